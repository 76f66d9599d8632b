"""The live view: what it serves over HTTP, and that a real browser shows it and moves the robot."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from browser import Browser, chromium
from live_requests import VESSEL_START, get
from places import SCENARIOS
from scipy.spatial.transform import Rotation
from written_plan_files import GOAL, write_small_plan

from ctrplan.certificate.certify import certify
from ctrplan.commands.program import parser
from ctrplan.commands.view import loaded
from ctrplan.drive.trajectory import time_parameterise
from ctrplan.files.scenario_file import BaseEntry, load_robot_or_scenario
from ctrplan.reports.live_server import LiveServer
from ctrplan.reports.live_state import LiveState

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# How far from the middle of the scene a vertex of the robot is seen, 1 at its edges, and whether axes cut it off (2).
OUTERMOST = """(name) => {
  const plot = document.getElementById(name), inner = plot._fullLayout.scene._scene.glplot;
  const {model, view, projection} = inner.cameraParams, times = (m, v) => [0, 1, 2, 3].map((i) =>
    m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + m[12 + i] * v[3]);
  const scale = plot._fullLayout.scene._scene.dataScale;
  const ranges = ["x", "y", "z"].map((axis) => plot._fullLayout.scene[`${axis}axis`].range);
  return Math.max(...plot.data.slice(0, 4).flatMap((trace) => Array.from(trace.x, (_, k) => {
    const point = [trace.x[k], trace.y[k], trace.z[k]];
    if (point.some((value, i) => value < ranges[i][0] - 1e-3 || value > ranges[i][1] + 1e-3)) return 2;
    const seen = times(projection, times(view, times(model, [...point.map((value, i) => value * scale[i]), 1])));
    return Math.max(Math.abs(seen[0] / seen[3]), Math.abs(seen[1] / seen[3]));
  })));
}"""


def test_page_brings_all_it_needs(server: LiveServer) -> None:
    code, page, headers = get(server, "/")
    assert code == 200 and "vessel branch" in page and "default-src 'none'" in headers["Content-Security-Policy"]
    assert "http://" not in page and "https://" not in page
    for path in ("/plotly.js", "/scene.js", "/live.js"):
        code, script, headers = get(server, path)
        assert code == 200 and headers["Content-Type"].startswith("text/javascript") and len(script) > 1000


def test_pose_says_what_the_mechanics_say(server: LiveServer) -> None:
    scenario = server.state.scenario
    code, answer, _ = get(server, f"/pose?q={VESSEL_START}")
    bound = scenario.robot.bound(*scenario.robot.drive.collars(scenario.start))
    assert code == 200 and answer["valid"] and answer["reason"] == ""
    assert answer["bound_mm"] == pytest.approx(bound.position_m * 1e3, abs=1e-3)
    assert answer["stability"] == pytest.approx(bound.frictionless.stability, abs=1e-3)
    np.testing.assert_allclose(answer["tip_mm"], bound.frictionless.tip_m * 1e3, atol=0.02)
    inner = np.array([answer["traces"][2][axis] for axis in "xyz"]).T
    assert np.linalg.norm(inner - bound.frictionless.tip_m * 1e3, axis=1).min() < 0.01  # the vertex in its end's middle
    assert answer["clearance_mm"] > 0 and len(answer["traces"]) == 6
    assert answer["nominal_mm"] >= answer["friction_mm"] > answer["sure_mm"] > 0
    certified = certify(scenario, scenario.start[None])
    assert certified.nominal is not None and certified.closest is not None
    assert answer["nominal_mm"] == pytest.approx(certified.nominal.clearance_m * 1e3, abs=0.02)
    assert answer["sure_mm"] == pytest.approx(certified.min_clearance_m * 1e3, abs=0.15)
    assert answer["friction_mm"] == pytest.approx(certified.closest.clearance_m * 1e3, abs=0.02)


def test_pose_says_how_far_from_the_target_it_may_be(server: LiveServer) -> None:
    goal = server.state.scenario.goal
    _, answer, _ = get(server, f"/pose?q={VESSEL_START}")
    away = np.linalg.norm(np.array(answer["tip_mm"]) - goal.tip_m * 1e3)  # the base stands at the origin
    assert answer["target"]["free_mm"] == pytest.approx(away, abs=0.02)
    assert answer["target"]["worst_mm"] == pytest.approx(answer["target"]["free_mm"] + answer["bound_mm"])
    assert answer["target"]["tolerance_mm"] == goal.tolerance_m * 1e3 and answer["target"]["exceeds"]


def test_a_base_that_is_moved_takes_the_robot_along(server: LiveServer) -> None:
    """Three turns of 90 deg and a shift: every point of robot and plate goes where the base's motion takes it."""
    _, before, _ = get(server, f"/pose?q={VESSEL_START}")
    _, after, _ = get(server, f"/pose?q={VESSEL_START}&base=5,-3,2,0,0,90")
    base = server.state.scenario.base_position_m * 1e3
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for k in (0, 3, 5):
        here, there = (
            np.array([answer["traces"][k][axis] for axis in "xyz"], dtype=float) for answer in (before, after)
        )
        moved = turn @ (here - base[:, None]) + base[:, None] + np.array([[5.0], [-3], [2]])
        np.testing.assert_allclose(there[:, -1], moved[:, -1], atol=0.02)  # rings may begin elsewhere, ends do not
    assert after["bound_mm"] == pytest.approx(before["bound_mm"]) and after["nominal_mm"] < before["nominal_mm"]
    lines = msgspec.convert(tomllib.loads(after["base"])["base"], BaseEntry)
    np.testing.assert_allclose(lines.position_mm, base + [5, -3, 2], atol=1e-6)
    np.testing.assert_allclose(Rotation.from_quat(np.roll(lines.quaternion_wxyz, -1)).as_matrix(), turn, atol=1e-8)
    _, again, _ = get(server, f"/pose?q={VESSEL_START}&base=0,0,0,0,0,0")
    assert again == before


@pytest.mark.parametrize("base", ["0,0,0,0,0,0", "2,1,0,0,0,5"])
def test_a_picked_tip_is_reached(server: LiveServer, base: str) -> None:
    _, there, _ = get(server, f"/pose?q=30,-50,60,-60&base={base}")
    point = ",".join(map(str, there["tip_mm"]))
    code, found, _ = get(server, f"/ik?q={VESSEL_START}&tip={point}&base={base}")
    assert code == 200
    _, reached, _ = get(server, f"/pose?q={','.join(map(str, found['joints']))}&base={base}")
    assert np.linalg.norm(np.subtract(reached["tip_mm"], there["tip_mm"])) < 0.23  # both rounded
    _, far, _ = get(server, f"/ik?q={VESSEL_START}&tip=0,0,5000&base={base}")
    assert "comes no nearer to that point than" in far["refusal"]


def test_a_plan_is_played_by_its_trajectory() -> None:
    scenario = load_robot_or_scenario(SCENARIOS / "robots" / "table_1_pair.toml")
    end = scenario.start + [0.5, -0.2]
    state = LiveState(scenario, time_parameterise(np.array([scenario.start, end]), scenario.robot.drive))
    played = state.played()
    assert played is not None and np.all(np.diff(played["time_s"]) > 0)
    np.testing.assert_allclose(played["joints"][0], [slider["value"] for slider in state.sliders()], atol=1e-5)
    np.testing.assert_allclose(played["joints"][-1], np.degrees(end), atol=1e-4)
    assert LiveState(scenario).played() is None


def test_pose_outside_the_lumen_and_out_of_nesting(server: LiveServer) -> None:
    _, wide, _ = get(server, "/pose?q=20,20,200,0")
    assert not wide["valid"] and wide["clearance_mm"] < 0 and "too close to the anatomy" in wide["reason"]
    _, beyond, _ = get(server, "/pose?q=20,-60,80,5")
    assert "translate inner = 5 mm: must be within" in beyond["refusal"]


def reachable_tip(server: LiveServer) -> list[float]:
    tip: list[float] = get(server, "/pose?q=30,-50,60,-60")[1]["tip_mm"]
    return tip


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
def test_browser_shows_the_robot_and_moves_it(server: LiveServer, tmp_path: Path) -> None:
    with Browser(tmp_path / "profile") as browser:
        browser.open(server.url)
        browser.wait_for("document.body && document.body.dataset.updates >= 1")
        assert browser.run("document.querySelectorAll('#joints input[type=range]').length") == 4
        assert browser.run("document.getElementById('state').textContent") == "Keeps all limits and margins"
        before = browser.run("document.getElementById('scene').data[2].z.slice()")
        bound = browser.run("document.getElementById('bound').textContent")
        browser.run(
            "(() => { const slider = document.querySelector('[aria-label=\"translate inner\"]'); slider.value = -40;"
            " slider.dispatchEvent(new Event('input')); })()"
        )
        browser.wait_for("!busy && !stale && document.body.dataset.updates >= 2")
        after = browser.run("document.getElementById('scene').data[2].z.slice()")
        assert np.abs(np.subtract(after, before)).max() > 10
        assert browser.run("document.getElementById('bound').textContent") != bound
        assert '"translate inner" = -40' in browser.run("document.getElementById('toml').textContent")
        browser.run("change(3, 3)")
        browser.wait_for("!busy && !stale && document.getElementById('state').className === 'bad'")
        assert "must be within" in browser.run("document.getElementById('state').textContent")
        browser.run("document.getElementById('reset').click()")
        browser.wait_for("!busy && !stale && document.getElementById('state').className === 'good'")
        assert browser.run("document.getElementById('bound').textContent") == bound
        for broken in ('new Response(\'{"error": "broken"}\', {status: 500})', "new Response('nonsense')"):
            browser.run(f"(() => {{ window.honest = window.fetch; window.fetch = async () => {broken}; }})()")
            browser.run("change(3, -40)")
            browser.wait_for("!busy && !stale && document.getElementById('state').className === 'bad'")
            assert browser.run("document.getElementById('bound').textContent") == "–"
            browser.run("(() => { window.fetch = window.honest; change(3, -86.4); })()")
            browser.wait_for("!busy && !stale && document.getElementById('state').className === 'good'")
        browser.run("reachFor(FIGURE_TIP)".replace("FIGURE_TIP", json.dumps(reachable_tip(server))))
        browser.wait_for("!busy && !stale && document.getElementById('state').className === 'good'")
        assert reachable_tip(server) == pytest.approx(
            [float(x) for x in browser.run("document.getElementById('tip_mm').textContent")[:-3].split(", ")], abs=0.4
        )
        browser.run("(() => { moves[0].value = 4; moves[0].dispatchEvent(new Event('change')); })()")
        browser.wait_for("!busy && !stale && document.getElementById('toml').textContent.includes('[4, 0, 0]')")
        browser.screenshot(tmp_path / "view.png")
        assert (tmp_path / "view.png").stat().st_size > 20_000
        assert browser.complaints() == []
        assert all(url.startswith(server.url) for url in browser.requests())
        browser.run("change(0, 1e22)")
        browser.wait_for("!busy && !stale && document.getElementById('state').className === 'bad'")
        assert "must be" in browser.run("document.getElementById('state').textContent")


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
@pytest.mark.parametrize(("width", "height"), [(1800, 400), (390, 844)])
def test_robot_is_wholly_on_the_screen(server: LiveServer, tmp_path: Path, width: int, height: int) -> None:
    """Also where it leaves what the axes showed at first."""
    with Browser(tmp_path / "profile") as browser:
        browser.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
        )
        browser.open(server.url)
        browser.wait_for("document.body && document.body.dataset.updates >= 1")
        browser.run("change(1, 100)")
        browser.run("change(3, 0)")
        browser.wait_for("!busy && !stale && document.body.dataset.updates >= 2")
        assert browser.run(f"({OUTERMOST})('scene')") <= 1.0
        assert browser.run("document.documentElement.scrollWidth <= innerWidth")


def test_the_command_takes_a_plan_to_be_played(tmp_path: Path) -> None:
    write_small_plan(tmp_path)
    arguments = parser().parse_args(["view", str(tmp_path / "plan.json"), "--allow-outside"])
    scenario, plan = loaded(arguments)
    state = LiveState(scenario, plan)
    played = state.played()
    assert played is not None and plan is not None
    np.testing.assert_allclose(played["joints"][-1], GOAL, atol=1e-4)
    assert loaded(parser().parse_args(["view", str(tmp_path / "scenario.toml"), "--allow-outside"]))[1] is None
