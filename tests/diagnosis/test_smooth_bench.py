"""Beside an error that is smooth in the joints: what is left is white, and a load is taken out by a fit without it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from measured_data import SIGMA_M, SIGMA_RAD, measured, pair_robot, waypoints

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis.block_evidence import Sides, evidence
from ctrplan.diagnosis.correlated_bench import CorrelatedBench, SmoothBench
from ctrplan.diagnosis.partial_search import PartialSelector
from ctrplan.diagnosis.partial_search import _sides as sides
from ctrplan.diagnosis.usable_poses import block_split, blocks
from ctrplan.diagnosis.workbench import Candidates, candidates
from ctrplan.measurement.measurements import Measurements

ROBOT = pair_robot()
PLAN = waypoints(ROBOT, 24, seed=4)


def smooth_error() -> Measurements:
    """1.5 mm rms, a function of the relative rotation and of nothing else."""
    data = measured(ROBOT, PLAN, {}, seed=2)
    turn = np.diff(PLAN.theta_commanded[PLAN.rows], axis=1)
    field = np.hstack([np.sin(2 * turn), np.cos(2 * turn), np.sin(2 * turn + 1)])
    return replace(data, position_m=data.position_m + 1.5e-3 * field / np.sqrt(1.5))


def bench_of(data: Measurements) -> CorrelatedBench:
    block = blocks(data, 0.0)
    parts = block_split(data, np.ones(data.count, bool), block)
    chosen = parts.selection
    return CorrelatedBench(ROBOT, data.subset(chosen), Noise(SIGMA_M, SIGMA_RAD), block[chosen], parts.fold)


@cache
def beside_smooth() -> tuple[CorrelatedBench, SmoothBench]:
    bench = bench_of(smooth_error())
    return bench, SmoothBench(bench, bench.begun())


def test_what_is_left_beside_a_smooth_error_is_white() -> None:
    bench, smooth = beside_smooth()
    position = smooth.at(bench.begun()).fit.residuals.r[:, :3]
    assert 0.5 < np.mean(position**2) < 1.5
    assert smooth.noise.discrepancy is not None and smooth.noise.discrepancy.is_there


def test_an_error_that_near_configurations_share_is_worth_less_than_one_of_their_own() -> None:
    bench, smooth = beside_smooth()
    data = bench.data
    number = np.unique(data.configuration, return_inverse=True)[1].ravel()
    turn = np.diff(data.theta_commanded[data.rows], axis=1)[:, 0]
    first = np.unique(number, return_index=True)[1]
    value = np.cos(2 * turn[first])
    mixed = np.random.default_rng(1).permutation(value)
    ratio = [worth(one, value[number]) / worth(one, mixed[number]) for one in (bench, smooth)]
    assert abs(ratio[0] - 1) < 1e-6 and ratio[1] < 0.5


def worth(bench: CorrelatedBench, error: Array) -> float:
    """Squares of an error (K,) of one coordinate, over the noise, beside what the bench has in its covariance."""
    found = bench.estimated(bench.begun()) if bench.noise.discrepancy is None else bench.noise.discrepancy
    every = np.zeros((len(error), 5))
    every[:, 0] = error
    return float((found.whitened(every) ** 2).sum())


def loaded() -> tuple[CorrelatedBench, Candidates]:
    data = measured(ROBOT, PLAN, {"tip_load": {"force_x_N": 0.15, "force_y_N": -0.1}}, seed=6)
    known = candidates(ROBOT, data)
    return bench_of(data), Candidates(tuple(t for t in known.terms if t.name == "tip_load"), {})


def test_a_load_is_worth_what_a_fit_without_it_loses() -> None:
    """To first order around a loaded robot, the stiffness of all tubes stands for the load."""
    bench, known = loaded()
    selector = PartialSelector(bench, known, lambda _: None)
    load = known.terms[0]
    chosen = bench.scored([load])
    among = [*bench.basis(chosen.terms), *chosen.terms]
    panel = bench.panel(chosen, [])
    refitted = evidence(bench, sides(selector, chosen, panel, among, load), load, 1.0)
    rest = [t for t in among if t.name != load.name]
    first_order = evidence(bench, Sides(panel, among, panel.without(load), rest), load, 1.0)
    gain, _ = bench.difference(chosen, bench.scored([], chosen.fit))
    assert abs(refitted.gain - gain) < 0.1 * gain
    assert first_order.gain < 0.5 * gain
