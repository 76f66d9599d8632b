"""What a search of tube designs may choose: tubes of a stock list, ranges of numbers, and tolerances to each."""

from __future__ import annotations

import hashlib
import json
import math
import os
import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from ctrplan.base.arrays import Array
from ctrplan.base.catalogue import code_version
from ctrplan.errors import InputError
from ctrplan.files.design_file import DesignEntry, MadeEntry, ParameterEntry, StockEntry, checked_design
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario
from ctrplan.storage.toml_document import Document, toml_value
from ctrplan.storage.toml_faults import unit_of
from ctrplan.studies.study.kinds.target_set import TARGET_S
from ctrplan.studies.study.points import target_points
from ctrplan.studies.study.sources import Sources
from ctrplan.studies.study.task import KEY_DIGITS, Job, Task
from ctrplan.studies.target_set import cost, dominates

Row = dict[str, Any]  # of the folder's rows.jsonl


@dataclass(frozen=True, eq=False)
class EvaluatedDesign:
    """A design and the row that came of it."""

    design: Design
    row: Row

    @property
    def numbers(self) -> dict[str, Any]:
        """What is known of it."""
        numbers: dict[str, Any] = self.row["numbers"]
        return numbers

    @property
    def is_done(self) -> bool:
        """Whether it has all numbers: it was neither given up nor refused."""
        return bool(self.row["status"] == "done")


@dataclass(eq=False)
class Archive:
    """All designs in the order in which they were proposed."""

    objectives: Sequence[str]
    all: list[EvaluatedDesign] = field(default_factory=list)

    def add(self, looked: EvaluatedDesign) -> None:
        """One more."""
        self.all.append(looked)

    def values(self, looked: EvaluatedDesign) -> dict[str, float]:
        """The objectives of a design that is done."""
        return {name: float(looked.numbers[name]) for name in self.objectives}

    @property
    def front(self) -> list[EvaluatedDesign]:
        """Designs that no other dominates, each once, the best by the first objective first."""
        done = {looked.design.key: looked for looked in reversed(self.all) if looked.is_done}
        known = [(looked, self.values(looked)) for looked in done.values()]
        kept = [looked for looked, own in known if not any(dominates(other, own) for _, other in known)]
        return sorted(kept, key=lambda looked: self._rank(looked))

    def _rank(self, looked: EvaluatedDesign) -> tuple[float, ...]:
        own = self.values(looked)
        return (*(cost(name, own[name]) for name in self.objectives), float(looked.row["index"]))


def judged(objectives: Iterable[str]) -> str:
    """The error that local steps lead down: the robust one where it is asked for."""
    return "robust_mm" if "robust_mm" in objectives else "error_mm"


@dataclass(frozen=True, eq=False)
class DesignDefinition:
    """A search."""

    entry: DesignEntry
    document: Document
    scenario: Scenario  # as in its file, with what every design has otherwise
    space: DesignSpace
    points_mm: Array  # (T, 3) targets
    job: Job

    @property
    def name(self) -> str:
        """The name in the file, else the file's own."""
        return self.entry.name or Path(self.document.file or "design").stem

    @property
    def content(self) -> bytes:
        """What every worker is given once."""
        return pickle.dumps(self.job)

    @property
    def expected_s(self) -> float:
        """Seconds of one core that the search takes at most, roughly."""
        local = self.entry.local.designs * self.entry.local.steps
        return (self.entry.trials + local) * len(self.points_mm) * TARGET_S

    @cached_property
    def base(self) -> str:
        """Hash of what all designs share."""
        content = {
            "version": code_version(),
            "task": dict(self.job.task),
            "start": self.job.sources.digest(self.job.main),
        }
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def task(self, index: int, design: Design, stage: str, front: list[dict[str, float]]) -> Task:
        """What a worker does with a design; `front`: designs that a better one has to match, else it is given up."""
        sides = [
            {"name": side.name, "low": low, "high": high, "is_tolerance": side.is_tolerance}
            for side, low, high in self.space.sides(design)
        ]
        overrides = self.space.overrides(design)
        settings: dict[str, Any] = {"seed": self.entry.seed, "sides": sides, "front": front}
        text = json.dumps([self.base, overrides, settings], sort_keys=True)
        key = hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]
        return Task(index, key, {"stage": stage, **self.space.inputs(design)}, tuple(overrides), settings)

    def goals(self, looked: EvaluatedDesign) -> list[dict[str, Any]]:
        """[goal] for each target: its tip, and the joints that the design was judged by where it is reached."""
        result = json.loads(looked.numbers.get("joints", "[]")) or [None] * len(self.points_mm)
        tips = [{"tip_mm": point, "tolerance_mm": self.job.task["tolerance_mm"]} for point in self.points_mm.tolist()]
        return [tip | ({"joints": own} if own else {}) for tip, own in zip(tips, result, strict=True)]

    def tolerance_costs(self, looked: EvaluatedDesign) -> list[tuple[str, float, str, float]]:
        """Name, half width, unit and cost [mm] of every tolerance of a design, the costliest first."""
        results = [
            (side.name, side.width, side.unit, abs(float(looked.numbers[f"slope.{side.name}"])))
            for side, _, _ in self.space.sides(looked.design)
            if side.is_tolerance
        ]
        return sorted(results, key=lambda row: -row[3])


def defined(document: Document, allow_outside: bool) -> DesignDefinition:
    """The search of a file. Raises InputError, one sentence, for anything malformed or contradictory."""
    entry = checked_design(document)
    folder = Path(document.file or ".").parent
    main = folder / entry.scenario
    if not main.is_file():
        raise document.fault("is not a file that exists", "scenario")
    scenario = load_scenario(main, _assignments(entry.set), allow_outside=allow_outside)
    named = [main.parent / value for value in entry.set.values() if isinstance(value, str)]
    sources = Sources.of([main, *(file for file in named if file.is_file())], folder)
    points = target_points(entry.targets, scenario, document, folder)
    task = {
        "kind": "target_set",
        "points_mm": points.tolist(),
        "tolerance_mm": entry.targets.tolerance_mm or scenario.goal.tolerance_m * 1e3,
        "starts": entry.starts,
        "unreached_mm": entry.unreached_mm,
    }
    job = Job(
        sources=sources,
        main=sources.name(main),
        is_robot=False,
        task=task,
        study_folder=sources.name(folder),
        allow_outside=allow_outside,
    )
    definition = DesignDefinition(entry, document, scenario, DesignSpace(entry, scenario.robot.n), points, job)
    _check(definition, os.fspath(main))
    return definition


def _check(definition: DesignDefinition, main: str) -> None:
    """Raises InputError for keys that there are not: designs at both ends of all ranges are read."""
    count = len(definition.space.names)
    for share in (0.0, 1.0, 0.5):
        overrides = definition.space.overrides(definition.space.design([share] * count))
        load_scenario(main, overrides, allow_outside=definition.job.allow_outside)


DIAMETERS = ("outer_diameter_mm", "inner_diameter_mm")


class StockChoice:
    """Tubes from outermost to innermost, each by a share from 0 to 1 of those that fit, thickest first."""

    def __init__(self, stock: Sequence[StockEntry], made: MadeEntry, tubes: int) -> None:
        """Raises InputError where no `tubes` of the list fit into each other."""
        self.made, self.tubes = made, tubes
        self.stock = sorted(stock, key=lambda tube: (-tube.outer_diameter_mm, -tube.inner_diameter_mm, tube.name))
        self._deepest: dict[str, int] = {}
        if not self._fitting(None, tubes):
            raise InputError(f"has no {tubes} tubes that fit into each other", key="stock")

    def chosen(self, shares: Sequence[float]) -> list[StockEntry]:
        """One tube for each share; whatever the shares are, they nest."""
        results: list[StockEntry] = []
        for k, share in enumerate(shares):
            fitting = self._fitting(results[-1] if results else None, self.tubes - k)
            results.append(fitting[min(int(share * len(fitting)), len(fitting) - 1)])
        return results

    def fits(self, outer: StockEntry, inner: StockEntry) -> bool:
        """Whether one goes into the other, at the ends of their tolerances too."""
        clearance_mm = (outer.inner_diameter_mm - inner.outer_diameter_mm) / 2
        off_mm = (outer.diameter_tolerance_mm + inner.diameter_tolerance_mm) / 2
        return self.made.least_clearance_mm + off_mm <= clearance_mm + 1e-12 <= self.made.most_clearance_mm + 2e-12

    def _fitting(self, outer: StockEntry | None, count: int) -> list[StockEntry]:
        """Entries of the stock that go into `outer` and leave room for count - 1 more."""
        return [tube for tube in self.stock if (outer is None or self.fits(outer, tube)) and self._depth(tube) >= count]

    def _depth(self, outer: StockEntry) -> int:
        """How many tubes there can be from this one inwards."""
        if outer.name not in self._deepest:
            inner = [self._depth(tube) for tube in self.stock if self.fits(outer, tube)]
            self._deepest[outer.name] = 1 + max(inner, default=0)
        return self._deepest[outer.name]


def bending_stiffness_Nm2(outer_diameter_mm: float, inner_diameter_mm: float, youngs_modulus_GPa: float) -> float:
    """E I of a tube [N m^2]."""
    return youngs_modulus_GPa * math.pi / 64 * (outer_diameter_mm**4 - inner_diameter_mm**4) * 1e-3


def tube_keys(stock: StockEntry, i: int, off: dict[str, float]) -> dict[str, float]:
    """What --set is told of tube i (from 1) as made `off` from the stock: diameters [mm], stiffness [%]."""
    outer, inner = (getattr(stock, key) + off.get(key, 0.0) for key in DIAMETERS)
    stiffness = bending_stiffness_Nm2(outer, inner, stock.youngs_modulus_GPa) * (1 + off.get("stiffness", 0.0) / 100)
    stem = f"robot.tube.{i}."
    return {
        f"{stem}outer_diameter_mm": outer,
        f"{stem}inner_diameter_mm": inner,
        f"{stem}bending_stiffness_Nm2": stiffness,
        f"{stem}poisson_ratio": stock.poisson_ratio,
    }


STEP_SHARE = 0.01  # of a range: to either side of a parameter without tolerance, for its derivative
DIGITS = 9
Off = Mapping[str, float]  # offsets by the name of what is off


@dataclass(frozen=True)
class Side:
    """A number of a design that may come out, or is moved, to either side."""

    name: str
    width: float  # to either side, in the unit of the file
    unit: str
    is_tolerance: bool


@dataclass(frozen=True, eq=False)
class Design:
    """A choice."""

    shares: tuple[float, ...]  # of tubes first, then of parameters
    stock: tuple[StockEntry, ...]
    values: tuple[float, ...]  # of parameters, in the units of their keys

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal where designs are."""
        return (*(tube.name for tube in self.stock), *self.values)


class DesignSpace:
    """Stock for each of n tubes, if there is any, and P parameters."""

    def __init__(self, entry: DesignEntry, tubes: int) -> None:
        """Raises InputError where the stock does not nest."""
        self.entry, self.parameters = entry, entry.parameter
        self.choice = StockChoice(entry.stock, entry.made, tubes) if entry.stock else None
        self.tubes = tubes if self.choice else 0

    @property
    def names(self) -> list[str]:
        """Names of all shares."""
        return [*(f"tube {i + 1}" for i in range(self.tubes)), *(name_of(p) for p in self.parameters)]

    @property
    def labels(self) -> list[str]:
        """Names with their units."""
        units = [unit_of(parameter.key) for parameter in self.parameters]
        named = [
            f"{name} ({unit})" if unit else name for name, unit in zip(self.names[self.tubes :], units, strict=True)
        ]
        return [*self.names[: self.tubes], *named]

    def design(self, shares: Sequence[float]) -> Design:
        """The design of shares (tubes + P,), values at what can be made."""
        stock = tuple(self.choice.chosen(shares[: self.tubes])) if self.choice else ()
        pairs = zip(self.parameters, shares[self.tubes :], strict=True)
        return Design(tuple(shares), stock, tuple(_value(parameter, share) for parameter, share in pairs))

    def inputs(self, design: Design) -> dict[str, Any]:
        """Columns of the table."""
        tubes = {f"tube {i}": tube.name for i, tube in enumerate(design.stock, start=1)}
        return {**tubes, **dict(zip(map(name_of, self.parameters), design.values, strict=True))}

    def overrides(self, design: Design) -> list[str]:
        """Everything that --set is told."""
        return [*_assignments(self.entry.set), *_assignments(self._keys(design, {}))]

    def sides(self, design: Design) -> Iterator[tuple[Side, list[str], list[str]]]:
        """Every number that may be off or be moved, and what --set is told of both ends, after all else."""
        own = self._keys(design, {})
        for side in self._widths(design):
            ends = []
            for sign in (-1, 1):
                moved = self._keys(design, {side.name: sign * side.width})
                ends.append(_assignments({key: value for key, value in moved.items() if value != own[key]}))
            yield side, ends[0], ends[1]

    def strain(self, design: Design) -> float:
        """The largest by which a precurvature of the design is set, of those that are parameters."""
        largest = 0.0
        outer = {i: tube.outer_diameter_mm for i, tube in enumerate(design.stock, start=1)}
        for key, value in self._keys(design, {}).items():
            steps = key.split(".")
            if steps[:2] == ["robot", "tube"] and steps[-1].startswith("curvature_") and int(steps[2]) in outer:
                largest = max(largest, abs(value) * outer[int(steps[2])] / 2e3)
        return largest

    def _widths(self, design: Design) -> Iterator[Side]:
        for i, tube in enumerate(design.stock, start=1):
            for key in DIAMETERS if tube.diameter_tolerance_mm else ():
                yield Side(f"tube {i} {key[:5]} diameter", tube.diameter_tolerance_mm, "mm", True)
            if tube.stiffness_tolerance_percent:
                yield Side(f"tube {i} stiffness", tube.stiffness_tolerance_percent, "%", True)
        for parameter, value in zip(self.parameters, design.values, strict=True):
            width = parameter.tolerance or abs(value) * parameter.tolerance_percent / 100
            step = STEP_SHARE * (parameter.high - parameter.low)
            yield Side(name_of(parameter), width or step, unit_of(parameter.key) or "", width > 0)

    def _keys(self, design: Design, off: Off) -> dict[str, float]:
        """Values of all keys that depend on the design."""
        results: dict[str, float] = {}
        for i, tube in enumerate(design.stock, start=1):
            own = {key: off.get(f"tube {i} {key[:5]} diameter", 0.0) for key in DIAMETERS}
            results |= tube_keys(tube, i, {**own, "stiffness": off.get(f"tube {i} stiffness", 0.0)})
        for parameter, value in zip(self.parameters, design.values, strict=True):
            made = value + off.get(name_of(parameter), 0.0)
            results[parameter.key] = made
            results |= {key: rule.times * made + rule.plus for key, rule in parameter.also.items()}
        return {key: round(value, DIGITS + 3) for key, value in results.items()}


def name_of(parameter: ParameterEntry) -> str:
    """What tables call it."""
    return parameter.name or parameter.key.removeprefix("robot.")


def _assignments(keys: Mapping[str, Any]) -> list[str]:
    """What --set is told for keys to have values."""
    return [f"{key}={toml_value(value)}" for key, value in keys.items()]


def _value(parameter: ParameterEntry, share: float) -> float:
    value = parameter.low + share * (parameter.high - parameter.low)
    if parameter.step is not None:
        most = int((parameter.high - parameter.low) / parameter.step + 1e-9)
        value = parameter.low + parameter.step * min(round((value - parameter.low) / parameter.step), most)
    return float(f"{value:.{DIGITS}g}")
