"""Targets for the tip and base poses of a study: listed, on a grid, drawn, on a patch or an opening."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.mesh_file import stated_frame
from ctrplan.anatomy.parts import AnatomyPart, exact_clearance, lumens_box
from ctrplan.anatomy.patient_frame import SAME, signs
from ctrplan.anatomy.shape import PartShape
from ctrplan.base.arrays import Array, shortest_rotation
from ctrplan.base.surface import Surface
from ctrplan.errors import InputError
from ctrplan.files.study_file import BasesEntry, PatchEntry, TargetsEntry
from ctrplan.storage.csv_table import CsvTable
from ctrplan.storage.toml_document import Document

if TYPE_CHECKING:
    from ctrplan.scenario.scenario import Scenario

MOST_CANDIDATES = 20_000_000  # points of a grid that are looked at
DRAWS = 200  # rounds of drawing as many points as are wanted, before a volume counts as empty
ON_SURFACE = 30  # points drawn on a surface for each that is kept
Inside = Callable[[Array], Array]  # (K, 3) [m] -> (K,) depth [m], negative outside


def target_points(targets: TargetsEntry, scenario: Scenario | None, document: Document, folder: Path) -> Array:
    """(K, 3) [mm], the same for the same entry. Raises InputError where there is none, or no file that it names."""
    if targets.points_mm is not None:
        return np.array(targets.points_mm, dtype=np.float64)
    if targets.file is not None:
        return _listed(check_file(folder, targets.file, document, "targets.file"))
    if targets.on is not None:
        points = _on_surface(_shape(targets.on, targets, scenario, document, folder, "on").surface(), targets)
    else:
        points = _within(targets, scenario, document, folder)
    if not len(points):
        raise document.fault("has no points", "targets")
    rounded: Array = np.round(points * 1e3, 6) + 0.0  # no minus zero
    return rounded


def _listed(file: Path) -> Array:
    return CsvTable(str(file), "points").columns(("x_mm", "y_mm", "z_mm"))


def _within(targets: TargetsEntry, scenario: Scenario | None, document: Document, folder: Path) -> Array:
    """Points of a volume, on a grid or drawn."""
    depth, (low, high) = _volume(targets, scenario, document, folder)
    if targets.box_mm is not None:
        corners = np.multiply(targets.box_mm, 1e-3)
        low, high = np.maximum(low, corners.min(axis=0)), np.minimum(high, corners.max(axis=0))
    if np.any(low > high):
        return np.empty((0, 3))
    least_m = targets.depth_mm * 1e-3
    if targets.step_mm is None:
        return _drawn(depth, low, high, least_m, targets)
    step = targets.step_mm * 1e-3
    first, last = np.ceil(low / step), np.floor(high / step)
    if np.prod(last - first + 1) > MOST_CANDIDATES:
        rule = (
            f"makes a grid of {np.prod(last - first + 1):,.0f} points, more than {MOST_CANDIDATES:,} can be looked at"
        )
        raise document.fault(rule, "targets", "step_mm")
    axes = [step * np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[depth(grid) >= least_m]


def _volume(
    targets: TargetsEntry, scenario: Scenario | None, document: Document, folder: Path
) -> tuple[Inside, tuple[Array, Array]]:
    """How deep points lie in a volume, and a box around it."""
    unbounded = np.full(3, -np.inf), np.full(3, np.inf)
    if targets.within is None:  # a box alone
        return lambda points: np.full(len(points), np.inf), unbounded
    if targets.within != "anatomy":
        shape = _shape(targets.within, targets, scenario, document, folder, "within")
        return lambda points: -shape.distance(points), shape.box()
    parts = scenario.anatomy if scenario is not None else ()
    box = lumens_box(parts)
    if box is None and targets.box_mm is None:
        raise document.fault("needs a part to stay inside, or box_mm: the room around obstacles has no end", "targets")
    return lambda points: exact_clearance(parts, points), box or unbounded


def _drawn(depth: Inside, low: Array, high: Array, least_m: float, targets: TargetsEntry) -> Array:
    """Points drawn evenly in the volume."""
    rng, result, count = np.random.default_rng(targets.seed), np.empty((0, 3)), targets.count or 0
    for _ in range(DRAWS):
        points = low + rng.random((max(count, 1000), 3)) * (high - low)
        result = np.concatenate([result, points[depth(points) >= least_m]])
        if len(result) >= count:
            return result[:count]
    return result


def _on_surface(surface: Surface, targets: TargetsEntry) -> Array:
    """Points drawn evenly on a surface: so many, or as many as stay `step_mm` apart."""
    a, b, c = np.moveaxis(surface.vertices_m[surface.faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    rng = np.random.default_rng(targets.seed)
    step = (targets.step_mm or 0.0) * 1e-3
    count = targets.count or math.ceil(ON_SURFACE * area.sum() / step**2)
    face = rng.choice(len(area), size=min(count, MOST_CANDIDATES), p=area / area.sum())
    u, v = rng.random((2, len(face)))
    turned = u + v > 1
    u[turned], v[turned] = 1 - u[turned], 1 - v[turned]
    points: Array = a[face] + u[:, None] * (b - a)[face] + v[:, None] * (c - a)[face]
    return _apart(points, step) if step else points


def _apart(points: Array, step_m: float) -> Array:
    """Points that are not within a step of one before them."""
    near = cKDTree(points)
    kept = np.ones(len(points), dtype=bool)
    for k in range(len(points)):
        if kept[k]:
            others = np.array(near.query_ball_point(points[k], step_m))
            kept[others[others > k]] = False
    return points[kept]


def _shape(
    name: str, targets: TargetsEntry, scenario: Scenario | None, document: Document, folder: Path, key: str
) -> PartShape:
    """A part of the anatomy by its number, "anatomy.2", or a mesh file."""
    if not name.startswith("anatomy"):
        from ctrplan.anatomy.mesh_file import load_mesh
        from ctrplan.anatomy.shapes.mesh import Mesh

        file = check_file(folder, name, document, f"targets.{key}")
        vertices, faces = load_mesh(file, targets.unit, file=document.file, key=f"targets.{key}")
        return Mesh(vertices * _signs(file, targets, scenario, document, key), faces, str(file))
    parts: tuple[AnatomyPart, ...] = scenario.anatomy if scenario is not None else ()
    number = name.removeprefix("anatomy.")
    if not (number.isdecimal() and 1 <= int(number) <= len(parts)):
        known = f"the scenario has parts 1 to {len(parts)}" if parts else "there is no anatomy"
        raise document.fault(f"must be anatomy.K or a mesh file; {known}", "targets", key)
    return parts[int(number) - 1].shape


def _signs(file: Path, targets: TargetsEntry, scenario: Scenario | None, document: Document, key: str) -> Array:
    """(3,) that take places of a mesh file to the scenario's frame. Raises InputError where either is not said."""
    stated, own = stated_frame(file), scenario and scenario.frame
    if stated and targets.frame and stated != targets.frame:
        raise document.fault(f"contradicts {file.name}, which says {stated}", "targets", "frame")
    frame = stated or targets.frame
    if frame and scenario and own is None:
        raise document.fault(f"is in {frame}, and the scenario says no frame", "targets", key)
    if own and frame is None:
        rule = f"is missing: {file.name} does not say whether its coordinates are in RAS or in LPS"
        raise document.fault(rule, "targets", "frame")
    return signs(frame, own) if frame and own else SAME


def check_file(folder: Path, name: str, document: Document, key: str) -> Path:
    """A file that [targets] names. Raises InputError where it does not exist."""
    if not (folder / name).is_file():
        raise InputError("is not a file that exists", file=document.file, key=key, value=name)
    return folder / name


def base_poses(bases: BasesEntry, document: Document) -> tuple[Array, Array]:
    """Positions (K, 3) [mm] and quaternions (K, 4), w first. Raises InputError."""
    if bases.patch is not None:
        return _on_patch(bases.patch, document)
    positions, rotations = [], []
    for k, pose in enumerate(bases.poses or []):
        if (pose.direction is None) == (pose.quaternion_wxyz is None):
            raise document.fault("must have one of direction and quaternion_wxyz", "bases", "poses", k)
        given = pose.direction or pose.quaternion_wxyz or ()
        if not any(given):
            key = "direction" if pose.direction is not None else "quaternion_wxyz"
            raise document.fault("must not be zero", "bases", "poses", k, key)
        positions.append(pose.position_mm)
        rotations.append(_turned_to(given) if pose.direction else Rotation.from_quat(np.roll(given, -1)))
    return np.array(positions, dtype=np.float64), _quaternions(Rotation.concatenate(rotations))


def _on_patch(patch: PatchEntry, document: Document) -> tuple[Array, Array]:
    if not any(patch.normal):
        raise document.fault("must not be zero", "bases", "patch", "normal")
    if patch.radius_mm and patch.along_mm is not None:
        raise document.fault("does not go with radius_mm, an opening is a line", "bases", "patch", "along_mm")
    if (patch.radius_mm or patch.along_mm is not None) and patch.step_mm is None:
        extent = "a radius" if patch.radius_mm else "along_mm"
        raise document.fault(f"is missing, a patch with {extent} needs it", "bases", "patch", "step_mm")
    extent_mm = 2 * patch.radius_mm or float(
        np.linalg.norm(np.subtract(patch.along_mm or patch.center_mm, patch.center_mm))
    )
    count = (1 + round(extent_mm / (patch.step_mm or 1.0))) ** (2 if patch.radius_mm else 1)
    if count > MOST_CANDIDATES:
        rule = f"makes {count:,} positions, more than {MOST_CANDIDATES:,} can be looked at"
        raise document.fault(rule, "bases", "patch", "step_mm")
    inward = _turned_to(patch.normal)
    offsets = _disc(patch.radius_mm, patch.step_mm or 1.0)
    places = np.array(patch.center_mm) + inward.apply(np.column_stack([offsets, np.zeros(len(offsets))]))
    if patch.along_mm is not None:
        places = _line(np.array(patch.center_mm), np.array(patch.along_mm), patch.step_mm or 1.0)
    positions, rotations = [], []
    for place, tilt, turn in product(places, _tilts(patch), patch.turns_deg):
        positions.append(place)
        rotations.append(inward * tilt * Rotation.from_euler("z", turn, degrees=True))
    return np.round(positions, 9), _quaternions(Rotation.concatenate(rotations))


def _turned_to(direction: Sequence[float]) -> Rotation:
    return Rotation.from_matrix(shortest_rotation(direction))


def _disc(radius: float, step: float) -> Array:
    """(K, 2) points of a square grid within a radius of its middle, nearest first."""
    count = math.floor(radius / step)
    line = step * np.arange(-count, count + 1)
    grid = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(grid, axis=1)
    order = np.argsort(np.round(away, 9), kind="stable")
    kept: Array = grid[order][away[order] <= radius * (1 + 1e-12)]
    return kept


def _line(start: Array, end: Array, step: float) -> Array:
    """(K, 3) points from start to end, both included, evenly spaced and at most a step apart."""
    count = math.ceil(float(np.linalg.norm(end - start)) / step - 1e-9)
    points: Array = np.linspace(start, end, count + 1) if count else start[None]
    return points


def _tilts(patch: PatchEntry) -> list[Rotation]:
    """Rotations from the inward normal, one for no tilt and `sides` for every other."""
    results = []
    for tilt in patch.tilts_deg:
        for side in range(patch.sides if tilt else 1):
            azimuth = 2 * math.pi * side / patch.sides
            axis = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            results.append(Rotation.from_rotvec(math.radians(tilt) * axis))
    return results


def _quaternions(rotations: Rotation) -> Array:
    result: Array = np.round(np.roll(rotations.as_quat(canonical=True), 1, axis=1), 12)
    return result
