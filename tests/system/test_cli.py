"""The command line as a person meets it: outputs, exit codes, one sentence for every failure."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tomli_w
import yaml
from csv_columns import csv_columns
from interruptible import INTERRUPTIBLE
from jsonschema import Draft202012Validator
from places import ROBOTS, SCENARIOS
from small_scenarios import NEAR

import ctrplan
from ctrplan.__main__ import main
from ctrplan.base.arguments import SEARCH_TIME, SEED
from ctrplan.commands import terminal
from ctrplan.commands.terminal import ProgressBar
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning.search.stage_search import Progress
from ctrplan.storage.output_folder import output_folder

SCHEMA = SCENARIOS.parent / "docs" / "plan.schema.json"
ROBOT = str(SCENARIOS / "robots" / "three_tube.toml")
REST = {"rotate outer": 0, "rotate inner": 0, "translate inner": -30}  # where the pair in free space starts
AWAY = {"rotate outer": 5, "rotate inner": 10, "translate inner": -27}


def test_plan_writes_everything_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(tmp_path)]
    arguments += ["--set", "planner.time_s=0.2", "--set", NEAR]
    assert main(arguments) == 0
    assert {p.name for p in tmp_path.iterdir()} == {
        "SHA256SUMS",
        "plan.json",
        "trajectory.csv",
        "trajectory.yaml",
        "report.html",
        "plan.png",
        "inputs.zip",
    }
    content = json.loads((tmp_path / "plan.json").read_text())
    assert content["certificate"]["valid"] is True
    columns = csv_columns(tmp_path / "trajectory.csv")
    assert columns["time_s"][0] == 0
    message = yaml.safe_load((tmp_path / "trajectory.yaml").read_text())
    assert len(message["points"]) == len(columns["time_s"])
    assert (tmp_path / "plan.png").read_bytes()[:4] == b"\x89PNG"
    assert "worst-case friction error" in capsys.readouterr().out


@pytest.mark.parametrize("targets", [[REST], [REST, AWAY, AWAY, REST]])
def test_targets_reached_already_are_planned_and_written(targets: list[dict[str, float]], tmp_path: Path) -> None:
    robot = SCENARIOS / "robots" / "table_5_pair.toml"
    content = {"robot": str(robot), "start": REST, "target": [{"joints": goal} for goal in targets]}
    (tmp_path / "case.toml").write_text(tomli_w.dumps({**content, "planner": {"time_s": 0.2}}))
    bare = ["--formats", "csv", "--no-report"]
    written = [] if len(targets) == 1 else bare  # of no motion at all every page and picture
    given = ["plan", str(tmp_path / "case.toml"), "-o", str(tmp_path / "out"), "--allow-outside", *written]
    assert main(given) == 0
    content = json.loads((tmp_path / "out" / "plan.json").read_text())
    Draft202012Validator(json.loads(SCHEMA.read_text())).validate(content)
    legs, reached = content["legs"], [target["leg"] for target in content["certificate"]["targets"]]
    assert reached[-1] == len(legs) - 1 and content["certificate"]["stops"] == content["trajectory"]["stops"]
    for goal, k in zip(targets, reached, strict=True):
        end = {name: values.get("deg", values.get("mm")) for name, values in legs[k]["end"].items()}
        assert end == pytest.approx(goal)


def test_the_search_says_how_long_and_which_seeds(capsys: pytest.CaptureFixture[str]) -> None:
    """The command line and Python read them by the same rules."""
    scenario = load_scenario(SCENARIOS / "pair_free.toml")
    for option, argument, value, kind in (("--time", "time_s", 3601.0, SEARCH_TIME), ("--seed", "seed", -1, SEED)):
        assert main(["plan", str(SCENARIOS / "pair_free.toml"), option, str(value)]) == 2
        with pytest.raises(InputError) as caught:
            ctrplan.plan(scenario, **{argument: value})
        assert caught.value.rule == kind.rule and kind.rule in capsys.readouterr().err


def test_bound_prints_the_bound(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["bound", ROBOT, "--theta-deg", "0", "90", "180", "--l-mm", "0", "-17", "-62.8"]
    assert main(arguments) == 0
    assert "worst-case friction error of the tip: 17." in capsys.readouterr().out
    assert main([*arguments, "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["bound_position_mm"] == pytest.approx(
        17.81, abs=0.1
    )  # 17.81 mm from the tips of three_tube_points.json
    assert [corner["phi"] for corner in content["corners"]] == [[1, 1], [1, -1], [-1, 1], [-1, -1]]


def test_set_changes_the_robot(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["bound", ROBOT, "--theta-deg", "0", "90", "180", "--l-mm", "0", "-17", "-62.8", "--json"]
    bounds = []
    for mu in ("0.0", "0.1", "0.2"):
        main(
            [
                *arguments,
                "--set",
                f"contact.1.friction_coefficient={mu}",
                "--set",
                f"contact.2.friction_coefficient={mu}",
            ]
        )
        bounds.append(json.loads(capsys.readouterr().out)["bound_position_mm"])
    assert bounds[0] < 1e-3 < bounds[1] < bounds[2]


def test_what_a_failed_solve_leaves_is_json_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    """More than the robot resists: no solve converges."""
    at = ["--theta-deg", "0", "90", "143", "--l-mm", "0", "-17", "-62.8", "--accuracy", "search"]
    assert main(["bound", ROBOT, *at, "--set", "effects.tip_load.force_x_N=2", "--json"]) == 1
    content = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert content["bound_position_mm"] is None
    assert content["frictionless"]["status"] == "FAILED"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["plan", "nowhere.toml"], 2, ["nowhere.toml"]),
        (["plan", str(SCENARIOS / "ribs.toml"), "--time", "-1"], 2, ["--time", "-1", "above 0"]),
        (["plan", str(SCENARIOS / "ribs.toml"), "--set", "cost.pth=1"], 2, ["pth", "path"]),
        (["bound", ROBOT, "--theta-deg", "0", "0", "--l-mm", "0", "-17", "-40"], 2, ["--theta-deg", "3 values"]),
        (
            ["bound", ROBOT, "--theta-deg", "0", "0", "nan", "--l-mm", "0", "-17", "-40"],
            2,
            ["--theta-deg = nan deg", "a number"],
        ),
        (["bound", ROBOT, "--theta-deg", "0", "0", "0", "--l-mm", "0", "-17", "-20"], 2, ["--l-mm", "17 mm apart"]),
        (["plan", ""], 2, ["'': does not exist"]),
        (["plan", ROBOT], 2, [ROBOT, "tube: is a key of robot files"]),
        (
            ["diagnose", str(SCENARIOS / "ribs.toml"), "x.csv"],
            2,
            ["ribs.toml: robot = 'robots/three_tube.toml'", "of scenarios"],
        ),
        (["field", "robot.toml"], 2, ["field", "solves every bound"]),
        (["view", str(SCENARIOS / "ribs.toml"), "--set", "tube.2.poisson_ratio=0"], 2, ["robot.tube after --set"]),
        (["calibrate", ROBOT, "x.csv", "--seed", "-1"], 2, ["--seed = -1", "must be a whole number from 0"]),
        (["calibrate", ROBOT, "x.csv", "--held-out", "1"], 2, ["--held-out = 1.0", "must be a number from 0 to 0.99"]),
        (["diagnose", ROBOT, "x.csv", "--without", "sticktion"], 2, ["--without = 'sticktion'", "friction"]),
    ],
)
def test_failure_is_one_sentence(
    arguments: list[str], code: int, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if arguments[0] == "plan":
        arguments = [*arguments, "-o", str(tmp_path / "out")]
    assert main(arguments) == code
    message = capsys.readouterr().err
    assert message.startswith("ctrplan: ") and message.count("\n") == 1
    assert all(word in message for word in words), message
    assert not list(tmp_path.rglob("*.*"))


PAIR, PATH = str(SCENARIOS / "robots" / "table_1_pair.toml"), "path.csv"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["simulate", PAIR, PATH, "--slow", "contact.1.friction_coefficient=0.1"],
            "--slow = .*: goes with --measured o",
        ),
        (["simulate", PAIR, PATH, "--histories", "9"], "--histories = 9: goes with --measured only"),
        (["simulate", PAIR, PATH, "--offset-mm", "0"], "--offset-mm = 0.0: goes with --measured only"),
        (
            ["simulate", PAIR, PATH, "--measured", "--offset-steps", "5"],
            "--offset-steps = 5.0: goes with --offset-mm o",
        ),
        (["check", PAIR, "--robot", PAIR], "robot = .*table_1_pair.toml': goes with measurements only"),
        (["init", "scenario", "new.toml", "--robot", PAIR, "--unit", "cm"], "--unit = 'cm': goes with --mesh only"),
        (["view", PAIR, "--no-browser", "--frame", "RAS"], "--frame = 'RAS': goes with --igtl only"),
        (["render", "plan.json", "-o", "x.png", "--fps", "5"], "--fps = 5.0: goes with a film only"),
    ],
)
def test_an_option_that_would_say_nothing_is_refused(
    arguments: list[str],
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Once it was passed over: who forgot --measured got a simulation without an observer."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / PATH).write_text("theta_1_rad,theta_2_rad,l_1_m,l_2_m\n0,0,0,-0.017\n", encoding="utf-8")
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert re.match(f"ctrplan: {sentence}", said.err) and said.err.count("\n") == 1, said.err
    assert [file.name for file in tmp_path.iterdir()] == [PATH]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "ctrplan: the following arguments are required: COMMAND (see ctrplan --help).\n"),
        (["plna"], "ctrplan: COMMAND: invalid choice: 'plna', did you mean plan? (choose from "),
        (["plan"], "ctrplan: the following arguments are required: SCENARIO.toml (see ctrplan plan --help).\n"),
        (["plan", "x", "--time", "soon"], "ctrplan: --time = 'soon': must be a number above 0 and at most 3600.\n"),
        (
            ["plan", "x", "--seed", "1.5"],
            "ctrplan: --seed = '1.5': must be a whole number from 0 to 2147383647.\n",
        ),
        (["plan", "x", "--tiem", "3"], "ctrplan: --tiem 3: is not known here (see ctrplan plan --help).\n"),
        (["ik", "x", "--tip-mm", "1", "2"], "ctrplan: --tip-mm: expected 3 arguments (see ctrplan ik --help).\n"),
        (["plan", "x", "-o"], "ctrplan: --output: expected one argument (see ctrplan plan --help).\n"),
    ],
)
def test_a_command_that_is_not_understood_is_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    message = capsys.readouterr().err
    assert message.startswith(sentence) and message.count("\n") == 1


@pytest.mark.parametrize("translations", ["0 -17 -62.8", "0 -17e0 -6.28e+1", "-0.0 -1.7E1 -62.80"])
def test_negative_numbers_are_values_however_they_are_written(
    translations: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bound", ROBOT, "--theta-deg", "0", "90", "-.18e3", "--l-mm", *translations.split(), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bound_position_mm"] == pytest.approx(17.81, abs=0.1)  # as above
    assert main(["bound", ROBOT, "--theta-deg", "0", "90", "-inf", "--l-mm", *translations.split()]) == 2
    assert "--theta-deg" in capsys.readouterr().err


def test_output_that_is_a_file_is_refused_before_planning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "out").write_text("mine")
    assert main(["plan", str(SCENARIOS / "ribs.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "--output" in capsys.readouterr().err
    assert (tmp_path / "out").read_text() == "mine"


def test_all_outputs_or_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "report.html").mkdir()
    assert main(["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(tmp_path), "--time", "0.5"]) == 2
    assert "report.html" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("seconds", [0.01, 0.9])  # others, at random: test_running_faults.py
def test_ctrl_c_at_any_moment(tmp_path: Path, seconds: float) -> None:
    """Never a traceback: 130, and all files or none."""
    command = [sys.executable, "-c", INTERRUPTIBLE, "plan", str(SCENARIOS / "pair_free.toml"), "--time", "1"]
    command += ["-o", str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path, text=True)
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in err, err
    written = sorted(p.name for p in (tmp_path / "out").iterdir()) if (tmp_path / "out").exists() else []
    files = ["SHA256SUMS", "inputs.zip", "plan.json", "plan.png", "report.html", "trajectory.csv", "trajectory.yaml"]
    assert written in ([], files)


def test_ctrl_c_that_an_import_makes_another_error_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The initialisation of compiled modules may turn KeyboardInterrupt into ImportError: libigl's does."""

    def importing(_: object) -> int:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(10)
        except KeyboardInterrupt:
            raise ImportError("std::bad_cast") from None
        return 0

    monkeypatch.setattr("ctrplan.commands.bound.run", importing)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["bound", ROBOT, "--theta-deg", "0", "--l-mm", "0"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, previous)
    assert capsys.readouterr().err == "ctrplan: interrupted before there was a result.\n"


def test_ctrl_c_keeps_the_best_plan_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pressed as soon as there is a certified path, in a search that would go on for five minutes."""
    update, pressed = ProgressBar.update, False

    def pressing(bar: ProgressBar, progress: Progress) -> None:
        nonlocal pressed
        update(bar, progress)
        if progress.stage == "search" and progress.best_cost_mm is not None and not pressed:
            pressed = True
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ProgressBar, "update", pressing)
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(tmp_path), "--time", "300"]) == 130
    finally:
        signal.signal(signal.SIGINT, previous)
    content = json.loads((tmp_path / "plan.json").read_text())
    assert pressed and content["interrupted"] and content["certificate"]["valid"] is True


def test_ik_shows_ten_by_branch_and_says_how_many_more_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    said = ["ik", str(ROBOTS / "three_tube.toml"), "--tip-mm", "34", "-47", "200"]
    assert main(said) == 0
    told = capsys.readouterr()
    rows = [line for line in told.out.splitlines() if re.match(r"\s+\d+\s", line)]
    branches = [int(row.split()[0]) for row in rows]
    assert len(rows) == 10 and len(set(branches)) == 2, "the best of each branch is among them"
    worst = [float(row.split()[5]) for row in rows]
    for branch in set(branches):
        own = [w for w, b in zip(worst, branches, strict=True) if b == branch]
        assert own == sorted(own)
    more = re.search(r"^and (\d+) more: --all lists them", told.out, re.MULTILINE)
    assert more is not None and "next: " in told.out.splitlines()[-1]
    assert main([*said, "--all"]) == 0
    assert len([r for r in capsys.readouterr().out.splitlines() if re.match(r"\s+\d+\s", r)]) == 10 + int(more[1])


def test_corners_are_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    said = ["--theta-deg", "0", "180", "180", "--l-mm", "0", "-17", "-60"]
    assert main(["bound", str(ROBOTS / "three_tube.toml"), *said]) == 0
    told = capsys.readouterr().out
    assert [line.split("tip (")[0].strip() for line in told.splitlines()[2:6]] == [
        "corner + +", "corner + \u2212", "corner \u2212 +", "corner \u2212 \u2212",
    ]  # fmt: skip
    assert "phi" not in told


def test_progress_without_a_terminal_is_a_line_every_ten_seconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [100.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: clock[0])
    with terminal.ProgressBar() as bar:
        for second in range(31):
            clock[0] = 100.0 + second
            bar.show("search", second / 31, "best cost 3.1 mm")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"ctrplan: search {100 * s / 31:.0f} %, best cost 3.1 mm, {s} s" for s in (10, 20, 30)]
    with terminal.ProgressBar(quiet=True) as bar:
        clock[0] += 60
        bar.show("search", 0.5)
    assert capsys.readouterr().err == ""


def test_long_work_without_progress_says_what_it_does(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with terminal.telling("looking for shapes"):
        pass
    monkeypatch.setattr(terminal, "EVERY_S", 0.01)
    with terminal.telling("looking for shapes"):
        time.sleep(0.2)
    assert capsys.readouterr().err == "ctrplan: looking for shapes; Ctrl-C ends it\n"


@pytest.mark.parametrize(
    "command",
    [
        ["check", ROBOT],
        ["check", str(SCENARIOS / "pair_free.toml")],
        ["bound", ROBOT, "--theta-deg", "0", "0", "0", "--l-mm", "0", "-17", "-34"],
        [
            "place",
            str(SCENARIOS / "vessel.toml"),
            "--candidates",
            "4",
            "--confirm",
            "1",
            "--quiet",
            "-o",
            "{}/placed.toml",
        ],
        ["init", "robot", "{}/robot.toml"],
    ],
)
def test_a_command_ends_with_what_to_do_next(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([part.format(tmp_path) for part in command]) == 0
    assert "next: " in capsys.readouterr().out.splitlines()[-1]


def test_the_package_runs_as_a_module() -> None:
    arguments = [sys.executable, "-m", "ctrplan", "--version"]
    ran = subprocess.run(arguments, capture_output=True, text=True, check=True)
    assert ran.stdout.strip().endswith(ctrplan.__version__)
    wrong = subprocess.run([*arguments[:3], "check", "nowhere.toml"], capture_output=True, text=True)
    assert wrong.returncode == 2 and "nowhere.toml" in wrong.stderr and "Traceback" not in wrong.stderr


def test_names_in_another_encoding_are_refused_before_anything_is_done(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files unpacked from another system have such names: no file that we write could hold one."""
    latin = os.fsdecode("sz\u00fc.toml".encode("latin-1"))
    (tmp_path / latin).write_text((SCENARIOS / "pair_free.toml").read_text())
    own = str(tmp_path / "r.toml")
    for command in (
        ["plan", str(tmp_path / latin), "-o", str(tmp_path / "out")],
        ["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(tmp_path / latin[:3])],
        ["init", "robot", own, "--name", latin],
        ["init", "robot", str(tmp_path / f"new_{latin}")],
    ):
        assert main(command) == 2
        assert "is not UTF-8 text" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [latin]
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_scenario(tmp_path / latin)
    with pytest.raises(InputError, match="is not UTF-8 text"):
        output_folder(str(tmp_path / latin[:3]), ["plan.json"])
