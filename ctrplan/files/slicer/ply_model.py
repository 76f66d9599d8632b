"""Surfaces as binary PLY: the simplest format that Slicer reads and that can say its frame."""

from __future__ import annotations

import numpy as np

from ctrplan.anatomy.patient_frame import Frame
from ctrplan.base.surface import Surface
from ctrplan.files.slicer.slicer_space import SPACE, lps_mm

FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def ply_model(surface: Surface, frame: Frame) -> bytes:
    """The file's content: vertices in mm, in single precision; Slicer takes the frame from the comment."""
    vertices = lps_mm(surface.vertices_m, frame).astype("<f4")
    faces = np.empty(len(surface.faces), FACE)
    faces["count"], faces["corners"] = 3, surface.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment SPACE={SPACE}",
        "comment unit mm",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    return "\n".join(header).encode() + b"\n" + vertices.tobytes() + faces.tobytes()
