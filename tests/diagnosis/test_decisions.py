"""Poses that are measured to decide: what is proposed, what it decides, and what is said where it decides nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints, write_csv

from ctrplan import diagnosis
from ctrplan.__main__ import main
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, Diagnosis, diagnose, workflow
from ctrplan.diagnosis.next_experiment import Decision, Proposal, decision, proposed_waypoints
from ctrplan.diagnosis.usable_poses import bench_of, checked_split
from ctrplan.diagnosis.verdict import Alternative, Finding
from ctrplan.diagnosis.workbench import Scored
from ctrplan.diagnosis.workflow import decide
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import term
from ctrplan.reports.diagnosis_words import verdict_sentence
from ctrplan.robot.robot import Robot

ROBOT = pair_robot()
NOISE = Noise(SIGMA_M, SIGMA_RAD)
BASE = {"calibration": {"precurvature_factor_1_1": 1.05, "stiffness_factor_2": 0.93}}
VALUES = {
    "tip_load": {"force_x_N": 0.15, "force_y_N": -0.12},
    "joint_scale": {"theta_2": 0.05},
    "base_misalignment": {"rotation_x_deg": 4.0, "shift_y_mm": 3.0},
    "eccentricity": {"sin_2_deg": 9.0, "cos_2_deg": 5.0},
}


def truth(effect: str, count: int, seed: int) -> Measurements:
    return measured(ROBOT, waypoints(ROBOT, count, seed), BASE | {effect: VALUES[effect]}, seed)


def explained(data: Measurements, first: str, second: str) -> tuple[Scored, Finding]:
    """Both effects fitted to the data, whatever is true of them."""
    bench = bench_of(ROBOT, data, checked_split(data, np.ones(data.count, bool)), NOISE)
    terms = [
        term(effect, [p.name for p in effect.parameters(ROBOT)], ROBOT)
        for effect in (CATALOGUE[first], CATALOGUE[second])
    ]
    chosen, other = (bench.scored([t]) for t in terms)
    return chosen, Finding(terms[0], (Alternative(terms[1], other),))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pair", [("tip_load", "joint_scale"), ("joint_scale", "base_misalignment")])
def test_what_is_true_is_decided_for_whichever_was_chosen(pair: tuple[str, str], seed: int) -> None:
    for true in pair:
        chosen, finding = explained(truth(true, 16, seed), *pair)
        taken = decision(chosen, finding, truth(true, 3, seed + 10), NOISE)
        assert taken.is_decided and taken.explanations[0] == true and sum(taken.probability) == pytest.approx(1)
        assert taken.sentence.startswith("Decided by") and f": {true}, with" in taken.sentence


def test_where_neither_explains_the_new_poses_that_is_said() -> None:
    chosen, finding = explained(truth("tip_load", 16, 1), "tip_load", "joint_scale")
    taken = decision(chosen, finding, truth("eccentricity", 3, 5), NOISE)
    assert not taken.explains and not taken.is_decided and "9 new poses fit neither" in taken.sentence


def test_what_predicts_the_same_everywhere_stays_undecided() -> None:
    data = measured(ROBOT, waypoints(ROBOT, 18), BASE | {"homing_offset": {"theta_2_deg": 6.0}})
    few = {name: CATALOGUE[name] for name in ("homing_offset", "off_plane_precurvature")}
    before = diagnose(ROBOT, data, catalogue=few)
    assert before.verdict == "ambiguous"
    (finding,) = before.judgement.findings  # look-alikes are reported together
    alike = {finding.term.name, *(other.term.name for other in finding.alternatives)}
    assert alike == {"homing_offset", "off_plane_precurvature"}
    assert "separates" in before.next_experiment or "To tell" in before.next_experiment
    new = measured(ROBOT, waypoints(ROBOT, 2, 7), BASE | {"homing_offset": {"theta_2_deg": 6.0}}, 3)
    after = decide(before, new, catalogue=few)
    (taken,) = after.decisions
    assert not taken.is_decided and after.verdict == "ambiguous" and "do not decide" in taken.sentence
    for again in (data, data.subset(np.arange(4))):  # which the probabilities are of already
        with pytest.raises(InputError, match="has not read: those poses count already"):
            decide(before, again, catalogue=few)
    unsure = replace(before, judgement=replace(before.judgement, verdict="unexplained", findings=()))
    assert unsure.posterior is not None and unsure.posterior.of_unknown < 1 / 2
    assert "not certain what acts" in verdict_sentence(unsure) and "This verdict has" not in verdict_sentence(unsure)
    assert "something acts which the catalogue lacks has probability" in verdict_sentence(unsure)
    nothing = replace(before, judgement=replace(before.judgement, verdict="no_missing_effect", findings=()))
    with pytest.raises(InputError, match="has nothing to decide"):
        decide(nothing, new, catalogue=few)


def test_sentences_and_waypoints() -> None:
    sure = Decision(("a", "b"), (0.9999, 0.0001), 8, True)
    assert sure.sentence == "Decided by 8 new poses: a, with a probability of above 0.999, and not b."
    assert replace(sure, probability=(0.8, 0.2)).sentence == (
        "8 new poses do not decide: a has a probability of 0.80 beside b."
    )
    proposal = Proposal(np.array([0.1, 0.2]), np.array([0.0, -0.02]), 9.0, ("a", "b"))
    sequence, theta, places = proposed_waypoints([proposal, proposal])
    assert len(theta) == 6 and np.array_equal(sequence, [0, 0, 1, 1, 2, 2])  # both sides, and none
    np.testing.assert_allclose(theta[1::2], [[0.1, 0.2]] * 3)
    np.testing.assert_allclose(theta[::2, 1] - 0.2, [-np.pi / 2, np.pi / 2, 0.0])
    np.testing.assert_allclose(places, [[0.0, -0.02]] * 6)


@pytest.fixture
def diagnosed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands and decisions that ask for a diagnosis of the same file with the same catalogue get the same one."""
    known = dict[tuple[str, frozenset[str]], Diagnosis]()

    def kept(robot: Robot, data: Measurements, *more: Any, without: Sequence[str] = (), **keys: Any) -> Diagnosis:
        asked = data.sha256, frozenset(without)
        if asked not in known:
            known[asked] = diagnose(robot, data, *more, without=without, **keys)
        return known[asked]

    for place in (diagnosis, workflow):
        monkeypatch.setattr(place, "diagnose", kept)


@pytest.mark.usefixtures("diagnosed_once")
def test_the_command_proposes_and_decides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = tmp_path / "pair.toml"
    robot.write_text(tomli_w.dumps(ROBOT.content), encoding="utf-8")
    loose = BASE | {"backlash": {"theta_2_deg": 1.3}}
    old, new = tmp_path / "old.csv", tmp_path / "new.csv"
    write_csv(old, measured(ROBOT, waypoints(ROBOT, 18), loose, 0))
    out, proposed = tmp_path / "out", tmp_path / "proposed.csv"
    few = ("joint_scale", "friction", "backlash", "tip_load")
    quick = [f"--without={name}" for name in CATALOGUE if name not in few]
    command = ["diagnose", str(robot), str(old), "-o", str(out), "--quiet", "--propose", str(proposed), *quick]
    assert main(command) == 0
    assert f"written to {proposed}" in capsys.readouterr().out
    assert json.loads((out / "diagnosis.json").read_text("utf-8"))["verdict"] == "ambiguous"
    header, *rows = proposed.read_text("utf-8").splitlines()
    assert header == "sequence,theta_1_rad,theta_2_rad,l_1_m,l_2_m"
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    driven, nothing = np.arange(1, len(table), 2), np.zeros((len(table) // 2, 3))
    times = np.arange(len(table), dtype=float)
    asked = Measurements(table[:, 0].astype(int), table[:, 1:3], table[:, 3:], driven, nothing, nothing, times)
    write_csv(new, measured(ROBOT, asked, loose, 4))
    assert main([*command, "--decide", str(new)]) == 0
    said, content = capsys.readouterr().out, json.loads((out / "diagnosis.json").read_text("utf-8"))
    assert "Decided by" in said and "backlash, with a probability of" in said and "nothing to propose" in said
    assert content["verdict"] == "named" and content["decisions"][0]["decided"]
    assert any("as new poses decided against it: friction" in note for note in content["notes"])
    assert main([*command, "--decide", str(new), "--without", "friction"]) == 2
    assert "has nothing to decide" in capsys.readouterr().err
