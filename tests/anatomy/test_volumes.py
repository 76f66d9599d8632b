"""Structures of medical images: where they are, whatever the file's axes and frame, and what is refused."""

from __future__ import annotations

import gzip
import locale
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import phantoms
import pytest
import SimpleITK
from dicom_series import write_series
from phantoms import AXES, CENTRE, OBLIQUE, Array, distance_mm, hand, image, near_points, part_of, written
from scipy.spatial.transform import Rotation

from ctrplan.errors import InputError
from ctrplan.files.scenario_file import scenario_from_dict
from ctrplan.scenario.scenario import Scenario

SPACING = (0.8, 1.0, 1.3)
TO_RAS = np.array([-1.0, -1.0, 1.0])


def check_hand(part: Any, points: Array, frame: str) -> None:
    """The four balls are found where they are: half a voxel is far less than any flip or swap would move them by."""
    found, true = distance_mm(part, points * (TO_RAS if frame == "RAS" else 1)), hand(points)
    assert np.abs(found - true).max() <= 0.6 * max(SPACING)


@pytest.mark.parametrize("frame", ["RAS", "LPS"])
@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz", ".mha"])
def test_a_structure_is_where_it_is_in_either_frame(suffix: str, axes: str, frame: str, tmp_path: Path) -> None:
    path = written(image(hand, CENTRE, 18, SPACING, AXES[axes]), tmp_path / f"a{suffix}")
    part = part_of(tmp_path, frame, kind="volume", file=path.name, label=3)
    check_hand(part, near_points(), frame)


@pytest.mark.parametrize("suffix", [".nii", ".nhdr", ".mhd"])
def test_headers_apart_and_uncompressed_files_are_the_same(suffix: str, tmp_path: Path) -> None:
    SimpleITK.WriteImage(image(hand, CENTRE, 18, SPACING), str(tmp_path / f"a{suffix}"))
    check_hand(part_of(tmp_path, "RAS", kind="volume", file=f"a{suffix}", label=3), near_points(), "RAS")


def voxels_in_ras(axes_ras: Array, origin_ras: Array, size: Any) -> Any:
    """Labels (nx, ny, nz) of the hand on a grid in RAS: axes are columns, in mm a voxel."""
    index = np.indices(size).reshape(3, -1).T
    return (hand((origin_ras + index @ axes_ras.T) * TO_RAS) < 0).reshape(size).astype(np.uint8)


def ras_grid() -> tuple[Array, Array, tuple[int, int, int]]:
    size = (40, 42, 30)
    axes = np.diag(TO_RAS) @ AXES["mirrored"] * SPACING
    return axes, CENTRE * TO_RAS - axes @ (np.array(size) - 1) / 2, size


@pytest.mark.parametrize("form", ["sform", "qform"])
def test_a_nifti_file_written_byte_by_byte(form: str, tmp_path: Path) -> None:
    """Not by the library that reads it: its sform or quaternion is in RAS by the standard."""
    axes, origin, size = ras_grid()
    head = bytearray(352)
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, *size, 1, 1, 1, 1)
    struct.pack_into("<2h", head, 70, 2, 8)
    mirrored = axes / SPACING @ np.diag([1, 1, -1])  # of a quaternion only the third axis may be turned round
    x, y, z, w = Rotation.from_matrix(mirrored).as_quat(canonical=True)
    struct.pack_into("<8f", head, 76, -1, *SPACING, 1, 1, 1, 1)
    struct.pack_into("<f", head, 108, 352)
    struct.pack_into("<B", head, 123, 2)
    struct.pack_into("<2h", head, 252, int(form == "qform"), int(form == "sform"))
    struct.pack_into("<6f", head, 256, x, y, z, *origin)
    struct.pack_into("<12f", head, 280, *np.column_stack([axes, origin]).ravel())
    head[344:348] = b"n+1\0"
    assert w >= 0
    with gzip.open(tmp_path / "a.nii.gz", "wb") as stream:
        stream.write(bytes(head) + voxels_in_ras(axes, origin, size).tobytes(order="F"))
    check_hand(part_of(tmp_path, "LPS", kind="volume", file="a.nii.gz", label=1), near_points(), "LPS")


def nifti_2(path: Path, sizes: tuple[int, int, int], axes: Array, origin: Array, values: Array, ahead: Any = 0) -> None:
    """A NIfTI-2 file by its standard, whose sform is moved `ahead` [mm] of its quaternion."""
    head = bytearray(544)
    struct.pack_into("<i8s2h", head, 0, 540, b"n+2\0\r\n\x1a\n", 2, 8)
    struct.pack_into("<8q", head, 16, 3, *sizes, 1, 1, 1, 1)
    x, y, z, _ = Rotation.from_matrix(axes / SPACING @ np.diag([1, 1, -1])).as_quat(canonical=True)
    struct.pack_into("<8d", head, 104, -1, *SPACING, 1, 1, 1, 1)
    struct.pack_into("<q2d", head, 168, 544, 1.0, 0.0)
    struct.pack_into("<2i6d", head, 344, 1, 1, x, y, z, *origin)
    struct.pack_into("<12d", head, 400, *np.column_stack([axes, origin + ahead]).ravel())
    struct.pack_into("<i", head, 500, 2)
    with gzip.open(path, "wb") as stream:
        stream.write(bytes(head) + values.tobytes(order="F"))


def test_a_nifti_2_file_is_where_both_of_its_forms_say(tmp_path: Path) -> None:
    axes, origin, size = ras_grid()
    values = voxels_in_ras(axes, origin, size)
    nifti_2(tmp_path / "a.nii.gz", size, axes, origin, values)
    for frame in ("RAS", "LPS"):
        check_hand(part_of(tmp_path, frame, kind="volume", file="a.nii.gz", label=1), near_points(), frame)
    nifti_2(tmp_path / "a.nii.gz", size, axes, origin, values, ahead=(0, 3, 0))
    with pytest.raises(InputError, match=r"says two places that lie 3 mm apart \(qform, sform\)"):
        part_of(tmp_path, kind="volume", file="a.nii.gz", label=1)
    nifti_2(tmp_path / "a.nii.gz", size, axes, origin, values[:, :, : size[2] // 2])
    with pytest.raises(InputError, match="is damaged or cut short: it has 25200 bytes of voxels, 50400 are due"):
        part_of(tmp_path, kind="volume", file="a.nii.gz", label=1)


def test_segments_in_layers_overlap_and_each_is_whole(tmp_path: Path) -> None:
    """3D Slicer's layout: voxels have a value in each layer, and one label means two things in two layers."""
    axes, origin, size = ras_grid()
    whole = voxels_in_ras(axes, origin, size)
    half = whole * (np.arange(size[0]) < size[0] // 2)[:, None, None].astype(whole.dtype)
    layers = np.ascontiguousarray(np.stack([half, whole], axis=-1).transpose(2, 1, 0, 3))  # (nz, ny, nx, layers)
    made = SimpleITK.GetImageFromArray(layers, isVector=True)
    lps = np.diag(TO_RAS) @ axes
    made.SetSpacing(np.asarray(SPACING, float).tolist())
    made.SetOrigin((origin * TO_RAS).tolist())
    made.SetDirection((lps / SPACING).ravel().tolist())
    for k, (name, layer) in enumerate((("half", 0), ("whole", 1))):
        for key, value in (("Name", name), ("ID", name), ("LabelValue", "1"), ("Layer", str(layer))):
            made.SetMetaData(f"Segment{k}_{key}", value)
    written(made, tmp_path / "a.seg.nrrd")
    check_hand(part_of(tmp_path, kind="volume", file="a.seg.nrrd", segment="whole"), near_points(), "LPS")
    parts = [part_of(tmp_path, kind="volume", file="a.seg.nrrd", segment=name) for name in ("half", "whole")]
    assert np.ptp(parts[0].box, axis=0).sum() < 0.9 * np.ptp(parts[1].box, axis=0).sum()
    inside = np.array(parts[0].shape.surface().vertices_m)
    assert parts[1].shape.distance(inside).max() < 1e-3 * max(SPACING)  # no segment cuts a hole into another one
    with pytest.raises(InputError, match="has segments that overlap: say a segment of 'half'"):
        part_of(tmp_path, kind="volume", file="a.seg.nrrd", label=1)


def nrrd(folder: Path, space: str, turned: Any = TO_RAS, extra: str = "", kinds: str = "domain domain domain") -> Path:
    """A NRRD file by hand, its numbers those of LPS multiplied by `turned` ones."""
    axes, origin, size = ras_grid()
    data = voxels_in_ras(axes, origin, size)
    axes, origin = np.diag(TO_RAS * turned) @ axes, TO_RAS * turned * origin
    lines = ["NRRD0004", "type: uint8", "dimension: 3", *([f"space: {space}"] if space else ["space dimension: 3"])]
    lines += [f"sizes: {size[0]} {size[1]} {size[2]}", f"kinds: {kinds}", "encoding: raw"]
    lines += ["space directions: " + " ".join(f"({a!r},{b!r},{c!r})" for a, b, c in axes.T.tolist())]
    lines += ["space origin: ({!r},{!r},{!r})".format(*origin.tolist())]
    path = folder / "a.nrrd"
    path.write_bytes(("\n".join(lines) + "\n" + extra + "\n").encode() + data.tobytes(order="F"))
    return path


@pytest.mark.parametrize(
    ("space", "turned"),
    [
        ("right-anterior-superior", (-1, -1, 1)),
        ("left-posterior-superior", (1, 1, 1)),
        ("LAS", (1, -1, 1)),
        ("RAS", (-1, -1, 1)),
    ],
)
def test_a_nrrd_file_by_hand_in_each_space(space: str, turned: Any, tmp_path: Path) -> None:
    nrrd(tmp_path, space, turned)
    for frame in ("RAS", "LPS"):
        check_hand(part_of(tmp_path, frame, kind="volume", file="a.nrrd", label=1), near_points(), frame)


def test_a_frame_that_no_one_says_is_asked_for(tmp_path: Path) -> None:
    nrrd(tmp_path, "")
    with pytest.raises(InputError, match=r"anatomy.1.frame: is missing: the file does not say.*RAS or in LPS"):
        part_of(tmp_path, "LPS", kind="volume", file="a.nrrd", label=1)
    check_hand(part_of(tmp_path, "LPS", kind="volume", file="a.nrrd", label=1, frame="RAS"), near_points(), "LPS")
    written(image(hand, CENTRE, 18, SPACING), tmp_path / "a.nii.gz")
    check_hand(part_of(tmp_path, "LPS", kind="volume", file="a.nii.gz", label=3, frame="RAS"), near_points(), "LPS")
    nrrd(tmp_path, "LPS", (1, 1, 1))
    with pytest.raises(InputError, match=r"toml: frame: is missing: anatomy.1 is in LPS"):
        part_of(tmp_path, None, kind="volume", file="a.nrrd", label=1)
    with pytest.raises(InputError, match=r"anatomy.1.frame = 'RAS': contradicts the file, which says LPS"):
        part_of(tmp_path, "LPS", kind="volume", file="a.nrrd", label=1, frame="RAS")


def test_names_of_segments_and_layers_that_overlap(tmp_path: Path) -> None:
    extra = "Segment0_Name:=a bone\nSegment0_LabelValue:=2\nSegment1_Name:=airway\nSegment1_LabelValue:=1\n"
    nrrd(tmp_path, "LPS", (1, 1, 1), extra)
    check_hand(part_of(tmp_path, kind="volume", file="a.nrrd", segment="airway"), near_points(), "LPS")
    with pytest.raises(
        InputError, match=r"segment = 'lung': a.nrrd has no segment of that name, but 'a bone' \(0 ml\), 'airway' \(1"
    ):
        part_of(tmp_path, kind="volume", file="a.nrrd", segment="lung")
    with pytest.raises(InputError, match=r"label = 7: a.nrrd has no voxel of that label, but 'a bone'"):
        part_of(tmp_path, kind="volume", file="a.nrrd", label=7)


@pytest.mark.parametrize("order", [1, -1])
def test_a_dicom_series_in_whatever_order_its_files_are_named(order: int, tmp_path: Path) -> None:
    (tmp_path / "ct").mkdir()
    write_series(tmp_path / "ct", image(hand, CENTRE, 18, (1.0, 1.0, 1.3)), "1", order=order)
    before = locale.setlocale(locale.LC_ALL)
    for frame in ("RAS", "LPS"):
        check_hand(part_of(tmp_path, frame, kind="volume", file="ct", label=3), near_points(), frame)
    assert locale.setlocale(locale.LC_ALL) == before, "other files would be opened as ASCII from here on"


def test_series_that_are_no_one_volume(tmp_path: Path) -> None:
    (tmp_path / "ct").mkdir()
    small = image(hand, CENTRE, 18, 2.0)
    write_series(tmp_path / "ct", small, "1", skip=6)
    with pytest.raises(InputError, match=r"has a gap: slices are 2 mm apart, but 4 mm after .*slices missing"):
        part_of(tmp_path, kind="volume", file="ct", label=3)
    write_series(tmp_path / "ct", small, "2")
    with pytest.raises(
        InputError, match=r"holds 2 series: say which .* 1.2.826.1 \(CT 'series 1', 17 images\); 1.2.826.2"
    ):
        part_of(tmp_path, kind="volume", file="ct", label=3)
    with pytest.raises(InputError, match="has no series of that series UID"):
        part_of(tmp_path, kind="volume", file="ct", label=3, series="1.2.3")
    part_of(tmp_path, kind="volume", file="ct", label=3, series="1.2.826.2")


def bad(tmp_path: Path, name: str) -> dict[str, Any]:
    """An entry of which something is wrong."""
    made = image(hand, CENTRE, 18, 1.5)
    entry: dict[str, Any] = {"kind": "volume", "file": "a.nrrd", "label": 3}
    if name == "nan":
        voxels = SimpleITK.GetArrayFromImage(made).astype(np.float32)
        voxels[3, 4, 5] = np.nan
        made = SimpleITK.GetImageFromArray(voxels)
    elif name == "colour":
        made = SimpleITK.Compose(made, made, made)
    elif name == "time":
        made = SimpleITK.JoinSeries([made, made])
    elif name == "metres":
        made.SetSpacing([s * 1e-3 for s in made.GetSpacing()])
    elif name == "both":
        entry |= {"above": -500.0}
    elif name == "none":
        del entry["label"]
    elif name == "range":
        entry = {"kind": "volume", "file": "a.nrrd", "above": 500.0}
    elif name == "absent":
        entry["label"] = 9
    path = written(made, tmp_path / "a.nrrd")
    if name == "spacing":
        path.write_bytes(b"\n".join(x for x in path.read_bytes().split(b"\n") if not x.startswith(b"space dir")))
    elif name == "truncated":
        path.write_bytes(path.read_bytes()[:-200])
    elif name == "gzip":
        entry["file"] = "a.nii.gz"
        whole = written(made, tmp_path / "a.nii.gz").read_bytes()
        (tmp_path / "a.nii.gz").write_bytes(whole[: len(whole) * 2 // 3])
    elif name == "huge":
        head = path.read_bytes().split(b"\n\n")[0].decode()
        path.write_text(
            "\n".join("sizes: 2048 2048 1500" if x.startswith("sizes") else x for x in head.split("\n")) + "\n\n"
        )
    elif name == "forms":
        entry["file"] = "a.nii"
        content = bytearray(written(made, tmp_path / "a.nii").read_bytes())
        struct.pack_into("<f", content, 268, -90.0)
        (tmp_path / "a.nii").write_bytes(content)
    return entry


@pytest.mark.parametrize(
    ("name", "phrase"),
    [
        ("nan", "has 1 voxels that are NaN or infinite"),
        ("colour", "has 3 values a voxel (colour?)"),
        ("time", "is a time series of 2 volumes, 24 x 24 x 24 x 2"),
        ("metres", "is 0.036 mm across"),
        ("both", "must be one of label, segment, and above or below"),
        ("none", "needs label, segment, above or below to say what is meant of 3 ("),
        ("range", "has no voxel in that range: its values go from 0 to 3"),
        ("absent", "label = 9: a.nrrd has no voxel of that label, but 3 ("),
        ("spacing", "does not say the size of its voxels"),
        ("truncated", "is damaged or cut short"),
        ("gzip", "is damaged or cut short"),
        ("huge", "holds 2048 x 2048 x 1500 voxels, 12.6 GB: crop it to the structure and what the robot reaches"),
        ("forms", "says two places that lie"),
    ],
)
def test_what_is_no_volume_is_refused_in_one_sentence(name: str, phrase: str, tmp_path: Path) -> None:
    entry = bad(tmp_path, name)
    with pytest.raises(InputError) as caught:
        part_of(tmp_path, "RAS", **entry)
    message = str(caught.value)
    assert (
        phrase in message and "scenario.toml: anatomy.1." in message and "\n" not in message and message.endswith(".")
    )
    assert "a.n" in message


def test_each_phantom_moves_when_it_is_flipped() -> None:
    """Or a flip would go unseen: in any of the other eight octants the hand is elsewhere."""
    points = near_points()
    for signs in np.ndindex(2, 2, 2):
        turned = CENTRE + (points - CENTRE) * (1 - 2 * np.array(signs))
        assert not any(signs) or np.abs(hand(turned) - hand(points)).max() > 3
    assert phantoms.MIRRORED.shape == (3, 3) and np.linalg.det(phantoms.MIRRORED) < 0


def scenario(folder: Path, **keys: Any) -> Scenario:
    """One with the hand as an obstacle, in RAS, whose robot stands far from it."""
    from places import ROBOTS

    written(image(hand, CENTRE, 18, 1.5), folder / "a.nii.gz")
    at_rest = {"rotate outer": 0, "rotate inner": 0, "translate inner": -17}
    content = {
        "robot": str(ROBOTS / "table_5_pair.toml"),
        "frame": "RAS",
        "start": at_rest,
        "goal": {"tip_mm": (CENTRE * TO_RAS).tolist()},
        "anatomy": [{"kind": "volume", "file": "a.nii.gz", "label": 3}],
    }
    content = {key: value for key, value in (content | keys).items() if value is not None}
    return scenario_from_dict(content, file=str(folder / "s.toml"), allow_outside=True)


def test_a_scenario_knows_its_frame_and_what_its_images_leave_open(tmp_path: Path) -> None:
    found = scenario(tmp_path)
    assert found.frame == "RAS"
    assert "anatomy.1 (a.nii.gz) its surface may be off by 0.9 mm, which the margin includes." in found.warnings


def test_a_target_outside_all_images_is_refused_and_a_flip_is_suspected(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"goal.tip_mm = .*: lies [\d.]+ mm outside all images: with x and y turned round"
    ):
        scenario(tmp_path, goal={"tip_mm": CENTRE.tolist()})
    away = (CENTRE * TO_RAS + 18 * OBLIQUE[:, 2] * TO_RAS + 7 * OBLIQUE[:, 2] * TO_RAS).tolist()
    with pytest.raises(InputError, match=r"target.2.tip_mm = .*: lies 7(\.\d+)? mm outside all images\."):
        scenario(tmp_path, goal=None, target=[{"tip_mm": (CENTRE * TO_RAS).tolist()}, {"tip_mm": away}])


def test_a_target_within_the_image_of_any_phase_is_within_the_images(tmp_path: Path) -> None:
    axis = OBLIQUE[:, 2] * TO_RAS
    target = CENTRE * TO_RAS + 22 * axis
    written(image(hand, CENTRE + 10 * OBLIQUE[:, 2], 30, 1.5), tmp_path / "b.nii.gz")
    moving = {"kind": "volume", "files": ["a.nii.gz", "b.nii.gz"], "label": 3, "motion_margin_mm": 5}
    scenario(tmp_path, goal={"tip_mm": target.tolist()}, anatomy=[moving])
    with pytest.raises(InputError, match="mm outside all images"):
        scenario(tmp_path, goal={"tip_mm": target.tolist()})


def test_without_the_extra_package_a_sentence_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(image(hand, CENTRE, 18, 2.0), tmp_path / "a.nrrd")
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(InputError, match=r"file = 'a.nrrd': needs SimpleITK: pip install ctrplan\[images\]"):
        part_of(tmp_path, kind="volume", file="a.nrrd", label=3)
