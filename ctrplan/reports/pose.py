"""The robot at one place, as pictures show it: in the anatomy's frame.

A tube is shown from the front plate to its tip; its part behind the plate is the drive's business.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Rod, Surface
from ctrplan.errors import SolverError

if TYPE_CHECKING:
    from ctrplan.mechanics.shapes import Bound, TubeShape
    from ctrplan.planning.scenario import Scenario

STATIONS = 40
STEP_M = 1e-5  # over which the outline drops from one tube's radius to the next one's
PLATE_THICKNESS_M = 0.8e-3


@dataclass(frozen=True, eq=False)
class Pose:
    """The robot at one place of its path, anatomy's frame; S stations per line, the same for every pose."""

    time_s: float
    tubes: tuple[Rod, ...]  # frictionless, outermost first
    envelope: Rod  # the outline with everything friction, as bounded, and the model error may add
    corners_m: Array  # (2**(n - 1), S, 3) innermost centreline of the corner shapes
    bound_m: float
    ends_R: Array  # (n, 3, 3) frames of the tubes where they end, third column along the tube

    @property
    def tip_m(self) -> Array:
        """(3,) tip without friction."""
        tip: Array = self.tubes[-1].centreline_m[-1]
        return tip


def pose(scenario: Scenario, joints: ArrayLike, time_s: float = 0.0) -> Pose:
    """The robot at commanded joints (m,) [rad, m]; solves one bound. Raises SolverError where there is no solution."""
    bound = scenario.robot.mechanics.bound(*scenario.robot.drive.collars(joints))
    if not np.isfinite(bound.position_m):
        raise SolverError("The model has no solution at these joints.")
    return _posed(scenario, bound, time_s)


def _posed(scenario: Scenario, bound: Bound, time_s: float) -> Pose:
    robot, tubes = scenario.robot, bound.frictionless.tubes
    radii = [tube.outer_diameter_m / 2 for tube in robot.tubes]
    rods = [_rod(tube, _stations(tube), radius) for tube, radius in zip(tubes, radii, strict=True)]
    return Pose(
        time_s,
        tuple(_in_anatomy(scenario, rod) for rod in rods),
        _in_anatomy(scenario, _envelope(bound, radii, robot.model_error_m)),
        np.array([scenario.located(_line(c.tubes[-1], _stations(c.tubes[-1]))[0]) for c in bound.corners]),
        bound.position_m,
        scenario.base_R @ np.array([tube.frames[-1] for tube in tubes]),
    )


def plate(scenario: Scenario) -> Rod:
    """The front plate, a disc that ends where the robot begins."""
    z = np.array([[0, 0, -PLATE_THICKNESS_M], [0, 0, 0]])
    radius = 4 * max(tube.outer_diameter_m for tube in scenario.robot.tubes) / 2
    return _in_anatomy(scenario, Rod(z, np.tile([0.0, 0.0, 1.0], (2, 1)), np.full(2, radius)))


def stand(scenario: Scenario) -> Surface:
    """The front plate and the fixtures at it."""
    surfaces = [plate(scenario).surface(32), *(fixture.shape.surface() for fixture in scenario.fixtures)]
    vertices = [surfaces[0].vertices_m, *(scenario.located(surface.vertices_m) for surface in surfaces[1:])]
    before = np.cumsum([0, *map(len, vertices[:-1])])
    faces = [surface.faces + count for surface, count in zip(surfaces, before, strict=True)]
    return Surface(np.concatenate(vertices), np.concatenate(faces))


def _in_anatomy(scenario: Scenario, rod: Rod) -> Rod:
    return Rod(scenario.located(rod.centreline_m), rod.tangent @ scenario.base_R.T, rod.radius_m)


def _stations(tube: TubeShape) -> Array:
    """Arc lengths (S,) from the plate to the tip; all at the tip of a tube that is behind the plate."""
    return np.linspace(min(0.0, tube.s_m[-1]), tube.s_m[-1], STATIONS)


def _rod(tube: TubeShape, s_m: Array, radius_m: float) -> Rod:
    return Rod(*_line(tube, s_m), np.full(len(s_m), radius_m if tube.s_m[-1] > 0 else 0.0))


def _line(tube: TubeShape, s_m: Array) -> tuple[Array, Array]:
    """Points and unit tangents (S, 3), (S, 3) of a tube at s_m."""
    line = CubicHermiteSpline(tube.s_m, tube.centreline_m, tube.frames[:, :, 2])
    tangent = line(s_m, 1)
    return line(s_m), tangent / np.linalg.norm(tangent, axis=1, keepdims=True)


def _envelope(bound: Bound, radii_m: list[float], model_error_m: float) -> Rod:
    """The outline of all tubes, thicker by the deviation of its station; a ring at each side of a tube's end."""
    shape = bound.frictionless
    end = max(float(shape.s_m[-1]), 0.0)
    tube_ends = np.array([tube.s_m[-1] for tube in shape.tubes])
    steps = np.concatenate([tube_ends[:-1], tube_ends[:-1] + STEP_M]).clip(0.0, end)
    s_m = np.sort(np.concatenate([np.linspace(0.0, end, STATIONS), steps]))
    reaches: NDArray[np.bool_] = s_m[:, None] <= tube_ends + STEP_M / 2
    outline = np.where(reaches, radii_m, 0.0).max(axis=1)
    deviation = np.interp(s_m, shape.s_m, bound.envelope_m)
    return Rod(*_line(shape.tubes[-1], np.minimum(s_m, shape.s_m[-1])), outline + deviation + model_error_m)
