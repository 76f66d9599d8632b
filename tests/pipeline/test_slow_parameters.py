"""Slow parameters of an observer: what the file has wrong is found beside the friction states."""

from __future__ import annotations

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.core import Mechanics
from ctrplan.robot.named_numbers import with_values
from ctrplan.robot.slow_states import SlowModel, SlowOffset, SlowParameter

PAIR = load_robot(ROBOTS / "table_5_pair.toml")
FRICTION = "contact.1.friction_coefficient"
NOISE_M = 0.1e-3


def large_motion(count: int = 60) -> tuple[Array, Array]:
    """Rotations to and fro that turn friction over again and again."""
    phase = np.linspace(0, 4 * np.pi, count)
    theta = np.outer(1.0 + 0.6 * np.sin(phase) + 0.1 * np.sin(3.3 * phase), [0.0, 1.0])
    return theta, np.tile([0.0, -0.06], (count, 1))


def seen_with(**changes: float) -> tuple[Array, Array, Array]:
    """Joints, and noisy tips of the pair with other numbers."""
    theta, l_b = large_motion()
    other = with_values(PAIR, {name.replace("__", "."): value for name, value in changes.items()})
    tips = other.history((0.4,)).follow(theta, l_b).position_m
    return theta, l_b, tips + NOISE_M * np.random.default_rng(5).standard_normal(tips.shape)


def test_friction_that_the_file_has_wrong_is_found() -> None:
    theta, l_b, seen = seen_with(contact__1__friction_coefficient=0.3)
    assert PAIR.friction[0, 1] == 0.2
    off = {}
    for slow in ((), (SlowParameter(FRICTION, 0.1),)):
        observer = PAIR.observer(NOISE_M, slow=slow)
        steps = [observer.observe(*row) for row in zip(theta, l_b, seen, strict=True)]
        ahead = np.array([step.expected.position_m for step in steps])
        off[len(slow)] = np.sqrt(np.mean(np.sum((ahead - seen)[20:] ** 2, axis=1)))
    found = steps[-1].parameters[FRICTION]
    assert abs(found.value - 0.3) < 3 * found.sigma < 0.09
    assert off[1] < 1.4 * np.sqrt(3) * NOISE_M < 0.6 * off[0]
    inside = [
        np.mean((s.expected.low_m <= tip) & (tip <= s.expected.high_m)) for s, tip in zip(steps, seen, strict=True)
    ]
    assert np.mean(inside) > 0.9
    state = observer.state()
    assert state.parameters[FRICTION] == found
    state.check(PAIR.mechanics, theta[-1], l_b[-1])  # of the robot as it stands in the file, for plans go by that


def test_the_zero_of_a_collar_is_found() -> None:
    theta, l_b, _ = seen_with()
    shift = np.array([0.0, 0.05])
    tips = PAIR.history((0.4,)).follow(theta + shift, l_b).position_m
    observer = PAIR.observer(NOISE_M, slow=[SlowParameter("theta_b.2", 0.1)])
    for row in zip(theta, l_b, tips, strict=True):
        last = observer.observe(*row)
    found = last.parameters["theta_b.2"]
    assert abs(found.value - 0.05) < 0.01
    assert np.linalg.norm(last.tip.position_m - tips[-1]) < 2 * NOISE_M


def test_without_measurements_a_parameter_stays_as_it_is_known_and_widens_the_interval() -> None:
    theta, l_b = large_motion(4)
    known, unknown = PAIR.observer(NOISE_M), PAIR.observer(NOISE_M, slow=[SlowParameter(FRICTION, 0.1)])
    for row in zip(theta, l_b, strict=True):
        narrow, wide = known.observe(*row), unknown.observe(*row)
    assert wide.parameters[FRICTION].value == pytest.approx(0.2)
    assert wide.parameters[FRICTION].sigma == pytest.approx(0.1)
    assert np.all(wide.tip.high_m - wide.tip.low_m >= narrow.tip.high_m - narrow.tip.low_m)


def test_the_filter_is_the_least_squares_estimate_of_all_tips_together() -> None:
    """Constant parameters follow from the normal equations with priors, an independent formulation."""
    rng = np.random.default_rng(0)
    model = SlowModel(SlowOffset(1e-3), [SlowParameter("a", 2.0, np.inf), SlowParameter("b", 0.5, np.inf)])
    slow, H, off = model.start(), [], []
    true = np.array([1e-3, 0.0, -1e-3, 0.7, -0.2])
    for _ in range(6):
        slopes = 1e-3 * rng.standard_normal((3, 2))
        H.append(np.hstack([np.eye(3), slopes]))
        off.append(H[-1] @ true + NOISE_M * rng.standard_normal(3))
        slow = model.after_step(slow)
        left = off[-1] - slow.moved_m(slopes, np.zeros(2))
        (slow,) = model.seen([slow], slopes[None], left[None], NOISE_M**2)
    rows, y = np.concatenate(H) / NOISE_M, np.concatenate(off) / NOISE_M
    information = rows.T @ rows + np.diag(1 / np.array([1e-3, 1e-3, 1e-3, 2.0, 0.5]) ** 2)
    np.testing.assert_allclose(slow.mean, np.linalg.solve(information, rows.T @ y), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(slow.covariance, np.linalg.inv(information), rtol=1e-5, atol=1e-12)


def test_slopes_are_those_of_the_mechanics() -> None:
    theta, l_b = np.array([[0.0, 1.2]]), np.array([[0.0, -0.06]])
    model = SlowModel(SlowOffset(0.0), [SlowParameter(FRICTION, 0.1)])
    by = model.slopes(PAIR.mechanics, theta, l_b, np.array([[0.8]]))[0, :, 0]
    low, high = (_tip(with_values(PAIR, {FRICTION: mu}).mechanics, theta, l_b) for mu in (0.199, 0.201))
    np.testing.assert_allclose(by, (high - low) / 0.002, atol=1e-3 * np.abs(by).max())


def _tip(mechanics: Mechanics, theta: Array, l_b: Array) -> Array:
    return mechanics.tips_with_friction(theta, l_b, np.array([[0.8]])).position_m[0]


@pytest.mark.parametrize(
    ("slow", "sentence"),
    [
        ([SlowParameter("contact.2.friction_coefficient", 0.1)], "contact.2.friction_coefficient: no such parameter"),
        ([SlowParameter(FRICTION, 0.1)] * 2, "is named twice"),
    ],
)
def test_numbers_that_the_robot_lacks_are_refused(slow: list[SlowParameter], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        PAIR.observer(NOISE_M, slow=slow)
