"""How far is the friction law from full simulations? Every shipped robot with friction, on histories it has not seen.

python benchmarks/friction_law.py [--histories N] [--write]     --write puts the table into docs/log/planning.md
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from page_table import put_into_page

import ctrplan
from ctrplan.mechanics.friction import FrictionLaw, largest_deviation
from ctrplan.robot.friction_calibration import HISTORIES, SimulatedPath, fit, misses, simulated_paths

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- friction law table -->\n", "<!-- end of friction law table -->"
HEADER = (
    "| robot | loading | release | calibrated in | law: rms, 95 % | no law: rms | worst case: rms "
    "| worst case left: rms | above it: share, largest |\n|---|---|---|---|---|---|---|---|---|\n"
)


def rms_mm(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) * 1e3


def load_left_m(law: FrictionLaw, path: SimulatedPath) -> np.ndarray:
    """(K,) the error that the search would assume, fully loaded at the start of the path."""
    loads = [np.ones(path.theta_b.shape[1] - 1)]
    for k in range(1, len(path.theta_b)):
        rows = slice(k - 1, k + 1)
        loads.append(law.load_left(loads[-1], path.theta_b[rows], path.l_b[rows], np.ones(1))[0])
    return largest_deviation(path.corner_tip_m, path.frictionless_m, np.array(loads))


def row(name: str, histories: int) -> str:
    robot = ctrplan.load_robot(ROOT / "scenarios" / "robots" / f"{name}.toml")
    began = time.monotonic()
    law = fit(robot, simulated_paths(robot, HISTORIES, np.random.default_rng(0)))
    seconds = time.monotonic() - began
    paths = simulated_paths(robot, histories, np.random.default_rng(1))
    errors = np.concatenate([misses(law, path) for path in paths])
    away = np.concatenate([np.linalg.norm(path.tip_m - path.frictionless_m, axis=1) for path in paths])
    worst = np.concatenate(
        [np.linalg.norm(path.corner_tip_m - path.frictionless_m[:, None], axis=2).max(axis=1) for path in paths]
    )
    left = np.concatenate([load_left_m(law, path) for path in paths])
    above = away - left
    loading = ", ".join(f"{degrees:.0f}" for degrees in np.degrees(law.loading_rad))
    release = ", ".join(f"{length:.2f}" for length in law.release_m * 1e3)
    return (
        f"| {robot.name} | {loading} deg | {release} mm | {seconds:.1f} s | {rms_mm(errors):.2f} mm, "
        f"{np.quantile(errors, 0.95) * 1e3:.2f} mm | {rms_mm(away):.2f} mm | {rms_mm(worst):.2f} mm "
        f"| {rms_mm(left):.2f} mm | {100 * np.mean(above > 0.1e-3):.1f} %, {max(above.max(), 0) * 1e3:.2f} mm |\n"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--histories", type=int, default=30, help="unseen histories of each robot")
    parser.add_argument("--write", action="store_true", help="put the table into docs/log/planning.md")
    arguments = parser.parse_args()
    text = HEADER
    for name in ("table_1_pair", "table_5_pair", "three_tube", "three_tube_calibrated"):
        text += row(name, arguments.histories)
        print(text.splitlines()[-1], file=sys.stderr, flush=True)
    print(text)
    if arguments.write:
        put_into_page(ROOT / "docs" / "log" / "planning.md", BEGIN, text, END)


if __name__ == "__main__":
    main()
