"""Targets and entries of a case in its frame: from numbers, from files of markups, from labels within them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ctrplan.anatomy.patient_frame import FRAMES, Frame, signs
from ctrplan.base.arrays import LONGEST_MM, Array
from ctrplan.errors import InputError
from ctrplan.files.slicer_markups import PlacedMarkup, is_markups, read_markups
from ctrplan.patients.request import Place

WORDS = {
    "--target": re.compile(r"target|goal|nodule|tumou?r|lesion", re.IGNORECASE),
    "--entry": re.compile(r"entry|entrance|burr|port|insertion", re.IGNORECASE),
}


@dataclass(frozen=True, eq=False)
class Named:
    """Points (K, 3) [mm] in the case's frame; one, or those of a line from its first to its last."""

    points_mm: Array
    name: str
    notes: tuple[str, ...] = ()  # of the file that it is from

    @property
    def is_line(self) -> bool:
        """Whether there are several."""
        return len(self.points_mm) > 1


def case_frame(frame: str | None, places: Sequence[Place]) -> Frame:
    """The frame that a case's numbers are in: as said, or RAS where no number was said. Raises InputError."""
    if frame is None and any(not isinstance(place, str) for place in places):
        rule = "is needed: say whether the numbers of --target and --entry are in RAS (as 3D Slicer shows) or in LPS"
        raise InputError(rule, key="--frame")
    for known in FRAMES:
        if (frame or "RAS") == known:
            return known
    raise InputError("must be RAS or LPS", key="--frame", value=frame)


def places_of(
    option: str, places: Sequence[Place] | None, markups: Sequence[PlacedMarkup], frame: Frame, file_frame: str | None
) -> list[Named]:
    """What an option, --target or --entry, says; or else what the files' markups call so. Raises InputError."""
    if places is None:
        results = [point for markup in markups for point in says(markup, WORDS[option])]
        if not results:
            raise InputError(f"is needed: X Y Z in mm, or a file of markups{_there(markups)}", key=option)
    else:
        results = []
    named = [_in_frame(point, frame, file_frame) for point in results]
    for place in places or ():
        if isinstance(place, str):
            named += [_in_frame(point, frame, file_frame) for point in _by_name(option, place, markups)]
        else:
            named.append(_number(option, place))
    return [part for group in named for part in _apart(*group)]


def _number(option: str, place: Sequence[float]) -> tuple[Array, PlacedMarkup]:
    point = np.asarray(place, dtype=np.float64)
    if point.shape != (3,) or not np.all(np.abs(point) <= LONGEST_MM):  # nor is it so of NaN
        raise InputError(f"must be three numbers from {-LONGEST_MM:g} to {LONGEST_MM:g} mm", key=option, value=place)
    return point[None], PlacedMarkup("", point[None], ("",), None, False)


def says(markup: PlacedMarkup, word: re.Pattern[str]) -> list[PlacedMarkup]:
    """A markup that its file's name calls so, or those of its points whose labels do."""
    rows = [k for k, label in enumerate(markup.labels) if word.search(label)]
    others = [other for other in WORDS.values() if other is not word]
    if word.search(markup.name) and not any(other.search(label) for other in others for label in markup.labels):
        return [markup]
    return [] if markup.is_line else [_rows(markup, rows)] if rows else []


def is_point(name: str, markups: Sequence[PlacedMarkup]) -> bool:
    """Whether a name is that of a file of markups, of one that was read, or the label of a point."""
    if is_markups(name) or is_markups(name.partition(":")[0]):
        return True
    return any(name == markup.name or name in markup.labels for markup in markups)


def _by_name(option: str, name: str, markups: Sequence[PlacedMarkup]) -> list[PlacedMarkup]:
    file, _, label = name.partition(":") if not is_markups(name) else (name, "", "")
    if is_markups(file):
        known = [markup for markup in markups if file in (markup.file, Path(markup.file).name)]
        results = known or read_markups(file)
        return [_point(option, markup, label) for markup in results] if label else results
    same = [markup for markup in markups if markup.name == name]
    if same:
        return same
    results = [_rows(markup, [k]) for markup in markups for k, text in enumerate(markup.labels) if text == name]
    if len(results) != 1:
        there = (
            "is the label of several points"
            if results
            else "is no file of markups, no label of a point and no structure"
        )
        raise InputError(f"{there}{_there(markups)}", key=option, value=name)
    return results


def _point(option: str, markup: PlacedMarkup, label: str) -> PlacedMarkup:
    rows = [k for k, text in enumerate(markup.labels) if text == label]
    if not rows:
        rule = f"has no point of that label, but {', '.join(map(repr, markup.labels))}"
        raise InputError(rule, file=markup.file, key=option, value=label)
    return _rows(markup, rows)


def _rows(markup: PlacedMarkup, rows: Sequence[int]) -> PlacedMarkup:
    labels = tuple(markup.labels[k] for k in rows)
    return replace(markup, points_mm=markup.points_mm[list(rows)], labels=labels, is_line=False)


def _in_frame(markup: PlacedMarkup, frame: Frame, file_frame: str | None) -> tuple[Array, PlacedMarkup]:
    stated = markup.frame or file_frame
    for known in FRAMES:
        if stated == known:
            return markup.points_mm * signs(known, frame), markup
    rule = "does not say whether its coordinates are in RAS or in LPS: --file-frame says it"
    raise InputError(rule, file=markup.file)


def _apart(points_mm: Array, markup: PlacedMarkup) -> list[Named]:
    """A line as one, points one by one."""
    if markup.is_line and len(points_mm) > 1:
        return [Named(points_mm + 0.0, markup.name, markup.notes)]
    names = [label or (markup.name if markup.file else "") for label in markup.labels]
    return [Named(point[None] + 0.0, name, markup.notes) for point, name in zip(points_mm, names, strict=True)]


def _there(markups: Sequence[PlacedMarkup]) -> str:
    if not markups:
        return ""
    texts = [
        f"{Path(markup.file).name} ({', '.join(label or '-' for label in markup.labels[:8])})" for markup in markups
    ]
    return f"; the files hold points: {'; '.join(texts)}"
