"""`ctrplan view`: the robot in a browser, with a slider for every joint."""

from __future__ import annotations

import argparse
import os
import webbrowser
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from ctrplan.base.arguments import Whole
from ctrplan.commands.options import add_allow_outside_option, add_igtl_option, add_number, add_set_option, refuse_alone
from ctrplan.commands.terminal import warn

if TYPE_CHECKING:
    from ctrplan.files.plan_file import WrittenPlan
    from ctrplan.reports.live_state import LiveState
    from ctrplan.scenario.scenario import Scenario

DESCRIPTION = (
    "A live 3-D page on this machine: the robot, its friction envelope and its error bound as the "
    "joints move. Nothing is loaded from the network."
)
EXAMPLES = """examples:
  ctrplan view scenarios/robots/three_tube.toml
  ctrplan view scenarios/airway.toml --no-browser --port 8080
  ctrplan view out/plan.json
  ctrplan view scenarios/airway.toml --igtl 18944 --frame LPS
"""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the command's arguments."""
    parser.add_argument("file", metavar="ROBOT.toml|SCENARIO.toml|PLAN.json", help="of a plan the motion can be played")
    add_number(parser, "--port", Whole(0, 65535), default=0, help="of 127.0.0.1 (default: a free one)")
    parser.add_argument("--no-browser", action="store_true", help="only print the page's address")
    add_igtl_option(parser, "tip and tubes of every pose")
    parser.add_argument("--frame", metavar="RAS|LPS", help="of the anatomy, for --igtl, which sends RAS")
    add_allow_outside_option(parser)
    add_set_option(parser, "a key of the file", "robot.tube.2.poisson_ratio=0.28")


def run(arguments: argparse.Namespace) -> int:
    """Serves the page until Ctrl-C; returns 0. Raises CtrplanError."""
    from ctrplan.reports.live_server import LiveServer
    from ctrplan.reports.live_state import LiveState

    scenario, motion = loaded(arguments)
    warn(scenario.warnings)
    state = LiveState(scenario, motion)
    with _sending(arguments, state), LiveServer(state, arguments.port) as server:
        print(f"{scenario.name}: {server.url}   (Ctrl-C ends)", flush=True)
        if not arguments.no_browser:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return 0


def loaded(arguments: argparse.Namespace) -> tuple[Scenario, WrittenPlan | None]:
    """The scenario of the file, and the plan if that is one. Raises InputError."""
    from ctrplan.files.plan_file import load_plan
    from ctrplan.files.plan_inputs import SUFFIX
    from ctrplan.files.scenario_file import load_robot_or_scenario

    if arguments.file.lower().endswith((".json", SUFFIX)) or os.path.isdir(arguments.file):
        plan = load_plan(arguments.file, None, arguments.overrides, allow_outside=arguments.allow_outside)
        warn(plan.warnings)
        return plan.scenario, plan
    return load_robot_or_scenario(arguments.file, arguments.overrides, allow_outside=arguments.allow_outside), None


def _sending(arguments: argparse.Namespace, state: LiveState) -> AbstractContextManager[Any]:
    """Sends every pose that is shown, the start first, if that was asked for."""
    if arguments.igtl is None:
        refuse_alone({"--frame": arguments.frame}, "--igtl")
        return nullcontext()
    from ctrplan.files.slicer_markups import patient_frame
    from ctrplan.reports.openigtlink import Broadcast, pose_messages, pyigtl

    frame = patient_frame(state.scenario, arguments.frame)
    pyigtl()
    broadcast = Broadcast(arguments.igtl)
    state.on_pose = lambda pose: broadcast.send(pose_messages(pose, frame))
    print(f"OpenIGTLink: 127.0.0.1:{broadcast.port}, RAS and mm", flush=True)
    return broadcast
