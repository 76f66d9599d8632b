"""The plan: a planned motion that writes and rechecks itself, and its plan.json. The schema is
docs/plan.schema.json.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array, content_sha256
from ctrplan.base.package import __version__, shown
from ctrplan.certificate.certificate import Closest, Difference, Recheck, path_differences
from ctrplan.drive.drive import Drive
from ctrplan.drive.legs import distance_from_polyline
from ctrplan.drive.trajectory import late_rows
from ctrplan.plans.planned_motion import PlannedMotion, place_time_s, settling_duration_s
from ctrplan.storage.output_folder import write_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ctrplan.plans.planned_motion import Leg, ReorderReport
    from ctrplan.robot.robot import Robot
    from ctrplan.scenario.scenario import Goal, Scenario

SCHEMA_VERSION = 6  # rises when a key changes its meaning or goes
SI_UNITS = {"deg": "rad", "mm": "m"}


def plan_to_json(plan: PlannedMotion) -> dict[str, Any]:
    """The content of plan.json; numbers that are not finite (clearance in free space) become None.

    Keys are those of the API, SI unless they say otherwise; joint values of goal and legs are in SI and in deg or mm.
    """
    scenario, robot, drive = plan.scenario, plan.scenario.robot, plan.scenario.robot.drive
    content = {
        "schema_version": SCHEMA_VERSION,
        "ctrplan_version": __version__,
        "scenario": _source(scenario),
        "robot": _source(robot),
        "seed": plan.seed,
        "planner": plan.planner,
        "style": plan.style,
        "clock_s": plan.clock_s,
        "clock_s_by": dict(plan.clock_s_by),
        "work_s": plan.work_s,
        "first_found_s": plan.first_found_s,
        "first_certified_s": plan.first_certified_s,
        "search_ended_by": plan.ended_by,
        "interrupted": plan.interrupted,
        "base": {"position_m": scenario.base_position_m, "R": scenario.base_R},
        "goal": _goal(scenario, scenario.goal),
        "via": [_goal(scenario, goal) for goal in scenario.via],
        "margins": asdict(scenario.margins),
        "cost": asdict(scenario.cost),
        "joints": [{"name": joint.name, "kind": joint.kind, "unit": joint.unit} for joint in drive.joints],
        "legs": [_leg(leg, drive) for leg in plan.legs],
        "certificate": _certificate(plan),
        "follow_the_leader_m": plan.follow_the_leader_m,
        "settling": _settling(plan),
        "uncertainty": None if plan.uncertainty is None else plan.uncertainty.to_json(),
        "compensation": _compensation(plan),
        "reorder": _reorder(plan.reorder),
        "trajectory": _trajectory(plan),
        "notes": plan.notes,
        "warnings": scenario.warnings,
    }
    plain: dict[str, Any] = _plain(content)
    return plain


def write_plan_json(path: str | os.PathLike[str], plan: PlannedMotion) -> None:
    """Write plan.json as UTF-8, a line per key, whole or not at all; as `write_atomically`."""
    content = plan_to_json(plan).items()
    rows = (f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False, allow_nan=False)}" for key, value in content)
    write_atomically(path, "{\n" + ",\n".join(rows) + "\n}\n")


def _source(of: Scenario | Robot) -> dict[str, Any]:
    return {"name": of.name, "path": of.path, "sha256": of.sha256, "sha256_of": of.sha256_of}


def _goal(scenario: Scenario, goal: Goal) -> dict[str, Any]:
    joints = None if goal.joints is None else _joint_values(goal.joints, scenario.robot.drive)
    return {
        "name": goal.name,
        "joints": joints,
        "tip_m": goal.tip_m,
        "tolerance_m": goal.tolerance_m,
        "direction": goal.direction,
        "direction_tolerance_rad": goal.direction_tolerance_rad,
        "line_m": goal.line_m,
    }


def _leg(leg: Leg, drive: Drive) -> dict[str, Any]:
    return {"kind": leg.kind, "start": _joint_values(leg.start, drive), "end": _joint_values(leg.end, drive)}


def _joint_values(q: Array, drive: Drive) -> dict[str, dict[str, float]]:
    """Values by joint name, for example {"rotate inner": {"deg": 90.0, "rad": 1.5707963267948966}}."""
    return {
        joint.name: {joint.unit: float(value) / joint.si_per_unit, SI_UNITS[joint.unit]: float(value)}
        for joint, value in zip(drive.joints, q, strict=True)
    }


def _certificate(plan: PlannedMotion) -> dict[str, Any]:
    """The summary, and the samples as columns of equal length."""
    certificate = plan.certificate
    left_out = ("samples", "settling", "end_states", "spare_m", "walk_again")
    names = [entry.name for entry in fields(certificate) if entry.name not in left_out]
    columns = {entry.name: getattr(certificate.samples, entry.name) for entry in fields(certificate.samples)}
    summary = {name: getattr(certificate, name) for name in names}
    places = {name: _place(plan, getattr(certificate, name)) for name in ("nominal", "closest", "narrowest")}
    targets = [asdict(target) for target in certificate.targets]
    arrival = certificate.arrival and asdict(certificate.arrival)
    return {**summary, **places, "arrival": arrival, "targets": targets, "samples": columns}


def _reorder(report: ReorderReport) -> dict[str, Any]:
    """The figures, and the alternatives where they were looked at, as a report page does."""
    figures = {entry.name: getattr(report, entry.name) for entry in fields(report) if entry.name != "compare"}
    return {**figures, "alternatives": [asdict(way) for way in report.known_alternatives]}


def _place(plan: PlannedMotion, place: Closest | None) -> dict[str, Any] | None:
    """Where the robot comes closest, and when; None in free space."""
    return None if place is None else {**asdict(place), "time_s": place_time_s(plan, place)}


def _settling(plan: PlannedMotion) -> dict[str, Any] | None:
    """The oscillation that ends the plan, if there is one."""
    settling = plan.certificate.settling
    if settling is None:
        return None
    turn = settling.amplitude_rad * settling.turns
    content = {entry.name: getattr(settling, entry.name) for entry in fields(settling) if entry.name != "turns"}
    first_turn = _joint_values(turn, plan.scenario.robot.drive)
    return {**content, "first_turn": first_turn, "duration_s": settling_duration_s(plan)}


def _compensation(plan: PlannedMotion) -> dict[str, Any] | None:
    """What the joints were moved by for the predicted tip to arrive, if that was asked for."""
    if plan.compensation is None:
        return None
    content = {entry.name: getattr(plan.compensation, entry.name) for entry in fields(plan.compensation)}
    return {**content, "correction": _joint_values(plan.compensation.correction, plan.scenario.robot.drive)}


def _trajectory(plan: PlannedMotion) -> dict[str, Any]:
    trajectory = plan.trajectory
    period = trajectory.time_s[1] - trajectory.time_s[0] if len(trajectory.time_s) > 2 else None
    return {
        "duration_s": trajectory.duration_s,
        "stops": trajectory.stops,
        "period_s": period,
        "samples": len(trajectory.time_s),
        "leg_end_s": trajectory.leg_end_s,
    }


def _plain(value: Any) -> Any:
    """`value` in the types of JSON; not a number and infinity become None."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


ENDED_BY_TIME = "The search was ended by the clock: with the same seed, another machine may find another path."


@shown
@dataclass(frozen=True, eq=False)
class Plan(PlannedMotion):
    """A certified motion of the drive from a scenario's start to its goal."""

    @cached_property
    def sha256(self) -> str:
        """Hash of its content: the scenario's, the robot's in it, the legs, and when the trajectory is where."""
        return content_sha256((self.scenario, self.waypoints, self.trajectory.time_s, self.trajectory.position))

    @property
    def arrives(self) -> bool:
        """Whether every target in space is reached within its tolerances, whatever friction was before; else amber."""
        targets = self.certificate.targets
        goals = self.scenario.targets[-len(targets) :]
        arrivals = [*(target.arrival for target in targets[:-1]), self.certificate.arrival]
        reached = zip(goals, arrivals, strict=True)
        return all(goal.tip_m is None or (there is not None and there.keeps(goal)) for goal, there in reached)

    def headline(self) -> str:
        """The scenario, length and duration of the plan, shown where it is printed."""
        legs = f"{len(self.legs)} leg{'s' if len(self.legs) != 1 else ''}"
        valid = "" if self.certificate.valid else ", not certified"
        return f"{self.scenario.name}, {legs} in {self.trajectory.duration_s:.3g} s{valid}"

    def plot(self) -> Figure:
        """The robot in its anatomy at start and goal, errors, joints and margins over time: the picture plan.png."""
        import ctrplan  # pictures are of a package above, and stand in the public names

        return ctrplan.plot(self)

    def show(self, frames: int = 40) -> Any:
        """The moving scene of the report as a plotly figure, for which the model is solved `frames` times."""
        import ctrplan  # pages are of a package above, and stand in the public names

        return ctrplan.show(self, frames=frames)

    def recheck(self) -> Recheck:
        """`certificate.recheck()`, and whether legs and trajectory are the ones that the certificate walked.

        Takes seconds. Raises InputError where the certificate does not know its legs.
        """
        result = self.certificate.recheck()
        certified, drive, played = result.fresh.samples.joints, self.scenario.robot.drive, self.trajectory
        if drive.is_late:
            apart = _late_differences(late_rows(drive, played.time_s, played.position, played.time_s), certified)
        else:
            apart = path_differences(self.waypoints, played.position, certified)
        return replace(result, differences=(*apart, *result.differences))

    def time_of(self, place: Closest) -> float:
        """When [s] the trajectory passes a place of the certificate: `plan.time_of(plan.certificate.closest)`."""
        return place_time_s(self, place)

    def save(
        self, folder: str | os.PathLike[str], formats: Sequence[str] = ("csv", "ros2"), *, report: bool = True
    ) -> Path:
        """Writes what `ctrplan plan` writes: plan.json, the trajectory in these formats, report.html and plan.png.

        All of them or none; the folder is made if need be, and returned. Without `report` there is neither page nor
        picture. Raises CtrplanError where the system refuses.
        """
        import ctrplan  # save_plan is of a package above, and stands in the public names

        return ctrplan.save_plan(self, folder, formats, report=report)

    @classmethod
    def load(
        cls,
        folder: str | os.PathLike[str],
        scenario: str | os.PathLike[str] | None = None,
        overrides: Sequence[str] = (),
    ) -> Plan:
        """The plan that `save` or `ctrplan plan` wrote into a folder; arguments as those of `ctrplan.load_plan`.

        Its figures are those of plan.json; its trajectory is made anew and must be the one in trajectory.csv. Its
        certificate can't be rechecked: ask `ctrplan.verify`. Raises InputError for anything malformed, of another
        scenario or robot, or that does not belong together.
        """
        import ctrplan  # open_plan is of a package above, and stands in the public names

        return ctrplan.open_plan(folder, scenario, overrides)

    def to_json(self) -> dict[str, Any]:
        """The content of plan.json, plain types only; the schema is in docs/plan.schema.json."""
        return plan_to_json(self)


OFF_LATE = 1e-4  # rad or m: the way of a late drive is certified in steps of a degree and a quarter of a mm


def _late_differences(driven: Array, certified: Array) -> tuple[Difference, ...]:
    """How far joints (T, m) [rad, m] that a late drive has are from the path certified, (L, m)."""
    distance = float(distance_from_polyline(driven, certified).max())
    what = "distance of the driven joints from the certified path"
    return (Difference(what, 0.0, distance),) if distance > OFF_LATE else ()
