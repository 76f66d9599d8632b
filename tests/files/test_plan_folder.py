"""A plan's folder read back: the same plan, or one sentence."""

from __future__ import annotations

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import SCENARIOS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.trajectory_file import trajectory_formats, write_trajectory
from ctrplan.plans.plan import write_plan_json
from ctrplan.reports import plan_page

FREE = str(SCENARIOS / "pair_free.toml")
QUICK = ["planner.time_s=0.05", "robot.model_error_mm=0.5"]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[ctrplan.Plan, Path]:
    plan = ctrplan.plan(ctrplan.load_scenario(FREE, QUICK), seed=4)
    folder = tmp_path_factory.mktemp("plan")
    write(folder, plan)
    return plan, folder


def write(folder: Path, plan: ctrplan.Plan) -> None:
    """Those files of its folder that are read."""
    write_plan_json(folder / "plan.json", plan)
    write_trajectory(folder, plan.trajectory, trajectory_formats(["csv"]))


def test_a_plan_survives_its_folder(written: tuple[ctrplan.Plan, Path], tmp_path: Path) -> None:
    plan, folder = written
    assert plan.uncertainty is not None
    loaded = ctrplan.Plan.load(folder, overrides=QUICK)
    assert json.dumps(loaded.to_json()) == json.dumps(plan.to_json())
    assert np.array_equal(loaded.trajectory.jerk, plan.trajectory.jerk)
    assert np.array_equal(loaded.certificate.samples.clearance_m, plan.certificate.samples.clearance_m)
    write(tmp_path, loaded)
    for name in ("plan.json", "trajectory.csv"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_what_is_no_plan_is_refused(written: tuple[ctrplan.Plan, Path], tmp_path: Path) -> None:
    _, folder = written
    with pytest.raises(InputError, match="holds no plan.json"):
        ctrplan.Plan.load(tmp_path, overrides=QUICK)
    content = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    (tmp_path / "trajectory.csv").write_bytes((folder / "trajectory.csv").read_bytes())
    for key, rule in (("reorder", "has no reorder"), ("notes", "has no notes")):
        less = {name: value for name, value in content.items() if name != key}
        (tmp_path / "plan.json").write_text(json.dumps(less), encoding="utf-8")
        with pytest.raises(InputError, match=rule):
            ctrplan.Plan.load(tmp_path, overrides=QUICK)
    (tmp_path / "plan.json").write_text(json.dumps(content), encoding="utf-8")
    rows = (folder / "trajectory.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / "trajectory.csv").write_text("".join([*rows[:1], *rows[1::2], rows[-1]]), encoding="utf-8")
    with pytest.raises(InputError, match="trajectory.csv"):
        ctrplan.Plan.load(tmp_path, overrides=QUICK)


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_other_ways_are_simulated_for_those_who_look(written: tuple[ctrplan.Plan, Path], tmp_path: Path) -> None:
    """A plan saved without its report compares nothing, and takes the page of an earlier plan away."""
    plan, _ = written
    ctrplan.save_plan(plan, tmp_path)
    assert (tmp_path / "report.html").exists() and (tmp_path / "plan.png").exists()
    ways = ctrplan.Plan.load(tmp_path, overrides=QUICK).reorder.alternatives
    assert [way.name for way in ways] == ["as given", "as driven", "straight line", "translations first"]

    other = replace(plan, reorder=replace(plan.reorder, compare=lambda: pytest.fail("nobody looked at other ways")))
    with pytest.MonkeyPatch.context() as patch, pytest.raises(ctrplan.CtrplanError):
        patch.setattr(plan_page, "write_plan_json", full_disk)
        ctrplan.save_plan(other, tmp_path, report=False)
    assert (tmp_path / "report.html").exists() and (tmp_path / "plan.png").exists()
    ctrplan.save_plan(other, tmp_path, report=False)
    assert not (tmp_path / "report.html").exists() and not (tmp_path / "plan.png").exists()
    assert ctrplan.Plan.load(tmp_path, overrides=QUICK).reorder.alternatives == ()
