"""Several targets in order: the certificates of a plan's stages put together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.planning.certified import Certificate, CertificateSamples, Closest, TargetReached

if TYPE_CHECKING:
    from ctrplan.mechanics.accuracy import Accuracy


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
