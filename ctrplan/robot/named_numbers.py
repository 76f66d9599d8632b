"""Named numbers of a robot, such as tube.2.poisson_ratio: read them and change them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, Literal, Protocol, TypeVar

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Contact, Loads, Tube, TubeSection

MAGNITUDE = "curvature_per_m"  # of a section's precurvature, whose direction stays
TUBE_KEYS = frozenset(field.name for field in fields(Tube)) - {"sections"}
SECTION_KEYS = frozenset(field.name for field in fields(TubeSection))


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
    """Where a named number is: a tube, one of its sections, a contact, or a vector of loads; indices from 0."""

    kind: Literal["tube", "section", "contact", "loads"]
    index: int  # of the tube or the contact; of the component of a load
    key: str
    section: int = -1


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
        if at.kind == "contact":
            of_all = robot.clearance_m if at.key == "clearance_m" else robot.friction[:, 1]
            return float(of_all[at.index])
        return float(getattr(robot.loads, at.key)[at.index])
    except (AttributeError, IndexError, TypeError, ValueError):
        raise _unknown(name) from None


def with_values(robot: R, values: Mapping[str, float]) -> R:
    """A copy of the robot with named numbers changed, SI. Raises InputError for a name the robot does not have."""
    tubes, contacts = list(robot.tubes), list(robot.contacts)
    loads: dict[str, list[float]] = {}
    for name, value in values.items():
        value_of(robot, name)
        at = parsed_name(name)
        if at.kind == "tube":
            changes: dict[str, Any] = {at.key: value}
            tubes[at.index] = replace(tubes[at.index], **changes)
        elif at.kind == "section":
            sections = list(tubes[at.index].sections)
            sections[at.section] = _changed_section(sections[at.section], at.key, value)
            tubes[at.index] = replace(tubes[at.index], sections=tuple(sections))
        elif at.kind == "contact":
            contacts[at.index] = _changed_contact(contacts[at.index], at.key, value)
        else:
            loads.setdefault(at.key, list(getattr(robot.loads, at.key)))[at.index] = value
    changed: dict[str, Any] = {"tubes": tuple(tubes), "contacts": tuple(contacts)}
    if loads:
        vectors: dict[str, Any] = {key: tuple(vector) for key, vector in loads.items()}
        changed["loads"] = replace(robot.loads, **vectors)
    made: R = replace(robot, **changed)  # type: ignore[type-var]
    return made


def _changed_section(section: TubeSection, key: str, value: float) -> TubeSection:
    changes: dict[str, Any] = {key: value}
    if key == MAGNITUDE:
        scale = value / section.curvature_per_m if section.curvature_per_m else 0.0
        changes = {key: scale * getattr(section, key) for key in ("curvature_x_per_m", "curvature_y_per_m")}
    return replace(section, **changes)


def _changed_contact(contact: Contact, key: str, value: float) -> Contact:
    if key == "clearance_m":
        return replace(contact, clearance_m=value)
    return replace(contact, friction_coefficient=(value, value))


def _is_place(text: str) -> bool:
    return text.isdecimal() and int(text) > 0


def _unknown(name: str) -> InputError:
    return InputError("no such parameter of the robot", key=name)
