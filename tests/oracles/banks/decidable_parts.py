"""Whether a known part could be told at all: how far it stands out for one who knows everything else.

    python -m banks.decidable_parts FOLDER w12_00 w45_01    # in tests/oracles; sets of built_terms, 15 s each

The world is solved again without its known effect. What that changes is the effect's own part of the measurements, in
standard errors: beside the calibration and the frame, which are fitted, and a covariance. `knows all` has the noise and
the true covariance of the smooth error, and the unknown effect taken out exactly: no test can do better. `knows sizes`
has the unknown effect as the random error of the size that the diagnosis takes it for before a term is built.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
from hidden_effects.case import make
from hidden_effects.leftovers import DEG_PER_MM, _places

from banks.built_terms import known
from ctrplan.calibration.observed_noise import noise_floor
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis.correlated_bench import FRAMES, CorrelatedBench
from ctrplan.diagnosis.usable_poses import blocks, usable_poses
from ctrplan.files.measurement_file import load_measurements
from ctrplan.files.robot_file import load_robot
from ctrplan.measurement.measurements import split

Array = np.ndarray


def standing_out(folder: Path) -> tuple[float, float]:
    """Standard errors of the known part in a set: knowing all, and knowing sizes."""
    robot, truth = load_robot(folder / "robot.toml"), json.loads((folder / "truth.json").read_text())
    data = load_measurements(folder / "measurements.csv", robot)
    case, plan, poses, _ = pickle.loads(folder.with_name(folder.name[:3] + ".pickle").read_bytes())
    without = make(replace(case, hidden=case.hidden[:1])).poses
    noise, usable = noise_floor(robot, data)[0], usable_poses(robot, data)
    block = blocks(data, 0.0)
    chosen = split(usable, block)
    some = chosen.selection
    bench = CorrelatedBench(robot, data.subset(some), noise, block[some])
    base = bench.scored([])
    predicted, group = base.fit.chain.predict(base.fit.p), bench.whitening_group
    seen = [
        residuals(replace(bench.data, position_m=one.p[some], tangent=one.tangent[some]), predicted, noise, group)
        for one in (poses, without)
    ]
    effect, J = seen[0].r - seen[1].r, seen[0].J
    fitted = np.array([t.name not in FRAMES or t.name not in known(truth) for t in base.fit.chain.terms])
    columns = np.repeat(fitted, [len(t.parameters) for t in base.fit.chain.terms])
    J, precision = J[:, :, columns], base.fit.precision[columns]
    place = _places(plan, truth["kind"])[some]
    square = ((place[:, None] - place[None]) ** 2).sum(axis=2)
    smooth = np.exp(-square / (2 * truth["memory"] ** 2))
    sizes = [1e-3 * truth["size_mm"] / np.sqrt(3) / noise.position_m] * 3
    sizes += [np.radians(DEG_PER_MM * truth["size_mm"]) / np.sqrt(2) / noise.tangent_rad] * 2
    roots = [np.linalg.cholesky(np.eye(len(place)) + size**2 * smooth) for size in sizes]
    knows_all = _errors(_over(effect, roots), _over(J, roots), precision)
    found = bench.estimated(base)
    return knows_all, _errors(found.whitened(effect), found.whitened(J), precision)


def _over(values: Array, roots: list[Array]) -> Array:
    """(K, 5, ...) numbers over the roots (K, K) of their covariances."""
    return np.stack([np.linalg.solve(root, values[:, k]) for k, root in enumerate(roots)], axis=1)


def _errors(effect: Array, J: Array, precision: Array) -> float:
    """Standard errors of an effect (K, 5) beside fitted parameters (K, 5, P), all over their covariance."""
    flat, y = J.reshape(-1, J.shape[2]), effect.ravel()
    scale = 1 / np.sqrt(precision)
    H = flat.T @ flat * np.outer(scale, scale) + np.eye(len(scale))
    g = scale * (flat.T @ y)
    return float(np.sqrt(max(y @ y - g @ np.linalg.solve(H, g), 0.0)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("sets", nargs="+")
    given = parser.parse_args()
    print("| set | hidden | smooth error [mm] | standard errors: knows all | knows sizes |\n|---|---|---|---|---|")
    for name in given.sets:
        truth = json.loads((given.folder / name / "truth.json").read_text())
        hidden = ", ".join(f"{effect} {size:g}" for effect, size in truth["hidden"])
        every, sizes = standing_out(given.folder / name)
        print(f"| {name} | {hidden} | {truth['size_mm']:g} | {every:.1f} | {sizes:.1f} |", flush=True)


if __name__ == "__main__":
    main()
