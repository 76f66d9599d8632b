"""The live view: what it serves over HTTP, and that a real browser shows it and moves the robot."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, chromium
from interruptible import INTERRUPTIBLE
from places import SCENARIOS

from ctrplan.cli import main
from ctrplan.files.bare_scenario import load_robot_or_scenario
from ctrplan.reports.live.server import LiveServer
from ctrplan.reports.live.state import LiveState

VESSEL_START = "20,-60,80,-86.4"


@pytest.fixture(scope="module")
def server() -> Iterator[LiveServer]:
    with LiveServer(LiveState(load_robot_or_scenario(SCENARIOS / "vessel.toml"))) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def get(server: LiveServer, path: str, **headers: str) -> tuple[int, Any, dict[str, str]]:
    connection = http.client.HTTPConnection(*server.server_address[:2], timeout=60)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    is_json = answer.headers["Content-Type"] == "application/json"
    return answer.status, json.loads(content) if is_json else content.decode(), dict(answer.headers)


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
    assert answer["clearance_mm"] > 0 and len(answer["traces"]) == 5


def test_pose_outside_the_lumen_and_out_of_nesting(server: LiveServer) -> None:
    _, wide, _ = get(server, "/pose?q=20,20,200,0")
    assert not wide["valid"] and wide["clearance_mm"] < 0 and "too close to the anatomy" in wide["reason"]
    _, beyond, _ = get(server, "/pose?q=20,-60,80,5")
    assert "translate inner = 5 mm: must be within" in beyond["refusal"]


@pytest.mark.parametrize(
    ("path", "code", "words"),
    [
        ("/pose?q=1,2", 400, "4 finite numbers"),
        ("/pose?q=1,2,3,nan", 400, "4 finite numbers"),
        ("/pose?q=a,b,c,d", 400, "must be numbers"),
        ("/pose", 400, "must be numbers"),
        ("/etc/passwd", 404, "there is no"),
        ("/../ctrplan/cli.py", 404, "there is no"),
    ],
)
def test_bad_requests_are_answered(server: LiveServer, path: str, code: int, words: str) -> None:
    found, answer, _ = get(server, path)
    assert found == code and words in answer["error"]


def test_other_hosts_are_refused(server: LiveServer) -> None:
    """Against pages elsewhere that resolve their own name to this machine."""
    code, answer, _ = get(server, "/", Host="example.org:80")
    assert code == 403 and "127.0.0.1" in answer["error"]
    assert get(server, "/", Host=f"localhost:{server.server_address[1]}")[0] == 200


def test_taken_port_is_one_sentence(server: LiveServer, capsys: pytest.CaptureFixture[str]) -> None:
    port = str(server.server_address[1])
    assert main(["view", str(SCENARIOS / "robots" / "table_5_pair.toml"), "--no-browser", "--port", port]) == 2
    assert f"--port = {port}: can't be listened on" in capsys.readouterr().err
    assert main(["view", str(SCENARIOS / "vessel.toml"), "--port", "70000"]) == 2


def test_command_serves_until_ctrl_c() -> None:
    robot = str(SCENARIOS / "robots" / "table_5_pair.toml")
    command = [sys.executable, "-c", INTERRUPTIBLE, "view", robot, "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    line = process.stdout.readline()
    assert "http://127.0.0.1:" in line
    port = int(line.split("127.0.0.1:")[1].split("/")[0])
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", "/pose?q=0,90,0")
    assert json.loads(connection.getresponse().read())["bound_mm"] > 0
    connection.close()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in errors


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
        browser.screenshot(tmp_path / "view.png")
        assert (tmp_path / "view.png").stat().st_size > 20_000
        assert browser.complaints() == []
        assert all(url.startswith(server.url) for url in browser.requests())
