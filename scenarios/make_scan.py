"""Make a patient of our own: the shipped airway and an artery beside it as a segmentation, with a target and an entry.

    python scenarios/make_scan.py DIRECTORY [VOXEL_MM]        (default: 0.8)

Needs `pip install ctrplan[images]`. The files are such as 3D Slicer writes: a .seg.nrrd with named segments and two
.mrk.json, in LPS and mm. The airway hangs head up: its bronchi lie towards the feet.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np
import SimpleITK
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))  # for `anatomies`, wherever this is started or imported from

from anatomies.airway import airway_distance  # noqa: E402
from anatomies.implicit import round_cone  # noqa: E402
from anatomies.swept import Array  # noqa: E402

HEAD_UP = np.diag([1.0, -1.0, -1.0])  # of the airway's own axes, z along the trachea from the plate
ORIGIN_MM = np.array([12.0, -31.0, -48.0])  # where its plate stands in the patient
LOWER, UPPER = np.array([-40.0, -30.0, -30.0]), np.array([40.0, 30.0, 118.0])
ARTERY = ((-16.0, 14.0, 36.0), (24.0, 16.0, 58.0), 7.0)  # ends and radius, in front of the bronchi
TARGET, ENTRY = (17.3, 3.0, 88.0), ((0.0, 0.0, 0.0), (0.0, 0.0, 40.0))
SEGMENTS = (("trachea and bronchi", 1), ("pulmonary artery", 2))


def in_patient(points: Array) -> Array:
    """Points (..., 3) of the airway's own axes in LPS, mm."""
    return np.asarray(np.asarray(points) @ HEAD_UP.T + ORIGIN_MM)


def segmentation(voxel_mm: float) -> SimpleITK.Image:
    """Labels 1 and 2, with what 3D Slicer says of its segments; axes along the patient's."""
    size = np.ceil((UPPER - LOWER) / voxel_mm).astype(int)
    k, j, i = np.meshgrid(*(np.arange(n) for n in size[::-1]), indexing="ij")
    corner = np.min([in_patient(LOWER), in_patient(UPPER)], axis=0)
    places = corner + voxel_mm * np.stack([i, j, k], axis=-1).reshape(-1, 3)
    own = (places - ORIGIN_MM) @ HEAD_UP
    start, end, radius = ARTERY
    labels: NDArray[np.uint8] = np.where(airway_distance()(own) < 0, 1, 0).astype(np.uint8)
    labels[(round_cone(start, end, radius)(own) < 0) & (labels == 0)] = 2
    image = SimpleITK.GetImageFromArray(labels.reshape(size[::-1]))
    image.SetSpacing([voxel_mm] * 3)
    image.SetOrigin(corner.tolist())
    for number, (name, label) in enumerate(SEGMENTS):
        for key, value in (("ID", f"Segment_{label}"), ("Name", name), ("LabelValue", str(label)), ("Layer", "0")):
            image.SetMetaData(f"Segment{number}_{key}", value)
    return image


def markup_text(kind: str, points: Array, labels: tuple[str, ...]) -> str:
    """Points in LPS as a file of markups."""
    rows = [
        {"id": str(n), "label": label, "position": point.tolist(), "positionStatus": "defined"}
        for n, (point, label) in enumerate(zip(points, labels, strict=True), start=1)
    ]
    markup = {"type": kind, "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": rows}
    return json.dumps({"markups": [markup]}, indent=1) + "\n"


def make_scan(directory: Path, voxel_mm: float = 0.8) -> list[Path]:
    """Write the three files into the directory and return their paths."""
    directory.mkdir(parents=True, exist_ok=True)
    image, target, entry = (directory / n for n in ("lungs.seg.nrrd", "target.mrk.json", "entry.mrk.json"))
    temporary = directory / "part.seg.nrrd"
    SimpleITK.WriteImage(segmentation(voxel_mm), str(temporary), True)
    os.replace(temporary, image)
    target.write_text(markup_text("Fiducial", in_patient(np.array([TARGET])), ("lobar bronchus",)), encoding="utf-8")
    entry.write_text(markup_text("Line", in_patient(np.array(ENTRY)), ("plate", "ahead")), encoding="utf-8")
    return [image, target, entry]


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        raise SystemExit(__doc__)
    for path in make_scan(Path(sys.argv[1]), *map(float, sys.argv[2:])):
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")
