"""Closing the openings of a surface: small ones anywhere, large ones where a cut is flat; the rest is refused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from ctrplan.anatomy.mesh_repair import Indices, MeshRefusal, odd_edges, odd_edges_counted
from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M

Repair = Literal["off", "holes", "caps"]

FARTHEST_M = 2e-3  # of a patch from any vertex: what a hole may be closed by without being asked
FLAT_M = 0.3e-3  # of a cut from its plane
LONGEST = 5000  # edges of an opening
SHARES = np.array([[1, 1, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]], float)


@dataclass(frozen=True, eq=False)
class Opening:
    """A loop of edges at which a surface ends."""

    loop: Indices  # (n,) vertices in order
    middle_m: Array  # (3,)
    across_m: float
    off_plane_m: float  # largest distance of its vertices from their plane
    normal: Array  # (3,) of that plane

    @property
    def place(self) -> str:
        """Where, for a sentence."""
        x, y, z = self.middle_m * MM_PER_M
        return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"


def closed(vertices: Array, faces: Indices, repair: Repair) -> tuple[Indices, tuple[str, ...]]:
    """Triangles (F, 3) without openings, and notes of what was closed. Raises MeshRefusal for what can't be."""
    if repair == "off" or not len(odd_edges(faces)):
        return faces, ()
    patches, notes, tree = [], [], cKDTree(vertices)
    for opening in openings(vertices, faces):
        patch = triangulated(vertices, opening)
        away = _away_m(vertices[patch], tree)
        if away > FARTHEST_M and not (repair == "caps" and opening.off_plane_m <= FLAT_M):
            raise MeshRefusal(_too_large(opening, away, repair), opening.middle_m)
        patches.append(patch)
        notes.append((away, opening))
    return np.concatenate([faces, *patches]), (_note(notes),)


def openings(vertices: Array, faces: Indices) -> list[Opening]:
    """The loops at which the surface ends. Raises MeshRefusal where they can't be told apart."""
    edges, counts = odd_edges_counted(faces)
    if (branch := np.flatnonzero(counts > 1)).size:
        _undecided(vertices[edges[branch[0]]].mean(axis=0), f"{counts[branch[0]]} triangles meet at an edge")
    ends, where, met = np.unique(edges, return_inverse=True, return_counts=True)
    if (crossed := np.flatnonzero(met != 2)).size:
        _undecided(vertices[ends[crossed[0]]], "several openings meet at a vertex")
    rows = np.argsort(where.reshape(-1), kind="stable").reshape(-1, 2) // 2  # the two edges of each end
    pairs = where.reshape(-1, 2)
    left, loops = np.ones(len(edges), bool), []
    for first in range(len(edges)):
        if left[first]:
            loops.append(ends[_walked(first, pairs, rows, left)])
    return [_opening(vertices, loop) for loop in loops]


def _walked(edge: int, pairs: Indices, rows: Indices, left: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    loop, at = [], int(pairs[edge, 0])
    while left[edge]:
        left[edge] = False
        loop.append(at)
        at = int(pairs[edge].sum()) - at
        edge = int(rows[at].sum()) - edge
    return loop


def _opening(vertices: Array, loop: Indices) -> Opening:
    points = vertices[loop]
    middle = points.mean(axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    across = float(np.linalg.norm(np.ptp((points - middle) @ axes.T, axis=0)))
    return Opening(loop, middle, across, float(np.abs((points - middle) @ axes[2]).max()), axes[2])


def triangulated(vertices: Array, opening: Opening) -> Indices:
    """Triangles (n - 2, 3) over a loop: the ear of the shortest new edge first, within the loop where it is flat."""
    loop = opening.loop.tolist()
    if len(loop) > LONGEST:
        rule = f"has an opening of {len(loop)} edges at {opening.place}: must have at most {LONGEST}"
        raise MeshRefusal(rule, opening.middle_m)
    axes = np.linalg.svd(opening.normal[None])[2][1:]
    flat = (vertices[opening.loop] - opening.middle_m) @ axes.T
    points, turn = vertices[opening.loop], np.sign(_area(flat)) or 1.0
    left, triangles = np.arange(len(loop)), []
    while len(left) > 3:
        before, after = np.roll(left, 1), np.roll(left, -1)
        order = np.argsort(((points[before] - points[after]) ** 2).sum(axis=1), kind="stable")
        ear = next((k for k in order if _is_ear(flat, turn, left, before[k], left[k], after[k])), order[0])
        triangles.append([before[ear], left[ear], after[ear]])
        left = np.delete(left, ear)
    return np.asarray(opening.loop[np.array([*triangles, left])], dtype=np.int64)


def _area(flat: Array) -> float:
    x, y = flat.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def _is_ear(flat: Array, turn: float, left: Indices, a: int, b: int, c: int) -> bool:
    """Whether corner b of the flat loop points outward and no other corner lies in its triangle."""
    p, q, r = flat[a], flat[b], flat[c]

    def side(u: Array, v: Array, x: Array) -> Array:
        return np.asarray(turn * ((v[0] - u[0]) * (x[..., 1] - u[1]) - (v[1] - u[1]) * (x[..., 0] - u[0])))

    if side(p, q, r) <= 0:
        return False
    others = flat[left[(left != a) & (left != b) & (left != c)]]
    return not ((side(p, q, others) > 0) & (side(q, r, others) > 0) & (side(r, p, others) > 0)).any()


def _away_m(corners: Array, tree: cKDTree) -> float:
    """How far the points of triangles (F, 3, 3) lie from the nearest vertex of the mesh, at the most."""
    shares = SHARES / SHARES.sum(axis=1, keepdims=True)
    samples = np.einsum("sk,fkx->fsx", shares, corners).reshape(-1, 3)
    return float(tree.query(samples)[0].max())


def _note(closed_: list[tuple[float, Opening]]) -> str:
    away, widest = max(closed_, key=lambda pair: pair[0])
    count = "one opening was" if len(closed_) == 1 else f"{len(closed_)} openings were"
    at = "at" if len(closed_) == 1 else "the widest at"
    return (
        f"{count} closed, {at} {widest.place}, {widest.across_m * MM_PER_M:.2g} mm across, by a patch up to "
        f"{away * MM_PER_M:.2g} mm from any vertex"
    )


def _too_large(opening: Opening, away_m: float, repair: Repair) -> str:
    away, most = away_m * MM_PER_M, FARTHEST_M * MM_PER_M
    limit = f"a patch would lie {away:.2g} mm from any vertex, must lie within {most:g} mm"
    flat = opening.off_plane_m <= FLAT_M and repair != "caps"
    advice = (
        "it is flat, repair = 'caps' closes it"
        if flat
        else "close it where the mesh was made, or say kind = 'surface' if it is a sheet to keep away from"
    )
    return f"is open at {opening.place}, {opening.across_m * MM_PER_M:.3g} mm across: {limit} ({advice})"


def _undecided(place_m: Array, what: str) -> None:
    x, y, z = place_m * MM_PER_M
    rule = "inside and outside can't be told apart: clean it where the mesh was made, or say kind = 'surface'"
    raise MeshRefusal(f"is not closed at ({x:.2f}, {y:.2f}, {z:.2f}) mm, where {what}: {rule}", place_m)
