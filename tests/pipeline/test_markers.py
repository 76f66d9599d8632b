"""Markers along the body: what they say is what a tip would say there, and what a tip alone can't."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_data import SIGMA_M, chain_of, measured, pair_robot, waypoints
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.calibration.calibrate import calibrate
from ctrplan.calibration.parameters import NamedParameters
from ctrplan.calibration.residuals import Noise, residuals
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

NOISE = Noise(SIGMA_M, 0.05)
MARKERS = [
    {"name": "nose", "tube": 2, "from_tip_mm": 0},
    {"name": "nearly", "tube": 2, "from_tip_mm": 1e-3},
    {"name": "middle", "tube": 2, "from_tip_mm": 25},
    {"name": "ring", "tube": 1, "from_base_mm": 50},
]
EVERY_STAGE: dict[str, list[str] | None] = {
    "homing_offset": None,
    "friction": None,
    "clearance": None,
    "tip_load": ["force_x_N"],
    "relaxation": None,
    "precurvature_loss": None,
    "base_misalignment": None,
}


def marked(**keys: Any) -> Robot:
    return pair_robot(marker=MARKERS, contact=[{"friction_coefficient": 0.15}], **keys)


def of(data: Measurements, *markers: int) -> Measurements:
    """Poses of some markers in the place of the tip's, 0 for the tip itself."""
    count = len(markers)
    return replace(
        data,
        rows=np.tile(data.rows, count),
        position_m=np.tile(data.position_m, (count, 1)),
        tangent=np.full((count * data.count, 3), np.nan),
        marker=np.repeat(markers, data.count),
    )


def seen(robot: Robot, data: Measurements, values: dict[str, dict[str, float]], seed: int = 3) -> Measurements:
    """Measurements of the poses by a chain with these values, with noise."""
    chain = chain_of(robot, data, {name: list(v) for name, v in values.items() if name != "calibration"})
    p = chain.neutral.copy()
    for t, place in zip(chain.terms, chain.slices(), strict=True):
        for j, q in zip(range(place.start, place.stop), t.parameters, strict=True):
            p[j] = values.get(t.name, {}).get(q.name, q.neutral) * q.si
    position = chain.predict(p, derivatives=False).position_m
    return replace(data, position_m=position + SIGMA_M * np.random.default_rng(seed).standard_normal(position.shape))


def test_a_marker_at_the_tip_says_exactly_what_a_position_of_the_tip_says() -> None:
    robot, data = marked(), measured(marked(), waypoints(marked(), 2))
    chains = [chain_of(robot, of(data, number), EVERY_STAGE) for number in (0, 1)]
    tip, nose = (chain.predict(chain.start) for chain in chains)
    for name in ("position_m", "position_by", "sound"):
        np.testing.assert_array_equal(getattr(nose, name), getattr(tip, name))
    found = [residuals(c.data, c.predict(c.start), NOISE, c.data.configuration) for c in chains]
    np.testing.assert_array_equal(found[0].r, found[1].r)
    np.testing.assert_array_equal(found[0].J, found[1].J)


def test_differences_of_a_marker_beside_the_tip_are_the_exact_derivatives_of_the_tip() -> None:
    robot, data = marked(), waypoints(marked(), 1)
    chains = [chain_of(robot, of(data, number), EVERY_STAGE) for number in (0, 2)]
    tip, nearly = (chain.predict(chain.start) for chain in chains)
    np.testing.assert_allclose(nearly.position_m, tip.position_m, atol=1.01e-6)
    prior = chains[0].prior
    for j, name in enumerate(parameter.name for parameter in chains[0].parameters):
        exact, differenced = (found.position_by[:, :, j] * prior[j] for found in (tip, nearly))
        size = max(float(np.abs(exact).max()), 1e-6)
        np.testing.assert_allclose(differenced, exact, atol=0.01 * size, err_msg=name)


def test_a_finer_mesh_and_a_history_correct_a_marker_beside_the_tip_as_the_tip() -> None:
    robot, data = marked(), waypoints(marked(), 1)
    moving = replace(data, rows=np.arange(len(data.sequence)), is_stream=True, **_blank(len(data.sequence)))
    for plan in (data, moving):
        chains = [chain_of(robot, of(plan, number), {}) for number in (0, 2)]
        tip, nearly = (friction_correction(chain, chain.neutral) for chain in chains)
        assert tip is not None and nearly is not None and np.abs(tip.shift_m).max() > 1e-6
        np.testing.assert_allclose(nearly.shift_m, tip.shift_m, atol=1e-7)


def _blank(count: int) -> dict[str, Array]:
    return {"position_m": np.zeros((count, 3)), "tangent": np.zeros((count, 3))}


def test_a_frame_that_stands_elsewhere_moves_markers_as_rigidly_as_tips() -> None:
    robot, data = marked(), of(waypoints(marked(), 2), 0, 3, 4)
    chain = chain_of(robot, data, {"base_misalignment": None})
    here, moved = chain.neutral, chain.neutral.copy()
    names = [parameter.name for parameter in chain.parameters]
    moved[names.index("shift_y_mm")], moved[names.index("rotation_x_deg")] = 2e-3, 0.1
    before, after = (chain.predict(p, derivatives=False).position_m for p in (here, moved))
    turn = Rotation.from_rotvec([0.1, 0.0, 0.0])
    np.testing.assert_allclose(after, turn.apply(before) + [0.0, 2e-3, 0.0], atol=1e-12)


def test_a_sensor_beside_the_tip_is_not_beside_the_markers() -> None:
    robot, data = marked(), of(waypoints(marked(), 2), 0, 3, 4)
    chain = chain_of(robot, data, {"sensor_offset": ["offset_x_mm", "offset_y_mm", "offset_z_mm"]})
    offset = chain.neutral.copy()
    offset[-3:] = [1e-3, 0.0, 0.0]
    moved = chain.predict(offset).position_m - chain.predict(chain.neutral).position_m
    np.testing.assert_allclose(np.linalg.norm(moved[data.seen_marker == 0], axis=1), 1e-3, rtol=1e-9)
    assert not moved[data.seen_marker > 0].any()


def rotating_tube() -> tuple[Robot, Measurements]:
    """One tube that only turns: of every turn its tip has a height and a distance from the axis, nothing else."""
    section = {"length_mm": 100, "curvature_x_per_m": 0, "curvature_y_per_m": 8.0}
    tube = {"outer_diameter_mm": 2, "inner_diameter_mm": 1.5, "bending_stiffness_Nm2": 0.02, "poisson_ratio": 0.3}
    marker = [{"name": "middle", "tube": 1, "from_base_mm": 50}]
    robot = robot_from_dict({"name": "one", "tube": [tube | {"section": [section]}], "marker": marker})
    theta = np.linspace(0.0, 5.0, 12)[:, None]
    nothing = np.zeros((12, 3))
    return robot, Measurements(np.arange(12), theta, np.zeros((12, 1)), np.arange(12), nothing, nothing)


@pytest.mark.parametrize(("markers", "told"), [((0,), 2), ((0, 1), 3)])
def test_a_marker_tells_length_and_change_of_precurvature_apart(markers: tuple[int, ...], told: int) -> None:
    """The tip alone tells two numbers of three: precurvature, its change along the tube, and the length."""
    robot, data = rotating_tube()
    names = [f"tube.1.section.1.{key}" for key in ("curvature_y_per_m", "gradient", "length_m")]
    sizes = dict(zip(names, (0.5, 0.1, 2e-3), strict=True))
    term = Term(named := NamedParameters(names, sizes, {}), named.parameters(robot))
    chain = ParametricChain(robot, of(data, *markers), [term])
    J = (chain.predict(chain.neutral).position_by * chain.prior).reshape(-1, 3) / SIGMA_M
    values = np.linalg.svd(J, compute_uv=False)
    assert (values > 1.0).sum() == told
    assert values[2] < 1e-3 * values[0] or told == 3


def test_markers_alone_calibrate_a_robot_whose_tip_nobody_sees() -> None:
    robot, plan = marked(), waypoints(marked(), 5)
    true = {"calibration": {"precurvature_factor_1_1": 1.2, "precurvature_factor_2_2": 0.85}}
    data = seen(robot, of(plan, 3, 4), true)
    missing = np.arange(data.count) % 7 == 0  # seen now and then by nobody
    flat = replace(
        data, position_m=np.where((data.seen_marker == 4)[:, None] & [False, True, False], np.nan, data.position_m)
    )
    names = list(true["calibration"])
    fitted = calibrate(robot, flat.subset(~missing), names, held_out=0)
    for name, value in true["calibration"].items():
        low, high = fitted.estimates[name].ci95
        assert low - 0.01 < value < high + 0.01 and high - low < 0.05
    assert fitted.training.rms_m < 2 * SIGMA_M < fitted.nominal.rms_m / 2


def test_a_marker_seen_less_exactly_counts_less() -> None:
    robot, plan = marked(), of(waypoints(marked(), 2), 3)
    chain = chain_of(robot, plan, {})
    data = replace(plan, position_m=plan.position_m + 1e-3)
    whole, half = (
        residuals(d, chain.predict(chain.neutral), NOISE, np.arange(d.count))
        for d in (data, replace(data, noise_ratio=np.full(data.count, 2.0)))
    )
    np.testing.assert_allclose(half.raw_norm, whole.raw_norm / 2, rtol=1e-12)


def test_derivatives_of_markers_are_asked_anew_where_the_robot_has_moved() -> None:
    """Derivatives are remembered while a fit hardly moves, and equal those of a fresh chain once it has moved."""
    robot, plan = marked(), of(waypoints(marked(), 1), 3)
    chain = chain_of(robot, plan, {"homing_offset": None})
    near, far = (chain.neutral + share * chain.prior for share in (-0.001, -0.5))
    first = chain.predict(chain.neutral).position_by
    np.testing.assert_array_equal(chain.predict(near).position_by, first)
    fresh = chain_of(robot, replace(plan, file="another"), {"homing_offset": None})
    np.testing.assert_array_equal(chain.predict(far).position_by, fresh.predict(far).position_by)
    exact = fresh.predict(near).position_by * chain.prior
    np.testing.assert_allclose(first * chain.prior, exact, atol=0.01 * np.abs(exact).max())
