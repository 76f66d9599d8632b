"""What a planner says about itself, and the catalogue of planners.

A planner is one file below planning/search/planners/: its name, its settings with their limits, and how OMPL's planner
is made of them. It must grow forwards only, or check every motion in the direction in which it will be driven: an
L-shaped motion driven backwards is another motion.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, Literal, TypeVar

from msgspec import Meta, Struct

from ctrplan.base.catalogue import AbstractStruct, Catalogue
from ctrplan.errors import InputError


class PlannerSettings(Struct, metaclass=AbstractStruct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[planner]: which search runs, for how long, and whether the plan ends with an oscillation that releases friction.

    Subclasses give `name` its value, add settings of their own, and make the planner.
    """

    name: str
    time_s: Annotated[float, Meta(gt=0, le=3600)] = 5.0
    settle: Literal["none", "oscillate"] = "none"

    @abstractmethod
    def ompl_planner(self, information: Any) -> Any:
        """A new OMPL planner with these settings, over an `ompl.base.SpaceInformation` whose distances are in mm.

        One that has a `bestCost` is run until time is up, any other until its first path.
        """


CATALOGUE: Catalogue[type[PlannerSettings]] = Catalogue("planner", "ctrplan.planning.search.planners")
DEFAULT = "BIT*"  # where a scenario names none
P = TypeVar("P", bound=type[PlannerSettings])


def register(planner: P) -> P:
    """Adds a planner to the catalogue. Raises InputError where it lacks something, or has another's name."""
    CATALOGUE.require(planner, ())
    try:
        name = planner().name  # type: ignore[call-arg]  # every setting has a default
    except TypeError as error:
        raise InputError(f"{planner.__name__} lacks a default: {error}") from error
    CATALOGUE.add(name, planner, planner.__module__)
    return planner
