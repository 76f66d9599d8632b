"""What headers of volumes say of units, places and scaling is read, or one sentence names what is in the way."""

from __future__ import annotations

import bz2
import gzip
import struct
from codecs import BOM_UTF8
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from field_volume import AFFINE, SIZE, SPACING, TURN, VOXELS, Array, check
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.image import ImageRefusal
from ctrplan.anatomy.image_file import read_image
from ctrplan.anatomy.patient_frame import TURNED


def nifti(
    path: Path, values: Array = VOXELS, order: str = "<", pack: Callable[[bytes], bytes] = bytes, **keys: Any
) -> Path:
    """A NIfTI-1 file by its standard."""
    kind = keys.get("type", {"i2": 4, "f8": 64, "u1": 2, "f4": 16}[values.dtype.str[1:]])
    head = bytearray(352)
    struct.pack_into(order + "i", head, 0, 348)
    struct.pack_into(order + "8h", head, 40, 3, *SIZE, 1, 1, 1, 1)
    struct.pack_into(order + "2h", head, 70, kind, keys.get("bits", 8 * values.itemsize))
    struct.pack_into(order + "8f", head, 76, *keys.get("pixdim", (1, *SPACING, 1, 1, 1, 1)))
    struct.pack_into(
        order + "3f", head, 108, keys.get("start", 352), keys.get("slope", 1.0), keys.get("intercept", 0.0)
    )
    head[123] = keys.get("unit", 2)
    struct.pack_into(order + "2h", head, 252, *keys.get("codes", (1, 1)))
    x, y, z, _ = Rotation.from_matrix(TURN).as_quat(canonical=True)
    struct.pack_into(order + "6f", head, 256, *keys.get("quaternion", (x, y, z)), *AFFINE[:, 3] * keys.get("size", 1.0))
    struct.pack_into(order + "12f", head, 280, *(AFFINE * keys.get("size", 1.0)).ravel())
    head[344:348] = keys.get("magic", b"n+1\0")
    data = values.astype(order + values.dtype.str[1:]).tobytes(order="F")
    path.write_bytes(pack(bytes(head) + data))
    return path


def nifti_2(path: Path, **keys: Any) -> Path:
    head = bytearray(544)
    struct.pack_into("<i8s2h", head, 0, 540, b"n+2\0\r\n\x1a\n", 4, 16)
    struct.pack_into("<8q", head, 16, 3, *SIZE, 1, 1, 1, 1)
    struct.pack_into("<8d", head, 104, 1, *SPACING, 1, 1, 1, 1)
    struct.pack_into("<q2d", head, 168, 544, keys.get("slope", 1.0), keys.get("intercept", 0.0))
    struct.pack_into("<2i", head, 344, 0, 1)
    struct.pack_into("<12d", head, 400, *AFFINE.ravel())
    struct.pack_into("<i", head, 500, 2)
    path.write_bytes(bytes(head) + VOXELS.tobytes(order="F"))
    return path


SCALED = (VOXELS.astype(int) * 1000).astype(np.int16)
FEW = np.where(VOXELS == 3, 2, VOXELS).astype(np.int16)
NIFTI: dict[str, Callable[[Path], Path]] = {
    "a slope that makes labels": lambda p: nifti(p / "a.nii", SCALED, slope=0.001),
    "a slope of 0 means none": lambda p: nifti(p / "a.nii", slope=0.0, intercept=7.0),
    "a slope of 0 in NIfTI-2": lambda p: nifti_2(p / "a.nii", slope=0.0, intercept=7.0),
    "a slope that is none": lambda p: nifti(p / "a.nii", slope=float("nan")),
    "slope and intercept": lambda p: nifti(p / "a.nii", (VOXELS * 2 + 8).astype(np.int16), slope=0.5, intercept=-4.0),
    "labels off by rounding": lambda p: nifti(p / "a.nii", VOXELS * 1.00000005),
    "the sform alone": lambda p: nifti(p / "a.nii", codes=(0, 2), pixdim=(1,) * 8),
    "the sform alone, no pixdim": lambda p: nifti(p / "a.nii", codes=(0, 1), pixdim=(0,) * 8),
    "the sform alone, a damaged quaternion": lambda p: nifti(p / "a.nii", codes=(0, 1), quaternion=(3, 3, 3)),
    "the qform alone": lambda p: nifti(p / "a.nii", codes=(1, 0)),
    "metres": lambda p: nifti(p / "a.nii", unit=1, size=1e-3, codes=(0, 1)),
    "micrometres": lambda p: nifti(p / "a.nii", unit=3, size=1e3, codes=(0, 1)),
    "no unit": lambda p: nifti(p / "a.nii", unit=0),
    "the other order of bytes": lambda p: nifti(p / "a.nii", order=">"),
    "gzip without its ending": lambda p: nifti(p / "a.nii", pack=gzip.compress),
    "an ending without gzip": lambda p: nifti(p / "a.nii.gz"),
    "bzip2": lambda p: nifti(p / "a.nii", pack=bz2.compress),
}


@pytest.mark.parametrize("name", NIFTI)
def test_a_nifti_file_is_what_its_header_says(name: str, tmp_path: Path) -> None:
    check(read_image(NIFTI[name](tmp_path)))


def test_a_size_that_is_passed_over_is_said(tmp_path: Path) -> None:
    image = read_image(nifti(tmp_path / "a.nii", codes=(0, 2), pixdim=(1,) * 8))
    assert image.notes == (
        "says voxels of 1 x 1 x 1 mm in pixdim and of 0.8 x 0.9 x 1.1 mm in its sform, which is taken",
    )


def test_places_of_a_standard_brain_are_said(tmp_path: Path) -> None:
    (note,) = read_image(nifti(tmp_path / "a.nii", codes=(0, 4))).notes
    assert "in a standard brain (sform_code 4)" in note


def zipped(data: bytes) -> bytes:
    return b"PK\x03\x04" + data


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "bits": (lambda p: nifti(p / "a.nii", type=1), "has one bit a voxel: save it with 8 bits"),
    "colour": (lambda p: nifti(p / "a.nii", type=128), "has 3 values a voxel"),
    "a pair": (lambda p: nifti(p / "a.nii", magic=b"ni1\0"), r"has its voxels in another file \(.img\)"),
    "Analyze": (lambda p: nifti(p / "a.nii", magic=b"\0" * 4), "is an Analyze file or damaged"),
    "zip": (lambda p: nifti(p / "a.nii", pack=zipped), "is packed by zip: unpack it first"),
    "a NRRD file": (lambda p: named(nrrd(p / "a.nrrd"), "a.nii"), "is a NRRD file by its first bytes: .* end in .nrrd"),
    "a NIfTI file": (lambda p: named(nifti(p / "a.nii"), "a.mha"), "does not say the size of its voxels"),
    "no origin": (lambda p: nrrd(p / "a.nrrd", without="space origin"), "does not say where its first voxel is"),
    "no offset": (lambda p: mha(p / "a.mha", without="Offset"), r"does not say where its first voxel is \(no Offset\)"),
    "furlongs": (
        lambda p: nrrd(p / "a.nrrd", units=("furlong",) * 3),
        r"has places in furlong \(space units\): must be",
    ),
    "mixed units": (lambda p: nrrd(p / "a.nrrd", units=("mm", "cm", "mm")), r"has places in cm, mm \(space units\)"),
    "a damaged bzip2": (
        lambda p: nrrd(p / "a.nrrd", "bzip2", lambda data: bz2.compress(data)[:-9]),
        "is damaged or cut",
    ),
    "a type of half the bytes": (
        lambda p: nifti(p / "a.nii", type=2),
        r"says 16 bits a voxel \(bitpix\), and a type of 8",
    ),
    "twice the voxels": (
        lambda p: nifti(p / "a.nii", np.concatenate([VOXELS, VOXELS], axis=2)),
        "bytes of voxels or more, its header makes 3360 of dim and datatype: they must agree",
    ),
    "no beginning": (lambda p: nifti(p / "a.nii", start=float("nan")), r"where its voxels begin \(vox_offset\)"),
    "no place beside spacings": (
        lambda p: nrrd(p / "a.nrrd", without="space", extra="spacings: 1 1 1"),
        "does not say where its first voxel is",
    ),
    "a NRRD of a byte order mark": (lambda p: begun(nrrd(p / "a.nrrd"), BOM_UTF8), "begins with a byte order mark"),
    "a NRRD that its reader refuses": (
        lambda p: nrrd(p / "a.nrrd", space="right-posterior-superior"),
        "can't be read: .*couldn't parse space",
    ),
    "no numbers of directions": (lambda p: nrrd(p / "a.nrrd", size=float("nan")), "three finite numbers each"),
    "a NRRD of fewer bytes": (lambda p: nrrd(p / "a.nrrd", pack=lambda d: d[:-400]), "has 2960 bytes .* 3360 are due"),
    "a NRRD of more bytes": (lambda p: nrrd(p / "a.nrrd", pack=lambda d: d + d), "makes 3360 of sizes and type"),
    "a MetaImage of another type": (
        lambda p: mha(p / "a.mha", ElementType="MET_UCHAR"),
        "has 3360 bytes of voxels or more, its header makes 1680 of DimSize and ElementType: they must agree",
    ),
    "decimal commas": (
        lambda p: mha(p / "a.mha", ElementSpacing="0,8 0,9 1,1"),
        "says ElementSpacing = 0,8 0,9 1,1: must be 3 numbers with a decimal point",
    ),
    "voxels that are not there": (
        lambda p: mha(p / "a.mhd", ElementDataFile="b.raw"),
        r"has its voxels in another file, b.raw, which is not beside it \(ElementDataFile\)",
    ),
    "voxels of elsewhere": (
        lambda p: mha(p / "a.mhd", ElementDataFile="../b.raw"),
        "has its voxels outside its folder",
    ),
    "slices by themselves": (lambda p: mha(p / "a.mhd", ElementDataFile="LIST"), "has its slices in several files"),
    **{
        f"{what} called {suffix}": (lambda p, s=suffix, c=content: written(p / f"a.{s}", c), phrase)
        for suffix in ("nii", "nii.gz", "nrrd", "mha", "mhd")
        for what, content, phrase in (
            ("nothing", b"", "is empty"),
            ("a web page", b"\n<!DOCTYPE html><p>404", "is a web page"),
            ("a pointer", b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of Git LFS"),
        )
    },
    "qform and sform": (lambda p: nifti(p / "a.nii", quaternion=(0, 0, 0)), r"says two places .* \(qform, sform\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_in_the_way_is_one_sentence(name: str, tmp_path: Path) -> None:
    make, phrase = REFUSED[name]
    with pytest.raises(ImageRefusal, match=phrase) as caught:
        read_image(make(tmp_path))
    assert "\n" not in str(caught.value) and "sitk" not in str(caught.value)


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def begun(path: Path, mark: bytes) -> Path:
    return written(path, mark + path.read_bytes())


def named(path: Path, name: str) -> Path:
    return path.rename(path.with_name(name))


def nrrd(
    path: Path,
    encoding: str = "raw",
    pack: Callable[[bytes], bytes] = bytes,
    units: tuple[str, ...] = (),
    size: float = 1.0,
    without: str = "",
    data_file: str = "",
    space: str = "right-anterior-superior",
    extra: str = "",
) -> Path:
    vectors = [*(AFFINE[:, :3] * size).T.tolist(), (AFFINE[:, 3] * size).tolist()]
    said = ["({!r},{!r},{!r})".format(*vector) for vector in vectors]
    lines = ["NRRD0005", "# a comment", "type: short", "dimension: 3", f"space: {space}"]
    lines += [
        f"sizes: {SIZE[0]} {SIZE[1]} {SIZE[2]}",
        f"space directions: {' '.join(said[:3])}",
        f"space origin: {said[3]}",
    ]
    lines += ["kinds: domain domain domain", "endian: little", f"encoding: {encoding}"]
    lines += ["space units: " + " ".join(f'"{unit}"' for unit in units)] if units else []
    lines += [extra] if extra else []
    data = pack(VOXELS.tobytes(order="F"))
    if data_file:
        (path.parent / data_file).write_bytes(data)
        lines, data = [*lines, f"data file: {data_file}"], b""
    text = "\n".join(line for line in lines if not without or not line.startswith(without))
    path.write_bytes(text.encode() + (b"\n\n" + data if not data_file else b"\n"))
    return path


NRRD: dict[str, Callable[[Path], Path]] = {
    "centimetres": lambda p: nrrd(p / "a.nrrd", units=("cm",) * 3, size=0.1),
    "metres": lambda p: nrrd(p / "a.nrrd", units=("m",) * 3, size=1e-3),
    "micrometres": lambda p: nrrd(p / "a.nrrd", units=("um",) * 3, size=1e3),
    "millimetres": lambda p: nrrd(p / "a.nrrd", units=("mm",) * 3),
    "bzip2": lambda p: nrrd(p / "a.nrrd", "bzip2", bz2.compress),
    "bzip2 apart": lambda p: nrrd(p / "a.nhdr", "bzip2", bz2.compress, data_file="a.raw.bz2"),
    "gzip": lambda p: nrrd(p / "a.nrrd", "gzip", gzip.compress),
    "units spelt out": lambda p: nrrd(p / "a.nrrd", units=("centimeters",) * 3, size=0.1),
    "units as a remark": lambda p: nrrd(p / "a.nrrd", extra='space units:="cm" "cm" "cm"'),
    "bytes that fill a block": lambda p: nrrd(p / "a.nrrd", pack=lambda data: data + bytes(64)),
    "packed as a whole": lambda p: packed_whole(nrrd(p / "a.nrrd")),
}


def packed_whole(path: Path) -> Path:
    path.write_bytes(gzip.compress(path.read_bytes()))
    return path


@pytest.mark.parametrize("name", NRRD)
def test_a_nrrd_file_is_what_its_header_says(name: str, tmp_path: Path) -> None:
    image = read_image(NRRD[name](tmp_path))
    assert image.frame == "RAS"
    check(image)


def test_values_that_were_others_are_said(tmp_path: Path) -> None:
    assert any(
        "old min" in note for note in read_image(nrrd(tmp_path / "a.nrrd", extra="old min: -9\nold max: 9")).notes
    )


def mha(
    path: Path, without: str = "", size: float = 1.0, values: Array = VOXELS, flip: float = 1.0, **keys: object
) -> Path:
    """In LPS, as MetaImage has it."""
    lps = TURNED[:, None] * AFFINE * size
    axes = lps[:, :3] / SPACING / size
    axes[:, 1] *= flip
    fields: dict[str, object] = {
        "NDims": 3,
        "BinaryData": True,
        "BinaryDataByteOrderMSB": False,
        "TransformMatrix": " ".join(map(repr, axes.T.ravel().tolist())),
        "Offset": " ".join(map(repr, lps[:, 3].tolist())),
        "ElementSpacing": f"{SPACING[0] * size!r} {SPACING[1] * size * flip!r} {SPACING[2] * size!r}".replace(
            "np.float64", ""
        ),
        "DimSize": "12 14 10",
        "ElementType": "MET_SHORT",
        **keys,
        "ElementDataFile": keys.get("ElementDataFile", "LOCAL"),
    }
    head = "".join(f"{name} = {value}\n" for name, value in fields.items() if name != without)
    path.write_bytes(head.replace("(", "").replace(")", "").encode() + values.tobytes(order="F"))
    return path


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"size": 0.1, "DistanceUnits": "cm"},
        {"size": 1e3, "DistanceUnits": "um"},
        {"DistanceUnits": "mm"},
        {"flip": -1.0},
        {"values": (VOXELS * 2 + 8).astype(np.int16)}
        | {"ElementToIntensityFunctionSlope": 0.5, "ElementToIntensityFunctionOffset": -4},
    ],
)
def test_a_meta_image_is_what_its_header_says(keys: Any, tmp_path: Path) -> None:
    check(read_image(mha(tmp_path / "a.mha", **keys)), TURNED)


def test_a_size_of_voxels_beside_their_distance_is_said(tmp_path: Path) -> None:
    image = read_image(mha(tmp_path / "a.mha", ElementSize="1 1 1"))
    check(image, TURNED)
    assert len(image.notes) == 1 and "ElementSize" in image.notes[0]
    assert read_image(mha(tmp_path / "b.mha", ElementSize="0.8 0.9 1.1")).notes == ()


def straight(path: Path, *fields: str) -> Path:
    """A NRRD file of spacings, whose axes are those of the patient in a space that it does not name."""
    lines = ["NRRD0005", "type: short", "dimension: 3", "sizes: 12 14 10", "endian: little", "encoding: raw", *fields]
    path.write_bytes("\n".join(lines).encode() + b"\n\n" + VOXELS.tobytes(order="F"))
    return path


SPACED, MINS = "spacings: 0.8 0.9 1.1", "axis mins: -30 12 -44"
CELLS, NODES = "axis maxs: -20.4 24.6 -33", "axis maxs: -21.2 23.7 -34.1"


@pytest.mark.parametrize(
    ("fields", "origin_mm"),
    [
        ([SPACED, MINS, "centerings: node node node"], (-30, 12, -44)),
        ([SPACED, MINS, "centers: cell cell cell"], (-29.6, 12.45, -43.45)),
        ([SPACED, "axismins: -30 12 -44", "centers: cell cell cell"], (-29.6, 12.45, -43.45)),
        ([SPACED, MINS, CELLS], (-29.6, 12.45, -43.45)),
        ([SPACED, MINS, NODES, "centerings: node node node"], (-30, 12, -44)),
        ([SPACED, "axis mins: -3 1.2 -4.4", "centers: cell cell cell", 'units: "cm" "cm" "cm"'], None),
    ],
)
def test_a_nrrd_file_whose_axes_begin_somewhere(
    fields: list[str], origin_mm: tuple[float, ...] | None, tmp_path: Path
) -> None:
    if origin_mm is None:  # spacings in centimetres
        origin_mm, fields = (-26.0, 16.5, -38.5), fields
    image = read_image(straight(tmp_path / "a.nrrd", *fields))
    np.testing.assert_allclose(image.origin_m * 1e3, origin_mm, atol=1e-9)
    assert image.frame is None


@pytest.mark.parametrize(
    ("fields", "phrase"),
    [
        (
            [SPACED, MINS],
            r"does not say whether axis mins is where the first voxel begins or its centre \(centerings\)",
        ),
        ([SPACED, MINS, "centers: cell ??? cell"], r"does not say whether axis mins .* \(centerings\)"),
        ([SPACED, MINS, NODES], r"does not say whether axis mins .* \(centerings\)"),
        ([SPACED, "axis mins: nan nan nan"], "says axis mins = nan nan nan: must be 3 numbers"),
        (
            [SPACED, MINS, "axis maxs: 0 24.6 -33"],
            "two sizes of its voxels, by axis mins and maxs",
        ),
        ([SPACED, MINS, CELLS, "centerings: node node node"], "says two sizes of its voxels"),
        ([SPACED, MINS, "centerings: cell cell node"], "say cell or node for all axes"),
    ],
)
def test_axes_that_begin_nowhere_are_refused_by_name(fields: list[str], phrase: str, tmp_path: Path) -> None:
    with pytest.raises(ImageRefusal, match=phrase):
        read_image(straight(tmp_path / "a.nrrd", *fields))


@pytest.mark.parametrize("name", ["old min", "oldmin"])
def test_fields_go_by_either_of_their_names(name: str, tmp_path: Path) -> None:
    assert any("old min" in note for note in read_image(nrrd(tmp_path / "a.nrrd", extra=f"{name}: -9")).notes)


@pytest.mark.parametrize(
    ("keys", "phrase"),
    [
        ({"Position": "0 0 0"}, "says Offset and Position, which differ: save it with one"),
        ({"Origin": "0 0 0"}, "says Offset and Origin, which differ"),
        ({"Rotation": "1 0 0 0 1 0 0 0 1"}, "says TransformMatrix and Rotation, which differ"),
        ({"Orientation": "1 0 0 0 1 0 0 0 1"}, "says TransformMatrix and Orientation, which differ"),
        (
            {"CenterOfRotation": "5 0 0"},
            r"turns about a point of its own \(CenterOfRotation\): save it with Offset alone",
        ),
        ({"offset": "0 0 0"}, "(?i)says Offset twice, and differently"),
        ({"elementspacing": "1 1 1"}, "(?i)says ElementSpacing twice, and differently"),
        ({"transformmatrix": "1 0 0 0 1 0 0 0 1"}, "(?i)says TransformMatrix twice, and differently"),
    ],
)
def test_a_meta_image_that_says_a_place_twice_is_refused(keys: Any, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(ImageRefusal, match=phrase):
        read_image(mha(tmp_path / "a.mha", **keys))


def test_remarks_may_be_repeated(tmp_path: Path) -> None:
    check(read_image(mha(tmp_path / "a.mha", Comment="one", comment="another")), TURNED)


def test_what_a_meta_image_says_twice_alike_is_read(tmp_path: Path) -> None:
    place = " ".join(map(repr, (TURNED * AFFINE[:, 3]).tolist()))
    image = read_image(mha(tmp_path / "a.mha", Position=place, CenterOfRotation="0 0 0", AnatomicalOrientation="LPI"))
    check(image, TURNED)
    assert image.frame == "LPS" and image.notes == ()


@pytest.mark.parametrize("letters", ["ASR", "RAI"])
def test_letters_of_the_sides_that_the_axes_do_not_bear_out_are_said(letters: str, tmp_path: Path) -> None:
    image = read_image(mha(tmp_path / "a.mha", AnatomicalOrientation=letters))
    assert image.frame is None
    assert image.notes == (
        f"says sides by letters (AnatomicalOrientation = {letters}) that its axes (TransformMatrix) do not run from: "
        "the letters are passed over",
    )
