"""A plan's folder -> Plan: the figures of plan.json as objects again, the trajectory made anew and compared."""

from __future__ import annotations

import math
import os
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from ctrplan.certificate.arrival import Arrival
from ctrplan.certificate.certificate import Certificate, CertificateSamples, Settling
from ctrplan.drive.drive import SAME_JOINTS
from ctrplan.drive.trajectory import PERIOD_S, Trajectory, remade_trajectory
from ctrplan.errors import InputError
from ctrplan.files.plan_file import WrittenPlan, load_plan, played_samples
from ctrplan.files.plan_inputs import changed_files, plan_json_of
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import ComparedWay, Compensation, Leg, ReorderReport, leg_kind
from ctrplan.uncertainty.result import Uncertainty

# Names that the dataclasses know while types are checked.
TYPES = {"Accuracy": str, "StartFriction": str, "Arrival": Arrival, "HistoryState": object}
T = TypeVar("T")


def open_plan(
    folder: str | os.PathLike[str], scenario: str | os.PathLike[str] | None = None, overrides: Sequence[str] = ()
) -> Plan:
    """The plan that `save_plan` or `ctrplan plan` wrote into a folder; arguments as those of `ctrplan.load_plan`.

    Its figures are those of plan.json; its trajectory is made anew and must be the one in trajectory.csv. Raises
    InputError for anything malformed, of another scenario or robot, or that does not belong together, and for a
    plan.json that was changed after it was written.
    """
    with plan_json_of(os.fspath(folder)) as file:
        place = Path(file).parent
        written = load_plan(file, scenario, overrides)
        content, drive = written.content, written.scenario.robot.drive
        if fault := changed_files(place).get("plan.json"):
            raise fault
        try:
            return Plan(
                scenario=written.scenario,
                seed=int(content["seed"]),
                planner=content["planner"],
                style=content["style"],
                legs=tuple(Leg(a, b, leg_kind(drive, a, b)) for a, b in pairwise(written.waypoints)),
                certificate=_certificate(written),
                trajectory=_trajectory(written, place / "trajectory.csv"),
                reorder=_reorder(content["reorder"]),
                clock_s=content["clock_s"],
                clock_s_by=content.get("clock_s_by", {}),
                work_s=content["work_s"],
                first_found_s=content["first_found_s"],
                first_certified_s=content["first_certified_s"],
                notes=(*content["notes"], *written.warnings),
                compensation=_compensation(written),
                interrupted=content["interrupted"],
                ended_by=content["search_ended_by"],
                follow_the_leader_m=content["follow_the_leader_m"],
                uncertainty=None if content["uncertainty"] is None else _made(Uncertainty, content["uncertainty"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            rule = f"has no {error.args[0]}" if isinstance(error, KeyError) else f"can't be read as a plan ({error})"
            raise InputError(rule, file=str(place / "plan.json")) from None


def _certificate(written: WrittenPlan) -> Certificate:
    content, settling = written.content["certificate"], written.content["settling"]
    samples = _made(CertificateSamples, content["samples"])
    known = {**content, "settling": None, "walk_again": None, "end_states": [], "samples": None}
    certificate = _made(Certificate, known)
    object.__setattr__(certificate, "samples", samples)
    if settling is not None:
        first_turn = _joint_values(written, settling["first_turn"])
        turns = first_turn / settling["amplitude_rad"]
        object.__setattr__(certificate, "settling", _made(Settling, {**settling, "turns": turns.tolist()}))
    return certificate


def _reorder(content: Mapping[str, Any]) -> ReorderReport:
    ways = tuple(_made(ComparedWay, way) for way in content["alternatives"])
    report = _made(ReorderReport, {**content, "compare": partial(tuple, ways)})
    _ = report.alternatives  # looked at, as when they were written
    return report


def _compensation(written: WrittenPlan) -> Compensation | None:
    content = written.content["compensation"]
    if content is None:
        return None
    return _made(Compensation, {**content, "correction": _joint_values(written, content["correction"]).tolist()})


def _joint_values(written: WrittenPlan, table: Mapping[str, Mapping[str, float]]) -> Any:
    """(m,) rad or m."""
    joints = written.scenario.robot.drive.joints
    return np.array([table[joint.name]["rad" if joint.unit == "deg" else "m"] for joint in joints])


def _trajectory(written: WrittenPlan, file: Path) -> Trajectory:
    """The trajectory of the legs, with the rests at targets. Raises InputError unless the file has the same."""
    drive, content = written.scenario.robot.drive, written.content
    rests = [target["leg"] + 1 for target in content["certificate"]["targets"]]
    period_s = content["trajectory"]["period_s"] or PERIOD_S
    time_s, position = played_samples(file, drive)
    made = remade_trajectory(written.waypoints, drive, period_s, rests, [float(time_s[-1])])
    is_same = len(time_s) == len(made.time_s) and np.abs(time_s - made.time_s).max() <= SAME_JOINTS  # in s
    if not is_same or np.abs(position - made.position).max() > SAME_JOINTS:
        raise InputError("is not the trajectory of the plan's legs: write it again", file=str(file))
    return made


def _made(kind: type[T], content: Mapping[str, Any]) -> T:
    """A dataclass of what JSON holds of it; keys that are none of its fields are left aside."""
    hints = get_type_hints(kind, localns=TYPES)
    values = {}
    for entry in fields(kind):  # type: ignore[arg-type]
        if entry.name in content:
            values[entry.name] = _value(hints[entry.name], content[entry.name], entry.name)
    return kind(**values)


def _value(hint: Any, value: Any, name: str) -> Any:
    """A value of a type; None in the place of a number is one that is not finite."""
    if get_origin(hint) in (Union, types.UnionType):
        others = [kind for kind in get_args(hint) if kind is not type(None)]
        return None if value is None else _value(others[0], value, name)
    if get_origin(hint) is tuple:
        inner = get_args(hint)[0]
        return tuple(_value(inner, item, name) for item in value)
    if is_dataclass(hint):
        return None if value is None else _made(hint, value)  # type: ignore[arg-type]
    if hint is float:
        return _beyond(name) if value is None else float(value)
    if get_origin(hint) is np.ndarray and value is not None:
        kind = np.int_ if "int" in str(hint) else np.float64
        return np.array(_finite(value, name), dtype=kind)
    return value


def _finite(value: Any, name: str) -> Any:
    if isinstance(value, list):
        return [_finite(item, name) for item in value]
    return _beyond(name) if value is None else value


def _beyond(name: str) -> float:
    """The number that JSON has none for: an infinite clearance, or what could not be computed."""
    return math.inf if "clearance" in name or "predicted" in name else math.nan
