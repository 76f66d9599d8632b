"""Scenario: a robot, where it stands, where it starts, where it shall go and past what; margins, costs, planner,
clearance grid.

A planner is one file below planning/search/planners/: its name, its settings with their limits, and how OMPL's planner
is made of them. It must grow forwards only, or check every motion in the direction in which it will be driven: an
L-shaped motion driven backwards is another motion.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from msgspec import Meta, Struct

from ctrplan.anatomy.anatomy_field import anatomy_field, shared_spacing_m
from ctrplan.anatomy.clearance_grid import SignedDistanceField, field_bounds
from ctrplan.base.arrays import MM_PER_M, Array, content_sha256
from ctrplan.base.catalogue import AbstractStruct, Catalogue
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.robot.robot import Robot

if TYPE_CHECKING:
    from ctrplan.anatomy.fixture import Fixture
    from ctrplan.anatomy.parts import AnatomyPart
    from ctrplan.robot.observer import ObserverState


class PlannerSettings(Struct, metaclass=AbstractStruct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """[planner]: which search runs, for how long, and whether and how the plan ends by slip that releases friction.

    Subclasses give `name` its value, add settings of their own, and make the planner.
    """

    name: str
    time_s: Annotated[float, Meta(gt=0, le=3600)] = 5.0
    settle: Literal["auto", "none", "oscillate"] = "auto"

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


def path_cost_mm(weights: Cost, *, length_mm: float, legs: int, integral_mm: float, left_m: float) -> float:
    """Cost [mm] of `length_mm` of joint length driven in `legs` legs, the drive stopping after each.

    integral_mm: of the released error along the path, see `MotionChecker.price`; left_m: bound and released error at
    every target that is reached, summed.
    """
    cost = weights.path * length_mm + weights.error_along * integral_mm + weights.stop * legs
    return cost + weights.error_goal * left_m * MM_PER_M


@shown
@dataclass(frozen=True, eq=False)
class Goal:
    """Either joint values, or a tip position in the anatomy's frame, possibly with a tip direction.

    With both, the joints are what is planned to, and the tip that they are for is what the plan is judged by.
    With a line, the tip comes from the line's first point, within the tolerance of it all the way.
    """

    joints: Array | None  # (m,) rad or m
    tip_m: Array | None  # (3,)
    tolerance_m: float  # on the tip position
    direction: Array | None = None  # (3,) unit vector, anatomy's frame
    direction_tolerance_rad: float | None = None
    line_m: Array | None = None  # (L, 3) corners, the last one tip_m
    name: str = ""
    table: str = "goal"  # of the scenario's file: "goal", or "target.2" for the second [[target]]
    tip_key: str = "tip_mm"  # in that table, or "line_mm.1" for where a line begins

    @property
    def place(self) -> str:
        """What the scenario's file calls the place to be reached: its key, and the value of a tip position."""
        if self.tip_m is None or self.joints is not None:
            return f"{self.table}.joints"
        return f"{self.table}.{self.tip_key} = {[round(float(x), 3) for x in self.tip_m * MM_PER_M]}"


@dataclass(frozen=True)
class Margins:
    """What every state of a plan keeps: least stability (dimensionless) and largest strain."""

    stability: float = 0.1
    max_strain: float = 0.08


@dataclass(frozen=True)
class Cost:
    """Weights of a plan's cost in mm: length in joint space, stops, friction error along the path and at the goal."""

    path: float = 1.0
    mm_per_rad: float = 20.0
    error_along: float = 1.0
    error_goal: float = 10.0
    max_error_goal_m: float | None = None  # requirement on the worst-case friction error at the goal
    stop: float = 2.0  # of each leg, at whose end the drive stops


# What is known of friction before a plan: nothing; Section V-A's oscillation released it; there is none; what an
# observer found, which only predictions start from: bounds and clearances are those of every friction state.
StartFriction = Literal["unknown", "oscillated", "released", "observed"]
StartTurns = Literal["unknown", "absolute"]  # whether whole turns of joints at the start count, as of a homed drive


ROWS_AT_ONCE = 16384  # of products by BLAS, which takes threads for more: a search keeps every core busy itself


@dataclass(frozen=True)
class Registration:
    """How well the robot's base is known in the anatomy's frame: normal errors, alike in all directions."""

    position_sigma_m: float = 0.0  # of each coordinate of the base's origin
    rotation_sigma_rad: float = 0.0  # of a small rotation about each axis through that origin

    @property
    def is_exact(self) -> bool:
        """Whether nothing is stated."""
        return self.position_sigma_m == 0 and self.rotation_sigma_rad == 0


@shown
@dataclass(frozen=True, eq=False)
class Scenario:
    """A planning problem; SI units, positions in the anatomy's frame."""

    name: str
    robot: Robot
    base_position_m: Array  # (3,) origin of the robot frame
    base_R: Array  # (3, 3) maps vectors of the robot frame to the anatomy's frame
    start: Array  # (m,) rad or m
    goal: Goal
    planner: PlannerSettings
    anatomy: tuple[AnatomyPart, ...] = ()
    fixtures: tuple[Fixture, ...] = ()  # what stands at the base besides the robot
    margins: Margins = Margins()
    cost: Cost = Cost()
    path: str | None = None
    warnings: tuple[str, ...] = ()  # the robot's included
    start_friction: StartFriction = "unknown"
    start_turns: StartTurns = "unknown"
    registration: Registration = Registration()
    via: tuple[Goal, ...] = ()  # goals to reach before `goal`, in this order
    frame: Literal["RAS", "LPS"] | None = None  # of the patient, which the anatomy's frame is; None where not said
    content: Mapping[str, Any] = field(default_factory=dict)  # of the scenario's file after overrides
    start_state: ObserverState | None = None  # of a robot that was followed to `start`, where friction is "observed"

    @cached_property
    def sha256_of(self) -> dict[str, str]:
        """Hashes of its contents by what a scenario file calls them; names, the planner and where they came from do not
        count.
        """
        each = {
            **{f"anatomy.{k}": part for k, part in enumerate(self.anatomy, start=1)},
            **{f"fixture.{k}": _of_fixture(one) for k, one in enumerate(self.fixtures, start=1)},
            "goal": [_of_goal(goal) for goal in self.targets],
            "base": (self.base_position_m, self.base_R, self.registration),
            "start": (self.start, self.start_friction if self.start_state is None else "unknown", self.start_turns),
            "margins": self.margins,
            "cost": self.cost,
        }
        return {"robot": self.robot.sha256, **{key: content_sha256(value) for key, value in each.items()}}

    @cached_property
    def sha256(self) -> str:
        """Hash of its content, as it is, the robot's among it: a scenario that was changed has another one."""
        return content_sha256(self.sha256_of)

    @property
    def targets(self) -> tuple[Goal, ...]:
        """All goals in the order in which they are reached."""
        return (*self.via, self.goal)

    def located(self, points_m: Array) -> Array:
        """Points (..., 3) [m] of the robot's frame in the anatomy's frame."""
        rows = points_m.reshape(-1, 3)
        result = np.empty(rows.shape)
        for k in range(0, len(rows), ROWS_AT_ONCE):
            np.matmul(rows[k : k + ROWS_AT_ONCE], self.base_R.T, out=result[k : k + ROWS_AT_ONCE])
        result += self.base_position_m
        return result.reshape(points_m.shape)

    def stage_from(self, start: Array) -> Scenario:
        """The scenario to its last goal from joints (m,).

        Elsewhere than at its start friction is unknown, and turns count: the robot was followed there.
        """
        if np.array_equal(start, self.start):
            return replace(self, start=start, via=())
        return replace(self, start=start, via=(), start_friction="unknown", start_turns="absolute", start_state=None)

    def observed(self, state: ObserverState) -> Scenario:
        """The scenario of a robot that was followed to its start: predictions begin with the histories of `state`.

        Raises InputError where it is of another robot, or stands elsewhere.
        """
        state.check(self.robot.mechanics, *self.robot.drive.collars(self.start))
        return replace(self, start_friction="observed", start_state=state)


def _of_goal(goal: Goal) -> object:
    return (goal.joints, goal.tip_m, goal.tolerance_m, goal.direction, goal.direction_tolerance_rad, goal.line_m)


def _of_fixture(one: Fixture) -> object:
    return (one.shape.kind, [np.asarray(each) for each in one.shape.content()], one.margin_m, one.stays_inside)


MOST_GRIDS = 4  # kept in memory for one robot, of different bases or anatomies
_GRIDS: WeakKeyDictionary[Robot, dict[bytes, SignedDistanceField]] = WeakKeyDictionary()


def anatomy_grid(scenario: Scenario) -> SignedDistanceField | None:
    """The scenario's anatomy as a signed-distance field around the robot's reach, built once; None in free space."""
    if not scenario.anatomy:
        return None
    grids = _GRIDS.setdefault(scenario.robot, {})
    place = np.append(scenario.base_R.ravel(), scenario.base_position_m)
    key = (
        place.tobytes() + np.array([id(part) for part in scenario.anatomy]).tobytes()
    )  # the grid keeps its parts alive
    if key not in grids:
        reach = max(tube.length_m for tube in scenario.robot.tubes) + scenario.robot.tubes[0].outer_diameter_m
        lower, upper = field_bounds(scenario.anatomy, reach, scenario.base_position_m, scenario.base_R)
        while len(grids) >= MOST_GRIDS:
            del grids[next(iter(grids))]
        grids[key] = anatomy_field(
            scenario.anatomy,
            lower,
            upper,
            shared_spacing_m(scenario.anatomy, reach),
            base_position_m=scenario.base_position_m,
            reach_m=reach,
        )
    return grids[key]
