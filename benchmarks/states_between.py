"""How far interpolated friction states are from solved ones, against what certificates take off for it.

python benchmarks/states_between.py [--legs 12] [SCENARIO.toml ...]

Random legs from random joints of the scenarios' robots: samples between those that certificates solve are taken from
their neighbours, on the mesh of the search and on that of the certificate, and solved for comparison. Printed for each
robot and mesh: samples, the largest error of a body point, the most that one is beyond what is taken off, and in how
many samples by more than 5 um. Samples where a state has no equilibrium, or another one than its neighbours, are
counted by themselves.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from own_cache import use_own_cache

import ctrplan
from ctrplan.base.arrays import Array
from ctrplan.certificate.every_state import LOOK_EVERY, SampleStates, StatesBetween
from ctrplan.certificate.walked_piece import walked
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.scenario import Scenario

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"
STATES = 12  # random ones of every sample
GRANTED_M = 5e-6
BRANCH_M = 5e-3
TURN_DEG, PUSH_MM = 20.0, 5.0  # of a leg at most


def leg(scenario: Scenario, rng: np.random.Generator) -> tuple[Array, Array]:
    """Joints at both ends: rotations and translations of random size, within limits."""
    space = JointSpace.of(scenario)
    start = space.sample(rng, 1)
    most = np.where(space.drive.is_rotation, np.radians(TURN_DEG), PUSH_MM * 1e-3)
    return start[0], space.projected(start + rng.uniform(-1, 1, start.shape) * most, start)[0]


def of_leg(scenario: Scenario, rng: np.random.Generator, accuracy: Accuracy) -> list[tuple[float, float]]:
    """Largest error [m], and the most that one is beyond what is taken off [m], by sample."""
    piece = walked(scenario, JointSpace.of(scenario), 0, *leg(scenario, rng), "search")
    count, found = len(piece.l_b), []
    solved = [SampleStates(scenario, piece, k, "search") for k in range(count)]
    for k in range(count):
        if k % LOOK_EVERY == 0:
            continue
        first, last = k - k % LOOK_EVERY, min(k - k % LOOK_EVERY + LOOK_EVERY, count - 1)
        own = SampleStates(scenario, piece, k, accuracy)
        share = (k - first) / max(last - first, 1)
        between = StatesBetween(own.known, (solved[first], solved[last]), share, accuracy != "search")
        states = [tuple(row) for row in rng.uniform(-1, 1, (STATES, scenario.robot.n - 1)).tolist()]
        guessed, true = between(states), own(states)
        error = np.array([np.linalg.norm(a.body_m - b.body_m, axis=1) for a, b in zip(guessed, true, strict=True)])
        doubt = np.array([a.doubt_m for a in guessed])
        found.append((float(error.max()), float((error - doubt).max())))
    return found


def of_different_robots(files: list[str]) -> Iterator[Scenario]:
    """The first scenario of each robot that has friction states."""
    seen: set[str] = set()
    for file in files:
        scenario = ctrplan.load_scenario(file)
        if scenario.robot.n > 1 and scenario.robot.friction.any() and str(scenario.robot.path) not in seen:
            seen.add(str(scenario.robot.path))
            yield scenario


def main() -> None:
    """Prints a line for each scenario and mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=sorted(map(str, SCENARIOS.glob("*.toml"))))
    parser.add_argument("--legs", type=int, default=12)
    options = parser.parse_args()
    use_own_cache()
    for scenario in of_different_robots(options.scenarios):
        name = Path(scenario.robot.path or "").stem
        for accuracy in ("search", "certificate"):
            rng = np.random.default_rng(0)
            rows = np.array([row for _ in range(options.legs) for row in of_leg(scenario, rng, accuracy)]).reshape(
                -1, 2
            )
            same = np.all(np.isfinite(rows), axis=1) & (rows[:, 0] < BRANCH_M)
            error, beyond = rows[same].max(axis=0) * 1e3
            print(
                f"{name:20} {accuracy:11} samples {same.sum():4} (other {np.sum(~same)}),"
                f" error {error:.3f} mm, beyond {beyond:.3f} mm, {np.mean(rows[same, 1] > GRANTED_M):.1%} of samples",
                flush=True,
            )


if __name__ == "__main__":
    main()
