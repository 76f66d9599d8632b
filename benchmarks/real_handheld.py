"""The handheld robot of github.com/NavidFeizi/Handheld_CTR_Control_ROS_WS as files that ctrplan reads, and how far it
is off by run.

    python benchmarks/real_handheld.py FOLDER OUTPUT [--calibrate] [--unread] [--floor] [--every 40]

FOLDER holds Joint_Values_RUN.dat and EM_Trajectory_RUN.dat (in the repository's history, Output_Files/Phantom): rows
that belong together, without clock; translations [m] and rotations [rad, wrapped now and then], innermost tube first;
the tip [m] in a frame at the robot's base, no tangent. A second sensor at the base gives that frame, which was set up
anew between runs: each run has a frame of its own. OUTPUT gets robot.toml, a mapping file for each set of runs and a
copy of the data, which have no licence: keep them out of any repository. Tubes are those of controller_node.cpp. Its
outer tube has an inner diameter of 1.1448 mm, into which the middle tube of 1.372 mm does not fit: taken for 1.448 mm.
With --calibrate: ordinary calibration without friction and with the base free on square_1, helix_1 and hypo_1, and the
rms by run on all. With --unread: the same with a frame for each run, and with zeros of the joints for each besides, on
the seven other runs in frames and zeros that the other 15 blocks of the run show. With --floor: what smooth functions
of the joints close. All runs are calibrated together with a frame each; what remains of a run is predicted from the
other runs by smooth functions of all four joints that move (ridge regression on Gaussian kernels), in a frame found by
half of the run.
"""

from __future__ import annotations

import argparse
import math
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

import tomli_w

from ctrplan.base.arrays import Array
from ctrplan.measurement.measurements import Measurements

TRAINING = ("square_1", "helix_1", "hypo_1")
OUTER_MM, INNER_MM = (2.045, 1.372, 0.940), (1.448, 0.965, 0.737)  # outermost first
YOUNG_PA = (74.9122e9, 30e9, 30e9)
STRAIGHT_MM, CURVED_MM = (62.0, 61.0, 151.0), (0.0, 78.0, 58.0)
RADIUS_MM = (math.inf, 95.0, 41.0)
WIDTHS = (0.7, 1.0, 1.5, 2.5)  # of kernels over cosines and sines of rotations, and translations over 20 mm


def robot() -> dict[str, object]:
    """The content of robot.toml."""
    tubes = []
    for outer, inner, young, straight, curved, radius in zip(
        OUTER_MM, INNER_MM, YOUNG_PA, STRAIGHT_MM, CURVED_MM, RADIUS_MM, strict=True
    ):
        sections = [{"length_mm": straight, "curvature_x_per_m": 0.0, "curvature_y_per_m": 0.0}]
        if curved:
            sections += [{"length_mm": curved, "curvature_x_per_m": 1e3 / radius, "curvature_y_per_m": 0.0}]
        area_moment_m4 = math.pi / 64 * (outer**4 - inner**4) * 1e-12
        tubes.append(
            {
                "outer_diameter_mm": outer,
                "inner_diameter_mm": inner,
                "bending_stiffness_Nm2": young * area_moment_m4,
                "poisson_ratio": 0.3,
                "section": sections,
            }
        )
    contacts = [{"friction_coefficient": 0.0}, {"friction_coefficient": 0.0}]
    return {"name": "handheld robot of NavidFeizi", "tube": tubes, "contact": contacts}


def mapping(runs: Sequence[str]) -> dict[str, object]:
    """The content of a mapping file for some runs."""
    return {
        "header": False,
        "tubes": "innermost first",
        "rotations": "wrapped",
        "columns": {"l": [1, 2, 3], "theta": [4, 5, 6], "position": [1, 2, 3]},
        "run": [
            {"joints": f"Joint_Values_{run}.dat", "poses": f"EM_Trajectory_{run}.dat", "tracker": run, "homing": run}
            for run in runs
        ],
    }


def convert(folder: Path, output: Path) -> list[str]:
    """Writes robot.toml and the mapping files, and copies the data; the names of the runs."""
    output.mkdir(parents=True, exist_ok=True)
    runs = sorted(path.stem.removeprefix("Joint_Values_") for path in folder.glob("Joint_Values_*.dat"))
    for run in runs:
        for kind in ("Joint_Values", "EM_Trajectory"):
            shutil.copyfile(folder / f"{kind}_{run}.dat", output / f"{kind}_{run}.dat")
        (output / f"{run}.toml").write_text(tomli_w.dumps(mapping([run])))
    (output / "robot.toml").write_text(tomli_w.dumps(robot()))
    (output / "training.toml").write_text(tomli_w.dumps(mapping(TRAINING)))
    (output / "confirmation.toml").write_text(tomli_w.dumps(mapping([run for run in runs if run not in TRAINING])))
    return runs


def calibrated(output: Path, runs: Sequence[str], every: int) -> None:
    """Prints the rms error by run, nominal and calibrated, on every so manieth pose."""
    import numpy as np

    import ctrplan
    from ctrplan.calibration.estimates import distances
    from ctrplan.pipeline.parametric_chain import ParametricChain

    believed = ctrplan.load_robot(output / "robot.toml")
    data = ctrplan.load_measurements(output / "training.toml", believed)
    thinned = data.subset(np.arange(0, data.count, every))
    found = ctrplan.calibrate(believed, thinned, ["calibration", "effects.base_misalignment"], held_out=0)
    for warning in found.notes:
        print(warning)
    for name, estimate in found.estimates.items():
        print(f"  {name:45} {estimate.value:9.4g}  {estimate.ci95[0]:9.4g} to {estimate.ci95[1]:9.4g}")
    print("run          rows   nominal   calibrated [mm rms]")
    for run in runs:
        one = ctrplan.load_measurements(output / f"{run}.toml", believed)
        chain = ParametricChain(believed, one.subset(np.arange(0, one.count, every)), found.fit.chain.terms)
        before, after = (
            np.sqrt(np.mean(distances(chain.predict(p, derivatives=False), chain.data) ** 2)) * 1e3
            for p in (chain.neutral, found.fit.p)
        )
        print(f"{run:10} {one.count:6} {before:9.2f} {after:9.2f}  {'fitted' if run in TRAINING else ''}")


def unread(output: Path, every: int) -> None:
    """Prints the rms error of the runs that nothing read, in frames and zeros found anew, and how late the tip is."""
    from dataclasses import replace

    import numpy as np

    import ctrplan
    from ctrplan.calibration.residuals import Noise
    from ctrplan.diagnosis.confirmation import _New

    believed = ctrplan.load_robot(output / "robot.toml", ["measurement.position_sigma_mm=1"])
    runs, seen = (ctrplan.load_measurements(output / f"{name}.toml", believed) for name in ("confirmation", "training"))
    for line in _late(runs):
        print(line)
    seen, runs = (data.subset(np.arange(0, data.count, every)) for data in (seen, runs))
    of = runs.frames[runs.rows]
    block = np.concatenate([16 * k + np.arange((of == k).sum()) * 16 // (of == k).sum() for k in np.unique(of)])
    print("mm rms, of every run; then of all: rms, mean, rms without the worst 2 %")
    for name, homings in (("frames", None), ("frames and zeros", runs.homings + 1)):
        effects = ["base_misalignment", "frame_shift", *(["homing_shift"] if homings is not None else [])]
        given = seen if homings is not None else replace(seen, homing=None)
        fit = ctrplan.calibrate(believed, given, ["calibration", *(f"effects.{e}" for e in effects)], held_out=0).fit
        anew = _New(replace(runs, homing=homings), Noise(1e-3, 1.0), block)
        off = anew.predicted(fit).distance_m * 1e3
        least = np.sort(off)[: int(0.98 * len(off))]
        cells = [np.sqrt(np.mean(off[of == k] ** 2)) for k in np.unique(of)]
        cells += [np.sqrt(np.mean(off**2)), off.mean(), np.sqrt(np.mean(least**2))]
        print(f"{name:18} " + " ".join(f"{cell:6.2f}" for cell in cells), flush=True)


def _late(data: Measurements) -> Iterator[str]:
    """By run, how far the tip goes on after joints that stand still from a step of at least 2 deg on, in rows."""
    import numpy as np

    step = np.degrees(np.abs(np.diff(data.theta_commanded, axis=0)).max(axis=1))
    slid = np.abs(np.diff(data.l_commanded, axis=0)).max(axis=1) / 0.25e-3
    moved, run = np.maximum(step, slid), data.sequence
    for k in np.unique(run):
        rows = [
            i
            for i in np.flatnonzero((moved > 2) & (run[1:] == k))
            if i + 16 < len(run) and run[i + 16] == k and moved[i + 1 : i + 15].max() < 0.1
        ]
        left = np.array(
            [np.linalg.norm(data.position_m[i + 1 : i + 9] - data.position_m[i + 15], axis=1) for i in rows]
        )
        shown = " ".join(f"{1e3 * value:.2f}" for value in np.median(left, axis=0))
        yield f"run {k + 1}: {len(rows)} steps, after which the tip has yet to go (median, mm, row by row) {shown}"


def floor(output: Path, runs: Sequence[str], every: int) -> None:
    """Prints what remains by run in a frame of its own, and that less what the other runs say of the same joints."""
    import numpy as np

    import ctrplan

    believed = ctrplan.load_robot(output / "robot.toml")
    (output / "all.toml").write_text(tomli_w.dumps(mapping(runs)))
    data = ctrplan.load_measurements(output / "all.toml", believed)
    thinned = data.subset(np.arange(0, data.count, every))
    names = ["calibration", "effects.base_misalignment", "effects.frame_shift"]
    fit = ctrplan.calibrate(believed, thinned, names, held_out=0).fit
    seen, tip_m = fit.chain.data, fit.chain.predict(fit.p, derivatives=False).position_m
    left, run_of = (seen.position_m - tip_m) * 1e3, seen.frames[seen.rows] - 1
    theta, translations = seen.theta_commanded[seen.rows], seen.l_commanded[seen.rows]
    inner = slice(1, None)  # the outermost tube never moves
    moved = (translations - translations.mean(axis=0))[:, inner] / 20e-3
    joints = np.hstack([np.cos(theta[:, inner]), np.sin(theta[:, inner]), moved])
    frame = np.stack([np.hstack([np.eye(3), np.cross(np.eye(3), tip / 0.1)]) for tip in tip_m])  # (K, 3, 6)
    print("run          alone   with the joints of the other runs [mm rms], by width of the kernels")
    errors = {width: [_beyond(left, frame, joints, run_of, run, width) for run in range(len(runs))] for width in WIDTHS}
    for k, run in enumerate(runs):
        cells = " ".join(f"{_rms(errors[width][k]):9.2f}" for width in WIDTHS)
        print(f"{run:10} {_rms(_in_half_frames(left[run_of == k], frame[run_of == k])):7.2f} {cells}")
    alone = np.vstack([_in_half_frames(left[run_of == k], frame[run_of == k]) for k in range(len(runs))])
    print(f"{'all':10} {_rms(alone):7.2f} " + " ".join(f"{_rms(np.vstack(errors[width])):9.2f}" for width in WIDTHS))


def _rms(off: Array) -> float:
    return float((off**2).sum(axis=1).mean() ** 0.5)


def _beyond(left: Array, frame: Array, joints: Array, run_of: Array, run: int, width: float) -> Array:
    """What remains (K, 3) of a run beside a smooth function of the joints that the other runs show."""
    import numpy as np

    others = run_of != run
    near = np.exp(-0.5 * ((joints[:, None] - joints[None, others]) ** 2).sum(axis=2) / width**2)
    ridge, target = near[others] + 0.5 * np.eye(int(others.sum())), left.copy()
    for _ in range(3):  # frames and function in turn
        smooth = near @ np.linalg.solve(ridge, target[others])
        for other in np.unique(run_of[others]):
            of = run_of == other
            columns = frame[of].reshape(-1, 6)
            found = np.linalg.lstsq(columns, (left - smooth)[of].ravel(), rcond=None)[0]
            target[of] = left[of] - (columns @ found).reshape(-1, 3)
    smooth = near @ np.linalg.solve(ridge, target[others])
    return _in_half_frames((left - smooth)[~others], frame[~others])


def _in_half_frames(left: Array, frame: Array) -> Array:
    """(K, 3) in a frame that the other half of 16 blocks has found."""
    import numpy as np

    half = np.arange(len(left)) // max(1, len(left) // 16) % 2
    out = np.empty_like(left)
    for h in (0, 1):
        found = np.linalg.lstsq(frame[half != h].reshape(-1, 6), left[half != h].ravel(), rcond=None)[0]
        out[half == h] = left[half == h] - frame[half == h] @ found
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--unread", action="store_true")
    parser.add_argument("--floor", action="store_true")
    parser.add_argument("--every", type=int, default=40)
    arguments = parser.parse_args()
    found_runs = convert(arguments.folder, arguments.output)
    if arguments.calibrate:
        calibrated(arguments.output, found_runs, arguments.every)
    if arguments.unread:
        unread(arguments.output, arguments.every)
    if arguments.floor:
        floor(arguments.output, found_runs, arguments.every)
