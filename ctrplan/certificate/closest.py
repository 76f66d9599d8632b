"""Where a robot comes closest to the anatomy, and the refusal that names the place.

The narrowest samples of a path are solved on the certificate mesh, with points close together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.parts import surface_distance
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.certificate.anatomy_distance import AnatomyDistance
from ctrplan.certificate.certificate import CertificateSamples, Closest
from ctrplan.certificate.friction_states import TIGHT_M, State, corner_states
from ctrplan.certificate.walked_piece import Piece
from ctrplan.motion.limits import TOO_CLOSE

if TYPE_CHECKING:
    from ctrplan.certificate.walked_legs import WalkedLegs
    from ctrplan.mechanics.friction import FrictionStates
    from ctrplan.scenario.scenario import Scenario

NEAR_M = 0.5e-3  # of the least clearance: samples that may be the narrowest on a finer mesh
MOST = 6  # of them solved
POINT_M = 0.25e-3


@dataclass(frozen=True)
class ClosestPlaces:
    """None in free space, and where nobody asked for all clearance that is left."""

    nominal: Closest | None = None
    friction: Closest | None = None
    certified: Closest | None = None


def closest_places(scenario: Scenario, pieces: Sequence[Piece], samples: CertificateSamples) -> ClosestPlaces:
    """The closest places of the frictionless robot, of the robot in all friction states that were narrow, and where
    the least
    clearance is certified, of samples that are certified alike the one that comes closest. None where a walk failed.
    """
    if (turned := AnatomyDistance.of(scenario)) is None:
        return ClosestPlaces()
    distance = turned.as_registered
    nominal = _rows(np.concatenate([p.nominal_m[k > 0 :] for k, p in enumerate(pieces)]))
    narrow = _rows(np.concatenate([_as_solved(scenario, p)[k > 0 :] for k, p in enumerate(pieces)]))
    phi = np.concatenate([p.phi[k > 0 :] for k, p in enumerate(pieces)])
    pairs = scenario.robot.n - 1
    rest: list[State] = [(0.0,) * pairs]
    at = cache(partial(_configuration, scenario, samples))
    results = [_closest(distance, samples, k, at(k), rest) for k in nominal.tolist()]
    corners = corner_states(pairs) if scenario.robot.friction.any() else []
    certified, variants = int(np.argmin(samples.clearance_m)), pieces[0].variants
    by_row: dict[int, Closest | None] = {}
    for k in dict.fromkeys([*narrow.tolist(), certified]):
        by_row[k] = _closest(distance, samples, k, at(k), [*rest, *corners, tuple(phi[k, :pairs].tolist())])
        for s in [tuple(phi[k, pairs:].tolist()), *corner_states(len(variants.large))] if variants.large else ():
            there = variants.configuration(variants.at(s), samples.joints[k], "certificate")
            other = _closest(distance, samples, k, there, [*rest, *corners, tuple(phi[k, :pairs].tolist())])
            by_row[k] = _least([by_row[k], other])
    least_m = samples.clearance_m[certified] + TIGHT_M
    tied = [(place.clearance_m, k) for k, place in by_row.items() if place and samples.clearance_m[k] <= least_m]
    narrowest = None
    if tied:
        _, k = min(tied)
        taken_m = causes(distance, pieces, samples, k, [*corners, tuple(phi[k, :pairs].tolist())])
        narrowest = replace(by_row[k], taken_m=taken_m)  # type: ignore[type-var]
    return ClosestPlaces(_least(results), _least([*by_row.values(), *results]), narrowest)


def causes(
    distance: AnatomyDistance,
    pieces: Sequence[Piece],
    samples: CertificateSamples,
    row: int,
    states: Sequence[State],
) -> dict[str, float]:
    """What is taken off the frictionless robot's clearance at a sample until the certified one is left [m], by cause.

    Friction by the shapes solved. What intervals, play and registration took together is shared among them in
    proportion to what each takes alone, friction as it is worst. The rest is what allowances take.
    """
    scenario, variants = distance.scenario, pieces[0].variants
    at = [(piece, k) for number, piece in enumerate(pieces) for k in range(number > 0, len(piece.theta_b))]
    piece, sample = at[row]

    def least_m(there: FrictionStates, friction: Sequence[State]) -> float:
        place = _closest(distance, samples, row, there, list(friction))
        return -np.inf if place is None else place.clearance_m

    own, released = _configuration(scenario, samples, row), (0.0,) * (scenario.robot.n - 1)
    alone_m, every = least_m(own, [released]), [released, *states]
    with_friction_m = least_m(own, every)
    singly: dict[str, float] = {}
    for axis in range(variants.count):
        ends = (variants.configuration(variants.end(axis, s), samples.joints[row], "certificate") for s in (-1.0, 1.0))
        name = variants.title(axis)
        singly[name] = singly.get(name, 0.0) + max(with_friction_m - min(least_m(end, every) for end in ends), 0.0)
    if not scenario.registration.is_exact:
        base, reach_m = variants.base, float(np.linalg.norm(samples.tip_m[row]))
        singly["registration"] = base.shift_m + base.rotation_rad * reach_m
    total, certified_m = sum(singly.values()), float(samples.clearance_m.min())
    together_m = min(float(piece.taken_m[sample]), with_friction_m - certified_m)
    shares = {name: together_m * part / total for name, part in singly.items()} if total > 0 else {}
    taken = {"friction": alone_m - with_friction_m, **shares}
    return {**taken, "motion between samples, meshes, uneven friction": alone_m - certified_m - sum(taken.values())}


def _as_solved(scenario: Scenario, piece: Piece) -> Array:
    """(K,) clearance of the frictionless and the corner shapes, nothing taken off: which samples are the narrowest.

    What is taken off depends on the mesh, and cells are looked into only until they keep enough: neither may choose.
    """
    clearance: Array = piece.as_walked_m + piece.offset_m(scenario, piece.accuracy)
    return clearance


def _least(results: Sequence[Closest | None]) -> Closest | None:
    """The closest of the states that were solved."""
    return min(filter(None, results), key=lambda place: place.clearance_m, default=None)


def _rows(clearance_m: Array) -> NDArray[np.intp]:
    """Indices of the narrowest samples (K,)."""
    near = np.flatnonzero(clearance_m <= np.nanmin(clearance_m) + NEAR_M)
    return near[np.argsort(clearance_m[near], kind="stable")][:MOST]


def _configuration(scenario: Scenario, samples: CertificateSamples, row: int) -> FrictionStates:
    """The configuration of a sample, on the certificate mesh."""
    collars = scenario.robot.drive.collars(samples.joints[row])
    return scenario.robot.mechanics.friction_states(*collars, accuracy="certificate")


def _closest(
    distance: AnatomyDistance, samples: CertificateSamples, row: int, at: FrictionStates, states: list[State]
) -> Closest | None:
    """The closest place of a sample in friction states; None where none of them has an equilibrium."""
    scenario, robot = distance.scenario, distance.scenario.robot
    bodies = at.bodies(np.array(list(dict.fromkeys(states))), spacing_m=POINT_M)
    if not bodies.solved.any():
        return None
    points, count = bodies.point_m[bodies.solved].reshape(-1, 3), len(bodies.radius_m)
    near = distance.near(points, np.tile(bodies.radius_m, int(bodies.solved.sum())))
    located = scenario.located(points[near])
    radius = bodies.radius_m[near % count]
    apart, part = _nearest_part(scenario, located, radius)
    margins = np.array([part.margin_m for part in scenario.anatomy])
    k = int(np.argmin(apart - margins[part]))
    state = np.array(list(dict.fromkeys(states)))[bodies.solved][near[k] // count]
    return Closest(
        clearance_m=float(apart[k] - margins[part[k]]),
        distance_m=float(apart[k]),
        part=f"anatomy.{part[k] + 1} ({scenario.anatomy[part[k]].shape.name})",
        tube=int(np.argmin([abs(tube.outer_diameter_m / 2 - radius[k]) for tube in robot.tubes])) + 1,
        point_m=located[k],
        leg=int(samples.leg[row]),
        path_mm=float(samples.path_mm[row]),
        joints=samples.joints[row],
        phi=state,
    )


def _nearest_part(scenario: Scenario, located: Array, radius: Array) -> tuple[Array, NDArray[np.intp]]:
    """(K,) distance of the surface of a tube from the part that leaves it least, and which; lumens are one room."""
    parts = scenario.anatomy
    sides = np.array([1.0 if part.role == "avoid" else -1.0 for part in parts])
    distance = sides[:, None] * [surface_distance(part, located) for part in parts] - radius
    beyond = distance - np.array([part.margin_m for part in parts])[:, None]
    lumens = sides < 0
    if lumens.any():
        best = np.argmax(np.where(lumens[:, None], beyond, -np.inf), axis=0)
        beyond[lumens[:, None] & (np.arange(len(parts))[:, None] != best)] = np.inf
    nearest = np.argmin(beyond, axis=0)
    return distance[nearest, np.arange(len(located))], nearest


def failure_with_place(walk: WalkedLegs) -> str:
    """The walk's failure; of a clearance also the part, and where the tube is (on its centreline, anatomy's frame)."""
    failure = walk.failure
    if TOO_CLOSE not in failure:
        return failure
    place = closest_places(walk.scenario, walk.pieces, walk.samples).certified
    if place is None:
        return failure
    at = ", ".join(f"{x:.1f}" for x in place.point_m * MM_PER_M)
    frame = f" in {walk.scenario.frame}" if walk.scenario.frame else ""
    return f"{failure.rstrip('.')}; there tube {place.tube} is at [{at}] mm{frame}, nearest to {place.part}."
