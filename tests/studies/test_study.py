"""Studies: the same table whoever does the tasks, however often they are interrupted, and a row for whatever fails."""

from __future__ import annotations

import json
import os
import pickle
import time
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from here import Here
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.studies.study.engine import answer
from ctrplan.studies.study.store import Lines
from ctrplan.studies.study.study import Doing, Study, chunk_size, chunk_sizes
from ctrplan.studies.study.table import load_study
from ctrplan.studies.study.task import TaskNumbers

PAIR = str(ROBOTS / "table_5_pair.toml")
FRICTION = "contact.1.friction_coefficient"
BOUND = {"kind": "bound", "theta_deg": [0, 180], "l_mm": [0, -60.4]}


def bounds(**keys: Any) -> dict[str, Any]:
    """A study of 12 bounds."""
    vary = [
        {"key": FRICTION, "values": [0.1, 0.2, 0.3]},
        {"key": "theta_2", "low": 0, "high": 180, "count": 4},
    ]
    return {"robot": PAIR, "task": BOUND, "vary": vary, **keys}


def run(content: dict[str, Any], folder: Path, executor: Any = None, **options: Any) -> ctrplan.StudyTable:
    return Study.of(content, folder.parent).run(folder, executor=executor or Here(), **options)


def test_rows_are_those_of_a_loop(tmp_path: Path) -> None:
    table = run(bounds(), tmp_path / "out")
    expected = []
    for mu in (0.1, 0.2, 0.3):
        robot = ctrplan.load_robot(PAIR, [f"{FRICTION}={mu}"])
        for degrees in np.linspace(0, 180, 4):
            theta_b, l_b = robot.collars(np.radians([0, degrees]), np.array([0, -60.4e-3]))
            expected.append(robot.bound_many(theta_b[None], l_b[None]).position_m[0] * 1e3)
    assert table["bound_mm"].tolist() == expected  # to the last bit
    assert table[FRICTION].tolist() == sorted(table[FRICTION].tolist())
    assert table["index"].tolist() == list(range(12)) and table.done.all()


def test_tasks_that_are_sent_by_number_are_those_of_the_list(tmp_path: Path) -> None:
    study = Study.of(bounds(), tmp_path)
    sent, sizes, own = TaskNumbers.none(), (5, 4, 9), []
    for k in (*range(11, 0, -2), *range(0, 12, 2)):  # their places in the table are others than those in the list
        own.append(replace(study.tasks[k], index=100 - k))
        sent.add(k, 100 - k, bytes.fromhex(own[-1].key))
    chunks = [pickle.loads(pickle.dumps(chunk)) for chunk in sent.chunks(sizes)]
    assert [len(chunk) for chunk in chunks] == [5, 4, 3]
    assert [task for chunk in chunks for task in chunk.of(study.tasks)] == own
    gone: Future[Lines] = Future()
    gone.set_exception(RuntimeError("the machine is off"))
    lost = [json.loads(line) for line in answer(gone, study.content, chunks[0])]
    assert [(row["index"], row["inputs"], row["status"]) for row in lost] == [
        (task.index, task.inputs, "lost") for task in own[:5]
    ]


def test_processes_give_the_same_table(tmp_path: Path) -> None:
    from ctrplan.studies.child_process import ChildExecutor

    alone = run(bounds(), tmp_path / "alone")
    with ChildExecutor(2) as executor:
        beside = run(bounds(), tmp_path / "two", executor, workers=2)
    assert beside.results == alone.results
    assert all(worker != alone.columns["worker"][0] for worker in beside.columns["worker"])


def test_an_executor_that_is_left_at_once_waits_for_none() -> None:
    """Processes that were being started when it was left did their tasks to the end: nobody knew them yet."""
    from ctrplan.studies.child_process import ChildExecutor

    began = time.monotonic()
    with ChildExecutor(2) as executor:
        sleeping = [executor.submit(time.sleep, 40.0) for _ in range(4)]
    assert time.monotonic() - began < 20.0
    assert all(future.cancelled() or future.exception() is not None for future in sleeping)


def test_what_was_done_before_an_interruption_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "ctrplan.studies.study.study.SHARES", 4
    )  # four chunks of three, two of them handed out at a time
    folder = tmp_path / "out"
    first = run(bounds(), folder, Here(most=6), workers=1)
    assert 0 < len(first) < 12
    with open(folder / "rows.jsonl", "ab") as file:
        file.write(b'{"key": "0123')  # what a kill in the middle of a line leaves
    assert load_study(folder).results == first.results
    rest = Here()
    table = run(bounds(), folder, rest)
    assert rest.done == 12 - len(first)
    assert table.results == run(bounds(), tmp_path / "whole").results
    again = Here()
    assert run(bounds(), folder, again).results == table.results and again.done == 0


def test_a_study_is_enlarged_and_changed(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    small = run(bounds(), folder)
    larger = bounds()
    larger["vary"][0] = {"key": FRICTION, "values": [0.1, 0.4]}
    did = Here()
    table = run(larger, folder, did, add=True)
    assert did.done == 4 and len(table) == 16
    assert {name: values[:12] for name, values in table.results.items()} == small.results
    assert len(run(larger, folder)) == 16  # it is there already
    other = tmp_path / "robot.toml"
    other.write_text(Path(PAIR).read_text(encoding="utf-8"), encoding="utf-8")
    mine = bounds(robot=str(other))
    before = run(mine, tmp_path / "changed")
    other.write_text(f"# a comment\n{other.read_text(encoding='utf-8')}", encoding="utf-8")
    did = Here()
    assert run(mine, tmp_path / "changed", did).results == before.results and did.done == 0
    content = ctrplan.load_robot(PAIR, ["tube.1.poisson_ratio=0.2"]).content
    other.write_text(tomli_w.dumps(dict(content)), encoding="utf-8")
    did = Here()
    after = run(mine, tmp_path / "changed", did)
    assert did.done == 12 and not np.array_equal(after["bound_mm"], before["bound_mm"])


def test_what_a_study_varies_itself_may_change_in_the_file(tmp_path: Path) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(tomli_w.dumps(dict(ctrplan.load_robot(PAIR).content)), encoding="utf-8")
    run(bounds(robot="robot.toml"), tmp_path / "out")
    changed = dict(ctrplan.load_robot(PAIR, [f"{FRICTION}=0.77"]).content)
    robot.write_text(tomli_w.dumps(changed), encoding="utf-8")
    did = Here()
    run(bounds(robot="robot.toml"), tmp_path / "out", did)
    assert did.done == 0


def test_a_task_that_fails_is_a_row(tmp_path: Path) -> None:
    content = bounds()
    content["vary"][1] = {"key": "l_2", "values": [-60.4, 1000.0]}
    table = run(content, tmp_path / "out")
    assert table.columns["status"] == ["done", "refused"] * 3
    assert "1000" in table.columns["reason"][1] and np.isnan(table["bound_mm"][1])


FUNCTIONS = """
import os, time

def tip(scenario, inputs, seed, scale=1.0):
    return {"goal_z_mm": scale * float(scenario.goal.tip_m[2]) * 1e3, "seed": seed}

def badly(scenario, inputs, seed):
    print("this is no row")
    if seed == 0:
        return 7
    if seed == 1:
        raise ValueError("of mine")
    if seed == 2:
        while True:
            pass
    if seed == 3:
        os._exit(3)
    return {"a": [1, 2]}
"""


def test_functions_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(FUNCTIONS, encoding="utf-8")
    content = {
        "scenario": str(SCENARIOS / "vessel.toml"),
        "task": {"kind": "function", "function": "mine:tip", "options": {"scale": 2.0}},
        "targets": {"points_mm": [[51, 2, 168], [51, 2, 160]]},
    }
    assert run(content, tmp_path / "out")["goal_z_mm"].tolist() == [336.0, 320.0]
    content = {
        "robot": PAIR,
        "task": {"kind": "function", "function": "mine:badly", "time_limit_s": 1.0},
        "vary": [{"key": "seed", "values": [0, 1, 4, 2, 3]}],
    }
    table = run(content, tmp_path / "bad")
    assert table.columns["status"] == ["done", "failed", "refused", "timed out", "lost"]
    reasons = table.columns["reason"]
    assert table["value"][0] == 7 and "ValueError: of mine (line 12 of mine.py)" in reasons[1]
    assert "not list as 'a'" in reasons[2] and "1 s" in reasons[3] and "exit code 3" in reasons[4]
    did = Here()
    run(content, tmp_path / "bad", did)
    assert did.done == 1  # that of the process which ended; who took too long is not given the same time again


def test_keys_that_do_not_exist(tmp_path: Path) -> None:
    for vary, sentence in (
        ({"key": "contact.1.friction_coeficient", "values": [0.1]}, "did you mean friction_coefficient?"),
        ({"key": "task.acuracy", "values": ["search"]}, "did you mean task.accuracy?"),
        ({"key": "theta_2", "values": [0.0], "count": 3}, "must have one of values"),
        ({"key": "theta_2", "low": 3, "high": 1, "count": 3}, "must be below high"),
        ({"key": "robot", "files": ["*.nothing"]}, "names no file that exists"),
        ({"key": "theta_5", "values": [1.0]}, "theta_5: no such tube, they are counted from 1"),
        ({"key": "theta_2", "values": [1.0, "a"]}, "vary, values of theta_2 = 'a': must be numbers"),
    ):
        with pytest.raises(InputError, match=sentence.replace("?", r"\?")):
            Study.of(bounds(vary=[vary]), tmp_path)
    with pytest.raises(InputError, match="needs a scenario"):
        Study.of(bounds(task={"kind": "plan"}), tmp_path)
    with pytest.raises(InputError, match="must be one of"):
        Study.of(bounds(task={"kind": "bounds"}), tmp_path)
    with pytest.raises(InputError, match="task.function = 'mine': must be module:function"):
        Study.of(bounds(task={"kind": "function", "function": "mine"}, vary=[]), tmp_path)
    task = {"kind": "function", "function": "missing_module:f"}
    (reason,) = run(bounds(task=task, vary=[]), tmp_path / "out").columns["reason"]
    assert reason.startswith("missing_module: is neither missing_module.py beside the study nor installed")


def test_a_billion_tasks_are_refused_with_their_time(tmp_path: Path) -> None:
    vary = [{"key": f"theta_{k}", "low": 0, "high": 180, "count": 31623} for k in (1, 2)]
    study = Study.of(bounds(vary=vary), tmp_path)
    with pytest.raises(InputError, match=r"1,000,014,129 tasks would take about [\d.]+ days on 2 workers: --yes"):
        study.run(tmp_path / "out", workers=2)
    assert not (tmp_path / "out").exists()
    assert study.tasks[study.count - 1].inputs == {"theta_1": 180.0, "theta_2": 180.0}


def test_a_folder_belongs_to_one_process(tmp_path: Path) -> None:
    from ctrplan.studies.study.store import Store

    store = Store(tmp_path / "out")
    store.open_for_work()
    with pytest.raises(InputError, match="another process works on this folder"):
        run(bounds(), tmp_path / "out")
    store.close()
    assert len(run(bounds(), tmp_path / "out")) == 12


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, written = os.pwrite, [0]

    def full(descriptor: int, data: bytes, offset: int) -> int:
        written[0] += len(data)
        if written[0] > 3000:
            real(descriptor, data[: len(data) // 2], offset)
            raise OSError(28, "No space left on device")
        return real(descriptor, data, offset)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with pytest.raises(ctrplan.CtrplanError, match=r"rows.jsonl: could not be written: No space left on device"):
            run(bounds(), tmp_path / "out")
    kept = len(load_study(tmp_path / "out"))
    did = Here()
    table = run(bounds(), tmp_path / "out", did)
    assert 0 < kept < 12 and did.done == 12 - kept and table.done.all()


def test_the_table_in_its_file(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow.parquet")
    table = run(bounds(), tmp_path / "out")
    read = pyarrow.read_table(tmp_path / "out" / "results.parquet")
    assert read.to_pydict() == dict(table.columns)
    assert table.to_pandas()["bound_mm"].tolist() == table["bound_mm"].tolist()
    assert json.loads(table.columns["set"][0]) == [f"{FRICTION}=0.1"]
    assert pytest.importorskip("pyarrow").table(table).to_pydict() == dict(
        table.columns
    )  # as polars and DuckDB read it


def test_chunks_grow_with_the_cluster_and_leave_something_for_everybody() -> None:
    assert chunk_size(1e-3, 100_000, 2) == 1000 and chunk_size(1e-3, 10**7, 1000) == 2000
    assert chunk_size(1e-3, 100, 2) == 25 and chunk_size(9.0, 100, 2) == 1
    sizes = list(chunk_sizes(1e-3, 4000, 2))  # the last ones are short, so that both are done at about the same time
    assert sum(sizes) == 4000 and sizes[0] == 1000 and sizes[-2] == 50 and sizes == sorted(sizes, reverse=True)
    assert sum(chunk_sizes(1e-3, 100, 2)) == 100 and max(chunk_sizes(1e-3, 100, 2)) == 25
    for workers in (1, 50, 400, 1600):  # so many chunks a second the scheduler has to hand out, of 1,000 it can
        assert workers / (chunk_size(1e-3, 10**9, workers) * 1e-3) <= 500 + 1


def test_progress_says_what_is_left(tmp_path: Path) -> None:
    told: list[Doing] = []
    run(bounds(), tmp_path / "out", progress=told.append)
    tasks = [doing for doing in told if doing.stage == "tasks"]
    assert tasks[-1].done == tasks[-1].count == 12 and tasks[-1].left_s == 0
    assert all(a.done < b.done for a, b in zip(tasks, tasks[1:], strict=False))
