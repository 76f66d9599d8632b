"""A pair of tubes whose friction moves its tip by 5 mm, and paths that erase it or do not."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from places import SCENARIOS

from ctrplan.certificate.arrival import Arrival
from ctrplan.certificate.certificate import Certificate
from ctrplan.certificate.certify import certify
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.scenario import Scenario

START = np.array([0.0, 0.0, -0.03])
GOAL = np.array([1.0, 3.2, 0.02])  # of the pair: friction moves its tip by 5 mm
PATH = np.array([START, [*GOAL[:2], START[2]], GOAL])
SHORT = np.array([GOAL - [0.0, 0.1, 0.0], GOAL])  # too short a turn to erase anything
TURNED_LAST = np.array([START, [*START[:2], GOAL[2]], GOAL])


@cache
def pair(*overrides: str) -> Scenario:
    """To the tip of GOAL; nobody changes it."""
    bare = load_scenario(SCENARIOS / "pair_free.toml")
    tip = bare.robot.solve(*bare.robot.drive.collars(GOAL)).tip_m * 1e3
    return load_scenario(
        SCENARIOS / "pair_free.toml", [f"goal={{tip_mm={tip.round(3).tolist()}, tolerance_mm=1}}", *overrides]
    )


def certified(path: np.ndarray[Any, Any]) -> Certificate:
    """The certificate of the pair without overrides along a path (K, 3), made once a path; nobody changes it."""
    return _certified(tuple(map(tuple, path)))


@cache
def _certified(rows: tuple[tuple[float, ...], ...]) -> Certificate:
    return certify(pair(), np.array(rows))


def arrival(scenario: Scenario, path: np.ndarray[Any, Any] = PATH) -> Arrival:
    return arrival_of(certify(scenario, path))


def plain_arrival(path: np.ndarray[Any, Any] = PATH) -> Arrival:
    """The arrival of the pair without overrides."""
    return arrival_of(certified(path))


def arrival_of(certificate: Certificate) -> Arrival:
    assert certificate.arrival is not None
    return certificate.arrival
