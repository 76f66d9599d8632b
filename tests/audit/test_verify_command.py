"""`ctrplan verify` as a person meets it: what it prints, exit codes, and scenes that replay."""

from __future__ import annotations

import csv
import json
import os
import re
import shlex
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from claimed_plans import claiming
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.commands.terminal import ProgressBar
from ctrplan.files.scenario_file import load_scenario
from ctrplan.files.trajectory_file import trajectory_formats, write_trajectory
from ctrplan.plans.plan import write_plan_json

JOINTS = ("rotate outer", "rotate middle", "rotate inner", "translate inner")
GOAL = [0, 8, 12, -77]
CONTENT: dict[str, Any] = {
    "robot": str(SCENARIOS / "robots" / "three_tube.toml"),
    "start": dict(zip(JOINTS, [0, 0, 0, -80], strict=True)),
    "goal": {"joints": dict(zip(JOINTS, GOAL, strict=True))},
    "anatomy": [
        {"kind": "sphere", "center_mm": [68, 5, 147], "radius_mm": 15},
        {"kind": "mesh", "file": str(SCENARIOS / "meshes" / "conchae.stl"), "unit": "mm"},
    ],
    "base": {"position_mm": [1, 2, 120], "quaternion_wxyz": [0.8, 0.0, 0.6, 0.0]},
}


@pytest.fixture(autouse=True)
def little_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second or so of the hunt."""
    monkeypatch.setattr("ctrplan.audit.verify.WORK", 3_000)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a plan; the sphere stands beside the robot."""
    folder = tmp_path_factory.mktemp("plan")
    content = {**CONTENT, "anatomy": CONTENT["anatomy"][1:]}
    (folder / "scenario.toml").write_text(tomli_w.dumps(content))
    scenario = load_scenario(folder / "scenario.toml", allow_outside=True)
    plan = claiming(scenario, GOAL)
    write_plan_json(folder / "plan.json", plan)
    write_trajectory(folder, plan.trajectory, trajectory_formats(["csv"]))
    return folder


def last_pose(folder: Path) -> dict[str, float]:
    """What `ctrplan simulate` says of the last waypoint."""
    with (folder / "poses.csv").open() as stream:
        *_, last = csv.DictReader(stream)
    return {name: float(value) for name, value in last.items() if name != "status"}


def arguments(folder: Path, *more: str) -> list[str]:
    return ["verify", str(folder / "plan.json"), "--allow-outside", "-o", str(folder / "broken"), *more]


def test_a_plan_that_holds(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments(written)) == 0
    shown = capsys.readouterr().out
    assert "no claim was found broken" in shown and "BROKEN" not in shown
    lines = re.findall(r"  (\w[\w ]+?)  +([\d.]+)[ %m]* found, ([\d.]+)[ %m]* claimed(.*?); leg ", shown)
    assert len(lines) >= 5
    for claim, at_worst, stated, within in lines:  # what is found worse than claimed says by how much it may be
        worse = float(at_worst) - float(stated)
        worse *= -1 if claim in ("clearance", "least stability") else 1
        most = re.fullmatch(r" \(meshes may differ by ([\d.]+)\)", within)
        assert worse <= (float(most[1]) if most else 0.0), claim
        assert most is None or worse >= 0, claim
    assert not (written / "broken").exists()


def spoiled(written: Path, folder: Path, change: dict[str, Any]) -> Path:
    content = json.loads((written / "plan.json").read_text())
    content["certificate"].update(change)
    (folder / "plan.json").write_text(json.dumps(content))
    (folder / "trajectory.csv").write_bytes((written / "trajectory.csv").read_bytes())
    return folder


@pytest.mark.parametrize("claim", ["clearance", "bound"])
def test_a_broken_claim_is_shown_as_a_scene_that_replays(
    claim: str, written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = json.loads((written / "plan.json").read_text())["certificate"]
    change = {"min_clearance_m": 0.2} if claim == "clearance" else {"samples": {**content["samples"]}}
    if claim == "bound":
        change["samples"] |= {"bound_m": [0.0 for _ in content["samples"]["bound_m"]]}
    assert main(arguments(spoiled(written, tmp_path, change))) == 1
    shown = capsys.readouterr().out
    assert "the certificate does not hold" in shown and "BROKEN" in shown
    found = json.loads((tmp_path / "broken" / "counterexample.json").read_text())
    assert found["claim"] == claim
    view, simulate = (shlex.split(command)[1:] for command in found["commands"])
    assert all(" ".join(["ctrplan", *command]) in shown for command in (view, simulate))
    shown_scene = load_scenario(view[1])
    np.testing.assert_allclose(shown_scene.start, found["joints"], atol=1e-9)
    assert len(shown_scene.anatomy) == 1
    assert main(simulate) == 0
    poses = last_pose(Path(simulate[simulate.index("-o") + 1]))
    if claim == "bound":  # its point is the tip
        tip = np.array([poses[name] for name in ("x_m", "y_m", "z_m")])
        located = shown_scene.base_R @ tip + shown_scene.base_position_m
        np.testing.assert_allclose(located * 1e3, found["point_mm"], atol=0.05)
        assert poses["deviation_mm"] == pytest.approx(found["found"] * 1e3, abs=0.05)


@pytest.mark.parametrize(
    "command, sentence",
    [
        (["nowhere.json"], "nowhere.json: does not exist"),
        (["plan.json", "--time", "0"], "--time"),
        (["plan.json", "--set", "margins.stability=0.2"], "is that of another scenario"),
        (["plan.json", "--set", "robot.tube.1.poisson_ratio=0.2"], "is that of another robot"),
        (["plan.json", "--trajectory", "plan.json"], "plan.json"),
    ],
)
def test_bad_input_is_one_sentence(
    command: list[str],
    sentence: str,
    written: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(written)
    assert main(["verify", *command, "--allow-outside"]) == 2
    shown = capsys.readouterr().err
    assert sentence in shown and shown.count("\n") == 1


def test_ctrl_c_prints_what_was_found_so_far(
    written: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pressed as soon as something is told of a hunt that would go on for ten minutes."""
    show, pressed = ProgressBar.show, list[float]()

    def pressing(bar: ProgressBar, stage: str, fraction: float, note: str = "") -> None:
        show(bar, stage, fraction, note)
        if stage == "hunting" and not pressed:
            pressed.append(fraction)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ProgressBar, "show", pressing)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(arguments(written, "--time", "600")) == 130
    finally:
        signal.signal(signal.SIGINT, previous)
    assert pressed and pressed[0] < 0.5
    assert capsys.readouterr().out.startswith("scenario: no claim was found broken, interrupted")
