"""What the live view shows at joint values: the robot's vertices and the figures beside it, ready for JSON.

The base can be moved, and joint values are sought for a tip that somebody picked.
"""

from __future__ import annotations

import html
import itertools
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.parts import lumens_box
from ctrplan.base.arrays import LONGEST_MM, MM_PER_M, MOST_DEGREES, Array
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.friction_states import POINT_SPACING_M, UNEVEN_FRICTION_M, mesh_allowance_m
from ctrplan.drive.drive import Kind
from ctrplan.errors import InputError
from ctrplan.mechanics.equilibria import other_shapes
from ctrplan.mechanics.shapes import Status
from ctrplan.motion.checker import MotionChecker
from ctrplan.motion.limits import path_limits
from ctrplan.motion.play import play_reach, play_shift
from ctrplan.planning.reach import reach
from ctrplan.plans.planned_motion import Played, joints_at
from ctrplan.reports import looks as looks
from ctrplan.reports.plan_scene import (
    Trace,
    in_anatomy,
    line_trace,
    moved_traces,
    plate_trace,
    robot_traces,
    xyz,
)
from ctrplan.reports.robot_surface import RobotPose, pose, stand
from ctrplan.scenario.tip_solver import TipTarget

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

UNLIMITED = (-180.0, 180.0)  # deg of the slider of a rotation without limits
MOST: dict[Kind, float] = {"rotation": MOST_DEGREES, "translation": LONGEST_MM}  # deg, mm
REACH_SAMPLES = 300
STEPS = 200  # of a motion that is played
AROUND_M = 5e-3  # shown beside lumens
REMEMBERED = 4  # places of the base
NEAR_M = 0.2e-3  # of the frictionless tip from what was picked
STARTS = 60  # of the search for its joint values
FRICTION_STATES = {1: 9}  # of each pair, by the number of pairs; of more pairs the extremes and the middle
FEWEST_STATES = 3


@dataclass(frozen=True, eq=False)
class StandingBase:
    """A scenario with its base somewhere, and what checks its motions there."""

    scenario: Scenario
    checker: MotionChecker

    @classmethod
    def of(cls, scenario: Scenario) -> StandingBase:
        """Where the scenario has its base."""
        checker = MotionChecker(scenario)
        checker.limits = path_limits(scenario)  # the scenario's own, without what a search adds
        return cls(scenario, checker)

    @property
    def lines(self) -> str:
        """[base] of a scenario file."""
        x, y, z, w = Rotation.from_matrix(self.scenario.base_R).as_quat(canonical=True).tolist()
        place = ", ".join(f"{value:.6g}" for value in (self.scenario.base_position_m * MM_PER_M + 0.0).tolist())
        turn = ", ".join(f"{value + 0.0:.9f}".rstrip("0").rstrip(".") for value in (w, x, y, z))
        return f"[base]\nposition_mm = [{place}]\nquaternion_wxyz = [{turn}]"


class LiveState:
    """A scenario's robot at any joint values; calls may come from several threads."""

    def __init__(self, scenario: Scenario, motion: Played | None = None) -> None:
        """Solves the scenario's start, where the sliders begin; a motion can be played."""
        self.scenario = scenario
        self.motion = motion
        self.placement = StandingBase.of(scenario)
        self.checker = self.placement.checker
        self._moved: dict[tuple[float, ...], StandingBase] = {}  # the last few
        self._lock = threading.Lock()
        self.start = self._shown(scenario.start)
        self.on_pose: Callable[[RobotPose], object] = lambda pose: None  # is told every pose that is shown

    def sliders(self) -> list[dict[str, Any]]:
        """Name, unit, range and first value of each joint, in deg or mm."""
        rows = []
        for joint, value in zip(self.scenario.robot.drive.joints, self.start, strict=True):
            low, high = UNLIMITED
            if not joint.is_unlimited:
                low, high = joint.lower / joint.si_per_unit, joint.upper / joint.si_per_unit
            rows.append({"name": joint.name, "unit": joint.unit, "min": low, "max": high, "value": value})
        return rows

    def played(self) -> dict[str, Any] | None:
        """Times [s] and joint values in deg or mm of the motion, at equal steps; None without one."""
        if self.motion is None:
            return None
        times = np.linspace(0.0, float(self.motion.time_s[-1]), STEPS)
        rows = [[round(value, 5) for value in self._shown(q)] for q in joints_at(self.motion, times)]
        return {"time_s": np.round(times, 3).tolist(), "joints": rows}

    def figure(self) -> dict[str, Any]:
        """The figure at the start, as a plain object: the traces that move first, then plate and anatomy."""
        scenario = self.scenario
        traces = [*robot_traces(pose(scenario, scenario.start)), plate_trace(scenario), *self._target()]
        points_m = self._reach()
        return in_anatomy(traces, scenario, points_m, np.concatenate([points_m, stand(scenario).vertices_m]))

    def _target(self) -> list[Trace]:
        """The points that the scenario asks for, to be clicked on."""
        goals = [goal for goal in self.scenario.targets if goal.tip_m is not None]
        traces = []
        for goal in goals:
            symbol = "diamond" if goal is self.scenario.goal else "diamond-open"
            name = html.escape(goal.name) or (
                looks.GOAL_LOOK.name if goal is self.scenario.goal else "target on the way"
            )
            marker = {"symbol": symbol, "size": 7, "color": looks.GOAL_LOOK.colour}
            hover = f"{name}: a click moves the tip here<extra></extra>"
            shown = {"mode": "markers", "marker": marker, "name": name, "hovertemplate": hover}
            traces.append(line_trace(xyz(np.array([goal.tip_m])), **shown, meta={"target": True}))
        return traces

    def reaching(self, values: list[float], tip_mm: list[float], base: list[float] | None = None) -> dict[str, Any]:
        """{"joints": (m,) in deg or mm} whose frictionless tip is at a point [mm, anatomy's frame].

        Valid ones come first, then the nearest to `values` in deg or mm. Else {"refusal": how near the tip comes}.
        Raises InputError unless `tip_mm` is three finite numbers.
        """
        joints, placement = self._joints(values), self.placed(base)
        if len(tip_mm) != 3 or not all(map(math.isfinite, tip_mm)):
            raise InputError("must be three finite numbers", key="tip", value=tip_mm, unit="mm")
        scenario, drive = placement.scenario, placement.scenario.robot.drive
        target = scenario.base_R.T @ (np.array(tip_mm) / MM_PER_M - scenario.base_position_m)
        reached = reach(placement.checker, TipTarget(target), NEAR_M, np.random.default_rng(0), STARTS)
        if not reached.configurations:
            return {"refusal": f"the tip comes no nearer to that point than {reached.nearest.tip_error_m * 1e3:.1f} mm"}
        scale = np.where(drive.is_rotation, scenario.cost.mm_per_rad, MM_PER_M)
        away = [float(np.linalg.norm((way.joints - joints) * scale)) for way in reached.configurations]
        rank = [(not way.valid, far) for way, far in zip(reached.configurations, away, strict=True)]
        chosen = reached.configurations[rank.index(min(rank))]
        return {"joints": [round(value, 6) for value in self._shown(chosen.joints)]}

    def placed(self, move: list[float] | None) -> StandingBase:
        """With the base moved by x, y, z [mm] and turned about the anatomy's axes through it, x first, then y, z [deg].

        Raises InputError unless there are six finite numbers.
        """
        if move is None or not any(move):
            return self.placement
        if len(move) != 6 or not (np.abs(move) <= np.repeat([LONGEST_MM, MOST_DEGREES], 3)).all():
            rule = f"must be six numbers, up to {LONGEST_MM:g} mm and {MOST_DEGREES:g} deg"
            raise InputError(rule, key="base", value=move)
        with self._lock:
            if tuple(move) not in self._moved:
                while len(self._moved) >= REMEMBERED:
                    del self._moved[next(iter(self._moved))]
                turned = Rotation.from_euler("xyz", move[3:], degrees=True).as_matrix() @ self.scenario.base_R
                position_m = self.scenario.base_position_m + np.array(move[:3]) / MM_PER_M
                moved = replace(self.scenario, base_position_m=position_m, base_R=turned)
                self._moved[tuple(move)] = StandingBase.of(moved)
            return self._moved[tuple(move)]

    def at(self, values: list[float], base: list[float] | None = None) -> dict[str, Any]:
        """The answer for joint values in deg or mm, in the order of the drive: vertices [mm] and figures, or a refusal.

        `base` is how it was moved, see `placed`. Raises InputError unless there is a finite number per joint.
        """
        joints, placement = self._joints(values), self.placed(base)
        scenario = placement.scenario
        motion, samples = placement.checker.probe(joints)
        if samples is None:
            return {"refusal": self._refusal(motion.reason)}
        if samples.status[-1] == Status.FAILED:
            return {"refusal": "the mechanics solver found no equilibrium here"}
        shown = pose(scenario, joints)
        self.on_pose(shown)
        robot = scenario.robot
        tip_m = (shown.tip_m - scenario.base_position_m) @ scenario.base_R
        others = other_shapes(robot, *robot.drive.collars(joints), tip_m)
        clearance_mm = float(samples.clearance_m[-1]) * 1e3 if placement.checker.field else None
        return {
            "traces": [_vertices(trace) for trace in [*moved_traces([shown])[0], xyz(stand(scenario).vertices_m)]],
            "base": placement.lines,
            "tip_mm": _rounded(shown.tip_m * 1e3, 2),
            "bound_mm": _finite(float(samples.position_m[-1]) * 1e3),
            "bound_deg": _finite(math.degrees(float(samples.tangent_rad[-1]))),
            "stability": _finite(float(samples.stability[-1])),
            "other_shape_mm": max((1e3 * apart for apart, _ in others), default=0.0),
            "strain_percent": _finite(100 * float(samples.max_strain[-1])),
            "clearance_mm": clearance_mm,
            **clearances_mm(scenario, joints),
            "target": self._from_target(joints, shown.tip_m, float(samples.position_m[-1])),
            "status": Status(int(samples.status[-1])).name,
            "valid": motion.valid,
            "reason": motion.reason,
        }

    def _joints(self, values: list[float]) -> Array:
        joints = self.scenario.robot.drive.joints
        if len(values) != len(joints) or not all(map(math.isfinite, values)):
            raise InputError(f"must be {len(joints)} finite numbers, one per joint", key="q", value=values)
        for joint, value in zip(joints, values, strict=True):
            if abs(value) > MOST[joint.kind]:
                rule = f"must be at most {MOST[joint.kind]:g} {joint.unit} either way"
                raise InputError(rule, key=joint.name, value=value)
        return np.array([value * joint.si_per_unit for value, joint in zip(values, joints, strict=True)])

    def _shown(self, q: Array) -> list[float]:
        return [float(x) / joint.si_per_unit for x, joint in zip(q, self.scenario.robot.drive.joints, strict=True)]

    def _from_target(self, joints: Array, tip_m: Array, bound_m: float) -> dict[str, Any] | None:
        """How far [mm] the tip is from the scenario's target without friction and at worst; None without a target."""
        goal = self.scenario.goal
        if goal.tip_m is None:
            return None
        free_m, robot = float(np.linalg.norm(tip_m - goal.tip_m)), self.scenario.robot
        play_m = play_shift(robot, *robot.drive.commanded(joints))
        worst_m = free_m + bound_m + play_m
        return {
            "free_mm": free_m * 1e3,
            "worst_mm": _finite(worst_m * 1e3),
            "tolerance_mm": goal.tolerance_m * 1e3,
            "exceeds": not worst_m <= goal.tolerance_m,
        }

    def _refusal(self, reason: str) -> str:
        """Without the number of the only row there is."""
        return reason.split(": ", 1)[1] if reason.startswith("row ") else reason

    def _reach(self) -> Array:
        """(K, 3) what to look at, anatomy's frame: the plate and random tips, near the lumens where there are any."""
        q = self.checker.space.sample(np.random.default_rng(0), REACH_SAMPLES)
        tips, _, status = self.checker.mechanics.tips(*self.checker.space.drive.collars(q), loads=False)
        points = self.scenario.located(np.concatenate([tips[status == Status.CONVERGED], np.zeros((1, 3))]))
        room = lumens_box(self.scenario.anatomy)
        return points if room is None else np.clip(points, room[0] - AROUND_M, room[1] + AROUND_M)


def clearances_mm(scenario: Scenario, joints: Array) -> dict[str, float | None]:
    """Exact distances beyond the margins [mm] at joints (m,): without friction, and least of a grid of friction states.

    `sure_mm` is the latter less what a certificate takes off for the mesh, uneven friction and play. All are None in
    free space, and where the frictionless robot has no equilibrium.
    """
    names, distance, robot = ("nominal_mm", "friction_mm", "sure_mm"), AnatomyDistance.of(scenario), scenario.robot
    if distance is None:
        return dict.fromkeys(names)
    pairs = robot.n - 1 if robot.friction.any() else 0
    grid = np.linspace(-1, 1, FRICTION_STATES.get(pairs, FEWEST_STATES))
    frictionless = np.zeros((1, robot.n - 1))
    states = np.vstack([frictionless, list(itertools.product(grid, repeat=pairs))]) if pairs else frictionless
    theta_b, l_b = robot.drive.collars(joints)
    bodies = robot.mechanics.friction_bodies(theta_b, l_b, states, spacing_m=POINT_SPACING_M, accuracy="certificate")
    if not bodies.solved[0]:
        return dict.fromkeys(names)
    points = bodies.point_m[bodies.solved]
    owner = np.repeat(np.arange(len(points)), points.shape[1])
    least = distance.least(points.reshape(-1, 3), np.tile(bodies.radius_m, len(points)), owner, len(points))
    play_m = play_reach(robot, *robot.drive.commanded(joints))
    allowance = mesh_allowance_m(robot, "certificate") + UNEVEN_FRICTION_M + play_m
    figures_m = (float(least[0]), float(least.min()), float(least.min()) - allowance)
    return dict(zip(names, (value * 1e3 for value in figures_m), strict=True))


def _vertices(trace: Any) -> dict[str, list[float | None]]:
    return {axis: _rounded(np.asarray(trace[axis], dtype=np.float64), 3) for axis in "xyz"}


def _rounded(values: Array, digits: int) -> list[float | None]:
    """Plain numbers; gaps of a line become None."""
    return [None if math.isnan(value) else round(value, digits) for value in values.tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
