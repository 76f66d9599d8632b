"""Whether 95 % intervals of effects hold: the noise of a bank's case drawn again and again, and how often they contain
the truth.

python benchmarks/diagnosis_intervals.py [--effects friction ...] [--size 4] [--seed 1] [--draws 40]

The case is made by the tests' own generator, of another formulation than the model (tests/oracles/hidden_effects).
The true set of effects is fitted to all poses, so that neither a selection nor the luck of one draw has a part in it.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import CATALOGUE
from ctrplan.diagnosis.workbench import Workbench
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.pipeline.term import term

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracles"))
from hidden_effects.case import Case, make
from hidden_effects.dataset import measurements_csv, robot_toml, write_folder
from hidden_effects.noise import POSITION_SIGMA_M, TANGENT_SIGMA_RAD, add_noise
from hidden_effects.world import believed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", nargs="+", default=["friction"])
    parser.add_argument("--size", type=float, default=4.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=40)
    given = parser.parse_args()
    case = Case("case", "single", given.seed, tuple((name, given.size) for name in given.effects))
    made = make(case)
    with TemporaryDirectory() as folder:
        table = measurements_csv(made.experiment, made.poses.p, made.poses.tangent)
        write_folder(Path(folder), {"robot.toml": robot_toml(believed(), "believed"), "measurements.csv": table}, {})
        robot = load_robot(Path(folder) / "robot.toml")
        data = load_measurements(Path(folder) / "measurements.csv", robot)
    truth = {name: value for values in made.parameters.values() for name, value in values.items()}
    effects = [CATALOGUE[name] for name in given.effects]
    terms = [term(effect, effect.variants(robot, data)[-1], robot) for effect in effects]
    errors: dict[str, list[float]] = {}
    for draw in range(given.draws):
        position, tangent = add_noise(made.poses.p, made.poses.tangent, "gaussian", np.random.default_rng(draw))
        noisy = replace(data, position_m=position, tangent=tangent)
        group, noise = noisy.configuration, Noise(POSITION_SIGMA_M, TANGENT_SIGMA_RAD)
        bench = Workbench(robot, noisy, noise, group, group % 6)
        fitted = bench.sized(bench.corrected(bench.scored(terms)))
        for t in terms:
            for name, e in estimates(fitted.fit, t).items():
                half = max(e.ci95[1] - e.value, e.value - e.ci95[0])
                errors.setdefault(name, []).append((e.value - truth.get(name, 0.0)) / half)
    print(f"{' and '.join(given.effects)} at size {given.size:g}, {data.count} poses, {given.draws} draws of the noise")
    for name, values in errors.items():
        inside, error = np.mean(np.abs(values) <= 1), np.array(values) * 1.96
        spread = f"error over its standard error: mean {error.mean():+.2f}, spread {error.std():.2f}"
        print(f"  {name:24} true {truth.get(name, 0.0):8.4g}: {100 * inside:5.1f} % inside; {spread}")
    every = np.abs(np.concatenate([np.array(v) for v in errors.values()])) <= 1
    print(f"  all: {100 * every.mean():.1f} % of {every.size}")


if __name__ == "__main__":
    main()
