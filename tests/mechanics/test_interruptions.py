"""Ctrl-C ends every long call into the core within a second, and leaves histories where they were."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from places import ROBOTS

import ctrplan

ROBOT = ROBOTS / "three_tube.toml"
PATIENCE_S = 1.0

CHILD = """
import signal, sys, threading
import numpy as np
import ctrplan
from ctrplan.mechanics.history import HistoryOptions

signal.signal(signal.SIGINT, signal.default_int_handler)  # children of what runs in the background ignore it
robot = ctrplan.load_robot(sys.argv[1])
theta, l = np.zeros(3), np.array([0.0, -0.017, -0.0628])

def ways(count, step):
    turned = theta + np.arange(count)[:, None] * [0, step, -step]
    return turned, np.tile(l, (count, 1))

def history(options=None):
    made = robot.history(options=options)
    made.advance(theta, l)
    return made

moved = None
call = sys.argv[2]
if call == "advance":
    moved = history()
    work = lambda: moved.advance(theta + [0, 9e4, 0], l)
elif call == "advance in small steps":
    moved = history(HistoryOptions(rotation_rad=1e-4))
    work = lambda: moved.advance(theta + [0, 90, 0], l)
elif call == "follow":
    moved = history()
    work = lambda: moved.follow(*ways(5000, 0.3))
elif call == "tips":
    rows = ways(3_000_000, 1e-3)
    work = lambda: robot.mechanics.tips(*rows)
elif call == "bound_many":
    rows = ways(20_000, 1e-2)
    work = lambda: robot.mechanics._model.bound_many(*rows, "exact", 2)  # one chunk, however long
elif call == "tips_with_friction":
    rows = ways(50_000, 1e-2)
    work = lambda: robot.mechanics.tips_with_friction(*rows, np.ones((50_000, 2)))
elif call == "check_path":
    work = lambda: robot.mechanics.check_path(*ways(2000, 1.0))
before = moved.tip_beside([0.3, -0.3]) if moved else None
print("begun", flush=True)
try:
    work()
    print("ended by itself", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
    if moved:  # where it was, to the last digits, and able to go on
        assert np.allclose(moved.tip_beside([0.3, -0.3]), before, rtol=0, atol=1e-9)
        moved.advance(theta + [0, 0.1, 0], l)
    robot.bound(theta, l)
    print("goes on", flush=True)
"""


@pytest.mark.parametrize(
    "call",
    ["advance", "advance in small steps", "follow", "tips", "bound_many", "tips_with_friction", "check_path"],
)
def test_ctrl_c_ends_a_long_call_within_a_second_and_the_robot_goes_on(call: str) -> None:
    command = [sys.executable, "-c", CHILD, str(ROBOT), call]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "begun\n"
        time.sleep(0.3)
        pressed = time.monotonic()
        child.send_signal(signal.SIGINT)
        assert child.stdout.readline() == "interrupted\n"
        assert time.monotonic() - pressed < PATIENCE_S
        assert child.stdout.readline() == "goes on\n"
    assert child.returncode == 0


def test_progress_of_a_followed_path_rises_and_what_it_raises_leaves_the_history_where_it_was() -> None:
    robot = ctrplan.load_robot(ROBOT)
    history = robot.history()
    theta, l = np.zeros(3), np.array([0.0, -0.017, -0.0628])  # noqa: E741
    history.advance(theta, l)
    before = history.tip_beside([0.5, 0.5])
    told: list[float] = []

    def stop_at_the_third(share: float) -> None:
        told.append(share)
        if len(told) == 3:
            raise RuntimeError("enough")

    turned = theta + np.arange(4000)[:, None] * [0, 0.3, -0.3]
    with pytest.raises(RuntimeError, match="enough"):
        history.follow(turned, np.tile(l, (4000, 1)), progress=stop_at_the_third)
    assert told == sorted(told) and 0 <= told[0] < told[-1] < 1
    np.testing.assert_allclose(history.tip_beside([0.5, 0.5]), before, rtol=0, atol=1e-9)
