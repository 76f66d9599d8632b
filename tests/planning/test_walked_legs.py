"""Legs walked after others that failed: what both share is walked once, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import Array
from ctrplan.certificate import walked_piece
from ctrplan.certificate.walked_legs import walk_legs
from ctrplan.files.scenario_file import load_scenario
from ctrplan.scenario.joint_space import JointSpace


def test_pieces_of_a_failed_walk_are_not_walked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario(SCENARIOS / "vessel.toml")
    strict = replace(scenario, margins=replace(scenario.margins, stability=0.99))  # no robot is that stable
    turn = 0.3 * JointSpace.of(scenario).drive.is_rotation
    begin, middle = scenario.start, scenario.start + turn
    first, second = np.array([begin, middle, middle + turn]), np.array([begin, middle, middle - 2 * turn])
    failed = walk_legs(strict, first)
    assert failed.problems
    assert len(failed.walked) >= 2
    alone = walk_legs(strict, second)
    begun: list[Array] = []
    walked = walked_piece.walked

    def counted(*args: object) -> object:
        begun.append(args[3])  # type: ignore[arg-type]
        return walked(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(walked_piece, "walked", counted)
    after = walk_legs(strict, second, failed=failed)
    shared = {piece.way.tobytes() for piece in failed.walked if piece.leg == 0}
    assert begun
    assert not any(way.tobytes() in shared for way in begun)
    np.testing.assert_array_equal(after.samples.clearance_m, alone.samples.clearance_m)
    np.testing.assert_array_equal(after.samples.bound_m, alone.samples.bound_m)
    np.testing.assert_array_equal(after.samples.leg, alone.samples.leg)
    assert after.problems == alone.problems
    begun.clear()
    walk_legs(scenario, second, failed=failed)
    assert len(begun) == len(after.pieces)  # of another scenario: clearances are taken off its anatomy and margins
