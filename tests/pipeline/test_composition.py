"""Effects of one stage compose: two of them act one after the other, and none displaces another."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from effect_values import continuous_motion, effects, pairs_of, table
from measured_data import pair_robot

from ctrplan.drive.legs import Collars
from ctrplan.effects.clock.lag import Lag
from ctrplan.effects.drive.backlash import Backlash
from ctrplan.effects.effect import CATALOGUE, Stage
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.joint_path import JointPath
from ctrplan.measurement.measurements import Poses, frames_along
from ctrplan.pipeline.chain import Acting, Chain, with_chain
from ctrplan.robot.robot import Robot
from ctrplan.studies.simulate import simulate

PLAIN = pair_robot(contact=[{"friction_coefficient": 0.1}])
DATA = continuous_motion()
RNG = np.random.default_rng(3)
POSES = Poses(RNG.uniform(-0.05, 0.15, (12, 3)), frames_along(np.tile([0.0, 0.6, 0.8], (12, 1)), np.eye(3)[[0] * 12]))
DIRECTIONS = RNG.choice([-1.0, 1.0], (12, 4))


def of(stage: Stage) -> list[str]:
    return [name for name, effect in CATALOGUE.items() if effect.stage == stage]


def chain_of(*names: str) -> Chain:
    return Chain.of(robot_from_dict({**PLAIN.content, "effects": effects(names, PLAIN)}))


@pytest.mark.parametrize(("first", "second"), list(itertools.permutations(of("drive"), 2)))
def test_of_the_drive(first: str, second: str) -> None:
    commanded = Collars(DATA.theta_commanded, DATA.l_commanded)
    found = chain_of(first, second).drive(commanded, DIRECTIONS)
    between = chain_of(first).drive(commanded, DIRECTIONS)
    expected = chain_of(second).drive(between, DIRECTIONS)
    np.testing.assert_array_equal(found.theta, expected.theta)
    np.testing.assert_array_equal(found.l, expected.l)
    acted = np.abs(found.theta - between.theta).max() > 0
    assert acted == (second != "homing_shift")  # whose zeros are those of later homings


@pytest.mark.parametrize(("first", "second"), list(itertools.permutations(of("sensor"), 2)))
def test_of_the_sensor(first: str, second: str) -> None:
    found = chain_of(first, second).sensor(POSES, DATA)
    expected = chain_of(second).sensor(chain_of(first).sensor(POSES, DATA), DATA)
    np.testing.assert_array_equal(found.position, expected.position)
    np.testing.assert_array_equal(found.frame, expected.frame)


@pytest.mark.parametrize(("first", "second"), pairs_of(of("mechanics")))
def test_of_the_mechanics(first: str, second: str) -> None:
    """What either of them changes is changed when both act."""
    alone = [chain_of(name).mechanics for name in (first, second)]
    both = chain_of(first, second).mechanics
    for robot in alone:
        for changed, plain, found in zip(robot.tubes, PLAIN.tubes, both.tubes, strict=True):
            for field in ("ovality", "softening_strain", "shaft_compliance_rad_per_Nm", "density_kg_m3"):
                if getattr(changed, field) != getattr(plain, field):
                    assert getattr(found, field) == getattr(changed, field)
            for a, b, c in zip(changed.sections, plain.sections, found.sections, strict=True):
                assert a == b or c != b
        if robot.loads != PLAIN.loads:
            assert both.loads != PLAIN.loads
    for field in ("friction", "clearance_m"):
        plain = getattr(PLAIN, field)
        changed = np.any([getattr(robot, field) != plain for robot in alone], axis=0)
        np.testing.assert_array_equal(getattr(both, field) != plain, changed)


class SecondLag(Lag):
    """Another clock."""

    name = "second_lag"


class SecondPlay(Backlash):
    """More play, in a coupling."""

    name = "second_play"


def test_of_the_clock() -> None:
    lags = (Acting(Lag(), {"tau_s": 0.05}), Acting(SecondLag(), {"tau_s": 0.12}))
    found = Chain(PLAIN, lags).clock(DATA)
    expected = Chain(PLAIN, (Acting(Lag(), {"tau_s": 0.17}),)).clock(DATA)
    np.testing.assert_allclose(found.theta, expected.theta, atol=1e-12)


def test_play_of_two_effects_adds_up() -> None:
    """Once the second replaced the first: 2 deg became 0.5."""
    widths = ((Backlash(), 2.0), (SecondPlay(), 0.5))
    play = tuple(Acting(effect, {"theta_2_deg": np.radians(width)}) for effect, width in widths)
    robot = with_chain(PLAIN, Chain(PLAIN, play))
    assert robot.drive.play is not None
    np.testing.assert_allclose(np.degrees(robot.drive.play[0, :2]), [0, 1.25])


def timeless_path() -> JointPath:
    return JointPath(DATA.theta_commanded, DATA.l_commanded, DATA.sequence, file="path.csv")


def test_a_sensor_effect_without_its_column_leaves_the_others_at_work() -> None:
    """Once it took all of them out of a simulation."""
    both, one = (robot_from_dict({**PLAIN.content, "effects": effects(names, PLAIN)}) for names in (
        ("base_misalignment", "drift"), ("base_misalignment",)))  # fmt: skip
    found, expected = simulate(both, timeless_path()), simulate(one, timeless_path())
    assert found.measured is not None and expected.measured is not None
    np.testing.assert_array_equal(found.measured.position, expected.measured.position)
    assert [sentence for sentence in found.warnings if "drift is left out" in sentence]
    assert not expected.warnings


def test_the_clock_is_one_hook_for_simulations_and_fits() -> None:
    """A late clock reports what a simulation of the path had that much earlier; fits ask the joints of then."""
    late = robot_from_dict({**PLAIN.content, "effects": {"lag": {"tau_s": 0.15}}})
    path = replace(timeless_path(), time_s=DATA.time_s)
    found = simulate(late, path)
    assert found.measured is not None
    fitted = Chain.of(late).clock(DATA)
    place = np.interp(DATA.time_s - 0.15, DATA.time_s, np.arange(12))  # type: ignore[operator]
    np.testing.assert_allclose(fitted.theta[:, 1], np.interp(place, np.arange(12), DATA.theta_commanded[:, 1]))
    expected = np.column_stack([np.interp(place, found.place, x) for x in found.position_m.T])
    np.testing.assert_allclose(found.measured.position[found.waypoints], expected, atol=1e-5)


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters_that_are_not_named_are_neutral(name: str) -> None:
    """A file may name any of an effect's parameters, or none."""
    every = table(name, PLAIN)
    neutral = {p.name: p.neutral for p in CATALOGUE[name].parameters(PLAIN)}
    for chosen in ({}, *({key: value} for key, value in list(every.items())[:12])):
        few, full = (Chain.of(_robot(name, values)) for values in (chosen, neutral | chosen))
        assert few.delay_s == full.delay_s
        np.testing.assert_allclose(few.release_m, full.release_m)
        a, b = (c.drive(Collars(DATA.theta_commanded, DATA.l_commanded), DIRECTIONS) for c in (few, full))
        np.testing.assert_allclose(a.theta, b.theta, atol=1e-12)
        np.testing.assert_allclose(a.l, b.l, atol=1e-12)
        seen, expected = (c.sensor(POSES, DATA).position for c in (few, full))
        np.testing.assert_allclose(seen, expected, atol=1e-12)
        tips = [c.mechanics.solve(DATA.theta_commanded[3], DATA.l_commanded[3]).tip_m for c in (few, full)]
        np.testing.assert_allclose(*tips, atol=5e-6)


def _robot(name: str, values: dict[str, float]) -> Robot:
    return robot_from_dict({**PLAIN.content, "effects": {name: values}})
