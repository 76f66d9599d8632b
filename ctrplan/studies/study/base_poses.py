"""Base poses: a list of them, or positions and directions on a patch of skin or an opening."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.base.directions import shortest_rotation
from ctrplan.files.study_entries import BasesEntry, PatchEntry
from ctrplan.storage.toml_document import Document


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
    found = []
    for tilt in patch.tilts_deg:
        for side in range(patch.sides if tilt else 1):
            azimuth = 2 * math.pi * side / patch.sides
            axis = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            found.append(Rotation.from_rotvec(math.radians(tilt) * axis))
    return found


def _quaternions(rotations: Rotation) -> Array:
    found: Array = np.round(np.roll(rotations.as_quat(canonical=True), 1, axis=1), 12)
    return found
