"""Robot: tubes, contacts and drive as one object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arguments import read_plain_fields, refuse_idle, require_made, rows_of
from ctrplan.base.arrays import ROUNDING_M, Array, content_sha256, frozen_content, numbers, read_only, warn_of_degrees
from ctrplan.base.package import shown, warn_caller
from ctrplan.drive.drive import Drive
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Marker, SensorNoise
from ctrplan.mechanics.tube import Contact, Loads, Tube, farthest_m, least_distance_m, nesting_inequalities

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from matplotlib.figure import Figure

    from ctrplan.base.long_work import Progress
    from ctrplan.mechanics.core import Mechanics
    from ctrplan.mechanics.equilibria import Equilibria
    from ctrplan.mechanics.guide import Guide
    from ctrplan.mechanics.history import History, Start, Walker
    from ctrplan.mechanics.shapes import Accuracy, Bound, Bounds, HistoryOptions, Shape
    from ctrplan.robot.observer import Observer
    from ctrplan.robot.slow_states import SlowOffset, SlowParameter

# Keys of a robot file whose numbers may have an interval -> their names and SI values of their units.
# `curvature_per_m` is the magnitude of a section's precurvature, whose direction stays.
KEYS = {
    "bending_stiffness_Nm2": ("bending_stiffness_Nm2", 1.0),
    "poisson_ratio": ("poisson_ratio", 1.0),
    "curvature_per_m": ("curvature_per_m", 1.0),
    "curvature_x_per_m": ("curvature_x_per_m", 1.0),
    "curvature_y_per_m": ("curvature_y_per_m", 1.0),
    "length_mm": ("length_m", 1e-3),
    "clearance_mm": ("clearance_m", 1e-3),
    "friction_coefficient": ("friction_coefficient", 1.0),
}


@shown
@dataclass(frozen=True, eq=False)
class StatedIntervals:
    """What [uncertainty] says, by names of `named_numbers.py`; of effects it stands in [effects.NAME] ci95."""

    ci95: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # SI, of the file's own numbers
    correlated: tuple[str, ...] = ()  # Q names, the file's own numbers or parameters of effects
    correlation: Array | None = None  # (Q, Q) of their errors


def file_key(name: str, value: float) -> tuple[str, float]:
    """What a robot file calls a named number, and the value [SI] in the file's unit."""
    stem, last = name.rsplit(".", 1)
    key, si = next((key, si) for key, (known, si) in KEYS.items() if known == last)
    return f"{stem}.{key}", value / si


def nesting_violation(robot: Robot, theta_b: ArrayLike, l_b: ArrayLike) -> str | None:
    """Sentence about the first nesting rule that collar coordinates (n,) [rad], (n,) [m] violate; None if they nest.

    Raises InputError for arrays of another shape. Rotations never violate nesting.
    """
    l = numbers(l_b, "l_b")  # noqa: E741
    for key, shape in (("theta_b", np.shape(theta_b)), ("l_b", l.shape)):
        if shape != (robot.n,):
            raise InputError(f"must have one value per tube, shape ({robot.n},), not {shape}", key=key)
    G, h = nesting_inequalities(robot.tubes)
    broken = np.flatnonzero(~(G @ l <= h + ROUNDING_M))
    return nesting_sentence(robot, int(broken[0]), l) if broken.size else None


def never_nests(robot: Robot) -> str | None:
    """Sentence about a nesting rule that no joint values within limits satisfy, if one is found."""
    G, h = nesting_inequalities(robot.tubes)
    drive, moved = robot.drive, ~robot.drive.is_rotation
    slope = (G @ drive.matrix_l)[:, moved]
    at_lower, at_upper = slope * drive.lower[moved], slope * drive.upper[moved]
    least = G @ drive.home_l_m + np.minimum(at_lower, at_upper).sum(axis=1)
    broken = np.flatnonzero(least > h + ROUNDING_M)
    return nesting_sentence(robot, int(broken[0]), drive.home_l_m) if broken.size else None


def nesting_sentence(robot: Robot, row: int, l_b: Array) -> str:
    """What is wrong in a row of `nesting_inequalities` at base translations (n,) [m]."""
    if row == 0:
        return f"{_base(robot, 0, l_b)} must be at or behind the plate, l_1b <= 0"
    i = (row - 1) % (robot.n - 1)
    bases = f"{_base(robot, i + 1, l_b)} and {_base(robot, i, l_b)}"
    if row < robot.n:
        apart_m = least_distance_m(robot.tubes[i], robot.tubes[i + 1])
        is_collar = apart_m == robot.tubes[i + 1].collar_length_m
        needed = f"the collar of tube {i + 2}" if is_collar else f"room for the compliant shaft of tube {i + 1}"
        return f"{bases} must be at least {apart_m * 1e3:.6g} mm apart, {needed}"
    ends_mm = [round((l_b[k] + robot.tubes[k].length_m) * 1e3, 6) + 0.0 for k in (i, i + 1)]
    order = f"tube {i + 2} ends at {ends_mm[1]:.6g} mm and tube {i + 1} at {ends_mm[0]:.6g} mm"
    return f"{bases} must keep the tips in order, but {order}"


def _base(robot: Robot, i: int, l_b: Array) -> str:
    """The base of tube i (from 0), the joints that translate it, and where it is."""
    movers = [joint.name for joint, moves in zip(robot.drive.joints, robot.drive.matrix_l[i], strict=True) if moves]
    moved_by = f" (moved by {', '.join(movers)})" if movers else ""
    return f"the base of tube {i + 1}{moved_by} at l_{i + 1}b = {l_b[i] * 1e3:.6g} mm"


MADE_OF = {"drive": "Drive", "measurement": "SensorNoise", "loads": "Loads", "intervals": "StatedIntervals"}


@shown
@dataclass(frozen=True, eq=False)
class Robot:
    """n concentric tubes, outermost first, their n - 1 contacts and the drive; SI units.

    Made in code it is checked as a file would be; without a drive it has a rotation and a translation per tube. What
    `with_` changes is checked again, what `dataclasses.replace` changes is not. Threads may share it; it pickles.
    """

    name: str
    tubes: tuple[Tube, ...]
    contacts: tuple[Contact, ...] = ()
    drive: Drive = None  # type: ignore[assignment]  # never None once made
    model_error_m: float = 0.0
    friction_memory: float = 0.0  # share of the friction bound that real contacts keep after slip, beyond the model's
    measurement: SensorNoise | None = None
    markers: tuple[Marker, ...] = ()  # on the body, in the order of the file
    loads: Loads = Loads()  # beyond the paper, set by [effects.*]
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # [effects.*] as in the file
    intervals: StatedIntervals = StatedIntervals()  # [uncertainty] as in the file, SI
    ideal: Robot | None = None  # without the effects, where tubes, contacts, loads and drive have them at work
    provenance: Mapping[str, Any] = field(default_factory=dict)  # as in the file
    content: Mapping[str, Any] = field(default_factory=dict)  # of the file after overrides, or of one that says this
    path: str | None = None
    warnings: tuple[str, ...] = ()
    guide: Guide | None = field(default=None, repr=False)  # shapes of its branch; None: of a robot never wound up

    def __post_init__(self) -> None:
        """Checks what was made in code. Raises InputError unless neighbouring tubes have a contact each."""
        read_plain_fields(self)
        require_made(self, MADE_OF)
        object.__setattr__(self, "tubes", rows_of("tubes", self.tubes, Tube))
        object.__setattr__(self, "contacts", rows_of("contacts", self.contacts, Contact))
        if len(self.contacts) != max(len(self.tubes) - 1, 0):
            rule = f"must be {max(len(self.tubes) - 1, 0)}, one for each pair of neighbouring tubes"
            raise InputError(rule, key="contacts", value=len(self.contacts))
        if not self.content:
            _as_in_a_file(self)
        object.__setattr__(self, "content", frozen_content(self.content))
        object.__setattr__(self, "effects", frozen_content(self.effects))

    @cached_property
    def sha256_of(self) -> dict[str, str]:
        """Hashes of its contents by what a robot file calls them; names and where they came from do not count."""
        drive = self.drive
        rest = {
            "drive": (drive.joints, drive.home_theta_rad, drive.home_l_m, drive.terms, drive.play, drive.execution),
            "model_error_mm": self.model_error_m,
            "friction_memory": self.friction_memory,
            "measurement": self.measurement,
            "marker": self.markers,
            "loads": self.loads,
            "effects": (self.effects, self.ideal),
            "uncertainty": self.intervals,
        }
        numbered = {"tube": self.tubes, "contact": self.contacts}
        each = {f"{key}.{k}": row for key, rows in numbered.items() for k, row in enumerate(rows, start=1)}
        return {key: content_sha256(value) for key, value in (each | rest).items()}

    @cached_property
    def sha256(self) -> str:
        """Hash of its content, as it is: a robot that was changed has another one."""
        return content_sha256(self.sha256_of)

    @property
    def n(self) -> int:
        """Number of tubes."""
        return len(self.tubes)

    @cached_property
    def clearance_m(self) -> Array:
        """(n - 1,) radial clearance [m] of each pair: half the difference of diameters unless the contact gives one."""
        return read_only(np.array([self._clearance(i) for i in range(self.n - 1)], dtype=np.float64))

    @cached_property
    def friction(self) -> Array:
        """(n - 1, 2) lowest and highest friction coefficient of each pair."""
        return read_only(np.array([c.friction_coefficient for c in self.contacts], dtype=np.float64).reshape(-1, 2))

    @cached_property
    def mechanics(self) -> Mechanics:
        """The compiled model; where friction is an interval it uses the upper end, whose corners enclose the rest."""
        from ctrplan.mechanics.core import Mechanics

        return Mechanics(self.tubes, self.clearance_m, self.friction[:, 1], self.loads, self.guide)

    @cached_property
    def unguided(self) -> Robot:
        """The robot as its file says it, on whichever branch this one stands."""
        return self if self.guide is None else replace(self, guide=None)

    def guided(self, guide: Guide) -> Robot:
        """The robot on a branch of equilibria: whatever is solved of it begins from the shapes of `guide`."""
        made = replace(self, guide=guide)
        vars(made)["unguided"] = self.unguided
        return made

    def headline(self) -> str:
        """Name and size of the robot, shown where it is printed."""
        longest = max(tube.length_m for tube in self.tubes) * 1e3
        return f"{self.name}, {self.n} tube{'s' if self.n > 1 else ''} up to {longest:.4g} mm long"

    def with_(self, *overrides: str, **changes: Any) -> Robot:
        """The robot with fields changed, and keys of its file by `overrides`, "tube.2.poisson_ratio=0.28"; checked.

        Raises InputError for a field or key that there is not, and as files do.
        """
        kept = {"effects": self.effects, "content": {}, "warnings": (), "guide": None} | changes
        made = changed(self.ideal or self, **kept)
        import ctrplan  # files are of a package above, and stand in the public names

        return ctrplan.as_read(made, overrides) if overrides else made

    def to_toml(self) -> str:
        """The text of a robot file that is read as this robot. Raises InputError for what no file says."""
        import ctrplan

        return ctrplan.to_toml(self)

    def plot(self) -> Figure:
        """The tubes to scale, as they are bent when nothing holds them, and the travel of the drive."""
        import ctrplan  # pictures are of a package above, and stand in the public names

        return ctrplan.plot(self)

    def collars(self, theta_commanded: ArrayLike, l_commanded: ArrayLike) -> tuple[Array, Array]:
        """Where the drive holds the bases: theta_b [rad], l_b [m], each (n,) or (K, n), of commanded values alike.

        The same unless the robot file has effects of the drive. Everything below asks for collars, theta_b and l_b.
        """
        return self.drive.reached(theta_commanded, l_commanded)

    def zero_clearance(self, theta_b: ArrayLike, l_b: ArrayLike) -> Shape:
        """Zero-clearance, frictionless shape at collars (n,) [rad], (n,) [m], (2)-(3), with the loads of the robot."""
        warn_of_degrees("theta_b", theta_b)
        return self.mechanics.zero_clearance(theta_b, l_b)

    def equilibria(self, theta_b: ArrayLike, l_b: ArrayLike) -> Equilibria:
        """Every equilibrium without clearance and friction at collars (n,) [rad], (n,) [m], stable or not.

        Whole turns of collars lead from one to another. `branches` of the result has the stable shapes with clearance
        and friction. Raises InputError for collars that don't nest, for robots with loads, with oval tubes or such that
        soften, and for more than five tubes.
        """
        from ctrplan.mechanics.equilibria import equilibria

        warn_of_degrees("theta_b", theta_b)
        self.mechanics.zero_clearance(theta_b, l_b, loads=False)  # which refuses collars that don't nest
        return equilibria(self, theta_b, l_b)

    def solve(
        self, theta_b: ArrayLike, l_b: ArrayLike, phi: ArrayLike = 0.0, *, accuracy: Accuracy = "search"
    ) -> Shape:
        """Shape with clearance and friction at collars (n,) [rad], (n,) [m].

        phi: share of the Coulomb limit in [-1, 1], a number or one for each pair of tubes (n - 1,); +1 where the inner
        tube was last rotated counterclockwise against the outer one, 0 without friction. accuracy: of the mesh.
        `status` of the result says whether it is one stable equilibrium. Raises InputError for collars that don't nest.
        """
        warn_of_degrees("theta_b", theta_b)
        return self.mechanics.solve(theta_b, l_b, phi, accuracy=accuracy)

    def bound(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        corners: Literal["all", "extreme"] | None = None,
        progress: Progress | None = None,
        gradient: bool = False,
        parameters: Sequence[str] = (),
    ) -> Bound:
        """How far friction may move the tip with collars at (n,) [rad], (n,) [m], and along the body.

        The largest distances between the shape without friction and those at the corners, friction at its limit one way
        or the other in each pair of tubes. corners: "all" of them, of at most 10 tubes, or those "extreme" ones that a
        search finds; by default all of at most 8 tubes. `progress` is told the finished share, 0 to 1.

        gradient: whether `Bound.gradient` has the derivatives of bound, stability and frictionless tip by the collars,
        per rad and per m, and by `parameters`, numbers of the robot file in SI units as "tube.2.poisson_ratio". They
        are those of the corner that is worst; where another one becomes it, the bound has a kink. Raises InputError
        for collars that do not nest, SolverError where nothing is solved.
        """
        refuse_idle(parameters, gradient=gradient)
        warn_of_degrees("theta_b", theta_b)
        bound = partial(self.mechanics.bound, accuracy=accuracy, corners=corners, progress=progress)
        return bound(theta_b, l_b, gradient=gradient, parameters=parameters)

    def bound_many(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        threads: int = 0,
        progress: Progress | None = None,
        executor: Executor | None = None,
    ) -> Bounds:
        """Bounds of K configurations of the collars, (K, n) [rad], (K, n) [m], on every core or an executor's workers.

        threads: 0 for every core. executor: any with the interface of concurrent.futures, whose tasks are chunks of
        half a second or so. `progress` is told the finished share, 0 to 1. Raises InputError, with the row, before
        anything is solved.
        """
        warn_of_degrees("theta_b", theta_b)
        return self.mechanics.bound_many(
            theta_b, l_b, accuracy=accuracy, threads=threads, progress=progress, executor=executor
        )

    def bounds(
        self,
        theta_b: ArrayLike,
        l_b: ArrayLike,
        *,
        accuracy: Accuracy = "search",
        threads: int = 0,
        progress: Progress | None = None,
        executor: Executor | None = None,
        gradient: bool = False,
        parameters: Sequence[str] = (),
    ) -> Bounds:
        """`bound_many` that never fails for a row: one that does not nest, or is no number, has the status REFUSED.

        gradient, parameters: as of `bound`, NaN in rows without a bound. Raises InputError for arrays of another shape
        alone, and for parameters that there are not.
        """
        refuse_idle(parameters, gradient=gradient)
        warn_of_degrees("theta_b", theta_b)
        return self.mechanics.bounds(
            theta_b,
            l_b,
            accuracy=accuracy,
            threads=threads,
            progress=progress,
            executor=executor,
            gradient=gradient,
            parameters=parameters,
        )

    def walker(self, *, accuracy: Accuracy = "search") -> Walker:
        """Bounds along a path of the collars: each call of its `bound` starts from the solution of the call before."""
        from ctrplan.mechanics.history import Walker

        return Walker(self.mechanics.core_walker(accuracy), self.n)

    def history(
        self, start: Start = "released", *, accuracy: Accuracy = "search", options: HistoryOptions | None = None
    ) -> History:
        """A simulation along a path of the collars, friction followed step by step: `advance` leads it on.

        start: "released", without friction, or the signs of a corner, friction fully loaded. options: lengths of steps.
        """
        from ctrplan.mechanics.history import History

        return History(self.mechanics, start, accuracy=accuracy, options=options)

    def observer(
        self,
        noise: SensorNoise | float | None = None,
        *,
        offset: SlowOffset | None = None,
        slow: Sequence[SlowParameter] = (),
        members: int = 9,
        seed: int = 0,
        accuracy: Accuracy = "search",
    ) -> Observer:
        """Follows the robot by collars and measured tips, from friction that nobody knows; `collars` says where those
        are of commanded joints.

        noise: of the tracker, or its standard deviation [m] of each coordinate; by default the robot file's
        [measurement]. offset: what no friction state explains changes slowly, by default nothing is. slow: numbers of
        the robot that are estimated besides. members: friction states that are followed, more where there are more
        corners. Raises InputError.
        """
        from ctrplan.robot.observer import Observer
        from ctrplan.robot.slow_states import SlowOffset, robot_with, values_of_slow

        known = self.measurement if noise is None else noise
        if known is None:
            raise InputError("must be given, the robot's file has no [measurement]", key="noise")
        if not isinstance(known, SensorNoise):
            known = SensorNoise(known)
        return Observer(
            robot_with(self),
            noise=known,
            offset=SlowOffset(0.0) if offset is None else offset,
            slow=values_of_slow(self, slow),
            members=members,
            seed=seed,
            accuracy=accuracy,
            farthest_m=farthest_m(self.tubes),
        )

    def _clearance(self, i: int) -> float:
        given = self.contacts[i].clearance_m
        return diametral_gap_m(self.tubes, i) if given is None else given


D = TypeVar("D")


def changed(given: D, **changes: Any) -> D:
    """A dataclass with fields changed. Raises InputError for a name that is no field of it."""
    known = [each.name for each in fields(given)]  # type: ignore[arg-type]
    for name in changes.keys() - set(known):
        raise InputError(f"is no field of a {type(given).__name__}: those are {', '.join(known)}", key=name)
    return replace(given, **changes)  # type: ignore[type-var]


def _as_in_a_file(robot: Robot) -> None:
    """Gives a robot made in code the content of a file that says it, and what such a file adds. Raises InputError."""
    import ctrplan  # files are of a package above, and stand in the public names

    read = ctrplan.as_read(robot)
    taken = {"content", "warnings"} | ({"drive"} if robot.drive is None else set())
    if robot.effects:
        taken |= {"tubes", "contacts", "drive", "loads", "ideal", "model_error_m"}
    for name in taken:
        object.__setattr__(robot, name, getattr(read, name))
    warn_of_doubts(read.warnings)


def warn_of_doubts(doubts: Sequence[str]) -> None:
    """Warns whoever makes an object in code of numbers that may be in another unit: of sentences that ask."""
    for text in doubts:
        if "?" in text:
            warn_caller(text)


def diametral_gap_m(tubes: Sequence[Tube], i: int) -> float:
    """Radial clearance [m] that the diameters of tubes i and i + 1 (from 0) leave."""
    return (tubes[i].inner_diameter_m - tubes[i + 1].outer_diameter_m) / 2
