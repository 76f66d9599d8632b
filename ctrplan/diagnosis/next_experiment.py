"""What to measure next: the configurations and approaches that best separate two explanations."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise, residuals
from ctrplan.diagnosis.verdict import Alternative, Judgement
from ctrplan.diagnosis.workbench import Scored
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain

CONFIGURATIONS, SEED = 24, 4
OFFSET_RAD = np.radians(90.0)
PROPOSALS = 3
SEPARATING_LOG_ODDS = 1.0  # expected log-odds of a pose below which it separates nothing
CERTAIN_LOG_ODDS = 100.0


@dataclass(frozen=True, eq=False)
class Proposal:
    """A configuration with the approaches to measure it from, and the log-odds to expect of them together."""

    theta_commanded: Array  # (n,) rad
    l_commanded: Array  # (n,) m
    log_odds: float
    between: tuple[str, str]

    @property
    def odds(self) -> str:
        """The log-odds for a reader: beyond some size no noise matters, but what neither effect explains does."""
        return f"{self.log_odds:.1f}" if self.log_odds < CERTAIN_LOG_ODDS else f"above {CERTAIN_LOG_ODDS:g}"


def proposals(name: str, chosen: Scored, other: Alternative, data: Measurements, noise: Noise) -> list[Proposal]:
    """The best of random configurations within the measured range, each approached from all directions.

    name: of the effect that the alternative may stand for. A frame is in both fits.
    """
    pool = _pool(data)
    chains = [ParametricChain(f.chain.robot, pool, f.chain.terms) for f in (chosen.fit, other.scored.fit)]
    predictions = [
        chain.predict(f.p, derivatives=False) for chain, f in zip(chains, (chosen.fit, other.scored.fit), strict=True)
    ]
    tangent = predictions[0].tangent if data.has_tangents else np.full_like(predictions[0].tangent, np.nan)
    seen = replace(pool, position_m=predictions[0].position_m, tangent=tangent)
    apart = residuals(seen, predictions[1], noise, np.arange(seen.count)).norm ** 2 / 2
    sound = predictions[0].sound & predictions[1].sound
    odds = np.bincount(pool.configuration, weights=np.where(sound, apart, 0.0))
    first = [int(np.flatnonzero(pool.configuration == k)[0]) for k in range(len(odds))]
    best = np.argsort(-odds)[:PROPOSALS]
    names = name, other.term.name
    rows = [int(pool.rows[first[k]]) for k in best]
    return [
        Proposal(pool.theta_commanded[row], pool.l_commanded[row], float(odds[k]), names)
        for row, k in zip(rows, best, strict=True)
    ]


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
            "Something outside the catalogue acts: repeat the configurations with the largest errors, each several "
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
    if not results or results[0].log_odds < SEPARATING_LOG_ODDS:
        return (
            f"No pose of the measured kind separates {name} from {other.term.name}: they predict the same everywhere "
            f"within its range."
        )
    best = results[0]
    angles = ", ".join(f"{angle:.0f}" for angle in np.degrees(best.theta_commanded))
    places = ", ".join(f"{place:.1f}" for place in best.l_commanded * 1e3)
    return (
        f"To tell {name} from {other.term.name}, measure theta = ({angles}) deg, l = ({places}) mm from all directions "
        f"of approach: expected log-odds {best.odds}."
    )


def _pool(data: Measurements) -> Measurements:
    """Random configurations in the measured range, each reached from every side by 90 degrees and by nothing."""
    rng = np.random.default_rng(SEED)
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
    pick = rng.integers(0, len(theta), (CONFIGURATIONS, 2))
    share = rng.random((CONFIGURATIONS, 1))
    thetas = theta.min(axis=0) + rng.random((CONFIGURATIONS, data.n)) * np.ptp(theta, axis=0)
    ls = l[pick[:, 0]] * share + l[pick[:, 1]] * (1 - share)  # between two that nest, which nests
    waypoints, sequence = [], []
    for number, (goal, place) in enumerate(zip(thetas, ls, strict=True)):
        for side, signs in enumerate([*itertools.product((1, -1), repeat=data.n - 1), (0,) * (data.n - 1)]):
            turns = np.concatenate([[0.0], np.cumsum(signs)]) * OFFSET_RAD
            waypoints += [np.concatenate([goal - turns, place]), np.concatenate([goal, place])]
            sequence += [number * 2**data.n + side] * 2
    table, rows = np.array(waypoints), np.arange(1, len(waypoints), 2)
    nothing = np.zeros((len(rows), 3))
    time_s = None if data.time_s is None else np.arange(len(table), dtype=float)
    of = np.repeat(rng.integers(0, len(theta), len(rows)), 2)  # other columns are as at some pose
    more = {name: values[data.rows][of] for name, values in data.more.items()}
    joints = table[:, : data.n], table[:, data.n :]
    return Measurements(np.array(sequence), *joints, rows, nothing, nothing, time_s, more=more)
