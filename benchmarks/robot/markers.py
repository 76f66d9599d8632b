"""What markers along the body tell beside the tip: widths of intervals, and the time that they take.

    python benchmarks/run.py markers [--configurations N]

The three-tube robot of Table II, positions alone, noise 0.3 mm; rings in the middle of the curved part of tube 3 and at
the ends of tubes 1 and 2. Intervals are those of a linearised fit of all numbers in the table together, as shares of
their priors.
"""

import time
from dataclasses import replace

import common
import numpy as np
from common import ROBOTS, table
from measured_data import chain_of, waypoints

import ctrplan
from ctrplan import Measurements
from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise, information_inverse, residuals
from ctrplan.pipeline.parametric_chain import ParametricChain

SIGMA_M = 0.3e-3
MARKERS = (
    "marker=[{name='ring3',tube=3,from_tip_mm=43},{name='ring2',tube=2,from_tip_mm=2},"
    "{name='ring1',tube=1,from_tip_mm=75}]"
)
TERMS: dict[str, list[str] | None] = {"friction": None, "varying_precurvature": None, "homing_offset": None}


def of_points(data: Measurements, count: int) -> Measurements:
    """The tip's poses, and those of the first `count` markers, positions alone."""
    points = range(count + 1)
    return replace(
        data,
        rows=np.tile(data.rows, len(points)),
        position_m=np.zeros((len(points) * data.count, 3)),
        tangent=np.full((len(points) * data.count, 3), np.nan),
        marker=np.repeat(points, data.count),
    )


def left_shares(chain: ParametricChain) -> tuple[Array, float]:
    """(P,) width of each interval over its prior's, and the time [s] of a prediction with derivatives."""
    began = time.thread_time()
    prediction = chain.predict(chain.start)
    took = time.thread_time() - began
    found = residuals(chain.data, prediction, Noise(SIGMA_M, 1.0), chain.data.configuration)
    root = information_inverse(found.J, found.weight, 1 / chain.prior**2)
    return np.linalg.norm(root, axis=1) / chain.prior, took


def drawn_back(plan: Measurements) -> Array:
    """(R, 2) translations of tubes 2, which is locked to tube 1, and 3, a new one for each configuration."""
    rng = np.random.default_rng(5)
    numbers = np.unique(plan.l_commanded, axis=0, return_inverse=True)[1].ravel()
    inner = rng.uniform(-0.110, -0.036, numbers.max() + 1)[numbers]
    return np.column_stack([np.full(len(inner), -0.017), inner])


def main() -> None:
    configurations = common.arguments(__doc__, configurations=12).configurations
    robot = ctrplan.load_robot(ROBOTS / "three_tube.toml", [MARKERS])
    plan = waypoints(robot, configurations)
    plan = replace(plan, l_commanded=np.column_stack([plan.l_commanded[:, :1] * 0, drawn_back(plan)]))
    columns, times = [], []
    for count in (0, 1, 3):
        chain = chain_of(robot, of_points(plan, count), TERMS)
        shares, took = left_shares(chain)
        columns.append([f"{100 * share:.0f}" for share in shares])
        times.append(f"{1e3 * took / plan.count:.1f} ms a pose")
    names = [*(parameter.name for parameter in chain.parameters), "prediction with derivatives"]
    rows = zip(names, *(([*column, took]) for column, took in zip(columns, times, strict=True)), strict=True)
    title = f"{configurations} configurations, {plan.count} poses; 95 % intervals in % of their priors'"
    table(title, ("", "tip alone", "and a ring on tube 3", "and on tubes 2 and 1"), rows)
