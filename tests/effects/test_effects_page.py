"""docs/effects.md is what the catalogue says, and the example of an effect of the sensor in docs/extending.md works."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from measured_data import chain_of, pair_robot, waypoints
from places import ROOT

from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.next_experiment import _pool
from ctrplan.files.measurement_file import load_joint_path
from ctrplan.studies.simulate import simulate


def test_the_page_is_up_to_date() -> None:
    made = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "effects_page.py")], capture_output=True, text=True, check=True
    )
    assert made.stdout == (ROOT / "docs" / "effects.md").read_text()
    assert len(CATALOGUE) >= 19


def test_every_look_alike_is_in_the_catalogue() -> None:
    for effect in CATALOGUE.values():
        assert set(effect.look_alikes) <= set(CATALOGUE), effect.name


def simulated_with_and_without_its_column(folder: Path) -> None:
    robot = pair_robot(effects={"thermal_scale": {"percent_per_K": 1.0}})
    rows = ["theta_1_rad,theta_2_rad,l_1_m,l_2_m", "0,0.5,0,-0.02", "0,0.9,0,-0.02"]
    (folder / "path.csv").write_text("\n".join(rows))
    result = simulate(robot, load_joint_path(folder / "path.csv", robot))
    assert result.measured is None and "without a column temperature_C" in result.warnings[0]
    warm = [f"{row},{cell}" for row, cell in zip(rows, ("temperature_C", 20, 30), strict=True)]
    (folder / "path.csv").write_text("\n".join(warm))
    result = simulate(robot, load_joint_path(folder / "path.csv", robot))
    assert result.measured is not None and not result.warnings
    np.testing.assert_allclose(result.measured.position[-1], 1.1 * result.position_m[-1])


def test_the_example_of_a_new_effect_works(tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "extending.md").read_text(), re.DOTALL)
    (source,) = [block for block in blocks if "thermal_scale" in block]
    assert len(source.splitlines()) <= 40
    try:
        exec(compile(source, "example", "exec"), {"__name__": "example"})
        robot = pair_robot()
        data = waypoints(robot, 2)
        assert "no column" in CATALOGUE["thermal_scale"].untestable(robot, data)
        warm = replace(data, more={"temperature_C": np.linspace(20, 30, len(data.sequence))})
        chain = chain_of(robot, warm, {"thermal_scale": None})
        p = chain.neutral.copy()
        plain = chain.predict(p, derivatives=False).position_m
        p[-1] = 0.01
        grown = chain.predict(p, derivatives=False).position_m
        ratio = np.linalg.norm(grown, axis=1) / np.linalg.norm(plain, axis=1)
        np.testing.assert_allclose(ratio, 1 + 0.01 * (warm.more["temperature_C"] - 20)[warm.rows])
        pool = chain_of(robot, _pool(warm, robot), {"thermal_scale": None})
        shown, cold = (pool.predict(q, derivatives=False).position_m for q in (p, pool.neutral))
        assert np.ptp(np.linalg.norm(shown, axis=1) / np.linalg.norm(cold, axis=1)) > 0.02
        simulated_with_and_without_its_column(tmp_path)
    finally:
        CATALOGUE.pop("thermal_scale", None)
