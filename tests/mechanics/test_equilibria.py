"""All equilibria at once: laws of the torus, against the core's own solutions and against simulated turns."""

from __future__ import annotations

import copy
import itertools
import json
import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_input import FUZZ
from places import ROBOTS, SCENARIOS
from stated_plans import PAIR, bent, in_si, rvim

import ctrplan
from ctrplan.__main__ import main
from ctrplan.base.arrays import Array
from ctrplan.certificate.certify import certify
from ctrplan.certificate.friction_states import BEYOND_BOUND_M
from ctrplan.certificate.other_equilibria import other_start
from ctrplan.errors import InputError, SolverError
from ctrplan.files.robot_file import load_robot, robot_from_dict
from ctrplan.files.scenario_file import load_scenario
from ctrplan.mechanics.equilibria import SAME_SHAPE_M, Torus, equilibria, is_unique, other_shapes
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.shapes import Status
from ctrplan.planning.goal_states import shape_notes
from ctrplan.reports.live_state import LiveState
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace, bare_scenario
from ctrplan.scenario.scenario import Goal
from ctrplan.storage.toml_document import read_document


def collars(robot: Robot, count: int, seed: int) -> list[tuple[Array, Array]]:
    rows = JointSpace.of_robot(robot).sample(np.random.default_rng(seed), count)
    return [robot.drive.collars(q) for q in rows]


@pytest.mark.parametrize("name", ["table_1_pair", "three_tube", "three_tube_insertion"])
def test_one_of_them_is_what_the_core_solves(name: str) -> None:
    robot = ctrplan.load_robot(ROBOTS / f"{name}.toml")
    for theta, l in collars(robot, 6, 3):  # noqa: E741 (as in the equations)
        known, shape = robot.equilibria(theta, l), robot.zero_clearance(theta, l)
        assert known.is_complete
        assert min(np.linalg.norm(one.tip_m - shape.tip_m) for one in known.each) < 1e-6


def test_numbers_of_stable_and_unstable_ones_differ_by_one_for_a_pair() -> None:
    """Between two wells of energy lies a hill; and where all signs are positive there is one well at any rotation."""
    mild, wound = bent(0.5), bent(2.5)
    place = np.array([0.0, -90e-3])
    for angle in np.linspace(0.1, 2 * np.pi, 8):
        theta = np.array([0.3, 0.3 + angle])
        known = wound.equilibria(theta, place)
        assert known.is_complete and len(known.stable) == 1 + len(known.each) - len(known.stable)
        assert is_unique(mild, place) and len(mild.equilibria(theta, place).each) == 1
    assert bent(6).equilibria([0.0, 2.0], place).is_complete  # on the denser grid
    assert not is_unique(wound, place) and len(wound.equilibria([0.0, np.pi], place).stable) == 2


@pytest.mark.parametrize("name", ["bent", "rvim"])
def test_equilibria_depend_on_nothing_that_is_asked_along_with_them(name: str) -> None:
    """At many collar angles at once, where each search begins at roots of those before it, too; and alone."""
    robot = rvim() if name == "rvim" else bent(2.5)
    alpha = np.random.default_rng(4).uniform(-np.pi, np.pi, (30, robot.n - 1))
    for _, l in collars(robot, 3, 11):  # noqa: E741 (as in the equations)
        together = Torus(robot.tubes, l).all_roots(alpha, [0.0] * len(alpha))
        for (each, degree), at in zip(together, alpha, strict=True):
            alone, own_degree = Torus(robot.tubes, l).roots(at, 0.0)
            assert degree == own_degree == 1
            by_energy = [sorted(row, key=lambda root: root.energy_J) for row in (each, alone)]
            np.testing.assert_allclose(*[[root.tip_m for root in row] for row in by_energy], atol=1e-7)


def test_opposed_tubes_have_two_shapes_that_mirror_each_other() -> None:
    known = bent(2.5).equilibria([0.0, np.pi], np.array([0.0, -90e-3]))
    a, b = known.stable
    assert a.energy_J == pytest.approx(b.energy_J, rel=1e-6)
    np.testing.assert_allclose(a.twist_rad, -b.twist_rad, atol=1e-6)
    np.testing.assert_allclose(a.tip_m, b.tip_m * [1, -1, 1], atol=1e-6)


def test_turning_everything_turns_every_shape() -> None:
    robot, (theta, l) = bent(2.5), (np.array([0.2, 3.0]), np.array([0.0, -90e-3]))  # noqa: E741
    turn = 0.7
    c, s = np.cos(turn), np.sin(turn)
    for one, other in zip(robot.equilibria(theta, l).each, robot.equilibria(theta + turn, l).each, strict=True):
        assert one.energy_J == pytest.approx(other.energy_J) and one.is_stable == other.is_stable
        np.testing.assert_allclose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ one.tip_m, other.tip_m, atol=1e-9)


def test_a_robot_wound_by_a_turn_stands_in_one_of_them() -> None:
    """Simulated without friction, from the other side; the model has clearance, so within half a mm."""
    content = copy.deepcopy(bent(2.5).content)
    frictionless = robot_from_dict({**content, "contact": [{"friction_coefficient": 0.0}]}, file="bent.toml")
    theta, l = np.array([0.0, np.radians(170.0)]), np.array([0.0, -90e-3])  # noqa: E741
    known = frictionless.equilibria(theta, l).stable
    reached = []
    for begin in (0.0, 2 * np.pi):
        history = frictionless.history()
        path = history.follow(np.array([[0.0, begin], theta]), np.array([l, l]))
        reached.append(path.position_m[-1])
        assert min(np.linalg.norm(one.tip_m - path.position_m[-1]) for one in known) < 1.0e-3
    assert np.linalg.norm(reached[0] - reached[1]) > 5e-3


def test_a_start_that_may_be_wound_is_refused_with_the_way_to_unwind_it() -> None:
    at = np.array([0.0, np.radians(170.0), -29.6e-3])  # the inner collar at -90 mm
    free = bare_scenario(bent(2.5))
    said = other_start(free, at)
    assert "another stable equilibrium" in said and "to unwind it turn" in said and "360 deg" in said
    assert "another" not in other_start(replace(free, start_turns="absolute", start_friction="released"), at)


@pytest.mark.parametrize(
    ("factor", "opposed_deg", "from_deg", "at_deg", "friction"),
    [(2.5, 180, 200, 170, "released"), (2.5, 120, 175, 90, "released"), (4, 60, 175, -60, "unknown")],
)
def test_limits_of_joints_do_not_keep_a_start_from_another_branch(
    factor: float, opposed_deg: float, from_deg: float, at_deg: float, friction: Any
) -> None:
    """Within half a turn of home, from where tubes were pushed out on the other side of where they are opposed."""
    robot = bent(factor, opposed_deg=opposed_deg, min_deg=-180, max_deg=180)
    at = np.array([0.0, np.radians(at_deg), -29.6e-3])
    before = (
        at - np.radians([from_deg - at_deg, 0, 0]) if from_deg > 180 else at + np.radians([0, from_deg - at_deg, 0])
    )
    history, bound = robot.history(), robot.bound(*robot.drive.collars(at))
    path = history.follow(*robot.drive.collars(np.array([before, at])))
    assert JointSpace.of_robot(robot).allowed(before) and not path.snaps.any()
    assert np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m) > bound.position_m + 70e-3
    scenario = replace(bare_scenario(robot), start=at, start_friction=friction)
    said = other_start(scenario, at)
    assert "to unwind it turn rotate" in said
    way = {name: np.radians(float(x)) for name, x in re.findall(r"(rotate \w+) by ([-+]\d+) deg", said)}
    there = at + [way.get(name, 0.0) for name in robot.drive.names]
    back = robot.history().follow(*robot.drive.collars(np.array([there, at]))).position_m[-1]
    assert JointSpace.of_robot(robot).allowed(there)
    assert np.linalg.norm(back - bound.frictionless.tip_m) > bound.position_m + 70e-3
    assert not certify(scenario, np.array([at, at + [0, 0, 1e-3]])).valid


def test_a_loaded_robot_is_refused_where_a_turn_within_limits_leads_elsewhere() -> None:
    """Equilibria of a loaded robot are not enumerated: it is simulated from as far as limits let it turn."""
    pair = bent(2.5, opposed_deg=120, min_deg=-180, max_deg=180)
    content = {**pair.content, "effects": {"tip_load": {"force_x_N": 0.05}}}
    robot, at = robot_from_dict(content, file=str(ROBOTS / "loaded.toml")), np.array([0, np.radians(90), -29.6e-3])
    path = np.array([at + [0, np.radians(85), 0], at])
    end, bound = robot.history().follow(*robot.drive.collars(path)), robot.bound(*robot.drive.collars(at))
    assert not end.snaps.any()
    assert np.linalg.norm(end.position_m[-1] - bound.frictionless.tip_m) > bound.position_m + 70e-3
    assert other_start(replace(bare_scenario(robot), start=at, start_friction="released"), at)


def test_a_start_that_is_reached_while_tubes_are_drawn_back_and_turned_is_refused() -> None:
    """Within limits, and by rotations and translations of more than one leg."""
    robot = bent(4, opposed_deg=60, min_deg=-180, max_deg=180)
    way = np.array([[3.142, -3.142, -0.043], [2.791, 1.587, -0.043], [3.106, 0.892, -0.043], [2.48, -0.486, 0.008]])
    way = np.clip(way, robot.drive.lower, robot.drive.upper)
    path = robot.history().follow(*robot.drive.collars(way))
    bound = robot.bound(*robot.drive.collars(way[-1]))
    assert not path.snaps.any() and bound.position_m < 10e-3
    assert np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m) > 100e-3
    assert "another stable equilibrium" in other_start(replace(bare_scenario(robot), start=way[-1]), way[-1])


def test_a_path_on_which_friction_winds_the_robot_up_is_refused_with_the_way_to_unwind_it() -> None:
    """Drawn back, a pair of which friction holds one corner on another branch than the others."""
    robot = bent(4, opposed_deg=60, min_deg=-180, max_deg=180)
    path = np.array([[-0.1695, -0.1643, 0.0331], [-0.1695, -0.1643, -0.0027], [-0.5106, 0.361, -0.0027]])
    scenario = replace(bare_scenario(robot), start=path[0], goal=Goal(joints=path[-1]), start_turns="followed")
    certificate = certify(scenario, path)
    assert not certificate.valid
    said = certificate.problems[0]
    (inner_deg,) = re.findall(r"the robot may be wound up there; to unwind it turn rotate inner by ([-+]\d+) deg", said)
    walker, apart_m = robot.walker(), list[float]()
    for joints in (path[0], path[1], path[1] + [0, np.radians(float(inner_deg)), 0]):
        walker.bound(*robot.drive.collars(joints))
        own = robot.bound(*robot.drive.collars(joints)).corners[1].tip_m
        apart_m.append(float(np.linalg.norm(walker.shapes().corners[1].tip_m - own)))
    assert apart_m[0] < 1e-4 and apart_m[1] > 50e-3 and apart_m[2] < 1e-4


def test_a_corner_of_friction_on_another_branch_than_the_frictionless_shape_refuses_the_motion() -> None:
    """The tip is 101 mm away in the corner, and farther in states before it: a past leaves what the bound says."""
    robot = bent(4, opposed_deg=60, min_deg=-180, max_deg=180)
    at = np.array([2.908, -3.0537, 0.0252])
    bound, history = robot.bound(*robot.drive.collars(at)), robot.history()
    end = history.follow(*robot.drive.collars(np.array([[-3.1415, 3.1415, 0.007], at]))).position_m[-1]
    assert np.linalg.norm(end - bound.frictionless.tip_m) > bound.position_m + BEYOND_BOUND_M
    for turns, friction in itertools.product(("unknown", "absolute", "followed"), ("unknown", "released")):
        scenario = replace(bare_scenario(robot), start=at, start_turns=turns, start_friction=friction)
        for by in ([0, 0, 1e-3], [0, 0.1, 0]):
            certificate = certify(scenario, np.array([at, at + by]))
            assert not certificate.valid and "another" in certificate.problems[0]


@pytest.mark.parametrize("angle_deg", [25, 30, 60, 90])
def test_a_shape_that_friction_alone_holds_refuses_the_start(angle_deg: float) -> None:
    """Without friction the pair has one shape there; after a whole turn, without a snap, friction holds another."""
    curvatures = [f"robot.tube.{i}.section.2.curvature_y_per_m={u}" for i, u in ((1, 3.471), (2, 60.0))]
    scenario = load_scenario(SCENARIOS / "pair_free.toml", curvatures)
    robot, at = scenario.robot, np.array([0.0, np.radians(angle_deg), -0.02])
    theta, l = robot.drive.collars(at)  # noqa: E741 (as in the equations)
    assert len(robot.equilibria(theta, l).stable) == 1
    path = robot.history().follow(np.array([theta + [0, 2 * np.pi], theta]), np.array([l, l]))
    bound = robot.bound(theta, l)
    assert not path.snaps.any()
    assert np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m) > bound.position_m + 50e-3
    assert re.search("with clearance and friction.*oscillated", other_start(scenario, at))
    assert not any(other_start(replace(scenario, start_friction=kind), at) for kind in ("released", "oscillated"))


def test_a_shape_that_friction_holds_beside_a_fold_is_known() -> None:
    """A whole turn leads 83 mm away, without a snap: friction holds the pair there fully loaded, and less does not."""
    robot = bent(2.5)
    at = JointSpace.of_robot(robot).sample(np.random.default_rng(11), 264)[263]
    theta, l = robot.drive.collars(at)  # noqa: E741 (as in the equations)
    history = robot.history()
    path = history.follow(np.array([theta + [0, 2 * np.pi], theta]), np.array([l, l]))
    assert not path.snaps.any() and np.isnan(history.tip_beside([-0.9])[0])
    tip_m = robot.solve(theta, l).tip_m
    (away_m, held), *_ = other_shapes(robot, theta, l, tip_m)
    assert away_m > 80e-3 and held.solved.tolist() == [False, False, True]
    np.testing.assert_allclose(held.tip_m[2], path.position_m[-1], atol=1e-6)
    scenario = bare_scenario(robot)
    shown = LiveState(scenario).at([float(np.degrees(at[0])), float(np.degrees(at[1])), float(at[2] * 1e3)])
    assert shown["other_shape_mm"] == pytest.approx(away_m * 1e3)
    assert "with clearance and friction" in other_start(scenario, at)
    assert not other_start(replace(scenario, start_turns="absolute", start_friction="released"), at)


def test_a_friction_state_that_a_fold_parts_from_every_frictionless_shape_is_on_a_branch() -> None:
    """Four histories to this configuration of RViM end there, and the bound counts it."""
    robot = rvim()
    theta, l = robot.drive.collars(JointSpace.of_robot(robot).sample(np.random.default_rng(12), 1000)[153])  # noqa: E741
    phi = np.vstack([np.zeros(2), corner_signs(2)])
    alone_m = robot.mechanics.tips_with_friction(np.tile(theta, (5, 1)), np.tile(l, (5, 1)), phi).position_m
    own, apart = robot.equilibria(theta, l).branches
    assert own.solved.tolist() == [True, True, False, True, True] and apart.solved.tolist() == [
        False,
        False,
        True,
        False,
        False,
    ]
    np.testing.assert_allclose(apart.tip_m[2], alone_m[2], atol=1e-6)
    assert np.linalg.norm(alone_m[2] - alone_m[0]) == pytest.approx(robot.bound(theta, l).position_m, rel=1e-6)


@pytest.mark.parametrize(("drawn", "turns"), [(60, (0, 1)), (263, (1, -1))])
def test_a_state_that_holds_a_shape_past_the_fold_of_every_other_is_known(drawn: int, turns: tuple[int, int]) -> None:
    """Histories of RViM's robot end there; on the way from collars beside other states meet a fold."""
    robot = rvim()
    theta, l = robot.drive.collars(JointSpace.of_robot(robot).sample(np.random.default_rng(12), 1000)[drawn])  # noqa: E741
    before, history = 2 * np.pi * np.append(0, np.cumsum(turns)), robot.history()
    history.follow(np.array([theta - before, theta]), np.array([l, l]))
    tips = np.array([history.tip_beside(phi) for phi in np.vstack([np.zeros(2), corner_signs(2)])])
    goes_on, known = np.flatnonzero(np.isfinite(tips[:, 0])), robot.equilibria(theta, l).branches
    apart = np.array([np.linalg.norm(branch.tip_m - tips, axis=1) for branch in known])[:, goes_on]
    assert len(goes_on) and np.all(np.nanmin(apart, axis=0) < SAME_SHAPE_M)


@pytest.mark.parametrize("name", ["bent", "bent without friction", "rvim", "three_tube"])
def test_where_a_history_ends_is_solved_again_from_its_shape(name: str) -> None:
    """From whole turns of every pair; where all contacts of a pair are at one end of what friction holds, or free."""
    robot = rvim() if name == "rvim" else load_robot(ROBOTS / f"{name}.toml") if "three" in name else bent(2.5)
    if name == "bent without friction":
        robot = robot_from_dict({**robot.content, "contact": [{"friction_coefficient": 0.0}]}, file="bent.toml")
    drawn, count = JointSpace.of_robot(robot).sample(np.random.default_rng(3), 500 if FUZZ else 40), 0
    for q in drawn if FUZZ else drawn[[5, 15]]:
        theta, l = robot.drive.collars(q)  # noqa: E741 (as in the equations)
        for turns in itertools.product((-1, 0, 1), repeat=robot.n - 1):
            before, history = 2 * np.pi * np.append(0, np.cumsum(turns)), robot.history()
            with suppress(SolverError):
                end = history.advance(theta - before, l) and history.advance(theta, l)
                phi = np.array([pair.phi[np.argmax(pair.force_N)] for pair in end.friction]) * robot.friction.any()
                apart = [np.abs(pair.phi[pair.force_N > 0] - x) for pair, x in zip(end.friction, phi, strict=True)]
                if robot.friction.any() and np.concatenate(apart).max(initial=0.0) > 1e-9:
                    continue
                s_m = np.unique(np.concatenate([tube.s_m for tube in end.shape.tubes]))
                angles = np.array([np.interp(s_m, tube.s_m, tube.theta_rad) for tube in end.shape.tubes])
                again = robot.mechanics.core_solve_from(theta[None], l, phi[None], s_m, angles[None], "search")
                count += 1
                assert again.status[0] == Status.CONVERGED
                np.testing.assert_allclose(again.tip_m[0], end.shape.tip_m, atol=1e-7)
    print(f"{name}: {count} ends")
    assert count > 3


def test_turns_that_count_lead_from_home_to_the_shape_that_is_walked_from() -> None:
    """The inner tube at -314.9 deg is wound up when it was turned there; at 45.1 deg, the same place, it is not."""
    robot = rvim()
    unwound = in_si(robot, [0, 68.2221, 45.0959, -129.4931, -174.9751, -203.5571])
    wound = unwound - [0, 0, 2 * np.pi, 0, 0, 0]
    for at, is_refused in ((unwound, False), (wound, True)):
        scenario = replace(bare_scenario(robot), start=at, start_turns="absolute", start_friction="released")
        said = other_start(scenario, at)
        assert ("straight from home" in said) == ("to unwind it turn r2 by +360 deg" in said) == is_refused
        theta, l = robot.drive.collars(np.array([np.where(robot.drive.is_rotation, 0.0, at), at]))  # noqa: E741
        end = robot.history().follow(theta, l).position_m[-1]
        bound = robot.bound(theta[-1], l[-1])
        assert (np.linalg.norm(end - bound.frictionless.tip_m) > bound.position_m + 5e-3) == is_refused
        assert not other_start(replace(scenario, start_turns="followed"), at)


@pytest.mark.parametrize("name", ["rvim", "bent"])
def test_a_plan_says_which_of_several_shapes_it_is_made_of(name: str) -> None:
    """At its ends; the shape at the end is the one that the robot is in that was driven there from the start."""
    robot = rvim() if name == "rvim" else bent(2.5)
    drawn = JointSpace.of_robot(robot).sample(np.random.default_rng(8), 40)
    several = [q for q in drawn if not is_unique(robot, robot.drive.collars(q)[1])]
    start = several[0]
    goal = start + np.where(robot.drive.is_rotation, 0.0, 1e-3) * (start < robot.drive.upper - 1e-3)
    scenario = replace(bare_scenario(robot), start=start, goal=Goal(joints=goal), start_turns="followed")
    each = robot.equilibria(*robot.drive.collars(goal)).branches
    notes = shape_notes(scenario, [goal])
    driven = robot.history("released").follow(*robot.drive.collars(np.array([start, goal])))
    assert len(each) > 1 and len(notes) == 2 and "At the start" in notes[0] and "At goal" in notes[1]
    said = [float(x) for x in re.findall(r"twisted by \(([^)]*)\)", notes[1])[0].split(",")]
    own = min(each, key=lambda one: float(np.linalg.norm(one.tip_m[one.first] - driven.position_m[-1])))
    np.testing.assert_allclose(said, np.degrees(own.twist_rad[own.first]), atol=0.6)
    assert not shape_notes(bare_scenario(bent(0.5)), [np.array([0.0, 1.0, -29.6e-3])])


def test_robots_of_another_kind_are_refused_in_one_sentence() -> None:
    loaded = robot_from_dict({**PAIR, "effects": {"tip_load": {"force_x_N": 0.1}}}, file=str(ROBOTS / "loaded.toml"))
    with pytest.raises(InputError, match="has loads"):
        equilibria(loaded, [0, 0], [0, -90e-3])
    assert not is_unique(loaded, [0, -90e-3])


@pytest.mark.parametrize(
    ("theta", "l", "sentence"),
    [
        ([0, np.nan, 1], [0, -0.01, -0.02], "theta_b of tube 2 = nan rad: must be finite"),
        ([0, 1, 1], [0, -0.01, -np.inf], "l_b of tube 3 = -inf m: must be finite"),
        ([0, 1, 1], [0, 0.01, 0.02], "l_b of tube 2 = 0.01 m: must lie behind the outer tube's base"),
        ([0, 1, 1], [0, -17, -60], "l_b = -60.0 m: .* are these millimetres"),
    ],
)
def test_collars_that_do_not_nest_have_no_equilibria(theta: list[float], l: list[float], sentence: str) -> None:  # noqa: E741
    """What solves the robot refuses them in these words, too."""
    robot = load_robot(ROBOTS / "three_tube.toml")
    for ask in (robot.solve, robot.equilibria):
        with pytest.raises(InputError, match=sentence) as refused:
            ask(theta, l)
        assert "\n" not in str(refused.value)


def test_ik_and_view_say_that_there_are_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 170 deg the bent pair has two stable shapes; at 20 deg it has one."""
    robot, file = bent(2.5), tmp_path / "bent.toml"
    pair = (ROBOTS / "table_5_pair.toml").read_text("utf-8")
    factor = re.compile(r"(curvature_y_per_m = )([\d.]+)")
    file.write_text(factor.sub(lambda match: f"{match[1]}{2.5 * float(match[2])}", pair), "utf-8")
    at, near = np.array([0.0, np.radians(170.0), -29.6e-3]), np.array([0.0, np.radians(20.0), -29.6e-3])
    state = LiveState(bare_scenario(robot))
    shown = [state.at([0.0, float(np.degrees(q[1])), float(q[2] * 1e3)]) for q in (at, near)]
    assert shown[0]["other_shape_mm"] > 50 and shown[1]["other_shape_mm"] == 0
    tip = robot.zero_clearance(*robot.drive.collars(at)).tip_m * 1e3
    texts = [f"{x:.3f}" for x in tip]
    assert main(["ik", str(file), "--tip-mm", *texts, "--tolerance-mm", "2", "--starts", "60"]) == 0
    assert "in one of several stable shapes (another up to" in capsys.readouterr().out
    assert main(["ik", str(file), "--tip-mm", *texts, "--tolerance-mm", "2", "--starts", "60", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["configurations"]
    assert any(row["other_shape_mm"] and row["other_shape_mm"] > 5 for row in rows)
    assert len(bent(0.5).equilibria([0.0, 1.0], [0.0, -90e-3]).branches) == 1


@pytest.mark.parametrize("name", ["rvim", "bent", "three_tube"])
def test_histories_with_friction_end_on_branches_that_are_known(name: str) -> None:
    """From whole turns of every pair, and from a side; in each friction state that the end of a history goes on to.

    Next to a fold it may be none that is known: then the start is refused, or its bound covers where the history ends.
    """
    three = load_robot(ROBOTS / "three_tube.toml")
    robot = rvim() if name == "rvim" else bent(2.5) if name == "bent" else three
    states, several, complete = np.vstack([np.zeros(robot.n - 1), corner_signs(robot.n - 1)]), 0, list[bool]()
    for q in JointSpace.of_robot(robot).sample(np.random.default_rng(11), 500 if FUZZ else 3):
        theta, l = robot.drive.collars(q)  # noqa: E741 (as in the equations)
        known = robot.equilibria(theta, l).branches
        several += len(known) > 1
        assert len(known) == 1 or not is_unique(robot, l)
        complete.append(True)
        for turns in itertools.product((-1, 0, 1), repeat=robot.n - 1):
            before = 2 * np.pi * np.array(turns) if any(turns) else np.full(robot.n - 1, 1.5)
            begin, history = theta - np.append(0, np.cumsum(before)), robot.history()
            with suppress(SolverError):
                path = history.follow(np.array([begin, theta]), np.array([l, l]))
                if path.status[-1] != Status.CONVERGED:
                    continue
                tips = np.array([history.tip_beside(phi) for phi in states])
                apart = np.array([np.linalg.norm(branch.tip_m - tips, axis=1) for branch in known])
                nearest = np.min(apart, axis=0, where=np.isfinite(apart), initial=np.inf)
                if not nearest.min() < SAME_SHAPE_M:
                    bound, complete[-1] = robot.bound(theta, l), False
                    away = np.linalg.norm(path.position_m[-1] - bound.frictionless.tip_m)
                    assert away <= bound.position_m + BEYOND_BOUND_M or other_start(bare_scenario(robot), q)
                complete[-1] &= bool(np.all(nearest[np.isfinite(tips[:, 0])] < SAME_SHAPE_M))
    print(f"{name}: {sum(complete)} of {len(complete)} complete, {several} with several branches")
    assert (several > 0) == (name != "three_tube" or FUZZ) and sum(complete) >= 0.98 * len(complete)


def test_a_shape_is_solved_again_from_itself_and_turns_with_its_collars() -> None:
    """Each state is a fixed point; whole turns change nothing."""
    robot = rvim()
    theta, l = collars(robot, 1, 11)[0]  # noqa: E741
    looked = [branch for branch in robot.equilibria(theta, l).branches if branch.solved[0]]
    assert len(looked) > 1
    s_m = Torus(robot.tubes, l).shapes(np.zeros((1, 2)), [0.0])[0]
    states = np.vstack([np.zeros(2), corner_signs(2)])
    for branch in looked:
        for turn in (np.zeros(3), 2 * np.pi * np.array([1, 0, -1])):
            has = branch.solved
            shapes = branch.angles_rad[has] + turn[:, None]
            at = np.tile(theta + turn, (len(shapes), 1))
            again = robot.mechanics.core_solve_from(at, l, states[has], s_m, shapes, "search")
            np.testing.assert_array_equal(again.status, Status.CONVERGED)
            np.testing.assert_allclose(again.tip_m, branch.tip_m[has], atol=2e-6)
            assert np.all(again.stability > 0)
    own = min(looked, key=lambda one: abs(one.twist_rad[one.first]).sum())
    bound = robot.bound(theta, l)
    np.testing.assert_allclose(own.tip_m, [shape.tip_m for shape in (bound.frictionless, *bound.corners)], atol=2e-6)


@pytest.mark.parametrize("name", ["table_5_pair", "three_tube", "bent"])
def test_wound_robots_end_in_one_of_them(name: str) -> None:
    """Histories without friction that come from whole turns of every pair end in an enumerated stable shape."""
    content = bent(2.5).content if name == "bent" else read_document(ROBOTS / f"{name}.toml").content
    contacts = [{**contact, "friction_coefficient": 0.0, "clearance_mm": 0.01} for contact in content["contact"]]
    robot, several = robot_from_dict({**content, "contact": contacts}, file=str(ROBOTS / "tight.toml")), 0
    for theta, l in collars(robot, 500 if FUZZ else 3, 5):  # noqa: E741 (as in the equations)
        known = robot.equilibria(theta, l)
        assert known.is_complete
        several += len(known.stable) > 1
        for turns in itertools.product((-1, 0, 1), repeat=robot.n - 1):
            begin = theta - 2 * np.pi * np.concatenate([[0], np.cumsum(turns)])
            with suppress(SolverError):
                end = robot.history().follow(np.array([begin, theta]), np.array([l, l])).position_m[-1]
                assert min(np.linalg.norm(shape.tip_m - end) for shape in known.stable) < 3e-3
    assert (several > 0) == (name == "bent")
