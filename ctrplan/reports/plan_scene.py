"""A plan in space: the robot along its path, solved once for all pictures and pages that draw it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.anatomy.parts import exact_clearance
from ctrplan.anatomy.patient_frame import ENDS, Frame, axis_label
from ctrplan.base.arrays import Array, spread_directions
from ctrplan.base.long_work import Progress
from ctrplan.base.surface import Rod, Surface, rod_vertices
from ctrplan.errors import SolverError
from ctrplan.files.plan_file import WrittenPlan
from ctrplan.mechanics.shapes import Status
from ctrplan.plans.planned_motion import Played, joints_at
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT
from ctrplan.reports.looks import view_box
from ctrplan.reports.robot_surface import RobotPose, anatomy_surface, pose, stand, tube_surface, tube_vertices
from ctrplan.scenario.scenario import Scenario

if TYPE_CHECKING:
    from ctrplan.certificate.certificate import Closest
    from ctrplan.plans.plan import Plan
    from ctrplan.scenario.scenario import Scenario

SIDES, ENVELOPE_SIDES = 10, 12
FINENESS = 128  # parts of a mm
TILT = np.radians(16)
LIGHT = {"ambient": 0.5, "diffuse": 0.75, "specular": 0.45, "roughness": 0.45, "fresnel": 0.1}
TISSUE_LIGHT = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.1, "roughness": 0.9, "fresnel": 0.5}


# A trace of plotly.js as a plain object. Those of plotly check what they consist of, which takes longer than the page:
# tests have them check it.
Trace = dict[str, Any]


def robot_traces(pose: RobotPose) -> list[Trace]:
    """The traces that move; their faces stay, and only their vertices come with the frames."""
    tubes = [
        mesh_trace(tube_surface(pose, i, SIDES), looks.tube_look(i).colour, 1.0, looks.tube_look(i).name)
        for i in range(len(pose.tubes))
    ]
    envelope = mesh_trace(
        pose.envelope.surface(ENVELOPE_SIDES), looks.ENVELOPE_LOOK.colour, 0.22, looks.ENVELOPE_LOOK.name
    )
    line = {"color": looks.CORNERS.colour, "width": 2}
    corners = line_trace(_corner_lines(pose), mode="lines", line=line, name=looks.CORNERS.name, hoverinfo="skip")
    return [*tubes, envelope, corners]


def line_trace(coordinates: dict[str, Any], **style: Any) -> Trace:
    """A line, points or words in space, `coordinates` as of `xyz`."""
    return {"type": "scatter3d", **coordinates, **style}


def moved_traces(poses: Sequence[RobotPose]) -> list[list[Trace]]:
    """What of `robot_traces` changes with the pose, for each."""
    envelopes = rod_vertices([pose.envelope for pose in poses], ENVELOPE_SIDES)
    return [
        [
            *({"type": "mesh3d", **xyz(vertices)} for vertices in (*tubes, envelope)),
            {"type": "scatter3d", **_corner_lines(pose)},
        ]
        for pose, tubes, envelope in zip(poses, tube_vertices(poses, SIDES), envelopes, strict=True)
    ]


def _corner_lines(pose: RobotPose) -> dict[str, Any]:
    """All corner shapes as one line with gaps."""
    gap = np.full((len(pose.corners_m), 1, 3), np.nan)
    return xyz(np.concatenate([pose.corners_m, gap], axis=1).reshape(-1, 3))


def anatomy_traces(scenario: Scenario, surfaces: list[Surface]) -> list[Trace]:
    """What to avoid and what to stay inside, translucent."""
    roles, traces = [part.role for part in scenario.anatomy], list[Trace]()
    for k, (role, surface) in enumerate(zip(roles, surfaces, strict=True)):
        look, opacity = looks.ANATOMY_LOOK[role], looks.ANATOMY_OPACITY[role]
        trace = mesh_trace(surface, look.colour, opacity, look.name, shown=role not in roles[:k])
        traces.append(trace | {"meta": {"cut": True, "wall": opacity}, "lighting": TISSUE_LIGHT})  # for looking.js
    return traces


def mesh_trace(surface: Surface, colour: str, opacity: float, name: str, shown: bool = True) -> Trace:
    """A lit surface that does not get in the way of the mouse."""
    i, j, k = surface.faces.T.astype(np.int32)
    return {
        "type": "mesh3d",
        **xyz(surface.vertices_m),
        "i": i,
        "j": j,
        "k": k,
        "color": colour,
        "opacity": opacity,
        "name": name,
        "legendgroup": name,
        "showlegend": shown,
        "lighting": LIGHT,
        "hoverinfo": "skip",
    }


def plate_trace(scenario: Scenario) -> Trace:
    """The front plate and the fixtures at it."""
    return mesh_trace(stand(scenario), looks.PLATE_LOOK.colour, 1.0, looks.PLATE_LOOK.name, shown=False)


def xyz(points_m: Array) -> dict[str, Any]:
    """Coordinates in mm to 1/128, in single precision: more than a screen can show, and pages are half as large."""
    x, y, z = (np.round(points_m * 1e3 * FINENESS) / FINENESS).astype(np.float32).T
    return {"x": x, "y": y, "z": z}


def laid_out(
    traces: list[Trace],
    lower_m: Array,
    upper_m: Array,
    points_m: Array,
    frame: Frame | None = None,
    *,
    base_m: Array | None = None,
    axes: bool = False,
) -> dict[str, Any]:
    """A figure of traces in space, with equal scales that stay while the robot moves, seen from where `points_m` (K, 3)
    spread widest, as near as may be.

    frame: of the patient, whose letters the axes have. base_m: (3,) from where the robot comes, left or below. axes:
    whether coordinates are to be read off; else a cross of known size stands in a corner of the box.
    """
    axis = {"backgroundcolor": "#F8FAFB", "gridcolor": looks.GRID, "zeroline": False, "nticks": 6, "visible": axes}
    ranges = (np.stack([lower_m, upper_m], axis=1) * 1e3).tolist()
    named = {
        f"{'xyz'[k]}axis": axis | {"title": {"text": f"{axis_label(k, frame)} (mm)"}, "range": r}
        for k, r in enumerate(ranges)
    }
    extent, (along, toward) = upper_m - lower_m, seen_from(points_m, base_m)
    sides = extent / np.cbrt(extent.prod())
    eye = (0.6 + 1.45 * sides.max()) * toward  # until fit_camera.js knows the shape of the window
    aspect = dict(zip("xyz", sides.tolist(), strict=True))
    light = dict(zip("xyz", (6e4 * (toward + 0.7 * np.cross(toward, along) + 0.3 * along)).tolist(), strict=True))
    camera = {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "center": {"x": 0, "y": 0, "z": 0.0}}
    traces = [trace | {"lightposition": light} if trace["type"] == "mesh3d" else trace for trace in traces]
    if not axes:
        traces += (cross := _cross(points_m, frame))
        points_m = np.concatenate([points_m, *(_ends_m(trace) for trace in cross)])
    scene = {"aspectmode": "manual", "aspectratio": aspect, "camera": camera, "bgcolor": "rgba(0,0,0,0)", **named}
    view = {"toward": toward.tolist(), "along": along.tolist(), "points": _outermost_mm(points_m), "axes": axes}
    layout = {
        "autosize": True,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "scene": scene,
        "paper_bgcolor": "rgba(0,0,0,0)",
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": looks.MUTED},
        "showlegend": False,  # the key is beside the scene
        "uirevision": "stays",
        "font": FIGURE_TEXT,
        "meta": {"view": view},
    }
    return {"data": traces, "layout": layout}


def in_anatomy(traces: list[Trace], scenario: Scenario, points_m: Array, seen_m: Array | None = None) -> dict[str, Any]:
    """The figure of traces about points (K, 3) [m] in a scenario's anatomy, seen from beside its base.

    seen_m: (K, 3) what a view of all has to hold, where that is not the same.
    """
    surfaces = [anatomy_surface(part) for part in scenario.anatomy]
    solid = np.concatenate([np.empty((0, 3)), *(surface.vertices_m for surface in surfaces)])
    shown = [*traces, *anatomy_traces(scenario, surfaces)]
    seen = points_m if seen_m is None else seen_m
    return laid_out(shown, *view_box(points_m, solid), seen, scenario.frame, base_m=scenario.base_position_m)


def seen_from(points_m: Array, base_m: Array | None = None) -> tuple[Array, Array]:
    """Unit vectors (3,), (3,): along the widest spread of points (K, 3), away from a base, and towards the eye.

    The eye looks across the two widest spreads, a little aslant, so that things in front stand in front.
    """
    middle = points_m.mean(axis=0)
    thin, wide, long = np.linalg.eigh(np.cov((points_m - middle).T) if len(points_m) > 1 else np.eye(3))[1].T
    along = long * (np.sign(long @ (middle - base_m)) or 1.0 if base_m is not None else np.sign(long[2]) or 1.0)
    toward = thin * (np.sign(thin @ FRONT) or 1.0) + np.tan(TILT) * wide * (np.sign(wide @ ABOVE) or 1.0)
    return along, toward / np.linalg.norm(toward)


FRONT, ABOVE = np.array([0.6, -1.0, 0.3]), np.array([0.2, -0.1, 1.0])  # where eyes usually are: only signs count
DIRECTIONS = 96  # in which outermost points are sought, a few degrees apart


def _outermost_mm(points_m: Array) -> list[list[float]]:
    """Points among (K, 3) that lie farthest in some direction, which a view of all has to hold."""
    rows = np.unique(np.argmax(points_m @ spread_directions(DIRECTIONS).T, axis=0))
    outermost: list[list[float]] = np.round(points_m[rows] * 1e3, 2).tolist()
    return outermost


ROUND_MM = (1, 2, 5, 10, 20, 50, 100)


def _ends_m(trace: Trace) -> Array:
    return np.column_stack([trace[axis] for axis in "xyz"]).astype(float) * 1e-3


def _cross(points_m: Array, frame: Frame | None) -> list[Trace]:
    """Three lines of one stated length in the lower corner around points (K, 3), with the letters of the axes."""
    corner, upper_m = points_m.min(axis=0), points_m.max(axis=0)
    extent, traces = float((upper_m - corner).max()) * 1e3, list[Trace]()
    length = max((mm for mm in ROUND_MM if mm <= 0.12 * extent), default=1)
    for k in range(3):
        end = corner + np.eye(3)[k] * length * 1e-3
        letter = "xyz"[k] if frame is None else ENDS[frame][k][1]
        text = ["", f"{letter}, {length} mm" if k == 0 else letter]
        drawn = {"mode": "lines+text", "line": {"color": looks.MUTED, "width": 4}, "text": text}
        style = {
            "textfont": {"color": looks.MUTED, "size": 12},
            "textposition": "top center",
            "showlegend": False,
            "hoverinfo": "skip",
        }
        traces.append(line_trace(xyz(np.stack([corner, end])), **drawn, **style, name="axes"))
    return traces


def poses_along(
    scenario: Scenario, trajectory: Played, frames: int, progress: Progress | None = None
) -> tuple[RobotPose, ...]:
    """`frames` poses of a trajectory, both ends included; one if it takes no time.

    Solves the model at each. Left out are poses where the model has none: a plan that is not certified may have some.
    Raises SolverError where no pose has a solution.
    """
    duration_s = float(trajectory.time_s[-1])
    times = np.linspace(0.0, duration_s, frames if duration_s > 0 else 1)
    path = []
    for k, (joints, at) in enumerate(zip(joints_at(trajectory, times), times.tolist(), strict=True)):
        if progress is not None:
            progress(k / len(times))
        with suppress(SolverError):
            path.append(pose(scenario, joints, at))
    if not path:
        raise SolverError("The model has no solution anywhere on the plan's trajectory.")
    return tuple(path)


SPACING_M = 1e-3
NUDGE_M = 1e-5  # of differences of the distance


@dataclass(frozen=True, eq=False)
class NarrowestPose:
    """In the friction state that comes closest; anatomy's frame."""

    place: Closest
    body: Rod  # outline of N stations
    clearance_m: Array  # (N,) of its surface beyond the margins
    gap_m: Array  # (2, 3) from the tube's surface to the anatomy's


def narrowest_pose(scenario: Scenario, place: Closest | None) -> NarrowestPose | None:
    """Solves one shape; None in free space, where there is no such place, and where the model has no solution."""
    if place is None:
        return None
    collars = scenario.robot.drive.collars(place.joints)
    result = scenario.robot.mechanics.friction_bodies(
        *collars, place.phi[None], spacing_m=SPACING_M, accuracy="certificate"
    )
    if not result.solved[0] or len(result.radius_m) < 2:
        return None
    points = scenario.located(result.point_m[0])
    along = np.gradient(points, axis=0)
    tangent = along / np.linalg.norm(along, axis=1, keepdims=True)
    clearance = exact_clearance(scenario.anatomy, points) - result.radius_m
    return NarrowestPose(place, Rod(points, tangent, result.radius_m), clearance, _gap(scenario, place))


def _gap(scenario: Scenario, place: Closest) -> Array:
    """(2, 3) straight across the free room at a place."""
    steps = NUDGE_M * np.concatenate([np.eye(3), -np.eye(3)])
    ahead, behind = exact_clearance(scenario.anatomy, place.point_m + steps).reshape(2, 3)
    away = (ahead - behind) / max(float(np.linalg.norm(ahead - behind)), 1e-12)
    radius = scenario.robot.tubes[place.tube - 1].outer_diameter_m / 2
    return place.point_m - np.array([[radius], [radius + place.distance_m]]) * away


@dataclass(frozen=True, eq=False)
class WrittenMotion:
    """A plan that was read, with the poses of its robot, anatomy's frame."""

    plan: WrittenPlan
    path: tuple[RobotPose, ...]  # at equal steps of the time, both ends included
    tip_m: Array  # (K, 3) without friction, at the places that were certified
    narrowest: NarrowestPose | None  # in free space

    @property
    def scenario(self) -> Scenario:
        """What was planned."""
        return self.plan.scenario

    @property
    def times_s(self) -> list[float]:
        """(F,) of the poses."""
        return [pose.time_s for pose in self.path]

    @property
    def targets(self) -> dict[str, Array]:
        """Places (3,) to be reached, in their order, by their names; of joint values the place that they lead to."""
        goals, result = self.scenario.targets, {}
        for k, goal in enumerate(goals, start=1):
            name = goal.name or ("goal" if k == len(goals) else f"target {k}")
            result[name] = goal.tip_m if goal.tip_m is not None else self.path[-1].tip_m
        return result

    @property
    def step_m(self) -> float:
        """How far a station of the robot's centreline moves at most between two poses."""
        lines = [pose.tubes[-1].centreline_m for pose in self.path]
        steps = [np.linalg.norm(b - a, axis=1).max() for a, b in zip(lines[:-1], lines[1:], strict=True)]
        return float(max(steps, default=0.0))

    def at(self, name: str) -> Array:
        """(F,) a column of the certificate's samples at the times of the poses; NaN where the plan has no number."""
        if name not in self.plan.certificate["samples"]:
            return np.full(len(self.path), np.nan)
        passed_s = np.interp(self.plan.certified_places, self.plan.places, self.plan.time_s)
        return np.interp(self.times_s, passed_s, self.plan.column(name))


def written_motion(plan: WrittenPlan, steps: int, progress: Progress | None = None) -> WrittenMotion:
    """Solves the model at `steps` poses, the tip wherever it was certified, and once where the robot is closest.

    Raises SolverError where no pose has a solution.
    """
    scenario, drive = plan.scenario, plan.scenario.robot.drive
    path = poses_along(scenario, plan, steps, progress)
    joints = np.array(plan.certificate["samples"]["joints"])
    free = np.zeros((len(joints), scenario.robot.n - 1))
    tips = scenario.robot.mechanics.tips_with_friction(*drive.collars(joints), free)
    tip_m = scenario.located(tips.position_m[tips.status == Status.CONVERGED])
    return WrittenMotion(plan, path, tip_m, narrowest_pose(scenario, plan.closest))


FRAMES = 50


@dataclass(frozen=True, eq=False)
class PlanScene:
    """A plan with the poses of its robot: all that writers need, so that none of them solves the model."""

    plan: Plan
    path: tuple[RobotPose, ...]  # at equal steps of the trajectory's time, both ends included; one if it takes no time
    narrowest: NarrowestPose | None = None  # in free space

    @property
    def start(self) -> RobotPose:
        """Where the trajectory begins."""
        return self.path[0]

    @property
    def goal(self) -> RobotPose:
        """Where the trajectory ends."""
        return self.path[-1]


def plan_scene(plan: Plan, frames: int = FRAMES) -> PlanScene:
    """The scene of a plan; solves the model `frames` times, and once where the robot is closest to the anatomy.

    Raises SolverError where no pose has a solution. Left out are poses where the model has none: a plan that is not
    certified may have some.
    """
    path = poses_along(plan.scenario, plan.trajectory, frames)
    return PlanScene(plan, path, narrowest_pose(plan.scenario, plan.certificate.closest))


def tip_path(plan: Plan) -> Array:
    """(K, 3) [m] the tip without friction at the certificate's samples, anatomy's frame."""
    return plan.scenario.located(plan.certificate.samples.tip_m)


def goal_tip(plan: Plan) -> Array:
    """(3,) [m] the tip that the goal asks for, or that its joint values give, anatomy's frame."""
    goal = plan.scenario.goal
    tip: Array = goal.tip_m if goal.tip_m is not None else tip_path(plan)[-1]
    return tip
