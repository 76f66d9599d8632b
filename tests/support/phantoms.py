"""Analytic bodies as volumes: where they are is said in LPS, in mm; images of any axes are made of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.files.scenario_anatomy import anatomy_part
from ctrplan.storage.toml_document import Document, TomlTable

Array = NDArray[np.float64]
Body = Callable[[Array], Array]  # points (K, 3) in LPS, mm -> distances (K,) in mm, negative within

OBLIQUE = Rotation.from_euler("xyz", [20, -30, 40], degrees=True).as_matrix()
FLIPPED = np.diag([-1.0, 1.0, -1.0]) @ OBLIQUE
MIRRORED = OBLIQUE @ np.diag([1.0, -1.0, 1.0])  # a left-handed grid
SWAPPED = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
AXES = {"oblique": OBLIQUE, "flipped": FLIPPED, "mirrored": MIRRORED, "swapped": SWAPPED, "straight": np.eye(3)}
# No turn and no mirror takes these four balls to themselves: towards L, P and S, each farther and smaller.
CENTRE = np.array([31.0, -17.0, 57.0])
BALLS = [(CENTRE, 6.0), (CENTRE + (9, 0, 0), 4.5), (CENTRE + (0, 10, 0), 4.0), (CENTRE + (0, 0, 11), 3.5)]


def hand(points: Array) -> Array:
    """Four balls in a row each of the patient's directions: left, back, head."""
    return np.min([np.linalg.norm(points - centre, axis=1) - radius for centre, radius in BALLS], axis=0)


def capsule(a: Any, b: Any, radius: float) -> Body:
    a, axis = np.asarray(a, float), np.subtract(b, a)

    def distance(points: Array) -> Array:
        along = np.clip((points - a) @ axis / (axis @ axis), 0, 1)
        return np.asarray(np.linalg.norm(points - a - along[:, None] * axis, axis=1) - radius)

    return distance


def torus(centre: Any, turned: Array, ring: float, radius: float) -> Body:
    def distance(points: Array) -> Array:
        q = (points - np.asarray(centre)) @ turned
        return np.asarray(np.hypot(np.hypot(q[:, 0], q[:, 1]) - ring, q[:, 2]) - radius)

    return distance


def image(
    body: Body,
    centre: Any,
    half_mm: float,
    spacing_mm: Any,
    direction: Array = OBLIQUE,
    *,
    label: int = 3,
    grey: bool = False,
) -> Any:
    """SimpleITK's image of a body, in a box of that half width: labels, or HU from -1000 outside to 0 inside."""
    spacing = np.broadcast_to(np.asarray(spacing_mm, float), 3)
    size = np.ceil(2 * half_mm / spacing).astype(int)
    index = np.indices(size).reshape(3, -1).T
    origin = np.asarray(centre, float) - direction @ (spacing * (size - 1) / 2)
    distance = body(origin + (index * spacing) @ direction.T).reshape(size).T
    if grey:  # a voxel's share, blurred over its width
        values = (-500 - 500 * np.clip(distance / spacing.max(), -1, 1)).astype(np.int16)
    else:
        values = np.where(distance < 0, label, 0).astype(np.int16)
    made = SimpleITK.GetImageFromArray(np.ascontiguousarray(values))
    made.SetSpacing(spacing.tolist())
    made.SetOrigin(origin.tolist())
    made.SetDirection(direction.ravel().tolist())
    return made


def written(made: Any, path: Path) -> Path:
    SimpleITK.WriteImage(made, str(path), True)
    return path


def part_of(folder: Path, own: str | None = "LPS", **entry: Any) -> AnatomyPart:
    """The part that an [[anatomy]] of a scenario in `folder` describes, whose own frame is said as `own`."""
    content: dict[str, Any] = {"anatomy": [entry]} | ({"frame": own} if own else {})
    return anatomy_part(TomlTable(Document(content, str(folder / "scenario.toml")), ("anatomy", 0)))


def distance_mm(part: AnatomyPart, points_mm: Any) -> Array:
    return np.asarray(part.shape.distance(np.asarray(points_mm, float) * 1e-3) * 1e3)


def near_points() -> Array:
    """(400, 3) around the phantom's middle, mm, LPS."""
    return np.random.default_rng(1).uniform(-16, 16, (400, 3)) + CENTRE
