"""Hidden names under which results are made: removed when their writer is gone, however it went, and never before."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from checksums import unmatched

from ctrplan.storage.output_folder import NAME, remove_abandoned, temporary, write_atomically, written_together

HOLDER = """
import sys
from pathlib import Path
from ctrplan.storage.output_folder import temporary
with temporary(Path(sys.argv[1]), getattr(Path, sys.argv[2])):
    print("made", flush=True)
    sys.stdin.read()
"""


def holder(folder: Path, kind: str) -> subprocess.Popen[str]:
    """A process that is making something in the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder), kind], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "made\n"
    return process


def write(folder: Path, text: str) -> None:
    """A set of two files, as commands write them."""
    with written_together(folder, "ab") as made:
        for name in "ab":
            write_atomically(made / name, text)


@pytest.mark.parametrize("kind", ["mkdir", "touch"])
def test_what_a_killed_process_left_goes_with_the_next_run_and_what_a_live_one_makes_stays(
    kind: str, tmp_path: Path
) -> None:
    killed, alive = holder(tmp_path, kind), holder(tmp_path, kind)
    assert len(list(tmp_path.iterdir())) == 2
    killed.kill()
    killed.wait()
    write(tmp_path, "new")
    (left,) = (path for path in tmp_path.iterdir() if NAME.fullmatch(path.name))
    alive.communicate()
    assert alive.returncode == 0 and not left.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b", "SHA256SUMS"}


def test_writing_one_file_clears_up_too_and_takes_nothing_else(tmp_path: Path) -> None:
    left = tmp_path / f".ctrplan-{'0' * 16}.tmp"
    left.mkdir()
    (left / "half").write_text("a plan")
    target = tmp_path / "elsewhere"
    target.mkdir()
    link, pipe = tmp_path / f".ctrplan-{'1' * 16}.tmp", tmp_path / f".ctrplan-{'2' * 16}.tmp"
    link.symlink_to(target)
    os.mkfifo(pipe)
    (tmp_path / ".ctrplan-notes").write_text("mine")
    write_atomically(tmp_path / "plan.json", "new")
    assert not left.exists() and target.exists()
    assert (tmp_path / ".ctrplan-notes").read_text() == "mine"


def test_many_writers_in_one_folder_never_take_each_others_unfinished_files(tmp_path: Path) -> None:
    """Each removes what it takes for abandoned a thousand times, in every moment of the others' writing."""
    faults: list[BaseException] = []

    def repeat(action: Callable[[], None], times: int) -> None:
        try:
            for _ in range(times):
                action()
        except BaseException as fault:
            faults.append(fault)

    work = [(lambda: write(tmp_path, "text"), 30)] * 3 + [(lambda: remove_abandoned(tmp_path), 1000)] * 2
    threads = [threading.Thread(target=repeat, args=each) for each in work]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults
    assert not unmatched(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b", "SHA256SUMS"}


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch])
def test_a_name_that_is_taken_away_before_it_is_held_is_made_again(
    make: Callable[[Path], None], tmp_path: Path
) -> None:
    made: list[Path] = []

    def slowly(path: Path) -> None:
        make(path)
        made.append(path)
        if len(made) < 3:
            remove_abandoned(tmp_path)  # another process, in the moment before the lock

    with temporary(tmp_path, slowly) as path:
        assert path == made[2] and path.exists()
    assert not list(tmp_path.iterdir())


def test_without_locks_results_are_written_and_nothing_is_taken_for_abandoned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = tmp_path / f".ctrplan-{'0' * 16}.tmp"
    left.mkdir()

    def unsupported(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", unsupported)
    write(tmp_path, "new")
    assert {path.name for path in tmp_path.iterdir()} == {"a", "b", "SHA256SUMS", left.name}
