"""Surfaces swept along a space curve, lengths in mm."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int64]]
Profile = Callable[[Array], Array]

FRONT_MM = -12.0  # meshes to stay inside begin behind the robot's front plate, so that its opening is well inside


def space_curve(length_mm: float, nodes: int, curvature_x: Profile, curvature_y: Profile, start_mm: ArrayLike) -> Array:
    """Curve (nodes, 3) of equal steps that leaves start_mm along +z and bends by the given curvatures [1/mm].

    curvature_x bends towards +x and curvature_y towards +y of a frame carried along without twist; both take arc
    lengths (K,) [mm]. Between nodes it is integrated in 20 chords along the middle direction of their arc.
    """
    substeps = 20 * (nodes - 1)
    step = length_mm / substeps
    middle = (np.arange(substeps, dtype=np.float64) + 0.5) * step
    kx, ky = curvature_x(middle), curvature_y(middle)
    position, frame = np.array(start_mm, dtype=np.float64), np.eye(3)
    curve = [position.copy()]
    for k in range(substeps):
        half = _rotation(np.array([-ky[k], kx[k], 0.0]) * step / 2)
        position = position + step * (frame @ half)[:, 2]
        frame = frame @ half @ half
        if (k + 1) % 20 == 0:
            curve.append(position.copy())
    return np.array(curve)


def _rotation(vector: Array) -> Array:
    """Rodrigues' formula for a rotation vector (3,) [rad]."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(angle / 2 / np.pi) ** 2 * cross @ cross
    )


def sweep_tube(centreline: ArrayLike, radius: ArrayLike, sides: int) -> Mesh:
    """Closed tube around centreline (N, 3) with radius (N,) at its nodes [mm]: vertices (V, 3), triangles (F, 3).

    Rings of `sides` vertices stand in rotation-minimising frames (double reflection; Wang et al. 2008, ACM Trans.
    Graph. 27:2), so that they do not twist. Both ends are closed by a fan; with radius zero they come to a point.
    """
    p, r = np.asarray(centreline, dtype=np.float64), np.asarray(radius, dtype=np.float64)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    tangent = np.gradient(p, arc, axis=0, edge_order=2)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    e1 = _minimally_rotating(p, tangent)
    e2 = np.cross(tangent, e1)
    angle = 2 * np.pi * np.arange(sides) / sides
    around = np.cos(angle)[:, None] * e1[:, None] + np.sin(angle)[:, None] * e2[:, None]
    ring = (r > 0).nonzero()[0]
    vertices = np.concatenate([(p[:, None] + r[:, None, None] * around)[ring].reshape(-1, 3), p[[0, -1]]])
    here = np.arange(sides)
    there = np.roll(here, -1)
    quads = [
        [k * sides + here, k * sides + there, (k + 1) * sides + there, (k + 1) * sides + here]
        for k in range(len(ring) - 1)
    ]
    first, last = len(ring) * sides, len(ring) * sides + 1
    back = (len(ring) - 1) * sides
    faces = [np.stack([a, b, c], axis=1) for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]
    faces.append(np.stack([np.full(sides, first), there, here], axis=1))
    faces.append(np.stack([np.full(sides, last), back + here, back + there], axis=1))
    return vertices, np.concatenate(faces).astype(np.int64)


def _minimally_rotating(p: Array, tangent: Array) -> Array:
    """First normal (N, 3) of a rotation-minimising frame, beginning next to the x axis."""
    start = np.eye(3)[np.argmin(np.abs(tangent[0]))]
    e1 = np.zeros(p.shape)
    e1[0] = start - (start @ tangent[0]) * tangent[0]
    e1[0] /= np.linalg.norm(e1[0])
    for k in range(len(p) - 1):
        v = p[k + 1] - p[k]
        normal, carried = (a - 2 / (v @ v) * (v @ a) * v for a in (e1[k], tangent[k]))
        w = tangent[k + 1] - carried
        e1[k + 1] = normal - (2 / (w @ w) * (w @ normal) * w if w @ w > 0 else 0)
    return e1


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """Several bodies as one mesh."""
    vertices, faces, count = [], [], 0
    for v, f in meshes:
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def blend(s: Array, begin: float, end: float) -> Array:
    """Smooth step from 0 at begin to 1 at end."""
    t = np.clip((s - begin) / (end - begin), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))
