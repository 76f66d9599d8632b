"""Bounds of many configurations on the workers of an executor, on this machine or on a cluster."""

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

import ctrplan

SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"


def main() -> None:
    robot = ctrplan.load_robot(SCENARIOS / "robots" / "three_tube.toml")
    theta_b = np.zeros((180, 3))
    theta_b[:, 2] = np.radians(np.linspace(0, 180, len(theta_b)))  # the innermost tube turns
    l_b = np.tile([0, -0.017, -0.0628], (len(theta_b), 1))

    # Drop-ins: dask.distributed.Client(...).get_executor(), mpi4py.futures.MPIPoolExecutor()
    with ProcessPoolExecutor(max_workers=2) as executor:
        bounds = robot.bound_many(theta_b, l_b, executor=executor, progress=lambda share: print(f"{share:.0%}"))

    worst = np.argmax(bounds.position_m)
    print(f"largest bound: {bounds.position_m[worst] * 1e3:.2f} mm at {np.degrees(theta_b[worst, 2]):.0f} deg")


if __name__ == "__main__":  # worker processes import this file
    main()
