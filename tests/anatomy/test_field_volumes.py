"""What headers of volumes say of units, places and scaling is read, or one sentence names what is in the way."""

from __future__ import annotations

import bz2
import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from pydicom.dataset import FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian, RLELossless
from scipy.spatial.transform import Rotation

from ctrplan.anatomy.dicom import read_series
from ctrplan.anatomy.image import Image, ImageRefusal
from ctrplan.anatomy.image_file import read_image
from ctrplan.anatomy.patient_frame import TURNED

Array = Any
SIZE, SPACING = (12, 14, 10), np.array([0.8, 0.9, 1.1])
TURN = Rotation.from_rotvec([0.2, -0.1, 0.4]).as_matrix()
AFFINE = np.column_stack([TURN * SPACING, [-30.0, 12.0, -44.0]])  # of indices to RAS mm
VOXELS = np.zeros(SIZE, np.int16)  # (nx, ny, nz)
VOXELS[3:7, 4:9, 2:6] = 3
VOXELS[0, 0, 0] = 5
PLACE = AFFINE[:, :3] @ [4.5, 6.0, 3.5] + AFFINE[:, 3]


def nifti(
    path: Path, values: Array = VOXELS, order: str = "<", pack: Callable[[bytes], bytes] = bytes, **keys: Any
) -> Path:
    """A NIfTI-1 file by its standard."""
    kind = keys.get("type", {"i2": 4, "f8": 64, "u1": 2, "f4": 16}[values.dtype.str[1:]])
    head = bytearray(352)
    struct.pack_into(order + "i", head, 0, 348)
    struct.pack_into(order + "8h", head, 40, 3, *SIZE, 1, 1, 1, 1)
    struct.pack_into(order + "2h", head, 70, kind, 8 * values.itemsize)
    struct.pack_into(order + "8f", head, 76, *keys.get("pixdim", (1, *SPACING, 1, 1, 1, 1)))
    struct.pack_into(order + "3f", head, 108, 352, keys.get("slope", 1.0), keys.get("intercept", 0.0))
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


def check(image: Image, sign: Array = 1.0, values: Any = (0, 3, 5)) -> None:
    assert np.unique(image.voxels).tolist() == list(values)
    z, y, x = np.nonzero(image.voxels == values[1])
    place = image.place_m(np.column_stack([x, y, z]).astype(float)).mean(axis=0) * 1e3
    np.testing.assert_allclose(place * sign, PLACE, atol=1e-4)


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
    "qform and sform": (lambda p: nifti(p / "a.nii", quaternion=(0, 0, 0)), r"says two places .* \(qform, sform\)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_in_the_way_is_one_sentence(name: str, tmp_path: Path) -> None:
    make, phrase = REFUSED[name]
    with pytest.raises(ImageRefusal, match=phrase) as caught:
        read_image(make(tmp_path))
    assert "\n" not in str(caught.value) and "sitk" not in str(caught.value)


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
        **keys,
        "DimSize": "12 14 10",
        "ElementType": "MET_SHORT",
        "ElementDataFile": "LOCAL",
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


def dicom(folder: Path, k: int, **changes: Any) -> pydicom.Dataset:
    """Slice k as an object of X-ray angiography, whose pixels GDCM would place by ImagerPixelSpacing."""
    lps = TURNED[:, None] * AFFINE
    made = pydicom.Dataset()
    made.file_meta = FileMetaDataset()
    made.file_meta.TransferSyntaxUID = changes.pop("syntax", ExplicitVRLittleEndian)
    made.SOPClassUID = made.file_meta.MediaStorageSOPClassUID = changes.pop("sop", "1.2.840.10008.5.1.4.1.1.12.1")
    made.SOPInstanceUID = made.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.{k + 1}"
    made.SeriesInstanceUID, made.StudyInstanceUID, made.Modality = "1.2.3", "1.2", "XA"
    made.Rows, made.Columns, made.SamplesPerPixel = SIZE[1], SIZE[0], 1
    made.PhotometricInterpretation, made.PixelRepresentation = "MONOCHROME2", 1
    made.BitsAllocated, made.BitsStored, made.HighBit = 16, 16, 15
    made.PixelSpacing, made.ImagerPixelSpacing = [f"{SPACING[1]}", f"{SPACING[0]}"], ["0.3", "0.3"]
    made.ImagePositionPatient = [f"{x:.8f}" for x in lps @ [0, 0, k, 1]]
    made.ImageOrientationPatient = [f"{x:.8f}" for x in (lps[:, :2] / SPACING[:2]).T.ravel()]
    values = changes.pop("values", VOXELS[:, :, k % SIZE[2]]).astype(np.int16)
    made.PixelData = values.T.tobytes()
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def series(folder: Path, change: Callable[[int], dict[str, Any]] = lambda k: {}, compress: Any = None) -> Path:
    for k in range(SIZE[2]):
        made = dicom(folder, k, **change(k))
        if compress is not None:
            made.compress(compress)
        made.save_as(folder / f"I{(7 * k) % 10}.dcm", enforce_file_format=True)
    return folder


def by_slice(k: int) -> dict[str, Any]:
    """PET's way: a slope of its own in every slice."""
    return {
        "values": VOXELS[:, :, k] * (k + 1) + 10,
        "RescaleSlope": f"{1 / (k + 1):.12f}",
        "RescaleIntercept": f"{-10 / (k + 1):.10f}",
    }


DICOM: dict[str, Any] = {
    "X-ray angiography": {},
    "an anonymised kind": {"change": lambda k: {"sop": "1.2.826.0.1.3680043.8.498.1"}},
    "implicit": {"change": lambda k: {"syntax": ImplicitVRLittleEndian}},
    "packed runs": {"compress": RLELossless},
    "a scaling in each slice": {"change": by_slice},
    "a scaling in each slice, packed": {"change": by_slice, "compress": RLELossless},
    "slope and intercept of a kind for which GDCM passes them over": {
        "change": lambda k: {"values": VOXELS[:, :, k] + 1024, "RescaleSlope": "1", "RescaleIntercept": "-1024"}
    },
    "overlays in the upper bits": {
        "change": lambda k: {"values": VOXELS[:, :, k] | 0x4000, "BitsStored": 12, "HighBit": 11}
    },
}


@pytest.mark.parametrize("name", DICOM)
def test_a_dicom_series_is_what_its_tags_say(name: str, tmp_path: Path) -> None:
    check(read_series(series(tmp_path, **DICOM[name]), None), TURNED)


def test_a_scout_is_left_out_by_name_and_two_stacks_are_refused(tmp_path: Path) -> None:
    across = ["1", "0", "0", "0", "0", "-1"]
    series(tmp_path)
    dicom(tmp_path, 50, values=VOXELS[:, :, 3], ImageOrientationPatient=across).save_as(tmp_path / "SCOUT.dcm")
    image = read_series(tmp_path, None)
    assert len(image.notes) == 1 and image.notes[0].startswith(
        "is read without SCOUT.dcm, which lies across the other 10"
    )
    check(image, TURNED)
    for k in (51, 52, 53):
        dicom(tmp_path, k, values=VOXELS[:, :, 3], ImageOrientationPatient=across).save_as(tmp_path / f"S{k}.dcm")
    with pytest.raises(ImageRefusal, match=r"slices of different orientations or sizes \(10 from I0.dcm, 4 from S"):
        read_series(tmp_path, None)


def test_a_scout_without_a_place_is_left_out(tmp_path: Path) -> None:
    series(tmp_path)
    scout = dicom(tmp_path, 50, values=VOXELS[:, :, 3], ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
    del scout.ImagePositionPatient
    scout.save_as(tmp_path / "TOPO.dcm")
    assert "TOPO.dcm" in read_series(tmp_path, None).notes[0]


def test_places_of_slices_count_and_a_spacing_that_contradicts_them_is_said(tmp_path: Path) -> None:
    image = read_series(series(tmp_path, lambda k: {"SpacingBetweenSlices": "5"}), None)
    check(image, TURNED)
    assert image.notes == ("says slices are 5 mm apart, their places 1.1 mm: the places are taken",)


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        ({"PixelSpacing": None}, r"which does not say its place.* \(ImagerPixelSpacing is that at the detector\)"),
        ({"NumberOfFrames": "3"}, r"holds I0.dcm, 3 frames that do not say where each lies \(a film\?\)"),
        ({"SamplesPerPixel": 3}, "holds colour images"),
        ({"ImageOrientationPatient": ["1", "0", "0", "1", "0", "0"]}, "whose rows and columns are not at right angles"),
    ],
)
def test_dicom_files_that_are_no_volume(change: dict[str, Any], phrase: str, tmp_path: Path) -> None:
    with pytest.raises(ImageRefusal, match=phrase):
        read_series(series(tmp_path, lambda k: change), None)


def group(**tags: Any) -> Sequence:
    made = pydicom.Dataset()
    for name, value in tags.items():
        setattr(made, name, value)
    return Sequence([made])


def enhanced(folder: Path, frames: list[dict[str, Any]], pixels: bytes, **tags: Any) -> Path:
    """One file of several frames; each of `frames` has what its functional groups say of its own."""
    made, first = dicom(folder, 0, **tags), dicom(folder, 0)
    for name in ("PixelSpacing", "ImagerPixelSpacing", "ImagePositionPatient", "ImageOrientationPatient"):
        delattr(made, name)
    shared = pydicom.Dataset()
    shared.PixelMeasuresSequence = group(PixelSpacing=first.PixelSpacing, SliceThickness=str(SPACING[2]))
    shared.PlaneOrientationSequence = group(ImageOrientationPatient=first.ImageOrientationPatient)
    made.SharedFunctionalGroupsSequence = Sequence([shared])
    each = []
    for frame in frames:
        own = pydicom.Dataset()
        own.PlanePositionSequence = group(ImagePositionPatient=dicom(folder, frame["k"]).ImagePositionPatient)
        if "slope" in frame:
            own.PixelValueTransformationSequence = group(RescaleSlope=frame["slope"], RescaleIntercept="0")
        if "segment" in frame:
            own.SegmentIdentificationSequence = group(ReferencedSegmentNumber=frame["segment"])
        each.append(own)
    made.PerFrameFunctionalGroupsSequence = Sequence(each)
    made.NumberOfFrames, made.PixelData = str(len(frames)), pixels
    made.save_as(folder / "E1.dcm", enforce_file_format=True)
    return folder


def test_frames_of_one_file_lie_where_each_says(tmp_path: Path) -> None:
    """Out of order, and with a scaling of each frame."""
    order = [(7 * k) % SIZE[2] for k in range(SIZE[2])]
    frames = [{"k": k, "slope": "0.5" if k % 2 else "1"} for k in order]
    stored = [VOXELS[:, :, k].T * (2 if k % 2 else 1) for k in order]
    data = b"".join(values.astype(np.int16).tobytes() for values in stored)
    check(read_series(enhanced(tmp_path, frames, data, sop="1.2.840.10008.5.1.4.1.1.2.1"), None), TURNED)


@pytest.mark.parametrize("kind", ["BINARY", "FRACTIONAL"])
def test_a_segmentation_object_has_its_segments(kind: str, tmp_path: Path) -> None:
    """Frames without a voxel are left out, as they may be; names and labels are those of the file."""
    frames, masks = [], []
    for number in (3, 5):
        for k in range(SIZE[2]):
            mask = (number == VOXELS[:, :, k].T).astype(np.uint8)
            if mask.any():
                frames.append({"k": k, "segment": number})
                masks.append(mask)
    bits = np.concatenate([mask.ravel() for mask in masks])
    data = (
        np.packbits(bits, bitorder="little").tobytes() if kind == "BINARY" else (bits * 255).astype(np.uint8).tobytes()
    )
    depth = 1 if kind == "BINARY" else 8
    named = [group(SegmentNumber=n, SegmentLabel=name)[0] for n, name in ((3, "lumen"), (5, "vessel"))]
    keys: dict[str, Any] = {"BitsAllocated": depth, "BitsStored": depth, "HighBit": depth - 1, "PixelRepresentation": 0}
    keys |= {"SegmentationType": kind, "SegmentSequence": Sequence(named), "Modality": "SEG"}
    keys |= {"MaximumFractionalValue": 255} if kind == "FRACTIONAL" else {}
    image = read_series(
        enhanced(tmp_path, frames, data + b"\0" * (len(data) % 2), sop="1.2.840.10008.5.1.4.1.1.66.4", **keys), None
    )
    assert [(s.name, s.label) for s in image.segments] == [("lumen", 3), ("vessel", 5)]
    check(image, TURNED)


def test_segments_that_overlap_are_layers(tmp_path: Path) -> None:
    frames = [{"k": k, "segment": number} for number in (1, 2) for k in range(SIZE[2])]
    bits = np.concatenate([(VOXELS[:, :, f["k"]].T > 0).astype(np.uint8).ravel() for f in frames])
    named = [group(SegmentNumber=n, SegmentLabel=f"s{n}")[0] for n in (1, 2)]
    keys: dict[str, Any] = {
        "BitsAllocated": 1,
        "BitsStored": 1,
        "HighBit": 0,
        "PixelRepresentation": 0,
        "Modality": "SEG",
    }
    keys |= {"SegmentationType": "BINARY", "SegmentSequence": Sequence(named)}
    image = read_series(enhanced(tmp_path, frames, np.packbits(bits, bitorder="little").tobytes(), **keys), None)
    assert image.voxels.shape[3] == 2 and [(s.label, s.layer) for s in image.segments] == [(1, 0), (1, 1)]
    np.testing.assert_array_equal(image.voxels[..., 0], image.voxels[..., 1])


def test_the_other_order_of_bytes(tmp_path: Path) -> None:
    for k in range(SIZE[2]):
        made = dicom(tmp_path, k, syntax=ExplicitVRBigEndian)
        made.PixelData = np.frombuffer(made.PixelData, "<i2").astype(">i2").tobytes()
        made.save_as(tmp_path / f"{k}.dcm", implicit_vr=False, little_endian=False, enforce_file_format=True)
    check(read_series(tmp_path, None), TURNED)
