"""One structure of the anatomy, and the clearance that several of them leave to a point.

The clearance of a point is the minimum over the parts to avoid of (distance outside the part - its margin). Several
lumens are one room: the robot stays within their union, so of the parts with role "inside" the largest of (distance
inside the part - its margin) counts, and the minimum is then taken with the parts to avoid. Near the seam of two
overlapping lumens this is less than the distance to the wall of their union, never more. Every distance is to a surface
and therefore 1-Lipschitz, and so is the clearance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.anatomy.shape import Role, Shape
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, InputError

CHUNK_POINTS = 1 << 18


@dataclass(frozen=True, eq=False)
class AnatomyPart:
    """A shape of the anatomy and what the robot has to do with it; compared and hashed by identity.

    role: "avoid" (the robot stays outside) or "inside" (the robot stays within the union of all such parts).
    margin_m: distance to keep from the surface on the allowed side [m]. Raises InputError for another role or margin.
    """

    shape: Shape
    role: Role = "avoid"
    margin_m: float = 0.0

    def __post_init__(self) -> None:
        """Checks role and margin; the shape has checked itself."""
        if self.role not in ("avoid", "inside"):
            raise InputError("must be 'avoid' or 'inside'", key="role", value=self.role)
        if not (np.isfinite(self.margin_m) and self.margin_m >= 0):
            raise InputError("must be a finite number, zero or more", key="margin_m", value=self.margin_m, unit="m")

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,), (3,) [m] of what the shape lies within."""
        return self.shape.box()


def surface_distance(part: AnatomyPart, points_m: Array) -> Array:
    """Distance of points (K, 3) [m] to the part's surface, (K,) [m], negative within the part.

    Raises CtrplanError where the part's kind says something that is no distance.
    """
    distance = np.empty(len(points_m))
    for k in range(0, len(points_m), CHUNK_POINTS):
        points = points_m[k : k + CHUNK_POINTS]
        chunk = part.shape.distance(points)
        if np.shape(chunk) != (len(points),) or np.isnan(chunk).any():
            raise CtrplanError(f"Anatomy of kind {part.shape.kind!r} must say a distance for every point.")
        distance[k : k + CHUNK_POINTS] = chunk
    return distance


def combined_clearance(
    parts: Sequence[AnatomyPart], distance: Callable[[AnatomyPart], NDArray[np.floating]]
) -> NDArray[np.floating]:
    """Clearance from each part's `distance` (negative within the part), all arrays of one shape [m]; see the module."""
    avoid: NDArray[np.floating] | None = None
    inside: NDArray[np.floating] | None = None
    for part in parts:
        value = distance(part)
        if part.role == "inside":
            np.negative(value, out=value)
            value -= part.margin_m
            inside = value if inside is None else np.maximum(inside, value, out=inside)
        else:
            value -= part.margin_m
            avoid = value if avoid is None else np.minimum(avoid, value, out=avoid)
    if avoid is None or inside is None:
        result = inside if avoid is None else avoid
        if result is None:
            raise ValueError("combined_clearance needs at least one part")
        return result
    np.minimum(avoid, inside, out=avoid)
    return avoid


def exact_clearance(parts: Sequence[AnatomyPart], points_m: ArrayLike) -> Array:
    """Clearance (K,) [m] that the parts leave to points (K, 3) [m], without a grid; inf where there are no parts.

    Raises InputError when a coordinate is not finite.
    """
    points = np.ascontiguousarray(points_m, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise InputError("must be finite to have a clearance", key="points_m", unit="m")
    if not parts:
        return np.full(len(points), np.inf)
    return np.asarray(combined_clearance(parts, lambda part: surface_distance(part, points)), dtype=np.float64)
