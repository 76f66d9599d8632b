"""What a hunt finds: the worst figure of a claim, where, when and in which friction state."""

from __future__ import annotations

from dataclasses import dataclass

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.mechanics.accuracy import Accuracy

# By how much a figure may miss its claim, and what share of the claim comes on top: rounding, or what the meshes of
# certificate and judge differ by. Clearances and worst bounds are claimed with an allowance for that.
ALLOWED = {
    "clearance": 0.01e-3,
    "worst bound": 0.01e-3,
    "bound": 0.3e-3,
    "predicted": 0.3e-3,
    "stability": 0.01,
    "strain": 0.2e-3,
}
SHARE = {"clearance": 0.0, "worst bound": 0.0, "bound": 0.02, "predicted": 0.02, "stability": 0.02, "strain": 0.02}
SMALLER_IS_WORSE = ("clearance", "stability")


@dataclass(frozen=True, eq=False)
class Finding:
    """A figure of a claim at a place of the way; SI."""

    claim: str  # a key of ALLOWED
    value: float
    stated: float  # what the certificate claims there; NaN where it claims nothing
    place: float
    joints: Array  # (m,)
    leg: int  # from 1
    time_s: float
    point_m: Array  # (3,) anatomy's frame: where the clearance is least, else the tip
    tube: int  # from 1
    phi: tuple[float, ...]  # uniform friction state; of a history where it started
    before: Array | None = None  # (H, m) joints driven before the start, for a state that a history leads to
    play: tuple[float, ...] = ()  # share of the play of every collar, rotations first
    accuracy: Accuracy = "certificate"

    @property
    def excess(self) -> float:
        """By how much the figure is worse than claimed; negative: better."""
        return self.stated - self.value if self.claim in SMALLER_IS_WORSE else self.value - self.stated

    @property
    def is_broken(self) -> bool:
        """Whether the claim is broken, beyond what is allowed for rounding and meshes."""
        return self.excess > ALLOWED[self.claim] + SHARE[self.claim] * abs(self.stated)

    def worse_than(self, other: Finding | None) -> bool:
        """Whether it says more against its claim."""
        if other is None:
            return True
        if self.stated != self.stated:  # nothing is claimed
            return self.value < other.value if self.claim in SMALLER_IS_WORSE else self.value > other.value
        return self.excess > other.excess

    @property
    def how(self) -> str:
        """The friction state in words."""
        state = ", ".join(f"{phi:+.3g}" for phi in self.phi)
        if self.before is None:
            return f"friction state ({state})"
        began = f"({state})" if any(self.phi) else "released"
        return f"a simulated history, {began}, {len(self.before)} turns before the start"

    @property
    def where(self) -> str:
        """Leg, time, place and tube in words."""
        point = ", ".join(f"{x:.1f}" for x in self.point_m * MM_PER_M)
        return f"leg {self.leg}, {self.time_s:.2f} s, tube {self.tube} at ({point}) mm"
