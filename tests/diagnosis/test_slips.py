"""A collar that slipped or a tracker that was knocked, nobody knows when; tubes that are not those of the file; errors
that come and go with time.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from made_up_input import FUZZ
from measured_data import SIGMA_M, measured, pair_robot, waypoints

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.remainder import localise
from ctrplan.diagnosis.slips import LEAST_POSES, after_slip, most_probable_slip
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import term
from ctrplan.reports.diagnosis_words import headline, verdict_sentence

ROBOT = pair_robot()
NOISE = Noise(SIGMA_M, float(np.radians(0.15)))
JOINTS = {"theta_2": (1, np.radians(6.0), True), "l_2": (1, 2e-3, False)}


def at_rest(seed: int, count: int = 40) -> Measurements:
    """Poses at rest, each at a place of its own, three seconds apart."""
    rows = waypoints(ROBOT, count, seed)
    kept = np.flatnonzero(np.isin(np.arange(len(rows.sequence)), rows.rows))[::3]
    theta, l = rows.theta_commanded[kept], rows.l_commanded[kept]  # noqa: E741 (as in the equations)
    n, nothing = len(kept), np.zeros((len(kept), 3))
    return Measurements(np.arange(n), theta, l, np.arange(n), nothing, nothing, 3.0 * np.arange(n))


def with_zero(
    data: Measurements, joint: str, way: Array, values: dict[str, dict[str, float]], seed: int
) -> Measurements:
    """What is measured where a joint's zero is off by so many times (K,) the size of JOINTS."""
    tube, size, is_turn = JOINTS[joint]
    off = np.zeros(data.theta_commanded.shape)
    off[:, tube] = size * way
    theta = data.theta_commanded + (off if is_turn else 0)
    l = data.l_commanded + (0 if is_turn else off)  # noqa: E741 (as in the equations)
    moved = measured(ROBOT, replace(data, theta_commanded=theta, l_commanded=l), values, seed)
    return replace(moved, theta_commanded=data.theta_commanded, l_commanded=data.l_commanded)


def slipped(data: Measurements, joint: str, pose: int, values: dict[str, dict[str, float]], seed: int) -> Measurements:
    """What is measured where a joint's zero is another one from a pose on."""
    return with_zero(data, joint, (np.arange(data.count) >= pose).astype(float), values, seed)


BASE = {"calibration": {"precurvature_factor_1_1": 1.04, "stiffness_factor_2": 0.95}}


@pytest.mark.parametrize("seed", range(40 if FUZZ else 4))
@pytest.mark.parametrize("joint", JOINTS)
def test_a_slip_is_found_where_it_happened(joint: str, seed: int) -> None:
    data = at_rest(seed)
    pose = int(np.random.default_rng(seed).integers(LEAST_POSES, data.count - LEAST_POSES))
    slip = most_probable_slip(ROBOT, slipped(data, joint, pose, BASE, seed), NOISE)
    assert slip is not None and slip.joint.startswith(joint) and abs(slip.pose - pose) <= 1


@pytest.mark.parametrize("seed", range(40 if FUZZ else 3))
def test_a_slip_beside_a_larger_effect_is_found_where_that_is_fitted_too(seed: int) -> None:
    data, turned = (
        at_rest(seed),
        {"base_misalignment": {"rotation_x_deg": 8.0, "rotation_y_deg": -6.0, "shift_y_mm": 9.0}},
    )
    moved = slipped(data, "theta_2", data.count // 2, BASE | turned, seed)
    frame = CATALOGUE["base_misalignment"]
    besides = [term(frame, [q.name for q in frame.parameters(ROBOT)], ROBOT)]
    assert most_probable_slip(ROBOT, moved, NOISE) is None
    slip = most_probable_slip(ROBOT, moved, NOISE, besides)
    assert slip is not None and slip.joint.startswith("theta_2") and abs(slip.pose - data.count // 2) <= 1
    assert most_probable_slip(ROBOT, measured(ROBOT, data, BASE | turned, seed), NOISE, besides) is None


def knocked(data: Measurements, pose: int, seed: int) -> Measurements:
    """What is measured where the tracker was shifted by 2 mm and turned by half a degree before a pose."""
    data, shift = measured(ROBOT, data, BASE, seed), np.array([1.6e-3, -1.0e-3, 0.6e-3])
    later = (np.arange(data.count) >= pose)[:, None]
    turned = np.cross([0.0, 0.0, np.radians(0.5)], data.position_m)
    return replace(data, position_m=data.position_m + later * (shift + turned))


@pytest.mark.parametrize("seed", range(40 if FUZZ else 4))
def test_a_tracker_that_was_knocked_is_found_where_that_happened(seed: int) -> None:
    data = at_rest(seed)
    pose = int(np.random.default_rng(seed).integers(2 * LEAST_POSES, data.count - 2 * LEAST_POSES))
    slip = most_probable_slip(ROBOT, knocked(data, pose, seed), NOISE)
    assert slip is not None and slip.joint == "tracker" and abs(slip.pose - pose) <= 1
    without = [name for name in CATALOGUE if name != "frame_shift"]
    assert most_probable_slip(ROBOT, knocked(data, pose, seed), NOISE, among=without) is None


def test_a_knocked_tracker_is_named_with_its_row_and_the_robot_stays_as_it_is() -> None:
    diagnosis = ctrplan.diagnose(ROBOT, knocked(at_rest(2), 17, 2))
    sentence = verdict_sentence(diagnosis)
    assert [t.name for t in diagnosis.listed] == ["frame_shift"] and "knocked" in headline(diagnosis)
    assert "from row 18 on the tracker is shifted by" in sentence and "tracker" in diagnosis.next_experiment
    assert diagnosis.to_json()["slip"] == {"row": 18, "joint": "tracker"}
    assert diagnosis.gap.after.rms_m < 1.2 * diagnosis.gap.floor_m < diagnosis.gap.before.rms_m / 2


@pytest.mark.parametrize("seed", range(40 if FUZZ else 4))
@pytest.mark.parametrize(
    "values",
    [
        {},
        {"joint_scale": {"theta_2": 0.05}},
        {"base_misalignment": {"rotation_x_deg": 3.0, "shift_y_mm": 4.0}},
        {"tip_load": {"force_x_N": 0.1}},
        {"drift": {"shift_x_mm_per_h": 60.0, "shift_z_mm_per_h": -40.0}},
    ],
    ids=lambda values: "-".join(values) or "nothing",
)
def test_what_is_no_slip_is_told_for_none(values: dict[str, dict[str, float]], seed: int) -> None:
    data = at_rest(seed)
    assert most_probable_slip(ROBOT, measured(ROBOT, data, BASE | values, seed), NOISE) is None


@pytest.mark.parametrize("joint", JOINTS)
def test_a_joint_that_drifts_has_not_slipped(joint: str) -> None:
    data = at_rest(5)
    for way in (np.linspace(-1, 1, data.count), np.cos(np.linspace(0, 2 * np.pi, data.count))):
        assert most_probable_slip(ROBOT, with_zero(data, joint, way, BASE, 1), NOISE) is None


def test_a_slip_is_named_with_its_row_and_is_in_the_json() -> None:
    data = slipped(at_rest(2), "theta_2", 17, BASE, 2)
    diagnosis = ctrplan.diagnose(ROBOT, data)
    sentence = verdict_sentence(diagnosis)
    assert diagnosis.verdict == "named" and "from row 18 on tube 2 stands turned by" in sentence
    assert "slipped" in sentence and "slipped" in headline(diagnosis) and "collar" in diagnosis.next_experiment
    assert diagnosis.to_json()["slip"] == {"row": 18, "joint": "theta_2"}
    assert diagnosis.slip is not None and after_slip(data, diagnosis.slip).homings.max() == 2
    json.dumps(diagnosis.to_json())


def test_a_wrong_tube_is_the_headline() -> None:
    few = {name: CATALOGUE[name] for name in ("off_plane_precurvature", "homing_offset", "backlash", "tip_load")}
    data = measured(ROBOT, at_rest(3), {"calibration": {"precurvature_factor_2_2": 1.6}})
    diagnosis = ctrplan.diagnose(ROBOT, data, catalogue=few)
    (clause,) = diagnosis.other_tubes
    assert clause.startswith("tube 2 is not the tube of the file: 1.59 times") and "as curved" in clause
    assert verdict_sentence(diagnosis).startswith("Tube 2 is not the tube of the file")
    assert headline(diagnosis) == "Tube 2 is not the tube of the file"
    right = ctrplan.diagnose(ROBOT, measured(ROBOT, at_rest(3), BASE), catalogue=few)
    assert right.other_tubes == [] and headline(right) == "Nothing is missing"


def test_errors_that_come_and_go_go_along_with_the_time() -> None:
    """A sine of one and a half periods leaves the means of quarters alike; neighbours in time are alike."""
    data, rng = measured(ROBOT, at_rest(4), BASE), np.random.default_rng(4)
    noise = rng.normal(size=(data.count, 5))
    wave = np.sin(3 * np.pi * np.arange(data.count) / data.count)[:, None] * [1.5, -1.0, 1.0, 0, 0]
    group = np.arange(data.count)
    told = localise(data, noise + wave, group, np.full(data.count, 1e-3), 0.5e-3)
    assert "goes along with the time" in told.sentence and told.trends[0].quantity == "time"
    alone = localise(data, noise, group, np.full(data.count, 1e-3), 0.5e-3)
    assert "goes along with none" in alone.sentence
