"""What to measure next: the poses, within the measured workspace, with the largest expected change of the posterior.

Two hypotheses are told apart by a pose as far as their predictions differ, over the uncertainty that noise, unnamed
errors and the parameters of both leave there. Weighed with the probabilities of both, that is the information to
expect.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import Noise, differences
from ctrplan.diagnosis.conclusion import Judgement
from ctrplan.diagnosis.hypotheses import Hypothesis, Slip
from ctrplan.diagnosis.posterior_search import Answer
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.storage.output_folder import write_atomically

CONFIGURATIONS, SEED = 64, 4
OFFSET_RAD = np.radians(90.0)  # that loads friction fully
PROPOSALS = 3  # configurations, an hour's work
SEPARATING_LOG_ODDS = 1.0  # expected log-odds of a pose below which it separates nothing
CERTAIN_LOG_ODDS = 100.0
MOST_COMPARED = 4  # hypotheses


@dataclass(frozen=True, eq=False)
class Proposal:
    """A configuration with the approaches to measure it from, and the log-odds to expect of them together."""

    theta_commanded: Array  # (n,) rad
    l_commanded: Array  # (n,) m
    log_odds: float
    between: tuple[str, str]
    ways: Array  # (A, n) rad, where each approach begins

    @property
    def odds(self) -> str:
        """The log-odds for a reader: beyond some size no noise matters, but what neither effect explains does."""
        return f"{self.log_odds:.1f}" if self.log_odds < CERTAIN_LOG_ODDS else f"above {CERTAIN_LOG_ODDS:g}"


def next_experiment(
    answer: Answer, judgement: Judgement, noise: Noise, not_testable: Sequence[str]
) -> tuple[str, tuple[Proposal, ...]]:
    """A sentence or two a person can act on, and the proposals behind it."""
    sentences: list[str] = []
    rivals = [h for h, w in zip(answer.hypotheses, answer.posterior, strict=True) if w > 1e-3][:MOST_COMPARED]
    undecided = judgement.verdict == "ambiguous" or bool(judgement.possible) or judgement.none < 1 - judgement.none
    proposed = _proposals(answer, rivals, judgement, noise) if undecided and len(rivals) > 1 else ()
    if judgement.verdict == "ambiguous" and len(rivals) > 1:
        sentences.append(_separating(rivals, proposed))
    listed = [f.term for f in judgement.findings]
    sentences += [f"{t.name} shows itself so: {t.effect.experiment}." for t in listed[:2]]
    if judgement.verdict in ("partial", "unexplained"):
        sentences.append(
            "Something outside the catalogue acts: repeat the configurations with the largest errors, each several "
            "times and with everything that can be changed changed (load, speed, mounting, temperature), and see "
            "with what the error goes."
        )
    if judgement.verdict == "wrong_tube":
        sentences.append("Measure the tube outside the robot, or correct its section in the robot file.")
    if judgement.verdict == "no_missing_effect":
        sentences.append("Nothing is missing as far as these data show.")
    if listed and judgement.verdict != "ambiguous":
        sentences.append("Then measure another run, which nothing has read, and ask it with --confirm.")
    if not_testable:
        sentences.append(f"These data can't test {', '.join(not_testable)}.")
    return " ".join(sentences), proposed


def _in_words(h: Hypothesis) -> str:
    return " with ".join(sorted(h.names)) or "nothing"


def _separating(rivals: Sequence[Hypothesis], results: Sequence[Proposal]) -> str:
    one, other = _in_words(rivals[0]), _in_words(rivals[1])
    if not results or results[0].log_odds < SEPARATING_LOG_ODDS:
        return f"No pose of the measured kind separates {one} from {other}: they predict the same within its range."
    best = results[0]
    angles = ", ".join(f"{angle:.0f}" for angle in np.degrees(best.theta_commanded))
    places = ", ".join(f"{place:.1f}" for place in best.l_commanded * 1e3)
    return (
        f"To tell {one} from {other}, measure theta = ({angles}) deg, l = ({places}) mm from all directions of "
        f"approach (--propose writes {len(results)} such configurations): expected log-odds {best.odds}."
    )


def _proposals(
    answer: Answer, rivals: Sequence[Hypothesis], judgement: Judgement, noise: Noise
) -> tuple[Proposal, ...]:
    """The best of random configurations within the measured range, each approached from all directions."""
    data = answer.bench.data
    pool = _pool(data)
    size = float(np.hypot(1.0, judgement.unnamed.over_noise))
    seen = [_predicted(h, pool, noise.scaled(size), data.has_tangents) for h in rivals]
    weights = np.array([answer.posterior[answer.hypotheses.index(h)] for h in rivals])
    gain, count = np.zeros(pool.count), len(np.unique(pool.configuration))
    apart: dict[tuple[int, int], Array] = {}
    for i, j in itertools.combinations(range(len(rivals)), 2):
        apart[i, j] = _log_odds(seen[i], seen[j])
        gain += weights[i] * weights[j] * apart[i, j]
    of_configuration = np.bincount(pool.configuration, weights=gain, minlength=count)
    first_pair = np.bincount(pool.configuration, weights=apart[0, 1], minlength=count)
    results = []
    for k in np.argsort(-of_configuration)[:PROPOSALS].tolist():
        mine = np.flatnonzero(pool.configuration == k)
        row = int(pool.rows[mine[0]])
        between = _in_words(rivals[0]), _in_words(rivals[1])
        ways = pool.theta_commanded[pool.rows[mine] - 1]
        results.append(Proposal(pool.theta_commanded[row], pool.l_commanded[row], float(first_pair[k]), between, ways))
    return tuple(results)


@dataclass(frozen=True, eq=False)
class _Predicted:
    """Numbers (K, 5) over the noise beside a reference, and their covariance (K, 5, 5) by the parameters."""

    numbers: Array
    covariance: Array


def _predicted(h: Hypothesis, pool: Measurements, noise: Noise, has_tangents: bool) -> _Predicted:
    kept = [(t, s) for t, s in zip(h.chain.terms, h.chain.slices(), strict=True) if not isinstance(t.effect, Slip)]
    chain = ParametricChain(h.chain.robot, pool, [t for t, _ in kept])
    index = np.concatenate([np.arange(s.start, s.stop) for _, s in kept])
    p, covariance = h.p[index], h.covariance[np.ix_(index, index)]
    prediction = chain.predict(p)
    reference = np.tile(np.array([0.0, 0.0, 1.0]), (pool.count, 1))
    tangent = reference if has_tangents else np.full((pool.count, 3), np.nan)
    r, J = differences(replace(pool, tangent=tangent), prediction, noise)
    r, J = np.where(prediction.sound[:, None], r, 0.0), np.where(prediction.sound[:, None, None], J, 0.0)
    return _Predicted(np.nan_to_num(r), np.einsum("kap,pq,kbq->kab", np.nan_to_num(J), covariance, np.nan_to_num(J)))


def _log_odds(one: _Predicted, other: _Predicted) -> Array:
    """(K,) expected of each pose."""
    apart = one.numbers - other.numbers
    within = np.eye(5) + (one.covariance + other.covariance) / 2
    result: Array = 0.5 * np.einsum("ka,ka->k", apart, np.linalg.solve(within, apart[:, :, None])[:, :, 0])
    return result


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


def write_proposals(path: str | os.PathLike[str], proposals: Sequence[Proposal], n: int) -> None:
    """commanded.csv: for every approach a run of two waypoints, and at the second one a pose to be measured."""
    joints = [*(f"theta_{i}_rad" for i in range(1, n + 1)), *(f"l_{i}_m" for i in range(1, n + 1))]
    lines, run = [",".join(["sequence", *joints, "x_m", "y_m", "z_m"])], 0
    for proposal in proposals:
        for start in proposal.ways:
            for theta in (start, proposal.theta_commanded):
                numbers = (f"{x:.9g}" for x in (*theta, *proposal.l_commanded))
                lines.append(",".join([str(run), *numbers, "", "", ""]))
            run += 1
    write_atomically(path, "\n".join(lines) + "\n")
