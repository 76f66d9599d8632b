"""`ctrplan view`: the robot in a browser, with a slider for every joint."""

from __future__ import annotations

import argparse
import sys
import webbrowser

from ctrplan.errors import InputError


def run_view(arguments: argparse.Namespace) -> int:
    """Serves the page until Ctrl-C; returns 0. Raises CtrplanError."""
    from ctrplan.bare_scenario import load_robot_or_scenario
    from ctrplan.live_server import LiveServer
    from ctrplan.live_state import LiveState

    if not 0 <= arguments.port <= 65535:
        raise InputError("must be from 0 to 65535", key="--port", value=arguments.port)
    scenario = load_robot_or_scenario(arguments.file, arguments.overrides)
    for warning in scenario.warnings:
        print(f"ctrplan: warning: {warning}", file=sys.stderr)
    with LiveServer(LiveState(scenario), arguments.port) as server:
        print(f"{scenario.name}: {server.url}   (Ctrl-C ends)", flush=True)
        if not arguments.no_browser:
            webbrowser.open(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()
    return 0
