"""The base as an ITK transform file (.tfm), which Slicer and ITK read."""

from __future__ import annotations

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.arrays import Array
from ctrplan.files.slicer.slicer_space import lps_mm, to_lps


def itk_transform_text(position_m: Array, R: Array, frame: Frame) -> str:
    """A rigid motion x -> R x + position from the robot's frame to the anatomy's, as ITK writes it.

    ITK's transforms go the way that resampling needs, from the parent to what is moved, in LPS and mm: the file holds
    x -> A' (x - t) with A, t of the motion to LPS. Slicer turns that round when it reads, so that what is put under
    the transform, in files that it takes for LPS, moves from the robot's frame to the patient.
    """
    A, t = to_lps(frame) @ R, lps_mm(position_m, frame)
    parameters = [*(A.T).ravel().tolist(), *(-A.T @ t).tolist()]
    return (
        "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"
        f"Parameters: {' '.join(f'{value + 0.0:.12g}' for value in parameters)}\nFixedParameters: 0 0 0\n"
    )
