"""Targets and entries of a case in its frame: from numbers, from files of markups, from labels within them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypedDict, cast

import numpy as np

from ctrplan.anatomy.patient_frame import FRAMES, Frame, signs
from ctrplan.base.arguments import (
    SEARCH_TIME,
    SEED,
    Choice,
    FilePath,
    Number,
    Option,
    Text,
    Texts,
    Whole,
    options_of,
)
from ctrplan.base.arrays import LONGEST_MM, Array
from ctrplan.errors import InputError
from ctrplan.files.slicer_markups import PlacedMarkup, is_markups, read_markups

STEP_NAMES = ("scenario", "bases", "placed", "plan", "slicer")
Place = tuple[float, float, float] | str  # mm in the case's frame; or a file of markups, a label in one, a structure

# What holds where nothing is said.
MARGIN_MM, TOLERANCE_MM = 0.5, 1.0
RADIUS_MM, CONE_DEG, CANDIDATES = 4.0, 20.0, 128
TRIES = 3  # base poses that are planned from

FRAME = Choice("RAS", "LPS")
LENGTH, ABOVE_ZERO = Number(0, LONGEST_MM, "mm"), Number(0, LONGEST_MM, "mm", above=True)
NAME = "[FILE:]NAME"
HOW = "segment, label, mesh, or range"


class ScenarioOptions(TypedDict, total=False):
    """What scenario.toml depends on, besides the files."""

    frame: Annotated[str, Option(FRAME, "of the numbers in this command and of the case's files")]
    file_frame: Annotated[str, Option(FRAME, "of files that do not say theirs")]
    series: Annotated[str, Option(Text(), "of a DICOM folder that has several", "UID")]
    unit: Annotated[str, Option(Choice("mm", "cm", "m", "in"), "of meshes (default: mm, of glTF m)")]
    repair: Annotated[
        str,
        Option(
            Choice("holes", "caps", "off"),
            "of openings of meshes: holes up to 2 mm from a vertex, also flat cuts of any size, none (default: holes)",
        ),
    ]
    lumens: Annotated[
        Sequence[str], Option(Texts(), f"a structure that the robot stays inside of: {HOW}", NAME, "--lumen")
    ]
    avoids: Annotated[Sequence[str], Option(Texts(), f"a structure that it keeps clear of: {HOW}", NAME, "--avoid")]
    ignored: Annotated[
        Sequence[str],
        Option(Texts(), f"a structure to leave out although its name is that of one of these: {HOW}", NAME, "--ignore"),
    ]
    robot: Annotated[
        str | os.PathLike[str], Option(FilePath(), "default: three tubes on a drive that advances all of them", "FILE")
    ]
    margin_mm: Annotated[
        float,
        Option(
            LENGTH, f"kept from every structure, besides what its surface may be off by (default: {MARGIN_MM:g})", "D"
        ),
    ]
    motion_margin_mm: Annotated[
        float, Option(LENGTH, "kept for places between phases (default: half the way from one to the next)", "D")
    ]
    surface_error_mm: Annotated[
        float, Option(LENGTH, "what surfaces of volumes may be off by (default: from their voxels)", "E")
    ]
    tolerance_mm: Annotated[float, Option(ABOVE_ZERO, f"of the tip at a target (default: {TOLERANCE_MM:g})", "T")]
    sheath_mm: Annotated[
        float, Option(ABOVE_ZERO, "inner radius of a straight sheath from the entry into the lumen", "R")
    ]


class BasesOptions(TypedDict, total=False):
    """What bases.csv depends on, besides the scenario and the seed."""

    radius_mm: Annotated[
        float, Option(LENGTH, f"of the places around an entry where the robot may stand (default: {RADIUS_MM:g})", "R")
    ]
    cone_deg: Annotated[
        float,
        Option(
            Number(0, 90, "deg"),
            f"by which it may look past the target, or the entry's line (default: {CONE_DEG:g})",
            "A",
        ),
    ]
    candidates: Annotated[int, Option(Whole(1, 100_000), f"base poses that are looked at (default: {CANDIDATES})", "N")]


class PlanOptions(TypedDict, total=False):
    """What the plan depends on, besides the placed scenario."""

    bases: Annotated[int, Option(Whole(1, 1000), f"of them to plan from, until one has a plan (default: {TRIES})", "N")]
    seed: Annotated[int, Option(SEED, "of every search (default: 0)", "N")]
    time_s: Annotated[float, Option(SEARCH_TIME, "seconds of the plan's search by the clock", "S", "--time")]


class Options(ScenarioOptions, BasesOptions, PlanOptions, total=False):
    """All options."""


class Inputs(TypedDict, total=False):
    """The files of a case, and the places in them."""

    inputs: tuple[str, ...]  # files and folders
    targets: tuple[Place, ...]
    entries: tuple[Place, ...]
    phases: tuple[tuple[str, ...], ...]  # files of one structure each


class Request(Inputs, Options, total=False):
    """What was said, in this run or before. Lengths in mm, angles in deg, as in the files that a case writes."""


def request_of(content: Mapping[str, Any]) -> Request:
    """What is said, in a call or in JSON: None and keys that are none count for nothing."""
    said = {name: _plain(content[name]) for name in Request.__annotations__ if content.get(name) is not None}
    return cast(Request, said)


def over(request: Request, earlier: Request) -> Request:
    """What is said, and what the earlier run said of the rest; named inputs begin a new case."""
    return request if "inputs" in request else {**earlier, **request}


def part(request: Request, *kinds: type) -> dict[str, Any]:
    """What is said of the keys of some TypedDicts, None where nothing is."""
    return {name: request.get(name) for keys in kinds for name in keys.__annotations__}


OPTIONS = options_of(Options)


def _plain(value: Any) -> Any:
    """The value as JSON gives it back, with tuples for lists."""
    if isinstance(value, (Sequence, Set)) and not isinstance(value, str):
        return tuple(map(_plain, value))
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return value.item() if hasattr(value, "item") else value  # of numpy's numbers


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
        results = [one for markup in markups for one in says(markup, WORDS[option])]
        if not results:
            raise InputError(f"is needed: X Y Z in mm, or a file of markups{_there(markups)}", key=option)
    else:
        results = []
    named = [_in_frame(one, frame, file_frame) for one in results]
    for place in places or ():
        if isinstance(place, str):
            named += [_in_frame(one, frame, file_frame) for one in _by_name(option, place, markups)]
        else:
            named.append(_number(option, place))
    return [part for one in named for part in _apart(*one)]


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
    said = markup.frame or file_frame
    for known in FRAMES:
        if said == known:
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
    texts = [f"{Path(one.file).name} ({', '.join(label or '-' for label in one.labels[:8])})" for one in markups]
    return f"; the files hold points: {'; '.join(texts)}"
