"""`ctrplan.check`: what a file says of a robot, a task, measured poses or a plan, in numbers that a person knows.

A stiffness becomes a Young's modulus, a curvature a radius and the strain when the tube is held straight; a flag says
which number is most likely in another unit. Nothing is changed.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import HOUR_S, MM_PER_M, Array
from ctrplan.calibration.reading import read_again
from ctrplan.certificate.certificate import FIGURES
from ctrplan.drive.legs import Collars
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.plan_file import WrittenPlan, load_plan
from ctrplan.files.plan_inputs import SUFFIX
from ctrplan.files.robot_file import doubtful_numbers, load_robot
from ctrplan.files.scenario_file import doubtful_sizes, load_scenario
from ctrplan.measurement.approach import how_taken
from ctrplan.measurement.measurements import Measurements
from ctrplan.mechanics.shapes import Bound, Status
from ctrplan.mechanics.tube import TubeSection
from ctrplan.pipeline.tip_table import point_table
from ctrplan.planning.room import blocked, fixture_trouble, start_trouble
from ctrplan.reports.object_figures import bound_figure, robot_figure
from ctrplan.robot.magnitudes import implied_young_Pa, reach_m, straightened_strain
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.scenario.sizes import nearest_tip_m
from ctrplan.storage.toml_document import Document, read_document

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAMPLES = 64  # configurations whose bounds are looked at, a second or so of three tubes
SHOWN = {"m": (1e3, " mm"), "rad": (180 / math.pi, " deg"), "mm": (1.0, " mm"), "number": (1.0, "")}
MORE = "in doubt: ctrplan check"  # in the line that stands for several flags
FAR_OFF = 0.1  # of the robot's length: a median error that no effect explains, where no other reading does


@dataclass(frozen=True, eq=False)
class Check:
    """What was read: `lines` to read, `flags` for what is in doubt, `notes` of the file; figures to look at."""

    name: str
    kind: str  # "robot", "scenario", "measurements", "plan"
    lines: tuple[str, ...]
    flags: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)  # numbers of the lines, by name and unit
    robot: Robot | None = None
    bound: Bound | None = None  # the largest among those that were looked at

    @property
    def text(self) -> str:
        """All of it, as `ctrplan check` prints it."""
        remarks = [*(f"! {flag}" for flag in self.flags), *(f"note: {note}" for note in self.notes)]
        last = "Nothing is in doubt." if not self.flags else f"{len(self.flags)} in doubt, marked by !."
        return "\n".join([f"{self.name} ({self.kind})", *self.lines, *remarks, last])

    def figures(self) -> dict[str, Figure]:
        """Figures by name: "tubes" of the robot, "bound" of the largest bound."""
        result = {} if self.robot is None else {"tubes": robot_figure(self.robot)}
        if self.bound is not None:
            result["bound"] = bound_figure(self.bound, "largest friction error of those looked at")
        return result

    def __repr__(self) -> str:
        """The text, at most 30 lines of it."""
        lines = [line if len(line) <= 120 else f"{line[:117]}..." for line in self.text.splitlines()]
        return "\n".join(lines if len(lines) <= 30 else [*lines[:29], "..."])


def check(
    subject: str | os.PathLike[str] | Robot | Scenario | Measurements | WrittenPlan,
    *,
    robot: str | os.PathLike[str] | Robot | None = None,
    allow_outside: bool = True,
) -> Check:
    """Looks at a robot, a scenario, measurements or a plan, or at the file of one.

    robot: that measurements are of. allow_outside: whether a scenario may name files outside its folder. Raises
    InputError for what is no such file, and where measurements lack their robot.
    """
    given = _read(subject, robot, allow_outside)
    if robot is not None and not isinstance(given, Measurements):
        raise InputError("goes with measurements only", key="robot", value=str(getattr(robot, "name", robot)))
    if isinstance(given, Robot):
        return _of_robot(given)
    if isinstance(given, Scenario):
        return _of_scenario(given)
    if isinstance(given, WrittenPlan):
        return _of_plan(given)
    if isinstance(given, Measurements):
        own = load_robot(robot) if isinstance(robot, (str, os.PathLike)) else robot
        if not isinstance(own, Robot):
            raise InputError("is needed: measurements say nothing without their robot", key="robot")
        return _of_measurements(given, own)
    rule = "must be a file, a Robot, a Scenario, Measurements or a written plan"
    raise InputError(rule, key="subject", value=subject)


def _read(subject: Any, robot: Any, allow_outside: bool) -> Any:
    """The object of a file; other things as they are. Raises InputError."""
    if not isinstance(subject, (str, os.PathLike)):
        return subject
    path = Path(subject)
    if path.is_dir() or path.suffix.lower() in (".json", SUFFIX):
        return load_plan(path, allow_outside=allow_outside)
    if path.suffix.lower() == ".csv":
        return _measurements(path, robot)
    content = read_document(path).content
    if "tube" in content:
        return load_robot(path)
    if "run" in content or "columns" in content:
        return _measurements(path, robot)
    return load_scenario(path, allow_outside=allow_outside)


def _measurements(path: Path, robot: Any) -> Measurements:
    own = load_robot(robot) if isinstance(robot, (str, os.PathLike)) else robot
    if not isinstance(own, Robot):
        raise InputError("is needed: say the robot that was measured (--robot ROBOT.toml)", file=path, key="robot")
    return load_measurements(path, own)


def _of_robot(robot: Robot) -> Check:
    lines, facts = _tubes(robot)
    more, bound, numbers = _bounds(robot)
    flags = doubtful_numbers(robot.ideal or robot, Document(dict(robot.content), robot.path))
    notes = [text for text in robot.warnings if MORE not in text and text not in flags]
    return Check(
        name=robot.name,
        kind="robot",
        lines=(*lines, *_pairs(robot), *_drive(robot), *more),
        flags=tuple(flags),
        notes=tuple(notes),
        facts=facts | numbers,
        robot=robot,
        bound=bound,
    )


def _tubes(robot: Robot) -> tuple[list[str], dict[str, Any]]:
    lines, facts = [], dict[str, Any]()
    for i, tube in enumerate(robot.tubes, start=1):
        young, strain = implied_young_Pa(tube) / 1e9, straightened_strain(tube)
        arcs = [_arc(section) for section in tube.sections if section.curvature_per_m > 0]
        bent = f"bent by a radius of {', then '.join(arcs)}" if arcs else "straight"
        sizes = f"{tube.outer_diameter_m * 1e3:.4g} x {tube.inner_diameter_m * 1e3:.4g} mm"
        lines.append(f"tube {i}: {sizes}, {tube.length_m * 1e3:.4g} mm long, {bent}")
        torsion = young / (2 * (1 + tube.poisson_ratio))
        lines.append(
            f"        Young's modulus {young:.3g} GPa, shear modulus {torsion:.3g} GPa by stiffness and diameters; "
            f"straightened it is strained by {100 * strain:.2g} %, {100 * tube.max_strain:.2g} % are allowed"
        )
        facts |= {
            f"tube.{i}.youngs_modulus_GPa": young,
            f"tube.{i}.shear_modulus_GPa": torsion,
            f"tube.{i}.straightened_strain": strain,
        }
    return lines, facts


def _arc(section: TubeSection) -> str:
    length, turned = section.length_m * 1e3, math.degrees(section.curvature_per_m * section.length_m)
    return f"{1e3 / section.curvature_per_m:.4g} mm over {length:.4g} mm ({turned:.3g} deg)"


def _pairs(robot: Robot) -> list[str]:
    return [
        f"tubes {i + 1} and {i + 2}: {gap * 1e3:.3g} mm radial clearance, friction coefficient {_interval(friction)}"
        for i, (gap, friction) in enumerate(zip(robot.clearance_m.tolist(), robot.friction.tolist(), strict=True))
    ]


def _interval(ends: list[float]) -> str:
    return f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g} to {ends[1]:g}"


def _drive(robot: Robot) -> list[str]:
    ranges = []
    for joint in robot.drive.joints:
        low, high = joint.lower / joint.si_per_unit, joint.upper / joint.si_per_unit
        unlimited = not (math.isfinite(low) and math.isfinite(high))
        ranges.append(f"{joint.name} {'without end' if unlimited else f'{low:.4g} to {high:.4g} {joint.unit}'}")
    least, most = robot.drive.travel_m
    tip = robot.tubes[-1].length_m
    ends = f"{(least[-1] + tip) * 1e3:.4g} to {(most[-1] + tip) * 1e3:.4g} mm"
    ahead = f"the innermost tip {ends} along, in front of the plate"
    return [f"drive: {', '.join(ranges)}", f"       {ahead}"]


def _bounds(robot: Robot) -> tuple[list[str], Bound | None, dict[str, Any]]:
    """The friction bounds of configurations drawn at random: the largest, and how many have several equilibria."""
    q = JointSpace.of_robot(robot).sample(np.random.default_rng(0), SAMPLES)
    if not len(q):
        return ["no joint values were found that nest the tubes"], None, {}
    theta, l = robot.drive.collars(q)  # noqa: E741 (as in the equations)
    bounds = robot.mechanics.bound_many(theta, l)
    counts = {status: int((bounds.status == status).sum()) for status in Status}
    solved = np.where(np.isfinite(bounds.position_m), bounds.position_m, -1.0)
    several = counts[Status.MULTIPLE] + counts[Status.UNSTABLE]
    lines = [f"of {len(q)} configurations drawn at random {several} have several equilibria or snap"]
    if counts[Status.FAILED]:
        lines[0] += f", {counts[Status.FAILED]} were not solved"
    facts: dict[str, Any] = {"configurations": len(q), "several_equilibria": several}
    if solved.max() < 0:
        return lines, None, facts
    worst = int(np.argmax(solved))
    middle = float(np.median(solved[solved >= 0]))
    lines.append(
        f"friction may move the tip by {middle * 1e3:.3g} mm in the middle, {solved[worst] * 1e3:.3g} mm at most: "
        f"{_shown(robot, q[worst])}"
    )
    facts |= {"bound_median_mm": middle * 1e3, "bound_largest_mm": float(solved[worst]) * 1e3}
    bound = robot.mechanics.bound(theta[worst], l[worst])
    return lines, bound, facts


def _shown(robot: Robot, q: Array) -> str:
    joints = zip(robot.drive.joints, q.tolist(), strict=True)
    return ", ".join(f"{joint.name} {value / joint.si_per_unit:.4g} {joint.unit}" for joint, value in joints)


def _of_scenario(scenario: Scenario) -> Check:
    robot = _of_robot(scenario.robot)
    reach = reach_m(scenario.robot)
    lines = [f"robot {robot.name}, {reach * 1e3:.4g} mm long; base at {_point(scenario.base_position_m)} mm"]
    for goal in scenario.targets:
        if goal.tip_m is not None:
            away = float(np.linalg.norm(goal.tip_m - scenario.base_position_m))
            share = f"{away * 1e3:.3g} mm from the base, {100 * away / reach:.2g} % of the robot's length"
            lines.append(
                f"{goal.table}: tip at {_point(goal.tip_m)} mm within {goal.tolerance_m * 1e3:.3g} mm, {share}"
            )
        else:
            lines.append(f"{goal.table}: joint values")
    for k, part in enumerate(scenario.anatomy, start=1):
        size = np.ptp(np.array(part.shape.box()), axis=0) * MM_PER_M
        role = "to stay inside" if part.role == "inside" else "to avoid"
        margin = f"margin {part.margin_m * 1e3:.3g} mm"
        lines.append(f"anatomy.{k}: {part.shape.name}, {_point(size / MM_PER_M)} mm across, {role}, {margin}")
    start, fault = _start(scenario)
    lines += [f"start: {_shown(scenario.robot, scenario.start)}", *([start] if start else [])]
    faults = {"start": fault} | {goal.place: _goal_fault(scenario, goal) for goal in scenario.targets}
    where = scenario.path or scenario.name
    fixture = fixture_trouble(scenario)
    flags = [
        *doubtful_sizes(scenario),
        *([f"{where}: {fixture}"] if fixture else []),
        *(f"{where}: {key}: {text}" for key, text in faults.items() if text),
    ]
    notes = [text for text in scenario.warnings if text not in (*scenario.robot.warnings, *flags) and MORE not in text]
    return Check(
        name=scenario.name,
        kind="scenario",
        lines=tuple(lines),
        flags=(*flags, *robot.flags),
        notes=(*notes, *robot.notes),
        facts=robot.facts,
        robot=scenario.robot,
        bound=robot.bound,
    )


def _start(scenario: Scenario) -> tuple[str, str]:
    """What the start is like, and what makes it impossible: nesting, or a body in the anatomy; empty if nothing."""
    space = JointSpace.of(scenario)
    if not space.allowed(scenario.start):
        return "", space.violation(scenario.start)
    from ctrplan.motion.checker import MotionChecker  # with its own solver

    status = scenario.robot.mechanics.bound(*scenario.robot.drive.collars(scenario.start))
    checker = MotionChecker(scenario)
    room_m = float(checker.clearance(scenario.start).clearance_m[0])
    line = (
        f"       stability {status.frictionless.stability:.2g}, strain {100 * status.frictionless.max_strain:.2g} %, "
        f"friction may move the tip by {status.position_m * 1e3:.3g} mm there"
    )
    if np.isfinite(room_m):
        line += f"; {room_m * MM_PER_M:.3g} mm are left beyond the margins"
    near = f"the body is {-room_m * MM_PER_M:.3g} mm too near to the anatomy, or in it" if room_m < 0 else ""
    return line, near and (start_trouble(checker) or near)


def _goal_fault(scenario: Scenario, goal: Goal) -> str:
    """What makes it impossible that any tip gets to a goal; empty if nothing is seen."""
    robot, tip = scenario.robot, goal.tip_m
    if tip is None or goal.joints is not None:
        return ""
    if trouble := blocked(scenario, tip, robot.tubes[-1].outer_diameter_m / 2, goal.tolerance_m):
        return trouble
    at = scenario.base_R.T @ (tip - scenario.base_position_m)
    away, reach = float(np.linalg.norm(at)), reach_m(robot)
    same = "are the goal and [base] in the same frame?"
    if away > reach + goal.tolerance_m:
        return f"lies {away * 1e3:.3g} mm from the base, the robot is {reach * 1e3:.3g} mm long: {same}"
    if away < nearest_tip_m(robot) - goal.tolerance_m:
        return (
            f"lies {away * 1e3:.3g} mm from the base, no tip ends nearer to it than {nearest_tip_m(robot) * 1e3:.3g} mm"
        )
    q = JointSpace.of_robot(robot).sample(np.random.default_rng(0), SAMPLES)
    if at[2] < 0 and len(q) and np.nanmin(robot.mechanics.tips(*robot.drive.collars(q))[0][:, 2]) > 0:
        return f"lies {-at[2] * 1e3:.3g} mm behind the base, where none of {len(q)} tips was: {same}"
    return ""


def _point(point_m: Array) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in np.round(point_m * MM_PER_M, 3) + 0.0) + ")"


def _of_measurements(data: Measurements, robot: Robot) -> Check:
    runs = len(np.unique(data.sequence))
    theta = np.degrees(np.ptp(data.theta_commanded, axis=0))
    travel = np.ptp(data.l_commanded, axis=0) * MM_PER_M
    away = np.linalg.norm(data.position_m, axis=1)
    lines = [
        f"{data.count} poses of {len(data.sequence)} rows in {runs} run{'s' if runs > 1 else ''}",
        f"tubes turn by {_listed(theta)} deg and move by {_listed(travel)} mm",
        f"measured points lie {away.min() * 1e3:.4g} to {away.max() * 1e3:.4g} mm from the base; the robot is "
        f"{reach_m(robot) * 1e3:.4g} mm long",
    ]
    theta_b, l_b = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    collars = (theta_b, l_b) if data.of_collars else robot.collars(theta_b, l_b)
    table = point_table(robot, data, Collars(*collars), np.zeros((data.count, robot.n - 1)))
    off = np.linalg.norm(table.position_m - data.position_m, axis=1)[table.sound]
    if data.time_s is not None:
        span = float(np.ptp(data.time_s))
        lines.append(
            f"they took {span:.3g} s (time_s)" if span < HOUR_S else f"they took {span / HOUR_S:.3g} h (time_s)"
        )
    readings = read_again(robot, data)
    facts: dict[str, Any] = {"poses": data.count, "reading": [reading.to_json() for reading in readings]}
    flags = [f"{data.file}: {reading.sentence}" for reading in readings]
    flags += [text for text in data.warnings if text.endswith("?")]
    if len(off):
        facts |= {"error_median_mm": float(np.median(off)) * 1e3, "error_largest_mm": float(off.max()) * 1e3}
        lines.append(
            f"the robot file explains them, without friction, to {np.median(off) * 1e3:.3g} mm in the middle, "
            f"{off.max() * 1e3:.3g} mm at most"
        )
        if not readings and np.median(off) > FAR_OFF * reach_m(robot):
            rule = "is too far for any effect: are columns in another order, axis or unit, or is the frame another one"
            flags.append(
                f'{data.file}: {np.median(off) * 1e3:.3g} mm {rule}? frame = "unknown" in a mapping file finds it.'
            )
    notes = (*(text for text in data.warnings if text not in flags), *how_taken(data))
    return Check(str(data.file), "measurements", tuple(lines), tuple(flags), notes, facts, robot)


def _listed(values: Array) -> str:
    return ", ".join(f"{x:.4g}" for x in values)


def _of_plan(plan: WrittenPlan) -> Check:
    certificate = plan.content["certificate"]
    valid = "valid" if certificate.get("valid") else "not valid"
    lines = [f"{len(plan.content['legs'])} legs, {float(plan.time_s[-1]):.3g} s; its certificate says {valid}"]
    for key, figure in FIGURES.items():
        if isinstance(value := certificate.get(key), float) and figure.title and figure.unit in SHOWN:
            factor, unit = SHOWN[figure.unit]
            lines.append(f"{figure.title}: {value * factor:.3g}{unit}")
    scenario = _of_scenario(plan.scenario)
    return Check(
        plan.scenario.name,
        "plan",
        tuple(lines),
        (*plan.warnings, *scenario.flags),
        scenario.notes,
        scenario.facts,
        scenario.robot,
        scenario.bound,
    )
