"""A term built of what nobody has named: the most probable error of a stage, in the form of few parts with units.

The mixed model says how the error of each process most probably goes, pose by pose. Parts of the dictionary of that
stage are fitted to it, one after the other, and then to the measurements themselves, as a hypothesis like any other:
the term is kept where the evidence with it, less the logarithm of the number of pieces for each choice, is not below
that without. It names no cause.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.conclusion import at_mode
from ctrplan.diagnosis.hypotheses import Bench, Hypothesis
from ctrplan.diagnosis.term_dictionary import TermPiece, pieces
from ctrplan.effects.effect import Stage
from ctrplan.effects.learned.inputs import InputRange, Situation, values
from ctrplan.effects.learned.learned import Learned, learned
from ctrplan.effects.learned.parts import inputs, part
from ctrplan.measurement.measurements import Measurements
from ctrplan.measurement.sensor import Poses, frames_along
from ctrplan.pipeline.term import Term

MOST_PIECES = 4  # of a term: more is no formula that a person reads
WORTH_A_PIECE = 0.05  # of the squares of the error, that a further piece has to close


@dataclass(frozen=True, eq=False)
class Built:
    """A hypothesis with built terms, and the error that they stand for."""

    hypothesis: Hypothesis  # with named and built terms
    stage: Stage
    gain: float  # log evidence over that without, less what choosing the pieces cost
    share: float  # of the squares of what nobody had named in that stage, closed by the pieces

    @property
    def terms(self) -> tuple[Term, ...]:
        """The built ones."""
        return tuple(t for t in self.hypothesis.terms if isinstance(t.effect, Learned))


STAGES: dict[str, Stage] = {"drive": "drive", "mechanics": "mechanics", "sensor": "sensor"}  # of processes' names


def build(bench: Bench, named: Hypothesis) -> Built | None:
    """The most probable term beside what is named; None where nothing can be built that is worth its parts."""
    y, scaled = at_mode(bench, named)
    errors: dict[Stage, Array] = {}
    for name, error in bench.model.explained(y, scaled, named.sizes).items():
        stage = STAGES.get(name.split(":")[0])
        if stage is not None:
            errors[stage] = errors.get(stage, np.zeros_like(error)) + error
    if not errors:
        return None
    every = _columns(bench, named, pieces(bench.robot, bench.data, named.terms))
    results = [
        built
        for stage, error in sorted(errors.items(), key=lambda pair: -float((pair[1] ** 2).sum()))[:2]
        if (built := _of_stage(bench, named, stage, error, every)) is not None
    ]
    best = max(results, key=lambda b: b.gain, default=None)
    return best if best is not None and best.gain > 0 else None


def _of_stage(
    bench: Bench, named: Hypothesis, stage: Stage, error: Array, every: Sequence[tuple[TermPiece, Array]]
) -> Built | None:
    """The term of a stage whose pieces close most of an error (K, 5)."""
    there = bench.model.given
    candidates = [(piece, columns[there]) for piece, columns in every if piece.on.kind.stage == stage]
    chosen: list[TermPiece] = []
    design, left = np.zeros((int(there.sum()), 0)), error[there]
    whole = float(left @ left)
    if whole < 1e-12 or not candidates:
        return None
    for _ in range(MOST_PIECES):
        tried = []
        for piece, columns in candidates:
            if piece not in chosen:
                both = np.column_stack([design, columns])
                tried.append((_rest(both, error[there]), piece, both))
        least = min((rest for rest, _, _ in tried), default=np.inf)
        if _rest(design, error[there]) - least < WORTH_A_PIECE * whole:
            break
        alike = [one for one in tried if one[0] < least + WORTH_A_PIECE * whole]
        _, piece, design = min(alike, key=lambda one: (one[2].shape[1], one[0]))  # a slope before a spline
        chosen.append(piece)
    if not chosen:
        return None
    terms = _terms(bench, chosen)
    result = bench.fitted([*named.terms, *terms], named.values, named.sizes)
    cost = len(chosen) * math.log(len(candidates))
    share = 1 - _rest(design, error[there]) / whole
    return Built(result, stage, result.evidence - named.evidence - cost, share)


def _rest(design: Array, target: Array) -> float:
    """Sum of squares that the best combination of columns leaves, each held to a usual amount by a small ridge."""
    if not design.shape[1]:
        return float(target @ target)
    normal = design.T @ design
    ridge = 1e-6 * np.trace(normal) / len(normal) + 1e-12
    x = np.linalg.solve(normal + ridge * np.eye(len(normal)), design.T @ target)
    return float(((target - design @ x) ** 2).sum())


def _columns(bench: Bench, named: Hypothesis, every: Sequence[TermPiece]) -> list[tuple[TermPiece, Array]]:
    """(K, 5, c) of each piece beside a hypothesis, over the priors."""
    terms = _terms(bench, every)
    chain = bench.chain([*named.terms, *terms])
    known = named.values
    keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
    p = np.array([known.get(key, value) for key, value in zip(keys, chain.neutral.tolist(), strict=True)])
    J = bench.linearised(chain, p)[1] * chain.prior
    place = {key: k for k, key in enumerate(keys)}
    return [(piece, J[:, :, [place[piece.on.effect_name, name] for name in piece.names]]) for piece in every]


def _terms(bench: Bench, chosen: Sequence[TermPiece]) -> list[Term]:
    """One term for each target, with the ranges of its inputs in the data."""
    names: dict[str, dict[str, None]] = {}
    targets = {piece.on.effect_name: piece.on for piece in chosen}
    for piece in chosen:
        names.setdefault(piece.on.effect_name, {}).update(dict.fromkeys(piece.names))
    ranges = _ranges(bench, chosen)
    made = [(learned(on, list(names[name]), ranges, bench.robot.n)) for name, on in targets.items()]
    return [Term(effect, effect.parameters_of()) for effect in made]


def _ranges(bench: Bench, chosen: Sequence[TermPiece]) -> dict[str, InputRange]:
    data = bench.data
    at = _situation(bench, data)
    asked = {
        name
        for piece in chosen
        for text in piece.parts
        if (result := part(text, bench.robot.n)) is not None
        for name in inputs(result)
    }
    spans: dict[str, InputRange] = {}
    for name in sorted(asked):
        x = values(name, at)
        if x is not None and np.isfinite(x).any():
            spans[name] = InputRange(float(np.nanmin(x)), float(np.nanmax(x)))
    return spans


def _situation(bench: Bench, data: Measurements) -> Situation:
    joints = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    chain = bench.chain([])
    prediction = chain.predict(bench.robust.p, derivatives=False)
    poses = Poses(prediction.position_m, frames_along(prediction.tangent, np.eye(3)[np.zeros(data.count, int)]))
    return Situation(*joints, poses=poses, data=data, tubes=bench.robot.tubes)


def with_reach(bench: Bench, hypothesis: Hypothesis) -> Hypothesis:
    """The same with the farthest that each built term moved a tip in the data, which margins allow for."""
    chain, p = hypothesis.chain, hypothesis.p
    whole = chain.predict(p, derivatives=False).position_m
    terms = list(chain.terms)
    for k, (t, place) in enumerate(zip(chain.terms, chain.slices(), strict=True)):
        if isinstance(t.effect, Learned):
            without = p.copy()
            without[place] = chain.neutral[place]
            moved = np.linalg.norm(whole - chain.predict(without, derivatives=False).position_m, axis=1)
            names = [q.name for q in t.parameters]
            effect = learned(t.effect.target, names, t.effect.ranges, bench.robot.n, float(1e3 * np.nanmax(moved)))
            terms[k] = Term(effect, t.parameters)
    again = chain.with_terms(terms)
    listed = {t.key: t for t in terms}
    return replace(hypothesis, chain=again, terms=tuple(listed[t.key] for t in hypothesis.terms))
