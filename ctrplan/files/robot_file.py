"""Robot files (TOML) -> Robot, with the effects of the file at work, and back."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomli_w

from ctrplan.files.drive_file import HomeEntry, build_drive
from ctrplan.files.robot_entries import MeasurementEntry, RobotEntry, build_contacts, build_markers, build_tubes
from ctrplan.files.uncertainty_entries import build_intervals
from ctrplan.robot.nesting import never_nests
from ctrplan.robot.robot import Robot, diametral_gap_m
from ctrplan.sensor.noise import SensorNoise
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.toml_document import Document, read_document

LARGEST_CLEARANCE_RATIO = 0.02  # of the smallest radius of curvature (Ha et al. 2019, section I)
SMALLEST_CLEARANCE_M = 5e-6  # the meshes do not resolve the contact forces of smaller ones (docs/model.md)
ROUNDING_M = 0.05e-3  # of diameters in drawings and tables


def load_robot(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Robot:
    """The robot of a TOML file after `overrides` such as "tube.2.poisson_ratio=0.28".

    Raises InputError, one sentence with file, key, value and rule, for anything malformed or contradictory.
    """
    return _build(read_document(path, overrides))


def robot_from_dict(content: Mapping[str, Any], *, file: str | None = None, overrides: Sequence[str] = ()) -> Robot:
    """The robot of a robot file's content, keys and units as in the file; `file` is what errors call it."""
    return _build(Document.of(content, "robot", file).with_overrides(overrides))


def _build(document: Document) -> Robot:
    entry = document.to(RobotEntry)
    if entry.name is not None and not entry.name.isprintable():
        raise document.fault("must be one line of printable text", "name")
    for effect, terms in entry.effects.items():
        if not isinstance(terms, dict):
            raise document.fault("must be a table", "effects", effect)
    tubes = build_tubes(entry, document)
    robot = Robot(
        name=entry.name or (Path(document.file).stem if document.file else "robot"),
        tubes=tubes,
        contacts=build_contacts(entry, document),
        drive=build_drive(entry.home or HomeEntry(), entry.joint, tubes, document),
        model_error_m=entry.model_error_mm * 1e-3,
        measurement=_measurement(entry.measurement),
        markers=build_markers(entry, document),
        effects=entry.effects,
        provenance=entry.provenance,
        content=document.content,
        path=document.file,
        sha256=document.sha256,
    )
    if violation := never_nests(robot):
        raise document.fault(f"no joint values within limits nest the tubes, at home {violation}", "home", "l_mm")
    intervals = build_intervals(entry.uncertainty, robot, document)
    robot = replace(robot, intervals=intervals, warnings=tuple(_clearance_warnings(robot, document)))
    if not robot.effects:
        return robot
    from ctrplan.pipeline.file_effects import check_effects
    from ctrplan.pipeline.installed import installed  # slow to import; most robots have no effects

    check_effects(robot, document)
    return installed(robot)


def _measurement(entry: MeasurementEntry | None) -> SensorNoise | None:
    if entry is None:
        return None
    degrees = entry.tangent_sigma_deg
    return SensorNoise(entry.position_sigma_mm * 1e-3, None if degrees is None else math.radians(degrees))


def _clearance_warnings(robot: Robot, document: Document) -> Iterator[str]:
    for i, clearance in enumerate(robot.clearance_m.tolist()):
        shown, gap = f"radial clearance {clearance * 1e3:g} mm", diametral_gap_m(robot.tubes, i)
        if abs(clearance - gap) > ROUNDING_M + 1e-9:
            yield str(document.fault(f"{shown} is used, but the diameters leave {gap * 1e3:g} mm", "contact", i))
        if clearance < SMALLEST_CLEARANCE_M:
            rule = f"{shown} is below {SMALLEST_CLEARANCE_M * 1e3:g} mm, bounds may be off by a quarter and more"
            yield str(document.fault(rule, "contact", i))
        curvature = max(section.curvature_per_m for tube in robot.tubes[i : i + 2] for section in tube.sections)
        if clearance * curvature > LARGEST_CLEARANCE_RATIO:
            radius = f"the smallest radius of curvature ({1e3 / curvature:g} mm)"
            rule = f"{shown} is above 2 % of {radius}, the model is less accurate there"
            yield str(document.fault(rule, "contact", i))


def write_robot(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Writes a robot file, whole or not at all, after checking that it can be read again."""
    robot_from_dict(content, file=os.fspath(path))
    write_atomically(path, tomli_w.dumps(content))
