"""What a case is asked for: each option once, as a keyword of `ctrplan.case`, an option of the command, and JSON.

An option is a key of the TypedDict of the step that it belongs to, which is made anew when the option changes. A key
that is missing was never said. Nothing slow is imported, for `ctrplan case --help`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence, Set
from typing import Annotated, Any, TypedDict, cast

from ctrplan.base.arguments import (
    LONGEST_MM,
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
    given = {name: _plain(content[name]) for name in Request.__annotations__ if content.get(name) is not None}
    return cast(Request, given)


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
