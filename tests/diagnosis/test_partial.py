"""A part of the truth beside errors that nothing explains; none where there is no such part; and other runs asked."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from made_up_input import FUZZ
from measured_data import measured, pair_robot, waypoints, write_csv
from unbuilt import build_nothing

from ctrplan.__main__ import main
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.diagnosis import CATALOGUE, Diagnosis, diagnose
from ctrplan.diagnosis.adequacy import remains
from ctrplan.diagnosis.conclusion import Closing
from ctrplan.diagnosis.confirmation import confirm
from ctrplan.diagnosis.correlated_bench import frames
from ctrplan.diagnosis.held_out import opened
from ctrplan.diagnosis.next_experiment import next_experiment
from ctrplan.diagnosis.partial_diagnosis import diagnose_partially
from ctrplan.diagnosis.usable_poses import usable_poses
from ctrplan.diagnosis.verdict import Alternative, Finding
from ctrplan.diagnosis.workbench import Teller, candidates
from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import term
from ctrplan.reports.diagnosis_figures import selection_errors
from ctrplan.reports.diagnosis_page import diagnosis_report_html, gap_split, share_table
from ctrplan.reports.diagnosis_words import effect_lines, verdict_sentence

ROBOT = pair_robot()
PLAN, OTHERS = waypoints(ROBOT, 18), waypoints(ROBOT, 8, seed=5)
QUICK = {name: CATALOGUE[name] for name in ("backlash", "tip_load", "joint_scale", "base_misalignment")}
KNOWN = {"backlash": {"theta_2_deg": 8.0}}


def beside_a_rest(values: dict[str, dict[str, float]], plan: Measurements = PLAN, seed: int = 3) -> Measurements:
    """Effects, and a smooth error of 0.7 mm and 1 deg that belongs to the configuration."""
    data, rng = measured(ROBOT, plan, values, seed=seed), np.random.default_rng(7)
    joints = np.column_stack([np.diff(plan.theta_commanded, axis=1), plan.l_commanded / 0.02])[plan.rows]
    waves, phases = rng.standard_normal((30, joints.shape[1])), rng.uniform(-np.pi, np.pi, 30)
    field = np.cos(joints @ waves.T + phases) @ rng.standard_normal((30, 6)) / np.sqrt(15)
    tangent = data.tangent + np.radians(1.0) * field[:, 3:]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return replace(data, position_m=data.position_m + 0.4e-3 * field[:, :3], tangent=tangent)


@cache
def partial() -> Diagnosis:
    with pytest.MonkeyPatch.context() as patch:
        build_nothing(patch)
        return diagnose(ROBOT, beside_a_rest(KNOWN), catalogue=QUICK)


def test_an_effect_is_named_beside_a_rest_that_nothing_explains() -> None:
    found = partial()
    assert found.verdict == "partial" and [t.name for t in found.listed] == ["backlash"]
    assert found.partial is not None and found.partial.rest is not None and 0.4e-3 < found.partial.rest.rms_m < 1.2e-3
    assert found.partial.rest.of_configuration > 0.6
    assert found.gap.after.rms_m < found.gap.before.rms_m
    effect = found.to_json()["effects"][0]
    low, high = effect["parameters"]["theta_2_deg"]["ci95"]
    assert low - 0.5 * (high - low) < 8.0 < high + 0.5 * (high - low)
    assert effect["probability"] > 0.99


def test_what_is_handed_over_is_a_robot_with_the_effect_a_frame_and_an_honest_error() -> None:
    content = partial().robot_content()
    assert {"backlash", "base_misalignment"} >= set(content["effects"]) > {"base_misalignment"}
    assert content["model_error_mm"] > 0.5  # what remains is in every margin
    assert robot_from_dict(content).effects["backlash"]["theta_2_deg"] == pytest.approx(8.0, abs=1.5)


def contradicted() -> Measurements:
    """What `partial()` was told of, with the backlash the other way round where poses are kept aside."""
    found, against = partial(), beside_a_rest({"backlash": {"theta_2_deg": -8.0}})
    assert found.partial is not None
    position, tangent, aside = found.data.position_m.copy(), found.data.tangent.copy(), found.partial.split.held_out_set
    position[aside], tangent[aside] = against.position_m[aside], against.tangent[aside]
    return replace(found.data, position_m=position, tangent=tangent)


def test_what_is_done_is_handed_over_without_a_name_unless_poses_kept_aside_contradict_it() -> None:
    found, part = partial(), partial().partial
    assert part is not None
    effects = tuple(finding.term for finding in part.judgement.findings)
    unnamed = replace(part.judgement, verdict="unexplained", findings=(), together=effects)
    answer = replace(part, judgement=unnamed)
    asked = opened(answer, found.data)
    assert asked.judgement.verdict == "unexplained" and asked.judgement.together == effects
    assert asked.gap.after.rms_m == pytest.approx(found.gap.after.rms_m, rel=1e-9)
    told = replace(found, judgement=asked.judgement, partial=None)
    assert "what backlash does is done" in verdict_sentence(told) and "backlash" in told.robot_content()["effects"]
    assert not opened(answer, contradicted()).judgement.together


def test_an_effect_that_is_taken_back_leaves_figures_over_the_noise_alone() -> None:
    part = partial().partial
    assert part is not None
    asked = opened(part, contradicted())
    assert asked.judgement.verdict == "unexplained" and not asked.judgement.findings
    left, beside = asked.judgement.adequacy, remains(part.bench, asked.written)  # the latter with a rest allowed for
    assert left.total.ratio > 1.2 * beside.total.ratio
    assert left.total.ratio > part.judgement.adequacy.total.ratio > 3  # less is explained than with the effect


def test_a_rest_alone_names_nothing() -> None:
    few = {name: QUICK[name] for name in ("backlash", "tip_load")}
    found = diagnose(ROBOT, beside_a_rest({}), catalogue=few)
    assert found.verdict == "unexplained" and not found.listed


def test_what_follows_any_smooth_error_is_not_named_beside_one() -> None:
    """On a pair the place of the tip gives the joints away: a distortion by place is any smooth error of the joints."""
    data = beside_a_rest({}, waypoints(ROBOT, 32, seed=3))
    known = candidates(ROBOT, data, {name: CATALOGUE[name] for name in ("sensor_distortion", "sensor_offset")})
    found = diagnose_partially(ROBOT, data, usable_poses(ROBOT, data), noise_floor(ROBOT, data)[0], known, Teller())
    assert not found.judgement.findings


@pytest.mark.usefixtures("without_building")
def test_runs_of_a_tracker_that_was_set_up_anew_have_frames_of_their_own() -> None:
    data = beside_a_rest(KNOWN)
    later = PLAN.sequence > np.median(PLAN.sequence)
    position = data.position_m + np.outer(later[PLAN.rows], [5e-3, -3e-3, 2e-3])
    few = {name: QUICK[name] for name in ("backlash", "base_misalignment")}  # and what is most like a frame
    found = diagnose(ROBOT, replace(data, position_m=position, frame=1 + later), catalogue=few)
    assert "backlash" in {t.name for t in found.listed}
    assert found.gap.before.rms_m > 2e-3 and found.gap.after.rms_m < 1.2 * partial().gap.after.rms_m
    assert found.framed_gap is not None and found.gap.after.rms_m < found.framed_gap.after.rms_m < 2e-3
    assert "a frame of its own in each of 2 set-ups" in effect_lines(found)[0]
    assert "frames of robot and tracker" in gap_split(found)
    assert found.robot_content()["effects"]["frame_shift"]["shift_x_2_mm"] == pytest.approx(5.0, abs=1.0)


@pytest.mark.usefixtures("without_building")
def test_zeros_of_a_robot_that_was_homed_anew_are_free_and_found_anew_on_other_runs() -> None:
    later = PLAN.sequence > np.median(PLAN.sequence)
    zeros = {"homing_shift": {"theta_2_2_deg": 12.0}}
    data = replace(beside_a_rest({**KNOWN, **zeros}, replace(PLAN, homing=1 + later)), homing=1 + later)
    few = {name: QUICK[name] for name in ("backlash", "base_misalignment")}
    found = diagnose(ROBOT, data, catalogue=few)
    assert {"backlash", "homing_shift"} == {t.name for t in found.listed}
    assert found.gap.before.rms_m > 2e-3 and found.gap.after.rms_m < 1.2 * partial().gap.after.rms_m
    assert "zeros of its own after each of 2 homings" in effect_lines(found)[0]
    assert found.robot_content()["effects"]["homing_shift"]["theta_2_2_deg"] == pytest.approx(12.0, abs=2.0)
    once = replace(OTHERS, homing=np.full(len(OTHERS.sequence), 2))
    turned = {"homing_shift": {"theta_2_2_deg": -12.0}}
    asked = confirm(found, beside_a_rest({**KNOWN, **turned}, once, seed=9))  # of one homing, none of those there
    never_homed = confirm(partial(), beside_a_rest(KNOWN, OTHERS, seed=9))
    assert asked.calibrated.rms_m > 1.5 * never_homed.calibrated.rms_m
    assert asked.after.rms_m < 1.1 * never_homed.after.rms_m


@pytest.mark.parametrize("seed", [0, 1] if FUZZ else [0])
def test_what_changes_slowly_while_poses_are_measured_is_no_drift(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """An error of 3 mm that is smooth in time: a drift was named in both, and in one of them a misaligned base."""
    if seed:
        build_nothing(monkeypatch)
    data, rng = measured(ROBOT, PLAN, {}, seed=seed), np.random.default_rng(seed)
    time = PLAN.rows / np.ptp(PLAN.rows)
    waves, phases = rng.standard_normal(30) / 0.2, rng.uniform(-np.pi, np.pi, 30)
    field = np.cos(time[:, None] * waves + phases) @ rng.standard_normal((30, 6)) / np.sqrt(15)
    tangent = data.tangent + np.radians(4.5) / np.sqrt(2) * np.cross(field[:, 3:], data.tangent)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    off = replace(data, position_m=data.position_m + 3e-3 / np.sqrt(3) * field[:, :3], tangent=tangent)
    known = {**QUICK, **{name: CATALOGUE[name] for name in ("drift", "sensor_offset")}}
    found = diagnose(ROBOT, off, catalogue=known)
    assert found.verdict == "unexplained" and not found.listed and found.built is None


def test_a_frame_and_what_may_stand_for_it_are_told_apart_by_an_experiment() -> None:
    """A frame is in the fit of its alternative as well: a misaligned base beside a kink ended in a traceback."""
    found = partial()
    assert found.partial is not None
    bench, chosen = found.partial.bench, found.partial.chosen
    (frame,) = frames(ROBOT, found.data)
    distortion = CATALOGUE["sensor_distortion"]
    other = term(distortion, [q.name for q in distortion.parameters(ROBOT)][:3], ROBOT)
    beside = Alternative(other, bench.scored([*chosen.terms, other], chosen.fit))
    judgement = replace(found.judgement, findings=(Finding(frame, (beside,)),))
    said, proposed = next_experiment(chosen, judgement, found.data, bench.plain, ())
    assert {one.between for one in proposed} == {("base_misalignment", "sensor_distortion")}
    assert "base_misalignment from sensor_distortion" in said


def test_the_report_splits_the_gap() -> None:
    page = diagnosis_report_html(partial(), selection_errors(partial()))
    assert "remains, unexplained" in page and "Beside all others" in page and "In part:" in page
    assert partial().other_tubes == [] and "not the tube of the file" not in page  # calibration hides what remains
    assert "noise of the measurement" in page and "remain (rms, noise taken out)" in page


@pytest.mark.parametrize(("without_m", "with_m"), [(4.47e-3, 12e-3), (18e-3, 0.6e-3), (4e-3, 2e-3)])
def test_effects_that_hide_one_another_have_errors_and_no_share(without_m: float, with_m: float) -> None:
    closing = Closing(without_m, with_m, gap_m=4.4e-3)
    part = partial().partial
    assert part is not None
    page = share_table([replace(part.parts[0], alone=closing, last=closing)])
    assert page.count(f"{without_m * 1e3:.2f} to {with_m * 1e3:.2f} mm") == 2
    assert ("mm, " in page) == (0 <= closing.share <= 1) == (f"{100 * closing.share:.0f} %" in page)


def test_other_runs_confirm_what_is_there_and_not_what_is_not() -> None:
    there_data = beside_a_rest(KNOWN, OTHERS, seed=9)
    there = confirm(partial(), there_data)
    assert [(e.name, e.verdict) for e in there.effects] == [("backlash", "confirmed")]
    assert there.after.rms_m < there.before.rms_m and "backlash confirmed" in there.sentence
    fewer = confirm(partial(), there_data.subset(np.arange(3))).effects[0]
    assert abs(fewer.log_bayes_factor) < there.effects[0].log_bayes_factor and there.effects[0].probability > 0.99
    moved = replace(there_data, position_m=there_data.position_m + [4e-3, -2e-3, 1e-3])
    elsewhere = confirm(partial(), moved)
    assert elsewhere.calibrated.rms_m > 4e-3 > 3 * elsewhere.after.rms_m  # the tracker was set up anew
    assert elsewhere.after.rms_m == pytest.approx(there.after.rms_m, rel=0.1)
    gone = confirm(partial(), beside_a_rest({}, OTHERS, seed=9))
    assert gone.effects[0].verdict == "contradicted" and gone.effects[0].log_bayes_factor < 0
    with pytest.raises(InputError, match="has not read"):
        confirm(partial(), partial().data.subset(np.arange(5)))


def test_the_command_confirms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    for name, plan in (("a", PLAN), ("b", OTHERS)):
        write_csv(tmp_path / f"{name}.csv", measured(ROBOT, plan, KNOWN))
    call = [str(tmp_path / name) for name in ("robot.toml", "a.csv")]
    quick = [f"--without={name}" for name in CATALOGUE if name not in QUICK]
    given = ["diagnose", *call, "--confirm", str(tmp_path / "b.csv"), "-o", str(tmp_path / "out"), *quick]
    assert main(given) == 0
    assert "backlash confirmed" in capsys.readouterr().out
    (written,) = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["confirmations"]
    assert written["effects"][0]["verdict"] == "confirmed" and written["effects"][0]["probability"] > 0.99
    assert written["after_rms_mm"] < written["before_rms_mm"]
