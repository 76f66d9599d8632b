"""Bodies over cells of friction states: the core against plain formulas and against many states looked at."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import ctrplan._model as core
from ctrplan.base.arrays import Array
from ctrplan.mechanics.friction import Doubts, bodies_between, cell_bodies, cell_spread, nearest_points

WITHIN_M, HALF_M = 1e-5, 0.5e-3


def drawn_bodies(pairs: int, cells: int = 2, points: int = 7, seed: int = 0) -> Array:
    """(L, 2^P + 1, N, 4) [m] of bodies some mm apart, whose radii differ too."""
    rng = np.random.default_rng(seed)
    middle = np.cumsum(rng.normal([0, 0, 1e-3], 2e-4, (cells, 1, points, 3)), axis=2)
    corners = middle + rng.normal(0, 2e-3, (cells, 2**pairs, points, 3))
    bodies = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    bodies[:, -1] += rng.normal(0, 1e-4, bodies[:, -1].shape)
    return np.concatenate([bodies, rng.uniform(0.5e-3, 1e-3, (*bodies.shape[:3], 1))], axis=3)


def at_states(corners: Array, unit: Array) -> Array:
    """(S, 4) of one point's corners (2^P, 4) at states (S, P), 0 to 1: one pair after the other."""
    found = np.broadcast_to(corners, (len(unit), *corners.shape))
    for share in unit.T:
        low, high = np.split(found, 2, axis=1)
        found = low + share[:, None, None] * (high - low)
    return found[:, 0]


def from_ball(points_m: Array, _: Array | None = None) -> Array:
    """(K,) [m] clearance of points to a ball beside the bodies."""
    return np.linalg.norm(points_m - [6e-3, 0, 4e-3], axis=1) - 2e-3


@pytest.mark.parametrize("pairs", [1, 2, 3])
def test_the_spread_is_what_plain_formulas_say(pairs: int) -> None:
    bodies, beyond = drawn_bodies(pairs, points=20), 4
    off, reach = cell_spread(bodies, beyond)
    corners, middle = bodies[:, :-1], bodies[:, -1]
    apart = np.linalg.norm((middle - corners.mean(axis=1))[..., :3], axis=2)
    for cell, k in np.ndindex(off.shape):
        assert off[cell, k] == pytest.approx(apart[cell, : k + beyond + 1].max(), abs=1e-15)
        away = corners[cell, :, k] - middle[cell, k]
        assert reach[cell, k] == pytest.approx(max(np.linalg.norm(row[:3]) + row[3] for row in away), abs=1e-15)


@pytest.mark.parametrize("pairs", [1, 2, 3, 4])
@pytest.mark.parametrize("enough_mm", [-5.0, 0.5, 2.0])
def test_no_state_of_a_cell_has_less_than_is_said(pairs: int, enough_mm: float) -> None:
    """No state has less than is claimed, and where the claim is not "enough" some state has about as little."""
    bodies = drawn_bodies(pairs, seed=pairs)
    cells, _, points, _ = bodies.shape
    error = np.full((cells, points), 0.1e-3)
    asked = np.arange(cells * points)
    unit = np.array(list(itertools.product(np.linspace(0, 1, 15 if pairs < 4 else 7), repeat=pairs)))
    given = {"parts": 1, "half_m": HALF_M, "within_m": WITHIN_M}
    least, where, place = nearest_points(bodies, asked, error, np.full(cells, enough_mm * 1e-3), from_ball, **given)
    for k in asked:
        corners = bodies[k // points, :-1, k % points]
        states = at_states(corners, unit)
        far = np.sqrt(np.maximum(from_ball(states[:, :3]), HALF_M) ** 2 - HALF_M**2)
        true = float((far - states[:, 3]).min()) - 0.1e-3
        if least[k] >= enough_mm * 1e-3:
            assert true >= least[k] - 1e-12  # a lower bound
        else:
            assert true < enough_mm * 1e-3 + 0.1e-3
        np.testing.assert_allclose(at_states(corners, where[k : k + 1])[0, :3], place[k], atol=1e-15)


@pytest.mark.parametrize("pairs", [2, 4])
def test_a_clearance_that_many_states_have_takes_boxes_within_a_budget(pairs: int) -> None:
    """All corners of a cell lie on a sphere around the ball: nearly as much is left in a whole region of states."""
    rng = np.random.default_rng(8)
    sides = rng.normal(size=(1, 2**pairs, 1, 3)) * [0.2, 0.2, 0.2] + [1.0, 0, 0]
    corners = 20e-3 * sides / np.linalg.norm(sides, axis=3, keepdims=True) + [6e-3, 0, 4e-3]
    bodies = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    bodies = np.concatenate([bodies, np.zeros((*bodies.shape[:3], 1))], axis=3)
    states = at_states(bodies[0, :-1, 0], rng.uniform(0, 1, (200_000, pairs)))
    true = float(np.sqrt(from_ball(states[:, :3]) ** 2 - HALF_M**2).min())
    asked: list[int] = []

    def distance(points_m: Array, _: Array) -> Array:
        asked.append(len(points_m))
        return from_ball(points_m)

    none, given = np.zeros((1, 1)), {"parts": 1, "half_m": HALF_M, "within_m": WITHIN_M}
    for enough in (true - 1e-6, true - 0.2e-3, true - 1e-3):
        least = nearest_points(bodies, np.array([0]), none, np.full(1, enough), distance, **given)[0][0]
        assert least <= true + 1e-12
    assert least >= enough  # 1 mm is to spare
    assert max(asked) <= 2 * 16384 and sum(asked) < 500_000


def test_parts_stand_between_a_point_and_those_beside_it() -> None:
    bodies = drawn_bodies(1, cells=1, points=3)
    told = list[Array]()

    def distance(points_m: Array, needed_m: Array) -> Array:
        told.append(points_m)
        return needed_m + 1.0

    none = np.zeros((1, 3))
    nearest_points(bodies, np.array([1]), none, np.zeros(1), distance, parts=4, half_m=HALF_M / 4, within_m=WITHIN_M)
    assert len(told) == 1  # far away: nothing is halved
    before, own, after = bodies[0, :-1, :, :3].mean(axis=0)
    expected = [own + share * (other - own) for other in (before, after) for share in (0.125, 0.375)]
    np.testing.assert_allclose(told[0], expected, atol=1e-15)


def test_what_is_asked_for_is_what_has_to_be_exact() -> None:
    """A clearance told as a lower bound above what was asked for changes no answer that is enough."""
    bodies = drawn_bodies(2, seed=5)
    error, enough, asked = np.zeros(bodies.shape[::2][:2]), np.full(2, 1e-3), np.arange(14)
    given = {"parts": 1, "half_m": HALF_M, "within_m": WITHIN_M}

    def rough(points_m: Array, needed_m: Array) -> Array:
        exact = from_ball(points_m)
        return np.where(exact < needed_m, exact, needed_m)

    exact = nearest_points(bodies, asked, error, enough, from_ball, **given)[0]
    lower = nearest_points(bodies, asked, error, enough, rough, **given)[0]
    np.testing.assert_array_equal(exact >= enough[0], lower >= enough[0])
    assert np.all(lower <= exact + 1e-15)
    np.testing.assert_array_equal(lower[exact < enough[0]], exact[exact < enough[0]])


def test_what_makes_no_cells_is_refused() -> None:
    bodies, enough = drawn_bodies(2), np.zeros(2)
    error = np.zeros((2, 7))
    search = core.PointsInCells(bodies, np.array([0, 13]), error, enough, 1, HALF_M, WITHIN_M)
    for wrong in (np.array([14]), np.array([-1])):
        with pytest.raises(ValueError, match="no cell has"):
            core.PointsInCells(bodies, wrong, error, enough, 1, HALF_M, WITHIN_M)
    with pytest.raises(ValueError, match="errors of all its points"):
        core.PointsInCells(bodies, np.array([0]), error[:, :3].copy(), enough, 1, HALF_M, WITHIN_M)
    with pytest.raises(ValueError, match="even number"):
        core.PointsInCells(bodies, np.array([0]), error, enough, 3, HALF_M, WITHIN_M)
    with pytest.raises(ValueError, match="2\\^P corners"):
        core.PointsInCells(bodies[:, 1:].copy(), np.array([0]), error, enough, 1, HALF_M, WITHIN_M)
    with pytest.raises(ValueError, match="one clearance"):
        search.tell(np.zeros(5))


@pytest.mark.parametrize("pairs", [1, 2, 3])
@pytest.mark.parametrize("is_view", [False, True])
def test_bodies_between_are_what_plain_formulas_say(pairs: int, is_view: bool) -> None:
    rng = np.random.default_rng(pairs)
    shapes = np.moveaxis(drawn_bodies(pairs, cells=1, points=9), 1, 0)[:, 0, :, : 4 if is_view else 3]
    shapes = np.ascontiguousarray(shapes)[..., :3]
    states, share, doubts = 4, 0.3, Doubts(0.2, 0.1, 0.05, 2)
    phi = rng.uniform(-1, 1, (states, pairs))
    ends = [
        (np.sort(np.append(rng.uniform(0, 1, n), [0, 1])), rng.normal(0, 1e-3, (states, n + 2, 3))) for n in (5, 11)
    ]
    bodies, doubt = bodies_between(shapes, phi, *ends, share, doubts)
    length = np.append(0, np.cumsum(np.linalg.norm(np.diff(shapes[0], axis=0), axis=1)))
    spread = np.linalg.norm(shapes[1:] - shapes[0], axis=2).max(axis=0)
    signs = np.array(list(itertools.product((1, -1), repeat=pairs)))
    for k in range(states):
        first, last = (
            np.transpose([np.interp(length / length[-1], at, bend[k][:, i]) for i in range(3)]) for at, bend in ends
        )
        bend = (1 - share) * first + share * last
        straight = np.tensordot(np.prod((1 + phi[k] * signs) / 2, axis=1), shapes[1:], axes=1)
        np.testing.assert_allclose(bodies[k], straight + bend, rtol=0, atol=1e-16)
        said = 0.2 * np.linalg.norm(first - last, axis=1) + 0.1 * np.linalg.norm(bend, axis=1) + 0.05 * spread
        assert doubt[k] == pytest.approx([said[: i + 3].max() for i in range(len(said))], abs=1e-16)


def test_a_state_without_a_body_on_one_side_has_none_between() -> None:
    shapes, at = np.ascontiguousarray(drawn_bodies(1, cells=1)[0, :, :, :3]), np.array([0.0, 0.5, 1.0])
    bend, lost = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    lost[1] = np.nan
    bodies, doubt = bodies_between(shapes, np.array([[0.5], [0.2]]), (at, bend), (at, lost), 0.5, Doubts(1, 1, 1, 2))
    assert np.isfinite(bodies[0]).all() and np.isfinite(doubt[0]).all()
    assert np.isnan(bodies[1]).all() and np.isnan(doubt[1]).all()


def test_bodies_of_cells_are_as_long_as_the_longest() -> None:
    rng = np.random.default_rng(0)
    bodies = [rng.normal(size=(n, 3)) for n in (4, 4, 4, 6, 6, 6)]
    radii, doubts = [rng.uniform(1, 2, 4), rng.uniform(1, 2, 6)], [None, rng.uniform(0, 1, 4), None, None, None, None]
    found = cell_bodies(bodies, radii, doubts)
    assert found.shape == (2, 3, 6, 4)
    np.testing.assert_array_equal(found[0, 1, :4, 3], radii[0] + doubts[1])
    np.testing.assert_array_equal(found[0, :, 4:], np.repeat(found[0, :, 3:4], 2, axis=1))
    np.testing.assert_array_equal(found[1, :, :, :3], bodies[3:])


def test_bodies_of_cells_may_be_rows_of_wider_arrays() -> None:
    """Shapes of a path are such rows: their points have a radius beside them."""
    wide = np.random.default_rng(1).normal(size=(3, 500, 8))
    bodies, radius, doubts = [row[:, ::2][:, :3] for row in wide], wide[0, :, 7], [row[:, 5] for row in wide]
    found = cell_bodies(bodies, [radius], doubts)
    np.testing.assert_array_equal(found[0, :, :, :3], bodies)
    np.testing.assert_array_equal(found[0, :, :, 3], radius + np.array(doubts))
    whole = cell_bodies([np.ones((2, 3), dtype=np.float32)] * 3, [np.ones(2, dtype=np.float32)], [None] * 3)
    np.testing.assert_array_equal(whole, np.ones((1, 3, 2, 4)))


@pytest.mark.parametrize("wrong", ["shapes", "share", "bend", "body"])
def test_arrays_that_do_not_fit_are_refused(wrong: str) -> None:
    shapes, at = np.zeros((3, 5, 3)), np.linspace(0, 1, 4)
    end, phi = (at, np.zeros((1, 4, 3))), np.zeros((1, 1))
    with pytest.raises(ValueError, match=r"body|bodies|bend"):
        if wrong == "body":
            cell_bodies([np.zeros((4, 3))] * 3, [np.ones(5)], [None] * 3)
        bodies_between(
            shapes[1:] if wrong == "shapes" else shapes,
            phi,
            (at[1:], end[1]) if wrong == "share" else end,
            (at, np.zeros((2, 4, 3))) if wrong == "bend" else end,
            0.5,
            Doubts(1, 1, 1, 1),
        )
