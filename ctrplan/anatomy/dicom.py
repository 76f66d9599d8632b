"""A DICOM series as a volume: its slices put in order by where they lie, all of one orientation, equally spaced."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.anatomy.image import Image, ImageRefusal
from ctrplan.anatomy.image_file import check_bytes, checked, kept_locale, quiet, reason, simpleitk
from ctrplan.anatomy.image_header import Header
from ctrplan.base.arrays import Array

POSITION, ORIENTATION, SPACING = "0020|0032", "0020|0037", "0028|0030"
DESCRIPTION, MODALITY, SAMPLES, SYNTAX = "0008|103e", "0008|0060", "0028|0002", "0002|0010"
UNEVEN_MM = 0.02  # by which gaps between slices may differ
SHOWN = 6


@dataclass(frozen=True, eq=False)
class Slice:
    """A file of a series: where its first pixel is, and the directions of its rows and columns, in LPS and mm."""

    file: str
    position: Array
    axes: Array  # (2, 3)


@kept_locale()
def read_series(folder: Path, series: str | None) -> Image:
    """The series of a folder by its UID, which may be left out where there is one. Raises ImageRefusal."""
    sitk = simpleitk()
    result = sitk.ImageSeriesReader.GetGDCMSeriesIDs(str(folder))
    if not result:
        raise ImageRefusal("holds no DICOM images")
    if series is None and len(result) > 1:
        raise ImageRefusal(
            f"holds {len(result)} series: say which by its UID (key series, or --series), "
            f"{_listed(sitk, folder, result)}"
        )
    if series is not None and series not in result:
        raise ImageRefusal(f"has no series of that series UID, but {_listed(sitk, folder, result)}")
    files = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), series or result[0])
    order = _in_order(sitk, files)
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames([one.file for one in order])
    try:
        with quiet():
            image = reader.Execute()
    except RuntimeError as error:
        syntax = _tags(sitk, order[0].file).get(SYNTAX, "unknown")
        raise ImageRefusal(f"can't be read (transfer syntax {syntax}): {reason(error)}") from error
    return _placed(checked(sitk, image, Header("LPS")), order)


def _listed(sitk: Any, folder: Path, results: tuple[str, ...]) -> str:
    texts = []
    for uid in results[:SHOWN]:
        files = sitk.ImageSeriesReader.GetGDCMSeriesFileNames(str(folder), uid)
        tags = _tags(sitk, files[0])
        texts.append(
            f"{uid} ({tags.get(MODALITY, '?').strip()} {tags.get(DESCRIPTION, '').strip()!r}, {len(files)} images)"
        )
    return "; ".join(texts) + (f" and {len(results) - SHOWN} more" if len(results) > SHOWN else "")


def _tags(sitk: Any, file: str) -> dict[str, str]:
    reader = sitk.ImageFileReader()
    reader.SetFileName(file)
    try:
        reader.ReadImageInformation()
    except RuntimeError as error:
        raise ImageRefusal(f"holds {Path(file).name}, which can't be read: {reason(error)}") from error
    return {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}


def _in_order(sitk: Any, files: tuple[str, ...]) -> list[Slice]:
    """The slices along their normal. Raises ImageRefusal unless they are one even stack."""
    first = _tags(sitk, files[0])
    if int(first.get(SAMPLES, "1")) > 1:
        raise ImageRefusal("holds colour images: must have one value a pixel")
    if len(files) < 2:
        raise ImageRefusal("holds one image of that series: a volume needs several slices")
    check_bytes((len(files), *_pixels(sitk, files[0])), 2)
    slices = [_slice(sitk, file) for file in files]
    axes = slices[0].axes
    if any(np.abs(one.axes - axes).max() > 1e-4 for one in slices):
        raise ImageRefusal("holds slices of different orientations: must be one stack (a scout among them?)")
    normal = np.cross(axes[0], axes[1])
    height = np.array([float(one.position @ normal) for one in slices])
    order = np.argsort(height, kind="stable")
    _check_gaps(height[order], np.array([slices[k].position for k in order]), normal)
    return [slices[k] for k in order]


def _pixels(sitk: Any, file: str) -> tuple[int, ...]:
    reader = sitk.ImageFileReader()
    reader.SetFileName(file)
    reader.ReadImageInformation()
    return tuple(reader.GetSize()[:2])


def _slice(sitk: Any, file: str) -> Slice:
    tags = _tags(sitk, file)
    try:
        position = np.array([float(x) for x in tags[POSITION].split("\\")])
        axes = np.array([float(x) for x in tags[ORIENTATION].split("\\")]).reshape(2, 3)
        spaced = all(float(x) > 0 for x in tags[SPACING].split("\\"))
    except (KeyError, ValueError):
        spaced = False
    if not spaced or position.shape != (3,) or not np.isfinite([*position, *axes.ravel()]).all():
        raise ImageRefusal(f"holds {Path(file).name}, which does not say its place, orientation or pixel spacing")
    return Slice(file, position, axes)


def _check_gaps(height: Array, position: Array, normal: Array) -> None:
    gaps = np.diff(height)
    usual = float(np.median(gaps))
    same = int((gaps < UNEVEN_MM).sum())
    if same:
        raise ImageRefusal(
            f"holds {same + 1} slices and more at one place: a time series or doubled images, must be one volume"
        )
    uneven = np.flatnonzero(np.abs(gaps - usual) > max(UNEVEN_MM, 1e-3 * usual))
    if len(uneven):
        k = int(uneven[0])
        rule = f"slices are {usual:.3g} mm apart, but {gaps[k]:.3g} mm after the one at {height[k]:.4g} mm"
        raise ImageRefusal(f"has a gap: {rule} (slices missing?)")
    aside = position - np.outer(height, normal)
    if float(np.ptp(aside, axis=0).max()) > 10 * UNEVEN_MM:
        raise ImageRefusal("has slices that lie aslant (tilted gantry): resample it to a straight grid")


def _placed(image: Image, order: list[Slice]) -> Image:
    """The image where its slices say, whatever its reader made of them."""
    first, last = order[0].position, order[-1].position
    gap_m = float(np.linalg.norm(last - first)) / (len(order) - 1) * 1e-3
    axes = np.column_stack([*order[0].axes, (last - first) / np.linalg.norm(last - first)])
    if not math.isclose(gap_m, image.spacing_m[2], abs_tol=UNEVEN_MM * 1e-3):
        image = replace(image, spacing_m=np.array([*image.spacing_m[:2], gap_m]))
    return replace(image, origin_m=first * 1e-3, direction=axes)
