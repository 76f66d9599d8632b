"""OpenIGTLink on the loopback: a client of another hand gets the poses where they are in the patient."""

from __future__ import annotations

import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyigtl
import pytest

from ctrplan.__main__ import main
from ctrplan.errors import InputError
from ctrplan.files.scenario_file import load_robot_or_scenario
from ctrplan.reports.live_state import LiveState
from ctrplan.reports.openigtlink import Broadcast, pose_messages, tip_messages
from ctrplan.reports.robot_surface import pose
from ctrplan.scenario.scenario import Scenario

PAIR = Path(__file__).parents[2] / "scenarios" / "robots" / "table_1_pair.toml"
WAIT_S = 5.0


@pytest.fixture
def broadcast() -> Iterator[Broadcast]:
    with Broadcast(0) as server:
        yield server


@pytest.fixture
def client(broadcast: Broadcast) -> Iterator[pyigtl.OpenIGTLinkClient]:
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", broadcast.port)
    yield client
    client.stop()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_robot_or_scenario(PAIR)


@pytest.mark.parametrize("frame", ["RAS", "LPS"])
def test_poses_of_the_live_view_come_to_a_client_in_ras(
    broadcast: Broadcast, client: pyigtl.OpenIGTLinkClient, scenario: Scenario, frame: str
) -> None:
    state = LiveState(scenario)
    state.on_pose = lambda shown: broadcast.send(pose_messages(shown, frame))  # type: ignore[arg-type]
    joints = [40.0, -25.0]
    state.at(joints)  # before or after the client is there: who comes late gets the last pose
    here = pose(scenario, state._joints(joints))
    sign = np.array([1, 1, 1] if frame == "RAS" else [-1, -1, 1])
    tip = client.wait_for_message("tip", WAIT_S)
    np.testing.assert_allclose(tip.matrix[:3, 3], here.tip_m * 1e3 * sign, atol=1e-3)
    np.testing.assert_allclose(tip.matrix[:3, 2], here.tubes[-1].tangent[-1] * sign, atol=1e-5)
    assert np.linalg.det(tip.matrix[:3, :3]) == pytest.approx(1, abs=1e-5)
    line = client.wait_for_message("centreline_1", WAIT_S)
    np.testing.assert_allclose(line.positions, here.tubes[0].centreline_m * 1e3 * sign, atol=1e-3)
    outer = client.wait_for_message("tube_1", WAIT_S)
    np.testing.assert_allclose(outer.matrix[:3, 3], here.tubes[0].centreline_m[-1] * 1e3 * sign, atol=1e-3)
    point = client.wait_for_message("tip_point", WAIT_S)
    np.testing.assert_allclose(np.ravel(point.positions), tip.matrix[:3, 3], atol=1e-4)


def test_a_listener_that_went_away_does_not_stop_the_others(broadcast: Broadcast) -> None:
    gone, stays = (pyigtl.OpenIGTLinkClient("127.0.0.1", broadcast.port) for _ in range(2))
    gone.stop()
    for k in range(40):
        broadcast.send(tip_messages(np.array([0.0, 0.0, k * 1e-3]), np.array([0.0, 0.6, 0.8])))
    try:
        assert stays.wait_for_message("tip", WAIT_S) is not None
    finally:
        stays.stop()


def test_a_listener_that_does_not_read_holds_up_nobody(broadcast: Broadcast, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once whoever sent waited for it, and so did all others, until it was let go."""
    monkeypatch.setattr("ctrplan.reports.openigtlink.SLOWEST_S", 10 * WAIT_S)
    deaf, content = socket.create_connection(("127.0.0.1", broadcast.port)), [bytes(64 * 1024)]
    hears = socket.create_connection(("127.0.0.1", broadcast.port))
    hears.settimeout(WAIT_S)
    while len(broadcast._listeners) < 2:
        threading.Event().wait(0.01)
    with deaf, hears:
        for _ in range(400):  # more than a connection keeps
            broadcast.send(content)
            left = len(content[0])
            while left:
                left -= len(hears.recv(left))


def test_a_connection_that_fails_is_not_the_last(broadcast: Broadcast, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once the first that was given up before it was accepted was the end of listening."""
    given, faults = broadcast.socket.accept, [OSError("given up")] * 2

    class Flaky:
        """The socket, which fails twice."""

        def accept(self) -> object:
            if faults:
                raise faults.pop()
            return given()

        def __getattr__(self, name: str) -> object:
            return getattr(broadcast_socket, name)

    broadcast_socket = broadcast.socket
    monkeypatch.setattr(broadcast, "socket", Flaky())
    broadcast.send([b"last"])
    for _ in range(2):  # the first was accepted before
        with socket.create_connection(("127.0.0.1", broadcast.port)) as hears:
            hears.settimeout(WAIT_S)
            assert hears.recv(4) == b"last"
    assert not faults


def test_simulated_tips_are_played_to_who_listens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "path.csv").write_text(
        "theta_1_rad,theta_2_rad,l_1_m,l_2_m,time_s\n0,0,0,-0.017,0\n0,0.4,0,-0.017,0.2\n"
    )
    with Broadcast(0) as server:
        port = server.port  # free again
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", port)
    command = ["simulate", str(PAIR), str(tmp_path / "path.csv"), "-o", str(tmp_path / "out"), "--igtl", str(port)]
    playing = threading.Thread(target=main, args=(command,))
    playing.start()
    tip = client.wait_for_message("tip", 20)
    playing.join()
    client.stop()
    rows = np.genfromtxt(tmp_path / "out" / "poses.csv", delimiter=",", names=True)
    tips = np.column_stack([rows[name] for name in rows.dtype.names if name in ("x_m", "y_m", "z_m")])
    apart = np.linalg.norm(tips[:, :3] * 1e3 * [-1, -1, 1] - tip.matrix[:3, 3], axis=1)
    assert apart.min() < 1e-3


def test_without_the_library_or_a_frame_it_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(PAIR), "--no-browser", "--igtl", "0"]) == 2
    assert "--frame: must be RAS or LPS" in capsys.readouterr().err
    assert main(["simulate", str(PAIR), "path.csv", "--measured", "--igtl", "0"]) == 2
    assert "--igtl = 0: goes without --measured" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyigtl", None)
    with pytest.raises(InputError, match=r"pip install ctrplan\[live\]"):
        tip_messages(np.zeros(3), np.array([0.0, 0.0, 1.0]))
