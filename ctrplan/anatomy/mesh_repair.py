"""Repairing a triangle mesh: cracks welded, holes closed, winding made consistent, or refused with the place named."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Indices = NDArray[np.int64]

BESIDE = 1e-3  # of a triangle's size: how far from it the sides are looked at
WELD_M = 1e-6  # vertices closer than this are one: a crack that no robot and no scanner can tell from a closed seam

logger = logging.getLogger(__name__)


class MeshRefusal(Exception):
    """A rule that a mesh breaks, as the end of a sentence; whoever reads the mesh says where it was named.

    place_m: (3,) where in the file's frame, of what has a place.
    """

    def __init__(self, rule: str, place_m: Array | None = None) -> None:
        """rule: see the class."""
        self.place_m = place_m
        super().__init__(rule)


def welded(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """The mesh with coinciding vertices merged, and if that leaves it open, those within WELD_M too.

    Raises MeshRefusal where it stays open.
    """
    vertices, faces = merged(vertices, faces)
    refuse_open(vertices, faces)
    return vertices, faces


def refuse_open(vertices: Array, faces: Indices) -> None:
    """Raises MeshRefusal for a mesh that is not closed."""
    odd = odd_edges(faces)
    if len(odd):
        # The place is reported in the file's own frame, as the viewer of the mesh shows it (but in mm).
        place = vertices[odd[0]].mean(axis=0)
        x, y, z = place * 1e3
        count = f"{len(odd)} open edge{'s' if len(odd) > 1 else ''}"
        raise MeshRefusal(f"is not closed: has {count}, one at ({x:.2f}, {y:.2f}, {z:.2f}) mm, must have none", place)


def merged(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """The mesh with coinciding vertices merged, and, if that leaves it open, those within WELD_M; maybe still open."""
    import igl  # slow to import
    from scipy.sparse import coo_matrix  # slow to import
    from scipy.sparse.csgraph import connected_components  # slow to import
    from scipy.spatial import cKDTree  # slow to import

    vertices, faces = _without_strays(vertices, faces)  # whose coordinates may be NaN
    unique, _, index = igl.remove_duplicate_vertices(vertices, 0.0)
    exact = np.asarray(unique), _distinct(np.asarray(index)[faces])
    if not len(odd_edges(exact[1])):
        return _without_strays(*exact)

    pairs = cKDTree(unique).query_pairs(WELD_M, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(unique), len(unique)))
    _, group = connected_components(graph, directed=False)
    _, first = np.unique(group, return_index=True)
    welded = unique[first], _distinct(group[exact[1]].astype(np.int64))
    if not len(odd_edges(welded[1])):
        logger.info("welded vertices less than %g mm apart to close the mesh", WELD_M * 1e3)
    return _without_strays(*welded)


def _without_strays(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    used = np.bincount(faces.reshape(-1), minlength=len(vertices)) > 0
    index = np.cumsum(used) - 1
    return np.ascontiguousarray(vertices[used]), np.ascontiguousarray(index[faces], dtype=np.int64)


def _distinct(faces: Indices) -> Indices:
    """Triangles with three different corners, each winding of each kept once."""
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    start = np.argmin(faces, axis=1)[:, None]
    turned = np.take_along_axis(faces, (start + np.arange(3)) % 3, axis=1)
    leading = np.sort(turned[:, 0] * (faces.max(initial=0) + 1) + turned[:, 1])
    if (leading[1:] != leading[:-1]).all():  # nearly always, and much faster than looking at whole triangles
        return faces
    _, first = np.unique(turned, axis=0, return_index=True)
    return faces[np.sort(first)]


def _edge_keys(faces: Indices) -> tuple[Indices, Array]:
    """For each side (3F,) of the triangles one number for its edge, and the direction +1 or -1 it takes along it."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    keys = np.minimum(start, end) * (faces.max(initial=0) + 1) + np.maximum(start, end)
    return keys, np.where(start < end, 1.0, -1.0)


def _edges(keys: Indices, faces: Indices) -> Indices:
    return np.stack(np.divmod(keys, faces.max(initial=0) + 1), axis=1)


def odd_edges(faces: Indices) -> Indices:
    """Edges (E, 2) at which an odd number of triangles meet: a surface ends there, or one branches off."""
    return odd_edges_counted(faces)[0]


def odd_edges_counted(faces: Indices) -> tuple[Indices, Indices]:
    """The odd edges (E, 2), and how many triangles (E,) meet there."""
    keys, count = np.unique(_edge_keys(faces)[0], return_counts=True)
    odd = count % 2 == 1
    return _edges(keys[odd], faces), count[odd]


def _unbalanced_edges(faces: Indices) -> Indices:
    """Edges (E, 2) that triangles do not run along equally often in both directions: the winding changes there."""
    keys, direction = _edge_keys(faces)
    unique, index = np.unique(keys, return_inverse=True)
    return _edges(unique[np.bincount(index.reshape(-1), weights=direction) != 0], faces)


def turned_outward(vertices: Array, faces: Indices) -> Indices:
    """Faces (F, 3) of a closed mesh, wound consistently with normals outward. Raises MeshRefusal if it is open."""
    given = faces
    if not len(faces):
        raise MeshRefusal("is empty: all its triangles are collapsed to lines")
    if len(_unbalanced_edges(faces)):
        faces, body = _consistent(vertices, faces)
    else:
        body = _bodies(faces)
    faces = _outermost_outward(vertices, faces, body)
    _refuse_inside_out(vertices, faces)
    turned = int((faces != given).any(axis=1).sum())
    if turned:
        logger.info("turned %d of %d triangles so that the surface faces outward", turned, len(faces))
    if _volumes(vertices, faces, np.zeros(len(faces), dtype=np.int64))[0] <= 0:
        raise MeshRefusal("encloses no volume: must be a closed body")
    return np.ascontiguousarray(faces)


def _bodies(faces: Indices) -> Indices:
    """Body (F,) of each triangle: closed patches where bodies touch along an edge, else what shares vertices."""
    import igl  # slow to import

    patch = np.asarray(igl.orientable_patches(faces))
    return patch if _are_closed(faces, patch) else np.asarray(igl.vertex_components(faces))[faces[:, 0]]


def _are_closed(faces: Indices, patch: Indices) -> bool:
    """Whether each patch (F,) is closed without the others."""
    _, apart = np.unique(faces + patch[:, None] * (faces.max() + 1), return_inverse=True)
    return not len(odd_edges(apart.reshape(-1, 3)))


def _refuse_inside_out(vertices: Array, faces: Indices) -> None:
    """Raises MeshRefusal where patches that share walls and are closed together only do not bound one solid."""
    import igl  # slow to import

    patch = np.asarray(igl.orientable_patches(faces))
    if _are_closed(faces, patch):
        return
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    largest = np.array([rows[np.argmax(area[rows])] for rows in map(np.flatnonzero, _each(patch))])
    step = BESIDE * normal[largest] / np.sqrt(area[largest])[:, None]
    middle = corners[largest].mean(axis=1)
    behind, before = (np.asarray(igl.winding_number(vertices, faces, middle + s * step)) for s in (-1, 1))
    wrong = np.flatnonzero((behind < 0.5) | (before < -0.5))
    if len(wrong):
        x, y, z = middle[wrong[0]] * 1e3
        rule = "its bodies share walls and can't be told apart, must bound a solid on one side"
        raise MeshRefusal(f"can't be turned outward at ({x:.2f}, {y:.2f}, {z:.2f}) mm: {rule}", middle[wrong[0]])


def _each(patch: Indices) -> Iterator[NDArray[np.bool_]]:
    return (patch == number for number in np.unique(patch))


def _consistent(vertices: Array, faces: Indices) -> tuple[Indices, Indices]:
    """Winding made consistent within each patch, following the larger part of the patch's area in the file."""
    import igl  # slow to import

    oriented, patch = (np.asarray(a) for a in igl.bfs_orient(faces))
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    vote = np.bincount(patch, weights=np.where((oriented == faces).all(axis=1), area, -area))
    turned = np.where((vote < 0)[patch][:, None], oriented[:, ::-1], oriented)
    bad = _unbalanced_edges(turned)  # one-sided, or patches that end at edges of more triangles and do not go together
    if len(bad):
        where = vertices[bad[0]].mean(axis=0)
        x, y, z = where * 1e3
        place = f"({x:.2f}, {y:.2f}, {z:.2f}) mm"
        raise MeshRefusal(f"can't be turned outward: its two sides meet at {place}, must bound a solid", where)
    return turned, patch


def _volumes(vertices: Array, faces: Indices, body: Indices) -> Array:
    corners = (vertices - vertices.mean(axis=0))[faces]
    tetrahedra = np.einsum("ki,ki->k", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    return np.asarray(np.bincount(body, weights=tetrahedra), dtype=np.float64)


def _outermost_outward(vertices: Array, faces: Indices, body: Indices) -> Indices:
    """Turn each outermost body outward, and with it all that lies within: cavities stay cavities."""
    body = np.unique(body, return_inverse=True)[1].reshape(-1)
    volume = _volumes(vertices, faces, body)
    if not (volume < 0).any():
        return faces
    within = _bodies_within(vertices, faces, body)
    outermost = ~within.any(axis=0)
    flip = outermost & (volume < 0)
    flip |= within[flip].any(axis=0)
    return np.where(flip[body][:, None], faces[:, ::-1], faces)


def _bodies_within(vertices: Array, faces: Indices, body: Indices) -> NDArray[np.bool_]:
    """(B, B) matrix: entry (a, b) tells that body b lies within body a."""
    import igl  # slow to import

    count = int(body.max()) + 1
    members = np.split(np.argsort(body, kind="stable"), np.cumsum(np.bincount(body))[:-1])
    corners = [vertices[faces[rows]].reshape(-1, 3) for rows in members]
    lower, upper = np.array([c.min(axis=0) for c in corners]), np.array([c.max(axis=0) for c in corners])
    sample = np.array([c[0] for c in corners])
    within = np.zeros((count, count), dtype=bool)
    for a in range(count):
        nested = np.flatnonzero((lower > lower[a]).all(axis=1) & (upper < upper[a]).all(axis=1))
        if len(nested):
            winding = igl.fast_winding_number(vertices, np.ascontiguousarray(faces[members[a]]), sample[nested])
            within[a, nested] = np.abs(winding) > 0.5
    return within


@dataclass(frozen=True, eq=False)
class MeshDefect:
    """In the file's frame, m."""

    file: Path
    surface: Surface
    place_m: Array  # (3,)

    @property
    def edges(self) -> Indices:
        """Edges (E, 2) at which the surface ends, or one branches off."""
        return odd_edges(self.surface.faces)


class MeshDefectError(InputError):
    """The refusal of a mesh that has a place."""

    def __init__(self, refusal: InputError, defect: MeshDefect) -> None:
        """Says what `refusal` says."""
        super().__init__(refusal.rule, file=refusal.file, key=refusal.key, value=refusal.value, unit=refusal.unit)
        self.defect = defect


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
    from scipy.spatial import cKDTree  # slow to import

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
