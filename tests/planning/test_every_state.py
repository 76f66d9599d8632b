"""Friction states along walked pieces: what is refused at the narrowest places says why."""

from __future__ import annotations

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import Array
from ctrplan.files.scenario_file import load_scenario
from ctrplan.planning.certificate.every_state import in_every_friction_state
from ctrplan.planning.certificate.problems import problems_of_walk
from ctrplan.planning.certificate.sample_states import SampleStates
from ctrplan.planning.certificate.walked_piece import walk_pieces
from ctrplan.planning.joint_space import JointSpace


def test_another_equilibrium_at_the_narrowest_places_is_told_as_that(monkeypatch: pytest.MonkeyPatch) -> None:
    def elsewhere(self: SampleStates, bodies: Array) -> None:
        self._compared, self.apart_m = True, 20e-3

    scenario = load_scenario(SCENARIOS / "vessel.toml")
    space = JointSpace.of(scenario)
    corners = scenario.start + np.array([[0.0], [0.05]]) * space.drive.is_rotation
    monkeypatch.setattr(SampleStates, "_compare", elsewhere)
    pieces = in_every_friction_state(scenario, walk_pieces(scenario, space, corners, "search", None), np.inf)
    assert any("another equilibrium exists" in told for told in problems_of_walk(scenario, space, corners, pieces))
    assert not any(piece.finer for piece in pieces)
