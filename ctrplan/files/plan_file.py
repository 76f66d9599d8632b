"""plan.json and trajectory.csv -> WrittenPlan: a plan read back by strict rules, whoever wrote it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, defstruct
from msgspec.structs import asdict

from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.certificate.certificate import FIGURES, Closest
from ctrplan.drive.drive import JOINT_ROUNDING, Drive
from ctrplan.drive.legs import SHORTEST, places_on_legs
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import played_columns
from ctrplan.files.plan_inputs import changed_files, plan_json_of, scenario_within
from ctrplan.files.scenario_file import load_scenario
from ctrplan.plans.plan import SCHEMA_VERSION, SI_UNITS, Plan, plan_to_json
from ctrplan.scenario.scenario import Scenario
from ctrplan.scenario.start_branch import standing
from ctrplan.storage.csv_table import LARGEST_FILE_BYTES, CsvTable, file_bytes, file_name
from ctrplan.storage.toml_document import Document

Numbers = list[float | None]  # None: not finite


class SourceEntry(Struct):
    """A file that a plan was made of."""

    sha256: str
    path: str | None = None
    sha256_of: dict[str, str] = {}


class PlanJointEntry(Struct):
    """A joint of the drive."""

    name: str


class LegEntry(Struct):
    """A leg; joint values by name, each in deg or mm and in SI."""

    start: dict[str, dict[str, float]]
    end: dict[str, dict[str, float]]


class SamplesEntry(Struct):
    """Columns of the certificate's samples that are judged."""

    joints: Annotated[list[list[float]], Meta(min_length=1)]
    bound_m: Numbers
    predicted_m: Numbers
    clearance_m: Numbers | None = None
    leg: list[int] | None = None  # these two are read for drives that leave their legs
    path_mm: Numbers | None = None


class TargetEntry(Struct):
    """A target of the plan."""

    leg: Annotated[int, Meta(ge=0)]


class ClosestEntry(Struct):
    """Where the robot comes closest to the anatomy."""

    clearance_m: float
    distance_m: float
    part: str
    tube: Annotated[int, Meta(ge=1)]
    point_m: tuple[float, float, float]
    leg: Annotated[int, Meta(ge=0)]
    path_mm: float
    joints: list[float]
    phi: list[float]


_Claims: Any = defstruct("_Claims", [(key, float | None) for key, figure in FIGURES.items() if figure.claim])


class CertificateEntry(_Claims):  # type: ignore[misc]
    """Claims that are judged, those of the table of figures and these."""

    valid: bool
    worst_predicted_m: float | None
    targets: Annotated[list[TargetEntry], Meta(min_length=1)]
    samples: SamplesEntry
    closest: ClosestEntry | None = None


class CompensationEntry(Struct):
    """What the joints were moved by for the predicted tip to arrive."""

    note: str


class SettlingEntry(Struct):
    """The oscillation that ends a plan."""

    amplitude_rad: float
    first_leg: Annotated[int, Meta(ge=0)]


class TrajectoryEntry(Struct):
    """How the trajectory was sampled."""

    period_s: Annotated[float, Meta(ge=1e-9, le=1e9)] | None


class OriginEntry(Struct, kw_only=True):
    """What a plan.json was made of."""

    scenario: SourceEntry
    robot: SourceEntry


class PlanEntry(OriginEntry, kw_only=True):
    """A plan.json."""

    schema_version: int
    ctrplan_version: str
    joints: list[PlanJointEntry]
    legs: Annotated[list[LegEntry], Meta(min_length=1)]
    certificate: CertificateEntry
    trajectory: TrajectoryEntry
    settling: SettlingEntry | None = None
    compensation: CompensationEntry | None = None


def played_samples(path: str | os.PathLike[str], drive: Drive) -> tuple[Array, Array]:
    """Times (T,) [s] and joint values (T, m) of a trajectory.csv; other columns are not needed.

    Raises InputError, one sentence with row and column, for what is missing, no finite number, or out of order.
    """
    table = CsvTable(file_name(path, "a trajectory.csv"), "trajectory")
    columns = played_columns(drive)
    for name in ("time_s", *columns):
        if name not in table.header:
            raise table.fault("is missing", column=name)
    time_s = table.numbers("time_s")
    for row in (np.flatnonzero(np.diff(time_s) <= 0) + 1).tolist():
        raise table.fault(f"must be later than the row before, {time_s[row - 1]:.9g} s", row, "time_s", time_s[row])
    return time_s, table.columns(columns)


@shown
@dataclass(frozen=True, eq=False)
class WrittenPlan:
    """A plan as it stands in plan.json and trajectory.csv: nothing of it is believed.

    places are (leg + share of it) of the trajectory's samples and of the certificate's samples.
    """

    scenario: Scenario
    content: dict[str, Any]  # of plan.json
    waypoints: Array  # (L + 1, m) joints at the ends of the legs, rad or m
    time_s: Array  # (T,) of the trajectory
    position: Array  # (T, m)
    places: Array  # (T,)
    certified_places: Array  # (K,)
    closest: Closest | None = None  # where the robot is said to come closest to the anatomy, in any friction state
    file: str | None = None
    warnings: tuple[str, ...] = ()  # of files that were changed after they were written

    @classmethod
    def of(cls, plan: Plan) -> WrittenPlan:
        """The plan as it would be written. Raises InputError for legs that nothing could drive."""
        content = json.loads(json.dumps(plan_to_json(plan)))
        return _checked(plan.scenario, content, None, (plan.trajectory.time_s, plan.trajectory.position))

    @property
    def certificate(self) -> dict[str, Any]:
        """What is claimed: the certificate's figures by their keys in plan.json."""
        claimed: dict[str, Any] = self.content["certificate"]
        return claimed

    def column(self, name: str) -> Array:
        """(K,) a column of the certificate's samples; NaN where it has no number."""
        return np.array([np.nan if value is None else value for value in self.certificate["samples"][name]])


def load_plan(
    path: str | os.PathLike[str],
    scenario: str | os.PathLike[str] | Scenario | None = None,
    overrides: Sequence[str] = (),
    *,
    trajectory: str | os.PathLike[str] | None = None,
    allow_outside: bool = False,
) -> WrittenPlan:
    """The plan in a plan.json, in its folder, or in that folder as one .ctrplan file, with its trajectory.csv.

    trajectory: another one. The scenario is one that was read before, that of the file named, the one in inputs.zip
    beside the plan, or else that of the file which the plan names, from here or from the plan's folder; `overrides` are
    those that files were planned with. Raises InputError, one sentence, for what is malformed, of an older version, or
    of another scenario or robot; and for a trajectory that leaves the legs. Files that were changed after they were
    written are told by the plan's `warnings`.
    """
    with plan_json_of(file_name(path, "a plan.json")) as file:
        content = _json_object(file)
        entry = Document(content, file).to(PlanEntry)
        if isinstance(scenario, Scenario):
            result = scenario
        elif scenario is None and (within := scenario_within(Path(file).parent, overrides)) is not None:
            result = within
        else:
            result = load_scenario(scenario or _scenario_file(entry, file), overrides, allow_outside=allow_outside)
        _check_origin(entry, result, file)
        beside = Path(file).parent / "trajectory.csv"
        written = _checked(result, content, file, played_samples(trajectory or beside, result.robot.drive))
        notices = {name: str(fault) for name, fault in changed_files(beside.parent).items()}
        if trajectory is not None:
            notices.pop(beside.name, None)
        return replace(written, warnings=tuple(notices.values()))


def _json_object(file: str) -> dict[str, Any]:
    """The content. Raises InputError unless it is a JSON object of the schema's version."""

    def no_number(name: str) -> float:
        raise InputError(f"holds {name}, all numbers must be finite", file=file)

    try:
        text = file_bytes(file, LARGEST_FILE_BYTES, "JSON", "plan").decode("utf-8-sig")
        content = json.loads(text, parse_constant=no_number)
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text (byte {error.start})", file=file) from None
    except json.JSONDecodeError as error:
        what = "" if file.lower().endswith(".json") else ": a plan.json is meant, which ctrplan plan -o DIR writes"
        raise InputError(f"is no JSON (line {error.lineno}: {error.msg}){what}", file=file) from None
    except (RecursionError, ValueError):  # thousands of brackets, or of digits
        raise InputError("is no JSON that could be read", file=file) from None
    if not isinstance(content, dict) or "schema_version" not in content:
        raise InputError("is no plan: it has no schema_version", file=file)
    version = content["schema_version"]
    if version != SCHEMA_VERSION or isinstance(version, bool):
        rule = f"must be {SCHEMA_VERSION}, the version this ctrplan writes: plan the scenario again"
        raise InputError(rule, file=file, key="schema_version", value=version)
    return content


def _scenario_file(entry: PlanEntry, file: str) -> str:
    """The scenario's file that the plan names. Raises InputError where there is none."""
    named = entry.scenario.path
    for place in [] if named is None else [Path(named), Path(file).parent / named]:
        if place.is_file():
            return str(place)
    which = (
        "name the scenario's file after the plan"
        if named
        else "give the scenario that was planned, load_plan(path, it)"
    )
    rule = f"is not here, nor inputs.zip, which would hold it: {which}"
    raise InputError(rule, file=file, key="scenario.path", value=named)


def check_origin(plan: WrittenPlan) -> None:
    """Raises InputError for a plan that is not of its robot and scenario, in their content, and says what differs."""
    _check_origin(Document(plan.content, plan.file).to(OriginEntry), plan.scenario, plan.file)


def _check_origin(entry: OriginEntry, scenario: Scenario, file: str | None) -> None:
    """Raises InputError for the plan of another scenario or robot."""
    for key, stated, here in (("robot", entry.robot, scenario.robot), ("scenario", entry.scenario, scenario)):
        if stated.sha256 != here.sha256:
            differs = "; ".join(_differing(stated.sha256_of, here.sha256_of, key)) or "nothing says what differs"
            rule = f"is that of another {key} than {here.path or here.name}: {differs}"
            raise InputError(rule, file=file, key=f"{key}.sha256", value=stated.sha256)


def _differing(stated: Mapping[str, str], here: Mapping[str, str], what: str) -> Iterator[str]:
    """What a plan's robot or scenario does not have alike; parts of the anatomy by content, whatever their number."""
    for key, value in here.items():
        if key not in stated or key.startswith("anatomy."):
            if value not in stated.values():
                yield f"{key} is not in the plan's {what}"
        elif stated[key] != value:
            yield f"{key} differs"
    for key, value in stated.items():
        if (key not in here or key.startswith("anatomy.")) and value not in here.values():
            yield f"the plan's {key} is not here"


def _checked(scenario: Scenario, content: dict[str, Any], file: str | None, played: tuple[Array, Array]) -> WrittenPlan:
    """The plan, if legs, samples and trajectory belong together. Raises InputError otherwise."""
    document = Document(content, file)
    entry = document.to(PlanEntry)
    waypoints = _waypoints(entry, scenario, document)
    scenario = scenario if scenario.robot.guide else standing(scenario, waypoints)
    _check_columns(entry, content, waypoints, document)
    certified = np.array(entry.certificate.samples.joints)
    if scenario.robot.drive.is_late:  # its joints leave the legs
        rows = _places_of_legs(entry.certificate.samples, document)
    else:
        rows = places_on_legs(certified, waypoints, file, "certificate.samples.joints")
    places = places_on_legs(played[1], waypoints, file, "trajectory")
    return WrittenPlan(scenario, content, waypoints, *played, places, rows, _closest(entry, scenario, document), file)


def _places_of_legs(samples: SamplesEntry, document: Document) -> Array:
    """(K,) leg number plus share of the way driven on it. Raises InputError where the plan does not say both."""
    for key in ("leg", "path_mm"):
        if len(getattr(samples, key) or ()) != len(samples.joints):
            rule = "must have a value for each sample: the drive follows late, and leaves its legs"
            raise document.fault(rule, "certificate", "samples", key)
    leg, path_mm = np.array(samples.leg), np.array(samples.path_mm, dtype=np.float64)
    places = leg.astype(np.float64)
    for number in np.unique(leg):
        way_mm = path_mm[leg == number] - path_mm[leg == number][0]
        places[leg == number] += way_mm / max(float(way_mm[-1]), SHORTEST)
    return places


def _closest(entry: PlanEntry, scenario: Scenario, document: Document) -> Closest | None:
    """The place. Raises InputError for one that the robot can't be at."""
    closest, robot = entry.certificate.closest, scenario.robot
    if closest is None:
        return None
    for name, count in (("joints", len(robot.drive.joints)), ("phi", robot.n - 1)):
        if len(getattr(closest, name)) != count:
            raise document.fault(f"must be {count} values", "certificate", "closest", name)
    if closest.tube > robot.n:
        raise document.fault(f"must be at most {robot.n}, the robot's tubes", "certificate", "closest", "tube")
    arrays = {name: np.array(getattr(closest, name)) for name in ("point_m", "joints", "phi")}
    return Closest(**{**asdict(closest), **arrays})


def _waypoints(entry: PlanEntry, scenario: Scenario, document: Document) -> Array:
    """(L + 1, m). Raises InputError for legs that do not follow each other from the scenario's start."""
    names, joints = [joint.name for joint in entry.joints], scenario.robot.drive.joints
    if names != list(scenario.robot.drive.names):
        raise document.fault(f"must be the robot's joints, {', '.join(scenario.robot.drive.names)}", "joints")
    units = [(joint.name, joint.unit, joint.si_per_unit) for joint in joints]
    ends = [(_joints(leg.start, units, document, k, "start"), _joints(leg.end, units, document, k, "end"))
            for k, leg in enumerate(entry.legs)]  # fmt: skip
    before = scenario.start
    for k, (start, end) in enumerate(ends):
        if np.abs(start - before).max() > JOINT_ROUNDING:
            where = "the leg before ends" if k else "the scenario starts"
            raise document.fault(f"must be where {where}", "legs", k, "start")
        before = end
    return np.array([ends[0][0], *(end for _, end in ends)])


def _joints(
    given: dict[str, dict[str, float]], units: list[tuple[str, str, float]], document: Document, k: int, end: str
) -> Array:
    values = []
    for name, unit, si_per_unit in units:
        both = given.get(name, {})
        if set(both) != {unit, SI_UNITS[unit]}:
            raise document.fault(f"must have {name!r} in {unit} and in {SI_UNITS[unit]}", "legs", k, end)
        if abs(both[unit] * si_per_unit - both[SI_UNITS[unit]]) > JOINT_ROUNDING:
            rule = f"contradicts itself, {both[unit]:.9g} {unit} is not {both[SI_UNITS[unit]]:.9g} {SI_UNITS[unit]}"
            raise document.fault(rule, "legs", k, end, name)
        values.append(both[SI_UNITS[unit]])
    return np.array(values)


def _check_columns(entry: PlanEntry, content: dict[str, Any], waypoints: Array, document: Document) -> None:
    """Raises InputError for columns of samples of unlike lengths, or rows that are no joint values."""
    columns, count = content["certificate"]["samples"], len(entry.certificate.samples.joints)
    for name, column in columns.items():
        if not isinstance(column, list) or len(column) != count:
            raise document.fault(f"must hold {count} values, one per sample", "certificate", "samples", name)
    for k, row in enumerate(entry.certificate.samples.joints):
        if len(row) != waypoints.shape[1]:
            rule = f"must be {waypoints.shape[1]} values, one per joint"
            raise document.fault(rule, "certificate", "samples", "joints", k)
