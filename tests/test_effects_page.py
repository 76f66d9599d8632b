"""docs/effects.md is what the catalogue says, and the example of a new effect in docs/diagnosis.md works."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from measured_data import chain_of, pair_robot, waypoints

from ctrplan.diagnosis import CATALOGUE

ROOT = Path(__file__).parents[1]


def test_the_page_is_up_to_date() -> None:
    made = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "effects_page.py")], capture_output=True, text=True, check=True
    )
    assert made.stdout == (ROOT / "docs" / "effects.md").read_text()
    assert len(CATALOGUE) >= 19


def test_every_look_alike_is_in_the_catalogue() -> None:
    for effect in CATALOGUE.values():
        assert set(effect.look_alikes) <= set(CATALOGUE), effect.name


def test_the_example_of_a_new_effect_works() -> None:
    source = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "diagnosis.md").read_text(), re.DOTALL)[0]
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
    finally:
        CATALOGUE.pop("thermal_scale", None)
