"""What to measure next: the configurations and approaches that best separate two explanations, and what they decided.

Poses that were measured to decide are no part of any fit: each explanation predicts them, with the uncertainty that its
own fit left, and the probability of what was seen is its evidence.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise, Residuals, residuals
from ctrplan.diagnosis.adequacy import REJECTED
from ctrplan.diagnosis.linear_fit import predicted
from ctrplan.diagnosis.verdict import NAMED, Alternative, Finding, Judgement, Posterior
from ctrplan.diagnosis.workbench import Scored
from ctrplan.measurement.measurements import SEED, Measurements
from ctrplan.pipeline.followed_runs import simulated
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.robot.robot import Robot
from ctrplan.scenario.joint_space import JointSpace

CONFIGURATIONS = 32  # drawn in the measured range, and as many in the drive's travel
OFFSET_RAD = np.radians(90.0)
PROPOSALS = 3
SEPARATING_LOG_ODDS = 1.0  # expected log-odds of a pose below which it separates nothing


@dataclass(frozen=True, eq=False)
class Proposal:
    """A configuration to be measured from all sides, and by how much that raises the log-odds to expect."""

    theta_commanded: Array  # (n,) rad
    l_commanded: Array  # (n,) m
    log_odds: float
    between: tuple[str, str]


def proposals(name: str, chosen: Scored, other: Alternative, data: Measurements, noise: Noise) -> list[Proposal]:
    """The best of random configurations within the measured range together, each approached from all directions.

    Each is the one that adds most to the log-odds that those before it let expect. name: of the effect that the
    alternative may stand for. A frame is in both fits.
    """
    pool = _pool(data, chosen.fit.chain.robot)
    fits = chosen.fit, other.scored.fit
    predictions = [ParametricChain(f.chain.robot, pool, f.chain.terms).predict(f.p) for f in fits]
    tangent = predictions[0].tangent if data.has_tangents else np.full_like(predictions[0].tangent, np.nan)
    seen = replace(pool, position_m=predictions[0].position_m, tangent=tangent)
    parts = [residuals(seen, prediction, noise, np.arange(seen.count)) for prediction in predictions]
    sound = predictions[0].sound & predictions[1].sound
    whole = [k for k in range(pool.configuration.max() + 1) if sound[pool.configuration == k].all()]
    taken, before = list[tuple[int, float]](), 0.0
    while len(taken) < min(PROPOSALS, len(whole)):
        chosen_ones = [k for k, _ in taken]
        odds = {
            k: _expected(parts, fits, np.isin(pool.configuration, [*chosen_ones, k]))
            for k in whole
            if k not in chosen_ones
        }
        best = max(odds, key=lambda k: odds[k])
        taken.append((best, odds[best] - before))
        before = odds[best]
    names = name, other.term.name
    rows = [int(pool.rows[np.flatnonzero(pool.configuration == k)[0]]) for k, _ in taken]
    return [
        Proposal(pool.theta_commanded[row], pool.l_commanded[row], gain, names)
        for row, (_, gain) in zip(rows, taken, strict=True)
    ]


def _expected(parts: Sequence[Residuals], fits: Sequence[Fit], poses: NDArray[np.bool_]) -> float:
    """Log-odds to expect of poses (K,), whichever of two fits is right: the smaller Kullback-Leibler divergence.

    What parameters are uncertain by is in both predictions: where a fit can still bend, it will.
    """
    given = (parts[1].given & poses[:, None]).ravel()
    apart = parts[1].r.ravel()[given]
    whole = [
        np.eye(len(apart)) + J @ fit.covariance @ J.T
        for part, fit in zip(parts, fits, strict=True)
        for J in [part.J.reshape(len(given), -1)[given]]
    ]
    logs = [float(np.linalg.slogdet(S)[1]) for S in whole]
    odds = []
    for own, rival in ((0, 1), (1, 0)):
        likened = np.linalg.solve(whole[rival], np.column_stack([whole[own], apart]))
        spread = np.trace(likened[:, :-1]) - len(apart) + logs[rival] - logs[own]
        odds.append(float(spread + apart @ likened[:, -1]) / 2)
    return min(odds)


def proposed_waypoints(proposed: Sequence[Proposal]) -> tuple[NDArray[np.int_], Array, Array]:
    """Runs (R,), rotations (R, n) [rad] and translations (R, n) [m]: every proposal from all directions of approach."""
    sequence, theta, places = list[int](), list[Array](), list[Array]()
    distinct = {(p.theta_commanded.tobytes(), p.l_commanded.tobytes()): p for p in proposed}
    for number, proposal in enumerate(distinct.values()):
        n = len(proposal.theta_commanded)
        for side, turns in enumerate(_approaches(n)):
            sequence += [number * 2**n + side] * 2
            theta += [proposal.theta_commanded - turns, proposal.theta_commanded]
            places += [proposal.l_commanded] * 2
    return np.array(sequence), np.array(theta), np.array(places)


def _approaches(n: int) -> list[Array]:
    """(n,) turns of the collars before a configuration: every side by 90 degrees, and none."""
    signs = [*itertools.product((1, -1), repeat=n - 1), (0,) * (n - 1)]
    return [np.concatenate([[0.0], np.cumsum(sign)]) * OFFSET_RAD for sign in signs]


@dataclass(frozen=True)
class Decision:
    """What poses that were measured to decide say of explanations, with what was known before."""

    explanations: tuple[str, ...]  # effects, likeliest first
    probability: tuple[float, ...]  # of each, if one of them acts
    poses: int
    explains: bool  # whether the likeliest explains the new poses, to noise and the uncertainty of its fit

    @property
    def is_decided(self) -> bool:
        """Whether one of them is left."""
        return self.probability[0] >= NAMED and self.explains

    @property
    def sentence(self) -> str:
        """The answer, with its probability."""
        first, rest = self.explanations[0], ", ".join(self.explanations[1:])
        by = f"{self.poses} new poses"
        if not self.explains:
            return f"{by} fit neither {' nor '.join(self.explanations)}: something else acts, or acts besides."
        if not self.is_decided:
            chance = f"{self.probability[0]:.2f}"
            return f"{by} do not decide: {first} has a probability of {chance} beside {rest}."
        chance = f"{self.probability[0]:.3f}" if self.probability[0] < 0.9995 else "above 0.999"
        return f"Decided by {by}: {first}, with a probability of {chance}, and not {rest}."

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        shares = {name: round(p, 4) for name, p in zip(self.explanations, self.probability, strict=True)}
        return {"probability": shares, "poses": self.poses, "explains": self.explains, "decided": self.is_decided}


def decision(
    chosen: Scored, finding: Finding, data: Measurements, noise: Noise, before: Posterior | None = None
) -> Decision:
    """Compares a finding with its alternatives by poses that no fit has seen; before: what is known, or nothing."""
    fits = {finding.term.name: chosen.fit} | {a.term.name: a.scored.fit for a in finding.alternatives}
    evidence = {name: _predictive(fit, data, noise) for name, fit in fits.items()}
    known = {name: before.of_one(name, fits) if before else 1.0 for name in fits}
    total = {name: evidence[name][0] + float(np.log(max(known[name], np.finfo(float).tiny))) for name in fits}
    order = sorted(fits, key=lambda name: -total[name])
    logs = np.array([total[name] for name in order])
    probability = np.exp(logs - logs[0]) / np.exp(logs - logs[0]).sum()
    return Decision(tuple(order), tuple(probability.tolist()), data.count, evidence[order[0]][1] > REJECTED)


def _predictive(fit: Fit, data: Measurements, noise: Noise) -> tuple[float, float]:
    """Log-density of new poses as a fit predicts them, and the chance of such a misfit by noise and its parameters."""
    chain = simulated(fit.chain.robot, data, fit.chain.terms, fit.p)
    parts = residuals(data, chain.predict(fit.p), noise, data.configuration)
    square, density = predicted(parts.r[parts.given], parts.J[parts.given], fit.information)
    return density, float(chdtrc(parts.given.sum(), square))


def next_experiment(
    chosen: Scored, judgement: Judgement, data: Measurements, noise: Noise, not_testable: Sequence[str]
) -> tuple[str, tuple[Proposal, ...]]:
    """A sentence or two a person can act on, and the proposals behind it."""
    sentences: list[str] = []
    proposed: list[Proposal] = []
    for finding in judgement.findings:
        for other in finding.alternatives:
            result = proposals(finding.term.name, chosen, other, data, noise)
            proposed += result
            sentences.append(_separating(finding.term.name, other, result))
            sentences.append(f"{finding.term.name} shows itself so: {finding.term.effect.experiment}.")
    if judgement.verdict == "partial":
        sentences += [f"To confirm {f.term.name}: {f.term.effect.experiment}." for f in judgement.findings]
        sentences.append("Then measure another run, which nothing has read, and ask it with --confirm.")
    if judgement.verdict == "unexplained":
        sentences.append(
            "Something acts that has no name: repeat the configurations with the largest errors, each several "
            "times and with everything that can be changed changed (load, speed, mounting, temperature), and see "
            "with what the error goes."
        )
    if judgement.verdict == "no_missing_effect":
        sentences.append("Nothing is missing as far as these data show.")
    if judgement.verdict == "named":
        names = ", ".join(f.term.name for f in judgement.findings)
        experiment = judgement.findings[0].term.effect.experiment
        sentences.append(f"To confirm {names}: {experiment}.")
    if not_testable:
        sentences.append(f"These data can't test {', '.join(not_testable)}.")
    return " ".join(sentences), tuple(proposed)


def _separating(name: str, other: Alternative, results: Sequence[Proposal]) -> str:
    if sum(result.log_odds for result in results) < SEPARATING_LOG_ODDS:
        return f"No pose separates {name} from {other.term.name}: they predict the same within the drive's travel."
    best, whole = results[0], sum(result.log_odds for result in results)
    angles = ", ".join(f"{angle:.0f}" for angle in np.degrees(best.theta_commanded))
    places = ", ".join(f"{place:.1f}" for place in best.l_commanded * 1e3)
    return (
        f"To tell {name} from {other.term.name}, measure theta = ({angles}) deg, l = ({places}) mm from all directions "
        f"of approach: expected log-odds {best.log_odds:.1f}, "
        f"with {len(results)} such {whole:.1f} (--propose writes them)."
    )


def _pool(data: Measurements, robot: Robot) -> Measurements:
    """Random configurations, each reached from every side by 90 degrees and by nothing.

    Half of them are within the measured range, half within the drive's travel: there fits differ that agree here.
    """
    rng = np.random.default_rng(SEED)
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
    pick = rng.integers(0, len(theta), (CONFIGURATIONS, 2))
    share = rng.random((CONFIGURATIONS, 1))
    thetas = theta.min(axis=0) + rng.random((CONFIGURATIONS, data.n)) * np.ptp(theta, axis=0)
    ls = l[pick[:, 0]] * share + l[pick[:, 1]] * (1 - share)  # between two that nest, which nests
    if not data.of_collars:
        far_theta, far_l = robot.drive.commanded(JointSpace.of_robot(robot).sample(rng, CONFIGURATIONS))
        thetas, ls = np.vstack([thetas, far_theta]), np.vstack([ls, far_l])
    waypoints, sequence = [], []
    for number, (goal, place) in enumerate(zip(thetas, ls, strict=True)):
        for side, turns in enumerate(_approaches(data.n)):
            waypoints += [np.concatenate([goal - turns, place]), np.concatenate([goal, place])]
            sequence += [number * 2**data.n + side] * 2
    table, rows = np.array(waypoints), np.arange(1, len(waypoints), 2)
    nothing = np.zeros((len(rows), 3))
    time_s = None if data.time_s is None else np.arange(len(table), dtype=float)
    of = np.repeat(rng.integers(0, len(theta), len(rows)), 2)  # other columns are as at some pose
    more = {name: values[data.rows][of] for name, values in data.more.items()}
    joints = table[:, : data.n], table[:, data.n :]
    return Measurements(np.array(sequence), *joints, rows, nothing, nothing, time_s, more=more)
