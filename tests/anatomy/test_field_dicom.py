"""What tags of DICOM files say of places, frames and scaling is read, or one sentence names what is in the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
import pytest
from field_volume import AFFINE, SIZE, SPACING, VOXELS, check
from pydicom.dataset import FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, ExplicitVRLittleEndian, ImplicitVRLittleEndian, RLELossless

from ctrplan.anatomy.dicom import read_series
from ctrplan.anatomy.image import ImageRefusal
from ctrplan.anatomy.patient_frame import TURNED


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


def test_numbers_that_a_series_leaves_out_are_said(tmp_path: Path) -> None:
    """Once a series of every second slice was read as if it were whole: its gaps are even."""
    series(tmp_path, lambda k: {"InstanceNumber": str(7 + k)})
    assert read_series(tmp_path, None).notes == ()
    for file in tmp_path.iterdir():
        if int(pydicom.dcmread(file).InstanceNumber) % 2:
            file.unlink()
    (note,) = read_series(tmp_path, None).notes
    assert note == "leaves out 4 numbers between those of its images (InstanceNumber): are slices missing?"


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


@pytest.mark.parametrize("there", [(0, 2, 4), (1, 6), (0, 2, 5), (2, 3, 4)])
def test_slices_that_a_segmentation_leaves_out_are_empty(there: tuple[int, ...], tmp_path: Path) -> None:
    """Once two slices 5.5 mm apart became one solid, and slices 2 and 3 places apart were refused as uneven."""
    frames = [{"k": k, "segment": 1} for k in there]
    bits = np.ones(len(there) * SIZE[0] * SIZE[1], np.uint8)
    keys: dict[str, Any] = {"BitsAllocated": 1, "BitsStored": 1, "HighBit": 0, "PixelRepresentation": 0}
    keys |= {"SegmentationType": "BINARY", "SegmentSequence": group(SegmentNumber=1, SegmentLabel="nodes")}
    data = np.packbits(bits, bitorder="little").tobytes()
    enhanced(tmp_path, frames, data, sop="1.2.840.10008.5.1.4.1.1.66.4", **keys)
    made = pydicom.dcmread(tmp_path / "E1.dcm")
    made.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = f"{SPACING[2]}"
    made.save_as(tmp_path / "E1.dcm")
    image = read_series(tmp_path, None)
    assert (np.flatnonzero(image.voxels.any(axis=(1, 2))) + there[0]).tolist() == list(there)
    assert image.spacing_m[2] == pytest.approx(SPACING[2] * 1e-3)


@pytest.mark.parametrize(
    ("place", "said"),
    [
        (lambda k: k // 2, "10 slices at 5 places, up to 2 at one"),
        (lambda k: max(k, 1), "10 slices at 9 places, up to 2 at one"),
        (lambda k: 0, "10 slices at one place"),
    ],
)
def test_slices_at_one_place_are_counted(place: Any, said: str, tmp_path: Path) -> None:
    """Two phases of five places are not six slices at one place."""
    series(tmp_path, lambda k: {"ImagePositionPatient": dicom(tmp_path, place(k)).ImagePositionPatient})
    with pytest.raises(ImageRefusal, match=f"holds {said}: a time series or doubled images"):
        read_series(tmp_path, None)


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


@pytest.mark.parametrize("content", [b"", b"\x1f\x8b packed", b"\0" * 128 + b"DICM cut"])
def test_a_damaged_slice_at_an_end_is_said_by_name(content: bytes, tmp_path: Path) -> None:
    series(tmp_path)
    (tmp_path / "I3.dcm").write_bytes(content)  # k = 9, the last
    (tmp_path / ".hidden").write_bytes(b"")
    (tmp_path / "DICOMDIR").write_bytes(b"")
    image = read_series(tmp_path, None)
    assert image.voxels.shape[0] == SIZE[2] - 1
    assert image.notes == ("is read without files that are no DICOM image, or a damaged one: I3.dcm",)


def test_a_folder_of_folders_names_the_one_that_is_meant(tmp_path: Path) -> None:
    (tmp_path / "ct").mkdir()
    series(tmp_path / "ct")
    (tmp_path / "report.pdf").write_bytes(b"%PDF")
    with pytest.raises(ImageRefusal, match=r"DICOM images: ct in it does, name that folder, but .*: report.pdf"):
        read_series(tmp_path, None)


def test_files_without_a_series_are_one(tmp_path: Path) -> None:
    series(tmp_path)
    for path in tmp_path.iterdir():
        made = pydicom.dcmread(path)
        del made.SeriesInstanceUID
        made.save_as(path)
    check(read_series(tmp_path, None), TURNED)


def test_a_number_of_images_that_is_stated_and_not_there_is_said(tmp_path: Path) -> None:
    (note,) = read_series(series(tmp_path, lambda k: {"ImagesInAcquisition": 12}), None).notes
    assert note == "says 12 images (ImagesInAcquisition), and 10 are read: are some missing?"


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (lambda k: {"FrameOfReferenceUID": f"1.2.{k // 5}"}, "slices of 2 frames of reference"),
        (lambda k: {"RescaleSlope": "0", "RescaleIntercept": "5"}, r"I\d.dcm, whose RescaleSlope is 0"),
    ],
)
def test_tags_that_contradict_a_volume_are_refused(change: Any, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(ImageRefusal, match=phrase):
        read_series(series(tmp_path, change), None)
