"""Make the anatomy meshes of the scenarios: binary STL in millimetres, the same bytes on every run and machine.

    python scenarios/make_meshes.py [DIRECTORY]        (default: meshes/ beside this script)

All are surfaces swept along a space curve, lengths in mm. Coordinates are rounded to 0.1 um so that the last bit of a
platform's mathematical functions does not show. `sweep_tube` and `space_curve` serve further scenarios too.
"""

import os
import struct
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Mesh = tuple[Array, NDArray[np.int64]]
Profile = Callable[[Array], Array]

HEADER = b"ctrplan anatomy, binary STL, millimetres"
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


def _blend(s: Array, begin: float, end: float) -> Array:
    """Smooth step from 0 at begin to 1 at end."""
    t = np.clip((s - begin) / (end - begin), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def vessel() -> Mesh:
    """A vessel 205 mm long: a trunk of 13 mm radius that bends with 300 mm radius, as the proximal tubes of the robot
    of Table II do, and from 150 mm on a branch of 9 mm radius that turns off with 75 mm radius, out of the trunk's
    plane.
    """

    def kx(s: Array) -> Array:
        return _blend(s, 10, 30) / 300 + _blend(s, 162, 174) * (0.7 / 75 - 1 / 300)

    def ky(s: Array) -> Array:
        return _blend(s, 162, 174) * 0.7 / 75

    centreline = space_curve(205 - FRONT_MM, 84, kx, ky, (0, 0, FRONT_MM))
    s = np.linspace(0, 205 - FRONT_MM, 84)
    return sweep_tube(centreline, 13 - 4 * _blend(s, 150, 195), 32)


def ribs() -> Mesh:
    """Four ribs across the way 75 mm ahead, 20 mm apart in y: 8 mm thick, arcs of 90 mm radius, with rounded ends."""
    return joined(_rib(y) for y in (-30.0, -10.0, 10.0, 30.0))


def _rib(y: float, radius: float = 4.0, arc_radius: float = 90.0, half_angle: float = 0.6) -> Mesh:
    length = 2 * arc_radius * half_angle
    # Towards each end the nodes crowd as on a hemisphere's meridian.
    cap = radius * (1 - np.cos(np.linspace(0, np.pi / 2, 7)))
    along = np.concatenate([cap[:-1], np.linspace(radius, length - radius, 40), length - cap[-2::-1]])
    angle = along / arc_radius - half_angle
    centreline = np.stack(
        [arc_radius * np.sin(angle), np.full_like(along, y), 75 + arc_radius * (1 - np.cos(angle))], axis=1
    )
    to_end = np.minimum(np.minimum(along, length - along), radius)
    return sweep_tube(centreline, np.sqrt(to_end * (2 * radius - to_end)), 16)


def heart_chamber() -> Mesh:
    """A vein of 9 mm radius that widens into a chamber 40 mm across and 50 mm long, its far end 160 mm ahead.

    The proportions are those of an inferior vena cava and right atrium within the normal range of adults (Lang et al.
    2015, J. Am. Soc. Echocardiogr. 28:1-39). The way there bends with a radius of 240 mm.
    """
    length, inlet, across, half_length = 160 - FRONT_MM, 9.0, 20.0, 25.0
    s_centre = length - half_length

    def kx(s: Array) -> Array:
        return (_blend(s, 20, 45) - _blend(s, 115, 140)) / 240

    # Equal steps along the vein, equal steps of the ellipse's angle in the chamber.
    angle = np.linspace(np.pi * 0.78, 0, 44)
    s = np.concatenate(
        [np.linspace(0, s_centre + half_length * np.cos(angle[0]), 40)[:-1], s_centre + half_length * np.cos(angle)]
    )
    fine = space_curve(length, 401, kx, lambda s: np.zeros_like(s), (0, 0, FRONT_MM))
    centreline = np.stack([np.interp(s, np.linspace(0, length, 401), axis) for axis in fine.T], axis=1)
    ellipse = across * np.sqrt(np.clip(1 - ((s - s_centre) / half_length) ** 2, 0, None))
    opening = (inlet**6 + ellipse**6) ** (1 / 6)  # the larger of the two, without an edge where they meet
    opening = inlet + (opening - inlet) * _blend(s, s_centre - 1.2 * half_length, s_centre)
    radius = np.where(s < s_centre, opening, ellipse)
    return sweep_tube(centreline, radius, 32)


def stl_bytes(vertices: Array, faces: NDArray[np.int64]) -> bytes:
    """Binary STL, coordinates rounded to 1e-4 mm."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.round(vertices, 4)[faces] + 0.0  # + 0.0 turns -0.0 into 0.0
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = np.zeros(len(faces), dtype=record)
    triangles["corners"] = corners
    triangles["normal"] = np.round(normal / np.linalg.norm(normal, axis=1)[:, None], 4) + 0.0
    return HEADER.ljust(80) + struct.pack("<I", len(faces)) + triangles.tobytes()


MESHES: dict[str, Callable[[], Mesh]] = {"vessel": vessel, "ribs": ribs, "heart_chamber": heart_chamber}


def make_meshes(directory: Path) -> list[Path]:
    """Write all meshes into the directory, each to a temporary name first, and return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, make in MESHES.items():
        path = directory / f"{name}.stl"
        temporary = path.with_suffix(".part")
        temporary.write_bytes(stl_bytes(*make()))
        os.replace(temporary, path)
        paths.append(path)
    return paths


if __name__ == "__main__":
    for written in make_meshes(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "meshes"):
        print(f"{written}  {written.stat().st_size / 1e3:.0f} kB")
