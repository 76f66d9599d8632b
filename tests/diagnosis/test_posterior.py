"""Posterior probabilities over sets of effects, built terms, and experiments that decide, on a pair of tubes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from measured_data import SIGMA_M, measured, pair_robot, waypoints, write_csv

from ctrplan.cli import main
from ctrplan.diagnosis import CATALOGUE, Diagnosis, diagnose
from ctrplan.diagnosis.confirmation import confirm
from ctrplan.diagnosis.gap import conformal_radius_m
from ctrplan.diagnosis.next_experiment import write_proposals
from ctrplan.diagnosis.workflow import Misread
from ctrplan.errors import InputError
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 18)
BASE = {"calibration": {"precurvature_factor_1_1": 1.05, "stiffness_factor_2": 0.93, "poisson_ratio_1": 0.36}}
FEW = {name: CATALOGUE[name] for name in ("backlash", "tip_load", "homing_offset", "joint_scale")}
PLAY = BASE | {"backlash": {"theta_2_deg": 8.0}}


@pytest.fixture(scope="module")
def play() -> Diagnosis:
    return diagnose(ROBOT, measured(ROBOT, PLAN, PLAY), catalogue=FEW)


def test_probabilities_of_sets_sum_to_one_and_those_of_effects_are_their_shares(play: Diagnosis) -> None:
    answer = play.answer
    assert answer.posterior.sum() == pytest.approx(1.0) and np.all(np.diff(answer.posterior) <= 1e-12)
    for name, share in answer.of_effects.items():
        assert share == pytest.approx(answer.of_any([name])) and 0 <= share <= 1 + 1e-9
    assert answer.of_any(list(FEW)) + answer.of_none == pytest.approx(1.0)
    content = play.to_json()["posterior"]
    assert content["effects"]["backlash"] > 0.99 and content["none"] < 0.01
    assert content["sets"][0]["effects"] == ["backlash"] and content["asked"] == len(answer.hypotheses)


def test_the_order_of_the_catalogue_is_of_no_matter(play: Diagnosis) -> None:
    other = diagnose(ROBOT, measured(ROBOT, PLAN, PLAY), catalogue=dict(reversed(FEW.items())))
    assert other.verdict == play.verdict
    for name, share in play.answer.of_effects.items():
        assert other.answer.of_effects.get(name, 0.0) == pytest.approx(share, abs=0.02)


def test_the_frame_that_everything_is_told_in_is_of_no_matter(play: Diagnosis) -> None:
    """All tubes and the tracker turned about the robot's axis: the same robot."""
    angle = 0.8
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    data = measured(ROBOT, PLAN, PLAY)
    moved = replace(
        data,
        theta_commanded=data.theta_commanded + angle,
        position_m=data.position_m @ turn.T,
        tangent=data.tangent @ turn.T,
    )
    other = diagnose(ROBOT, moved, catalogue=FEW)
    assert other.verdict == play.verdict and [t.name for t in other.listed] == ["backlash"]
    best, there = play.answer.best, other.answer.best
    assert there.evidence - other.answer.base.evidence == pytest.approx(
        best.evidence - play.answer.base.evidence, rel=0.05
    )


def rippled() -> Measurements:
    """Measured while gears turned tube 2 further, three times a turn: made without any built term."""
    theta = PLAN.theta_commanded.copy()
    theta[:, 1] += np.radians(7.0) * np.sin(3 * theta[:, 1] + 0.5)
    return replace(measured(ROBOT, replace(PLAN, theta_commanded=theta), BASE), theta_commanded=PLAN.theta_commanded)


def test_a_ripple_of_gears_is_built_in_the_drive_and_nothing_is_named() -> None:
    found = diagnose(ROBOT, rippled(), catalogue=FEW)
    assert found.verdict == "unexplained" and not found.listed and found.built is not None
    assert found.built.stage == "drive" and [t.name for t in found.built_terms] == ["learned_theta_2"]
    rest = [np.sqrt(max(e.rms_m**2 - found.gap.floor_m**2, 0.0)) for e in (found.gap.before, found.gap.after)]
    assert rest[1] < 0.4 * rest[0]
    (term,) = found.to_json()["built"]["terms"]
    wave = [term["parameters"][f"{name}_3_theta_2_deg"]["value"] for name in ("sin", "cos")]
    np.testing.assert_allclose(wave, 7.0 * np.array([np.cos(0.5), np.sin(0.5)]), atol=1.0)
    written = robot_from_dict(found.robot_content())
    assert written.effects["learned_theta_2"]["sin_3_theta_2_deg"] == pytest.approx(wave[0])


def test_other_runs_confirm_an_effect_that_is_there_and_not_one_that_is_gone(play: Diagnosis) -> None:
    plan = waypoints(ROBOT, 14, seed=9)
    again, repaired = measured(ROBOT, plan, PLAY, seed=5), measured(ROBOT, plan, BASE, seed=6)
    (there,), (gone,) = (confirm(play, replace(d, sha256="new")).effects for d in (again, repaired))
    assert there.verdict == "confirmed" and there.log_odds > 20
    assert gone.verdict == "contradicted" and gone.log_odds < -20
    with pytest.raises(InputError, match="not read"):
        confirm(replace(play, data=replace(play.data, sha256="x")), replace(again, sha256="x"))


def test_proposed_poses_that_are_measured_decide(tmp_path: Path) -> None:
    """An offset of homing or a tube bent out of its plane: one pair of poses can tell where both are asked."""
    truth = BASE | {"joint_scale": {"theta_2": 0.02}}
    few = {name: CATALOGUE[name] for name in ("joint_scale", "homing_offset", "eccentricity")}
    narrow = replace(PLAN, theta_commanded=0.35 * PLAN.theta_commanded)
    data = measured(ROBOT, narrow, truth)
    first = diagnose(ROBOT, data, catalogue=few)
    wide = measured(ROBOT, waypoints(ROBOT, 3, seed=3), truth, seed=8)
    second = diagnose(ROBOT, data, catalogue=few, deciding=[wide])
    assert second.data.count == data.count + wide.count
    assert second.answer.of_effects.get("joint_scale", 0.0) >= first.answer.of_effects.get("joint_scale", 0.0) - 0.02
    assert set(second.answer.bench.data.rows[-1:].tolist()) <= set(second.data.rows[-wide.count :].tolist())
    if first.proposals:
        write_proposals(tmp_path / "commanded.csv", first.proposals, ROBOT.n)
        lines = (tmp_path / "commanded.csv").read_text().splitlines()
        assert lines[0].startswith("sequence,theta_1_rad") and len(lines) == 1 + 2 * 3 * len(first.proposals)


def test_the_command_tells_a_misread_file_first_and_fits_it_only_if_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = measured(ROBOT, PLAN, BASE)
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    write_csv(tmp_path / "data.csv", replace(data, position_m=data.position_m[:, [1, 0, 2]]))
    files, out = [str(tmp_path / name) for name in ("robot.toml", "data.csv")], tmp_path / "out"
    for command in ("diagnose", "calibrate"):
        assert main([command, *files, "-o", str(out)]) == 2
        assert "x, y, z" in capsys.readouterr().err
        assert not (out / "robot.toml").exists()
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["verdict"] == "misread" and content["reading"]["faults"][0]["columns"] == ["x_m", "y_m", "z_m"]
    assert main(["calibrate", *files, "-o", str(out), "--as-read"]) == 0
    robot = robot_from_dict(dict(ROBOT.content))
    with pytest.raises(Misread, match="--as-read"):
        diagnose(robot, load_measurements(files[1], robot))


def test_the_radius_contains_what_it_says_of_errors_of_any_law() -> None:
    rng = np.random.default_rng(4)
    inside = [rng.gamma(1.5) <= conformal_radius_m(rng.gamma(1.5, size=59)) for _ in range(4000)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.012)
    assert conformal_radius_m(np.array([1.0, 3.0, 2.0])) == 3.0


def test_noise_alone_is_no_unnamed_error() -> None:
    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE), catalogue=FEW)
    assert found.verdict == "no_missing_effect" and not found.judgement.unnamed.is_large
    assert found.judgement.none > 0.9 and found.gap.radius_m < 6 * SIGMA_M
