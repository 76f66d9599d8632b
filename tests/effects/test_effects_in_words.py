"""Every effect of the catalogue says its values in words, with the right number, unit and tube."""

from __future__ import annotations

import re

import numpy as np
import pytest
from places import SCENARIOS

from ctrplan.calibration.estimates import Estimate
from ctrplan.effects.effect import CATALOGUE, Effect, two_digits
from ctrplan.files.robot_file import load_robot

ROBOT = load_robot(SCENARIOS / "robots" / "three_tube.toml")
SAID = {
    "joint_scale": ({"theta_2": 0.0498}, "tube 2 turns 5 % too far"),
    "homing_offset": ({"l_1_mm": -1.23}, "tube 1 stands 1.2 mm too far back"),
    "homing_shift": ({"theta_3_2_deg": -4.0}, "after homing 2 tube 3 stands turned by -4 deg"),
    "backlash": ({"theta_2_deg": 8.08}, "the rotation of tube 2 has 8.1 deg of play"),
    "eccentricity": (
        {"sin_2_deg": 3.0, "cos_2_deg": -4.0},
        "the rotation of tube 2 errs by up to 5 deg once a turn",
    ),
    "lag": ({"tau_s": -0.12}, "poses are stamped 0.12 s early"),
    "drive_lag": ({"l_s": 0.07}, "translations follow 0.07 s late"),
    "friction": ({"mu_2": 0.31}, "the friction coefficient of tubes 2 and 3 is 0.31, not 0.2"),
    "clearance": ({"delta_1_mm": -0.01}, "tubes 1 and 2 have 0.01 mm less radial clearance"),
    "shaft_torsion": ({"compliance_1_rad_per_Nm": 10.0}, "the shaft of tube 1 twists by 0.57 deg per N mm"),
    "tip_load": (
        {"force_x_N": 0.03, "force_z_N": -0.04},
        "a force of 0.05 N pulls at the tip along (0.6, 0, -0.8)",
    ),
    "varying_precurvature": (
        {"gradient_3_2": -0.1},
        "section 2 of tube 3 is 10 % less curved at its end than in its middle",
    ),
    "base_misalignment": (
        {"rotation_x_deg": 1.5, "shift_z_mm": 2.0},
        "the base is turned by 1.5 deg and shifted by 2 mm",
    ),
    "kink": ({"along_3_2_2_deg": 3.0, "across_3_2_2_deg": -4.0}, "tube 3 is bent by 5 deg 206 mm from its base"),
    "translation_release": ({"release_per_mm": 0.08}, "a translation of 12 mm leaves a third of the friction"),
}


@pytest.mark.parametrize("name", SAID)
def test_the_number_the_unit_and_the_tube_are_said(name: str) -> None:
    values, clause = SAID[name]
    assert CATALOGUE[name].in_figures(values, ROBOT) == clause


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_every_effect_says_what_it_does_and_not_its_parameters(name: str) -> None:
    """Each parameter on its own and all together: a clause with a number, in words instead of keys."""
    effect = CATALOGUE[name]
    values = {p.name: p.neutral + (-0.4 if p.neutral else 0.7) * min(p.prior, 1.0) for p in effect.parameters(ROBOT)}
    each = [values, *({key: value} for key, value in list(values.items())[:8] if name not in NEEDS_BOTH)]
    for some in each:
        clause = effect.in_figures(some, ROBOT)
        assert type(effect).in_figures is not Effect.in_figures
        assert clause and clause[0].islower() and not clause.endswith(".") and "_" not in clause and len(clause) < 300
        assert re.search(r"\d", clause) and "e-" not in clause and "nan" not in clause


NEEDS_BOTH = ("sensor_distortion",)  # its share of the slope is no length


@pytest.mark.parametrize(
    ("value", "text"),
    [(4.98, "5"), (0.0498, "0.05"), (0.00123, "0.0012"), (-12.6, "-13"), (123.4, "123"), (0.0, "0"), (0.31, "0.31")],
)
def test_two_digits(value: float, text: str) -> None:
    assert two_digits(value) == text


def test_no_interval_has_no_width() -> None:
    assert Estimate(0.6, (0.6, 0.6), at_bound=True).shown_ci95 == "at the end of its range"
    assert Estimate(0.6, (0.6, 0.6)).shown_ci95 == "no interval"
    rng = np.random.default_rng(0)
    for value, half in zip(10.0 ** rng.uniform(-6, 6, 100), 10.0 ** rng.uniform(-9, 2, 100), strict=True):
        low, high = Estimate(value, (value - half, value + half)).shown_ci95.split(" to ")
        assert float(low) < float(high) or value > 1e5 * half * 1e5
