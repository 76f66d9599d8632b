"""A DICOM series as a volume: its slices put in order by where they lie, all of one orientation, equally spaced.

Tags are read by pydicom, which gives them as they stand. GDCM, with which SimpleITK reads, chooses by the kind of
object which spacing it believes and whether it scales values; here PixelSpacing, the places of the slices and the
scaling of each slice are applied as stated, whatever the object calls itself. GDCM unpacks compressed pixels.

Files of several frames (enhanced CT and MR, segmentations) state these things frame by frame, in functional groups.
"""

from __future__ import annotations

import copy
import importlib
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.anatomy.image import Header, Image, ImageRefusal, Segment
from ctrplan.anatomy.image_file import check_bytes, kept_locale, placed, quiet, reason, simpleitk
from ctrplan.base.arrays import Array
from ctrplan.errors import FEW

UNEVEN_MM = 0.02  # by which gaps between slices may differ
SAME_SPACING = 1e-2  # by which SpacingBetweenSlices may differ from the places before it is said
TURNED = 1e-4  # of direction cosines: the same orientation
CT_IMAGE = "1.2.840.10008.5.1.4.1.1.2"  # what an image is called while its pixels are unpacked
GROUPS = ("PlanePosition", "PlaneOrientation", "PixelMeasures", "PixelValueTransformation", "SegmentIdentification")
SCALING = ("RescaleSlope", "RescaleIntercept", "ModalityLUTSequence", "VOILUTSequence")


@dataclass(frozen=True, eq=False)
class Slice:
    """A file of a series: where its first pixel is, and the directions of its rows and columns, in LPS and mm."""

    file: Path
    tags: Any  # pydicom's
    position: Array
    axes: Array  # (2, 3)
    spacing: tuple[float, float]  # along a row, along a column
    frame: int | None = None  # of a file of several, from 0
    scaling: tuple[float, float] = (1.0, 0.0)  # slope and intercept of that frame
    segment: int = 0  # that it belongs to, in a segmentation

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return int(self.tags.Rows), int(self.tags.Columns)

    @property
    def is_localiser(self) -> bool:
        """Whether the file calls itself a scout."""
        return "LOCALIZER" in map(str, self.tags.get("ImageType", ()))


def pydicom() -> Any:
    """The package. Raises ImageRefusal where it is not installed."""
    try:
        return importlib.import_module("pydicom")
    except ImportError as error:
        raise ImageRefusal("needs pydicom: pip install ctrplan[images]") from error


@kept_locale()
def read_series(folder: Path, series: str | None) -> Image:
    """The series of a folder by its UID, which may be left out where there is one. Raises ImageRefusal."""
    simpleitk()
    result, others = _series(folder)
    if not result:
        below = [part.name for part in sorted(folder.iterdir()) if part.is_dir() and _series(part)[0]]
        hint = f": {', '.join(below[:FEW])} in it does, name that folder" if below else ""
        raise ImageRefusal(f"holds no DICOM images{hint}{_named(', but files that are none', others)}")
    if series is None and len(result) > 1:
        raise ImageRefusal(
            f"holds {len(result)} series: say which by its UID (key series, or --series), {_listed(result)}"
        )
    if series is not None and series not in result:
        raise ImageRefusal(f"has no series of that series UID, but {_listed(result)}")
    files = result[series or next(iter(result))]
    if len(files) == 1 and "SegmentSequence" in files[0][1]:
        return _segmentation(*files[0])
    slices, notes = _single_stack(files)
    order = _in_order(slices)
    kept: dict[Path, tuple[Any, Any]] = {}
    pixels = [_values(part, kept) for part in order]
    kind = np.result_type(*(values.dtype for values in pixels))
    voxels = np.stack([values.astype(kind, copy=False) for values in pixels])
    first, last = order[0].position, order[-1].position
    gap_mm = float(np.linalg.norm(last - first)) / (len(order) - 1)
    axes = np.column_stack([*order[0].axes, (last - first) / np.linalg.norm(last - first)])
    spacing = np.array([*order[0].spacing, gap_mm]) * 1e-3
    header = Header("LPS", notes=(*notes, *_gap_notes(order, gap_mm), *_count_notes(order), *_left_out(others)))
    return placed(voxels, spacing, first * 1e-3, axes, header)


def _series(folder: Path) -> tuple[dict[str, list[tuple[Path, Any]]], list[str]]:
    """The files with pixels of each series, by its UID, in the order of their names; names of files without any.

    Hidden files and the folder's list DICOMDIR are neither.
    """
    package, result, others = pydicom(), dict[str, list[tuple[Path, Any]]](), list[str]()
    for path in sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")):
        try:
            tags = package.dcmread(path, stop_before_pixels=True, force=not _is_dicom(path) and _may_be(path))
        except Exception:  # whatever the damage leads it to: no DICOM file
            tags = {}
        if "Rows" in tags and "Columns" in tags:
            result.setdefault(str(tags.get("SeriesInstanceUID", "")), []).append((path, tags))
        elif path.name.upper() != "DICOMDIR":
            others.append(path.name)
    return result, others


def _named(what: str, names: Sequence[str]) -> str:
    more = f" and {len(names) - FEW} more" if len(names) > FEW else ""
    return f"{what}: {', '.join(names[:FEW])}{more}" if names else ""


def _left_out(others: Sequence[str]) -> tuple[str, ...]:
    """A slice that is damaged at an end of the stack leaves no gap: what was not read is said by name."""
    notice = _named("is read without files that are no DICOM image, or a damaged one", others)
    return (notice,) if notice else ()


def _count_notes(order: Sequence[Slice]) -> Iterator[str]:
    stated = order[0].tags.get("ImagesInAcquisition")
    if stated is not None and str(stated).isdigit() and int(stated) != len(order):
        yield f"says {int(stated)} images (ImagesInAcquisition), and {len(order)} are read: are some missing?"
    numbers = {number for part in order if isinstance(number := part.tags.get("InstanceNumber"), int)}
    if len(numbers) == len(order) and (skipped := max(numbers) - min(numbers) + 1 - len(order)):
        yield f"leaves out {skipped} numbers between those of its images (InstanceNumber): are slices missing?"


def _is_dicom(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(132)[128:] == b"DICM"


def _may_be(path: Path) -> bool:
    """Whether a file without DICOM's mark may be one all the same: it begins with a tag of group 2 or 8."""
    with path.open("rb") as stream:
        return stream.read(2) in (b"\x02\x00", b"\x08\x00")


def _listed(result: dict[str, list[tuple[Path, Any]]]) -> str:
    texts = [
        f"{uid} ({files[0][1].get('Modality', '?')} {str(files[0][1].get('SeriesDescription', ''))!r}, "
        f"{len(files)} images)"
        for uid, files in list(result.items())[:FEW]
    ]
    return "; ".join(texts) + (f" and {len(result) - FEW} more" if len(result) > FEW else "")


def _single_stack(files: Sequence[tuple[Path, Any]]) -> tuple[list[Slice], tuple[str, ...]]:
    """The slices of the stack among the files; a scout is left out, with a note of its name. Raises ImageRefusal."""
    first = files[0][1]
    if int(first.get("SamplesPerPixel", 1)) > 1:
        raise ImageRefusal("holds colour images: must have one value a pixel")
    segmented = [path.name for path, tags in files if "SegmentSequence" in tags]
    if segmented:
        raise ImageRefusal(f"holds segmentations beside other files in one series ({', '.join(segmented[:FEW])})")
    count = sum(_count(tags) for _, tags in files)
    if count < 2:
        raise ImageRefusal("holds one image of that series: a volume needs several slices")
    check_bytes((count, int(first.Rows), int(first.Columns)), 2)
    frames = {str(tags.get("FrameOfReferenceUID", "")) for _, tags in files} - {""}
    if len(frames) > 1:
        raise ImageRefusal(f"holds slices of {len(frames)} frames of reference, whose places do not go together")
    slices = [part for path, tags in files for part in _parts(path, tags)]
    stacks = _stacks(slices)
    main = max(stacks, key=len)
    others = [part for stack in stacks if stack is not main for part in stack]
    if any(len(stack) > 1 and not all(part.is_localiser for part in stack) for stack in stacks if stack is not main):
        shown = ", ".join(f"{len(stack)} from {stack[0].file.name}" for stack in stacks[:FEW])
        raise ImageRefusal(f"holds slices of different orientations or sizes ({shown}): must be one stack")
    left = [*(part.file.name for part in others), *(path.name for path, tags in files if _is_placeless_scout(tags))]
    if len(main) < 2:
        raise ImageRefusal(f"holds no stack of slices: {len(slices)} images, each of its own orientation or size")
    names = ", ".join(left[:FEW]) + (f" and {len(left) - FEW} more" if len(left) > FEW else "")
    rule = f"is read without {names}, which lies across the other {len(main)} slices or differs in size (a scout)"
    return main, (rule,) if left else ()


def _count(tags: Any) -> int:
    return int(tags.get("NumberOfFrames", 1) or 1)


def _parts(path: Path, tags: Any) -> list[Slice]:
    """The slices of a file; none of a scout without a place. Raises ImageRefusal."""
    if _count(tags) > 1 or "PerFrameFunctionalGroupsSequence" in tags:
        return _frames(path, tags)
    part = _slice(path, tags)
    return [] if part is None else [part]


def _frames(path: Path, tags: Any) -> list[Slice]:
    """The frames of a file of several, each where its functional groups or those of all frames say."""
    each, shared = tags.get("PerFrameFunctionalGroupsSequence"), tags.get("SharedFunctionalGroupsSequence")
    if not each or len(each) != _count(tags):
        what = "segments" if "SegmentSequence" in tags else "frames"
        raise ImageRefusal(f"holds {path.name}, {_count(tags)} {what} that do not say where each lies (a film?)")
    result = []
    for k, own in enumerate(each):
        attributes = pydicom().Dataset()
        for groups in ([shared[0]] if shared else [], [own]):  # what a frame says of its own comes last
            for name in GROUPS:
                if group := groups[0].get(f"{name}Sequence") if groups else None:
                    attributes.update(group[0])
        attributes.ImageType, attributes.Rows, attributes.Columns = ["DERIVED"], tags.Rows, tags.Columns
        part = _slice(path, attributes)
        assert part is not None
        scaling = float(attributes.get("RescaleSlope", 1.0)), float(attributes.get("RescaleIntercept", 0.0))
        segment = int(attributes.get("ReferencedSegmentNumber", 0) or 0)
        result.append(replace(part, tags=tags, frame=k, scaling=scaling, segment=segment))
    return result


def _segmentation(path: Path, tags: Any) -> Image:
    """A segmentation object: a layer for all segments, or one each where they overlap. Raises ImageRefusal.

    Frames without a voxel of a segment may be left out, so that places may be several slices apart.
    """
    parts = _frames(path, tags)
    stacks = _stacks(parts)
    if len(stacks) > 1 or any(not part.segment for part in parts):
        raise ImageRefusal(f"holds {path.name}, whose segments are not of one orientation, size and place each")
    first, normal = parts[0], np.cross(*parts[0].axes)
    height = np.array([float(part.position @ normal) for part in parts])
    levels = np.unique(height.round(3))
    groups = tags.get("SharedFunctionalGroupsSequence") or [tags]
    measures = groups[0].get("PixelMeasuresSequence") or [tags]
    stated = abs(float(measures[0].get("SpacingBetweenSlices", 0.0) or 0.0))
    gap = min(np.diff(levels), default=stated or float(measures[0].get("SliceThickness", 0.0) or 0.0))
    steps = np.diff(levels) / stated if stated else np.zeros(0)
    if len(steps) and (np.abs(steps - np.rint(steps)) <= SAME_SPACING * steps).all():
        gap = stated  # all frames next to those that are there may be left out
    index = np.rint((height - levels[0]) / gap).astype(int) if gap > 0 else np.zeros(len(parts), int)
    gap = float(np.ptp(height) / index.max()) if index.max() else gap
    if gap <= 0 or np.abs(height - height.min() - index * gap).max() > UNEVEN_MM:
        raise ImageRefusal(f"holds {path.name}, whose slices are not evenly apart")
    values = np.asarray(_stored(pydicom().dcmread(path), path)).reshape(len(parts), *first.shape)
    most = float(tags.get("MaximumFractionalValue", 1) or 1)
    inside = values > most / 2 if str(tags.get("SegmentationType", "")) == "FRACTIONAL" else values > 0
    numbers = [int(segment.SegmentNumber) for segment in tags.SegmentSequence]
    check_bytes((index.max() + 1, *first.shape), len(numbers))
    layers = np.zeros((index.max() + 1, *first.shape, len(numbers)), np.uint8)
    for part, k, mask in zip(parts, index.tolist(), inside, strict=True):
        layers[k, :, :, numbers.index(part.segment)] |= mask
    names = [str(segment.get("SegmentLabel", segment.SegmentNumber)) for segment in tags.SegmentSequence]
    if (layers.sum(axis=-1) > 1).any():
        voxels, segments = layers, tuple(Segment(name, 1, k) for k, name in enumerate(names))
    else:
        voxels = (layers * np.array(numbers, np.uint8)).sum(axis=-1, dtype=np.uint8)
        segments = tuple(Segment(name, number) for name, number in zip(names, numbers, strict=True))
    origin = first.position + (height.min() - height[0]) * normal
    spacing = np.array([*first.spacing, gap]) * 1e-3
    return placed(voxels, spacing, origin * 1e-3, np.column_stack([*first.axes, normal]), Header("LPS"), segments)


def _stacks(slices: Sequence[Slice]) -> list[list[Slice]]:
    """Slices of one orientation, size and spacing each."""
    result: list[list[Slice]] = []
    for part in slices:
        for stack in result:
            same = stack[0].shape == part.shape and np.allclose(stack[0].spacing, part.spacing, rtol=1e-3)
            if same and np.abs(stack[0].axes - part.axes).max() <= TURNED:
                stack.append(part)
                break
        else:
            result.append([part])
    return result


def _is_placeless_scout(tags: Any) -> bool:
    return "ImagePositionPatient" not in tags and "LOCALIZER" in map(str, tags.get("ImageType", ()))


def _slice(path: Path, tags: Any) -> Slice | None:
    """The slice of a file; None of a scout without a place. Raises ImageRefusal."""
    if _is_placeless_scout(tags):
        return None
    try:
        position = np.array([float(x) for x in tags.ImagePositionPatient])
        axes = np.array([float(x) for x in tags.ImageOrientationPatient]).reshape(2, 3)
        down, along = (float(x) for x in tags.PixelSpacing)  # between rows, between columns
        spaced = down > 0 and along > 0
    except (AttributeError, TypeError, ValueError):
        spaced = False
    if not spaced or position.shape != (3,) or not np.isfinite([*position, *axes.ravel(), down, along]).all():
        at_detector = " (ImagerPixelSpacing is that at the detector)" if "ImagerPixelSpacing" in tags else ""
        rule = f"which does not say its place, orientation or pixel spacing{at_detector}"
        raise ImageRefusal(f"holds {path.name}, {rule}")
    if np.abs(axes @ axes.T - np.eye(2)).max() > 1e-3:
        raise ImageRefusal(f"holds {path.name}, whose rows and columns are not at right angles")
    return Slice(path, tags, position, axes, (along, down))


def _in_order(slices: Sequence[Slice]) -> list[Slice]:
    """The slices along their normal. Raises ImageRefusal unless they are even."""
    normal = np.cross(*slices[0].axes)
    height = np.array([float(part.position @ normal) for part in slices])
    order = np.argsort(height, kind="stable")
    _check_gaps(height[order], np.array([slices[k].position for k in order]), normal)
    return [slices[k] for k in order]


def _check_gaps(height: Array, position: Array, normal: Array) -> None:
    gaps = np.diff(height)
    usual = float(np.median(gaps))
    ends = np.append(np.flatnonzero(gaps >= UNEVEN_MM), len(gaps))
    most = int(np.diff(ends, prepend=-1).max())  # slices at one place
    if most > 1:
        places = f"{len(ends)} places, up to {most} at one" if len(ends) > 1 else "one place"
        what = f"holds {len(height)} slices at {places}"
        raise ImageRefusal(f"{what}: a time series or doubled images, must be one volume")
    uneven = np.flatnonzero(np.abs(gaps - usual) > max(UNEVEN_MM, 1e-3 * usual))
    if len(uneven):
        k = int(uneven[0])
        rule = f"slices are {usual:.3g} mm apart, but {gaps[k]:.3g} mm after the one at {height[k]:.4g} mm"
        raise ImageRefusal(f"has a gap: {rule} (slices missing?)")
    aside = position - np.outer(height, normal)
    if float(np.ptp(aside, axis=0).max()) > 10 * UNEVEN_MM:
        raise ImageRefusal("has slices that lie aslant (tilted gantry): resample it to a straight grid")


def _gap_notes(order: Sequence[Slice], gap_mm: float) -> Iterator[str]:
    stated_mm = order[0].tags.get("SpacingBetweenSlices")
    if stated_mm is not None and not math.isclose(abs(float(stated_mm)), gap_mm, rel_tol=SAME_SPACING):
        yield f"says slices are {float(stated_mm):.3g} mm apart, their places {gap_mm:.3g} mm: the places are taken"


def _values(part: Slice, kept: dict[Path, tuple[Any, Any]]) -> NDArray[Any]:
    """(rows, columns) of a slice in the unit that it says, whole numbers where they are; keeps the last file read.

    Raises ImageRefusal.
    """
    package = pydicom()
    try:
        if part.file not in kept:
            kept.clear()
            whole = package.dcmread(part.file, force=True)
            kept[part.file] = whole, _stored(whole, part.file)
        whole, stored = kept[part.file]
        if part.frame is None:
            if float(whole.get("RescaleSlope", 1) or 0) == 0:
                raise ImageRefusal(f"holds {part.file.name}, whose RescaleSlope is 0: all its values would be the same")
            result = package.pixels.apply_modality_lut(stored, whole)
        else:
            result = np.asarray(stored).reshape(-1, *part.shape)[part.frame] * part.scaling[0] + part.scaling[1]
    except ImageRefusal:
        raise
    except Exception as error:  # whatever the damage leads it to
        raise ImageRefusal(f"holds {part.file.name}, which can't be read: {reason(error)}") from error
    if result.shape != part.shape:
        raise ImageRefusal(f"holds {part.file.name}, whose pixels are no {part.shape[0]} rows of {part.shape[1]}")
    return result if result.dtype.kind != "f" else _whole(result)


def _whole(values: NDArray[Any]) -> NDArray[Any]:
    nearest = np.rint(values)
    exact = (values == nearest).all() and np.abs(nearest).max(initial=0.0) < 2**31
    return np.asarray(nearest.astype(np.int32)) if exact else values


def _stored(whole: Any, file: Path) -> NDArray[Any]:
    """The pixels as they are stored, before any scaling."""
    syntax = whole.file_meta.get("TransferSyntaxUID") if hasattr(whole, "file_meta") else None
    if syntax is None or not syntax.is_compressed or syntax.is_deflated or _count(whole) > 1:
        if syntax is None:
            whole.file_meta.TransferSyntaxUID = pydicom().uid.ImplicitVRLittleEndian
        return _without_other_bits(np.asarray(whole.pixel_array), whole)
    sitk = simpleitk()
    bare = copy.deepcopy(whole)
    bare.SOPClassUID = bare.file_meta.MediaStorageSOPClassUID = CT_IMAGE
    for name in SCALING:
        if name in bare:
            delattr(bare, name)
    with tempfile.TemporaryDirectory() as folder:
        unscaled = Path(folder) / "slice.dcm"
        bare.save_as(unscaled)
        reader = sitk.ImageFileReader()
        reader.SetFileName(str(unscaled))
        try:
            with quiet():
                return np.asarray(sitk.GetArrayFromImage(reader.Execute())).reshape(whole.Rows, whole.Columns)
        except RuntimeError as error:
            name = f"{file.name} (transfer syntax {syntax})"
            raise ImageRefusal(f"holds {name}, which can't be read: {reason(error)}") from error


def _without_other_bits(pixels: NDArray[Any], tags: Any) -> NDArray[Any]:
    """Pixels without what stands in bits that are not theirs, such as overlays."""
    kept, unused = int(tags.BitsStored), int(tags.BitsAllocated) - int(tags.BitsStored)
    if not unused or pixels.dtype.kind not in "iu":
        return pixels
    shifted = pixels >> (int(tags.HighBit) - kept + 1)
    return np.asarray((shifted << unused) >> unused).astype(pixels.dtype, copy=False)
