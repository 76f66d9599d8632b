"""Numbers of a robot by their names: keys of a robot file as people have their numbers, the plain ones that they stand
for, and addresses such as tube.2.poisson_ratio, to read and to change.

Young's modulus with the diameters is the bending stiffness; the shear modulus with the diameters, or the torsional
stiffness itself, stands for Poisson's ratio, which is then EI / GJ - 1 of the two and need not be one of a material; a
radius is the precurvature of an arc that bends towards +x at theta = 0. With order = "inner first" tubes and all lists
by tube begin with the innermost.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal, NamedTuple, Protocol, TypeVar

from ctrplan.base.arguments import no_such_number
from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Contact, Loads, Tube, TubeSection

MAGNITUDE = "curvature_per_m"  # of a section's precurvature, whose direction stays
BENT = ("x_rad", "y_rad")  # of a cell, about the tube's own axes
TUBE_KEYS = frozenset(field.name for field in fields(Tube)) - {"sections"}
SECTION_KEYS = frozenset(field.name for field in fields(TubeSection)) - {"bent"}


class HasNumbers(Protocol):
    """What has the numbers of a robot; a `Robot`, which may ask for them itself."""

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Outermost first."""

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Contacts of neighbouring tubes."""

    @property
    def loads(self) -> Loads:
        """Beyond the tubes' own."""

    @property
    def clearance_m(self) -> Array:
        """(n - 1,) of each pair."""

    @property
    def friction(self) -> Array:
        """(n - 1, 2) lowest and highest coefficient of each pair."""


R = TypeVar("R", bound=HasNumbers)


@dataclass(frozen=True)
class NumberName:
    """Where a named number is: a tube, one of its sections or of their cells, a contact, or a vector of loads; indices
    from 0.
    """

    kind: Literal["tube", "section", "cell", "contact", "loads"]
    index: int  # of the tube or the contact; of the component of a load
    key: str
    section: int = -1
    cell: int = -1


@cache
def parsed_name(name: str) -> NumberName:
    """A name such as tube.2.section.1.curvature_x_per_m, read once. Raises InputError where it names nothing."""
    match name.split("."):
        case ["loads", vector, component] if _is_place(component):
            return NumberName("loads", int(component) - 1, vector)
        case ["contact", index, "clearance_m" | "friction_coefficient" as key] if _is_place(index):
            return NumberName("contact", int(index) - 1, key)
        case ["tube", index, "section", section, key] if _is_place(index) and _is_place(section):
            if key == MAGNITUDE or key in SECTION_KEYS:
                return NumberName("section", int(index) - 1, key, int(section) - 1)
        case ["tube", index, "section", section, "cell", cell, "x_rad" | "y_rad" as key] if (
            _is_place(index) and _is_place(section) and _is_place(cell)
        ):
            return NumberName("cell", int(index) - 1, key, int(section) - 1, int(cell) - 1)
        case ["tube", index, key] if _is_place(index) and key in TUBE_KEYS:
            return NumberName("tube", int(index) - 1, key)
    raise _unknown(name)


def value_of(robot: HasNumbers, name: str) -> float:
    """The number behind a name, SI. Raises InputError for a name the robot does not have."""
    at = parsed_name(name)
    try:
        if at.kind == "tube":
            return float(getattr(robot.tubes[at.index], at.key))
        if at.kind == "section":
            return float(getattr(robot.tubes[at.index].sections[at.section], at.key))
        if at.kind == "cell":
            section = robot.tubes[at.index].sections[at.section]
            if at.cell >= section.cells:
                raise _unknown(name)
            return next((about[BENT.index(at.key)] for cell, *about in section.bent if cell == at.cell + 1), 0.0)
        if at.kind == "contact":
            of_all = robot.clearance_m if at.key == "clearance_m" else robot.friction[:, 1]
            return float(of_all[at.index])
        return float(getattr(robot.loads, at.key)[at.index])
    except (AttributeError, IndexError, TypeError, ValueError):
        raise _unknown(name) from None


def with_values(robot: R, values: Mapping[str, float]) -> R:
    """A copy of the robot with named numbers changed, SI. Raises InputError for a name the robot does not have."""
    tubes, contacts = list(robot.tubes), list(robot.contacts)
    of_tubes: dict[int, dict[str, Any]] = {}
    of_sections: dict[tuple[int, int], list[tuple[NumberName, float]]] = {}
    loads: dict[str, list[float]] = {}
    for name, value in values.items():
        value_of(robot, name)
        at = parsed_name(name)
        if at.kind == "tube":
            of_tubes.setdefault(at.index, {})[at.key] = value
        elif at.kind == "contact":
            contacts[at.index] = _changed_contact(contacts[at.index], at.key, value)
        elif at.kind == "loads":
            loads.setdefault(at.key, list(getattr(robot.loads, at.key)))[at.index] = value
        else:
            of_sections.setdefault((at.index, at.section), []).append((at, value))
    for (index, number), changes in of_sections.items():
        sections = of_tubes.setdefault(index, {}).setdefault("sections", list(tubes[index].sections))
        sections[number] = _changed_section(sections[number], changes)
    for index, change in of_tubes.items():
        if "sections" in change:
            change["sections"] = tuple(change["sections"])
        tubes[index] = replace(tubes[index], **change)
    changed: dict[str, Any] = {"tubes": tuple(tubes), "contacts": tuple(contacts)}
    if loads:
        vectors: dict[str, Any] = {key: tuple(vector) for key, vector in loads.items()}
        changed["loads"] = replace(robot.loads, **vectors)
    made: R = replace(robot, **changed)  # type: ignore[type-var]
    return made


def _changed_section(section: TubeSection, changes: Sequence[tuple[NumberName, float]]) -> TubeSection:
    """The section with its own numbers and those of its cells changed, one after the other.

    A cell that is bent by another angle is a piece of its own from then on, however small that is.
    """
    own, bent = dict[str, Any](), {number: [x, y] for number, x, y in section.bent}
    for at, value in changes:
        if at.kind == "cell":
            bent.setdefault(at.cell + 1, [0.0, 0.0])[BENT.index(at.key)] = value
        elif at.key == MAGNITUDE:
            x, y = (own.get(key, getattr(section, key)) for key in CURVATURES)
            scale = value / math.hypot(x, y) if x or y else 0.0
            own |= dict(zip(CURVATURES, (scale * x, scale * y), strict=True))
        else:
            own[at.key] = value
    if any(at.kind == "cell" for at, _ in changes):
        own["bent"] = tuple((number, x, y) for number, (x, y) in sorted(bent.items()))
    return replace(section, **own)


def _changed_contact(contact: Contact, key: str, value: float) -> Contact:
    if key == "clearance_m":
        return replace(contact, clearance_m=value)
    return replace(contact, friction_coefficient=(value, value))


def _is_place(text: str) -> bool:
    return text.isdecimal() and int(text) > 0


def _unknown(name: str) -> InputError:
    return no_such_number(name, (*TUBE_KEYS, *SECTION_KEYS, MAGNITUDE, "clearance_m", "friction_coefficient"))


BENDING, YOUNG = "bending_stiffness_Nm2", "youngs_modulus_GPa"
POISSON, SHEAR, TORSIONAL = "poisson_ratio", "shear_modulus_GPa", "torsional_stiffness_Nm2"
CURVATURES, RADIUS = ("curvature_x_per_m", "curvature_y_per_m"), "radius_mm"
MOST_RATIO = 0.5  # Poisson's, of a material
PASCAL, DIGITS = 1e9, 12
BY_TUBE = ("effects", "uncertainty", "marker")  # tables that number tubes


class KeyFault(NamedTuple):
    """The rule that a key of a tube or section breaks."""

    rule: str
    key: str


def second_moment_m4(outer_diameter_mm: float, inner_diameter_mm: float) -> float:
    """pi/64 (D^4 - d^4), of a ring's cross section about a diameter."""
    return math.pi / 64 * ((outer_diameter_mm * 1e-3) ** 4 - (inner_diameter_mm * 1e-3) ** 4)


def stiffness_fault(tube: Mapping[str, Any]) -> KeyFault | None:
    """What is wrong with the choice of keys for the two stiffnesses of a tube; None if nothing is."""
    for keys, what in (((BENDING, YOUNG), "the bending stiffness"), ((POISSON, SHEAR, TORSIONAL), "the torsion")):
        given = [key for key in keys if tube.get(key) is not None]
        if len(given) > 1:
            return KeyFault(f"and {given[0]} exclude each other: both say {what}", given[1])
        if not given:
            others = " or ".join(keys[1:])
            return KeyFault(f"is missing: {what} is said by it, or in its place by {others}", keys[0])
    return None


def section_fault(section: Mapping[str, Any]) -> KeyFault | None:
    """What is wrong with the choice of keys for the precurvature of a section; None if nothing is."""
    given = [key for key in CURVATURES if section.get(key) is not None]
    if section.get(RADIUS) is not None:
        return KeyFault(f"and {given[0]} exclude each other: both say how it is bent", RADIUS) if given else None
    if len(given) != 1:
        return None
    missing = next(key for key in CURVATURES if key not in given)
    return KeyFault(f"is missing: say both curvatures, {RADIUS} in their place, or none of a straight section", missing)


def stiffnesses(tube: Mapping[str, Any]) -> tuple[float, float]:
    """Bending stiffness [N m^2] and EI / GJ - 1 of a tube whose keys are in order."""
    moment = second_moment_m4(tube["outer_diameter_mm"], tube["inner_diameter_mm"])
    EI = tube[BENDING] if tube.get(BENDING) is not None else tube[YOUNG] * PASCAL * moment
    if tube.get(POISSON) is not None:
        return EI, tube[POISSON]
    GJ = tube[TORSIONAL] if tube.get(TORSIONAL) is not None else tube[SHEAR] * PASCAL * 2 * moment
    return EI, EI / GJ - 1


def curvatures_per_m(section: Mapping[str, Any]) -> tuple[float, float]:
    """Precurvature about x and y [1/m] of a section whose keys are in order; none of one that says none."""
    if section.get(RADIUS) is not None:
        return 0.0, 1e3 / section[RADIUS]
    x, y = (section.get(key) or 0.0 for key in CURVATURES)
    return x, y


def with_plain_keys(content: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a robot file's content whose tubes have bending stiffness, Poisson's ratio and curvatures."""
    plain: dict[str, Any] = copy.deepcopy(dict(content))
    for tube in plain["tube"]:
        EI, ratio = stiffnesses(tube)
        for key in (YOUNG, SHEAR, TORSIONAL):
            tube.pop(key, None)
        tube[BENDING], tube[POISSON] = _rounded(EI), _rounded(ratio)
        for section in tube["section"]:
            section |= dict(zip(CURVATURES, map(_rounded, curvatures_per_m(section)), strict=True))
            section.pop(RADIUS, None)
    return plain


def outermost_first(content: Mapping[str, Any]) -> tuple[dict[str, Any], KeyFault | None]:
    """The content with the outermost tube first, and what is in the way of that."""
    turned: dict[str, Any] = copy.deepcopy(dict(content))
    if turned.pop("order", "outer first") != "inner first":
        return turned, None
    if numbered := [key for key in BY_TUBE if turned.get(key)]:
        rule = f"does not go with {numbered[0]}, which numbers tubes from the outermost: list that one first"
        return turned, KeyFault(rule, "order")
    lists = [(turned, "tube"), (turned, "contact")]
    lists += [(turned["home"], key) for key in ("theta_deg", "l_mm")] if isinstance(turned.get("home"), dict) else []
    for joint in turned.get("joint") or ():
        moves = joint.get("moves") if isinstance(joint, dict) else None
        lists += [(moves, key) for key in ("theta", "l")] if isinstance(moves, dict) else []
    for table, key in lists:
        if isinstance(table.get(key), list):
            table[key].reverse()
    return turned, None


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
