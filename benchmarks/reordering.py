"""What does the order of motions leave at the goal? Every scenario, predicted by history, beside the worst case.

python benchmarks/reordering.py [--seed N] [--count S] [--write] [SCENARIO ...]

--write puts the table into docs/log/planning.md. The plan as found is the search's path before reordering. "with
settling" is the reordered plan with the oscillation at its end, also where `ctrplan plan` would leave it out. A reason
in brackets, such as "(collides)": the motion is not valid. Of several targets the last one counts; where that is a
line, along which joints have one way to go, the one before it. Searches end by work counted.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from own_cache import use_own_cache
from page_table import put_into_page

import ctrplan
from ctrplan.errors import CtrplanError
from ctrplan.planning import MotionChecker, Plan
from ctrplan.planning.oscillate import AMPLITUDES_DEG, oscillation, turnings
from ctrplan.scenario.prediction import goal_error, start_states

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- reordering table -->\n", "<!-- end of reordering table -->"
NAMES = ("as given", "as driven", "straight line", "translations first")
HEADER = (
    "| scenario | worst case | as found | reordered | straight line | translations first | reordered, with settling |\n"
    "|---|---|---|---|---|---|---|\n"
)


def settled(checker: MotionChecker, corners: np.ndarray) -> str:
    """The smallest error that the widest valid oscillation leaves at the end of a path, and how wide it is."""
    for degrees in AMPLITUDES_DEG:
        swings = [oscillation(corners[-1], np.radians(degrees) * turn) for turn in turnings(checker.space.drive)]
        valid = [
            swing for swing in swings if checker.along(np.concatenate([corners[-1:], swing[:2], corners[-1:]])).valid
        ]
        if valid:
            errors = [
                goal_error(checker.scenario.robot, np.concatenate([corners, swing]), start_states(checker.scenario))
                for swing in valid
            ]
            return f"{min(errors) * 1e3:.2f} mm ({degrees} deg)"
    return "no room"


def row(plan: Plan) -> str:
    checker = MotionChecker(plan.scenario)
    found = {other.name: other for other in plan.reorder.alternatives}
    cells = []
    for name in NAMES:
        error = found[name].goal_predicted_m
        shown = f"{error * 1e3:.2f} mm" if np.isfinite(error) else "no equilibrium"
        cells.append(shown + (f" ({_short(found[name].problem)})" if found[name].problem else ""))
    cells.append(settled(checker, plan.waypoints))
    bound = f"{plan.certificate.goal_bound_m * 1e3:.2f} mm"
    return f"| {plan.scenario.name} | {' | '.join([bound, *cells])} |\n"


def _short(problem: str) -> str:
    if "unstable" in problem:
        return "snaps"
    return "collides" if "anatomy" in problem else problem


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="*", help="names of scenarios; default: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=float, metavar="S", help="of search, by work counted (default: the scenario's)")
    parser.add_argument("--write", action="store_true", help="put the table into docs/log/planning.md")
    arguments = parser.parse_args()
    text = HEADER
    for path in sorted((ROOT / "scenarios").glob("*.toml")):
        if arguments.scenarios and path.stem not in arguments.scenarios:
            continue
        try:
            scenario = ctrplan.load_scenario(path, [f"planner.time_s={arguments.count}"] if arguments.count else [])
            if scenario.goal.line_m is not None:
                scenario = replace(scenario, goal=scenario.via[-1], via=scenario.via[:-1])
            scenario = replace(scenario, planner=msgspec.structs.replace(scenario.planner, settle="none"))
            text += row(ctrplan.plan(scenario, seed=arguments.seed))
        except CtrplanError as error:
            print(error, file=sys.stderr)
            text += f"| {path.stem} | no plan in time | | | | | |\n"
        print(text.splitlines()[-1], file=sys.stderr, flush=True)
    print(text)
    if arguments.write:
        page = ROOT / "docs" / "log" / "planning.md"
        table = page.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
        put_into_page(page, BEGIN, merged(table, text), END)


def merged(table: str, text: str) -> str:
    """The table with its rows renewed by those of another, by their scenarios."""
    head = HEADER.count("\n")
    rows = {line.split("|")[1].strip(): line for half in (table, text) for line in half.splitlines()[head:]}
    return HEADER + "".join(f"{rows[name]}\n" for name in sorted(rows))


if __name__ == "__main__":
    main()
