"""Hashes of contents: the same content has the same one, however it came about; whatever is changed has another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SCENARIOS
from stated_plans import moved_to, scene_of, sphere, stated, table_ii
from written_plan_files import write_small_plan

import ctrplan
from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.errors import InputError
from ctrplan.robot.named_numbers import with_values
from ctrplan.scenario.scenario import Registration, Scenario

CORNERS = np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
FACES = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]


def made(robot: Any = None) -> Scenario:
    mesh = AnatomyPart(Mesh(CORNERS + 0.1, np.array(FACES)))
    return scene_of(robot or table_ii(), [0, 0, 0, -60], [0, 5, 5, -60], sphere([60, 30, 150], 5), mesh)


def test_the_same_content_has_the_same_hash() -> None:
    assert made().sha256 == made().sha256 == replace(made(), name="another", path="elsewhere.toml").sha256 != ""
    file = SCENARIOS / "robots" / "three_tube.toml"
    assert ctrplan.load_robot(file).sha256 == ctrplan.load_robot(file, ["name=other"]).sha256
    changed = with_values(table_ii(), {"tube.2.poisson_ratio": 0.25})
    assert changed.sha256 == table_ii("tube.2.poisson_ratio=0.25").sha256 != table_ii().sha256


CHANGES: dict[str, Callable[[Scenario], Scenario]] = {
    "start": lambda s: replace(s, start=s.start + 1e-9),
    "friction at the start": lambda s: replace(s, start_friction="released"),
    "goal": lambda s: replace(s, goal=replace(s.goal, joints=s.goal.joints + 1e-9)),
    "tolerance": lambda s: replace(s, goal=replace(s.goal, tolerance_m=2e-3)),
    "a target before": lambda s: replace(s, via=(s.goal,)),
    "margins": lambda s: replace(s, margins=replace(s.margins, stability=0.2)),
    "cost": lambda s: replace(s, cost=replace(s.cost, error_goal=0.0)),
    "registration": lambda s: replace(s, registration=Registration(position_sigma_m=1e-4)),
    "base": lambda s: replace(s, base_position_m=s.base_position_m + 1e-9),
    "no wall": lambda s: replace(s, anatomy=s.anatomy[:1]),
    "margin": lambda s: replace(s, anatomy=(replace(s.anatomy[0], margin_m=1e-4), s.anatomy[1])),
    "role": lambda s: replace(s, anatomy=(replace(s.anatomy[0], role="inside"), s.anatomy[1])),
    "a vertex": lambda s: replace(
        s, anatomy=(s.anatomy[0], AnatomyPart(Mesh(CORNERS + 0.1 + 1e-9 * np.eye(4)[:, :3], np.array(FACES))))
    ),
    "an effect": lambda s: replace(s, robot=table_ii("effects.backlash.theta_3_deg=1")),
    "another value of it": lambda s: replace(s, robot=table_ii("effects.backlash.theta_3_deg=2")),
    "an interval": lambda s: replace(s, robot=table_ii('uncertainty.ci95={"tube.3.poisson_ratio" = [0.25, 0.35]}')),
    "a limit": lambda s: replace(s, robot=table_ii("joint.4.max_mm=-1")),
    "friction": lambda s: replace(s, robot=with_values(s.robot, {"contact.1.friction_coefficient": 0.21})),
    "model error": lambda s: replace(s, robot=replace(s.robot, model_error_m=1e-4)),
}


def test_whatever_is_changed_has_another_hash() -> None:
    given = made()
    hashes = [given.sha256, *(change(given).sha256 for change in CHANGES.values())]
    assert len(set(hashes)) == len(hashes)


def test_plans_have_one_too(make_plan: Callable[..., ctrplan.Plan]) -> None:
    plans = [make_plan([[0, 0, 0, -80], [0, 8, end, -80]]) for end in (12, 12, 13)]
    assert plans[0].sha256 == plans[1].sha256 != plans[2].sha256
    walled = replace(plans[0], scenario=replace(plans[0].scenario, anatomy=(sphere([60, 30, 150], 5),)))
    assert walled.sha256 != plans[0].sha256


def test_a_plan_is_refused_where_its_scenario_was_changed(tmp_path: Path) -> None:
    write_small_plan(tmp_path)
    known = ctrplan.load_plan(tmp_path / "plan.json", allow_outside=True).scenario
    assert ctrplan.load_plan(tmp_path / "plan.json", known).scenario is known
    wall = replace(known, anatomy=(*known.anatomy, sphere([0, 0, 500], 5)))
    number = len(wall.anatomy)
    with pytest.raises(InputError, match=rf"another scenario.*: anatomy.{number} is not in the plan's scenario"):
        ctrplan.load_plan(tmp_path / "plan.json", wall)
    robot = with_values(known.robot, {"contact.1.friction_coefficient": 0.3})
    with pytest.raises(InputError, match=r"another robot.*: contact.1 differs"):
        ctrplan.load_plan(tmp_path / "plan.json", replace(known, robot=robot))


def test_what_verify_is_given_must_belong_together() -> None:
    plan = stated(made(), 1.0)
    for name, change in CHANGES.items():
        with pytest.raises(InputError, match="is that of another (scenario|robot)"):
            ctrplan.verify(replace(plan, scenario=change(plan.scenario)), work=1)
        assert moved_to(plan, change(plan.scenario)).content["scenario"]["sha256"], name
    with pytest.raises(InputError, match="the plan's anatomy.2 is not here"):
        ctrplan.verify(replace(plan, scenario=replace(plan.scenario, anatomy=plan.scenario.anatomy[:1])))
    nothing = {**plan.content, "scenario": {"sha256": "", "sha256_of": {}}}
    with pytest.raises(InputError, match="another scenario"):
        ctrplan.verify(replace(plan, content=nothing), work=1)
