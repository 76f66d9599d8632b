"""What the live view shows at joint values: the robot's vertices and the figures beside it, ready for JSON."""

from __future__ import annotations

import html
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.mechanics.shapes import Status
from ctrplan.motion.play import play_shift
from ctrplan.plans.planned_motion import Played, joints_at
from ctrplan.reports import looks as looks
from ctrplan.reports.live.clearances import clearances_mm
from ctrplan.reports.live.picked_tip import picked_tip
from ctrplan.reports.live.standing import Standings
from ctrplan.reports.looks import view_box
from ctrplan.reports.plan_words import WorstMiss
from ctrplan.reports.robot_surface import RobotPose, anatomy_surface, pose, stand
from ctrplan.reports.scene_traces import anatomy_traces, lay_out, mesh_trace, moved_traces, robot_traces, xyz

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

UNLIMITED = (-180.0, 180.0)  # deg of the slider of a rotation without limits
MOST = 1e5  # deg or mm: turns beyond have too few digits for an angle
REACH_SAMPLES = 300
STEPS = 200  # of a motion that is played
AROUND_M = 5e-3  # shown beside lumens


class LiveState:
    """A scenario's robot at any joint values; calls may come from several threads."""

    def __init__(self, scenario: Scenario, motion: Played | None = None) -> None:
        """Solves the scenario's start, where the sliders begin; a motion can be played."""
        self.scenario = scenario
        self.motion = motion
        self.standings = Standings(scenario)
        self.checker = self.standings.first.checker
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

    def figure(self) -> Any:
        """The plotly figure at the start: the traces that move first, then plate and anatomy."""
        import plotly.graph_objects as go

        scenario = self.scenario
        surfaces = [anatomy_surface(part) for part in scenario.anatomy]
        still = [mesh_trace(stand(scenario), looks.PLATE_LOOK.colour, 1.0, looks.PLATE_LOOK.name)]
        anatomy = anatomy_traces(scenario, surfaces)
        figure = go.Figure([*robot_traces(pose(scenario, scenario.start)), *still, *self._target(), *anatomy])
        reach = self._reach(surfaces)
        solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface in surfaces)])
        lay_out(figure, *view_box(reach, solid), reach, scenario.frame)
        return figure

    def _target(self) -> list[Any]:
        """The points that the scenario asks for, to be clicked on."""
        import plotly.graph_objects as go

        goals = [goal for goal in self.scenario.targets if goal.tip_m is not None]
        traces = []
        for goal in goals:
            symbol = "diamond" if goal is self.scenario.goal else "diamond-open"
            name = html.escape(goal.name) or (
                looks.GOAL_LOOK.name if goal is self.scenario.goal else "target on the way"
            )
            marker = {"symbol": symbol, "size": 7, "color": looks.GOAL_LOOK.colour}
            hover = f"{name}: a click moves the tip here<extra></extra>"
            shown = {
                "mode": "markers",
                "marker": marker,
                "name": name,
                "hovertemplate": hover,
                "meta": {"target": True},
            }
            traces.append(go.Scatter3d(**xyz(np.array([goal.tip_m])), **shown))
        return traces

    def reaching(self, values: list[float], tip_mm: list[float], base: list[float] | None = None) -> dict[str, Any]:
        """Joint values for a tip [mm, anatomy's frame], near to joint values in deg or mm, or a refusal; as `at`."""
        return picked_tip(self.standings.at(base), self._joints(values), tip_mm)

    def at(self, values: list[float], base: list[float] | None = None) -> dict[str, Any]:
        """The answer for joint values in deg or mm, in the order of the drive: vertices [mm] and figures, or a refusal.

        `base` is how it was moved, see `Standings`. Raises InputError unless there is a finite number per joint.
        """
        joints, standing = self._joints(values), self.standings.at(base)
        scenario = standing.scenario
        motion, samples = standing.checker.probe(joints)
        if samples is None:
            return {"refusal": self._refusal(motion.reason)}
        if samples.status[-1] == Status.FAILED:
            return {"refusal": "the mechanics solver found no equilibrium here"}
        shown = pose(scenario, joints)
        self.on_pose(shown)
        clearance_mm = float(samples.clearance_m[-1]) * 1e3 if standing.checker.field else None
        return {
            "traces": [self._vertices(trace) for trace in self._moved(shown, scenario)],
            "base": standing.lines,
            "tip_mm": _rounded(shown.tip_m * 1e3, 2),
            "bound_mm": _finite(float(samples.position_m[-1]) * 1e3),
            "bound_deg": _finite(math.degrees(float(samples.tangent_rad[-1]))),
            "stability": _finite(float(samples.stability[-1])),
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
            if abs(value) > MOST:
                raise InputError(f"must be at most {MOST:g} {joint.unit} either way", key=joint.name, value=value)
        return np.array([value * joint.si_per_unit for value, joint in zip(values, joints, strict=True)])

    def _shown(self, q: Array) -> list[float]:
        return [float(x) / joint.si_per_unit for x, joint in zip(q, self.scenario.robot.drive.joints, strict=True)]

    def _from_target(self, joints: Array, tip_m: Array, bound_m: float) -> dict[str, Any] | None:
        """How far [mm] the tip is from the scenario's target without friction and at worst; None without a target."""
        goal = self.scenario.goal
        if goal.tip_m is None:
            return None
        free_m, robot = float(np.linalg.norm(tip_m - goal.tip_m)), self.scenario.robot
        play_m = play_shift(robot, *robot.drive.collars(joints))
        miss = WorstMiss("the target", free_m, bound_m, play_m, goal.tolerance_m)
        return {
            "free_mm": miss.without_friction_m * 1e3,
            "worst_mm": _finite(miss.total_m * 1e3),
            "tolerance_mm": goal.tolerance_m * 1e3,
            "exceeds": miss.exceeds,
        }

    def _refusal(self, reason: str) -> str:
        """Without the number of the only row there is."""
        return reason.split(": ", 1)[1] if reason.startswith("row ") else reason

    def _reach(self, surfaces: list[Surface]) -> Array:
        """(K, 3) what to look at, anatomy's frame: the plate and random tips, near the lumens where there are any."""
        q = self.checker.space.sample(np.random.default_rng(0), REACH_SAMPLES)
        tips, _, status = self.checker.mechanics.tips(*self.checker.space.drive.collars(q))
        points = self.scenario.located(np.concatenate([tips[status == Status.CONVERGED], np.zeros((1, 3))]))
        parts = zip(self.scenario.anatomy, surfaces, strict=True)
        lumens = [surface.vertices_m for part, surface in parts if part.role == "inside"]
        if lumens:
            room = np.concatenate(lumens)
            points = np.clip(points, room.min(axis=0) - AROUND_M, room.max(axis=0) + AROUND_M)
        return points

    def _moved(self, shown: RobotPose, scenario: Scenario) -> list[Any]:
        """What of the figure changes: its first traces, the plate last."""
        return [*moved_traces(shown), xyz(stand(scenario).vertices_m)]

    def _vertices(self, trace: Any) -> dict[str, list[float | None]]:
        return {axis: _rounded(np.asarray(trace[axis], dtype=np.float64), 3) for axis in "xyz"}


def _rounded(values: Array, digits: int) -> list[float | None]:
    """Plain numbers; gaps of a line become None."""
    return [None if math.isnan(value) else round(value, digits) for value in values.tolist()]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
