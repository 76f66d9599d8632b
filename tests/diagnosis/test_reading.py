"""Files that do not mean what they say are told by asking the uncalibrated robot; clean ones raise no alarm."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from made_up_input import thorough
from measured_data import measured, pair_robot, waypoints, write_csv
from places import SCENARIOS
from scipy.spatial.transform import Rotation

from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import Calibration, calibrate
from ctrplan.calibration.reading import MisreadError, read_again
from ctrplan.diagnosis import Diagnosis, diagnose
from ctrplan.measurement.approach import how_taken
from ctrplan.measurement.measurements import Measurements, is_streamed

ROBOT = pair_robot()
BASE = {"calibration": {"precurvature_factor_1_1": 1.05, "stiffness_factor_2": 0.93, "poisson_ratio_1": 0.36}}
FIXED = measured(ROBOT, waypoints(ROBOT, 14), BASE)  # tube 1 never turns there
TURN = 0.7 * (1 + np.arange(len(FIXED.sequence)) // 5)  # so does the whole robot with both tubes
CLEAN = replace(
    FIXED,
    theta_commanded=FIXED.theta_commanded + TURN[:, None],
    position_m=Rotation.from_rotvec(np.outer(TURN[FIXED.rows], [0, 0, 1])).apply(FIXED.position_m),
    tangent=Rotation.from_rotvec(np.outer(TURN[FIXED.rows], [0, 0, 1])).apply(FIXED.tangent),
)


def joints(theta: Array | None = None, l: Array | None = None) -> Measurements:  # noqa: E741
    return replace(
        CLEAN,
        theta_commanded=CLEAN.theta_commanded if theta is None else theta,
        l_commanded=CLEAN.l_commanded if l is None else l,
    )


def places(position: Array) -> Measurements:
    return replace(CLEAN, position_m=position)


THETA, L, P = CLEAN.theta_commanded, CLEAN.l_commanded, CLEAN.position_m
ELSEWHERE = Rotation.from_rotvec([0.4, 1.1, -0.7])
FAULTS = {
    "rotation 2 has the other sign": joints(THETA * [1, -1]),
    "rotation 2 is logged relative to tube 1": joints(THETA - np.outer(THETA[:, 0], [0, 1])),
    "rotations are in degrees": joints(np.degrees(THETA)),
    "rotation 1 is in degrees": joints(THETA * [180 / np.pi, 1]),
    "rotation 2 is 57.3 times too small": joints(THETA * [1, np.pi / 180]),
    "all rotations are half of what the tubes turn": joints(THETA / 2),
    "tubes are in the opposite order": joints(THETA[:, ::-1], L[:, ::-1]),
    "translations are in millimetres": joints(l=1e3 * L),
    "translation 2 is 1000 times too small": joints(l=L * [1, 1e-3]),
    "(y, x, z)": places(P[:, [1, 0, 2]]),
    "(x, y, -z)": places(P * [1, 1, -1]),
    "positions are in millimetres": places(1e3 * P),
    "positions are in inches": places(P / 0.0254),
    "positions are in centimetres": places(100 * P),
    "positions are 1000 times too small": places(1e-3 * P),
    "translations are in inches": joints(l=L / 0.0254),
    "poses are two rows late": places(np.roll(P, 2, axis=0)),
    "tube 2 is mounted 90 deg off": joints(THETA - [0, np.pi / 2]),
    "shifted by 1": places(P + [0.1, -0.05, 0.02]),
    "(-tx, -ty, -tz)": replace(CLEAN, tangent=-CLEAN.tangent),
    "(tz, ty, tx)": replace(CLEAN, tangent=CLEAN.tangent[:, ::-1]),
    "tangents are in another frame": replace(CLEAN, tangent=ELSEWHERE.apply(CLEAN.tangent)),
    "positions are in another frame": places(ELSEWHERE.apply(P) + [0.03, -0.2, 0.1]),
}


def test_a_file_that_means_what_it_says_raises_no_alarm() -> None:
    assert read_again(ROBOT, CLEAN) == ()


@pytest.mark.parametrize("fault", FAULTS)
def test_gross_faults_are_told(fault: str) -> None:
    told = read_again(ROBOT, FAULTS[fault])
    assert told and fault in told[0].what and told[0].rms_after < 4.0
    assert told[0].to_json()["columns"] and "read so" in told[0].sentence


def test_rows_that_are_late_by_the_clock_may_be_a_lag() -> None:
    """Both say the same of a stream: the answer names both, with the time between so many rows."""
    late = places(np.roll(P, 2, axis=0))
    stream = replace(late, is_stream=True, time_s=0.1 * np.arange(len(THETA)))
    told, at_rest = (read_again(ROBOT, data)[0] for data in (stream, late))
    apart_s = 2 * float(np.median(np.diff(stream.time_s[stream.rows])))  # type: ignore[index]
    assert told.what == f"{at_rest.what}, or stamped {apart_s:.2g} s late, which --as-read leaves to the effect lag"


def test_tangents_are_read_as_positions_where_that_suits_them() -> None:
    turned = places(P[:, [2, 1, 0]])
    assert "tx" not in read_again(ROBOT, turned)[0].columns
    (told,) = read_again(ROBOT, replace(turned, tangent=CLEAN.tangent[:, [2, 1, 0]]))
    assert told.columns == ("x_m", "y_m", "z_m", "tx", "ty", "tz")


def test_another_axis_of_the_sensor_is_no_tangent() -> None:
    across = np.cross(CLEAN.tangent, [1.0, 0.0, 0.0])
    (told,) = read_again(ROBOT, replace(CLEAN, tangent=across / np.linalg.norm(across, axis=1, keepdims=True)))
    assert told.what.startswith("tangents are 90 deg from") and told.sentence.endswith("follow the tube.")


def test_a_base_that_is_turned_as_far_as_an_effect_has_it_is_no_fault_of_reading() -> None:
    assert read_again(ROBOT, places(Rotation.from_rotvec([0.05, -0.08, 0.02]).apply(P) + [0.004, -0.005, 0.003])) == ()


def test_a_base_that_drifts_on_a_short_motion_is_no_other_frame() -> None:
    """Where tips stay in one corner, the frame that suits a drift best is turned about a far place."""
    rng = np.random.default_rng(8)
    gone = np.linspace(0, 1, len(THETA))[:, None]
    near = joints(np.hstack([0.2 * gone, 1 + 0.5 * gone]), L.mean(axis=0) - 4e-3 * gone)
    collars = ROBOT.collars(near.theta_commanded[near.rows], near.l_commanded[near.rows])
    position = ROBOT.mechanics.tips(*collars)[0]
    late = np.linspace(0, 1, len(position))[:, None]
    for _ in range(20):
        by = 12e-3 * (v := rng.normal(size=3)) / np.linalg.norm(v)
        noise = 3e-4 * rng.normal(size=position.shape)
        assert read_again(ROBOT, replace(near, position_m=position + late * by + noise)) == ()


@pytest.mark.parametrize("seed", [0, 5, 9, 11, 21])
def test_what_ordinary_calibration_explains_is_no_fault_of_reading(seed: int) -> None:
    """A short motion of a robot that is as far from its file as priors have it, which others than its joints fit."""
    rng, gone = np.random.default_rng(seed), np.linspace(0, 1, len(THETA))[:, None]
    turn = rng.uniform(-3, 3) + np.sin(2 * np.pi * gone + rng.uniform(0, 6))
    near = joints(np.hstack([0 * gone, turn]), L.mean(axis=0) - 4e-3 * gone)
    names = ("precurvature_factor_1_1", "precurvature_factor_2_2", "stiffness_factor_2")
    sizes = np.array([0.1, 0.1, 0.2, 0.15, 0.15]) * rng.standard_normal(5)
    ratios = np.clip(0.3 + sizes[3:], 0.01, 0.6).tolist()
    factors = dict(zip(names, (1 + sizes[:3]).tolist(), strict=True))
    base = factors | {"poisson_ratio_1": ratios[0], "poisson_ratio_2": ratios[1]}
    assert read_again(ROBOT, measured(ROBOT, near, {"calibration": base}, seed=seed)) == ()


def near(seed: int) -> Measurements:
    """A motion whose tips move 15 mm (rms), and a base that is shifted by 15 mm and turned by 14 deg."""
    gone = np.linspace(0, 1, len(THETA))[:, None]
    short = joints(np.hstack([1.6 + gone, -1.0 + 0.6 * gone + np.sin(4 * gone)]), L.mean(axis=0) - 9e-3 * gone)
    told = measured(ROBOT, short, BASE, seed=seed)
    turn, shift = (v / np.linalg.norm(v) for v in np.random.default_rng(seed).normal(size=(2, 3)))
    off = Rotation.from_rotvec(np.radians(14.0) * turn)
    return replace(told, position_m=off.apply(told.position_m) + 15e-3 * shift, tangent=off.apply(told.tangent))


NEAR_FAULTS: dict[str, Callable[[Measurements], Measurements]] = {
    "(y, x, z)": lambda data: replace(data, position_m=data.position_m[:, [1, 0, 2]]),
    "(x, y, -z)": lambda data: replace(data, position_m=data.position_m * [1, 1, -1]),
    "positions are in millimetres": lambda data: replace(data, position_m=1e3 * data.position_m),
    "rotation 2 has the other sign": lambda data: replace(data, theta_commanded=data.theta_commanded * [1, -1]),
    "rotations are in degrees": lambda data: replace(data, theta_commanded=np.degrees(data.theta_commanded)),
    "translations are in millimetres": lambda data: replace(data, l_commanded=1e3 * data.l_commanded),
    "(-tx, -ty, -tz)": lambda data: replace(data, tangent=-data.tangent),
}


@pytest.mark.parametrize("fault", NEAR_FAULTS)
def test_faults_are_told_where_the_base_is_off_as_far_as_tips_move(fault: str) -> None:
    """The base is off in every reading alike: none is asked without one."""
    for seed in range(4):
        told = read_again(ROBOT, NEAR_FAULTS[fault](near(seed)))
        assert told and fault in told[0].what


def test_a_base_that_is_off_is_no_fault_of_a_short_motion() -> None:
    for seed in range(8):
        assert read_again(ROBOT, near(seed)) == ()


@pytest.mark.parametrize("count", [4, 5, 6, 8])
def test_few_poses_that_mean_what_they_say_raise_no_alarm(count: int) -> None:
    """Orders of the rows that put every tip where it was are no other orders."""
    for seed in range(12):
        few = np.sort(np.random.default_rng(seed).permutation(CLEAN.count)[:count])
        assert read_again(ROBOT, CLEAN.subset(few)) == ()
        assert "positions are in millimetres" in read_again(ROBOT, places(1e3 * P).subset(few))[0].what


def test_tips_that_heed_no_joint_are_told_and_read_in_no_other_way() -> None:
    rng = np.random.default_rng(3)
    spread = np.sqrt(np.mean(np.sum((P - P.mean(axis=0)) ** 2, axis=1)) / 3)
    for loose in (places(P.mean(axis=0) + spread * rng.normal(size=P.shape)), places(P[rng.permutation(len(P))])):
        (told,) = read_again(ROBOT, loose)
        assert told.what.startswith("the tips heed no joint") and not told.columns
        assert "put in any other order" in told.sentence and "read so" not in told.sentence


def test_tips_that_hardly_move_are_not_said_to_heed_no_joint() -> None:
    """Where joints hardly move, any order of the rows fits as well."""
    rng = np.random.default_rng(3)
    still = joints(THETA[:1] + 1e-3 * rng.normal(size=THETA.shape), L[:1] + np.zeros_like(L))
    assert read_again(ROBOT, replace(still, position_m=P[:1] + 1e-3 * rng.normal(size=P.shape))) == ()


def test_rows_that_jump_about_are_poses_at_rest_and_dense_ones_a_motion() -> None:
    rng = np.random.default_rng(0)
    run, rows = np.zeros(40, int), np.arange(40)
    jumps, places_m = rng.normal(size=(40, 4)), rng.normal(size=(40, 3))
    assert is_streamed(run, rows, jumps) and not is_streamed(run, rows, jumps, places_m)
    assert is_streamed(run, rows, np.cumsum(jumps, axis=0), np.cumsum(0.01 * np.ones((40, 3)), axis=0))


def test_how_poses_were_taken_is_said_and_wide_turns_as_well() -> None:
    theta = np.radians([[0.0, 0.0], [20.0, 300.0], [5.0, 10.0], [70.0, 40.0]])
    nothing = np.zeros((4, 3))
    single = Measurements(np.zeros(4, int), theta, np.zeros((4, 2)), np.arange(4), nothing, nothing)
    told = how_taken(single)
    assert "at rest" in told[0] and "rows 1 and 2" in told[1] and "300 deg" in told[1]
    assert how_taken(CLEAN) == []


@pytest.mark.parametrize("command", ["diagnose", "calibrate"])
def test_commands_fit_nothing_to_a_misread_file(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import ctrplan.files.measurement_file as files

    swapped = joints(theta=THETA[:, ::-1].copy())
    monkeypatch.setattr(files, "load_measurements", lambda *_: swapped)
    robot = SCENARIOS / "robots" / "table_5_pair.toml"
    monkeypatch.setattr("ctrplan.files.robot_file.load_robot", lambda *_, **__: ROBOT)
    parameters = ["--parameters", "poisson_ratio_1"] if command == "calibrate" else []
    assert main([command, str(robot), "log.csv", "-o", str(tmp_path / "out"), *parameters]) == 1
    assert "--as-read fits it as it stands" in capsys.readouterr().err
    assert not (tmp_path / "out" / "robot.toml").exists()


@pytest.mark.parametrize("fitted", [calibrate, diagnose])
def test_python_fits_nothing_to_misread_measurements_unless_told_to(
    fitted: Callable[..., Calibration | Diagnosis],
) -> None:
    swapped = places(P[:, [1, 0, 2]])
    with pytest.raises(MisreadError, match=r"\(y, x, z\).*as_read=True"):
        fitted(ROBOT, swapped)
    assert inspect.signature(fitted).parameters["as_read"].default is False


def test_what_is_fitted_as_it_stands_says_so() -> None:
    swapped = places(P[:, [1, 0, 2]])
    result = calibrate(ROBOT, swapped, ["poisson_ratio_1"], as_read=True)
    assert read_again(ROBOT, swapped)[0].sentence == result.notes[0] and "(y, x, z)" in result.notes[0]


def misread_files(folder: Path) -> list[str]:
    """Robot and measurements whose two tubes were exchanged in the log, as a shell names them."""
    (folder / "robot.toml").write_text(tomli_w.dumps(dict(ROBOT.content)))
    write_csv(folder / "log.csv", joints(theta=THETA[:, ::-1].copy()))
    return [str(folder / "robot.toml"), str(folder / "log.csv")]


def test_the_reading_is_written_where_nothing_is_fitted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files, out = misread_files(tmp_path), tmp_path / "out"
    out.mkdir()
    for name in ("diagnosis.json", "robot.toml"):
        (out / name).write_text("# of an earlier run")
    assert main(["diagnose", *files, "-o", str(out), "--quiet"]) == 1
    said = json.loads((out / "diagnosis.json").read_text())
    told = said["reading"][0]
    assert said["verdict"] == "misread" and set(told) == {"what", "columns", "rms_before_mm", "rms_after_mm"}
    assert told["rms_after_mm"] < 0.5 * told["rms_before_mm"] and told["what"] in capsys.readouterr().err.lower()
    assert not (out / "robot.toml").exists() and "diagnosis.json" in (out / "SHA256SUMS").read_text()


@thorough("test_the_reading_is_written_where_nothing_is_fitted has the sentence")
def test_the_reading_is_the_first_sentence_of_an_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = misread_files(tmp_path)
    assert main(["diagnose", *files, "-o", str(tmp_path / "out"), "--quiet", "--as-read"]) in (0, 1)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("Rotations 1 and 2 are exchanged") and said["reading"][0]["what"] in first.lower()
    assert first in (tmp_path / "out" / "report.html").read_text()


def test_check_reads_measurements_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, log = misread_files(tmp_path)
    assert main(["check", log, "--robot", robot]) == 1
    assert "! " in (said := capsys.readouterr().out) and "Rotations 1 and 2 are exchanged" in said
    write_csv(tmp_path / "clean.csv", CLEAN)
    assert main(["check", str(tmp_path / "clean.csv"), "--robot", robot, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reading"] == []


@pytest.mark.filterwarnings("error")
def test_few_poses_are_too_few_and_no_warning_of_numpy() -> None:
    few = places(CLEAN.position_m).subset(np.arange(3))
    assert read_again(ROBOT, few) == ()
