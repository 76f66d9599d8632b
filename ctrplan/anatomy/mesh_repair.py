"""Repairing a triangle mesh: cracks welded, winding made consistent and outward, or refused with the place named."""

import logging
from collections.abc import Iterator

import igl
import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array

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
    vertices, faces = _without_strays(vertices, faces)  # whose coordinates may be NaN
    unique, _, index = igl.remove_duplicate_vertices(vertices, 0.0)
    exact = np.asarray(unique), _distinct(np.asarray(index)[faces])
    if not len(odd_edges(exact[1])):
        return _without_strays(*exact)
    from scipy.sparse import coo_matrix  # seldom needed, and slow to import
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

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
    """Likewise, and how many triangles (E,) meet there."""
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
    patch = np.asarray(igl.orientable_patches(faces))
    return patch if _are_closed(faces, patch) else np.asarray(igl.vertex_components(faces))[faces[:, 0]]


def _are_closed(faces: Indices, patch: Indices) -> bool:
    """Whether each patch (F,) is closed without the others."""
    _, apart = np.unique(faces + patch[:, None] * (faces.max() + 1), return_inverse=True)
    return not len(odd_edges(apart.reshape(-1, 3)))


def _refuse_inside_out(vertices: Array, faces: Indices) -> None:
    """Raises MeshRefusal where patches that share walls and are closed together only do not bound one solid."""
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
