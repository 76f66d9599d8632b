"""What of a plan is drawn: the anatomy as glass, or as a wall where the eye is within it, and the robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod, capsule
from ctrplan.reports import looks as looks
from ctrplan.reports.plan_scene import WrittenMotion
from ctrplan.reports.render.body import Body
from ctrplan.reports.robot_surface import RobotPose, anatomy_surface, stand

TRIANGLES = 60_000  # of a part of the anatomy
SIDES, ENVELOPE_SIDES = 24, 24
GLASS = {"avoid": (0.30, 0.85), "inside": (0.06, 0.75)}  # opacity seen squarely and along the surface
PATH_M, MARK_M = 0.0022, 0.009  # thickness of the tip's path and size of targets, shares of the robot's length
LINE_M, APART_M, BEAD_M = 0.8e-3, 5e-3, 0.7e-3  # along the path as a line and as beads, and their size
NEAREST_BEAD = 5.0  # radii: nearer ones would cover what lies ahead
WALL = np.array([0.86, 0.52, 0.46])  # of a lumen seen from inside


def still_bodies(motion: WrittenMotion, inside: bool) -> list[Body]:
    """Anatomy, plate, the tip's path and the targets."""
    return [*_anatomy(motion, inside), *_marks(motion, inside)]


def moving_bodies(pose: RobotPose, motion: WrittenMotion, inside: bool) -> list[Body]:
    """Tubes, and the envelope of friction around them; an endoscope sees the way that is left instead."""
    if inside:
        return list(_way_ahead(pose, motion))
    tubes = [
        Body(rod.surface(SIDES), rgb(looks.tube_look(tube).colour))
        for tube, rod in enumerate(pose.tubes)
        if rod.radius_m.any()
    ]
    return [*tubes, Body(pose.envelope.surface(ENVELOPE_SIDES), rgb(looks.ENVELOPE_LOOK.colour), 0.14, 0.6)]


def rgb(colour: str) -> Array:
    """(3,) in [0, 1] of "#RRGGBB"."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255


def _anatomy(motion: WrittenMotion, inside: bool) -> Iterator[Body]:
    for part in motion.scenario.anatomy:
        surface = anatomy_surface(part, TRIANGLES)
        if inside:
            yield Body(surface, WALL if part.role == "inside" else rgb(looks.ANATOMY_LOOK["avoid"].colour))
        else:
            yield Body(surface, rgb(looks.ANATOMY_LOOK[part.role].colour), *GLASS[part.role])


def _marks(motion: WrittenMotion, inside: bool) -> Iterator[Body]:
    if inside:
        return
    length = _length(motion)
    yield Body(stand(motion.scenario), rgb(looks.PLATE_LOOK.colour))
    line = _beads(motion.tip_m, LINE_M)
    if len(line) > 1:
        tangent = np.gradient(line, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
        yield Body(Rod(line, tangent, np.full(len(line), PATH_M * length)).surface(8), rgb(looks.TIP_PATH.colour))
    for point in motion.targets.values():
        yield Body(capsule(point, point, MARK_M * length, 24), rgb(looks.GOAL_LOOK.colour), 0.75, 1.0)


def _way_ahead(pose: RobotPose, motion: WrittenMotion) -> Iterator[Body]:
    """Beads where the tip will come, and the targets, unless the eye is there."""
    eye, size = pose.tip_m, BEAD_M
    beads = _beads(motion.tip_m, APART_M)
    passed = int(np.argmin(np.linalg.norm(beads - eye, axis=1)))
    marks = [(point, 0.6 * size, looks.TIP_PATH.colour) for point in beads[passed + 1 :]]
    marks += [(point, 1.6 * size, looks.GOAL_LOOK.colour) for point in motion.targets.values()]
    for point, radius, colour in marks:
        if np.linalg.norm(point - eye) > NEAREST_BEAD * radius:
            yield Body(capsule(point, point, radius, 24), rgb(colour))


def _beads(path: Array, apart_m: float) -> Array:
    """(K, 3) points of a path that are about `apart_m` from each other along it, both ends included."""
    s_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, s_m[-1], int(s_m[-1] / apart_m) + 2)
    moves = np.diff(s_m, prepend=-1.0) > 0
    return np.stack([np.interp(at, s_m[moves], column) for column in path[moves].T], axis=1)


def _length(motion: WrittenMotion) -> float:
    line = motion.path[-1].tubes[-1].centreline_m
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
