"""What an answer states beside names: slips, wrong tubes, errors that go along with time, proposed poses, the radius.

    python -m banks.stated FOLDER --seed 1 --count 8 --row slip drift    # in tests/oracles; half a minute a set

- slip: a collar slips once by 10 to 20 degrees; told if its tube is named.
- wrong tube: a tube is 0.55 to 0.7 or 1.4 to 1.7 times as curved as its file; told if the headline says so of it.
- drift: what is measured swings by 1.7 mm with 1.2 to 3 periods in the experiment; told if the errors are said to go
  along with time, and nothing else is named.
- decide: the true effect and another one are fitted to 12 configurations, three poses are proposed, solved by the
  generator and measured; told apart if the true one is decided.

Of whatever is named, or of a wrong tube, 8 configurations that nothing has read are measured besides: how many tips are
inside the radius that is stated (`model_error_mm`, with the noise in squares), without and with what the intervals of
parameters leave open there.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hidden_effects.case import Case, Made, make
from hidden_effects.chain import poses
from hidden_effects.dataset import measurements_csv, robot_toml
from hidden_effects.effects import add_sensor
from hidden_effects.equilibrium import NoEquilibrium
from hidden_effects.experiment import Experiment, approaches
from hidden_effects.noise import add_noise
from hidden_effects.score import wilson
from hidden_effects.world import Motion, World

from ctrplan.base.arrays import CHI95
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis import Diagnosis, diagnose
from ctrplan.diagnosis.next_experiment import decision, proposals, proposed_waypoints
from ctrplan.diagnosis.usable_poses import bench_of, checked_split, usable_poses
from ctrplan.diagnosis.verdict import Alternative, Finding
from ctrplan.diagnosis.workbench import candidates
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.robot.robot import Robot

Array = np.ndarray
ROWS = ("slip", "wrong tube", "drift", "decide")
ROBOTS = ("two tubes", "three tubes")
CONFIGURATIONS, UNREAD, RETRIES = 16, 8, 8
SWING_M = 1.7e-3
RIVALS = (  # the true effect and what is asked beside it
    ("tip_load", "gravity"),
    ("gravity", "tip_load"),
    ("joint_scale", "eccentricity"),
    ("eccentricity", "homing_offset"),
    ("base_misalignment", "sensor_offset"),
    ("sensor_offset", "base_misalignment"),
    ("backlash", "friction"),
    ("friction", "backlash"),
    ("clearance", "shaft_torsion"),
    ("shaft_torsion", "clearance"),
)


@dataclass(frozen=True)
class Swing:
    """What is measured swings by (3,) [m], with a period."""

    shift_m: Array
    period_s: float

    def __call__(self, p: Array, F: Array, time_s: Array) -> tuple[Array, Array]:
        return p + np.outer(np.sin(2 * np.pi * time_s / self.period_s), self.shift_m), F


def world_of(row: str, k: int, seed: int) -> tuple[Made, World, dict[str, Any]]:
    """A case, its true world, and what is true of it; drawn again where a pose has no equilibrium."""
    for attempt in range(RETRIES):
        drawn = 7_000_000 + 1000 * seed + 37 * k + 100_000 * attempt
        rng = np.random.default_rng([drawn, ROWS.index(row)])
        hidden: tuple[tuple[str, float], ...] = ()
        if row == "slip":
            hidden = (("collar_slip", float(rng.uniform(2, 4))),)
        if row == "decide":
            name = RIVALS[k % len(RIVALS)][0]
            hidden = (({"homing_offset": "homing_translation"}.get(name, name), 2.0),)
        count = 12 if row == "decide" else CONFIGURATIONS
        try:
            made = make(Case(f"{row}{k}", row, drawn, hidden, count=count, robot=ROBOTS[k % len(ROBOTS)]))
            world, truth = made.world, dict(made.parameters)
            if row == "wrong tube":
                tube, factor = (
                    int(rng.integers(world.n)),
                    float(rng.choice([rng.uniform(0.55, 0.7), rng.uniform(1.4, 1.7)])),
                )
                curvature = tuple(u * (factor if i == tube else 1) for i, u in enumerate(made.ordinary.curvature))
                world = replace(made.ordinary, curvature=curvature).of(made.case.believed())
                truth = {"tube": tube + 1, "factor": round(factor, 3)}
            if row == "drift":
                duration = made.experiment.duration_s
                period = duration / float(rng.uniform(1.2, 3.0))
                direction = rng.standard_normal(3)
                world = add_sensor(world, Swing(SWING_M * direction / np.linalg.norm(direction), period))
                truth = {"periods": round(duration / period, 2)}
            poses(world, made.experiment)
            return made, world, truth
        except (NoEquilibrium, np.linalg.LinAlgError):
            continue
    raise NoEquilibrium(f"{row} {k}: no robot has an equilibrium in every pose")


def measured(folder: Path, name: str, world: World, plan: Experiment, robot: Robot, seed: int) -> Measurements:
    """What the generator measures along a plan."""
    solved = poses(world, plan)
    p, tangent = add_noise(solved.p, solved.tangent, "gaussian", np.random.default_rng([seed, 2]))
    path = folder / f"{name}.csv"
    path.write_text(measurements_csv(plan, p, tangent), encoding="utf-8")
    return load_measurements(path, robot)


def inside(found: Diagnosis, unread: Measurements) -> dict[str, list[bool]]:
    """Whether unread tips are within the stated radius and the noise, without and with uncertain parameters.

    What parameters leave open has the covariance J C J^T, of which the mean over the coordinates counts.
    """
    fit = found.chosen.fit
    chain = ParametricChain(fit.chain.robot, unread, fit.chain.terms)
    chain.correction = friction_correction(chain, fit.p)
    predicted, sigma = chain.predict(fit.p), found.noise.position_m
    J = residuals(unread, predicted, found.noise, np.arange(unread.count)).J[:, :3]
    left_open = np.einsum("kip,pq,kiq->k", J, fit.covariance, J) / 3
    error, sound = distances(predicted, unread), predicted.sound
    radii = {"radius": 1.0 + 0 * left_open, "with parameters": 1.0 + left_open}
    within = {name: error <= np.hypot(found.model_error_m, CHI95 * sigma * np.sqrt(v)) for name, v in radii.items()}
    return {name: hits[sound].tolist() for name, hits in within.items()}


def told(row: str, found: Diagnosis, truth: dict[str, Any]) -> bool:
    """Whether what is hidden is told."""
    said = found.to_json()
    if row == "slip":
        turned = np.flatnonzero(truth["collar_slip"]["theta_rad"])[0] + 1
        return bool(said["slip"]) and said["slip"]["joint"] == f"theta_{turned}"
    if row == "wrong tube":
        return found.verdict == "no_missing_effect" and any(
            f"ube {truth['tube']}" in one for one in said["other_tubes"]
        )
    along = found.posterior is not None and found.posterior.along.get("time", 0.0) > 0.5
    return along and not [e for e in said["effects"] if e["name"] != "drift"] and found.verdict != "named"


def proposed(k: int, folder: Path, made: Made, robot: Robot, data: Measurements) -> dict[str, Any]:
    """Whether the true effect and another one are told apart by three proposed poses."""
    noise, usable = noise_floor(robot, data)[0], usable_poses(robot, data)
    known = candidates(robot, data)
    bench = bench_of(robot, data, checked_split(data, usable), noise)
    best = []
    for name in RIVALS[k % len(RIVALS)]:
        sets = [bench.scored([t]) for t in known.terms if t.name == name]
        best.append(min(sets, key=lambda one: one.fit.loss))
    chosen, other = (bench.corrected(one)[1] for one in best)
    rival = Alternative(other.terms[0], other)
    wanted = proposals(chosen.names[0], chosen, rival, bench.data, noise)
    sequence, theta, l_b = proposed_waypoints(wanted)
    number, n = np.arange(len(sequence)), robot.n
    reached = number % 2 == 1
    turns = np.where(reached[:, None], theta - np.roll(theta, 1, axis=0), 0.0)
    phi = np.sign(np.round(np.diff(turns, axis=1), 6))
    plan = Experiment(Motion(theta, l_b, 2.0 * number, sequence), reached, phi, np.zeros((len(theta), n - 1)))
    new = measured(folder, f"decide{k}_new", made.world, plan, robot, made.case.seed + 1)
    taken = decision(chosen, Finding(chosen.terms[0], (rival,)), new, noise)
    right = taken.is_decided and taken.explanations[0] == chosen.names[0]
    wrong = taken.is_decided and not right
    return {
        "told": right,
        "wrong": wrong,
        "expected": round(sum(p.log_odds for p in wanted), 1),
        "said": taken.sentence,
    }


def ask(row: str, k: int, folder: Path, seed: int) -> dict[str, Any]:
    """One set of a row."""
    made, world, truth = world_of(row, k, seed)
    toml = folder / f"{row}{k}.toml"
    toml.write_text(robot_toml(made.case.believed(), made.case.robot), encoding="utf-8")
    robot = load_robot(toml)
    data = measured(folder, f"{row}{k}", world, made.experiment, robot, made.case.seed)
    result: dict[str, Any] = {"row": row, "k": k, "robot": made.case.robot, "truth": truth}
    began = time.process_time()
    if row == "decide":
        return result | proposed(k, folder, made, robot, data)
    found = diagnose(robot, data, as_read=True)
    result |= {"told": told(row, found, truth), "seconds": round(time.process_time() - began, 1)}
    result |= {"verdict": found.headline(), "tubes": found.other_tubes, "where": found.place.sentence}
    if found.verdict == "named" or row == "wrong tube":
        rng, homed = np.random.default_rng([made.case.seed, 3]), replace(world, drive=())  # anew, after a slip
        unread = measured(folder, f"{row}{k}_unread", homed, approaches(made.case.believed(), UNREAD, rng), robot, k)
        result["inside"] = inside(found, unread)
    return result


def table(results: list[dict[str, Any]]) -> None:
    """Shares with their Wilson intervals."""
    print("\n| | hits | trials | 95 % interval |\n|---|---|---|---|")
    for row in ROWS:
        those = [one["told"] for one in results if one["row"] == row]
        if those:
            low, high = wilson(sum(those), len(those))
            print(f"| {row} | {sum(those)} | {len(those)} | {100 * low:.1f} to {100 * high:.1f} % |")
    for name in ("radius", "with parameters"):
        tips = [tip for one in results for tip in one.get("inside", {}).get(name, [])]
        if tips:
            low, high = wilson(sum(tips), len(tips))
            print(f"| unread tips inside: {name} | {sum(tips)} | {len(tips)} | {100 * low:.1f} to {100 * high:.1f} % |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=8, help="sets of a row")
    parser.add_argument("--row", nargs="*", default=ROWS, choices=ROWS)
    parser.add_argument("--robot", nargs="*", default=ROBOTS, choices=ROBOTS, help="sets of these, which take turns")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    kept = given.folder / "results.jsonl"
    results = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(one["row"], one["k"]) for one in results}
    for k in range(given.count):
        for row in given.row:
            if (row, k) not in done and ROBOTS[k % len(ROBOTS)] in given.robot:
                results.append(ask(row, k, given.folder, given.seed))
                with kept.open("a") as out:
                    out.write(json.dumps(results[-1]) + "\n")
                print(json.dumps(results[-1]), flush=True)
    table(results)


if __name__ == "__main__":
    main()
