"""What a certificate says of a motion, what comes out when it is checked again, and certificates of several stages
joined.

A recheck asks two questions. Do the figures follow from the legs? On the mesh of the first walk each must come out
again. Do the legs hold? On the certificate mesh, the finer one, they must be valid too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline, merge_legs
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.scenario.scenario import StartFriction

SAME, SHARE = 1e-5, 1e-3  # in a figure's own unit (0.01 mm of a length), and of its value: processors round differently
OFF_PATH = 1e-9  # rad or m by which legs and trajectory may leave the certified path


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out again."""

    figure: str  # its name, "samples.bound_m" for the worst sample of a column
    stated: float | str
    found: float | str

    @property
    def sentence(self) -> str:
        """Figure and both values, without a full stop."""
        stated, found = (x if isinstance(x, str) else f"{x:.6g}" for x in (self.stated, self.found))
        return f"{self.figure} is stated as {stated} and found to be {found}"


def differences(stated: Any, found: Any, *, of: str = "", skip: tuple[str, ...] = ()) -> tuple[Difference, ...]:
    """The differences of two dataclasses of one kind, fields in `skip` left out; figures are named `of` and the field.

    Of sequences of unlike lengths the lengths are compared, of texts whether they are alike.
    """
    names = (entry.name for entry in fields(stated) if entry.name not in skip)
    return tuple(d for name in names for d in _compared(of + name, getattr(stated, name), getattr(found, name)))


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


def _compared(figure: str, stated: Any, found: Any) -> Iterator[Difference]:
    if (stated is None) != (found is None) and (is_dataclass(stated) or is_dataclass(found)):
        yield Difference(figure, np.nan, np.nan)
    elif is_dataclass(stated):
        yield from differences(stated, found, of=f"{figure}.")
    elif isinstance(stated, str):
        if stated != found:
            yield Difference(figure, stated, str(found))
    elif isinstance(stated, tuple):
        if len(stated) != len(found):
            yield Difference(figure, len(stated), len(found))
        for number, (a, b) in enumerate(zip(stated, found, strict=False), start=1):
            yield from _compared(f"{figure}.{number}", a, b)
    else:
        yield from _numbers_compared(figure, stated, found)


def _numbers_compared(figure: str, stated: Any, found: Any) -> Iterator[Difference]:
    """The largest difference of numbers or arrays beyond what rounding may do; None counts as not a number."""
    a, b = (np.asarray(np.nan if value is None else value, dtype=np.float64).ravel() for value in (stated, found))
    if a.shape != b.shape:
        yield Difference(f"number of {figure}", len(a), len(b))
        return
    off = ~np.isclose(a, b, rtol=SHARE, atol=SAME, equal_nan=True)
    if off.any():
        gap = np.nan_to_num(np.abs(a - b), nan=np.inf)
        k = int(np.argmax(np.where(off, gap, -1.0)))
        yield Difference(figure, float(a[k]), float(b[k]))


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
    play_m: Array  # (K,) how far play of the drive may move the robot
    parameter_bound_m: Array  # (K,) what uncertain parameters add to the bound; in bound_m
    parameter_clearance_m: Array  # (K,) what they and registration take off the clearance; off clearance_m
    parameter_stability: Array  # (K,) what uncertain parameters take off the stability; off stability
    parameter_strain: Array  # (K,) and add to the strain; in max_strain


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


@dataclass(frozen=True, eq=False)
class Settling:
    """The oscillation of decreasing amplitude that ends a plan (Section V-A of the paper)."""

    amplitude_rad: float  # of the first turn, between neighbouring tubes
    turns: Array  # (m,) joint motion per rad of amplitude
    first_leg: int  # index of its first leg; the rest of the plan is settling
    min_clearance_m: float  # while settling; inf in free space
    goal_predicted_before_m: float  # predicted error that it starts from
    goal_predicted_after_m: float  # and that it leaves


@dataclass(frozen=True)
class TargetReached:
    """A target of a plan, and how well it is reached there."""

    name: str
    leg: int  # index of the leg that ends at it
    path_mm: float  # weighted joint length travelled until then
    bound_m: float
    bound_rad: float
    released_m: float  # the bound less what the friction law says translations released
    predicted_m: float  # by simulated history
    tip_error_m: float  # frictionless tip to the target; 0 for joint goals
    play_m: float = 0.0  # how far play of the drive may move the tip
    line_error_m: float | None = (
        None  # largest distance of the frictionless tip from the line on the way, if it has one
    )


@dataclass(frozen=True, eq=False)
class Certificate:
    """Dense recheck of the legs, independent of anything the search approximated."""

    samples: CertificateSamples
    valid: bool
    problems: tuple[str, ...]  # sentences; empty when valid
    worst_bound_m: float  # with the allowance for the mesh
    goal_bound_m: float  # likewise
    goal_bound_rad: float
    goal_tip_error_m: float  # frictionless tip to the goal's tip; 0 for joint goals
    error_integral_mm: float  # integral of the bound over the joint length, mm * mm / mm_per_rad
    worst_predicted_m: float  # as the bounds, but by simulated history
    goal_predicted_m: float
    released_integral_mm: float  # integrals of released_m and predicted_m, like error_integral_mm
    predicted_integral_mm: float
    goal_predicted_tip_m: Array  # (3,) robot frame, mean over the start states
    goal_predicted_spread_m: float  # how far from it a start state can leave the tip
    snaps: int  # times a simulated robot slid to another equilibrium
    min_clearance_m: float  # in every friction state, all allowances taken off; inf in free space
    min_stability: float
    max_strain: float
    length_mm: float  # weighted joint length
    stops: int  # of the drive on the way: changes of direction, and targets but the last
    cost_mm: float
    spacing_m: float  # largest motion of a body point of any shape between samples
    worst_play_m: float = 0.0  # how far play of the drive may move the robot
    goal_play_m: float = 0.0
    start_friction: StartFriction = "unknown"  # what the figures assume of friction before the motion
    nominal: Closest | None = None  # the frictionless robot where it comes closest; None in free space
    closest: Closest | None = None  # the robot in any friction state
    narrowest: Closest | None = None  # where min_clearance_m is left, in the friction state that comes closest there
    targets: tuple[TargetReached, ...] = ()  # in the order reached, the goal last
    settling: Settling | None = None
    walk_again: Callable[[Accuracy | None], Certificate] | None = None  # the same legs; on the same mesh if None

    def recheck(self) -> Recheck:
        """Walks the legs again, on the mesh they were certified on and on the certificate mesh; see `Recheck`.

        Takes seconds. Raises InputError where the certificate does not know its legs.
        """
        if self.walk_again is None:
            raise InputError("holds no legs to walk again", key="certificate")
        return Recheck(self, self.walk_again("certificate"), self._differences(self.walk_again(None)))

    def _differences(self, again: Certificate) -> tuple[Difference, ...]:
        """The differences of all figures, samples and targets included, from those of another walk of the same legs."""
        found = differences(self, again, skip=("settling", "walk_again"))
        if self.settling is None:
            return found
        swinging = again.samples.leg >= self.settling.first_leg
        expected = replace(
            self.settling,
            min_clearance_m=float(again.samples.clearance_m[swinging].min(initial=np.inf)),
            goal_predicted_after_m=again.goal_predicted_m,
        )
        return found + differences(self.settling, expected, of="settling.")


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


def joined_certificates(stages: list[Certificate]) -> Certificate:
    """One certificate over all stages: figures at the goal are the last one's, the others the worst or the sum."""
    if len(stages) == 1:
        return stages[0]
    samples, targets = _joined_samples(stages)
    last, before = stages[-1], sum(map(_legs, stages[:-1]))
    return replace(
        last,
        samples=samples,
        valid=all(stage.valid for stage in stages),
        problems=tuple(problem for stage in stages for problem in stage.problems),
        worst_bound_m=max(stage.worst_bound_m for stage in stages),
        error_integral_mm=sum(stage.error_integral_mm for stage in stages),
        worst_predicted_m=max(stage.worst_predicted_m for stage in stages),
        released_integral_mm=sum(stage.released_integral_mm for stage in stages),
        predicted_integral_mm=sum(stage.predicted_integral_mm for stage in stages),
        snaps=sum(stage.snaps for stage in stages),
        min_clearance_m=min(stage.min_clearance_m for stage in stages),
        min_stability=min(stage.min_stability for stage in stages),
        max_strain=max(stage.max_strain for stage in stages),
        length_mm=sum(stage.length_mm for stage in stages),
        stops=max(sum(map(_legs_driven, stages)) - 1, 0),
        cost_mm=sum(stage.cost_mm for stage in stages),
        spacing_m=max(stage.spacing_m for stage in stages),
        worst_play_m=max(stage.worst_play_m for stage in stages),
        start_friction=stages[0].start_friction,  # where it is known, later stages go on from any that it leads to
        nominal=_closest(stages, "nominal"),
        closest=_closest(stages, "closest"),
        narrowest=_closest(stages, "narrowest"),
        targets=targets,
        walk_again=_all_again(stages),
        settling=last.settling and replace(last.settling, first_leg=last.settling.first_leg + before),
    )


def _closest(stages: list[Certificate], name: Literal["nominal", "closest", "narrowest"]) -> Closest | None:
    """The closest of all stages, that of least certified clearance for "narrowest"; leg and path are the tour's."""
    found: list[tuple[float, Closest]] = []
    legs, travelled = 0, 0.0
    for stage in stages:
        place: Closest | None = getattr(stage, name)
        if place is not None:
            left_m = stage.min_clearance_m if name == "narrowest" else place.clearance_m
            found.append((left_m, replace(place, leg=place.leg + legs, path_mm=place.path_mm + travelled)))
        legs, travelled = legs + _legs(stage), travelled + stage.length_mm
    return min(found, key=lambda one: one[0])[1] if found else None


def _all_again(stages: list[Certificate]) -> Callable[[Accuracy | None], Certificate] | None:
    """Walks every stage again; None where one does not know its legs."""
    ways = [stage.walk_again for stage in stages if stage.walk_again is not None]
    if len(ways) < len(stages):
        return None
    return lambda accuracy: joined_certificates([again(accuracy) for again in ways])


def _legs(stage: Certificate) -> int:
    """Legs of the plan that are the stage's: one, of no length, where its target is reached already."""
    return int(stage.samples.leg[-1]) + 1


def _legs_driven(stage: Certificate) -> int:
    """Times that the drive stops in the stage, its end included."""
    return stage.stops + 1 if stage.length_mm > 0 else 0


def _joined_samples(stages: list[Certificate]) -> tuple[CertificateSamples, tuple[TargetReached, ...]]:
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    targets, legs, travelled = [], 0, 0.0
    for number, stage in enumerate(stages):
        keep = slice(0 if number == 0 else 1, None)  # a stage begins with the last sample of the one before
        for name, parts in columns.items():
            offset = {"leg": legs, "path_mm": travelled}.get(name, 0)
            parts.append((getattr(stage.samples, name) + offset)[keep])
        targets += [replace(t, leg=t.leg + legs, path_mm=t.path_mm + travelled) for t in stage.targets]
        legs += _legs(stage)
        travelled += stage.length_mm
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()}), tuple(targets)
