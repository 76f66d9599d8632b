"""Named numbers of a robot, such as tube.2.poisson_ratio: read them and change them. Names: `parameters.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Protocol, TypeVar

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.tube import Contact, Loads, Tube, TubeSection

MAGNITUDE = "curvature_per_m"  # of a section's precurvature, whose direction stays


class HasNumbers(Protocol):
    """What has the numbers of a robot; a `Robot`, which may ask for them itself."""

    @property
    def tubes(self) -> tuple[Tube, ...]:
        """Outermost first."""

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Of neighbouring tubes."""

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


def value_of(robot: HasNumbers, name: str) -> float:
    """The number behind a name, SI. Raises InputError for a name the robot does not have."""
    steps = name.split(".")
    try:
        return float(_read(robot, steps))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        raise InputError("no such parameter of the robot", key=name) from None


def with_values(robot: R, values: Mapping[str, float]) -> R:
    """A copy of the robot with named numbers changed, SI. Raises InputError for a name the robot does not have."""
    tubes, contacts = list(robot.tubes), list(robot.contacts)
    loads: dict[str, Any] = {}
    for name, value in values.items():
        value_of(robot, name)
        kind, *steps = name.split(".")
        if kind == "tube":
            tubes[int(steps[0]) - 1] = _with_tube_value(tubes[int(steps[0]) - 1], steps[1:], value)
        elif kind == "contact":
            contacts[int(steps[0]) - 1] = _with_contact_value(contacts[int(steps[0]) - 1], steps[1], value)
        else:
            vector = list(loads.get(steps[0], getattr(robot.loads, steps[0])))
            vector[int(steps[1]) - 1] = value
            loads[steps[0]] = tuple(vector)
    changed: dict[str, Any] = {"tubes": tuple(tubes), "contacts": tuple(contacts)}
    if loads:
        changed["loads"] = replace(robot.loads, **loads)
    made: R = replace(robot, **changed)  # type: ignore[type-var]
    return made


def _read(robot: HasNumbers, steps: list[str]) -> Any:
    kind, place, *rest = steps
    if kind == "loads":
        return getattr(robot.loads, place)[_index(rest[0])]
    index = _index(place)
    if kind == "contact":
        return {"clearance_m": robot.clearance_m[index], "friction_coefficient": robot.friction[index, 1]}[rest[0]]
    owner: Any = {"tube": robot.tubes}[kind][index]
    if rest[0] == "section":
        owner, rest = owner.sections[_index(rest[1])], rest[2:]
        if rest[0] == MAGNITUDE:
            return owner.curvature_per_m
    if rest[0] not in [field.name for field in fields(owner)]:
        raise KeyError(rest[0])
    return getattr(owner, rest[0])


def _index(text: str) -> int:
    index = int(text) - 1
    if index < 0:
        raise IndexError(text)
    return index


def _with_tube_value(tube: Tube, steps: list[str], value: float) -> Tube:
    if steps[0] != "section":
        changes: dict[str, Any] = {steps[0]: value}
        return replace(tube, **changes)
    sections: list[TubeSection] = list(tube.sections)
    section = sections[int(steps[1]) - 1]
    section_changes: dict[str, Any] = {steps[2]: value}
    if steps[2] == MAGNITUDE:
        scale = value / section.curvature_per_m if section.curvature_per_m else 0.0
        section_changes = {key: scale * getattr(section, key) for key in ("curvature_x_per_m", "curvature_y_per_m")}
    sections[int(steps[1]) - 1] = replace(section, **section_changes)
    return replace(tube, sections=tuple(sections))


def _with_contact_value(contact: Contact, key: str, value: float) -> Contact:
    if key == "clearance_m":
        return replace(contact, clearance_m=value)
    return replace(contact, friction_coefficient=(value, value))
