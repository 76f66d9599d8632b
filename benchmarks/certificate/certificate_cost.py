"""What a certificate costs: of a plan of every shipped scenario with one target, alone or against another checkout.

python benchmarks/run.py certificate_cost plan FILE                       writes the legs of a plan of each
python benchmarks/run.py certificate_cost time FILE [--against CHECKOUT]  seconds by the clock, in alternation

A checkout needs its compiled core in ctrplan/. The certificate as it is stated with a plan, histories simulated; and
the walk alone as a search asks for it. The first of a run is not counted: grids and friction laws are kept then.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import common
import numpy as np
from common import ROOT, SCENARIOS, again, table

SEARCH_TIME_S = 10.0
KINDS = ("certificate", "walk of a search")
Times = dict[str, list[float]]  # of a scenario, seconds of each kind


def main() -> None:
    parser = common.parser(__doc__)
    parser.add_argument("command", choices=["plan", "time", "once"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    if given.command == "plan":
        given.file.write_text(json.dumps(planned(), indent=1), encoding="utf-8")
    elif given.command == "once":
        print(json.dumps(once(json.loads(given.file.read_text(encoding="utf-8")))))
    else:
        compare(given.file, given.against, given.rounds)


def planned() -> dict[str, list[list[float]]]:
    """Joint values at the corners of a plan of each scenario."""
    import ctrplan

    found = {}
    for path in sorted(SCENARIOS.glob("*.toml")):
        scenario = ctrplan.load_scenario(path)
        if scenario.via or scenario.goal.line_m is not None:
            continue
        plan = ctrplan.plan(scenario, time_s=SEARCH_TIME_S)
        found[path.stem] = plan.waypoints.tolist()
        print(f"{path.stem}: {plan.certificate.cost_mm:.0f} mm", file=sys.stderr, flush=True)
    return found


def once(legs: dict[str, list[list[float]]]) -> Times:
    """With the package that Python finds first."""
    import ctrplan

    certify, walk_legs = of_either_layout("certify", "certify"), of_either_layout("walk_legs", "walked_legs")
    spare = {"spare_m": 0.5e-3} if "spare_m" in inspect.signature(walk_legs).parameters else {}
    times = {}
    for name, rows in legs.items():
        scenario, corners = ctrplan.load_scenario(SCENARIOS / f"{name}.toml"), np.array(rows)
        certify(scenario, corners)
        seconds = [
            timed(lambda: certify(scenario, corners)),  # noqa: B023 (called at once)
            timed(lambda: walk_legs(scenario, corners, **spare)),  # noqa: B023
        ]
        times[name] = seconds
    return times


def of_either_layout(name: str, module: str) -> Callable[..., object]:
    """A function of the certificate, wherever a checkout has it."""
    for package in ("ctrplan.certificate", "ctrplan.planning.certificate"):
        with suppress(ImportError):
            return getattr(importlib.import_module(f"{package}.{module}"), name)  # type: ignore[no-any-return]
    raise ImportError(f"no {name} in this checkout")


def timed(work: Callable[[], object]) -> float:
    """Seconds by the clock."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def compare(file: Path, against: Path | None, rounds: int) -> None:
    """Medians of the rounds, and with another checkout how many times as long it takes here."""
    checkouts = [ROOT] + ([against.resolve()] if against else [])
    runs: list[list[Times]] = [[] for _ in checkouts]
    for _ in range(rounds):
        for found, checkout in zip(runs, checkouts, strict=True):
            environment = os.environ | {"PYTHONPATH": str(checkout)}
            command = again("certificate_cost", "once", str(file.resolve()))
            printed = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE).stdout
            found.append(json.loads(printed))
    names = list(runs[0][0])
    seconds = np.array([[np.median([run[name] for run in found], axis=0) for name in names] for found in runs])
    heads = [f"{kind} (s)" for kind in KINDS] + ([f"{kind}, ratio" for kind in KINDS] if against else [])
    ratios = seconds[0] / seconds[1] if against else np.zeros((len(names), 0))
    rows = [(name, *(f"{x:.2f}" for x in (*seconds[0][k], *ratios[k]))) for k, name in enumerate(names)]
    if against:
        for label, value in (("median", np.median(ratios, axis=0)), ("largest", ratios.max(axis=0))):
            rows.append((label, "", "", *(f"{x:.2f}" for x in value)))
    table("certificates", ("scenario", *heads), rows)
