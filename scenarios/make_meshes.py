"""Make the anatomy meshes of the scenarios: binary STL in millimetres, the same bytes on every run and machine.

    python scenarios/make_meshes.py [DIRECTORY]        (default: meshes/ beside this script)

A file of `anatomies` each, with the source of its dimensions; lengths in mm. Coordinates are rounded to 0.1 um so that
the last bit of a platform's mathematical functions does not show. `anatomies.swept` (tubes along curves) and
`anatomies.implicit` (rounded pieces that flow into each other) serve further scenarios too.
"""

import os
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))  # for `anatomies`, wherever this is started or imported from

from anatomies.airway import airway  # noqa: E402
from anatomies.heart import heart_chamber  # noqa: E402
from anatomies.ribs import ribs  # noqa: E402
from anatomies.sinus import conchae, sphenoid_wall  # noqa: E402
from anatomies.swept import Array, Mesh  # noqa: E402
from anatomies.ventricle import ventricle  # noqa: E402
from anatomies.vessel import vessel  # noqa: E402

HEADER = b"ctrplan anatomy, binary STL, millimetres"
MESHES: dict[str, Callable[[], Mesh]] = {
    "vessel": vessel,
    "ribs": ribs,
    "heart_chamber": heart_chamber,
    "airway": airway,
    "ventricle": ventricle,
    "sphenoid_wall": sphenoid_wall,
    "conchae": conchae,
}


def stl_bytes(vertices: Array, faces: NDArray[np.int64]) -> bytes:
    """Binary STL, coordinates rounded to 1e-4 mm."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    corners = np.round(vertices, 4)[faces] + 0.0  # + 0.0 turns -0.0 into 0.0
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = np.zeros(len(faces), dtype=record)
    triangles["corners"] = corners
    triangles["normal"] = np.round(normal / np.linalg.norm(normal, axis=1)[:, None], 4) + 0.0
    return HEADER.ljust(80) + struct.pack("<I", len(faces)) + triangles.tobytes()


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
