"""Robots and scenarios made in code: what files may say and nothing else, and files that are read as they are."""

from __future__ import annotations

import copy
import math
import operator
import pickle
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROBOTS, SCENARIOS

import ctrplan
from ctrplan.errors import InputError
from ctrplan.files.plan_inputs import inputs_of


def pair(**changes: Any) -> ctrplan.Robot:
    outer = ctrplan.Tube(2.4e-3, 2e-3, 0.08, 0.3, [ctrplan.Section(0.12, 0, 4)])  # type: ignore[arg-type]
    bent = [ctrplan.Section(0.07, 0, 0), ctrplan.Section(0.08, 0, 12)]
    inner = ctrplan.Tube(1.9e-3, 1.5e-3, 0.03, 0.3, bent, collar_length_m=0.015)  # type: ignore[arg-type]
    given = {"name": "pair", "tubes": [outer, inner], "contacts": [ctrplan.Contact(0.2)]} | changes  # type: ignore[arg-type]
    return ctrplan.Robot(**given)


def scenario(**changes: Any) -> ctrplan.Scenario:
    robot = changes.pop("robot", None) or pair()
    goal = ctrplan.Goal(joints=[0, math.pi / 2, 0, 0])  # type: ignore[arg-type]
    given = {"name": "made", "robot": robot, "start": [0, 0, 0, 0], "goal": goal} | changes
    return ctrplan.Scenario(**given)


def read(folder: Path, text: str, name: str = "read.toml") -> Path:
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.parametrize("file", sorted(ROBOTS.glob("*.toml")), ids=lambda file: file.stem)
def test_a_robot_is_read_from_its_text_as_it_is(file: Path, tmp_path: Path) -> None:
    robot = ctrplan.load_robot(file)
    again = ctrplan.load_robot(read(tmp_path, robot.to_toml()))
    assert (again.sha256_of, again.name) == (robot.sha256_of, robot.name)
    assert again.to_toml() == robot.to_toml()


@pytest.mark.parametrize("file", sorted(SCENARIOS.glob("*.toml")), ids=lambda file: file.stem)
def test_a_scenario_is_read_from_its_text_as_it_is(file: Path) -> None:
    there = ctrplan.load_scenario(file)
    text = there.to_toml()
    again = ctrplan.scenario_from_dict(content(text), file=str(file))
    assert (again.sha256_of, again.name, again.planner) == (there.sha256_of, there.name, there.planner)
    assert again.to_toml() == text


def content(text: str) -> dict[str, Any]:
    from ctrplan.storage.toml_document import parsed_toml

    return parsed_toml(text, "text")


def test_effects_and_intervals_are_said_too(tmp_path: Path) -> None:
    """Effects are at work in tubes, contacts and drive, and written as the file's tables, not twice."""
    keys = [
        "effects.tip_load={force_x_N=0.2, ci95={force_x_N=[0.1, 0.3]}}",
        "effects.backlash={theta_2_deg=1}",
        "effects.clearance={delta_1_mm=0.01}",
        'uncertainty.ci95={"tube.2.poisson_ratio"=[0.2, 0.4], "contact.1.clearance_mm"=[0.03, 0.07]}',
        "measurement={position_sigma_mm=0.3, tangent_sigma_deg=0.7}",
        'marker=[{name="ring", tube=2, from_tip_mm=7.3}]',
        "execution={rotation_deg=0.3}",
    ]
    robot = ctrplan.load_robot(ROBOTS / "three_tube.toml", keys)
    assert robot.ideal is not None
    again = ctrplan.load_robot(read(tmp_path, robot.to_toml()))
    assert again.sha256_of == robot.sha256_of
    assert robot.with_(name="other").sha256_of == robot.sha256_of
    made = ctrplan.Robot(robot.name, again.ideal.tubes, again.ideal.contacts, effects=robot.effects)  # type: ignore[union-attr]
    assert made.loads == robot.loads and made.ideal is not None


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3), st.floats(-math.pi, math.pi), st.floats(1e-4, 0.1))
def test_numbers_made_in_code_are_read_to_the_last_digit(tip: list[float], turn: float, tolerance: float) -> None:
    """A unit is a factor: of some numbers no number of millimetres or degrees is read as the same one."""
    place = np.add(tip, [0.35, 0, 0])  # nearer to the base it would be taken for metres
    made = scenario(start=[turn, 0, 0, 0], goal=ctrplan.Goal(tip_m=place, tolerance_m=tolerance))
    again = ctrplan.scenario_from_dict(content(made.to_toml()))
    for here, there in ((made.start, again.start), (made.goal.tip_m, again.goal.tip_m)):
        np.testing.assert_allclose(there, here, rtol=3e-16, atol=0)
    assert again.goal.tolerance_m == pytest.approx(tolerance, rel=3e-16)


def test_what_is_made_in_code_is_what_the_file_makes(tmp_path: Path) -> None:
    robot = pair()
    assert robot.drive.names == ("rotate 1", "rotate 2", "translate 1", "translate 2")
    assert ctrplan.load_robot(read(tmp_path, robot.to_toml())).sha256 == robot.sha256
    line = ctrplan.Goal(line_m=[[0.02, 0, 0.12], [0.03, 0, 0.12]], tolerance_m=1e-3)  # type: ignore[arg-type]
    made = scenario(
        robot=robot,
        goal=line,
        anatomy=[
            ctrplan.Anatomy(ctrplan.Sphere([0, 0, 0.3], 0.01), margin_m=1e-3),
            ctrplan.Anatomy(ctrplan.Capsule([0.1, 0, 0], [0.1, 0, 0.1], 0.005)),
            ctrplan.Anatomy(ctrplan.Box([-0.1, -0.1, -0.1], [-0.08, 0.1, 0.2])),
        ],
        base_R=[[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        planner=ctrplan.RRTConnect(time_s=2),
        cost=ctrplan.Cost(error_goal=3, max_error_goal_m=2e-3),
    )
    assert [goal.table for goal in made.targets] == ["goal", "goal"] and made.via[0].tip_key == "line_mm.1"
    again = ctrplan.load_scenario(read(tmp_path, made.to_toml()))
    assert again.sha256_of == made.sha256_of and again.planner == made.planner
    assert pickle.loads(pickle.dumps(made)).sha256 == made.sha256
    assert inputs_of(made) is not None  # so that its plans travel


def block(shift_m: float = 0.1) -> ctrplan.Mesh:
    """A cube of 10 mm beside the robot, its corners in no order and its triangles turned inward."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])[::-1] * 0.01 + [0, shift_m, 0.1]
    sides = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    sides += [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    return ctrplan.Mesh(corners, np.array(sides)[:, ::-1])


def test_overrides_leave_bodies_of_arrays_and_terms_as_they_are() -> None:
    term = ctrplan.CostTerm("turned", 5, lambda joints: np.abs(joints[:, 0]))
    made = scenario(anatomy=[ctrplan.Anatomy(block())], terms=[term])
    changed = made.with_("goal.tolerance_mm=0.5", "planner.time_s=2")
    assert changed.goal.tolerance_m == 0.5e-3 and changed.planner.time_s == 2
    assert changed.anatomy == made.anatomy and changed.terms == made.terms
    with pytest.raises(InputError, match="a mesh made of arrays stands in no scenario file"):
        made.with_("frame=LPS")  # which would place bodies anew


def test_plans_beside_a_mesh_of_arrays_are_saved_and_opened(tmp_path: Path) -> None:
    sheet = ctrplan.Sheet([[0.2, 0, 0], [0.2, 0, 0.1], [0.2, 0.1, 0]], [[0, 1, 2]])  # type: ignore[arg-type]
    made = scenario(anatomy=[ctrplan.Anatomy(block()), ctrplan.Anatomy(sheet)])
    ctrplan.plan(made, time_s=1).save(tmp_path / "plan", report=False)
    opened = ctrplan.open_plan(tmp_path / "plan")
    assert opened.scenario.sha256 == made.sha256


@pytest.mark.parametrize("kind", [ctrplan.Volume, partial(ctrplan.Mesh, surface_error_m=1e-4)])
def test_plans_beside_what_no_file_says_are_opened_by_their_scenario(kind: Callable[..., Any], tmp_path: Path) -> None:
    made = scenario(anatomy=[ctrplan.Anatomy(kind(block().vertices_m, block().faces))])
    ctrplan.plan(made, time_s=1).save(tmp_path / "plan", report=False)
    with pytest.raises(InputError, match="give the scenario that was planned"):
        ctrplan.open_plan(tmp_path / "plan")
    assert ctrplan.load_plan(tmp_path / "plan", made).scenario is made


def test_numbers_of_numpy_are_those_of_python() -> None:
    single = np.float32(2.4e-3)
    section = ctrplan.Section(np.float64(0.12), np.int64(0), np.int64(4))  # type: ignore[arg-type]
    tube = replace(pair().tubes[0], outer_diameter_m=single, sections=(section,))
    robot = pair(tubes=[tube, pair().tubes[1]], contacts=[ctrplan.Contact(np.float32(0.2))])  # type: ignore[arg-type]
    made = scenario(robot=robot, cost=ctrplan.Cost(path=np.float32(2)))  # type: ignore[arg-type]
    assert ctrplan.scenario_from_dict(content(made.to_toml())).sha256 == made.sha256


GOOD = {"start": [0, 0, 0, 0]}
TURNED = np.diag([-1.0, 1.0, 1.0])
REFUSED = {
    "goal: must have one of joints, tip_m and line_m.": lambda: ctrplan.Goal(),
    "error_goal = -1: must be from 0 to 1e+06.": lambda: ctrplan.Cost(error_goal=-1),
    "time_s = -1 s: must be above 0 and at most 3600.": lambda: ctrplan.BITStar(time_s=-1),
    "base_R: must be a rotation, this one mirrors: turn one axis round.": lambda: scenario(base_R=TURNED),
    "tip_m: must be numbers, not texts.": lambda: ctrplan.Goal(tip_m=["a", "b", "c"]),  # type: ignore[arg-type]
    "start: must have one value per joint, shape (4,), not (3,).": lambda: scenario(start=[0, 0, 0]),
    "start.translate 1 = 300.0 mm: must be within the joint's limits": lambda: scenario(start=[0, 0, 0.3, 0]),
    "goal.joints: the base of tube 2": lambda: scenario(goal=ctrplan.Goal([0, 0, -0.05, 0])),  # type: ignore[arg-type]
    "goal.direction_tolerance_deg: is missing": lambda: scenario(
        goal=ctrplan.Goal(tip_m=[0, 0, 0.1], direction=[0, 0, 2])  # type: ignore[arg-type]
    ),
    "tube.2.outer_diameter_mm = 2.6 mm: must be smaller than tube.1.inner_diameter_mm": lambda: pair(
        tubes=[pair().tubes[0], replace(pair().tubes[1], outer_diameter_m=2.6e-3)]
    ),
    "tube.1.poisson_ratio = -2.0: must be": lambda: pair(
        tubes=[replace(pair().tubes[0], poisson_ratio=-2.0), pair().tubes[1]]
    ),
    "contact.1.friction_coefficient = 3.0: must be": lambda: pair(contacts=[ctrplan.Contact(3.0)]),  # type: ignore[arg-type]
    "contacts = 0: must be 1": lambda: pair(contacts=()),
    "tubes = 3: must be a list of Tube objects.": lambda: pair(tubes=3),
    "shape = 'sphere': must be a PartShape.": lambda: ctrplan.Anatomy("sphere"),  # type: ignore[arg-type]
    "upper_m = [0.0, 0.0, 0.0] m: must exceed lower_m.": lambda: ctrplan.Box([0, 0, 0], [0, 0, 0]),  # type: ignore[arg-type]
    "colour: is no field of a Robot: those are": lambda: pair().with_(colour=3),
    "cost.colour = 3: unknown key": lambda: scenario().with_("cost.colour=3"),
    "kind = 'spin': must be": lambda: ctrplan.Joint("a", "spin", [1, 0]),  # type: ignore[arg-type]
    "moves of a = [1.0]: must be a list of 2 finite numbers.": lambda: ctrplan.Drive(
        (ctrplan.Joint("a", "rotation", [1.0]),),
        [0, 0],
        [0, 0],  # type: ignore[arg-type]
    ),
    "loads: stands in no robot file by itself": lambda: pair(loads=ctrplan.Loads((0.1, 0, 0))).to_toml(),
    "anatomy.1: a mesh made of arrays stands in no scenario file": lambda: scenario(
        anatomy=[ctrplan.Anatomy(block())]
    ).to_toml(),
    "faces: is not closed: has 3 open edges": lambda: ctrplan.Mesh([[0, 0, 1], [1, 0, 1], [0, 1, 1]], [[0, 1, 2]]),  # type: ignore[arg-type]
    "length_m = '0.12': must be a number.": lambda: ctrplan.Section("0.12", 0, 4),  # type: ignore[arg-type]
    "outer_diameter_m = [0.0024]: must be a number.": lambda: replace(
        pair().tubes[0],
        outer_diameter_m=np.array([2.4e-3]),  # type: ignore[arg-type]
    ),
    "name = None: must be a text.": lambda: pair(name=None),
    "drive = [3]: must be a Drive.": lambda: pair(drive=[3]),
    "measurement = [0.3, 0.4]: must be a SensorNoise.": lambda: pair(measurement=[0.3, 0.4]),
    "joints: must hold one joint at least.": lambda: ctrplan.Drive((), [0, 0], [0, -0.015]),  # type: ignore[arg-type]
    "planner = 'RRT*': must be a PlannerSettings.": lambda: scenario(planner="RRT*"),
    "cost = {'path': 1}: must be a Cost.": lambda: scenario(cost={"path": 1}),
    "tube.1.outer_diameter_mm = 2400.0 mm: must be above 0 and at most 1000; lengths in code are in metres: is 2.4 in "
    "millimetres?": lambda: pair(tubes=[replace(pair().tubes[0], outer_diameter_m=2.4), pair().tubes[1]]),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_no_file_may_say_is_refused_in_a_sentence(sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        REFUSED[sentence]()
    assert str(refused.value).startswith(sentence)


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("cost.error_goal=-1", lambda: {"cost": ctrplan.Cost(error_goal=-1)}),
        ("margins.max_strain=2", lambda: {"margins": ctrplan.Margins(max_strain=2)}),
        ("planner.time_s=0", lambda: {"planner": ctrplan.BITStar(time_s=0)}),
    ],
)
def test_code_is_refused_by_the_rules_of_files(key: str, change: Any) -> None:
    with pytest.raises(InputError) as of_file:
        scenario().with_(key)
    with pytest.raises(InputError) as of_code:
        scenario().with_(**change())
    assert of_file.value.rule == of_code.value.rule


def test_with_changes_and_checks_again() -> None:
    there = ctrplan.load_scenario(SCENARIOS / "vessel.toml")
    changed = there.with_("planner.time_s=2", margins=ctrplan.Margins(0.2))
    assert (changed.planner.time_s, changed.margins.stability) == (2, 0.2)
    assert there.planner.time_s == 5 and there.with_().sha256 == there.sha256
    robot = there.robot.with_("contact.2.friction_coefficient=0.3")
    assert robot.friction[1].tolist() == [0.3, 0.3] and there.robot.friction[1, 0] != 0.3
    assert there.with_(robot=robot).robot.sha256 == robot.sha256


def test_a_path_where_an_object_is_expected_is_told_who_reads_it() -> None:
    with pytest.raises(ctrplan.InputError, match=r"must be a Scenario; ctrplan\.load_scenario reads one from a file"):
        ctrplan.plan(str(SCENARIOS / "vessel.toml"))  # type: ignore[arg-type]
    with pytest.raises(ctrplan.InputError, match=r"ctrplan\.load_measurements reads one from a file"):
        ctrplan.diagnose(ctrplan.load_robot(ROBOTS / "three_tube.toml"), Path("measured.csv"))  # type: ignore[arg-type]


CHANGES: list[Callable[[Any], Any]] = [
    lambda content: content.update(name="x"),
    lambda content: content.pop("name"),
    lambda content: content["tube"][0].update(poisson_ratio=0.1),
    lambda content: content["tube"][0].__setitem__("poisson_ratio", 0.1),
    lambda content: content["tube"].append({}),
    lambda content: content["tube"].pop(),
    lambda content: content["tube"][0]["section"].clear(),
    lambda content: operator.ior(content, {"name": "x"}),
    lambda content: operator.iadd(content["tube"], [{}]),
]


@pytest.mark.parametrize("change", CHANGES)
def test_content_refuses_changes_that_would_change_nothing(change: Callable[[Any], Any]) -> None:
    made = scenario()
    for robot in (pair(), ctrplan.load_robot(ROBOTS / "three_tube.toml"), made.robot):
        with pytest.raises(TypeError, match=r"with_\(\.\.\.\) makes another one"):
            change(robot.content)
        change(copy.deepcopy(robot.content))  # which is one's own
        assert pickle.loads(pickle.dumps(robot)).content == robot.content
    with pytest.raises(TypeError, match="changed in place"):
        made.content["start"] = {}
    with pytest.raises(TypeError, match="changed in place"):
        pair(effects={"backlash": {"theta_2_deg": 1.0}}).effects["backlash"]["theta_2_deg"] = 2.0  # type: ignore[index]


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"base_position_m": [0, 0, 50]}, r"^base.position_m = .* is the base in millimetres"),
        ({"goal": ctrplan.Goal(tip_m=[0, 10, 60])}, r"^goal.tip_m = .* are these in millimetres"),  # type: ignore[arg-type]
        ({"goal": ctrplan.Goal(tip_m=[0, 0.01, 0.06], tolerance_m=1)}, r"^goal.tolerance_m = 1.0 m: .* in millimetres"),  # type: ignore[arg-type]
        ({"registration": ctrplan.Registration(1, 0)}, r"^base.position_sigma_m = 1.0 m: .* in millimetres"),
    ],
)
def test_millimetres_given_for_metres_are_called_so(changes: dict[str, Any], rule: str) -> None:
    """Those that nothing else explains are refused, the others doubted."""
    given = {"goal": ctrplan.Goal(tip_m=[0, 0.01, 0.06])} | changes  # type: ignore[arg-type]
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        try:
            scenario(**given)
            sentence = str(doubts[0].message)
        except InputError as error:
            sentence = str(error)
    assert re.match(rule, sentence)
