"""report.html stands alone, says what the plan says, and takes no text for HTML."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest
from browser import Browser, chromium
from jinja2 import UndefinedError
from packed_page import library, unpacked

from ctrplan.anatomy.parts import AnatomyPart
from ctrplan.anatomy.shapes.mesh import Mesh
from ctrplan.base.surface import capsule
from ctrplan.plans.plan import Plan
from ctrplan.plans.planned_motion import ComparedWay
from ctrplan.reports.curves import CURSOR
from ctrplan.reports.html_page import _templates, rendered
from ctrplan.reports.plan_motion import camera_places, moments, scene_figure
from ctrplan.reports.plan_page import joints_figure, margins_figure, plan_report_html, write_plan_report
from ctrplan.reports.plan_scene import FRAMES, PlanScene, plan_scene
from ctrplan.reports.plan_words import certificate_rows, verdict
from ctrplan.reports.words import Markup, millimetres

HOSTILE = """<script>alert("x")</script><img src=x onerror=alert(1)>'&</title>"""
LOADING = ("src", "href", "data", "poster", "srcset", "action", "formaction", "background")


class Page(HTMLParser):
    """Elements, what they load, and the text that a reader sees."""

    def __init__(self, content: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loaded: list[tuple[str, str]] = []
        self.attributes: list[str] = []
        self.scripts, self.text, self._script = "", "", False
        self.feed(content)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
        self.loaded += [(tag, value or "") for name, value in attrs if name in LOADING]
        self._script = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._script = False

    def handle_data(self, data: str) -> None:
        if self._script:
            self.scripts += data
        else:
            self.text += data


@pytest.fixture(scope="module")
def content(scene: PlanScene) -> str:
    return plan_report_html(scene)


@pytest.fixture(scope="module")
def hostile(plan: Plan) -> Plan:
    """A plan in which every text of the user is an attack."""
    drive = plan.scenario.robot.drive
    joints = tuple(replace(joint, name=f"{HOSTILE}{k}") for k, joint in enumerate(drive.joints))
    robot = replace(plan.scenario.robot, name=HOSTILE, path=HOSTILE, drive=replace(drive, joints=joints))
    scenario = replace(plan.scenario, name=HOSTILE, path=HOSTILE, robot=robot, warnings=(HOSTILE,))
    certificate = replace(plan.certificate, valid=False, problems=(HOSTILE,))
    return replace(plan, scenario=scenario, certificate=certificate, planner=HOSTILE, notes=(HOSTILE,))


def test_nothing_is_loaded(content: str) -> None:
    parsed = Page(content)
    assert parsed.loaded == []
    assert not {"link", "iframe", "object", "embed", "base"} & set(parsed.tags)
    assert not re.search(r"@import|url\(\s*['\"]?(https?:)?//", content.split("<script", 1)[0])
    assert "default-src 'none'" in content and "connect-src" not in content


def test_plotly_comes_once_and_the_file_is_small(scene: PlanScene, tmp_path: Path) -> None:
    write_plan_report(tmp_path / "report.html", scene)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").stat().st_size < 4e6
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "* plotly.js v" in library(text) and "* plotly.js v" not in text


def test_report_is_the_same_every_time(plan: Plan, content: str) -> None:
    assert plan_report_html(plan_scene(plan)) == content


def test_report_says_what_the_plan_says(plan: Plan, content: str) -> None:
    text = Page(content).text
    assert verdict(plan) in text and plan.scenario.name in text
    for row in certificate_rows(plan):
        assert row.quantity in text and row.value in text
    for fact in (plan.scenario.sha256, plan.scenario.robot.sha256, f"seed {plan.seed}", *plan.notes):
        assert fact in text
    assert "translate inner: -50.00 mm → -20.00 mm" in text and "rotate inner: 60.00° → 110.00°" in text


def test_texts_are_no_html(hostile: Plan, scene: PlanScene, content: str) -> None:
    attacked = plan_report_html(replace(scene, plan=hostile))
    parsed = Page(attacked)
    assert {"img", "b"} & set(parsed.tags) <= {"b"}
    assert parsed.tags.count("script") == Page(content).tags.count("script")
    assert parsed.tags.count("title") == 1
    assert not any(name.startswith("on") for name in parsed.attributes)
    assert HOSTILE in parsed.text and HOSTILE not in attacked
    figures = re.findall(r'drawn\("\w+", "([^"]+)"', parsed.scripts)
    assert len(figures) == 3 and all("<img" not in unpacked(figure) for figure in figures)
    assert "<img" not in parsed.scripts


def test_names_in_plots_are_shown_not_interpreted(hostile: Plan) -> None:
    names = [trace.name for trace in go.Figure(joints_figure(hostile)).data if trace.name]
    assert names and all("<" not in name and "&lt;script&gt;" in name for name in names)


def test_frames_move_the_robot_and_nothing_else(scene: PlanScene) -> None:
    plan, figure = scene.plan, scene_figure(scene)
    assert len(figure.frames) == FRAMES == len({frame.name for frame in figure.frames})
    assert float(figure.frames[-1].name) == pytest.approx(plan.trajectory.duration_s, abs=1e-3)
    for frame in figure.frames:
        assert list(frame.traces) == list(range(len(frame.data)))
        for trace, moved in zip(figure.data, frame.data, strict=False):
            assert trace.type == moved.type and len(trace.x) == len(moved.x)
    first = figure.frames[0].data
    for trace, moved in zip(figure.data, first, strict=False):
        np.testing.assert_array_equal(np.asarray(trace.z), np.asarray(moved.z))


def test_nothing_of_the_future_is_shown_at_the_start(scene: PlanScene) -> None:
    """The pose at the goal, the closest one, the swept space and the tip's way beyond its place are hidden."""
    figure = scene_figure(scene)
    start = np.concatenate([step.envelope.surface(4).vertices_m for step in scene.path[:1]]) * 1e3
    still = {"goal", "lumen to", "anatomy to", "front plate", "axes", "line to", "targets on"}
    for trace in figure.data:
        if trace.visible is False:
            assert trace.meta["later"]
        elif not any(trace.name.startswith(name) for name in still):
            points = np.column_stack([np.asarray(trace[axis], dtype=float) for axis in "xyz"])
            points = points[np.isfinite(points).all(axis=1)]
            assert np.all(points.min(axis=0) > start.min(axis=0) - 3) and np.all(
                points.max(axis=0) < start.max(axis=0) + 3
            )
    ways = [frame.data[-1] for frame in figure.frames]
    passed = [int(np.isfinite(np.asarray(way.x)).sum()) for way in ways]
    assert passed[0] == 1 and passed == sorted(passed) and passed[-1] == len(scene.plan.certificate.samples.leg)


def test_the_scene_fills_its_window_with_the_motion(scene: PlanScene) -> None:
    """What the camera has to hold is the robot's way and its goal, not a box around the anatomy."""
    view = scene_figure(scene).layout.meta["view"]
    points, every = (
        np.array(view["points"]),
        np.concatenate([step.envelope.surface(4).vertices_m for step in scene.path]),
    )
    lower, upper = points.min(axis=0), points.max(axis=0)
    assert np.all(lower <= every.min(axis=0) * 1e3 + 3) and np.all(upper >= every.max(axis=0) * 1e3 - 3)
    toward, along = np.array(view["toward"]), np.array(view["along"])
    assert np.linalg.norm(toward) == pytest.approx(1) and abs(toward @ along) < 1e-9


def test_inside_is_offered_where_there_is_a_lumen(scene: PlanScene) -> None:
    lumen = AnatomyPart(Mesh(*capsule_mesh()), "inside")
    within = replace(scene, plan=replace(scene.plan, scenario=replace(scene.plan.scenario, anatomy=(lumen,))))
    assert camera_places(within)["inside"] and not camera_places(scene)["inside"]


def capsule_mesh() -> tuple[np.ndarray, np.ndarray]:
    ball = capsule(np.zeros(3), np.array([0.0, 0.0, 0.15]), 0.06, 40)
    return ball.vertices_m, ball.faces


def test_figures_of_the_moment_are_those_of_the_certificate(scene: PlanScene) -> None:
    texts, samples = moments(scene), scene.plan.certificate.samples
    assert {len(column) for column in texts.values()} == {FRAMES}
    for name, column in (("bound", samples.bound_m), ("clearance", samples.clearance_m)):
        assert texts[f"now_{name}"][0] == millimetres(column[0]) and texts[f"now_{name}"][-1] == millimetres(column[-1])


def test_other_ways_stand_beside_the_scene(scene: PlanScene) -> None:
    ways = (
        ComparedWay("straight line", 0.6e-3, 64.0, ""),
        ComparedWay("as driven", 0.49e-3, 64.0, ""),
        ComparedWay("translations first", 3.4e-3, 64.0, "too close"),
        ComparedWay("as given", math.inf, 64.0, "no history leads there"),
    )
    plan = replace(scene.plan, reorder=replace(scene.plan.reorder, compare=lambda: ways))
    text = Page(plan_report_html(replace(scene, plan=plan))).text
    assert text.index("this plan") < text.index("all joints at once") and "3.40 mm, not valid" in text
    assert "no way, not valid" in text and "that is not compared" in text


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("width", "height"), [(390, 844)])  # the live view has larger screens
def test_report_opens_on_the_first_frame_and_plays_in_a_loop(
    scene: PlanScene, tmp_path: Path, width: int, height: int
) -> None:
    write_plan_report(tmp_path / "report.html", scene)
    with Browser(tmp_path / "profile") as browser:
        browser.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        browser.open((tmp_path / "report.html").as_uri())
        browser.wait_for("document.readyState === 'complete' && document.querySelector('#key button')")
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")
        assert browser.run("document.getElementById('play').getBoundingClientRect().bottom < innerHeight")
        assert browser.run("document.getElementById('now').textContent") == "0.0 s"
        np.testing.assert_allclose(
            browser.run("Array.from(document.getElementById('scene')._fullData[2].z)"),
            np.asarray(scene_figure(scene).frames[0].data[2].z),
        )
        last = len(scene.path) - 1
        slider = "document.getElementById('time')"
        browser.run(f"({slider}.value = {last - 1}, {slider}.dispatchEvent(new Event('input')))")
        before = browser.run("document.getElementById('now_bound').textContent")
        browser.run("document.getElementById('play').click()")
        browser.wait_for(f"{slider}.value > 0 && {slider}.value < {last - 1}")
        assert browser.run("document.getElementById('now_bound').textContent") != before
        browser.run("document.getElementById('play').click()")
        if width > 1000:
            looks_around_and_cuts(browser, scene)
        assert browser.complaints() == []


def test_scene_has_equal_scales_that_stay(scene: PlanScene) -> None:
    figure = scene_figure(scene)
    assert figure.layout.scene.aspectmode == "manual"
    shares = [
        np.ptp(figure.layout.scene[f"{axis}axis"].range) / figure.layout.scene.aspectratio[axis] for axis in "xyz"
    ]
    np.testing.assert_allclose(shares, shares[0])
    for axis in "xyz":
        low, high = figure.layout.scene[f"{axis}axis"].range
        for frame in figure.frames:
            values = np.concatenate([np.asarray(trace[axis], dtype=float) for trace in frame.data])
            assert low <= np.nanmin(values) and np.nanmax(values) <= high


def test_cursor_is_the_shape_that_the_player_moves(plan: Plan) -> None:
    for figure in (go.Figure(margins_figure(plan)), go.Figure(joints_figure(plan))):
        cursor = figure.layout.shapes[CURSOR]
        assert cursor.type == "line" and cursor.x0 == cursor.x1 == 0


@pytest.mark.parametrize("waypoints", [[[0, 0], [60, -120]], [[0, 0], [0, 0]]])
def test_free_space_and_rest_are_reported(make_plan: Callable[..., Plan], waypoints: list[list[float]]) -> None:
    plan = make_plan(waypoints, robot="robots/table_1_pair.toml", cost={"max_error_goal_mm": 2.0})
    titles = [annotation.text for annotation in go.Figure(margins_figure(plan)).layout.annotations]
    assert not any("Clearance" in title for title in titles) and "allowed at the goal" in titles[0]
    assert "free space" in Page(plan_report_html(plan_scene(plan))).text


@pytest.mark.parametrize("call", ["table([t], [[t]])", "tiles([(t, t)])", "list([t])", "remarks(t, [t])",
                                  "facts([(t, t)])", "opening(t, t, t, t)", "source(t, t, t, t)"])  # fmt: skip
def test_page_escapes_what_is_not_markup(call: str) -> None:
    name = call.split("(")[0]
    template = _templates().from_string(f'{{% from "parts.html" import {name} %}}{{{{ {call} }}}}')
    page = template.render(t=HOSTILE)
    assert HOSTILE not in page and Page(page).text.count(HOSTILE) >= 1
    assert HOSTILE not in rendered("page.html", title=HOSTILE)
    assert "<b>x</b>" in template.render(t=Markup("<b>x</b>"))


def test_every_template_is_read_and_a_name_that_it_lacks_is_an_error() -> None:
    for name in _templates().list_templates():
        _templates().get_template(name)
    with pytest.raises(UndefinedError):
        rendered("page.html")


def looks_around_and_cuts(browser: Browser, scene: PlanScene) -> None:
    eye = "JSON.stringify(document.getElementById('scene').layout.scene.camera)"
    buttons, seen = "document.querySelectorAll('#looking button')", list[str]()
    names = browser.run(f"Array.from({buttons}, (b) => b.textContent)")
    assert names == ["All", "Plate", "Target", "Closest"]  # no lumen to be inside of
    for number in (1, 2, 3, 0):
        browser.run(f"{buttons}[{number}].click()")
        browser.wait_for(f"!{json.dumps(seen)}.includes({eye})")
        seen.append(browser.run(eye))
    traces = "document.getElementById('scene').data.filter((trace) => trace.meta && trace.meta.cut)"
    browser.run("document.getElementById('cut').value = 'z above'")
    browser.run("document.getElementById('cut').dispatchEvent(new Event('change'))")
    browser.wait_for(f"{traces}.every((trace) => Array.isArray(trace.i))")
    low, top = scene_figure(scene).layout.scene.zaxis.range
    highest = browser.run(f"Math.max(...{traces}.flatMap((t) => Array.from(t.i, (n) => t.z[n])))")
    assert highest == pytest.approx((low + top) / 2, abs=1e-3)


def test_a_fine_mesh_is_drawn_coarser_and_the_page_says_so(scene: PlanScene) -> None:
    """80,000 triangles, those of a patient's airway: the page stays below 5 MB."""
    rng = np.random.default_rng(0)
    ball = capsule(np.zeros(3), np.array([0.0, 0.0, 0.15]), 0.06, 283)
    rough = ball.vertices_m + rng.normal(0, 2e-4, ball.vertices_m.shape)
    assert len(ball.faces) > 79_000
    part = AnatomyPart(Mesh(rough, ball.faces), "inside")
    plan = replace(scene.plan, scenario=replace(scene.plan.scenario, anatomy=(part,)))
    content = plan_report_html(replace(scene, plan=plan))
    assert len(content) < 5e6
    (drawn, whole) = re.search(r"drawn in ([\d,]+) of its ([\d,]+) triangles", Page(content).text).groups()  # type: ignore[union-attr]
    assert int(whole.replace(",", "")) == len(ball.faces) and int(drawn.replace(",", "")) <= 12_000
