"""Scenario: a robot, where it stands, where it starts, where it shall go and past what; margins, costs, planner,
clearance grid.

A planner is one file below planning/search/planners/: its name, its settings with their limits, and how OMPL's planner
is made of them. It must grow forwards only, or check every motion in the direction in which it will be driven: an
L-shaped motion driven backwards is another motion.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from msgspec import Meta, Struct, to_builtins
from numpy.typing import ArrayLike

from ctrplan.anatomy.clearance_grid import SignedDistanceField, anatomy_field, field_bounds, shared_spacing_m
from ctrplan.base.arguments import (
    LONGEST_MM,
    PROGRESS,
    Limited,
    Text,
    checked,
    read_plain_fields,
    require,
    require_made,
    rows_of,
)
from ctrplan.base.arrays import (
    MILLIMETRE,
    MM_PER_M,
    ORIGIN,
    Array,
    content_sha256,
    frozen_content,
    numbers,
    read_only,
    unit,
    vector,
)
from ctrplan.base.catalogue import AbstractStruct, Catalogue, guarded
from ctrplan.base.package import shown
from ctrplan.errors import InputError
from ctrplan.robot.robot import Robot, changed, warn_of_doubts
from ctrplan.storage.toml_document import LARGEST_WEIGHT
from ctrplan.storage.toml_faults import first_fault, unit_of

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

    def __post_init__(self) -> None:
        """Raises InputError for settings that no file may have."""
        if fault := first_fault(to_builtins(self), type(self)):
            (key, *_), rule = fault
            raise InputError(rule, key=str(key), value=getattr(self, str(key)), unit=unit_of(str(key)))

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
    guarded(planner, f"planner {name}")
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

    joints: Array | None = None  # (m,) rad or m
    tip_m: Array | None = None  # (3,)
    tolerance_m: float = 1e-3  # on the tip position
    direction: Array | None = None  # (3,) unit vector, anatomy's frame
    direction_tolerance_rad: float | None = None
    line_m: Array | None = None  # (L, 3) corners, the last one tip_m
    name: str = ""
    table: str = "goal"  # of the scenario's file: "goal", or "target.2" for the second [[target]]
    tip_key: str = "tip_mm"  # in that table, or "line_mm.1" for where a line begins

    def __post_init__(self) -> None:
        """Reads its numbers. Raises InputError for a goal that says nowhere, and for what is no place."""
        for name, length in (("joints", None), ("tip_m", 3), ("direction", 3)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, vector(name, getattr(self, name), length))
        read_plain_fields(self)
        require("tolerance_m", self.tolerance_m, Limited(0, 1, "m", above=True))
        if self.line_m is not None:
            line = numbers(self.line_m, "line_m")
            if line.ndim != 2 or line.shape[1] != 3 or len(line) < 2 or not np.isfinite(line).all():
                raise InputError("must be two points or more of three finite coordinates", key="line_m", unit="m")
            object.__setattr__(self, "line_m", read_only(line))
            object.__setattr__(self, "tip_m", read_only(line[-1]))
        if self.joints is None and self.tip_m is None:
            raise InputError("must have one of joints, tip_m and line_m", key="goal")
        if self.direction is not None:
            if not self.direction.any():
                raise InputError("must not be zero", key="direction", value=self.direction)
            object.__setattr__(self, "direction", read_only(unit(self.direction)))

    @property
    def place(self) -> str:
        """What the scenario's file calls the place to be reached: its key, and the value of a tip position."""
        if self.tip_m is None or self.joints is not None:
            return f"{self.table}.joints"
        return f"{self.table}.{self.tip_key} = {[round(float(x), 3) for x in self.tip_m * MM_PER_M]}"


@checked(stability=Limited(0, 1000), max_strain=Limited(0, 1, above=True))
@shown
@dataclass(frozen=True)
class Margins:
    """What every state of a plan keeps: least stability (dimensionless) and largest strain."""

    stability: float = 0.1
    max_strain: float = 0.08

    def __post_init__(self) -> None:
        """Raises InputError for what is no number."""
        read_plain_fields(self)


WEIGHT = Limited(0, LARGEST_WEIGHT)


@checked(
    path=WEIGHT,
    mm_per_rad=Limited(1e-3, 1e5, "mm/rad"),
    error_along=WEIGHT,
    error_goal=WEIGHT,
    max_error_goal_m=Limited(0, LONGEST_MM * MILLIMETRE, "m", above=True),
    stop=WEIGHT,
)
@shown
@dataclass(frozen=True)
class Cost:
    """Weights of a plan's cost in mm: length in joint space, stops, friction error along the path and at the goal."""

    path: float = 1.0
    mm_per_rad: float = 20.0
    error_along: float = 1.0
    error_goal: float = 10.0
    max_error_goal_m: float | None = None  # requirement on the worst-case friction error at the goal
    stop: float = 2.0  # of each leg, at whose end the drive stops

    def __post_init__(self) -> None:
        """Raises InputError for what is no number."""
        read_plain_fields(self)


@shown
@dataclass(frozen=True, eq=False)
class CostTerm:
    """A term of one's own in a plan's cost: `weight` times the integral of a value along the joint length.

    of_states: the values (K,) of joint values (K, m) [rad, m], finite and never negative: a search takes zero for the
    least that a motion may cost. 1 over 1 rad costs `weight` mm, as 1 mm of error_along does. Threads may ask it.
    """

    name: str
    weight: float
    of_states: Callable[[Array], ArrayLike]

    def __post_init__(self) -> None:
        """Raises InputError for what is no term."""
        require("name", self.name, Text())
        require(f"weight of {self.name}", self.weight, WEIGHT)
        require(f"of_states of {self.name}", self.of_states, PROGRESS)


# What is known of friction before a plan: nothing; Section V-A's oscillation released it; there is none; what an
# observer found, which only predictions start from: bounds and clearances are those of every friction state.
StartFriction = Literal["unknown", "oscillated", "released", "observed"]
# Whether whole turns of joints at the start count, as of a homed drive; followed: the shape is known by the way there.
StartTurns = Literal["unknown", "absolute", "followed"]


UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SKEWED = 1e-6  # of a rotation matrix that was written with a few digits


def rotation_matrix(key: str, values: ArrayLike) -> Array:
    """A rotation (3, 3), read-only. Raises InputError for what is none, and for a mirror image."""
    R = numbers(values, key)
    if R.shape != (3, 3) or not np.isfinite(R).all() or np.abs(R @ R.T - np.eye(3)).max() > SKEWED:
        raise InputError("must be a rotation: three rows of length 1 at right angles", key=key)
    if np.linalg.det(R) < 0:
        raise InputError("must be a rotation, this one mirrors: turn one axis round", key=key)
    return read_only(R)


ROWS_AT_ONCE = 16384  # of products by BLAS, which takes threads for more: a search keeps every core busy itself


@shown
@dataclass(frozen=True)
class Registration:
    """How well the robot's base is known in the anatomy's frame: normal errors, alike in all directions."""

    position_sigma_m: float = 0.0  # of each coordinate of the base's origin
    rotation_sigma_rad: float = 0.0  # of a small rotation about each axis through that origin

    def __post_init__(self) -> None:
        """Raises InputError for what is no number."""
        read_plain_fields(self)

    @property
    def is_exact(self) -> bool:
        """Whether nothing is stated."""
        return self.position_sigma_m == 0 and self.rotation_sigma_rad == 0


MADE_OF = {
    "robot": "Robot",
    "margins": "Margins",
    "cost": "Cost",
    "registration": "Registration",
    "planner": "PlannerSettings",
}


@shown
@dataclass(frozen=True, eq=False)
class Scenario:
    """A planning problem; SI units, positions in the anatomy's frame.

    Made in code it is checked as a file would be. What `with_` changes is checked again, what `dataclasses.replace`
    changes is not. Threads may share it; it pickles.
    """

    name: str
    robot: Robot
    start: Array  # (m,) rad or m
    goal: Goal
    base_position_m: Array = ORIGIN  # type: ignore[assignment]  # (3,) of the robot frame's origin
    base_R: Array = UNTURNED  # type: ignore[assignment]  # (3, 3) maps vectors of the robot frame to the anatomy's
    planner: PlannerSettings = None  # type: ignore[assignment]  # never None once made, by default the catalogue's
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
    content: Mapping[str, Any] = field(default_factory=dict)  # of the file after overrides, or of one that says this
    start_state: ObserverState | None = None  # of a robot that was followed to `start`, where friction is "observed"
    terms: tuple[CostTerm, ...] = ()  # of the cost besides, which no file says

    def __post_init__(self) -> None:
        """Reads what was made in code, and checks it as files are checked. Raises InputError."""
        if self.planner is None:
            object.__setattr__(self, "planner", CATALOGUE[DEFAULT]())
        require_made(self, MADE_OF)
        object.__setattr__(self, "terms", rows_of("terms", self.terms, CostTerm))
        names = [term.name for term in self.terms]
        for name in (name for k, name in enumerate(names) if name in names[:k]):
            raise InputError("is the name of two terms", key="terms", value=name)
        object.__setattr__(self, "start", vector("start", self.start))
        object.__setattr__(self, "base_position_m", vector("base_position_m", self.base_position_m, 3))
        object.__setattr__(self, "base_R", rotation_matrix("base_R", self.base_R))
        if not self.content:
            import ctrplan  # files are of a package above, and stand in the public names

            for name, kind in (("anatomy", ctrplan.Anatomy), ("via", Goal)):
                object.__setattr__(self, name, rows_of(name, getattr(self, name), kind))
            if not isinstance(self.goal, Goal):
                raise InputError("must be a ctrplan.Goal", key="goal", value=self.goal)
            read = ctrplan.as_read(self)
            for name in ("content", "warnings", "goal", "via"):
                object.__setattr__(self, name, getattr(read, name))
            warn_of_doubts([text for text in read.warnings if text not in self.robot.warnings])
        object.__setattr__(self, "content", frozen_content(self.content))

    def with_(self, *overrides: str, **changes: Any) -> Scenario:
        """The scenario with fields changed, and keys of its file by `overrides`, "planner.time_s=2"; checked.

        Raises InputError for a field or key that there is not, and as files do.
        """
        made = changed(self, **({"content": {}, "warnings": (), "robot": self.robot.unguided} | changes))
        if not overrides:
            return made
        import ctrplan

        return ctrplan.as_read(made, overrides)

    def to_toml(self) -> str:
        """The text of a scenario file that is read as this scenario, its robot in the table [robot].

        Files of the anatomy are named from the folder of `path`. Raises InputError for what no file says.
        """
        import ctrplan

        return ctrplan.to_toml(self)

    @cached_property
    def sha256_of(self) -> dict[str, str]:
        """Hashes of its contents by what a scenario file calls them; names, the planner and where they came from do not
        count.
        """
        each = {
            **{f"anatomy.{k}": part for k, part in enumerate(self.anatomy, start=1)},
            **{f"fixture.{k}": _of_fixture(fixture) for k, fixture in enumerate(self.fixtures, start=1)},
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

        Elsewhere than at its start friction is unknown, and whole turns do not matter: the robot was followed there.
        """
        if np.array_equal(start, self.start):
            return replace(self, start=start, via=())
        return replace(self, start=start, via=(), start_friction="unknown", start_turns="followed", start_state=None)

    def observed(self, state: ObserverState) -> Scenario:
        """The scenario of a robot that was followed to its start: predictions begin with the histories of `state`.

        Raises InputError where it is of another robot, or stands elsewhere.
        """
        state.check(self.robot.mechanics, *self.robot.drive.collars(self.start))
        return replace(self, start_friction="observed", start_state=state)


def _of_goal(goal: Goal) -> object:
    return (goal.joints, goal.tip_m, goal.tolerance_m, goal.direction, goal.direction_tolerance_rad, goal.line_m)


def _of_fixture(fixture: Fixture) -> object:
    return (
        fixture.shape.kind,
        [np.asarray(each) for each in fixture.shape.content()],
        fixture.margin_m,
        fixture.stays_inside,
    )


MOST_GRIDS = 4  # kept in memory for one robot, of different bases or anatomies
_GRIDS: WeakKeyDictionary[Robot, dict[bytes, SignedDistanceField]] = WeakKeyDictionary()


def anatomy_grid(scenario: Scenario) -> SignedDistanceField | None:
    """The scenario's anatomy as a signed-distance field around the robot's reach, built once; None in free space."""
    if not scenario.anatomy:
        return None
    grids = _GRIDS.setdefault(scenario.robot.unguided, {})
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
