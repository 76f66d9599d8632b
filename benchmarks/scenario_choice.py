"""How much choice do the scenarios' goals leave? Goal configurations, their bounds, and the ratio between them.

python benchmarks/scenario_choice.py [--write]     --write puts the ratios into docs/scenarios.md
"""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from own_cache import use_own_cache

from ctrplan.files.scenario_file import load_scenario
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.goal_states import goal_states

ROOT = Path(__file__).resolve().parents[1]


def choice(path: Path) -> tuple[int, float, float] | None:
    """Number of valid goal configurations, lowest and highest bound [mm]; None for joint goals and tours."""
    scenario = load_scenario(path)
    first = scenario.targets[0]
    if first.tip_m is None or len(scenario.targets) > 2:
        return None
    stage = replace(scenario, goal=first, via=())
    bounds = [goal.bound_m * 1e3 for goal in goal_states(MotionChecker(stage), np.random.default_rng(0))]
    return len(bounds), min(bounds), max(bounds)


def main() -> None:
    use_own_cache()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help="put the ratios into docs/scenarios.md")
    arguments = parser.parse_args()
    page = ROOT / "docs" / "scenarios.md"
    text = page.read_text(encoding="utf-8")
    for path in sorted((ROOT / "scenarios").glob("*.toml")):
        found = choice(path)
        if found is None:
            continue
        count, low, high = found
        print(f"{path.stem:15} {count:3} goal configurations, bounds {low:.2f} to {high:.2f} mm, {high / low:.1f} x")
        text = re.sub(rf"(\| `{path.stem}` \|.*\| )[^|]+\|$", rf"\g<1>{high / low:.1f} x |", text, flags=re.MULTILINE)
    if arguments.write:
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
