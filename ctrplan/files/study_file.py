"""Study files (TOML): read strictly; `studies/study/definition.py` makes a study of what stands in them."""

from __future__ import annotations

import os
from collections.abc import Sequence

from ctrplan.files.study_entries import StudyEntry, TargetsEntry
from ctrplan.storage.toml_document import Document, read_document


def read_study(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> tuple[StudyEntry, Document]:
    """The entries of a study file after `overrides`, and its content.

    Raises InputError, one sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    document = read_document(path, overrides)
    return checked_study(document), document


def checked_study(document: Document) -> StudyEntry:
    """The content of a study file as entries. Raises InputError."""
    entry = document.to(StudyEntry)
    if (entry.robot is None) == (entry.scenario is None):
        rule = "is missing, or robot in its place" if entry.robot is None else "and robot exclude each other"
        raise document.fault(rule, "scenario")
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    if entry.robot is not None and entry.bases is not None:
        raise document.fault("needs a scenario: a robot alone stands nowhere", "bases")
    for k in range(len(entry.vary)):
        _check_vary(entry, document, k)
    if entry.targets is not None:
        check_targets(entry.targets, document)
    if entry.bases is not None and (entry.bases.poses is None) == (entry.bases.patch is None):
        raise document.fault("must have one of poses and patch", "bases")
    return entry


def _check_vary(entry: StudyEntry, document: Document, k: int) -> None:
    """Raises InputError unless one [[vary]] says one thing."""
    vary = entry.vary[k]
    if any(other.key == vary.key for other in entry.vary[:k]):
        raise document.fault("is varied twice", "vary", k, "key")
    is_range = vary.count is not None
    ways = (vary.values is not None) + (vary.files is not None) + (vary.distribution is not None) + is_range
    if ways != 1:
        raise document.fault("must have one of values, files, distribution, and low, high, count", "vary", k)
    needed = {
        "range": ("low", "high"),
        "uniform": ("low", "high"),
        "triangular": ("low", "high", "mode"),
        "normal": ("mean", "sigma"),
        "lognormal": ("mean", "sigma"),
    }.get("range" if is_range else vary.distribution or "", ())
    for name in ("low", "high", "mean", "sigma", "mode"):
        if (getattr(vary, name) is None) == (name in needed):
            what = vary.distribution or ("a range" if is_range else "a list")
            raise document.fault("is missing" if name in needed else f"does not go with {what}", "vary", k, name)
    if vary.low is not None and vary.high is not None and not vary.low < vary.high:
        raise document.fault(f"must be below high = {vary.high:g}", "vary", k, "low")
    if vary.mode is not None and not (vary.low or 0.0) <= vary.mode <= (vary.high or 0.0):
        raise document.fault("must lie from low to high", "vary", k, "mode")


def check_targets(targets: TargetsEntry, document: Document) -> None:
    """Raises InputError unless [targets] says one set of points."""
    listed = (targets.points_mm is not None) + (targets.file is not None)
    shaped = (targets.within is not None) + (targets.on is not None)
    if listed + shaped != 1 and not (listed + shaped == 0 and targets.box_mm is not None):
        raise document.fault("must have one of points_mm, file, within, on and box_mm", "targets")
    spaced = (targets.step_mm is not None) + (targets.count is not None)
    if listed and (spaced or targets.box_mm is not None or targets.depth_mm):
        key = next(key for key in ("step_mm", "count", "box_mm", "depth_mm") if key in document.content["targets"])
        raise document.fault("does not go with points that are listed", "targets", key)
    if not listed and spaced != 1:
        raise document.fault("must have one of step_mm and count", "targets")
    if targets.direction is not None and not any(targets.direction):
        raise document.fault("must not be zero", "targets", "direction")
    if targets.direction_tolerance_deg is not None and targets.direction is None:
        raise document.fault("goes with direction", "targets", "direction_tolerance_deg")
