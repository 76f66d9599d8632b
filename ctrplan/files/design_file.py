"""Design files (TOML): what can be made, what may be chosen, and what a design is to be good at; read strictly."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from ctrplan.files.study_file import Seed, TargetsEntry, check_targets
from ctrplan.storage.toml_document import (
    LARGEST_NUMBER,
    Component,
    Distance,
    Document,
    Length,
    Name,
    Tolerance,
)

Objective = Literal["error_mm", "robust_mm", "reach", "stability", "clearance_mm"]
Key = Annotated[str, Meta(min_length=1, max_length=200)]
Percent = Annotated[float, Meta(ge=0, le=50)]


class StockEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[[stock]]: tube that can be bought. Tolerances are to either side."""

    name: Name
    outer_diameter_mm: Length
    inner_diameter_mm: Distance
    youngs_modulus_GPa: Annotated[float, Meta(gt=0, le=1000)]
    poisson_ratio: Annotated[float, Meta(gt=-0.95, le=0.5)] = 0.3
    diameter_tolerance_mm: Distance = 0.0  # of both diameters
    stiffness_tolerance_percent: Percent = 0.0


class MadeEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[made]: what can be assembled and set."""

    least_clearance_mm: Distance = 0.01  # radial, between neighbours at the ends of their tolerances
    most_clearance_mm: Length = 1.0  # as drawn
    most_strain: Annotated[float, Meta(gt=0, le=1)] = 0.08  # of the outer fibre, by which a precurvature is set


class FollowsEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """What another key becomes: times the parameter, plus."""

    times: Component = 1.0
    plus: Component = 0.0


class ParameterEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[[parameter]]: a number that may be chosen: a key as in --set, of the scenario or of the robot after "robot."."""

    key: Key
    low: Component
    high: Component
    name: Name | None = None
    step: Annotated[float, Meta(gt=0, le=LARGEST_NUMBER)] | None = None  # what can be made: low, low + step, ...
    tolerance: Annotated[float, Meta(ge=0, le=LARGEST_NUMBER)] = 0.0  # to either side
    tolerance_percent: Percent = 0.0
    also: dict[str, FollowsEntry] = {}  # keys that follow it


class LocalEntry(Struct, forbid_unknown_fields=True, frozen=True):
    """[local]: steps down the exact derivatives, after the search, from the best designs by the first objective."""

    designs: Annotated[int, Meta(ge=0, le=1000)] = 3
    steps: Annotated[int, Meta(ge=0, le=1000)] = 6


class DesignEntry(Struct, forbid_unknown_fields=True):
    """A design file."""

    scenario: str
    targets: TargetsEntry
    parameter: Annotated[list[ParameterEntry], Meta(max_length=100)] = []
    name: Name | None = None
    stock: Annotated[list[StockEntry], Meta(max_length=1000)] = []
    made: MadeEntry = MadeEntry()
    set: dict[str, Any] = {}  # keys that every design has otherwise than the files
    objectives: Annotated[list[Objective], Meta(min_length=2)] = field(
        default_factory=lambda: ["error_mm", "reach", "stability"]
    )
    sampler: Literal["tpe", "nsga2", "random"] = "tpe"
    trials: Annotated[int, Meta(ge=1, le=1_000_000)] = 200
    together: Annotated[int, Meta(ge=1, le=10_000)] = 10  # trials that are asked for at a time, whoever does them
    seed: Seed = 0
    starts: Annotated[int, Meta(ge=1, le=100_000)] = 40  # of inverse kinematics, for each target
    unreached_mm: Tolerance = 10.0  # what a target counts that is not reached
    prune: bool = True  # give a design up when one of the front is better whatever its other targets give
    local: LocalEntry = LocalEntry()
    plans: Annotated[int, Meta(ge=0, le=1000)] = 0  # designs from which all targets are planned to, and certified


def checked_design(document: Document) -> DesignEntry:
    """The content of a design file as entries. Raises InputError."""
    entry = document.to(DesignEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    if not entry.parameter and not entry.stock:
        raise document.fault("is missing, or [[stock]]: nothing may be chosen", "parameter")
    check_targets(entry.targets, document)
    if entry.targets.direction is not None:
        raise document.fault("does not go with a design, whose targets are points", "targets", "direction")
    for k in range(len(entry.parameter)):
        _check_parameter(entry, document, k)
    for k, stock in enumerate(entry.stock):
        if not stock.inner_diameter_mm < stock.outer_diameter_mm:
            rule = f"must be below outer_diameter_mm = {stock.outer_diameter_mm:g}"
            raise document.fault(rule, "stock", k, "inner_diameter_mm")
        if any(other.name == stock.name for other in entry.stock[:k]):
            raise document.fault("is there twice", "stock", k, "name")
    if not all(_is_plain(value) for value in entry.set.values()):
        raise document.fault("must be numbers, texts, truth values, lists or tables", "set")
    if len(set(entry.objectives)) < len(entry.objectives):
        raise document.fault("names one twice", "objectives")
    if "robust_mm" in entry.objectives and not has_tolerances(entry):
        raise document.fault("has robust_mm, but nothing has a tolerance", "objectives")
    return entry


def has_tolerances(entry: DesignEntry) -> bool:
    """Whether anything may come out otherwise than designed."""
    of_stock = any(stock.diameter_tolerance_mm or stock.stiffness_tolerance_percent for stock in entry.stock)
    return of_stock or any(parameter.tolerance or parameter.tolerance_percent for parameter in entry.parameter)


def _is_plain(value: Any) -> bool:
    """Whether --set can be told a value."""
    if isinstance(value, dict):
        return all(map(_is_plain, value.values()))
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, (str, int, float, bool))


def _check_parameter(entry: DesignEntry, document: Document, k: int) -> None:
    """Raises InputError unless one [[parameter]] says one thing."""
    parameter = entry.parameter[k]
    if not parameter.low < parameter.high:
        raise document.fault(f"must be below high = {parameter.high:g}", "parameter", k, "low")
    if parameter.step is not None and parameter.step > parameter.high - parameter.low:
        raise document.fault("is wider than from low to high", "parameter", k, "step")
    if parameter.tolerance and parameter.tolerance_percent:
        raise document.fault("does not go with tolerance", "parameter", k, "tolerance_percent")
    for other in entry.parameter[:k]:
        if parameter.key == other.key or (parameter.name or parameter.key) == (other.name or other.key):
            raise document.fault("is there twice", "parameter", k, "key" if parameter.key == other.key else "name")
