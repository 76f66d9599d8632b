"""One structure of the anatomy, and the clearance that several of them leave to a point.

The clearance of a point is the minimum over the parts to avoid of (distance outside the part - its margin). Several
lumens are one room: the robot stays within their union, so of the parts with role "inside" the largest of (distance
inside the part - its margin) counts, and the minimum is then taken with the parts to avoid. Near the seam of two
overlapping lumens this is less than the distance to the wall of their union, never more. Every distance is to a surface
and therefore 1-Lipschitz, and so is the clearance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import igl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError

CHUNK_POINTS = 1 << 18


@dataclass(frozen=True, eq=False)
class AnatomyPart:
    """A sphere, capsule or closed triangle mesh in the anatomy's frame; compared and hashed by identity.

    kind: "sphere" (center_m (3,), radius_m), "capsule" (from_m (3,), to_m (3,), radius_m) or "mesh" (vertices_m (V, 3),
    faces (F, 3), closed and turned outward, as `ctrplan.anatomy.clearance_grid.load_mesh` returns them).
    role: "avoid" (the robot stays outside) or "inside" (the robot stays within the union of all such parts).
    margin_m: distance to keep from the surface on the allowed side [m]. file: where a mesh came from, for messages.
    Arrays are copied and made read-only. Raises InputError for a missing, malformed or non-finite quantity.
    """

    kind: str
    role: str = "avoid"
    margin_m: float = 0.0
    center_m: Array | None = None
    radius_m: float | None = None
    from_m: Array | None = None
    to_m: Array | None = None
    vertices_m: Array | None = None
    faces: NDArray[np.int64] | None = None
    file: str | None = None

    def __post_init__(self) -> None:
        """Checks the quantities of the kind and copies its arrays."""
        if self.kind not in _QUANTITIES:
            raise InputError("must be 'sphere', 'capsule' or 'mesh'", key="kind", value=self.kind)
        if self.role not in ("avoid", "inside"):
            raise InputError("must be 'avoid' or 'inside'", key="role", value=self.role)
        if not (np.isfinite(self.margin_m) and self.margin_m >= 0):
            raise InputError("must be a finite number, zero or more", key="margin_m", value=self.margin_m, unit="m")
        for name, checked in _QUANTITIES[self.kind].items():
            if getattr(self, name) is None:
                raise InputError(f"is required for a {self.kind}", key=name)
            object.__setattr__(self, name, checked(name, getattr(self, name)))
        if self.faces is not None and self.vertices_m is not None and self.faces.max() >= len(self.vertices_m):
            raise InputError(f"must hold vertex indices below {len(self.vertices_m)}", key="faces")


def _length(name: str, value: float) -> float:
    if not (np.isfinite(value) and value > 0):
        raise InputError("must be a finite number above zero", key=name, value=value, unit="m")
    return float(value)


def _point(name: str, value: ArrayLike) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError("must be three finite coordinates", key=name, value=value, unit="m")
    array.flags.writeable = False
    return array


def _points(name: str, value: ArrayLike) -> Array:
    array = np.array(value, dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != 3 or not array.size or not np.isfinite(array).all():
        raise InputError("must hold points of three finite coordinates", key=name, unit="m")
    array.flags.writeable = False
    return array


def _triangles(name: str, value: ArrayLike) -> NDArray[np.int64]:
    array = np.array(value, dtype=np.int64, order="C")
    if array.ndim != 2 or array.shape[1] != 3 or not array.size or array.min() < 0:
        raise InputError("must hold triangles of three vertex indices", key=name)
    array.flags.writeable = False
    return array


_QUANTITIES: dict[str, dict[str, Callable[[str, Any], Any]]] = {
    "sphere": {"center_m": _point, "radius_m": _length},
    "capsule": {"from_m": _point, "to_m": _point, "radius_m": _length},
    "mesh": {"vertices_m": _points, "faces": _triangles},
}


class _MeshDistance:
    """Signed distance to a closed mesh: nearest triangle from an AABB tree, sign from the fast winding number.

    Where bodies of one mesh overlap, a point in the overlap has winding number 2 and is inside as it should be.
    """

    def __init__(self, part: AnatomyPart) -> None:
        self.vertices_m, self.faces = part.vertices_m, part.faces
        self.tree, self.winding = igl.AABB(), igl.FastWindingNumberBVH()
        self.tree.init(self.vertices_m, self.faces)
        self.winding.init(self.vertices_m, self.faces)

    def __call__(self, points_m: Array) -> Array:
        squared = np.asarray(self.tree.squared_distance(self.vertices_m, self.faces, points_m)[0])
        inside = np.asarray(self.winding.winding_number(points_m)) > 0.5
        distance: Array = np.sqrt(squared)
        np.negative(distance, where=inside, out=distance)
        return distance


# Trees are expensive, so each lives as long as its part does.
_mesh_distances: WeakKeyDictionary[AnatomyPart, _MeshDistance] = WeakKeyDictionary()


def surface_distance(part: AnatomyPart, points_m: Array) -> Array:
    """Distance of points (K, 3) [m] to the part's surface, (K,) [m], negative within the part."""
    if part.kind == "sphere":
        assert part.center_m is not None and part.radius_m is not None
        return np.asarray(np.linalg.norm(points_m - part.center_m, axis=1) - part.radius_m)
    if part.kind == "capsule":
        return _capsule_distance(part, points_m)
    if part not in _mesh_distances:
        _mesh_distances[part] = _MeshDistance(part)
    distance = _mesh_distances[part]
    chunks = [distance(points_m[k : k + CHUNK_POINTS]) for k in range(0, len(points_m), CHUNK_POINTS)]
    return np.concatenate(chunks) if chunks else np.empty(0)


def _capsule_distance(part: AnatomyPart, points_m: Array) -> Array:
    assert part.from_m is not None and part.to_m is not None and part.radius_m is not None
    axis, offset = part.to_m - part.from_m, points_m - part.from_m
    length_squared = float(axis @ axis)
    along = np.clip(offset @ axis / length_squared, 0.0, 1.0) if length_squared > 0 else np.zeros(len(points_m))
    return np.asarray(np.linalg.norm(offset - along[:, None] * axis, axis=1) - part.radius_m)


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
