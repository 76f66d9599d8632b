"""Stations common to all tubes of a configuration: places where links meet and where contact is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hidden_effects.tube import Array, Tube

SAME_PLACE_M = 1e-6


@dataclass(frozen=True)
class Fineness:
    """Length of links where forces concentrate and elsewhere, growth from link to link, links per shape function."""

    finest_m: float = 0.35e-3
    coarsest_m: float = 2.0e-3
    growth: float = 1.2
    links_per_node: int = 4

    @staticmethod
    def searching() -> Fineness:
        """Coarse, to see where contact is."""
        return Fineness(2e-3, 8e-3, 1.4, 2)

    def halved(self) -> Fineness:
        return Fineness(self.finest_m / 2, self.coarsest_m / 2, self.growth**0.5, self.links_per_node)


def stations(tubes: Sequence[Tube], l_b: Array, fineness: Fineness, contacts_m: Sequence[float] = ()) -> Array:
    """Arc lengths (K,) [m] from the innermost collar to the foremost tip.

    Graded towards collars, joints, tips, and the places where a coarser solution has found contact.
    """
    places = sorted([0.0] + [base + x for tube, base in zip(tubes, l_b.tolist(), strict=True) for x in tube.joints_m])
    near = 4 * fineness.finest_m
    places = sorted(places + [s for s in contacts_m if min(abs(s - place) for place in places) > near])
    places = [place for place in places if place >= l_b[-1] - SAME_PLACE_M]
    corners = [places[0]] + [b for a, b in zip(places[:-1], places[1:], strict=True) if b - a > SAME_PLACE_M]
    pieces = [a + graded(b - a, fineness) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    return np.concatenate([[corners[0]], *pieces])


def graded(length_m: float, fineness: Fineness) -> Array:
    """Ends of links that grow from both ends of an interval towards its middle; the last one is `length_m`."""
    half, h = [0.0], fineness.finest_m
    while half[-1] < length_m / 2:
        half.append(half[-1] + h)
        h = min(h * fineness.growth, fineness.coarsest_m)
    ends = np.array(half) * (length_m / 2 / half[-1])
    return np.concatenate([ends[1:], length_m - ends[-2::-1]])
