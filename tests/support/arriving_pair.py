"""A pair of tubes whose friction moves its tip by 5 mm, and paths that erase it or do not."""

from __future__ import annotations

from typing import Any

import numpy as np
from places import SCENARIOS

from ctrplan.certificate.arrival import Arrival
from ctrplan.certificate.certify import certify
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario

START = np.array([0.0, 0.0, -0.03])
GOAL = np.array([1.0, 3.2, 0.02])  # of the pair: friction moves its tip by 5 mm
PATH = np.array([START, [*GOAL[:2], START[2]], GOAL])
SHORT = np.array([GOAL - [0.0, 0.1, 0.0], GOAL])  # too short a turn to erase anything


def pair(*overrides: str) -> Scenario:
    """To the tip of GOAL."""
    bare = load_scenario(SCENARIOS / "pair_free.toml")
    tip = bare.robot.solve(*bare.robot.drive.collars(GOAL)).tip_m * 1e3
    return load_scenario(
        SCENARIOS / "pair_free.toml", [f"goal={{tip_mm={tip.round(3).tolist()}, tolerance_mm=1}}", *overrides]
    )


def arrival(scenario: Scenario, path: np.ndarray[Any, Any] = PATH) -> Arrival:
    found = certify(scenario, path).arrival
    assert found is not None
    return found
