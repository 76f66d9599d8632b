"""How a figure of the certificate is joined, written, required and shown; the class `Certificate` is the table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

Unit = Literal["", "m", "rad", "mm", "share", "number", "count"]  # "": a field that is no single number
Join = Literal["", "max", "min", "sum", "all", "first", "last", "chain"]
JOINS: dict[Join, Callable[[list[Any]], Any]] = {
    "max": max,
    "min": min,
    "sum": sum,
    "all": all,
    "first": itemgetter(0),
    "last": itemgetter(-1),
    "chain": lambda stages: tuple(chain(*stages)),
}


@dataclass(frozen=True)
class Figure:
    """What plan.json, its schema, the terminal, the page and the audit have to know of a figure of the certificate.

    Its key in plan.json is its name in `Certificate`, whose order is that of every list of figures.
    """

    join: Join  # how the figures of stages make that of the whole motion; "": `joined_certificates` says how
    unit: Unit = ""
    description: str = ""  # in the schema of plan.json
    title: str = ""  # of its row on the page; no row without one
    line: tuple[str, str] = ("", "{}")  # of the terminal: label, and text around the value; a label has one line
    tile: tuple[str, str] = ("", "")  # on the page: a term of reports/words.py, and the text that it explains
    limit: Callable[[Scenario], float | None] | None = None  # what the scenario requires: of a minimum at least that
    claim: str = ""  # the name under which the audit looks for counterexamples

    @property
    def is_minimum(self) -> bool:
        """Whether the limit is a lower one."""
        return self.join == "min"

    def meets(self, value: float, limit: float) -> bool:
        """Whether a value keeps the limit; what is not a number never does."""
        return bool(value >= limit if self.is_minimum else value <= limit)


def figure(*given: Any, **shown: Any) -> dict[str, Figure]:
    """Arguments of a `Figure` as the metadata of a field."""
    return {"figure": Figure(*given, **shown)}
