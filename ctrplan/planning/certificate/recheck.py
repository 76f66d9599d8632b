"""A certificate that checks itself: its legs are walked again, and its figures compared with what is found.

Two questions are asked. Do the figures follow from the legs? On the mesh of the first walk each must come out again.
Do the legs hold? On the certificate mesh, the finer one, they must be valid too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import distance_from_polyline, merge_legs
from ctrplan.errors import InputError
from ctrplan.planning.certificate.certify import certify
from ctrplan.planning.certificate.tour import joined_certificates
from ctrplan.planning.plan import Certificate, CertifiedLegs

if TYPE_CHECKING:
    from ctrplan.mechanics.core import Accuracy
    from ctrplan.planning.plan import Plan

FINE: Accuracy = "certificate"
SAME, SHARE = 1e-5, 1e-3  # in a figure's own unit (0.01 mm of a length), and of its value: processors round differently
OFF_PATH = 1e-9  # rad or m by which legs and trajectory may leave the certified path
NOT_FIGURES = ("samples", "problems", "walked", "settling", "targets")


@dataclass(frozen=True)
class Difference:
    """A figure that does not come out again."""

    figure: str  # its name in the certificate, "samples.bound_m" for the worst sample of a column
    stated: float
    found: float

    @property
    def sentence(self) -> str:
        """Figure and both values, without a full stop."""
        return f"{self.figure} is stated as {self.stated:.6g} and found to be {self.found:.6g}"


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


def recheck_certificate(certificate: Certificate) -> Recheck:
    """See `Certificate.recheck`."""
    if not certificate.walked:
        raise InputError("holds no legs to walk again", key="certificate")
    again = _walked_again(certificate)
    fine = all(legs.accuracy == FINE for legs in certificate.walked)
    fresh = again if fine else _walked_again(certificate, FINE)
    return Recheck(certificate, fresh, tuple(_differences(certificate, again)))


def recheck_plan(plan: Plan) -> Recheck:
    """See `Plan.recheck`."""
    found = recheck_certificate(plan.certificate)
    certified, driven = _path(plan.certificate.walked), plan.trajectory.position
    apart = {
        "legs": _apart(plan.waypoints, certified),
        "ends of the trajectory": float(np.abs(driven[[0, -1]] - certified[[0, -1]]).max()),
        "trajectory": float(distance_from_polyline(driven, certified).max()),
    }
    off = (
        Difference(f"distance of the {what} from the certified path", 0.0, distance)
        for what, distance in apart.items()
        if distance > OFF_PATH
    )
    return replace(found, differences=(*off, *found.differences))


def _walked_again(certificate: Certificate, accuracy: Accuracy | None = None) -> Certificate:
    stages = [
        certify(legs.scenario, legs.corners, accuracy=accuracy or legs.accuracy, arrival=legs.arrival)
        for legs in certificate.walked
    ]
    return joined_certificates(stages)


def _differences(stated: Certificate, again: Certificate) -> Iterator[Difference]:
    """Of all figures, those of targets and samples included."""
    for name in (entry.name for entry in fields(Certificate) if entry.name not in NOT_FIGURES):
        yield from _compared(name, getattr(stated, name), getattr(again, name))
    yield from _compared("problems", len(stated.problems), len(again.problems))
    yield from _compared("targets", len(stated.targets), len(again.targets))
    for number, (a, b) in enumerate(zip(stated.targets, again.targets, strict=False), start=1):
        for entry in fields(a):
            if entry.name != "name":
                yield from _compared(f"targets.{number}.{entry.name}", getattr(a, entry.name), getattr(b, entry.name))
    yield from _settling_differences(stated, again)
    yield from _sample_differences(stated, again)


def _settling_differences(stated: Certificate, again: Certificate) -> Iterator[Difference]:
    if stated.settling is None:
        return
    swinging = again.samples.leg >= stated.settling.first_leg
    least = again.samples.clearance_m[swinging].min(initial=np.inf)
    yield from _compared("settling.min_clearance_m", stated.settling.min_clearance_m, least)
    after = stated.settling.goal_predicted_after_m
    yield from _compared("settling.goal_predicted_after_m", after, again.goal_predicted_m)


def _sample_differences(stated: Certificate, again: Certificate) -> Iterator[Difference]:
    """Column by column, where the walks have the same samples; else their number is what differs."""
    count = len(stated.samples.leg), len(again.samples.leg)
    yield from _compared("samples", *count)
    if count[0] == count[1]:
        for entry in fields(stated.samples):
            a, b = getattr(stated.samples, entry.name), getattr(again.samples, entry.name)
            yield from _compared(f"samples.{entry.name}", a, b)


def _compared(figure: str, stated: Any, found: Any) -> Iterator[Difference]:
    """The largest difference of numbers or arrays beyond what rounding may do; nothing where there is none."""
    a, b = (np.asarray(np.nan if value is None else value, dtype=np.float64).ravel() for value in (stated, found))
    if a.shape != b.shape:
        yield Difference(f"{figure} (count)", len(a), len(b))
        return
    off = ~np.isclose(a, b, rtol=SHARE, atol=SAME, equal_nan=True)
    if off.any():
        gap = np.nan_to_num(np.abs(a - b), nan=np.inf)
        k = int(np.argmax(np.where(off, gap, -1.0)))
        yield Difference(figure, float(a[k]), float(b[k]))


def _path(walked: tuple[CertifiedLegs, ...]) -> Array:
    """(K, m) corners of all stages one after the other, K >= 2."""
    corners = np.concatenate([legs.corners for legs in walked])
    return corners if len(corners) > 1 else np.repeat(corners, 2, axis=0)


def _apart(path: Array, other: Array) -> float:
    """Largest difference of a joint at the corners of two paths (K, m), (L, m) [rad or m]; inf if not as many."""
    a, b = merge_legs(path), merge_legs(other)
    return float(np.abs(a - b).max()) if a.shape == b.shape else float(np.inf)
