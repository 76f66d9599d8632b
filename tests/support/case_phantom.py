"""A patient of our own: a wide lumen and a vessel beside it, as files of either frame, with a target and an entry.

No turn and no mirror takes it to itself. Places are said in LPS, in mm.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import phantoms
import SimpleITK
from places import ROBOTS

ROBOT = ROBOTS / "table_5_pair.toml"
ENTRY = np.array([31.0, -17.0, 57.0])
WAY = phantoms.OBLIQUE[:, 2]
FAR = ENTRY + 190 * WAY
VESSEL = (ENTRY + phantoms.OBLIQUE @ (45.0, 10.0, 60.0), ENTRY + phantoms.OBLIQUE @ (45.0, 60.0, 130.0), 5.0)
LUMEN_MM, VOXEL_MM = 70.0, 5.0


def lumen(points: Any) -> Any:
    return phantoms.capsule(ENTRY - 15 * WAY, FAR, LUMEN_MM)(points)


def vessel(points: Any) -> Any:
    return phantoms.capsule(*VESSEL)(points)


def labels() -> Any:
    """SimpleITK's image: 1 the lumen, 2 the vessel in it."""
    centre = (ENTRY + FAR) / 2
    made = phantoms.image(lumen, centre, 200.0, VOXEL_MM, label=1)
    other = phantoms.image(vessel, centre, 200.0, VOXEL_MM, label=2)
    voxels = SimpleITK.GetArrayFromImage(made)
    voxels[SimpleITK.GetArrayFromImage(other) == 2] = 2
    both = SimpleITK.GetImageFromArray(voxels)
    both.CopyInformation(made)
    return both


def write_markups(path: Path, frame: str, points: dict[str, Any], kind: str = "Fiducial") -> Path:
    """Points of LPS by their labels, as 3D Slicer would write them in a frame."""
    turned = {"LPS": (1, 1, 1), "RAS": (-1, -1, 1)}[frame]
    places = {label: np.multiply(point, turned).tolist() for label, point in points.items()}
    if path.name.endswith(".fcsv"):
        head = f"# Markups fiducial file version = 4.11\n# CoordinateSystem = {frame}\n"
        head += "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n"
        rows = [f"n{k},{x},{y},{z},0,0,0,1,1,1,0,{label},," for k, (label, (x, y, z)) in enumerate(places.items())]
        path.write_text(head + "\n".join(rows) + "\n")
    else:
        given = [{"label": k, "position": v, "positionStatus": "defined"} for k, v in places.items()]
        markup = {"type": kind, "coordinateSystem": frame, "coordinateUnits": "mm", "controlPoints": given}
        path.write_text(json.dumps({"markups": [markup]}))
    return path
