"""A tracker that was set up anew between runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.effects.effect import DEGREE, MILLIMETRE, Effect, Parameter, Values, joined_clauses, register, vectors
from ctrplan.measurement.measurements import Measurements, Poses, moved_rigidly
from ctrplan.robot.robot import Robot

MOST_FRAMES = 12


@register
class FrameShift(Effect):
    """A rigid motion of all poses of frame K beside those of the first: `rotation_x_K_deg` ..., `shift_x_K_mm` ..."""

    name = "frame_shift"
    in_words = "frames of the tracker that differ by run"
    stage = "sensor"
    equation = "p = R_k (rotation vector) p + t_k in the runs of frame k from 2 on, tangents turn with R_k"
    signature = "all poses of some runs are displaced by one rigid motion, those of others by another"
    look_alikes = ("base_misalignment", "drift")
    experiment = "repeat one run without touching the tracker: its frame stays"

    def in_figures(self, values: Values, robot: Robot) -> str:
        axes, text = "xyz", "frame {I} of the tracker is turned by {value} deg"
        turned = vectors(values, [f"rotation_{axis}_I_deg" for axis in axes], text)
        moved = vectors(
            values, [f"shift_{axis}_I_mm" for axis in axes], "frame {I} of the tracker is shifted by {value} mm"
        )
        return joined_clauses(turned, moved)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        frames = range(2, MOST_FRAMES + 1)
        return tuple(
            parameter
            for k in frames
            for parameter in (
                *(Parameter(f"rotation_{axis}_{k}_deg", 4.0, lower=-90, upper=90, si=DEGREE) for axis in "xyz"),
                *(Parameter(f"shift_{axis}_{k}_mm", 4.0, lower=-200, upper=200, si=MILLIMETRE) for axis in "xyz"),
            )
        )

    def untestable(self, robot: Robot, data: Measurements) -> str:
        frames = len(np.unique(data.frames[data.rows]))
        if frames < 2:
            return "all runs are of one frame of the tracker"
        return f"there are {frames} frames, at most {MOST_FRAMES} can be told" if frames > MOST_FRAMES else ""

    def variants(self, robot: Robot, data: Measurements) -> Sequence[Sequence[str]]:
        """The set-ups of the tracker that the poses are in."""
        frames = {str(k) for k in np.unique(data.frames[data.rows]).tolist()}
        return [[p.name for p in self.parameters(robot) if p.name.split("_")[2] in frames]]

    def sensor(self, values: Values, poses: Poses, data: Measurements) -> Poses:
        turn, shift = np.zeros((2, MOST_FRAMES + 1, 3))
        for name, value in values.items():
            kind, axis, frame, _ = name.split("_")
            (turn if kind == "rotation" else shift)[int(frame), "xyz".index(axis)] = value
        frame_of: Array = np.minimum(data.frames[data.rows], MOST_FRAMES)
        return moved_rigidly(poses, turn[frame_of], shift[frame_of])
