"""A written plan is read back by strict rules: every fault is one sentence."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from written_plan_files import write_small_plan

from ctrplan.audit.audited_plan import DrivenWay
from ctrplan.errors import InputError
from ctrplan.files.plan_file import WrittenPlan, load_plan


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario, plan.json and trajectory.csv; nobody changes them."""
    folder = tmp_path_factory.mktemp("plan")
    write_small_plan(folder)
    return folder


@pytest.fixture
def copied(folder: Path, tmp_path: Path) -> Path:
    """A copy of the folder that a test may spoil."""
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def read(folder: Path) -> WrittenPlan:
    return load_plan(folder / "plan.json", folder / "scenario.toml", allow_outside=True)


def test_reading_returns_what_was_written(folder: Path) -> None:
    plan = read(folder)
    assert plan.certificate["valid"] is True and plan.content["seed"] == 0
    np.testing.assert_array_equal(plan.waypoints[0], plan.scenario.start)
    assert np.array_equal(plan.waypoints[-1], plan.scenario.goal.joints)
    assert len(plan.time_s) == len(plan.position) == plan.content["trajectory"]["samples"]
    assert np.all(np.diff(plan.places) >= 0) and plan.places[0] == 0 and plan.places[-1] == len(plan.waypoints) - 1
    assert len(plan.column("bound_m")) == len(plan.certified_places)


def test_the_scenario_is_that_which_the_plan_names(folder: Path) -> None:
    assert load_plan(folder / "plan.json", allow_outside=True).scenario.path == str(folder / "scenario.toml")


def test_the_way_goes_through_every_sample_and_every_corner(folder: Path) -> None:
    plan = read(folder)
    way = DrivenWay.of(plan)
    for row, place in zip(plan.position[::7], plan.places[::7], strict=True):
        at = float(way.places_of(np.array([place]))[0])
        np.testing.assert_allclose(way.joints_at(at), row, atol=1e-12)
    for number, corner in enumerate(plan.waypoints):
        at = float(way.places_of(np.array([float(number)]))[0])
        np.testing.assert_allclose(way.joints_at(at), corner, atol=1e-12)
        assert way.leg_at(at) == pytest.approx(number)
    commanded = np.hstack(plan.scenario.robot.drive.commanded(plan.waypoints))
    np.testing.assert_allclose(way.until(1.0), commanded, atol=1e-12)
    assert way.time_at(1.0) == plan.time_s[-1]


CLOSEST = {
    **{"clearance_m": 0.0, "distance_m": 0.0, "part": "anatomy.1", "tube": 7, "point_m": [0.0, 0.0, 0.0]},
    **{"leg": 0, "path_mm": 0.0, "joints": [0.0], "phi": [0.0]},
}
Change = Callable[[dict[str, Any]], object]
SPOILED: dict[str, tuple[Change, str]] = {
    "an older version": (lambda c: c.update(schema_version=1), r"schema_version = 1: must be \d+, the version"),
    "no version": (lambda c: c.pop("schema_version"), "is no plan: it has no schema_version"),
    "another scenario": (
        lambda c: c["scenario"].update(sha256="ab" * 32),
        "scenario.sha256.*is that of another scenario",
    ),
    "another robot": (lambda c: c["robot"].update(sha256="ab" * 32), "robot.sha256.*is that of another robot"),
    "no legs": (lambda c: c.pop("legs"), "legs: is missing"),
    "legs of text": (lambda c: c.update(legs="all"), "legs = 'all': must be a list"),
    "other joints": (lambda c: c["joints"].reverse(), "joints: must be the robot's joints"),
    "a joint left out": (
        lambda c: c["legs"][0]["end"].pop("rotate inner"),
        "must have 'rotate inner' in deg and in rad",
    ),
    "two units that differ": (
        lambda c: c["legs"][0]["end"]["rotate inner"].update(deg=11.0),
        "legs.1.end.rotate inner: contradicts itself, 11 deg is not",
    ),
    "two units that differ after many turns": (
        lambda c: c["legs"][0]["end"]["rotate inner"].update(rad=100.0, deg=float(np.degrees(100.0 + 5e-8))),
        "legs.1.end.rotate inner: contradicts itself",
    ),
    "a gap between legs": (
        lambda c: c["legs"].insert(0, {"start": c["legs"][0]["start"], "end": c["legs"][-1]["end"]}),
        "legs.2.start: must be where the leg before ends",
    ),
    "another start": (
        lambda c: c["legs"][0]["start"]["rotate inner"].update(deg=1.0, rad=float(np.radians(1.0))),
        "legs.1.start: must be where the scenario starts",
    ),
    "samples out of order": (
        lambda c: c["certificate"]["samples"]["joints"].reverse(),
        "certificate.samples.joints, sample 2: is out of order",
    ),
    "samples elsewhere": (
        lambda c: c["certificate"]["samples"]["joints"][1].__setitem__(0, 0.5),
        "certificate.samples.joints, sample 2: leaves the legs by 0.5 rad or m",
    ),
    "a short column": (
        lambda c: c["certificate"]["samples"]["bound_m"].pop(),
        r"certificate.samples.bound_m.*: must hold \d+ values",
    ),
    "a column of text": (
        lambda c: c["certificate"]["samples"]["bound_m"].__setitem__(0, "x"),
        "certificate.samples.bound_m.1 = 'x': must be a number",
    ),
    "clearances of text": (
        lambda c: c["certificate"]["samples"]["clearance_m"].__setitem__(0, "x"),
        "certificate.samples.clearance_m.1 = 'x': must be a number",
    ),
    "a closest place of another robot": (
        lambda c: c["certificate"].update(closest=CLOSEST),
        "certificate.closest.joints.*: must be 4 values",
    ),
    "a closest tube that there is not": (
        lambda c: c["certificate"].update(closest=CLOSEST | {"joints": [0.0] * 4, "phi": [0.0] * 2}),
        "certificate.closest.tube = 7: must be at most 3",
    ),
    "a missing figure": (lambda c: c["certificate"].pop("min_stability"), "certificate.min_stability: is missing"),
}


@pytest.mark.parametrize("what", SPOILED)
def test_a_spoiled_plan_is_refused_in_a_sentence(what: str, copied: Path) -> None:
    change, sentence = SPOILED[what]
    content = json.loads((copied / "plan.json").read_text())
    change(content)
    (copied / "plan.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=sentence) as caught:
        read(copied)
    assert "\n" not in str(caught.value) and str(copied / "plan.json") in str(caught.value)


@pytest.mark.parametrize(
    "text, sentence",
    [
        ("", "is empty"),
        ("nothing", r"is no JSON \(line 1"),
        ("{", "is no JSON"),
        ("[]", "is no plan"),
        ('{"schema_version": NaN}', "holds NaN, all numbers must be finite"),
        ('{"schema_version": Infinity}', "holds Infinity"),
        ("[" * 100_000, "is no JSON that could be read"),
    ],
)
def test_what_is_no_plan_is_refused(text: str, sentence: str, copied: Path) -> None:
    (copied / "plan.json").write_text(text)
    with pytest.raises(InputError, match=sentence):
        read(copied)


def rows(folder: Path) -> list[list[str]]:
    return [line.split(",") for line in (folder / "trajectory.csv").read_text().splitlines()]


def swapped(table: list[list[str]], a: int, b: int) -> None:
    """Two rows, but not their times."""
    table[a][1:], table[b][1:] = table[b][1:], table[a][1:]


Spoil = Callable[[list[list[str]]], object]
BAD_ROWS: dict[str, tuple[Spoil, str]] = {
    "off the legs": (lambda r: r[20].__setitem__(1, "0.3"), "trajectory, sample 20: leaves the legs by"),
    "out of order": (lambda r: swapped(r, 40, 41), "is out of order"),
    "time runs back": (
        lambda r: r[20].__setitem__(0, "0.01"),
        "row 20, time_s = 0.01: must be later than the row before",
    ),
    "no number": (lambda r: r[20].__setitem__(1, "nan"), "row 20, rotate_outer_position_rad = 'nan': must be a"),
    "no column": (lambda r: r[0].__setitem__(1, "angle"), "rotate_outer_position_rad: is missing"),
    "ends early": (lambda r: r.__delitem__(slice(-30, None)), "must be at the end of the legs"),
    "begins late": (lambda r: r.__delitem__(slice(1, 30)), "must be at the start of the legs"),
}


@pytest.mark.parametrize("what", BAD_ROWS)
def test_a_spoiled_trajectory_is_refused_in_a_sentence(what: str, copied: Path) -> None:
    spoil, sentence = BAD_ROWS[what]
    table = rows(copied)
    spoil(table)
    (copied / "trajectory.csv").write_text("\n".join(map(",".join, table)) + "\n")
    with pytest.raises(InputError, match=sentence) as caught:
        read(copied)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", ["plan.json", "trajectory.csv", "scenario.toml"])
def test_missing_files_are_named(missing: str, copied: Path) -> None:
    (copied / missing).unlink()
    with pytest.raises(InputError, match=f"{re.escape(str(copied / missing))}: does not exist"):
        read(copied)


def test_a_scenario_that_is_elsewhere_is_asked_for(copied: Path) -> None:
    content = json.loads((copied / "plan.json").read_text())
    content["scenario"]["path"] = "nowhere.toml"
    (copied / "plan.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="scenario.path = 'nowhere.toml': is not here"):
        load_plan(copied / "plan.json")


def test_rounded_trajectories_of_others_are_read(copied: Path) -> None:
    """Six digits, times and positions alone, columns in another order."""
    table = np.array(rows(copied))
    keep = [k for k, name in enumerate(table[0]) if "velocity" not in name and "acceleration" not in name][::-1]
    rounded = [list(table[0, keep]), *([f"{float(x):.6f}" for x in row] for row in table[1:, keep])]
    (copied / "trajectory.csv").write_text("\n".join(map(",".join, rounded)) + "\n")
    assert len(read(copied).time_s) == len(table) - 1
