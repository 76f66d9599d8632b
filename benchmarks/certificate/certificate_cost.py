"""What a certificate costs: of a plan of every shipped scenario with one target, alone or against another checkout.

    python benchmarks/run.py certificate_cost plan FILE [SCENARIO ...]    writes the legs of a plan of each
    python benchmarks/run.py certificate_cost time FILE [--against CHECKOUT] [--rounds 3]    seconds by the clock

A checkout needs its compiled core in ctrplan/. The certificate as it is stated with a plan, histories simulated; and
the walk alone as a search asks for it. The first of a run is not counted: grids and friction laws are kept then.
"""

import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import common
import numpy as np
from common import ROOT, SCENARIOS, SHIPPED, elsewhere, table, took

SPARE_M = 0.5e-3  # that a search asks for
SEARCH_TIME_S = 10.0
KINDS = ("certificate", "walk of a search")


def planned(names: list[str]) -> dict[str, list[list[float]]]:
    """Joint values at the corners of a plan of each scenario."""
    import ctrplan

    found = {}
    common.end_searches_by_count()
    for name in names or SHIPPED:
        scenario = ctrplan.load_scenario(SCENARIOS / f"{name}.toml", [f"planner.time_s={SEARCH_TIME_S}"])
        if not scenario.via and scenario.goal.line_m is None:
            found[name] = ctrplan.plan(scenario).waypoints.tolist()
    return found


def once(legs: dict[str, list[list[float]]]) -> Iterator[float]:
    """Seconds by the clock of both kinds, scenario by scenario, with the package that Python finds first."""
    import ctrplan
    from ctrplan.certificate.certify import certify
    from ctrplan.certificate.walked_legs import walk_legs

    for name, rows in legs.items():
        scenario, corners = ctrplan.load_scenario(SCENARIOS / f"{name}.toml"), np.array(rows)
        certify(scenario, corners)
        yield took(certify, scenario, corners)[0]
        yield took(partial(walk_legs, spare_m=SPARE_M), scenario, corners)[0]


def compare(file: Path, names: list[str], against: Path | None, rounds: int) -> None:
    """Medians of the rounds, and with another checkout how many times as long it takes here."""
    trees = [ROOT] + ([against.resolve()] if against else [])
    runs = [[elsewhere(tree, "certificate_cost", "once", str(file.resolve())) for tree in trees] for _ in range(rounds)]
    seconds = np.median(runs, axis=0).reshape(len(trees), len(names), 2)
    heads = [f"{kind} (s)" for kind in KINDS] + ([f"{kind}, ratio" for kind in KINDS] if against else [])
    ratios = seconds[0] / seconds[1] if against else np.zeros((len(names), 0))
    rows = [(name, *(f"{x:.2f}" for x in (*seconds[0][k], *ratios[k]))) for k, name in enumerate(names)]
    if against:
        for label, value in (("median", np.median(ratios, axis=0)), ("largest", ratios.max(axis=0))):
            rows.append((label, "", "", *(f"{x:.2f}" for x in value)))
    table("certificates", ("scenario", *heads), rows)


def main() -> None:
    places = ("command", ("plan", "time", "once")), "file", ("scenarios*", SHIPPED)
    given = common.arguments(__doc__, *places, against=Path, rounds=3)
    file = Path(given.file)
    if given.command == "plan":
        file.write_text(json.dumps(planned(given.scenarios), indent=1), encoding="utf-8")
        return
    if not file.exists():
        sys.exit(f"{file}: is not there; `certificate_cost plan {file}` writes it")
    legs = json.loads(file.read_text(encoding="utf-8"))
    if given.command == "once":
        print(*once(legs))
    else:
        compare(file, list(legs), given.against, given.rounds)
