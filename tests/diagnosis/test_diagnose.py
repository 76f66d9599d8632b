"""The diagnose end to end on small data: nothing missing, one effect, look-alikes, something outside the catalogue."""

from __future__ import annotations

import json
import re
import threading
from dataclasses import replace
from functools import cache
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from counted_calls import count_calls
from made_up_input import FUZZ, thorough
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints, without_solutions, write_csv
from packed_page import library
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE, Diagnosis, diagnose, partial_diagnosis, verdict
from ctrplan.diagnosis.remainder import localise
from ctrplan.diagnosis.workbench import Workbench
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.measurement.measurements import Measurements, groups, split
from ctrplan.pipeline.term import term
from ctrplan.reports.diagnosis_figures import selection_errors
from ctrplan.reports.diagnosis_page import diagnosis_report_html

ROBOT = pair_robot()
SILENT = pair_robot(measurement=None)
PLAN = waypoints(ROBOT, 18)
BASE = {"calibration": {"precurvature_factor_1_1": 1.05, "stiffness_factor_2": 0.93, "poisson_ratio_1": 0.36}}
QUICK = {name: CATALOGUE[name] for name in ("backlash", "tip_load", "homing_offset", "off_plane_precurvature", "lag")}


FEW = {name: CATALOGUE[name] for name in ("backlash", "tip_load")}


def names(found: Diagnosis) -> list[set[str]]:
    return [{f.term.name, *(a.term.name for a in f.alternatives)} for f in found.judgement.findings]


@cache
def of_nominal_parameters() -> Diagnosis:
    """The diagnosis of a robot whose parameters alone are wrong, made once; nobody changes it."""
    return diagnose(ROBOT, measured(ROBOT, PLAN, BASE), catalogue=QUICK)


def test_wrong_nominal_parameters_are_no_missing_effect() -> None:
    found = of_nominal_parameters()
    assert found.verdict == "no_missing_effect" and not found.listed
    assert found.gap.after.rms_m < 1.3 * found.gap.floor_m < found.gap.nominal.rms_m
    assert "lag" in found.not_testable and "measured at rest" in found.not_testable["lag"]


def test_a_tip_load_is_named_with_its_size() -> None:
    values = BASE | {"tip_load": {"force_x_N": 0.15, "force_y_N": -0.12, "force_z_N": 0.0}}
    found = diagnose(ROBOT, measured(ROBOT, PLAN, values), catalogue=QUICK)
    assert found.verdict == "named" and names(found) == [{"tip_load"}]
    parameters = found.to_json()["effects"][0]["parameters"]
    for axis, force in zip("xyz", (0.15, -0.12, 0.0), strict=True):
        low, high = parameters[f"force_{axis}_N"]["ci95"]
        assert low - 0.5 * (high - low) < force < high + 0.5 * (high - low)
    assert found.gap.after.rms_m < 1.3 * found.gap.floor_m < 0.7 * found.gap.before.rms_m


def test_an_effect_larger_than_expected_gets_the_size_that_the_data_say() -> None:
    values = {"g_x_m_s2": 200.0, "g_y_m_s2": -300.0, "g_z_m_s2": 0.0}  # the prior has 40
    data = measured(ROBOT, PLAN, BASE | {"gravity": values})
    found = diagnose(ROBOT, data, catalogue={"gravity": CATALOGUE["gravity"]})
    assert found.verdict == "named" and any("times what is plausible" in note for note in found.notes)
    for name, e in found.to_json()["effects"][0]["parameters"].items():
        half = (e["ci95"][1] - e["ci95"][0]) / 2
        assert abs(e["value"] - values[name]) < 1.5 * half
    y = found.to_json()["effects"][0]["parameters"]["g_y_m_s2"]
    assert y["value"] == pytest.approx(-300, rel=0.2) and y["ci95"][1] < -150


def test_two_effects_that_hide_one_another_are_found_together() -> None:
    values = {"tip_load": {"force_x_N": 0.15, "force_y_N": -0.12}, "eccentricity": {"sin_2_deg": 5.0, "cos_2_deg": 3.0}}
    catalogue = {name: CATALOGUE[name] for name in ("homing_offset", "tip_load", "eccentricity")}
    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE | values), catalogue=catalogue)
    taken = [step for step in found.path if step.taken]
    assert {*taken[-1].effect.split(" and ")} == {"tip_load", "eccentricity"}  # none passes alone
    assert found.verdict == "named" and set(found.chosen.names) == {"tip_load", "eccentricity"}


@pytest.mark.usefixtures("without_building")  # of the same effect test_gross_outliers.py builds a term
def test_an_effect_outside_the_catalogue_gets_no_name() -> None:
    data = measured(ROBOT, PLAN, BASE | {"eccentricity": {"sin_2_deg": 9.0, "cos_2_deg": 5.0}})
    found = diagnose(ROBOT, data, catalogue=FEW)
    assert found.verdict == "unexplained" and not found.listed
    assert found.judgement.adequacy.within.p > 1e-3 > found.judgement.adequacy.between.p


@pytest.mark.usefixtures("without_building")
def test_an_effect_taken_out_is_not_replaced_by_another_name() -> None:
    data = measured(ROBOT, PLAN, BASE | {"backlash": {"theta_2_deg": 8.0}})
    found = diagnose(ROBOT, data, catalogue=QUICK, without=["backlash"])
    assert found.verdict == "unexplained" and not found.listed
    assert found.to_json()["without"] == ["backlash"]
    assert any("backlash" in note for note in found.notes)
    assert not any(step.effect == "backlash" for step in found.path)


def distorted(values: dict[str, dict[str, float]]) -> Diagnosis:
    """What is said where the catalogue has a distortion of the tracker and nothing else of the sensor."""
    catalogue = {name: CATALOGUE[name] for name in ("sensor_distortion", "tip_load")}
    return diagnose(ROBOT, measured(ROBOT, PLAN, BASE | values), catalogue=catalogue)


@pytest.mark.usefixtures("without_building")
def test_what_a_turned_base_does_as_well_is_no_evidence_for_a_distortion() -> None:
    turned = distorted({"base_misalignment": {"rotation_x_deg": 2.0, "rotation_y_deg": -1.5, "shift_z_mm": 1.0}})
    assert any(step.effect == "sensor_distortion" and step.taken for step in turned.path)
    assert turned.verdict == "unexplained" and not turned.listed
    assert any("other causes" in note for note in turned.notes)


def test_noise_that_a_bent_field_fits_is_no_evidence_for_it() -> None:
    """Beside a shift, which other causes make as well, the 18 numbers of second degree always fit some noise."""
    touching = [f"tube.{i}.collar_length_mm=0" for i in (2, 3)]  # made-up waypoints have collars that do
    robot, bent = load_robot(SCENARIOS / "robots" / "three_tube.toml", touching), CATALOGUE["sensor_distortion"]
    plan, noise = waypoints(robot, 13), Noise(4 * SIGMA_M, 4 * SIGMA_RAD)
    for seed in range(10):
        data = measured(robot, plan, {"base_misalignment": {"shift_x_mm": 1.5, "rotation_y_deg": 1.0}}, seed, noise=4)
        bench = Workbench(robot, data, noise, data.configuration)
        whole = term(bent, bent.variants(robot, data)[0], robot)
        assert verdict._is_shared(bench, bench.scored([whole]), whole)


def test_a_distortion_that_bends_the_field_is_named() -> None:
    bent = {"x_zz_mm": 3.0, "y_xz_mm": -2.0, "x_y_mm": 2.0, "tangent_share": 1.0}
    found = distorted({"sensor_distortion": bent})
    assert found.verdict == "named" and names(found) == [{"sensor_distortion"}]


def test_only_effects_of_the_catalogue_can_be_taken_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="'sticktion': must be an effect of the catalogue: .*tip_load"):
        diagnose(ROBOT, PLAN, without=["tip_load", "sticktion"])
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    write_csv(tmp_path / "data.csv", measured(ROBOT, PLAN, BASE))
    call = ["diagnose", str(tmp_path / "robot.toml"), str(tmp_path / "data.csv"), "-o", str(tmp_path / "out")]
    assert main([*call, "--without", "sticktion"]) == 2
    message = capsys.readouterr().err
    assert "friction" in message and "sticktion" in message and message.count("\n") == 1
    assert not (tmp_path / "out" / "diagnosis.json").exists()


def test_a_ratio_no_tube_has_is_reported_and_a_robot_file_can_still_be_written(tmp_path: Path) -> None:
    data = measured(ROBOT, PLAN, {"calibration": {"poisson_ratio_1": 0.9, "poisson_ratio_2": 0.9}})
    found = diagnose(ROBOT, data, catalogue=QUICK)
    assert any("poisson_ratio" in note and "no tube has" in note for note in found.notes)
    write_robot(tmp_path / "robot.toml", found.robot_content())
    written = load_robot(tmp_path / "robot.toml")
    assert max(tube.poisson_ratio for tube in written.tubes) == 0.5
    tips = [
        written.solve(*row).tip_m
        for row in zip(data.theta_commanded[data.rows], data.l_commanded[data.rows], strict=True)
    ]
    error_m = np.linalg.norm(np.array(tips) - data.position_m, axis=1)  # the gap is that of the file
    share = np.sqrt(np.mean(error_m**2)) / found.gap.after.rms_m
    assert 0.8 < share < 1.25


def test_no_name_is_given_beside_a_calibration_that_no_tube_can_have() -> None:
    impossible = {"calibration": {"poisson_ratio_1": 0.9, "poisson_ratio_2": 0.9}}
    found = diagnose(ROBOT, measured(ROBOT, PLAN, impossible | {"backlash": {"theta_2_deg": 8.0}}), catalogue=QUICK)
    assert {step.effect for step in found.path if step.taken} == {"backlash"}  # found, and not believed
    assert found.verdict == "unexplained" and any("no tube has" in note for note in found.notes)
    assert found.chosen.names == () and "backlash" not in found.robot_content().get("effects", {})


@pytest.mark.usefixtures("without_building")
@thorough("test_no_name_is_given_beside_a_calibration_that_no_tube_can_have")
def test_what_is_handed_over_has_the_effects_of_the_verdict_alone() -> None:
    values = {"tip_load": {"force_x_N": 0.1, "force_y_N": -0.1, "force_z_N": 0.0}, "backlash": {"theta_2_deg": 3.0}}
    data = measured(ROBOT, PLAN, BASE | values | {"eccentricity": {"sin_2_deg": 2.0, "cos_2_deg": 2.0}})
    found = diagnose(ROBOT, data, catalogue=FEW)
    taken = {name for step in found.path if step.taken for name in step.effect.split(" and ")}
    assert taken > {"backlash"}  # others were chosen, and not believed
    assert found.verdict == "partial" and [t.name for t in found.listed] == ["backlash"]
    assert set(found.chosen.names) == {"backlash"}
    assert set(found.robot_content()["effects"]) == {"backlash", "base_misalignment"}  # the frame is always free


def test_an_outlier_is_reported_and_changes_little() -> None:
    clean = measured(ROBOT, PLAN, BASE)
    position = clean.position_m.copy()
    chosen = of_nominal_parameters()
    row = int(chosen.base.fit.chain.data.rows[0])  # one that the selection sees
    position[int(np.flatnonzero(clean.rows == row)[0])] += [0.02, -0.01, 0.0]
    spoilt = Measurements(
        clean.sequence,
        clean.theta_commanded,
        clean.l_commanded,
        clean.rows,
        position,
        clean.tangent,
        clean.time_s,
        clean.is_stream,
    )
    found = diagnose(ROBOT, spoilt, catalogue=QUICK)
    assert found.outlier_rows == (row + 1,) and found.verdict == "no_missing_effect"
    np.testing.assert_allclose(found.base.fit.p, chosen.base.fit.p, atol=0.1)


def test_a_blank_does_not_hide_what_the_error_goes_along_with() -> None:
    group, rng = PLAN.configuration, np.random.default_rng(0)
    warmth = np.linspace(20.0, 30.0, len(PLAN.sequence))
    warmth[PLAN.rows[[3, 11]]] = np.nan
    r = rng.standard_normal((PLAN.count, 5)) + np.where(PLAN.rows > np.median(PLAN.rows), 2.0, -2.0)[:, None]
    place = localise(replace(PLAN, time_s=None, more={"temperature_C": warmth}), r, group, np.ones(len(r)), 0.1)
    assert place.trends[0].quantity == "temperature_C" and place.trends[0].share > 0.6
    warmth[:] = np.where(np.arange(len(warmth)) > np.median(PLAN.rows), 20.0, np.nan)  # blank or not says it all
    place = localise(replace(PLAN, time_s=None, more={"temperature_C": warmth}), r, group, np.ones(len(r)), 0.1)
    assert place.trends[0].quantity == "temperature_C" and place.trends[0].probability > 0.95


TIP_LOAD = BASE | {"tip_load": {"force_x_N": 0.15, "force_y_N": -0.12, "force_z_N": 0.0}}


def test_poses_without_a_solution_are_left_out_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses of the selection and of the held-out set are left out; an effect that is right stays so."""
    data = measured(ROBOT, PLAN, TIP_LOAD)
    parts = split(np.ones(data.count, bool), groups(data))
    configurations = [int(data.configuration[part[0]]) for part in (parts.selection, parts.held_out_set)]
    rows = without_solutions(PLAN, configurations, monkeypatch)
    found = diagnose(ROBOT, data, catalogue=FEW)
    assert found.verdict == "named" and names(found) == [{"tip_load"}]
    assert found.judgement.adequacy.total.p > 1e-3 and found.gap.after.rms_m < 1.3 * found.gap.floor_m
    assert (
        found.gap.before.poses == found.gap.after.poses == len(parts.held_out_set) - 3 and found.gap.failed.sum() == 3
    )
    (note,) = (note for note in found.notes if "no equilibrium" in note)
    assert note.startswith(f"The solver found no equilibrium at {len(rows)} of {data.count} poses")
    assert all(f"{row}" in note for row in rows) and "left out" in note
    errors, called = selection_errors(found), count_calls(monkeypatch)
    assert np.isnan(errors.calibrated_m).sum() == np.isnan(errors.with_effects_m).sum() == len(rows) - 3
    assert note in unescape(diagnosis_report_html(found, errors)) and called == []  # writers solve nothing
    (signature,) = errors.signatures
    drawn = np.isfinite(signature.shift_m)
    assert drawn.sum() == len(signature.shift_m) - len(rows) + 3
    explained = signature.measured_m[drawn] - signature.shift_m[drawn]  # what is measured is what the effect does
    assert np.sqrt(np.mean(explained**2)) < found.gap.floor_m < np.sqrt(np.mean(signature.shift_m[drawn] ** 2))
    assert found.coverage == pytest.approx(1 - len(rows) / data.count) and not found.outlier_rows


def test_a_model_that_fails_everywhere_explains_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    data = measured(ROBOT, PLAN, TIP_LOAD)
    rows = without_solutions(PLAN, list(range(0, 18, 2)), monkeypatch)
    found = diagnose(ROBOT, data, catalogue=FEW)
    assert found.verdict == "unexplained"
    assert any(f"no equilibrium at {len(rows)} of" in note and "too many" in note for note in found.notes)


def test_too_few_configurations_and_unknown_noise_are_refused() -> None:
    with pytest.raises(InputError, match="too few"):
        diagnose(ROBOT, measured(ROBOT, waypoints(ROBOT, 5)))
    with pytest.raises(
        InputError, match="measurement: is missing.*or measure at least 20 poses again.*these data have 0"
    ):
        diagnose(SILENT, measured(ROBOT, PLAN))
    with pytest.raises(InputError, match="have 9"):
        diagnose(SILENT, measured(ROBOT, waypoints_with_repeats(9)))


def test_without_a_stated_noise_it_comes_from_repeats() -> None:
    data = measured(ROBOT, waypoints_with_repeats(54), BASE | {"backlash": {"theta_2_deg": 8.0}})
    data.position_m[np.flatnonzero(np.diff(data.rows) == 1)[3]] += 0.02  # one that went wrong
    found = diagnose(SILENT, data, catalogue=QUICK)
    assert found.noise.position_m == pytest.approx(SIGMA_M, rel=0.15)
    assert found.noise.tangent_rad == pytest.approx(SIGMA_RAD, rel=0.15)
    assert any("states no noise; 54 repeated poses" in note for note in found.notes)
    assert found.verdict == "named" and names(found) == [{"backlash"}]  # no difference of approaches went into it


def waypoints_with_repeats(count: int) -> Measurements:
    """The plan with its first poses measured twice."""
    again = np.sort(np.concatenate([np.arange(len(PLAN.sequence)), PLAN.rows[:count]]))
    rows = np.flatnonzero(np.isin(again, PLAN.rows))
    nothing = np.zeros((len(rows), 3))
    return Measurements(
        PLAN.sequence[again],
        PLAN.theta_commanded[again],
        PLAN.l_commanded[again],
        rows,
        nothing,
        nothing,
        np.arange(len(again), dtype=float),
    )


def test_an_interrupted_run_keeps_what_it_had() -> None:
    stop, steps = threading.Event(), list[str]()

    def progress(step: str, share: float) -> None:
        steps.append(step)
        assert 0 <= share <= 1
        if step.startswith("comparing"):
            stop.set()

    found = diagnose(ROBOT, measured(ROBOT, PLAN, BASE), progress, catalogue=QUICK, interrupted=stop)
    assert found.interrupted and found.verdict != "named"
    assert steps[0] == "calibrating" and steps[-1] == "asking the held-out set"


def test_the_command_writes_files_that_go_on_working(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    write_csv(tmp_path / "data.csv", measured(ROBOT, PLAN, BASE | {"backlash": {"theta_2_deg": 8.0}}))
    out = tmp_path / "out"
    quick = [f"--without={name}" for name in CATALOGUE if name not in QUICK]
    given = [str(tmp_path / "robot.toml"), str(tmp_path / "data.csv"), "-o", str(out), "--quiet", *quick]
    assert main(["diagnose", *given]) == 0
    assert re.search(
        r"Missing: the rotation of tube 2 has [\d.]+ deg of play \(backlash theta_2_deg = ", capsys.readouterr().out
    )
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["verdict"] == "named" and content["effects"][0]["stage"] == "drive"
    assert set(content["gap"]) >= {
        "before_rms_mm",
        "after_rms_mm",
        "noise_floor_mm",
        "heldout_poses",
        "before_max_mm",
        "after_max_mm",
    }
    page = (out / "report.html").read_text()
    assert "<h1>Play in the drive</h1>" in page and "[effects.backlash]" in page and ">named<" not in page
    assert "* plotly.js v" in library(page) and 'id="signature_0"' in page
    written = load_robot(out / "robot.toml")
    assert written.effects["backlash"]["theta_2_deg"] == pytest.approx(8.0, abs=1.0)
    assert np.isfinite(written.bound([0.0, 1.0], [0.0, -0.02]).position_m)
    page = (out / "report.html").read_text()
    assert "backlash" in page and "http://" not in page.split("<script")[0]
    again = [str(out / "robot.toml"), str(tmp_path / "data.csv"), "-o", str(tmp_path / "again"), "--quiet", *quick]
    assert main(["diagnose", *again]) == 0  # with the effect in the file nothing is missing
    assert json.loads((tmp_path / "again" / "diagnosis.json").read_text())["verdict"] == "no_missing_effect"


@pytest.mark.parametrize("sigma", [1e-6, 1000.0])
def test_a_stated_noise_at_the_ends_of_its_range_is_no_numerical_fault(
    sigma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not FUZZ:
        monkeypatch.setattr(partial_diagnosis, "MOST_EFFECTS", 1)  # pieces: noise of this size takes as many as it may
    stated = {"position_sigma_mm": sigma, "tangent_sigma_deg": 1e-6 if sigma < 1 else 180.0}
    robot = pair_robot(measurement=stated)
    found = diagnose(robot, measured(robot, waypoints(robot, 14)), without=sorted(set(CATALOGUE) - {"friction"}))
    assert np.isfinite(found.gap.after.rms_m)
