"""Friction states along walked pieces: what is refused at the narrowest places says why."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.base.arrays import Array
from ctrplan.certificate import every_state, narrow_samples
from ctrplan.certificate.every_state import _PieceView, in_every_friction_state
from ctrplan.certificate.friction_cube import Needed, StateMinima
from ctrplan.certificate.friction_states import LOOK_EVERY, State
from ctrplan.certificate.narrow_samples import closely_solved, remembered_looks
from ctrplan.certificate.problems import problems_of_walk
from ctrplan.certificate.sample_states import SampleStates
from ctrplan.certificate.walked_piece import Piece, walk_pieces
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.shapes import FrictionBodies
from ctrplan.motion.limits import path_limits
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario


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


def _pieces(corners_turned_by: list[float]) -> tuple[Scenario, list[Piece]]:
    """Pieces of turns [rad] of all joints of the vessel's start, one after the other."""
    scenario = load_scenario(SCENARIOS / "vessel.toml")
    space = JointSpace.of(scenario)
    corners = scenario.start + np.array(corners_turned_by)[:, None] * space.drive.is_rotation
    return scenario, walk_pieces(scenario, space, corners, "search", None)


@pytest.mark.parametrize("breaks", [(), ((0, 40),), ((0, 12), (1, 5))])
def test_what_is_kept_does_not_depend_on_which_thread_comes_first(
    monkeypatch: pytest.MonkeyPatch, breaks: tuple[tuple[int, int], ...]
) -> None:
    """Samples before and in the first broken batch of a piece count, none after it, whoever was sooner."""
    monkeypatch.setattr(every_state, "AT_ONCE", 32)
    scenario, pieces = _pieces([0.0, 1.8, 0.2])
    assert min(len(piece.clearance_m) for piece in pieces[:2]) > 2 * every_state.AT_ONCE
    number = {id(piece.samples): k for k, piece in enumerate(pieces)}
    least_stability = np.random.default_rng(0).uniform(0.3, 0.9, size=(len(pieces), max(len(p.l_b) for p in pieces)))
    for piece, sample in breaks:
        least_stability[piece, sample] = -1.0
    delays = np.random.default_rng(1)

    def least(self: _PieceView, samples: Sequence[int]) -> list[StateMinima]:
        time.sleep(float(delays.uniform(0, 0.02)))
        k = number[id(self.piece.samples)]
        return [StateMinima(1.0, least_stability[k, s], 0.01, (0.0, 0.0), np.zeros(3), 0) for s in samples]

    monkeypatch.setattr(_PieceView, "least", least)
    monkeypatch.setattr(every_state, "_narrowest", lambda pieces: [])
    found = []
    for threads in (1, 4, 4):
        monkeypatch.setattr(every_state, "cores", lambda threads=threads: threads)
        found.append(in_every_friction_state(scenario, pieces, np.inf))
    for k, same in enumerate(zip(*found, strict=True)):
        assert all(np.array_equal(piece.stability, same[0].stability) for piece in same)
        own = np.minimum(pieces[k].stability, least_stability[k, : len(pieces[k].stability)])
        first = min([sample for p, sample in breaks if p == k], default=None)
        if first is None:
            np.testing.assert_array_equal(same[0].stability, own)
        else:
            np.testing.assert_array_equal(same[0].stability[: first + 1], own[: first + 1])
            behind = first + every_state.AT_ONCE
            np.testing.assert_array_equal(same[0].stability[behind:], pieces[k].stability[behind:])


def test_batches_hold_every_sample_once_and_begin_where_states_are_solved() -> None:
    scenario, pieces = _pieces([0.0, 0.8])
    limits = path_limits(scenario)
    for clearance_m in (-1.0, float(np.median(pieces[0].as_walked_m)), 1.0):
        needed = Needed(clearance_m, limits.stability, limits.max_strain)
        batches = _PieceView(scenario, pieces[0], needed, limits.clearance_m, None).batches()
        assert [sample for batch in batches for sample in batch] == list(range(len(pieces[0].clearance_m)))
        assert all(batch[0] % LOOK_EVERY == 0 for batch in batches)


def test_pieces_of_a_path_before_are_not_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are those of looks from scratch, and where all clearance is asked for nothing is taken from before.

    What a plan states of a sample was once that of a path which had asked for less, and `verify` found another number.
    """
    scenario, pieces = _pieces([0.0, 0.3, 0.1])
    solve, solved = SampleStates.solve, list[int]()

    def counted(self: SampleStates, states: Iterable[State]) -> FrictionBodies:
        solved.append(1)
        return solve(self, states)

    monkeypatch.setattr(SampleStates, "solve", counted)

    def looked(spare_m: float) -> tuple[list[Piece], int]:
        solved.clear()
        return in_every_friction_state(scenario, pieces, spare_m), len(solved)

    fresh, effort = looked(0.2e-3)
    wide, wide_effort = looked(np.inf)
    with remembered_looks():
        first, first_effort = looked(0.2e-3)
        again, again_effort = looked(0.2e-3)
        wider, wider_effort = looked(np.inf)
        last, last_effort = looked(0.2e-3)
    outside, outside_effort = looked(0.2e-3)
    assert (
        first_effort == effort == outside_effort > 0 and again_effort == last_effort == 0 < wider_effort == wide_effort
    )
    for ours, piece in zip(wider, wide, strict=True):
        assert np.array_equal(ours.clearance_m, piece.clearance_m)
        assert np.array_equal(ours.stability, piece.stability) and np.array_equal(ours.max_strain, piece.max_strain)
    for same in (first, again, outside):
        for ours, piece in zip(same, fresh, strict=True):
            assert np.array_equal(ours.clearance_m, piece.clearance_m)
            assert np.array_equal(ours.stability, piece.stability)
    assert min(float(piece.clearance_m.min()) for piece in last) >= min(float(p.clearance_m.min()) for p in fresh)


MUCH_M = 0.1  # of clearance, more than any sample has: but not all of it


def test_samples_of_a_path_before_are_solved_closely_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, pieces = _pieces([0.0, 0.3, 0.1])
    fresh = closely_solved(scenario, pieces, MUCH_M)
    assert any(piece.finer for piece in fresh)
    with remembered_looks():
        first = closely_solved(scenario, pieces, MUCH_M)
        monkeypatch.setattr(narrow_samples, "_solved_anew", lambda *_: pytest.fail("solved once more"))
        again = closely_solved(scenario, pieces, MUCH_M)
    for same in (first, again):
        for ours, piece in zip(same, fresh, strict=True):
            assert np.array_equal(ours.clearance_m, piece.clearance_m) and ours.finer.keys() == piece.finer.keys()
