"""What a call from Python takes beyond the core's own work: zero-clearance shapes, bounds, steps of a walker.

The core's own time is that of the same configurations in one call, on one thread, which gives numbers and no shapes.

python benchmarks/call_overhead.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import ctrplan

ROBOT = ctrplan.load_robot(Path(ctrplan.__file__).parent / "scenarios" / "robots" / "three_tube.toml")
CONFIGURATIONS = 200
ROUNDS = 7  # in alternation: the machine is not ours alone
STEP_RAD = np.radians(1.0)

random = np.random.default_rng(1)
THETA = random.uniform(-np.pi, np.pi, (CONFIGURATIONS, 3))
L = np.tile([0.0, -0.017, -0.0628], (CONFIGURATIONS, 1))
L[:, 2] -= random.uniform(0, 0.02, CONFIGURATIONS)
TURNED = np.array([0.0, 1.0, 2.0]) + np.outer(np.arange(CONFIGURATIONS), [0.0, 0.0, STEP_RAD])
STAYING = np.tile(L[0], (CONFIGURATIONS, 1))


def one_by_one(call: Callable[[np.ndarray, np.ndarray], object], theta: np.ndarray, l_b: np.ndarray) -> float:
    """Microseconds a call."""
    begun = time.perf_counter()
    for row in zip(theta, l_b, strict=True):
        call(*row)
    return 1e6 * (time.perf_counter() - begun) / len(theta)


def at_once(call: Callable[[], object]) -> float:
    """Microseconds a configuration."""
    begun = time.perf_counter()
    call()
    return 1e6 * (time.perf_counter() - begun) / CONFIGURATIONS


def walked() -> float:
    """Microseconds a step of a walker, its first one left out."""
    walker = ROBOT.walker()
    walker.bound(TURNED[0], STAYING[0])
    return one_by_one(walker.bound, TURNED[1:], STAYING[1:])


def everything(theta_b: np.ndarray, l_b: np.ndarray) -> None:
    """A bound all of whose arrays are looked at."""
    found = ROBOT.bound(theta_b, l_b)
    for shape in (found.frictionless, *found.corners):
        _ = shape.tubes, shape.radius_m, shape.contact_s_m, shape.contact_force_N, shape.contact_angle_rad


MEASURED: dict[str, tuple[Callable[[], float], Callable[[], float]]] = {
    "zero_clearance, its tip": (
        lambda: one_by_one(lambda q, l_b: ROBOT.zero_clearance(q, l_b).tip_m, THETA, L),
        lambda: at_once(lambda: ROBOT.mechanics.tips(THETA, L, threads=1)),
    ),
    "zero_clearance, all arrays": (
        lambda: one_by_one(lambda q, l_b: ROBOT.zero_clearance(q, l_b).tubes, THETA, L),
        lambda: at_once(lambda: ROBOT.mechanics.tips(THETA, L, threads=1)),
    ),
    "bound, cold, its tip": (
        lambda: one_by_one(lambda q, l_b: ROBOT.bound(q, l_b).frictionless.tip_m, THETA, L),
        lambda: at_once(lambda: ROBOT.bound_many(THETA, L, threads=1)),
    ),
    "bound, cold, all arrays": (
        lambda: one_by_one(everything, THETA, L),
        lambda: at_once(lambda: ROBOT.bound_many(THETA, L, threads=1)),
    ),
    "walker, steps of 1 degree": (
        walked,
        lambda: at_once(lambda: ROBOT.mechanics.check_path(TURNED, STAYING)),
    ),
}


def main() -> None:
    """Prints medians over rounds."""
    print("call                          from Python (us)  core (us)  overhead (us)")
    for name, (python, core) in MEASURED.items():
        python(), core()
        pairs = np.array([(python(), core()) for _ in range(ROUNDS)])
        outside, inside = np.median(pairs, axis=0)
        print(f"{name:30} {outside:15.0f} {inside:10.0f} {np.median(pairs[:, 0] - pairs[:, 1]):14.0f}")


if __name__ == "__main__":
    main()
