"""Robot files (TOML) -> Robot, with the effects of the file at work, and back."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, to_builtins

from ctrplan.base.arrays import ROUNDING_M
from ctrplan.files.robot_tables import (
    ExecutionEntry,
    HomeEntry,
    JointEntry,
    UncertaintyEntry,
    build_drive,
    build_intervals,
)
from ctrplan.measurement.measurements import Marker, SensorNoise
from ctrplan.mechanics.tube import RANGES, SOFTEST_NM2, STIFFEST_NM2, Contact, Tube, TubeSection
from ctrplan.robot.magnitudes import (
    PERCENT_RATIO,
    SLENDER,
    USUAL_OUTER_M,
    bend_readings,
    in_words,
    likely_units,
    robot_doubts,
    summarised,
    tube_doubts,
)
from ctrplan.robot.named_numbers import (
    BENDING,
    CURVATURES,
    MOST_RATIO,
    POISSON,
    RADIUS,
    SHEAR,
    TORSIONAL,
    YOUNG,
    curvatures_per_m,
    outermost_first,
    section_fault,
    stiffness_fault,
    stiffnesses,
)
from ctrplan.robot.robot import Robot, diametral_gap_m, never_nests
from ctrplan.storage.output_folder import write_atomically
from ctrplan.storage.toml_document import (
    LARGEST_NUMBER,
    Distance,
    Document,
    Length,
    Name,
    checked_overrides,
    read_document,
)
from ctrplan.storage.toml_faults import WORD

MOST_TUBES = 12  # the bound visits 2**(n - 1) corners
MOST_MARKERS = 200
LONGEST_TUBE_MM = 5000.0  # beyond these two a value was most likely given in another unit
LARGEST_CURVATURE_PER_M = 1000.0
LARGEST_FRICTION = 2.0
LEAST_RATIO, LARGEST_RATIO = -0.999, RANGES["poisson_ratio"].high  # of EI / GJ - 1
TAKEN_NAMES = ("frictionless", "measured")  # of columns beside those of the tip

Curvature = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]  # narrower below, with a hint

Stiffness = Annotated[float, Meta(ge=SOFTEST_NM2, le=STIFFEST_NM2)]
Modulus = Annotated[float, Meta(ge=1e-6, le=1e4)]


class SectionEntry(Struct, forbid_unknown_fields=True):
    """[[tube.section]], from base to tip."""

    length_mm: Length
    curvature_x_per_m: Curvature | None = None  # both, or radius_mm, or none of a straight section
    curvature_y_per_m: Curvature | None = None
    radius_mm: Annotated[float, Meta(gt=0, le=1e6)] | None = None  # bent towards +x at theta = 0


class TubeEntry(Struct, forbid_unknown_fields=True):
    """[[tube]], outermost first."""

    outer_diameter_mm: Annotated[float, Meta(gt=0, le=1000)]
    inner_diameter_mm: Annotated[float, Meta(ge=0, le=1000)]
    section: Annotated[list[SectionEntry], Meta(min_length=1)]
    bending_stiffness_Nm2: Stiffness | None = None  # or youngs_modulus_GPa
    poisson_ratio: Annotated[float, Meta(gt=-0.999, le=99)] | None = None  # or one of the two below
    youngs_modulus_GPa: Modulus | None = None
    shear_modulus_GPa: Modulus | None = None
    torsional_stiffness_Nm2: Stiffness | None = None
    collar_length_mm: Annotated[float, Meta(ge=0, le=LONGEST_TUBE_MM)] = 0.0
    max_strain: Annotated[float, Meta(gt=0, le=1)] = 0.08
    density_kg_m3: Annotated[float, Meta(ge=0, le=1e5)] = 0.0
    retractable: bool = False


class ContactEntry(Struct, forbid_unknown_fields=True):
    """[[contact]], one per neighbouring pair."""

    # Limits are checked by hand: msgspec 0.22 reads stray memory for a union of a constrained number and a tuple.
    friction_coefficient: float | list[float]
    clearance_mm: Annotated[float, Meta(gt=0, le=1000)] | None = None


class MeasurementEntry(Struct, forbid_unknown_fields=True):
    """[measurement]: standard deviations of each coordinate and of a rotation of the tangent about each axis."""

    position_sigma_mm: Annotated[float, Meta(ge=1e-6, le=1000)]
    tangent_sigma_deg: Annotated[float, Meta(ge=1e-6, le=180)] | None = None  # of a tracker of positions alone


class MarkerEntry(Struct, forbid_unknown_fields=True):
    """[[marker]]: a point of the body whose position is measured, by its distance along a tube from one of its ends."""

    name: Annotated[str, Meta(pattern=WORD)]
    tube: Annotated[int, Meta(ge=1, le=MOST_TUBES)]
    from_tip_mm: Distance | None = None
    from_base_mm: Distance | None = None
    position_sigma_mm: Annotated[float, Meta(ge=1e-6, le=1000)] | None = None


class RobotEntry(Struct, forbid_unknown_fields=True):
    """A robot file."""

    tube: Annotated[list[TubeEntry], Meta(min_length=1, max_length=MOST_TUBES)]
    name: Name | None = None
    order: Literal["outer first", "inner first"] = "outer first"
    contact: list[ContactEntry] = []
    home: HomeEntry | None = None
    joint: Annotated[list[JointEntry], Meta(min_length=1)] | None = None
    execution: ExecutionEntry | None = None
    model_error_mm: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    friction_memory: Annotated[float, Meta(ge=0, le=1)] = 0.0
    measurement: MeasurementEntry | None = None
    marker: Annotated[list[MarkerEntry], Meta(max_length=MOST_MARKERS)] = []
    uncertainty: UncertaintyEntry | None = None
    effects: dict[str, Any] = {}
    provenance: dict[str, Any] = {}  # where calibrated values come from


def build_tubes(entry: RobotEntry, document: Document) -> tuple[Tube, ...]:
    """Tubes of the file. Raises InputError for values no tube can have and for tubes that don't fit together."""
    tubes = tuple(_tube(tube, i, document) for i, tube in enumerate(entry.tube))
    if _is_innermost_first(tubes):
        rule = (
            'fit into each other from the last to the first: list the outermost first, or write order = "inner first"'
        )
        raise document.fault(rule, "tube")
    for i in range(1, len(tubes)):
        _check_fit(tubes[i - 1], tubes[i], i, document)
    return tubes


def build_contacts(entry: RobotEntry, document: Document) -> tuple[Contact, ...]:
    """Contacts of the file. Raises InputError unless there is one per neighbouring pair of tubes."""
    pairs, given = len(entry.tube) - 1, len(entry.contact)
    if given != pairs:
        rule = f"must be given once per neighbouring pair of tubes, {pairs} in all, not {given}"
        raise document.fault(rule, "contact")
    return tuple(_contact(contact, i, document) for i, contact in enumerate(entry.contact))


def build_markers(entry: RobotEntry, document: Document) -> tuple[Marker, ...]:
    """Markers of the file. Raises InputError for one that is nowhere on its tube and for names given twice."""
    names = [marker.name for marker in entry.marker]
    for k, name in enumerate(names):
        if name in names[:k]:
            raise document.fault("is the name of another marker", "marker", k, "name")
        if name in TAKEN_NAMES:
            raise document.fault("is a word of other columns of poses", "marker", k, "name")
    return tuple(_marker(marker, k, entry, document) for k, marker in enumerate(entry.marker))


def _marker(entry: MarkerEntry, k: int, robot: RobotEntry, document: Document) -> Marker:
    if entry.tube > len(robot.tube):
        raise document.fault(f"must be one of the {len(robot.tube)} tubes", "marker", k, "tube")
    if (entry.from_tip_mm is None) == (entry.from_base_mm is None):
        raise document.fault("must have from_tip_mm or from_base_mm, one of them", "marker", k)
    key = "from_tip_mm" if entry.from_base_mm is None else "from_base_mm"
    length_mm, at_mm = sum(s.length_mm for s in robot.tube[entry.tube - 1].section), getattr(entry, key)
    if at_mm > length_mm:
        raise document.fault(f"must be within the tube, which is {length_mm:g} mm long", "marker", k, key)
    sigma = entry.position_sigma_mm
    if sigma is not None and robot.measurement is None:
        rule = "needs the noise of the tip beside it, position_sigma_mm of [measurement]"
        raise document.fault(rule, "marker", k, "position_sigma_mm")
    end: Literal["tip", "base"] = "tip" if key == "from_tip_mm" else "base"
    return Marker(entry.name, entry.tube, at_mm * 1e-3, end, None if sigma is None else sigma * 1e-3)


def _tube(entry: TubeEntry, i: int, document: Document) -> Tube:
    given = to_builtins(entry)
    if fault := stiffness_fault(given):
        raise document.fault(fault.rule, "tube", i, fault.key)
    if not entry.inner_diameter_mm < entry.outer_diameter_mm:
        rule = f"must be smaller than outer_diameter_mm = {entry.outer_diameter_mm:g} mm"
        raise document.fault(rule, "tube", i, "inner_diameter_mm")
    EI, ratio = stiffnesses(given)
    _check_stiffnesses(entry, EI, ratio, i, document)
    sections = tuple(_section(section, i, k, document) for k, section in enumerate(entry.section))
    tube = Tube(
        outer_diameter_m=entry.outer_diameter_mm * 1e-3,
        inner_diameter_m=entry.inner_diameter_mm * 1e-3,
        bending_stiffness_Nm2=EI,
        poisson_ratio=ratio,
        sections=sections,
        collar_length_m=entry.collar_length_mm * 1e-3,
        max_strain=entry.max_strain,
        density_kg_m3=entry.density_kg_m3,
        retractable=entry.retractable,
    )
    for k, section in enumerate(sections):
        if section.curvature_per_m * tube.outer_diameter_m / 2 >= 1:
            bend = f"bends by a radius of {1e3 / section.curvature_per_m:.3g} mm"
            readings = bend_readings(tube, section)[entry.section[k].radius_mm is not None]
            hint = f": is it {' or '.join(readings)}?" if readings else ""
            rule = f"{bend}, must be more than the tube's own outer radius{hint}"
            raise document.fault(rule, "tube", i, "section", k)
    if tube.length_m * 1e3 > LONGEST_TUBE_MM:
        rule = f"sections add up to {tube.length_m * 1e3:g} mm, must be at most 5000 mm, are they in millimetres?"
        raise document.fault(rule, "tube", i)
    return tube


def _check_stiffnesses(entry: TubeEntry, EI: float, ratio: float, i: int, document: Document) -> None:
    """Raises InputError for a Poisson's ratio or stiffnesses that go beyond what the model takes."""
    if not SOFTEST_NM2 <= EI <= STIFFEST_NM2:
        rule = f"makes a bending stiffness of {EI:.3g} N m^2, must be from {SOFTEST_NM2:g} to {STIFFEST_NM2:g}"
        if units := likely_units(entry.outer_diameter_mm * 1e-3, "mm", *USUAL_OUTER_M):
            rule += f": are the diameters in {in_words(units)}?"
        raise document.fault(rule, "tube", i, YOUNG)
    if not LEAST_RATIO < ratio <= LARGEST_RATIO:
        given = (TORSIONAL, entry.torsional_stiffness_Nm2), (SHEAR, entry.shear_modulus_GPa)
        key = next((name for name, value in given if value is not None), POISSON)
        rule = f"makes EI / GJ = {ratio + 1:.3g}, must be above {LEAST_RATIO + 1:.3g} and at most {LARGEST_RATIO + 1:g}"
        raise document.fault(rule, "tube", i, key)


def _section(entry: SectionEntry, i: int, k: int, document: Document) -> TubeSection:
    given = to_builtins(entry)
    if fault := section_fault(given):
        raise document.fault(fault.rule, "tube", i, "section", k, fault.key)
    if entry.length_mm > LONGEST_TUBE_MM:
        rule = "must be at most 5000 mm, is it in millimetres?"
        raise document.fault(rule, "tube", i, "section", k, "length_mm")
    for key in ("curvature_x_per_m", "curvature_y_per_m"):
        if abs(getattr(entry, key) or 0.0) > LARGEST_CURVATURE_PER_M:
            rule = "must be within -1000 to 1000 1/m, is it per metre?"
            raise document.fault(rule, "tube", i, "section", k, key)
    return TubeSection(entry.length_mm * 1e-3, *curvatures_per_m(given))


def _is_innermost_first(tubes: Sequence[Tube]) -> bool:
    """Whether every tube goes around the one before it, which none does of tubes that are listed outermost first."""
    pairs = list(zip(tubes[:-1], tubes[1:], strict=True))
    return bool(pairs) and all(inner.outer_diameter_m < outer.inner_diameter_m for inner, outer in pairs)


def _check_fit(outer: Tube, inner: Tube, i: int, document: Document) -> None:
    """`inner` is tube i (from 0)."""
    if not inner.outer_diameter_m < outer.inner_diameter_m:
        rule = f"must be smaller than tube.{i}.inner_diameter_mm = {outer.inner_diameter_m * 1e3:g} mm"
        raise document.fault(rule, "tube", i, "outer_diameter_mm")
    needed = outer.length_m + inner.collar_length_m
    if inner.length_m < needed - ROUNDING_M and not inner.retractable:
        rule = (
            f"sections add up to {inner.length_m * 1e3:g} mm, must be at least {needed * 1e3:g} mm: the length of "
            f"tube {i} ({outer.length_m * 1e3:g} mm) and this tube's collar ({inner.collar_length_m * 1e3:g} mm)"
        )
        if inner.length_m < SLENDER * inner.outer_diameter_m:
            units = likely_units(inner.length_m, "mm", needed, LONGEST_TUBE_MM * 1e-3)
            rule += f": are they in {in_words(units)}?" if units else ""
        raise document.fault(rule, "tube", i)


def _contact(entry: ContactEntry, i: int, document: Document) -> Contact:
    friction = entry.friction_coefficient
    interval = friction if isinstance(friction, list) else [friction, friction]
    if len(interval) != 2 or not 0 <= interval[0] <= interval[1] <= LARGEST_FRICTION:
        rule = "must be a number from 0 to 2, or an interval [low, high] within 0 to 2 with low <= high"
        rule += ": is it in %?" if len(interval) == 2 and LARGEST_FRICTION < max(interval) <= 100 else ""
        raise document.fault(rule, "contact", i, "friction_coefficient")
    clearance_m = None if entry.clearance_mm is None else entry.clearance_mm * 1e-3
    return Contact((interval[0], interval[1]), clearance_m)


LARGEST_CLEARANCE_RATIO = 0.02  # of the smallest radius of curvature (Ha et al. 2019, section I)
SMALLEST_CLEARANCE_M = 5e-6  # the meshes do not resolve the contact forces of smaller ones (docs/model.md)
DRAWN_M = 0.05e-3  # of diameters in drawings and tables


ROBOT_PREFIX = "robot."  # of overrides of a scenario that are for its robot's file


def of_robot(overrides: Sequence[str]) -> list[str]:
    """Overrides of a robot file, whose keys may be written as those of a scenario's robot are."""
    return [override.lstrip().removeprefix(ROBOT_PREFIX) for override in checked_overrides(overrides)]


def load_robot(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Robot:
    """The robot of a TOML file after `overrides` such as "tube.2.poisson_ratio=0.28".

    Raises InputError, one sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    return _build(read_document(path, of_robot(overrides)))


def robot_from_dict(content: Mapping[str, Any], *, file: str | None = None, overrides: Sequence[str] = ()) -> Robot:
    """The robot of a robot file's content, keys and units as in the file; `file` is what errors call it."""
    return _build(Document.of(content, "robot", file).with_overrides(overrides))


def _build(document: Document) -> Robot:
    entry = document.to(RobotEntry)
    if entry.order != "outer first":
        content, fault = outermost_first(document.content)
        if fault is not None:
            raise document.fault(fault.rule, fault.key)
        document = Document(content, document.file)
        entry = document.to(RobotEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    for effect, terms in entry.effects.items():
        if not isinstance(terms, dict):
            raise document.fault("must be a table", "effects", effect)
    tubes = build_tubes(entry, document)
    robot = Robot(
        name=entry.name or (Path(document.file).stem if document.file else "robot"),
        tubes=tubes,
        contacts=build_contacts(entry, document),
        drive=build_drive(entry.home or HomeEntry(), entry.joint, entry.execution or ExecutionEntry(), tubes, document),
        model_error_m=entry.model_error_mm * 1e-3,
        friction_memory=entry.friction_memory,
        measurement=_measurement(entry.measurement),
        markers=build_markers(entry, document),
        effects=entry.effects,
        provenance=entry.provenance,
        content=document.content,
        path=document.file,
    )
    if violation := never_nests(robot):
        for doubt in tube_doubts(robot):  # lengths in metres beside those in millimetres
            is_length = len(doubt.key) == 2 or doubt.key[-1] in ("length_mm", "collar_length_mm")
            if is_length and (key := _key_in_file(doubt.key, document)):
                raise document.fault(f"{doubt.rule} No joint values nest the tubes", *key)
        raise document.fault(f"no joint values within limits nest the tubes, at home {violation}", "home", "l_mm")
    intervals = build_intervals(entry.uncertainty, robot, document)
    doubts = doubtful_numbers(robot, document)
    in_doubt = summarised(doubts, f"ctrplan check {document.file or 'ROBOT.toml'}")
    other = [text for text in _clearance_warnings(robot, document) if not _is_doubted(text, doubts)]
    warnings = (*in_doubt, *_ratio_warnings(entry, document), *other)
    robot = replace(robot, intervals=intervals, warnings=warnings)
    if not robot.effects:
        return robot
    from ctrplan.pipeline.chain import (
        check_effects,
        installed,  # slow to import; most robots have no effects
    )

    check_effects(robot, document)
    return installed(robot)


def _measurement(entry: MeasurementEntry | None) -> SensorNoise | None:
    if entry is None:
        return None
    degrees = entry.tangent_sigma_deg
    return SensorNoise(entry.position_sigma_mm * 1e-3, None if degrees is None else math.radians(degrees))


def doubtful_numbers(robot: Robot, document: Document) -> list[str]:
    """A sentence for each number of a robot's file that is most likely in another unit."""
    sentences = []
    for doubt in robot_doubts(robot):
        key = _key_in_file(doubt.key, document)
        if key is None:
            continue
        rule = doubt.otherwise if key[-1] in (YOUNG, SHEAR, RADIUS) and doubt.otherwise else doubt.rule
        sentences += [str(document.fault(rule, *key))] if rule else []
    return sentences


def _key_in_file(key: tuple[str | int, ...], document: Document) -> tuple[str | int, ...] | None:
    """The key of a doubt as the file has it, which may say a stiffness or a bend in another way; None where it leaves
    the table to ctrplan, as it may [home].
    """
    table: Any = document.content
    for step in key if isinstance(key[-1], int) else key[:-1]:
        if isinstance(step, str) and step not in table:
            return None
        table = table[step]
    for plain, others in ((BENDING, (YOUNG,)), (POISSON, (SHEAR, TORSIONAL))):
        if key[-1] == plain and plain not in table:
            return (*key[:-1], next(name for name in others if name in table))
    if len(key) == 4 and key[2] == "section":
        bent = max(CURVATURES, key=lambda name: abs(table.get(name) or 0.0))
        return (*key, RADIUS if RADIUS in table else bent)
    return key


def _ratio_warnings(entry: RobotEntry, document: Document) -> Iterator[str]:
    for i, tube in enumerate(entry.tube):
        given = tube.poisson_ratio
        if given is not None and given > MOST_RATIO and not PERCENT_RATIO[0] <= given <= PERCENT_RATIO[1]:
            EI, ratio = stiffnesses(to_builtins(tube))
            rule = (
                f"is above {MOST_RATIO}, which no material is: of stiffnesses that were fitted apart, say "
                f"{TORSIONAL} = {EI / (1 + ratio):.6g} in its place"
            )
            yield str(document.fault(rule, "tube", i, "poisson_ratio"))


def _is_doubted(warning: str, doubts: Sequence[str]) -> bool:
    """Whether a warning of a contact repeats what is in doubt of it."""
    place, _, _ = warning.partition(": radial clearance")
    return any(doubt.startswith(f"{place}.clearance_mm") for doubt in doubts)


def _clearance_warnings(robot: Robot, document: Document) -> Iterator[str]:
    for i, clearance in enumerate(robot.clearance_m.tolist()):
        shown, gap = f"radial clearance {clearance * 1e3:g} mm", diametral_gap_m(robot.tubes, i)
        if abs(clearance - gap) > DRAWN_M + ROUNDING_M:
            yield str(document.fault(f"{shown} is used, but the diameters leave {gap * 1e3:g} mm", "contact", i))
        if clearance < SMALLEST_CLEARANCE_M:
            rule = f"{shown} is below {SMALLEST_CLEARANCE_M * 1e3:g} mm, bounds may be off by a quarter and more"
            yield str(document.fault(rule, "contact", i))
        curvature = max(section.curvature_per_m for tube in robot.tubes[i : i + 2] for section in tube.sections)
        if clearance * curvature > LARGEST_CLEARANCE_RATIO:
            radius = f"the smallest radius of curvature ({1e3 / curvature:g} mm)"
            rule = f"{shown} is above 2 % of {radius}, the model is less accurate there"
            yield str(document.fault(rule, "contact", i))


def write_robot(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Writes a robot file, whole or not at all, after checking that it can be read again."""
    import tomli_w  # only to write

    robot_from_dict(content, file=os.fspath(path))
    write_atomically(path, tomli_w.dumps(content))
