"""Bounds of many tubes: the extreme corners stand for all of them, sizes are refused in a sentence, work is bounded."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ctrplan.errors import InputError
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.core import kernel_name
from ctrplan.mechanics.shapes import Status
from ctrplan.robot.robot import Robot


def content(n: int, friction: float = 0.2, poisson_ratio: float = 0.3, bend: float = 5.0) -> dict[str, Any]:
    tubes: list[dict[str, Any]] = [
        {
            "outer_diameter_mm": 1.0 + 0.5 * (n - 1 - i),
            "inner_diameter_mm": 0.7 + 0.5 * (n - 1 - i),
            "bending_stiffness_Nm2": 0.01 * 1.6 ** (n - 1 - i),
            "poisson_ratio": poisson_ratio,
            "section": [
                {"length_mm": 30 + 15 * i, "curvature_x_per_m": 0, "curvature_y_per_m": 0},
                {"length_mm": 40, "curvature_x_per_m": 0, "curvature_y_per_m": bend + 1.5 * i},
            ],
        }
        for i in range(n)
    ]
    return {"tube": tubes, "contact": [{"friction_coefficient": friction}] * (n - 1)}


def nested(n: int, friction: float = 0.2, poisson_ratio: float = 0.3, bend: float = 5.0) -> Robot:
    return robot_from_dict(content(n, friction, poisson_ratio, bend))


def anywhere(n: int, seed: int) -> tuple[Any, Any]:
    random = np.random.default_rng(seed)
    return random.uniform(-np.pi, np.pi, n), -np.concatenate([[0.0], np.cumsum(random.uniform(5e-3, 10e-3, n - 1))])


@pytest.mark.parametrize("n", [2, 3, 4, 5, 6])
def test_extreme_corners_give_the_bound_of_all_corners(n: int) -> None:
    for seed in range(6):
        robot, q = nested(n, friction=0.05 + 0.05 * seed), anywhere(n, seed)
        whole, part = robot.bound(*q, corners="all"), robot.bound(*q, corners="extreme")
        assert whole.has_all_corners and len(whole.corners) == 2 ** (n - 1)
        assert n < 6 or not part.has_all_corners
        assert part.position_m == pytest.approx(whole.position_m, rel=1e-6)
        assert part.tangent_rad == pytest.approx(whole.tangent_rad, rel=1e-6)
        assert np.all(part.envelope_m <= whole.envelope_m + 1e-9)
        known = {tuple(phi): shape.tip_m for phi, shape in zip(whole.corner_phi, whole.corners, strict=True)}
        for phi, shape in zip(part.corner_phi, part.corners, strict=True):
            np.testing.assert_allclose(shape.tip_m, known[tuple(phi)], rtol=0, atol=1e-7)


SIDE_BY_SIDE = """
import json, sys
import numpy as np
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.mechanics.core import kernel_name
content, theta_b, l_b, phi = json.load(open(sys.argv[1]))
robot = robot_from_dict(content)
bound, bodies = robot.bound(theta_b, l_b), robot.mechanics.friction_bodies(theta_b, l_b, phi)
tips = [shape.tip_m for shape in bound.corners] + list(bodies.point_m[:, -1])
np.savez(sys.argv[2], kernel=kernel_name(), tips=tips, stability=bodies.stability)
"""


@pytest.mark.skipif(kernel_name() != "avx512", reason="this CPU solves four friction states side by side at most")
@pytest.mark.parametrize("n", [3, 4, 5])
def test_eight_friction_states_side_by_side_are_solved_as_four_are(n: int, tmp_path: Path) -> None:
    """Thirteen states with friction: eight, then five of eight. Modes are those of the last factors, a step apart."""
    theta_b, l_b = (values.tolist() for values in anywhere(n, 3))
    phi = np.random.default_rng(n).uniform(-1, 1, (13, n - 1)).tolist()
    (tmp_path / "in.json").write_text(json.dumps([content(n), theta_b, l_b, phi]))
    results = []
    for kernel in ("avx2", ""):
        out = tmp_path / f"out{kernel}.npz"
        command = [sys.executable, "-c", SIDE_BY_SIDE, str(tmp_path / "in.json"), str(out)]
        subprocess.run(command, env={**os.environ, "CTRPLAN_KERNEL": kernel}, cwd=tmp_path, check=True)
        results.append(np.load(out))
    narrow, wide = results
    assert (narrow["kernel"], wide["kernel"]) == ("avx2", "avx512")
    np.testing.assert_allclose(wide["tips"], narrow["tips"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(wide["stability"], narrow["stability"], rtol=1e-4)


def test_all_corners_of_more_than_ten_tubes_are_refused_in_a_sentence_and_extremes_are_not() -> None:
    robot, q = nested(11, friction=0.1), anywhere(11, 0)
    sentence = r"^bounds over all corners are for robots of at most 10 tubes, this one has 11 and 2\^10 corners: .*\.$"
    with pytest.raises(InputError, match=sentence):
        robot.bound(*q, corners="all")
    with pytest.raises(InputError, match=sentence):
        robot.bound_many(q[0][None], q[1][None])
    found = robot.bound(*q)
    assert np.isfinite(found.position_m) and not found.has_all_corners
    assert found.corner_phi.shape == (len(found.corners), 10) and set(np.unique(found.corner_phi)) == {-1.0, 1.0}


def test_what_finds_no_memory_is_a_sentence() -> None:
    script = (
        "import resource, sys; sys.path.insert(0, sys.argv[1]);"
        "from test_bound_sizes import nested, anywhere; from ctrplan.errors import SolverError\n"
        "robot, q = nested(9), anywhere(9, 0)\n"
        "robot.zero_clearance(*q)\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 30_000_000,) * 2)\n"
        "try:\n    robot.bound(*q, corners='all')\n"
        "except SolverError as error:\n    print(error)\n"
    )

    child = subprocess.run(
        [sys.executable, "-c", script, str(Path(__file__).parent)], capture_output=True, text=True, timeout=60
    )
    assert child.stdout == "there is not enough memory for so many solves at once\n", child.stderr


def test_a_robot_that_locks_itself_takes_bounded_work_and_says_what_was_reached() -> None:
    """Six tubes bent by more than half a turn at mu = 1.5, which took up to two minutes."""
    robot, q = nested(6, friction=1.5, poisson_ratio=0.5, bend=60.0), anywhere(6, 3)
    begun = time.monotonic()
    found = robot.bound(*q)
    assert time.monotonic() - begun < 30
    failed = [shape.status is Status.FAILED for shape in found.corners]
    assert any(failed) == bool(np.isnan(found.position_m))
