"""How far a written plan stays from a patient's raw data: voxels as boxes, triangles as they are in the file.

Judges by as little of ctrplan as can be: joints are read from trajectory.csv, drive and base from the TOML files,
voxels by SimpleITK, STL by numpy; distances are below. Only the shape of the robot in a friction state is the core's.
"""

from __future__ import annotations

import csv
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomllib
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

import ctrplan

Array = np.ndarray
REACH_MM = 25.0  # of structures around the body that are looked at


@dataclass(frozen=True)
class Measured:
    """The narrowest place of a motion."""

    room_mm: float  # from the outer surface to the structure's voxels or triangles, margin taken off
    part: str
    time_s: float
    point_mm: Array  # (3,) of the centreline, patient's frame
    states: int  # shapes that were looked at


def measured_clearance(scenario_file: Path, robot_file: Path, plan_folder: Path, moments: int = 40) -> Measured:
    """The least room of a plan's motion in the frictionless state and every corner of friction."""
    scenario, robot = (tomllib.loads(path.read_text()) for path in (scenario_file, robot_file))
    bodies = list(_bodies(scenario, robot, robot_file, plan_folder, moments))
    points = np.concatenate([body for _, body, _ in bodies])
    radii = np.concatenate([radius for _, _, radius in bodies])
    times = np.concatenate([np.full(len(body), time) for time, body, _ in bodies])
    best = (np.inf, "", 0)
    for name, room in _rooms(scenario, scenario_file.parent, points):
        k = int(np.argmin(room - radii))
        best = min(best, (float((room - radii)[k]), name, k))
    room_mm, name, k = best
    return Measured(room_mm, name, float(times[k]), points[k], len(bodies))


def _bodies(scenario: dict[str, Any], robot: dict[str, Any], robot_file: Path, folder: Path, moments: int) -> Any:
    """Time, points (K, 3) [mm] of the centreline in the patient's frame, outer radius (K,) [mm] there."""
    solver = ctrplan.load_robot(robot_file)
    position, R = _base(scenario["base"])
    pairs = len(robot["tube"]) - 1
    corners = [np.zeros(pairs), *map(np.array, itertools.product((-1.0, 1.0), repeat=pairs))]
    for time, theta, l in _collars(robot, folder / "trajectory.csv", moments):  # noqa: E741
        for phi in corners:
            points, radii = _body(robot, solver.solve(theta, l, phi))
            yield time, points @ R.T + position, radii


def _base(base: dict[str, Any]) -> tuple[Array, Array]:
    """Position (3,) [mm] and rotation (3, 3)."""
    position = np.array(base["position_mm"], dtype=float)
    if "quaternion_wxyz" in base:
        w, *v = np.array(base["quaternion_wxyz"], dtype=float) / np.linalg.norm(base["quaternion_wxyz"])
        cross = np.cross(np.eye(3), v)
        return position, np.eye(3) + 2 * w * cross + 2 * cross @ cross
    z = np.array(base["direction"], dtype=float) / np.linalg.norm(base["direction"])
    axis = np.cross([0, 0, 1], z)
    cross = np.cross(np.eye(3), axis)
    return position, np.eye(3) + cross + cross @ cross / (1 + z[2])  # tubes turn all together: any roll does


def _collars(robot: dict[str, Any], path: Path, moments: int) -> Any:
    """Time, rotations (n,) [rad] and translations (n,) [m] of tubes at about evenly spaced rows, the last included."""
    with path.open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    home_theta, home_l = np.radians(robot["home"]["theta_deg"]), np.array(robot["home"]["l_mm"]) * 1e-3
    for k in np.unique(np.linspace(0, len(rows) - 1, moments).round().astype(int)):
        theta, l = home_theta.copy(), home_l.copy()  # noqa: E741
        for joint in robot["joint"]:
            kind = "theta" if "theta" in joint["moves"] else "l"
            value = rows[k][joint["name"].replace(" ", "_") + ("_position_rad" if kind == "theta" else "_position_m")]
            moved = np.array(joint["moves"][kind], dtype=float) * value
            theta, l = (theta + moved, l) if kind == "theta" else (theta, l + moved)  # noqa: E741
        yield rows[k]["time_s"], theta, l


def _body(robot: dict[str, Any], shape: Any) -> tuple[Array, Array]:
    """Points (K, 3) [mm] in front of the plate, at most 0.5 mm apart, and the outer radii (K,) [mm] of tubes there."""
    points, radii, covered = [], [], 0.0
    for tube, solved in zip(robot["tube"], shape.tubes, strict=True):
        line = np.asarray(solved.centreline_m) * 1e3
        line = line[max(int(np.searchsorted(solved.s_m, covered + 1e-9)) - 1, 0) :]  # what lies in no other tube
        covered = max(covered, float(solved.s_m[-1]))
        steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
        along = np.concatenate([[0], np.cumsum(steps)])
        if len(line) < 2 or along[-1] == 0:
            continue
        fine = np.linspace(0, along[-1], int(along[-1] / 0.5) + 2)
        points.append(np.stack([np.interp(fine, along, axis) for axis in line.T], axis=1))
        radii.append(np.full(len(fine), tube["outer_diameter_mm"] / 2))
    return np.concatenate(points), np.concatenate(radii)


def _rooms(scenario: dict[str, Any], folder: Path, points: Array) -> Any:
    """Name and room (K,) of every part to avoid, and of all lumens together."""
    lumens = []
    for part in scenario["anatomy"]:
        files = part.get("files", [part.get("file", "")])
        rooms = [_room(part, folder / file, scenario["frame"], points) - part["margin_mm"] for file in files]
        room = np.min(rooms, axis=0) - part.get("motion_margin_mm", 0)
        name = Path(files[0]).name or part["kind"]
        if part["role"] == "inside":
            lumens.append((name, room))
        else:
            yield name, room
    if lumens:
        yield " + ".join(name for name, _ in lumens), np.max([room for _, room in lumens], axis=0)


def _room(part: dict[str, Any], file: Path, frame: str, points: Array) -> Array:
    """(K,) mm from points of the scenario's frame to what is not allowed."""
    inside = part["role"] == "inside"
    if part["kind"] == "capsule":
        a, b = np.array(part["from_mm"], dtype=float), np.array(part["to_mm"], dtype=float)
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        apart = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1) - part["radius_mm"]
        return -apart if inside else apart
    if part["kind"] == "volume":
        return _voxel_room(file, part["label"], inside, points * ([-1, -1, 1] if frame == "RAS" else 1))
    if part.get("frame", frame) != frame:
        points = points * [-1, -1, 1]
    return _triangle_room(_triangles(file), inside, points)


def _voxel_room(file: Path, label: int, inside: bool, points_lps: Array) -> Array:
    """To the nearest box of a voxel that has the label, or of one that has not; at most `REACH_MM`, negative within."""
    import SimpleITK

    image = SimpleITK.ReadImage(str(file))
    spacing, size = np.array(image.GetSpacing()), np.array(image.GetSize())
    turned = np.array(image.GetDirection()).reshape(3, 3)
    index = (points_lps - image.GetOrigin()) @ turned / spacing  # of voxels' centres; turned is orthogonal
    lower = np.clip(np.floor(index.min(axis=0) - REACH_MM / spacing), 0, size - 1).astype(int)
    upper = np.clip(np.ceil(index.max(axis=0) + REACH_MM / spacing) + 1, 1, size).astype(int)
    lower = np.minimum(lower, upper - 1)
    cut = tuple(slice(a, b) for a, b in zip(lower[::-1], upper[::-1], strict=True))
    has = np.pad(SimpleITK.GetArrayViewFromImage(image)[cut] == label, 1).transpose(2, 1, 0)
    forbidden = ~has if inside else has
    near = np.zeros_like(forbidden)
    for axis in range(3):
        for step in (-1, 1):
            near |= np.roll(~forbidden, step, axis)
    boxes = np.argwhere(forbidden & near) + lower - 1
    at = np.clip(np.rint(index).astype(int) - lower + 1, 0, np.array(has.shape) - 1)
    outside = forbidden[tuple(at.T)]
    return np.where(outside, -1.0, 1.0) * _to_boxes(boxes * spacing, spacing / 2, index * spacing)


def _to_boxes(centres: Array, half: Array, points: Array) -> Array:
    """(K,) from points to the nearest of equal boxes; centres in reach of the half diagonal decide."""
    if not len(centres):
        return np.full(len(points), REACH_MM)
    tree, corner = cKDTree(centres), float(np.linalg.norm(half))
    to_centre, _ = tree.query(points)
    found = np.full(len(points), REACH_MM)
    for k in np.flatnonzero(to_centre < REACH_MM):
        close = centres[tree.query_ball_point(points[k], to_centre[k] + corner + 1e-9)]
        away = np.maximum(np.abs(points[k] - close) - half, 0)
        found[k] = np.sqrt((away**2).sum(axis=1).min())
    return found


def _triangles(path: Path) -> Array:
    """(F, 3, 3) of a binary STL, or of a VTP by VTK's own reader (`pip install vtk`)."""
    if path.suffix == ".stl":
        raw = path.read_bytes()
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        return np.frombuffer(raw, kind, int.from_bytes(raw[80:84], "little"), 84)["corners"].astype(float)
    from vtk import vtkCleanPolyData, vtkPolyDataNormals, vtkTriangleFilter, vtkXMLPolyDataReader

    reader, flat, joined, turned = vtkXMLPolyDataReader(), vtkTriangleFilter(), vtkCleanPolyData(), vtkPolyDataNormals()
    reader.SetFileName(str(path))
    flat.SetInputConnection(reader.GetOutputPort())
    joined.SetInputConnection(flat.GetOutputPort())
    turned.SetInputConnection(joined.GetOutputPort())
    turned.ConsistencyOn(), turned.SplittingOff()  # neighbours wound alike, no point moved
    turned.Update()
    mesh = turned.GetOutput()
    cells = (mesh.GetCell(k).GetPointIds() for k in range(mesh.GetNumberOfCells()))
    return np.array([[mesh.GetPoint(ids.GetId(k)) for k in range(3)] for ids in cells])


def _triangle_room(triangles: Array, inside: bool, points: Array) -> Array:
    """To the nearest triangle, negative on the wrong side by the winding number of the surface, its openings capped."""
    whole, triangles = np.concatenate([triangles, _caps(triangles)]), _in_pieces(triangles)
    middles = triangles.mean(axis=1)
    reach = np.linalg.norm(triangles - middles[:, None], axis=2).max()
    tree, found = cKDTree(middles), np.empty(len(points))
    for begin in range(0, len(points), 2000):
        some = points[begin : begin + 2000]
        away, near = tree.query(some, k=min(24, len(triangles)))
        found[begin : begin + 2000] = _to_triangles(some, triangles[near])
        for k in np.flatnonzero(away[:, -1] - reach < found[begin : begin + 2000]):  # a farther one may be nearer
            close = triangles[tree.query_ball_point(some[k], found[begin + k] + reach)]
            found[begin + k] = _to_triangles(some[k : k + 1], close[None])[0]
    within = _within(whole, points, found)
    return np.where(within == inside, found, -found)


def _caps(triangles: Array) -> Array:
    """(C, 3, 3) fans over the openings, each about its middle: for sides only, no distance is to them."""
    corners, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    rows = index.reshape(-1, 3)
    edges = np.concatenate([rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]])
    both = set(map(tuple, edges.tolist()))
    rim = np.array([(a, b) for a, b in edges.tolist() if (b, a) not in both], dtype=int).reshape(-1, 2)
    joined = coo_array((np.ones(len(rim)), rim.T), shape=(len(corners),) * 2)
    opening = connected_components(joined, directed=False)[1][rim[:, 0]]
    middles = {k: corners[rim[opening == k, 0]].mean(axis=0) for k in np.unique(opening)}
    fans = [(corners[b], corners[a], middles[k]) for (a, b), k in zip(rim, opening, strict=True)]
    return np.array(fans).reshape(-1, 3, 3)


def _in_pieces(triangles: Array, longest_mm: float = 3.0) -> Array:
    """(F, 3, 3) with triangles that have longer edges cut in four: the same surface."""
    done = []
    while len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        done.append(triangles[edges <= longest_mm])
        a, b, c = np.moveaxis(triangles[edges > longest_mm], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(piece, axis=1) for piece in corners])
    return np.concatenate(done)


def _to_triangles(points: Array, triangles: Array) -> Array:
    """(K,) from points (K, 3) to the nearest of triangles (K, F, 3, 3): a foot in its plane, else the nearest edge."""
    a, b, c = np.moveaxis(triangles, 2, 0)
    point = points[:, None]
    normal = np.cross(b - a, c - a)
    long = np.linalg.norm(normal, axis=2)
    normal = normal / np.where(long > 0, long, 1)[..., None]
    off = ((point - a) * normal).sum(axis=2)
    foot = point - off[..., None] * normal
    over, least = long > 0, np.full(off.shape, np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        over &= (np.cross(q - p, foot - p) * normal).sum(axis=2) >= 0
        share = ((point - p) * (q - p)).sum(axis=2) / np.maximum(((q - p) ** 2).sum(axis=2), 1e-30)
        nearest = p + np.clip(share, 0, 1)[..., None] * (q - p)
        least = np.minimum(least, np.linalg.norm(point - nearest, axis=2))
    return np.where(over, np.abs(off), least).min(axis=1)


def _within(triangles: Array, points: Array, room: Array) -> Array:
    """(K,) whether points are inside: as the one before or the first, unless the surface may lie between them."""
    within = np.zeros(len(points), bool)
    for k, point in enumerate(points):
        for known in {max(k - 1, 0), 0} if k else ():
            if np.linalg.norm(point - points[known]) < room[known] + room[k]:
                within[k] = within[known]
                break
        else:
            within[k] = _winding(triangles, point) > 0.5
    return within


def _winding(triangles: Array, point: Array) -> float:
    """The share of the sphere that a surface takes of a point's view, by the angles of its triangles."""
    rays = triangles - point
    lengths = np.linalg.norm(rays, axis=2)
    volume = np.linalg.det(rays)
    a, b, c = np.moveaxis(rays, 1, 0)
    la, lb, lc = lengths.T
    below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return abs(float(np.arctan2(volume, below).sum() / (2 * np.pi)))
