"""Interrupted, killed, out of room, shared and damaged: old outputs stay, exit codes are right, caches are rebuilt."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from checksums import unmatched
from interruptible import INTERRUPTIBLE
from made_up_input import FUZZ, repetitions
from measured_data import measured, pair_robot, waypoints, write_csv
from places import SCENARIOS
from small_scenarios import NEAR

from ctrplan.__main__ import main
from ctrplan.anatomy.clearance_grid import SignedDistanceField
from ctrplan.diagnosis import diagnose
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot, write_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.friction import FrictionLaw
from ctrplan.robot.friction_calibration import friction_law
from ctrplan.scenario.scenario import anatomy_grid
from ctrplan.storage.output_folder import written_together

THREE = str(SCENARIOS / "robots" / "three_tube.toml")
PAIR = str(SCENARIOS / "robots" / "table_1_pair.toml")
OUTPUTS = {
    "plan": {"SHA256SUMS", "inputs.zip", "plan.json", "plan.png", "report.html", "trajectory.csv", "trajectory.yaml"},
    "diagnose": {"SHA256SUMS", "diagnosis.json", "report.html", "robot.toml"},
}
PLAN = f'plan "{SCENARIOS / "pair_free.toml"}" --set planner.time_s=0.2 --set "{NEAR}"'  # as a shell reads it
PATIENCE_S = 120  # on a busy machine; a process that ignores Ctrl-C would take far longer


@pytest.fixture(scope="module")
def measurements(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """A robot file and measurements of that robot, which take a while to diagnose."""
    folder = tmp_path_factory.mktemp("measured")
    robot = pair_robot(contact=[{"friction_coefficient": 0.2}])
    write_robot(folder / "robot.toml", dict(robot.content))
    write_csv(folder / "measurements.csv", measured(robot, waypoints(robot, 20)))
    return str(folder / "robot.toml"), str(folder / "measurements.csv")


@pytest.fixture
def commands(measurements: tuple[str, str]) -> dict[str, list[str]]:
    return {
        "plan": ["plan", str(SCENARIOS / "pair_free.toml"), "--time", "60"],
        "diagnose": ["diagnose", *measurements],
    }


def started(arguments: list[str], folder: Path, cache: Path | None = None) -> subprocess.Popen[str]:
    """The command in a process of its own, writing into folder / out."""
    return subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, *arguments, "-o", str(folder / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=folder,
        text=True,
        env={**os.environ, "CTRPLAN_CACHE_DIR": str(cache or folder / "cache")},
    )


def wait_until_up(process: subprocess.Popen[str]) -> None:
    """Until everything is imported that no Ctrl-C can be caught in."""
    assert process.stdout is not None and process.stdout.readline() == "up\n"


def readable(folder: Path) -> set[str]:
    """Names of the results there are, of one set, each of which can be read; nothing hidden is left beside them."""
    if not folder.exists() or not any(folder.iterdir()):
        return set()
    assert not unmatched(folder)
    for path in folder.iterdir():
        assert not path.name.startswith(".ctrplan-"), f"{path.name} was left behind"
        content = path.read_bytes()
        assert content
        if path.suffix == ".json":
            json.loads(content)
        if path.suffix == ".html":
            assert content.rstrip().endswith(b"</html>")
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("command", ["plan", "diagnose"])
def test_ctrl_c_at_any_moment_ends_with_130_and_whole_files(
    command: str, commands: dict[str, list[str]], tmp_path: Path
) -> None:
    moments = random.Random(command)
    for attempt in range(repetitions(1)):
        folder = tmp_path / str(attempt)
        folder.mkdir()
        process = started(commands[command], folder)
        wait_until_up(process)
        time.sleep(moments.uniform(0.0, 6.0 if FUZZ else 2.0))
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in err, err
        assert process.returncode in (0, 130), err  # 0: it was done before
        written = readable(folder / "out")
        assert written == OUTPUTS[command] or (process.returncode == 130 and not written)
        assert not list(folder.rglob(".ctrplan-*"))
        shutil.rmtree(folder)


WRITER = """
import sys
from pathlib import Path
from ctrplan.storage.output_folder import written_together
from ctrplan.storage.output_folder import write_atomically
names = ["a", "b", "c"]
for version in range(10**6):
    with written_together(Path(sys.argv[1]), names) as made:
        for name in names:
            write_atomically(made / name, f"{version:08d}" * 50_000)
    if not version:
        print("written", flush=True)
"""


def test_killed_while_writing_leaves_old_or_new_files_whole_and_tells_them_apart(tmp_path: Path) -> None:
    moments = random.Random(0)
    for attempt in range(repetitions(3)):
        folder = tmp_path / str(attempt)
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdout.readline() == "written\n"
        time.sleep(moments.uniform(0.0, 0.1))
        process.kill()
        process.communicate()
        contents = [(folder / name).read_text() for name in "abc"]
        assert all(content == content[:8] * 50_000 for content in contents)
        if len(set(contents)) > 1:
            assert unmatched(folder)
        with written_together(folder, "abc") as made:  # the next run
            for name in "abc":
                (made / name).write_text("new")
        assert {path.name for path in folder.iterdir()} == {"a", "b", "c", "SHA256SUMS"}


@pytest.mark.parametrize("renamed", range(5))
def test_a_set_is_whole_or_does_not_match_its_checksums(
    renamed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped after each of the renames that put four files, the checksums among them, in the place of older ones."""
    replace, left = os.replace, renamed

    def write(text: str) -> None:
        with written_together(tmp_path, "abc") as made:
            for name in "abc":
                (made / name).write_text(text)

    def stopping(source: Path, target: Path) -> None:
        nonlocal left
        if Path(target).parent == tmp_path:
            if not left:
                raise KeyboardInterrupt
            left -= 1
        replace(source, target)

    write("old")
    monkeypatch.setattr(os, "replace", stopping)
    if renamed < 4:
        with pytest.raises(KeyboardInterrupt):
            write("new")
    else:
        write("new")
    texts = [(tmp_path / name).read_text() for name in "abc"]
    assert texts == ["new"] * min(renamed, 3) + ["old"] * (3 - min(renamed, 3))
    assert unmatched(tmp_path) == (() if renamed == 4 else tuple("abc"[:renamed]))
    check = subprocess.run(["sha256sum", "--check", "--status", "SHA256SUMS"], cwd=tmp_path)
    assert (check.returncode == 0) == (renamed in (0, 4))


def in_a_small_world(
    tmp_path: Path, options: str, arguments: str, after: str = "true"
) -> subprocess.CompletedProcess[str]:
    """A command with a small disk at tmp_path / disk, in a mount namespace of its own."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = f"mount -t tmpfs -o size=200k none '{disk}' && echo old > '{disk}/plan.json'"
    script = f"{mount} && mount -o remount,{options} '{disk}' && '{sys.executable}' -m ctrplan {arguments}; "
    script += f"echo exit $?; ls -A '{disk}'; cat '{disk}/plan.json'; {after}"
    environment = {**os.environ, "CTRPLAN_CACHE_DIR": str(disk / "cache"), "MPLCONFIGDIR": str(tmp_path / "matplotlib")}
    return subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True, env=environment)


def lets_users_mount() -> bool:
    """Whether this machine, a container perhaps, lets a process mount a disk that only it sees."""
    command = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs none /mnt"]
    return shutil.which("unshare") is not None and subprocess.run(command, capture_output=True).returncode == 0


needs_namespaces = pytest.mark.skipif(not lets_users_mount(), reason="users may not mount a small disk here")


def test_files_that_may_not_grow_leave_the_old_plan_and_nothing_else(tmp_path: Path) -> None:
    """No file may be longer than 200 blocks, which stands for a full disk wherever there is a shell."""
    folder = tmp_path / "disk"
    folder.mkdir()
    (folder / "plan.json").write_text("old")
    arguments = f"{PLAN} -o '{folder}'"
    command = f"ulimit -f 200; '{sys.executable}' -m ctrplan {arguments}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "File too large" in done.stderr and "Traceback" not in done.stderr
    assert [path.name for path in folder.iterdir()] == ["plan.json"]
    assert (folder / "plan.json").read_text() == "old"


@needs_namespaces
def test_a_full_disk_leaves_the_old_plan_and_nothing_else(tmp_path: Path) -> None:
    arguments = f"{PLAN} -o '{tmp_path / 'disk'}'"
    done = in_a_small_world(tmp_path, "rw", arguments)
    assert done.stdout.split() == ["exit", "1", "cache", "plan.json", "old"], done.stdout + done.stderr
    assert "No space left on device" in done.stderr and "Traceback" not in done.stderr


@needs_namespaces
def test_a_read_only_disk_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    arguments = f"plan '{SCENARIOS / 'pair_free.toml'}' --time 1000 -o '{tmp_path / 'disk'}'"
    done = in_a_small_world(tmp_path, "ro", arguments)
    assert done.stdout.split() == ["exit", "2", "plan.json", "old"], done.stdout + done.stderr
    assert "is not writable" in done.stderr and "Traceback" not in done.stderr


@needs_namespaces
@pytest.mark.parametrize("options", ["ro", "size=8k"] if FUZZ else ["ro"])
def test_a_cache_without_room_or_permission_is_no_error_to_those_who_only_use_it(options: str, tmp_path: Path) -> None:
    arguments = f"{PLAN} --no-report -o '{tmp_path / 'out'}'"
    done = in_a_small_world(tmp_path, options, arguments)
    assert "exit 0\n" in done.stdout and not done.stderr, done.stderr
    assert ".ctrplan-" not in done.stdout and (tmp_path / "out" / "plan.json").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="has no /dev/full")
def test_results_that_can_not_be_printed_are_reported() -> None:
    command = [sys.executable, "-m", "ctrplan", "bound", PAIR, "--theta-deg", "0", "90", "--l-mm", "0", "-17"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1 and "could not print the result: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


def test_two_processes_share_a_cache(tmp_path: Path) -> None:
    for attempt in range(repetitions(1)):
        cache = tmp_path / f"cache {attempt}"
        sphere = 'anatomy=[{kind="sphere", center_mm=[0, 60, 210], radius_mm=10}]'
        given = ["--set", sphere, "--set", NEAR, "--time", "0.2", "--quiet", "--formats", "csv", "--no-report"]
        plan = ["plan", str(SCENARIOS / "pair_free.toml"), *given]
        pair = [started(plan, folder, cache) for folder in (tmp_path / "a", tmp_path / "b") if not folder.mkdir()]
        told = [process.communicate(timeout=PATIENCE_S) for process in pair]
        assert [process.returncode for process in pair] == [0, 0], told
        assert all(not err for _, err in told)
        kept = [path for path in cache.rglob("*") if path.is_file()]
        assert {path.suffix for path in kept} == {".grid", ".json"}
        assert not [path for path in kept if path.name.startswith(".")]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SignedDistanceField, FrictionLaw]:
    """A cache with the vessel's grid and the pair's friction law, and both."""
    folder = tmp_path_factory.mktemp("kept")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CTRPLAN_CACHE_DIR", str(folder))
        grid = anatomy_grid(load_scenario(SCENARIOS / "vessel.toml"))
        assert grid is not None
        return folder, grid, friction_law(load_robot(PAIR))


@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "folder"])
def test_a_damaged_clearance_grid_is_rebuilt_with_a_note(
    damage: str,
    kept: tuple[Path, SignedDistanceField, FrictionLaw],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    shutil.copytree(kept[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    first = kept[1]
    stored = min(path for path in tmp_path.rglob("*.grid") if path.is_file())
    content = bytearray(stored.read_bytes())
    if damage == "truncated":
        content = content[: len(content) // 2]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    elif damage == "empty":
        content.clear()
    stored.write_bytes(content)
    if damage == "folder":
        stored.unlink()
        stored.mkdir()
    again = anatomy_grid(load_scenario(SCENARIOS / "vessel.toml"))
    assert again is not None
    np.testing.assert_array_equal(first.values_m, again.values_m)
    if damage != "folder":
        assert "damaged and will be rebuilt" in caplog.text
        assert stored.is_file()


@pytest.mark.parametrize("damage", ["digit", "truncated", "list", "number", "nan"])
def test_a_damaged_friction_law_is_calibrated_again_with_a_note(
    damage: str,
    kept: tuple[Path, SignedDistanceField, FrictionLaw],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    shutil.copytree(kept[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.setenv("CTRPLAN_CACHE_DIR", str(tmp_path))
    first = kept[2]
    (stored,) = (path for path in tmp_path.rglob("*") if path.is_file() and path.suffix != ".grid")
    text = stored.read_text()
    place = text.index("loading_rad")
    digit = next(k for k in range(place, len(text)) if text[k] in "123456789")
    damaged = {
        "digit": text[:digit] + str(int(text[digit]) % 9 + 1) + text[digit + 1 :],
        "truncated": text[: len(text) // 2],
        "list": "[]",
        "number": "7",
        "nan": text[:digit] + "NaN" + text[digit + 1 :].lstrip("0123456789."),
    }
    stored.write_text(damaged[damage])
    again = friction_law(load_robot(PAIR))
    np.testing.assert_array_equal(first.loading_rad, again.loading_rad)
    assert "damaged and will be" in caplog.text
    assert stored.read_text() == text


def test_a_clock_that_goes_backwards_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Searches go by the monotonic clock; the wall clock, set back a year at every look, is not asked."""
    clock = iter(range(10**9, 0, -31_536_000 // 100))
    monkeypatch.setattr(time, "time", lambda: float(next(clock)))
    assert main(["plan", str(SCENARIOS / "pair_free.toml"), "--time", "0.2", "--set", NEAR, "-o", str(tmp_path)]) == 0
    assert readable(tmp_path) == OUTPUTS["plan"]


def test_a_diagnosis_interrupted_from_the_start_says_so(measurements: tuple[str, str]) -> None:
    robot, event = load_robot(measurements[0]), threading.Event()
    event.set()
    found = diagnose(robot, load_measurements(measurements[1], robot), interrupted=event)
    assert found.interrupted and found.verdict == "unexplained" and any("Interrupted" in note for note in found.notes)
