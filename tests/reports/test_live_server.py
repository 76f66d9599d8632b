"""The live view's server: whom it answers and whom it refuses, and that nobody keeps anybody else waiting."""

from __future__ import annotations

import http.client
import json
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from browser import Browser, chromium
from interruptible import INTERRUPTIBLE
from live_requests import VESSEL_START, ask, get
from places import SCENARIOS

from ctrplan.__main__ import main
from ctrplan.reports.live_server import LiveServer


@pytest.mark.parametrize(
    ("path", "code", "words"),
    [
        ("/pose?q=1,2", 400, "4 finite numbers"),
        ("/pose?q=1,2,3,nan", 400, "4 finite numbers"),
        ("/pose?q=a,b,c,d", 400, "must be numbers"),
        ("/pose", 400, "must be numbers"),
        (f"/pose?q={VESSEL_START}&base=1,2,3", 400, "must be six numbers"),
        (f"/pose?q={VESSEL_START}&base=1,2,3,0,0,nan", 400, "must be six numbers"),
        (f"/ik?q={VESSEL_START}", 400, "must be numbers"),
        (f"/ik?q={VESSEL_START}&tip=1,2", 400, "must be three finite numbers"),
        ("/pose?q=1_0,2,3,4", 400, "must be numbers"),
        ("/etc/passwd", 404, "there is no"),
        ("/../ctrplan/__main__.py", 404, "there is no"),
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


@pytest.mark.parametrize(
    "path", ["/", "/scene.js", "/pose?q=20,-60,80,-86.4", "/wrong/scene.js", "//scene.js", "/\u00e9/"]
)
def test_nothing_is_served_without_the_token(server: LiveServer, path: str) -> None:
    code, answer, _ = ask(server, quote(path, safe="/?=,"))
    assert code == 403 and "address that the program printed" in answer["error"]


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
@pytest.mark.parametrize("path", ["/", "/scene.js", f"/pose?q={VESSEL_START}"])
def test_other_pages_are_refused_even_with_the_token(server: LiveServer, path: str, site: str) -> None:
    code, answer, _ = get(server, path, Sec_Fetch_Site=site)
    assert code == 403 and "other pages" in answer["error"]
    assert get(server, path, Sec_Fetch_Site="same-origin")[0] == 200


# What a page may try: to read, to ask without reading, to take a script, to show the page in itself, to open a socket.
ATTEMPTS = """(async (url) => {
  const read = await fetch(url + "pose?q=START").then((answer) => answer.text(), () => "nothing");
  await fetch(url + "pose?q=START", {mode: "no-cors"}).then((answer) => answer.text(), () => "nothing");
  const added = (name, source) => new Promise((done) => {
    const made = Object.assign(document.createElement(name), {src: source, onload: done, onerror: done});
    document.body.append(made);
  });
  await added("script", url + "scene.js");
  await added("iframe", url);
  const socket = await new Promise((done) => {
    const tried = new WebSocket(url.replace("http", "ws"));
    tried.onopen = () => done("open");
    tried.onerror = () => done("nothing");
  });
  const framed = document.querySelector("iframe").contentDocument;
  return [read, typeof JOINTS, socket, framed ? framed.body.textContent : "nothing"];
})(URL)"""


@pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine")
def test_a_page_on_another_port_reads_nothing_and_moves_nothing_even_with_the_token(
    server: LiveServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    poses: list[object] = []
    monkeypatch.setattr(server.state, "on_pose", poses.append)
    (tmp_path / "page.html").write_text("<!DOCTYPE html><html><body>another page</body></html>")
    handler = partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with (
        ThreadingHTTPServer(("127.0.0.1", 0), handler) as other,
        Browser(tmp_path / "profile") as browser,
        ExitStack() as end,
    ):
        threading.Thread(target=other.serve_forever).start()
        end.callback(other.shutdown)
        browser.open(f"http://127.0.0.1:{other.server_address[1]}/page.html")
        browser.wait_for("document.body && document.body.textContent === 'another page'")
        tried = browser.run(ATTEMPTS.replace("START", VESSEL_START).replace("URL", json.dumps(server.url)))
        assert tried == ["nothing", "undefined", "nothing", "nothing"]
        assert not poses
        browser.open(server.url)  # of its own page it is
        browser.wait_for("document.body && document.body.dataset.updates >= 1")
        assert poses


def test_every_answer_keeps_itself_to_its_origin(server: LiveServer) -> None:
    for code, _, headers in (get(server, "/scene.js"), get(server, "/nothing"), ask(server, "/scene.js")):
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin", code
        assert headers["Referrer-Policy"] == "no-referrer" and headers["X-Content-Type-Options"] == "nosniff"


def test_token_differs_between_starts(server: LiveServer) -> None:
    with LiveServer(server.state) as other:
        assert other.token != server.token and len(other.token) >= 32


def test_plus_sign_of_an_exponent_is_one(server: LiveServer) -> None:
    plain, exponent = get(server, "/pose?q=20,-60,80,-50"), get(server, "/pose?q=2e+1,-6E+1,80,-50")
    assert exponent[0] == 200 and exponent[1] == plain[1]


def test_turns_beyond_counting_are_refused(server: LiveServer) -> None:
    code, answer, _ = get(server, "/pose?q=1e22,-60,80,-86.4")
    assert code == 200 and "must be within" in answer["refusal"] or code == 400 and "at most" in answer["error"]


@pytest.mark.parametrize(
    "head",
    [
        b"GET http://[ HTTP/1.1\r\n\r\n",
        b"GET\r\n\r\n",
        b"\r\n\r\n",
        b"\xff\xfe / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n",
    ],
)
def test_broken_requests_are_answered(server: LiveServer, capfd: pytest.CaptureFixture[str], head: bytes) -> None:
    with socket.create_connection(server.server_address, timeout=30) as client:
        client.sendall(head)
        answer = client.recv(100_000)
    assert answer.startswith(b"HTTP/1.1 400 ") and b"not a request" in answer
    assert get(server, "/")[0] == 200 and capfd.readouterr().err == ""


def test_clients_that_leave_are_let_go_quietly(server: LiveServer, capfd: pytest.CaptureFixture[str]) -> None:
    reset = struct.pack("ii", 1, 0)
    for text in (b"", b"GET /", f"GET /{server.token}/plotly.js HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()):
        client = socket.create_connection(server.server_address, timeout=30)
        client.sendall(text)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
        client.close()
    with socket.create_connection(server.server_address, timeout=30) as client, suppress(ConnectionError):
        client.sendall(b"x" * 10**6)  # more than a request may be long
        client.recv(100)
    assert get(server, "/")[0] == 200 and capfd.readouterr().err == ""


def test_silent_clients_keep_nobody_waiting(server: LiveServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that heard one out before the next would answer after ten minutes, when the asking has long given up."""
    monkeypatch.setattr("ctrplan.reports.live_server.HEAD_S", 600.0)
    silent = [socket.create_connection(server.server_address, timeout=30) for _ in range(60)]
    assert get(server, "/")[0] == 200
    assert select.select(silent, [], [], 0)[0] == []  # none of them has been let go for it
    for client in silent:
        client.close()


def test_slow_clients_are_let_go(server: LiveServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """However they drip their bytes."""
    monkeypatch.setattr("ctrplan.reports.live_server.HEAD_S", 1.0)
    silent = [socket.create_connection(server.server_address, timeout=30) for _ in range(60)]
    assert get(server, "/")[0] == 200
    drip, dripped = silent.pop(), 0
    with suppress(ConnectionError):
        while dripped < 100:
            drip.sendall(b"G")
            dripped += 1
            time.sleep(0.1)
    assert dripped < 40
    assert [client.recv(10) for client in silent] == [b""] * 59
    for client in (drip, *silent):
        client.close()


def test_many_requests_at_once_are_all_answered(server: LiveServer) -> None:
    """600 at the same time, every twelfth with a pose to solve."""
    asked = [(f"/pose?q={VESSEL_START}", b"200")] + 11 * [("/pose?q=1,2", b"400")]
    clients = []
    for k in range(600):  # each asks when it has come: all poses are solved in this process, which slows the asking
        clients.append(socket.create_connection(server.server_address, timeout=120))
        path = asked[k % len(asked)][0]
        clients[k].sendall(f"GET /{server.token}{path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
    assert threading.active_count() < 20
    for k, client in enumerate(clients):
        assert client.recv(100_000)[9:12] == asked[k % len(asked)][1]
        client.close()


def test_more_connections_than_allowed_are_told_so(server: LiveServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ctrplan.reports.live_server.MOST_CONNECTIONS", 3)
    idle = [socket.create_connection(server.server_address, timeout=30) for _ in range(3)]
    code, answer, _ = get(server, "/")
    assert code == 503 and "too many" in answer["error"]
    for client in idle:
        client.close()


def test_fault_of_the_program_is_an_error_for_the_page(
    server: LiveServer, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def broken(values: list[float]) -> dict[str, Any]:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(server.state, "at", broken)
    code, answer, _ = get(server, f"/pose?q={VESSEL_START}")
    assert code == 500 and "the program failed" in answer["error"]
    assert "Traceback" not in capfd.readouterr().err


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
    port, token = line.split("127.0.0.1:")[1].split("/")[:2]
    connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=60)
    connection.request("GET", f"/{token}/pose?q=0,90,0")
    assert json.loads(connection.getresponse().read())["bound_mm"] > 0
    connection.close()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and "Traceback" not in errors


def test_ctrl_c_leaves_nothing_behind() -> None:
    """An interrupted wait took the serving thread for ended: it went on, its socket was closed and trees leaked."""
    command = [sys.executable, "-c", INTERRUPTIBLE, "view", str(SCENARIOS / "vessel.toml"), "--no-browser"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    assert process.stdout is not None and process.stdout.readline() == "up\n" and process.stdout.readline()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0 and errors == ""
