"""How near a plan's robot comes to the anatomy: without friction, in the worst friction state, and as certified."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from ctrplan.reports.plan_words.numbers import millimetres

if TYPE_CHECKING:
    from ctrplan.base.arrays import Array
    from ctrplan.planning.certified import Closest
    from ctrplan.planning.plan import Plan

Kind = Literal["nominal", "closest", "narrowest"]  # as the certificate calls them
LABELS: dict[Kind, str] = {
    "nominal": "clearance without friction",
    "closest": "clearance, worst friction",
    "narrowest": "clearance, certified",
}
ENDINGS: dict[Kind, str] = {
    "nominal": " beyond the margins",
    "closest": "",
    "narrowest": ", all allowances taken off",
}
START_FRICTION = {
    "unknown": "unknown, so that the certificate holds whatever the robot did before",
    "oscillated": "let go of by an oscillation, as the scenario says; the certificate covers no other start",
    "observed": "as an observer found it, for predictions; the certificate holds whatever the robot did before",
    "released": "none, as the scenario says; the certificate covers no other start",
}


@dataclass(frozen=True)
class ClearanceRow:
    """A clearance beyond the margins, and where it is left."""

    kind: Kind
    clearance_m: float  # of "narrowest" less all allowances, else that of the place
    place: Closest
    time_s: float

    @property
    def where(self) -> str:
        """Tube, part and point: "tube 3 to anatomy.1 (tube) at [1.2, 3.4, 5.6] mm"."""
        return f"tube {self.place.tube} to {self.place.part} at {point_words(self.place.point_m)}"

    @property
    def when(self) -> str:
        """Leg and time."""
        return f"leg {self.place.leg + 1}, {self.time_s:.1f} s"

    @property
    def friction(self) -> str:
        """The friction state: shares of the Coulomb limit, from the outermost pair of tubes on."""
        phi = self.place.phi
        return f"({', '.join(f'{share:+.2g}' for share in phi)})" if phi.any() else "none"

    @property
    def sentence(self) -> str:
        """All of it, without a full stop."""
        state = "" if self.kind == "nominal" else f", friction {self.friction}"
        return f"{millimetres(self.clearance_m)}{ENDINGS[self.kind]}: {self.where}, {self.when}{state}"


def clearance_rows(plan: Plan) -> tuple[ClearanceRow, ...]:
    """From the widest to the narrowest; none in free space."""
    certificate, rows = plan.certificate, []
    for kind in LABELS:
        place: Closest | None = getattr(certificate, kind)
        if place is not None:
            left_m = certificate.min_clearance_m if kind == "narrowest" else place.clearance_m
            rows.append(ClearanceRow(kind, left_m, place, plan.time_of(place)))
    return tuple(rows)


def point_words(point_m: Array) -> str:
    """A point (3,) in the anatomy's frame, in mm."""
    return f"[{', '.join(f'{x:.1f}' for x in point_m * 1e3)}] mm"
