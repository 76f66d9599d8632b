"""What a certificate says of a motion: its figures in one table, a recheck of them, certificates of stages joined.

A recheck asks two questions. Do the figures follow from the legs? On the mesh of the first walk each must come out
again. Do the legs hold? On the certificate mesh, the finer one, they must be valid too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from itertools import chain
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.base.package import shown
from ctrplan.certificate.arrival import Arrival, TargetReached
from ctrplan.drive.legs import distance_from_polyline, merge_legs
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.mechanics.history import HistoryState
    from ctrplan.mechanics.shapes import Accuracy
    from ctrplan.mechanics.walk import PathLimits
    from ctrplan.scenario.scenario import Scenario, StartFriction

WalkAgain = Callable[["Accuracy | None", "Sequence[HistoryState] | None"], "Certificate"]
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

    Its key in plan.json is its name in `Certificate`, whose order is that of every list of figures. A plan whose figure
    misses its limit is not acceptable; what makes legs invalid, so that a search goes on, stands in `problems.py`.
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


SAME, SHARE = 1e-5, 1e-3  # in a figure's own unit (0.01 mm of a length), and of its value: processors round differently
OFF_PATH = 1e-9  # rad or m by which legs and trajectory may leave the certified path


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out again."""

    figure: str  # its name, "samples.bound_m" for the worst sample of a column
    stated: float | str
    recomputed: float | str

    @property
    def sentence(self) -> str:
        """Figure and both values, without a full stop."""
        stated, result = (x if isinstance(x, str) else f"{x:.6g}" for x in (self.stated, self.recomputed))
        return f"{self.figure} is stated as {stated} and found to be {result}"


def differences(stated: Any, result: Any, *, of: str = "", skip: tuple[str, ...] = ()) -> tuple[Difference, ...]:
    """The differences of two dataclasses of one kind, fields in `skip` left out; figures are named `of` and the field.

    Of sequences of unlike lengths the lengths are compared, of texts whether they are alike.
    """
    names = (entry.name for entry in fields(stated) if entry.name not in skip)
    return tuple(d for name in names for d in _compared(of + name, getattr(stated, name), getattr(result, name)))


def path_differences(waypoints: Array, trajectory: Array, certified: Array) -> tuple[Difference, ...]:
    """How far legs through waypoints (K, m) and a trajectory (T, m) [rad, m] are from the path certified, (L, m)."""
    driven, path = merge_legs(waypoints), merge_legs(certified)
    line = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    apart = {
        "legs": np.abs(driven - path).max() if driven.shape == path.shape else np.inf,
        "ends of the trajectory": np.abs(trajectory[[0, -1]] - line[[0, -1]]).max(),
        "trajectory": distance_from_polyline(trajectory, line).max(),
    }
    return tuple(
        Difference(f"distance of the {what} from the certified path", 0.0, float(distance))
        for what, distance in apart.items()
        if distance > OFF_PATH
    )


def _compared(figure: str, stated: Any, result: Any) -> Iterator[Difference]:
    if (stated is None) != (result is None) and (is_dataclass(stated) or is_dataclass(result)):
        yield Difference(figure, np.nan, np.nan)
    elif is_dataclass(stated):
        yield from differences(stated, result, of=f"{figure}.")
    elif isinstance(stated, str):
        if stated != result:
            yield Difference(figure, stated, str(result))
    elif isinstance(stated, Mapping):
        yield from _compared(figure, tuple(stated.items()), tuple(result.items()))
    elif isinstance(stated, tuple):
        if len(stated) != len(result):
            yield Difference(figure, len(stated), len(result))
        for number, (a, b) in enumerate(zip(stated, result, strict=False), start=1):
            yield from _compared(f"{figure}.{number}", a, b)
    else:
        yield from _numbers_compared(figure, stated, result)


def _numbers_compared(figure: str, stated: Any, result: Any) -> Iterator[Difference]:
    """The largest difference of numbers or arrays beyond what rounding may do; None counts as not a number."""
    a, b = (np.asarray(np.nan if value is None else value, dtype=np.float64).ravel() for value in (stated, result))
    if a.shape != b.shape:
        yield Difference(f"number of {figure}", len(a), len(b))
        return
    off = ~np.isclose(a, b, rtol=SHARE, atol=SAME, equal_nan=True)
    if off.any():
        gap = np.nan_to_num(np.abs(a - b), nan=np.inf)
        k = int(np.argmax(np.where(off, gap, -1.0)))
        yield Difference(figure, float(a[k]), float(b[k]))


@shown
@dataclass(frozen=True, eq=False)
class CertificateSamples:
    """The finished legs with the full model, K samples in the order driven."""

    leg: NDArray[np.int_]  # (K,) index of the leg
    joints: Array  # (K, m)
    path_mm: Array  # (K,) weighted joint length travelled
    bound_m: Array  # (K,) worst-case friction error of the tip, on the mesh walked on, parameters in their intervals
    bound_rad: Array  # (K,) of the tip tangent
    stability: Array  # (K,) in every friction state, parameters in their intervals
    max_strain: Array  # (K,) likewise
    clearance_m: Array  # (K,) in every friction state, beyond the margins of the anatomy; inf in free space
    motion_m: Array  # (K,) largest displacement of a body point of any shape since the sample before
    tip_m: Array  # (K, 3) frictionless tip, robot frame
    released_m: Array  # (K,) as bound_m, less what translations released by the friction law; fully loaded at the start
    predicted_m: Array  # (K,) friction error by simulated history, the largest over the states it may start in
    play_m: Array  # (K,) how far play of the drive may move the tip
    parameter_bound_m: Array  # (K,) what uncertain parameters add to the bound; in bound_m
    parameter_clearance_m: Array  # (K,) what intervals, play and registration take off the clearance; off clearance_m
    parameter_stability: Array  # (K,) what intervals and play take off the stability; off stability
    parameter_strain: Array  # (K,) and add to the strain; in max_strain
    spread_m: Array  # (K,) size of the set of friction states at the tip: half the largest distance of two histories
    friction_spread: Array  # (K, n - 1) of each pair: 1 where nothing is known of its friction, 0 where all is


@dataclass(frozen=True, eq=False)
class Closest:
    """Where a robot comes closest to the anatomy, solved on the certificate mesh; no allowance is taken off."""

    clearance_m: float  # of the tube's surface beyond the margin of the part
    distance_m: float  # from its surface
    part: str  # as the scenario's file has it: "anatomy.1 (tube)"
    tube: int  # from 1, the outermost
    point_m: Array  # (3,) on the tube's centreline, anatomy's frame
    leg: int  # index
    path_mm: float  # weighted joint length travelled until then
    joints: Array  # (m,)
    phi: Array  # (n - 1,) friction state
    taken_m: Mapping[str, float] = field(default_factory=dict)  # by cause, see `causes`; of the certified clearance


@dataclass(frozen=True, eq=False)
class Settling:
    """The oscillation of decreasing amplitude that ends a plan (Section V-A of the paper)."""

    amplitude_rad: float  # of the first turn, between neighbouring tubes
    turns: Array  # (m,) joint motion per rad of amplitude
    first_leg: int  # index of its first leg; the rest of the plan is settling
    min_clearance_m: float  # while settling; inf in free space
    goal_predicted_before_m: float  # predicted error that it starts from
    goal_predicted_after_m: float  # and that it leaves


def _limits(scenario: Scenario) -> PathLimits:
    """Imported where a limit is evaluated: files that read plans need no checker of motions."""
    from ctrplan.motion.limits import path_limits

    return path_limits(scenario)


@shown
@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate:
    """Dense recheck of the legs, independent of anything the search approximated. Its fields are the table of figures.

    A new figure is a field here and its value in `certify.finished`.
    """

    samples: CertificateSamples
    # fmt: off
    valid: bool = field(metadata=figure("all"))
    problems: tuple[str, ...] = field(metadata=figure("chain"))  # sentences; empty when valid
    goal_bound_m: float = field(metadata=figure(
        "last", "m", "worst-case friction error of the tip at the goal, with the allowance for the mesh",
        title="Worst-case friction error at the goal, position", line=("worst-case friction error", "{} at the goal"),
        tile=("worst-case friction error", "worst-case friction error at the goal"),
        limit=lambda scenario: scenario.cost.max_error_goal_m,
    ))
    goal_bound_rad: float = field(metadata=figure(
        "last", "rad", "of the tip's tangent", title="Worst-case friction error at the goal, direction"
    ))
    worst_bound_m: float = field(metadata=figure(
        "max", "m", "largest worst-case friction error of the tip along the path", claim="worst bound",
        title="Worst-case friction error along the path", line=("worst-case friction error", "{} on the way"),
        tile=("worst-case friction error", "worst case at most along the path"),
    ))
    goal_predicted_m: float = field(metadata=figure(
        "last", "m", "friction error at the goal by simulated history, the largest over the states it may start in",
        title="Predicted friction error at the goal", line=("predicted friction error", "{} at the goal"),
        tile=("predicted friction error", "predicted friction error at the goal"),
    ))
    worst_predicted_m: float = field(metadata=figure(
        "max", "m", "largest friction error along the path by simulated history, over the states it may start in",
        title="Predicted friction error along the path", line=("predicted friction error", "{} on the way"),
    ))
    goal_predicted_tip_m: Array = field(metadata=figure("last"))  # (3,) robot frame, mean over the start states
    goal_predicted_spread_m: float = field(metadata=figure(
        "last", "m", "how far from that mean the friction state at the start can leave the tip"
    ))
    goal_tip_error_m: float = field(metadata=figure(
        "last", "m", "distance of the frictionless tip from the goal's; 0 for goals in joint values",
        title="Distance from the goal without friction", limit=lambda scenario: scenario.goal.tolerance_m,
    ))
    worst_play_m: float = field(default=0.0, metadata=figure(
        "max", "m", "how far play of the drive may move the tip; clearances hold anywhere within it"
    ))
    goal_play_m: float = field(default=0.0, metadata=figure("last", "m", "that at the goal"))
    min_clearance_m: float = field(metadata=figure(  # inf in free space
        "min", "m", claim="clearance", limit=lambda scenario: _limits(scenario).clearance_m,
        description="of every friction state to the anatomy, beyond its margins, all allowances taken off; "
        "null in free space",
        title="Clearance to the anatomy in every friction state, beyond its margins",
        tile=("certified clearance", "certified clearance beyond the margins"),
    ))
    min_stability: float = field(metadata=figure(
        "min", "number", "in every friction state", claim="stability",
        title="Smallest stability in every friction state", line=("least stability", "{}"),
        tile=("stability", "smallest stability"), limit=lambda scenario: _limits(scenario).stability,
    ))
    max_strain: float = field(metadata=figure(
        "max", "share", "in every friction state", claim="strain",
        title="Largest strain in every friction state", line=("least stability", "largest strain {}"),
        limit=lambda scenario: _limits(scenario).max_strain,
    ))
    length_mm: float = field(metadata=figure(
        "sum", "mm", "length in joint space, 1 rad counted as mm_per_rad", title="Joint path length"
    ))
    error_integral_mm: float = field(metadata=figure(
        "sum", "mm", "integral of the bound over the joint length, divided by mm_per_rad",
        title="Error summed over the path",
    ))
    released_integral_mm: float = field(metadata=figure(
        "sum", "mm", "integral of released_m over the joint length, divided by mm_per_rad"
    ))
    predicted_integral_mm: float = field(metadata=figure(
        "sum", "mm", "integral of the predicted error over the joint length, divided by mm_per_rad"
    ))
    spacing_m: float = field(metadata=figure(
        "max", "m", "largest motion of a body point between samples",
        title="Largest motion of the body between samples",
    ))
    cost_mm: float = field(metadata=figure(
        "sum", "mm", "of released errors along the path, bound and unknown friction at the goal, terms of one's own",
        title="Cost", line=("cost", "{}"),
    ))
    stops: int = field(metadata=figure(
        "", "count", "of the drive on the way, as the trajectory's", title="Stops on the way"
    ))
    snaps: int = field(metadata=figure("sum", "count", "times a simulated robot slid to another equilibrium"))
    # The first stage's: where that is known, later stages go on from any that it leads to.
    start_friction: StartFriction = field(default="unknown", metadata=figure("first"))  # before the motion, as assumed
    # fmt: on
    nominal: Closest | None = None  # the frictionless robot where it comes closest; None in free space
    closest: Closest | None = None  # the robot in any friction state
    narrowest: Closest | None = None  # where min_clearance_m is left, in the friction state that comes closest there
    targets: tuple[TargetReached, ...] = ()  # in the order reached, the goal last
    arrival: Arrival | None = None  # at the goal, by this motion; None where a history found no equilibrium
    settling: Settling | None = None
    end_states: tuple[HistoryState, ...] = ()  # friction states at the end, one for each start
    spare_m: float = np.inf  # of clearance beyond what the scenario asks for: of more it is only known that it is more
    walk_again: WalkAgain | None = None  # on the same mesh if None, from the friction states that a stage before left

    def __getstate__(self) -> dict[str, Any]:
        """What a copy in another process has: friction states stay where they were simulated."""
        return {**self.__dict__, "end_states": (), "walk_again": None}

    def recheck(self) -> Recheck:
        """Walks the legs again, on the mesh they were certified on and on the certificate mesh; see `Recheck`.

        Takes seconds. Raises InputError where the certificate does not know its legs.
        """
        if self.walk_again is None:
            raise InputError("holds no legs to walk again", key="certificate")
        return Recheck(self, self.walk_again("certificate", None), self._differences(self.walk_again(None, None)))

    def _differences(self, again: Certificate) -> tuple[Difference, ...]:
        """The differences of all figures, samples and targets included, from those of another walk of the same legs."""
        result = differences(self, again, skip=("settling", "end_states", "spare_m", "walk_again"))
        if self.settling is None:
            return result
        swinging = again.samples.leg >= self.settling.first_leg
        expected = replace(
            self.settling,
            min_clearance_m=float(again.samples.clearance_m[swinging].min(initial=np.inf)),
            goal_predicted_after_m=again.goal_predicted_m,
        )
        return result + differences(self.settling, expected, of="settling.")


@dataclass(frozen=True, eq=False)
class Recheck:
    """What walking the legs of a certificate again found."""

    stated: Certificate
    fresh: Certificate  # on the certificate mesh
    differences: tuple[Difference, ...]  # of the stated figures from a walk on the mesh they come from; empty: none

    @property
    def is_confirmed(self) -> bool:
        """Every figure came out again, and legs that are stated to be valid are so on the certificate mesh."""
        return not self.differences and (self.fresh.valid or not self.stated.valid)

    @property
    def sentence(self) -> str:
        """What was found, in one sentence."""
        if self.differences:
            more = f" (and {len(self.differences) - 1} more)" if len(self.differences) > 1 else ""
            return f"Not confirmed: {self.differences[0].sentence}{more}."
        if self.fresh.valid:
            return "Confirmed: every figure came out again, and the legs are valid on the certificate mesh."
        opening = "Confirmed, but not valid" if self.is_confirmed else "Not confirmed"
        return f"{opening} on the certificate mesh: {self.fresh.problems[0]}"


FIGURES: dict[str, Figure] = {
    entry.name: entry.metadata["figure"] for entry in fields(Certificate) if "figure" in entry.metadata
}


def joined_certificates(stages: list[Certificate]) -> Certificate:
    """One certificate over all stages: figures at the goal are the last one's, the others the worst or the sum."""
    if len(stages) == 1:
        return stages[0]
    samples, targets = _joined_samples(stages)
    last, before = stages[-1], sum(map(_legs, stages[:-1]))
    joins = {name: JOINS[figure.join] for name, figure in FIGURES.items() if figure.join}
    return replace(
        last,
        **{name: join([getattr(stage, name) for stage in stages]) for name, join in joins.items()},
        samples=samples,
        stops=max(sum(map(_legs_driven, stages)) - 1, 0),
        nominal=_closest(stages, "nominal"),
        closest=_closest(stages, "closest"),
        narrowest=_closest(stages, "narrowest"),
        targets=targets,
        arrival=targets[-1].arrival,
        walk_again=_all_again(stages),
        settling=last.settling and replace(last.settling, first_leg=last.settling.first_leg + before),
    )


def _closest(stages: list[Certificate], name: Literal["nominal", "closest", "narrowest"]) -> Closest | None:
    """The closest of all stages, that of least certified clearance for "narrowest"; leg and path are the tour's."""
    results, legs, travelled = list[tuple[float, Closest]](), 0, 0.0
    for stage in stages:
        place: Closest | None = getattr(stage, name)
        if place is not None:
            left_m = stage.min_clearance_m if name == "narrowest" else place.clearance_m
            results.append((left_m, replace(place, leg=place.leg + legs, path_mm=place.path_mm + travelled)))
        legs, travelled = legs + _legs(stage), travelled + stage.length_mm
    return min(results, key=lambda pair: pair[0])[1] if results else None


def _all_again(stages: list[Certificate]) -> WalkAgain | None:
    """Walks every stage again, from where the one before leaves friction; None where one does not know its legs."""
    ways = [stage.walk_again for stage in stages if stage.walk_again is not None]
    if len(ways) < len(stages):
        return None

    def again(accuracy: Accuracy | None, starts: Sequence[HistoryState] | None) -> Certificate:
        results: list[Certificate] = []
        for way in ways:
            results.append(way(accuracy, results[-1].end_states or None if results else starts))
        return joined_certificates(results)

    return again


def _legs(stage: Certificate) -> int:
    """Legs of the plan that are the stage's: one, of no length, where its target is reached already."""
    return int(stage.samples.leg[-1]) + 1


def _legs_driven(stage: Certificate) -> int:
    return stage.stops + 1 if stage.length_mm > 0 else 0  # times that the drive stops, its end included


def _joined_samples(stages: list[Certificate]) -> tuple[CertificateSamples, tuple[TargetReached, ...]]:
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    targets, legs, travelled = list[TargetReached](), 0, 0.0
    for number, stage in enumerate(stages):
        keep = slice(0 if number == 0 else 1, None)  # a stage begins with the last sample of the one before
        for name, parts in columns.items():
            offset = {"leg": legs, "path_mm": travelled}.get(name, 0)
            parts.append((getattr(stage.samples, name) + offset)[keep])
        before = targets[-1].arrival if targets else None
        targets += [
            replace(
                target,
                leg=target.leg + legs,
                path_mm=target.path_mm + travelled,
                arrival=target.arrival and target.arrival.after(before, legs),
            )
            for target in stage.targets
        ]
        legs += _legs(stage)
        travelled += stage.length_mm
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()}), tuple(targets)
