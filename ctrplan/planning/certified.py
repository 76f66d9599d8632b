"""What a certificate says of a motion, and what comes out when it is checked again.

A recheck asks two questions. Do the figures follow from the legs? On the mesh of the first walk each must come out
again. Do the legs hold? On the certificate mesh, the finer one, they must be valid too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.planning.comparison import Difference, differences

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy
    from ctrplan.planning.scenario import StartFriction


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
        """Of all figures, those of samples and targets included, from those of another walk of the same legs."""
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
