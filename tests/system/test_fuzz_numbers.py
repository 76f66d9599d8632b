"""Numbers that nobody means: in every key of a file, on the command line, in every argument of the public functions.

Each of them is refused in one sentence, or the command does what it always does; nothing else reaches the terminal.
That every number of a file has a finite range is asked of all keys. That a range is kept is asked of a key of each
kind, and of all keys with CTRPLAN_FUZZ set (`make fuzz`).
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import msgspec
import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import measured, pair_robot, waypoints, write_csv
from places import SCENARIOS
from small_scenarios import NEAR

import ctrplan
from ctrplan.__main__ import main
from ctrplan.anatomy.shape import CATALOGUE as SHAPES
from ctrplan.calibration.calibrate import calibrate
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.effects.effect import CATALOGUE as EFFECTS
from ctrplan.errors import CtrplanError, InputError
from ctrplan.files.design_file import DesignEntry
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import RobotEntry, load_robot, robot_from_dict, write_robot
from ctrplan.files.scenario_file import ScenarioEntry, load_scenario
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import HistoryOptions
from ctrplan.scenario.scenario import CATALOGUE as PLANNERS
from ctrplan.studies.sweep import parse_axis, sweep

ROBOT_FILE = SCENARIOS / "robots" / "table_1_pair.toml"
SCENARIO_FILE = SCENARIOS / "pair_free.toml"
ROBOT = load_robot(ROBOT_FILE)
SCENARIO = load_scenario(SCENARIO_FILE)
AT = [0.0, 1.0], [0.0, -0.017]
HUGE, TINY = ("1e300", "-1e300"), ("1e-300", "-1e-300", "0", "nan", "inf", "9" * 400)
BY_HAND = {"friction_coefficient"}  # a union, of which msgspec reads limits wrongly; see robot_entries.py


def keys(schema: type[msgspec.Struct], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Key and type of every number of a schema, the first entry of every list."""
    for field in msgspec.structs.fields(schema):
        yield from _keys(field.type, prefix + field.name)


def _keys(hint: Any, key: str) -> Iterator[tuple[str, Any]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield from keys(hint, f"{key}.")
    elif hint in (int, float) or getattr(hint, "__metadata__", None) and get_args(hint)[0] in (int, float):
        yield key, hint
    elif getattr(hint, "__origin__", None) in (list, tuple):
        for inner in get_args(hint)[:1]:
            yield from _keys(inner, f"{key}.1")
    else:
        for inner in get_args(hint):
            yield from _keys(inner, key)


ROBOT_KEYS = dict(keys(RobotEntry))
SCENARIO_KEYS = dict(keys(ScenarioEntry))
DESIGN_KEYS = dict(keys(DesignEntry))
SCENARIO_KEYS |= {key: hint for schema in PLANNERS.values() for key, hint in keys(schema, "planner.")}
SCENARIO_KEYS |= {key: hint for schema in SHAPES.values() for key, hint in keys(schema, "anatomy.1.")}


def has_finite_range(hint: Any) -> bool:
    metas = getattr(hint, "__metadata__", ())
    ends = [(meta.ge if meta.gt is None else meta.gt, meta.le if meta.lt is None else meta.lt) for meta in metas]
    return any(None not in pair and all(map(math.isfinite, pair)) for pair in ends)


def test_every_number_of_a_file_has_a_finite_range() -> None:
    known = ROBOT_KEYS | SCENARIO_KEYS | DESIGN_KEYS
    asked = [key for key in known if key.rpartition(".")[2] not in BY_HAND and "friction_coefficient" not in key]
    assert len(asked) > 90 and not [key for key in asked if not has_finite_range(known[key])]


def test_every_number_of_an_effect_has_a_finite_range() -> None:
    robot = load_robot(SCENARIOS / "robots" / "three_tube.toml")
    for name in EFFECTS:
        for parameter in EFFECTS[name].parameters(robot):
            assert math.isfinite(parameter.lower) and math.isfinite(parameter.upper), (name, parameter.name)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, list[str]]:
    """Exit code, and what is on standard error besides warnings of ctrplan."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # what numpy would print on the terminal
        code = main(list(arguments))
    lines = capsys.readouterr().err.splitlines()
    return code, [line for line in lines if not line.startswith("ctrplan: warning:")]


def assert_refused(code: int, lines: list[str]) -> None:
    assert code == 2 and len(lines) == 1, (code, lines)
    assert lines[0].startswith("ctrplan: ") and lines[0].endswith((".", "?")) and len(lines[0]) < 1000


def assert_told(code: int, lines: list[str]) -> None:
    """An answer, or one sentence why there is none."""
    assert code in (0, 1, 2) and len(lines) == (code != 0), (code, lines)


def of_each_kind(known: dict[str, Any]) -> list[str]:
    """The first key of each table of a file, and the first entry of a list in it."""
    tables = {(key.rpartition(".")[0], key.endswith(".1")): key for key in sorted(known, reverse=True)}
    return sorted(tables.values())


PLACE = ["place", str(SCENARIO_FILE), "--candidates", "1", "--confirm", "1"]
BOUND = ["bound", str(ROBOT_FILE), "--theta-deg", "0", "60", "--l-mm", "0", "-17"]


@pytest.mark.parametrize("value", HUGE)
@pytest.mark.parametrize("key", sorted(ROBOT_KEYS) if FUZZ else of_each_kind(ROBOT_KEYS))
def test_no_key_of_a_robot_may_be_huge(key: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert_refused(*run(capsys, *BOUND, "--set", f"{key}={value}"))


@pytest.mark.parametrize("value", HUGE)
@pytest.mark.parametrize("key", sorted(SCENARIO_KEYS) if FUZZ else of_each_kind(SCENARIO_KEYS))
def test_no_key_of_a_scenario_may_be_huge(
    key: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_refused(
        *run(capsys, "plan", str(SCENARIO_FILE), "-o", str(tmp_path), "--set", f"{key}={value}", "--time", "0.2")
    )


ODD = sorted(ROBOT_KEYS) if FUZZ else ["tube.1.bending_stiffness_Nm2", "tube.2.poisson_ratio", "contact.1.clearance_mm"]


@pytest.mark.parametrize("value", [*TINY, "1e-9", "1e-12"])
@pytest.mark.parametrize("key", ODD)
def test_a_bound_of_a_robot_with_an_odd_number_is_one_or_is_refused(
    key: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert_told(*run(capsys, *BOUND, "--set", f"{key}={value}"))


ODD_COSTS = [(key, value) for key in ("cost.mm_per_rad", "cost.path", "cost.stop") for value in TINY[2:]]
ODD_COSTS += [("cost.mm_per_rad", "1e-300"), ("cost.path", "-1e-300"), ("cost.path", "1e-300"), ("cost.stop", "1e6")]
ODD_COSTS.remove(("cost.path", "0"))  # a plan, as with the smallest number


@pytest.mark.parametrize(
    ("key", "value"), [(key, value) for key in SCENARIO_KEYS for value in (*TINY, "1e6")] if FUZZ else ODD_COSTS
)
def test_a_plan_with_an_odd_number_is_one_or_is_refused(
    key: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("-o", str(tmp_path / "out"), "--set", NEAR, "--set", f"{key}={value}", "--time", "0.2", "--quiet")
    assert_told(*run(capsys, "plan", str(SCENARIO_FILE), *arguments))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("cost.mm_per_rad=1e300", ["cost.mm_per_rad = 1e+300 mm/rad"]),
        ("goal.tolerance_mm=1e300", ["goal.tolerance_mm = 1e+300 mm"]),
        ("cost.path=1e300", ["cost.path = 1e+300"]),
        ("cost.stop=1e300", ["cost.stop = 1e+300"]),
        ('goal.joints."rotate inner"=1e300', ["pair_free.toml", "goal.joints.rotate inner = 1e+300"]),
        ("robot.joint.1.max_velocity_deg_s=1e-4", ["table_5_pair.toml", "joint.1.max_velocity_deg_s = 0.0001 deg/s"]),
        ("robot.joint.1.max_velocity_deg_s=1e-3", ["table_5_pair.toml", "joint.1.max_velocity_deg_s", "deg/s"]),
        ("robot.measurement.position_sigma_mm=1e-300", ["measurement.position_sigma_mm = 1e-300 mm"]),
        ("robot.tube.1.bending_stiffness_Nm2=1e-300", ["tube.1.bending_stiffness_Nm2 = 1e-300 N m^2"]),
    ],
)
def test_the_sentence_names_file_key_and_value(
    change: str, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, lines = run(capsys, "plan", str(SCENARIO_FILE), "-o", str(tmp_path / "out"), "--set", change, "--time", "0.5")
    assert_refused(code, lines)
    assert all(word in lines[0] for word in words), lines


OPTIONS = {
    "--theta-deg": [*BOUND[:2], "--theta-deg", "{}", "0", "--l-mm", "0", "-17"],
    "--l-mm": [*BOUND[:2], "--theta-deg", "0", "0", "--l-mm", "0", "{}"],
    "--sweep": [*BOUND, "--sweep", "theta_1=0:{}:3"],
    "--sweep, count": [*BOUND, "--sweep", "theta_1=0:1:{}"],
    "--tip-mm": ["ik", str(ROBOT_FILE), "--tip-mm", "{}", "0", "100"],
    "--direction": ["ik", str(ROBOT_FILE), "--tip-mm", "0", "0", "100", "--direction", "{}", "0", "0"],
    "--tolerance-mm": ["ik", str(ROBOT_FILE), "--tip-mm", "0", "0", "100", "--tolerance-mm", "{}"],
    "--direction-tolerance-deg": [
        *("ik", str(ROBOT_FILE), "--tip-mm", "0", "0", "100", "--direction", "0", "0", "1"),
        *("--direction-tolerance-deg", "{}"),
    ],
    "--starts": ["ik", str(ROBOT_FILE), "--tip-mm", "0", "0", "100", "--starts", "{}"],
    "ik --seed": ["ik", str(ROBOT_FILE), "--tip-mm", "0", "0", "100", "--seed", "{}"],
    "plan --seed": ["plan", str(SCENARIO_FILE), "--seed", "{}"],
    "--time": ["plan", str(SCENARIO_FILE), "--time", "{}"],
    "--port": ["view", str(ROBOT_FILE), "--no-browser", "--port", "{}"],
    "--held-out": ["calibrate", str(ROBOT_FILE), "none.csv", "--held-out", "{}"],
    "calibrate --starts": ["calibrate", str(ROBOT_FILE), "none.csv", "--starts", "{}"],
    "calibrate --seed": ["calibrate", str(ROBOT_FILE), "none.csv", "--seed", "{}"],
    **{f"place {option}": [*PLACE, option, "{}"] for option in ("--radius-mm", "--cone-deg", "--seed")},
    **{f"place {option}": [*PLACE[:2], option, "{}"] for option in ("--candidates", "--confirm", "--plan")},
    "place --center-mm": [*PLACE, "--center-mm", "{}", "0", "0"],
    "--fps": ["render", "none.json", "-o", "film.gif", "--fps", "{}"],
    "--size": ["render", "none.json", "-o", "film.gif", "--size", "{}x100"],
    "--steps": ["export", "none.json", "--to", "slicer", "-o", "case", "--steps", "{}"],
    "--igtl": ["view", str(ROBOT_FILE), "--no-browser", "--igtl", "{}"],
    "--start": ["simulate", str(ROBOT_FILE), "none.csv", "--start", "{}"],
}


@pytest.mark.parametrize("option", sorted(OPTIONS))
def test_no_option_may_be_huge_or_no_number(
    option: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for value in ("1e300", "-1e300", "nan", "9" * 5000, "1_0", "١", ""):
        assert_refused(*run(capsys, *(part.format(value) for part in OPTIONS[option])))


@pytest.mark.parametrize("option", sorted(set(OPTIONS) - {"--port"}))
def test_an_option_may_be_tiny_or_is_refused(
    option: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_told(*run(capsys, *(part.format("1e-300") for part in OPTIONS[option])))


DATA = measured(pair_robot(), waypoints(pair_robot(), 4))
WRONG: list[Any] = ["x", 1e300, -1e300, math.nan, 10**400, None, [], {}, object(), 1j, b"x", True, np.array(["a"])]
WRONG_ARRAYS: list[Any] = [
    *("x", 10**400, [10**400, 0], [1j, 0], {}, object(), [[0], [0, 1]], [None, 0.0], [1e300, 0], [math.nan, 0]),
    np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[D]"),
    np.array([1, 2], dtype="timedelta64[s]"),
    np.ma.array([0.0, 1.0], mask=[False, True]),
    np.array(["0.0", "1.0"]),
    ["0.0", "1.0"],
    np.array([True, False]),
    np.array([1j, 0]),
]
Call = Callable[[Any], object]
ARRAYS: dict[str, Call] = {
    "bound theta_b": lambda x: ROBOT.bound(x, AT[1]),
    "bound l_b": lambda x: ROBOT.bound(AT[0], x),
    "solve": lambda x: ROBOT.solve(x, AT[1]),
    "zero_clearance": lambda x: ROBOT.zero_clearance(x, AT[1]),
    "collars": lambda x: ROBOT.bound(*ROBOT.collars(x, AT[1])),
    "bound_many": lambda x: ROBOT.bound_many([AT[0], x], [AT[1], AT[1]]),
    "tips": lambda x: ROBOT.mechanics.tips([x], [AT[1]]),
    "advance": lambda x: ROBOT.history().advance(x, AT[1]),
    "follow": lambda x: ROBOT.history().follow([AT[0], x], [AT[1], AT[1]]),
    "check_path": lambda x: ROBOT.mechanics.check_path([AT[0], x], [AT[1], AT[1]]),
    "body": lambda x: ROBOT.mechanics.body(x, AT[1]),
    "reorder": lambda x: ctrplan.reorder(x, SCENARIO),
    "l_shaped": lambda x: ctrplan.planning.l_shaped(x, SCENARIO),
    "time_parameterise": lambda x: time_parameterise(x, ROBOT.drive),
    "sweep": lambda x: sweep(ROBOT.content, [parse_axis("l_2=-20:-17:2", 2)], x, AT[1]),
}
OF_ROWS = {"bound_many", "follow", "check_path"}
SCALARS: dict[str, Call] = {
    "refinement": lambda x: ROBOT.mechanics.solve(*AT, refinement=x),
    "accuracy": lambda x: ROBOT.bound(*AT, accuracy=x),
    "threads": lambda x: ROBOT.bound_many([AT[0]], [AT[1]], threads=x),
    "bodies": lambda x: ROBOT.mechanics.check_path([AT[0]], [AT[1]], bodies=x),
    "parameters": lambda x: ROBOT.mechanics.tips_with_friction([AT[0]], [AT[1]], [[0.0]], parameters=x),
    "rotation_rad": lambda x: HistoryOptions(rotation_rad=x),
    "breakaway_m": lambda x: HistoryOptions(breakaway_m=x),
    "state_change": lambda x: HistoryOptions(state_change=x),
    "start": lambda x: ROBOT.history(x),
    "seed": lambda x: ctrplan.plan(SCENARIO, seed=x),
    "scenario": lambda x: ctrplan.plan(x),
    "scenario of reorder": lambda x: ctrplan.reorder([[0.0] * 3, [0.1] * 3], x),
    "period_s": lambda x: ctrplan.reorder([[0.0] * 3, [0.1] * 3], SCENARIO, period_s=x),
    "robot of diagnose": lambda x: ctrplan.diagnose(x, DATA),
    "data": lambda x: ctrplan.diagnose(pair_robot(), x),
    "robot of calibrate": lambda x: calibrate(x, DATA),
    "held_out": lambda x: calibrate(pair_robot(), DATA, held_out=x),
    "starts": lambda x: calibrate(pair_robot(), DATA, starts=x),
    "checker": lambda x: ctrplan.planning.MotionChecker(x),
    "stiffness": lambda x: Mechanics([replace(ROBOT.tubes[0], bending_stiffness_Nm2=x)], [], []).solve([0], [0]),
    "length": lambda x: Mechanics(
        [replace(ROBOT.tubes[0], sections=(replace(ROBOT.tubes[0].sections[0], length_m=x),))], [], []
    ).solve([0], [0]),
    "robot file": lambda x: load_robot(x),
    "scenario file": lambda x: load_scenario(x),
    "measurements": lambda x: load_measurements(x, ROBOT),
    "content": lambda x: robot_from_dict(x),
}
OPTIONAL: dict[str, Call] = {  # what may be None
    "options": lambda x: ROBOT.history(options=x),
    "progress": lambda x: ROBOT.bound_many([AT[0]], [AT[1]], progress=x),
    "executor": lambda x: ROBOT.bound_many([AT[0]], [AT[1]], executor=x),
    "field": lambda x: ROBOT.mechanics.check_path([AT[0]], [AT[1]], x),
    "density": lambda x: ROBOT.mechanics.check_path([AT[0]], [AT[1]], density=x),
    "time_s": lambda x: ctrplan.plan(SCENARIO, time_s=x),
    "interrupted": lambda x: ctrplan.plan(SCENARIO, interrupted=x),
    "weighting": lambda x: calibrate(pair_robot(), DATA, weighting=x),
    "priors": lambda x: calibrate(pair_robot(), DATA, priors={"tube.1.poisson_ratio": x}),
}
HARMLESS = {("start", "[]"), ("parameters", "[]"), ("bodies", "True"), ("content", "{}"), ("threads", "[]")}


def refused(call: Call, value: Any) -> str:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(CtrplanError) as caught:
            call(value)
    sentence = str(caught.value)
    assert isinstance(caught.value, InputError) and sentence.isprintable() and len(sentence) < 1000
    return sentence


@pytest.mark.parametrize("name", sorted(ARRAYS))
def test_no_array_of_another_kind_is_taken_or_ends_in_a_bare_error(name: str) -> None:
    for value in WRONG_ARRAYS:
        if name in OF_ROWS and isinstance(value, np.ndarray) and value.dtype == bool:
            continue  # among rows of numbers they are numbers to numpy
        refused(ARRAYS[name], value)


@pytest.mark.parametrize("name", sorted(SCALARS | OPTIONAL))
def test_no_argument_of_another_kind_is_taken_or_ends_in_a_bare_error(name: str) -> None:
    for value in WRONG:
        if (name, str(value)) in HARMLESS or (value is None and name in OPTIONAL):
            continue
        refused((SCALARS | OPTIONAL)[name], value)


def test_an_executor_that_was_shut_down_is_refused() -> None:
    with ThreadPoolExecutor(1) as executor:
        pass
    assert "takes no tasks" in refused(lambda x: ROBOT.bound_many([AT[0]], [AT[1]], executor=x), executor)


@pytest.mark.parametrize(
    "header", ["theta_" + "1" * 5000 + "_rad", "theta_" + "0" * 5000 + "_rad", "l_" + "9" * 5000 + "_m"]
)
def test_a_column_of_thousands_of_digits_is_refused(header: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{header},x\n0,0\n")
    refused(lambda path: load_measurements(path, ROBOT), tmp_path / "a.csv")


@pytest.mark.parametrize("text", ["1_0", "١", "0x1", "1e400"])
def test_a_cell_of_a_table_is_a_number_in_plain_digits(text: str, tmp_path: Path) -> None:
    robot = pair_robot()
    write_csv(tmp_path / "a.csv", DATA)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    (tmp_path / "a.csv").write_text(
        "\n".join([*lines[:3], ",".join(["0", text, *lines[3].split(",")[2:]]), *lines[4:]])
    )
    assert "row 3, time_s" in refused(lambda path: load_measurements(path, robot), tmp_path / "a.csv")


@pytest.mark.parametrize("closed", ["stdout", "stderr", "stdin"])
def test_a_standard_stream_that_is_closed_is_no_place_for_anything_else(closed: str, tmp_path: Path) -> None:
    """The sentence where the result is lost; and the next file that is opened does not take the stream's place."""
    write_robot(tmp_path / "pair.toml", pair_robot().content)
    redirect = {"stdout": ">&-", "stderr": "2>&-", "stdin": "<&-"}[closed]
    arguments = f"-m ctrplan bound {tmp_path / 'pair.toml'} --theta-deg 0 60 --l-mm 0 -17"
    done = subprocess.run(
        ["bash", "-c", f"exec {sys.executable} {arguments} {redirect}"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert "Traceback" not in done.stderr
    if closed == "stdout":
        assert done.returncode == 1
        assert done.stderr == "ctrplan: could not print the result: standard output is closed.\n"
    else:
        assert done.returncode == 0 and "worst-case friction error" in done.stdout and not done.stderr


@pytest.mark.parametrize("name", ["x" * 300, "new/" + "x" * 300, "a\0b", "x" * 5000])
def test_a_place_for_results_that_cannot_be_is_refused(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    code, lines = run(capsys, "plan", str(SCENARIO_FILE), "-o", name, "--time", "0.2")
    assert_refused(code, lines)
    assert lines[0].startswith("ctrplan: --output = 'x") or name[0] != "x"
    assert not list(tmp_path.iterdir())


COMMANDS_OF_A_FILE = ["plan", "bound", "ik", "simulate", "study", "design", "field", "diagnose", "view", "calibrate"]


@pytest.mark.parametrize("command", COMMANDS_OF_A_FILE)
def test_an_input_file_of_an_impossible_name_is_refused(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    rest = {
        **{"bound": ["--theta-deg", "0", "--l-mm", "0"], "ik": ["--tip-mm", "0", "0", "0"], "simulate": ["a.csv"]},
        **{"diagnose": ["a.csv"], "calibrate": ["a.csv"]},
    }
    for name in ("x" * 300, "a\0b"):
        assert_refused(*run(capsys, command, name, *rest.get(command, [])))
