"""Equal input gives equal output: plans by their bytes, kernels to 1e-9 m."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from places import SCENARIOS
from small_scenarios import NEAR, pair_past_a_sphere

import ctrplan
from ctrplan.__main__ import main
from ctrplan.files.robot_file import load_robot
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.core import kernel_name
from ctrplan.plans.plan import plan_to_json

BOUNDS = """
import json, sys
import numpy as np
from ctrplan.mechanics.core import kernel_name
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.files.robot_file import load_robot
found = {"kernel": kernel_name()}
for name in sys.argv[2:]:
    robot = load_robot(f"{sys.argv[1]}/{name}.toml")
    joints = JointSpace.of_robot(robot).sample(np.random.default_rng(0), 20)
    bounds = robot.bound_many(*robot.drive.collars(joints), accuracy="certificate")
    found[name] = [bounds.position_m.tolist(), bounds.status.tolist(), bounds.tip_m.tolist()]
print(json.dumps(found))
"""


@pytest.mark.skipif(kernel_name() == "baseline", reason="this processor has the baseline kernel only")
def test_kernels_agree_on_every_bound() -> None:
    names = ["table_1_pair", "table_5_pair", "three_tube"]
    found = []
    for kernel in ("baseline", ""):
        done = subprocess.run(
            [sys.executable, "-c", BOUNDS, str(SCENARIOS / "robots"), *names],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "CTRPLAN_KERNEL": kernel},
        )
        found.append(json.loads(done.stdout))
    baseline, wide = found
    assert (baseline.pop("kernel"), wide.pop("kernel")) == ("baseline", kernel_name())
    for name in names:
        for one, other in zip(baseline[name], wide[name], strict=True):
            np.testing.assert_allclose(np.array(one, float), np.array(other, float), rtol=0, atol=1e-9)


def test_a_bound_is_the_same_to_the_last_bit_however_often_and_wherever_it_is_asked_for() -> None:
    robot = load_robot(SCENARIOS / "robots" / "three_tube.toml")
    theta, l = np.array([[0.0, 1.5, 3.0]] * 5), np.array([[0.0, -0.017, -0.0628]] * 5)  # noqa: E741
    bounds = [robot.bound_many(theta, l, threads=threads).position_m for threads in (1, 2, 0)]
    assert len({float(x) for bound in bounds for x in bound} | {robot.bound(theta[0], l[0]).position_m}) == 1


def test_the_same_path_is_reordered_to_the_same_bytes() -> None:
    scenario = load_scenario(SCENARIOS / "pair_free.toml")
    path = np.linspace(scenario.start, scenario.goal.joints, 5)
    legs, certificates = [], []
    for _ in range(2):
        content = plan_to_json(ctrplan.reorder(path, scenario))
        legs.append(json.dumps(content["legs"]))
        certificates.append(json.dumps(content["certificate"]))
    assert legs[0] == legs[1] and certificates[0] == certificates[1]


def test_a_plan_says_that_it_depends_on_the_speed_of_the_machine(tmp_path: Path) -> None:
    given = ["--time", "0.2", "--set", NEAR, "--seed", "5", "--formats", "csv"]
    assert main(["plan", str(SCENARIOS / "pair_free.toml"), "-o", str(tmp_path), *given]) == 0
    content = json.loads((tmp_path / "plan.json").read_text())
    assert content["seed"] == 5 and content["clock_s"] > content["first_found_s"] > 0 and content["work_s"] > 0
    assert content["search_ended_by"] == "time"
    assert any("may find another path" in note for note in content["notes"])


def test_a_search_that_ends_by_count_gives_the_same_legs_to_the_last_bit() -> None:
    scenario = pair_past_a_sphere(time_s=0.3)
    first, second = (plan_to_json(ctrplan.plan(scenario, seed=4)) for _ in range(2))
    assert first["search_ended_by"] == "count"
    for key in ("legs", "certificate", "search_ended_by", "notes"):
        assert json.dumps(first[key]) == json.dumps(second[key])
    assert not any("another machine" in note for note in first["notes"])
