"""Studies on dask: a cluster of this machine, and one whose scheduler and workers were started by hand."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from here import Here
from places import ROBOTS

from ctrplan.__main__ import main
from ctrplan.errors import InputError
from ctrplan.studies.study import engine_dask
from ctrplan.studies.study.engine import VersionError, do_tasks
from ctrplan.studies.study.study import Doing, Study
from ctrplan.studies.study.table import load_study
from ctrplan.studies.study.task import Job

pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="dask is not installed")

PAIR = str(ROBOTS / "table_5_pair.toml")
SLOW = """
import time

def slowly(scenario, inputs, seed):
    time.sleep(0.1)
    return {"pressed": seed ** 2}
"""


def slow_study(folder: Path) -> Study:
    """40 tasks of a tenth of a second."""
    (folder / "slow.py").write_text(SLOW, encoding="utf-8")
    seeds = {"key": "seed", "values": list(range(40))}
    task = {"kind": "function", "function": "slow:slowly"}
    return Study.of({"robot": PAIR, "task": task, "vary": [seeds]}, folder)


@pytest.fixture
def started() -> Iterator[Any]:
    """started(program, arguments) -> process of dask; all are ended afterwards."""
    with ExitStack() as stack:

        def start(*arguments: str) -> Any:
            command = [sys.executable, "-m", *arguments]
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        yield start


def test_a_worker_is_killed_and_another_joins_late(started: Any, tmp_path: Path) -> None:
    file = tmp_path / "scheduler.json"
    started("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
            "--scheduler-file", str(file))  # fmt: skip

    def worker() -> Any:
        return started("distributed.cli.dask_worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-nanny",
                       "--no-dashboard", "--local-directory", str(tmp_path / "dask"))  # fmt: skip

    workers = [worker(), worker()]
    late: list[Any] = []
    notes: set[str] = set()

    def watch(doing: Doing) -> None:
        notes.add(doing.note)
        if doing.stage == "tasks" and doing.done >= 6 and not late:
            late.append(worker())
            workers[0].kill()

    until = time.monotonic() + 30
    while not file.exists() and time.monotonic() < until:
        time.sleep(0.05)
    table = slow_study(tmp_path).run(tmp_path / "out", scheduler_file=str(file), progress=watch)
    assert late and table.done.all() and notes == {""}  # a scheduler without a dashboard has none to be watched
    assert table["pressed"].tolist() == [seed**2 for seed in range(40)]


def test_the_command_on_a_cluster_of_this_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    script = ModuleType("__main__")  # one without a guard: workers that ran it again would end at once
    script.__file__ = str(tmp_path / "script.py")
    (tmp_path / "script.py").write_text("raise SystemExit(3)\n", encoding="utf-8")
    monkeypatch.setitem(sys.modules, "__main__", script)
    file = tmp_path / "study.toml"
    file.write_text(
        f'robot = "{PAIR}"\ntask = {{kind = "bound", theta_deg = [0, 90], l_mm = [0, -60.4]}}\n'
        '[[vary]]\nkey = "theta_2"\nlow = 0\nhigh = 180\ncount = 9\n',
        encoding="utf-8",
    )
    assert main(["study", str(file), "-o", str(tmp_path / "out"), "--workers", "1", "--quiet"]) == 0
    assert sys.modules["__main__"] is script
    said = capsys.readouterr()
    assert "9 of 9 tasks, 9 of them done now" in said.out and "results.parquet" in said.out
    assert "9 tasks (bound), about" in said.err
    assert ("can be watched at http" in said.err) == (find_spec("bokeh") is not None)
    table = load_study(tmp_path / "out")
    assert (tmp_path / "out" / "report.html").is_file() and table.done.all()
    alone = Study.read(file).run(tmp_path / "pool", executor=Here())
    assert alone.results == table.results


def test_no_scheduler_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_dask, "CONNECT_S", 0.3)
    with pytest.raises(InputError, match=r"--scheduler = 'tcp://127.0.0.1:9': no scheduler answered within 0.3 s"):
        slow_study(tmp_path).run(tmp_path / "out", scheduler="tcp://127.0.0.1:9")
    with pytest.raises(InputError, match="--scheduler-file"):
        slow_study(tmp_path).run(tmp_path / "out", scheduler_file=str(tmp_path / "none.json"))


@pytest.mark.parametrize("answers", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_what_listens_there_is_no_scheduler(answers: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_dask, "CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:

        def answer() -> None:  # as a web server does, or nothing at all
            with suppress(OSError):
                while True:
                    client = stack.enter_context(server.accept()[0])
                    client.sendall(answers)

        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(
            InputError, match=r"--scheduler = 'tcp://127.0.0.1:\d+': no scheduler answered within 0.5 s"
        ):
            slow_study(tmp_path).run(tmp_path / "out", scheduler=address)
        (tmp_path / "scheduler.json").write_text('{"id": "no address"}', encoding="utf-8")
        with pytest.raises(InputError, match="--scheduler-file"):
            slow_study(tmp_path).run(tmp_path / "out", scheduler_file=str(tmp_path / "scheduler.json"))


def test_without_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine_dask, "is_installed", lambda: False)
    with pytest.raises(InputError, match=r"a cluster needs dask.distributed: pip install 'ctrplan\[cluster\]'"):
        slow_study(tmp_path).run(tmp_path / "out", scheduler="tcp://127.0.0.1:9")


def test_another_version_is_refused_with_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pickle
    from dataclasses import replace

    study = slow_study(tmp_path)
    theirs: Job = replace(study.job, version="7.8.9")
    with pytest.raises(VersionError, match=r"has ctrplan .*, the study is run by 7\.8\.9"):
        do_tasks(pickle.dumps(theirs), [study.tasks[0]])
    monkeypatch.setattr("ctrplan.studies.study.study_definition.StudyDefinition.content", pickle.dumps(theirs))
    with pytest.raises(VersionError, match=r"7\.8\.9"):
        study.run(tmp_path / "out", executor=Here())
