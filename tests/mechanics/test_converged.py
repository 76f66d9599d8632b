"""CONVERGED promises numbers: nothing that the typed face calls so is NaN or infinite."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measured_data import pair_robot

from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.core_arrays import sound
from ctrplan.mechanics.shapes import Status
from ctrplan.mechanics.tube import SOFTEST_NM2, STIFFEST_NM2

ROBOT = pair_robot(contact=[{"friction_coefficient": 0.3}])
THETA, L = [0.0, 2.0], [0.0, -0.02]


def assert_promised(status: int, *numbers: object) -> None:
    if status <= Status.MULTIPLE:
        assert all(np.all(np.isfinite(number)) for number in numbers)  # type: ignore[call-overload]


def assert_converged_means_finite(model: Mechanics) -> None:
    solve, zero = model.solve(THETA, L, 1.0), model.zero_clearance(THETA, L)
    for shape in (solve, zero, model.bound(THETA, L).frictionless):
        assert_promised(shape.status, shape.tip_m, shape.tip_tangent, shape.residual, shape.stability, shape.max_strain)
    many, walk = model.bound_many([THETA], [L]), model.check_path([THETA, [0.0, 2.2]], [L, L])
    for found in (many, walk):
        for k, status in enumerate(found.status):
            assert_promised(status, found.tip_m[k], found.tip_tangent[k], found.stability[k], found.max_strain[k])
    tips = model.tips_with_friction([THETA], [L], [[0.5]])
    assert_promised(tips.status[0], tips.position_m, tips.tangent, tips.residual, tips.max_strain)
    assert_promised(int(model.tips([THETA], [L])[2][0]), model.tips([THETA], [L])[0])


STIFFNESS = st.floats(math.log10(SOFTEST_NM2), math.log10(STIFFEST_NM2)).map(lambda x: float(10**x))


@settings(max_examples=40, deadline=None)
@given(stiffness=st.tuples(STIFFNESS, STIFFNESS), ratio=st.tuples(st.floats(-0.9989, 0.5), st.floats(-0.9989, 0.5)))
def test_whatever_the_tubes_converged_means_finite(stiffness: tuple[float, float], ratio: tuple[float, float]) -> None:
    tubes = [
        replace(tube, bending_stiffness_Nm2=EI, poisson_ratio=nu)
        for tube, EI, nu in zip(ROBOT.tubes, stiffness, ratio, strict=True)
    ]
    assert_converged_means_finite(Mechanics(tubes, ROBOT.clearance_m, [0.3]))


@pytest.mark.parametrize(("outer", "inner"), list(itertools.product([SOFTEST_NM2, STIFFEST_NM2], repeat=2)))
def test_at_the_ends_of_the_range_converged_means_finite(outer: float, inner: float) -> None:
    tubes = [replace(t, bending_stiffness_Nm2=EI) for t, EI in zip(ROBOT.tubes, (outer, inner), strict=True)]
    assert_converged_means_finite(Mechanics(tubes, ROBOT.clearance_m, [0.3]))


def test_a_status_with_a_number_that_is_none_has_failed() -> None:
    status = np.array([Status.CONVERGED, Status.CONVERGED, Status.UNSTABLE, Status.FAILED])
    numbers = np.array([[0.0, 1.0], [0.0, math.nan], [math.inf, 0.0], [math.nan, 0.0]])
    assert sound(status, numbers).tolist() == [Status.CONVERGED, Status.FAILED, Status.FAILED, Status.FAILED]
    assert sound(status[:0], numbers[:0]).tolist() == []
