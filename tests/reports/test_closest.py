"""Terminal, page and picture say how near a plan comes to the anatomy, in the certificate's own numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from ctrplan.anatomy.parts import surface_distance
from ctrplan.commands.plan import _summary
from ctrplan.plans.plan import Plan
from ctrplan.reports.plan_motion import clearance_section, narrowest_traces, scene_figure
from ctrplan.reports.plan_picture import plan_figure
from ctrplan.reports.plan_scene import NarrowestPose, PlanScene, plan_scene
from ctrplan.reports.plan_words import START_FRICTION, clearance_rows
from ctrplan.reports.words import millimetres


@pytest.fixture
def narrowest(scene: PlanScene) -> NarrowestPose:
    assert scene.narrowest is not None
    return scene.narrowest


@pytest.fixture(scope="module")
def free_plan(make_plan: Callable[..., Plan]) -> Plan:
    return make_plan([[0, 0], [60, -120]], robot="robots/table_1_pair.toml")


def test_the_gap_goes_from_the_tube_to_the_anatomy(plan: Plan, narrowest: NarrowestPose) -> None:
    place, (from_m, to_m) = narrowest.place, narrowest.gap_m
    part = plan.scenario.anatomy[int(place.part.removeprefix("anatomy.").split(" ")[0]) - 1]
    radius = plan.scenario.robot.tubes[place.tube - 1].outer_diameter_m / 2
    assert np.linalg.norm(from_m - place.point_m) == pytest.approx(radius, abs=1e-9)
    assert np.linalg.norm(to_m - from_m) == pytest.approx(place.distance_m, abs=1e-9)
    assert surface_distance(part, to_m[None])[0] == pytest.approx(0.0, abs=1e-5)


def test_the_body_is_coloured_by_its_clearance(narrowest: NarrowestPose) -> None:
    least_m = narrowest.place.clearance_m
    assert least_m - 1e-6 <= narrowest.clearance_m.min() <= least_m + 0.1e-3
    body, gap, label = go.Figure(narrowest_traces(narrowest)).data
    assert len(body.intensity) == len(body.x)
    assert float(min(body.intensity)) == pytest.approx(1e3 * narrowest.clearance_m.min(), rel=1e-5)
    assert millimetres(least_m) in gap.hovertemplate and millimetres(least_m) in label.text[0]
    assert {trace.name for trace in (body, gap, label)} == {body.name}  # a click shows them together


def test_page_and_picture_mark_the_narrowest_place(scene: PlanScene, narrowest: NarrowestPose) -> None:
    number = millimetres(narrowest.place.clearance_m)
    marks = [trace for trace in scene_figure(scene).data if number in (trace.hovertemplate or "")]
    assert marks and not any(trace.visible for trace in marks)  # it lies in the future when the motion begins
    assert number in {text.get_text().strip() for text in plan_figure(scene).axes[0].texts}


def test_all_three_numbers_are_said_with_their_places(plan: Plan) -> None:
    rows, terminal = clearance_rows(plan), _summary(Path("out"), plan, ())
    page = clearance_section(plan).replace("\u00a0", " ")
    assert [row.clearance_m for row in rows] == sorted((row.clearance_m for row in rows), reverse=True)
    assert rows[-1].clearance_m == plan.certificate.min_clearance_m
    for row in rows:
        assert row.sentence in terminal
        for said in (millimetres(row.clearance_m), row.place.part, row.when):
            assert said in page and said in row.sentence


@pytest.mark.parametrize("start", START_FRICTION)
def test_what_is_assumed_of_friction_at_the_start_is_said(plan: Plan, start: str) -> None:
    assumed = replace(plan, certificate=replace(plan.certificate, start_friction=start))
    for text in (_summary(Path("out"), assumed, ()), clearance_section(assumed)):
        assert START_FRICTION[start] in text


def test_free_space_has_nothing_to_come_near(free_plan: Plan) -> None:
    assert "free space" in _summary(Path("out"), free_plan, ())
    assert not clearance_rows(free_plan) and not clearance_section(free_plan)
    scene = plan_scene(free_plan, frames=2)
    assert scene.narrowest is None and plan_figure(scene).axes
