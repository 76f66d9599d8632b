"""Points between the stations of a shape."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from places import ROBOTS

from ctrplan.files.robot_file import load_robot
from ctrplan.mechanics.shapes import points_on_tubes

TUBES = load_robot(ROBOTS / "three_tube.toml").solve([0.0, 0.5, 1.0], [0.0, -0.017, -0.06], [0.5, -1.0]).tubes


@pytest.mark.parametrize("tube", TUBES)
def test_the_slope_along_a_tube_is_its_unit_tangent(tube) -> None:  # type: ignore[no-untyped-def]
    h = 1e-6
    s = np.linspace(tube.s_m[0] + h, tube.s_m[-1] - h, 50)
    (before, _), (_, tangent), (after, _) = (points_on_tubes([tube] * 50, s + side) for side in (-h, 0.0, h))
    np.testing.assert_allclose((after - before) / (2 * h), tangent, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("tube", TUBES)
def test_stations_are_themselves_and_half_of_them_say_where_the_others_are(tube) -> None:  # type: ignore[no-untyped-def]
    some = np.unique([*range(0, len(tube.s_m), 2), len(tube.s_m) - 1])
    half = replace(tube, **{name: getattr(tube, name)[some] for name in ("s_m", "centreline_m", "frames")})
    count = len(tube.s_m)
    np.testing.assert_array_equal(points_on_tubes([tube] * count, tube.s_m)[0], tube.centreline_m)
    np.testing.assert_allclose(points_on_tubes([half] * count, tube.s_m)[0], tube.centreline_m, atol=5e-6)


def test_beyond_its_ends_a_tube_is_nowhere() -> None:
    ends = TUBES[2].s_m[[0, -1]]
    assert np.isnan(points_on_tubes([TUBES[2]] * 2, ends + [-1e-6, 1e-6])).all()
    assert np.isfinite(points_on_tubes([TUBES[2]] * 2, ends + [-1e-12, 1e-12])).all()
