"""Forward selection of the parts of a missing term: each above what permuted residuals reach, by blocks that were
left out.

A search for a term takes minutes on a continuous motion. One that can't reach what a term needs is not begun.

After each piece the catalogue is asked again. What it has may have been small beside the rest before, and has a name.

An error of a collar acts through d pose / d joint, one of a tube's property through d pose / d parameter, one of the
sensor directly. A piece acts in proportion to its shape, so that one derivative per target is enough.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis.block_evidence import mean_square
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.cross_validation import Linear, left_out_residuals, null_thresholds
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.selection import MOST_EFFECTS
from ctrplan.diagnosis.term_dictionary import TermPiece
from ctrplan.diagnosis.workbench import CERTAIN, Scored, certainty, values_by_name
from ctrplan.effects.learned import parts
from ctrplan.effects.learned.inputs import InputRange, Situation, Target, values
from ctrplan.effects.learned.learned import Learned, learned, named, split_name
from ctrplan.effects.learned.parts import Part
from ctrplan.measurement.approach import last_directions
from ctrplan.measurement.measurements import Poses, frames_along
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term


@dataclass(frozen=True, eq=False)
class WideLinearisation:
    """A fit's own columns, first, and those of pieces."""

    whole: Linear
    alike: Linear  # of the same columns, where every pose counts alike
    own: int
    places: dict[TermPiece, list[int]]
    ranges: dict[TermPiece, dict[str, InputRange]]

    def here(self) -> Linear:
        """Columns of the fit itself."""
        return self.whole.columns(list(range(self.own)))

    def beside(self, piece: TermPiece) -> Linear:
        """With a piece besides."""
        return self.whole.columns([*range(self.own), *self.places[piece]])


def wide_linearisation(bench: CorrelatedBench, here: Scored, pieces: Sequence[TermPiece]) -> WideLinearisation:
    """The linearisation of a fit and of pieces that vanish there."""
    probed = _probed(bench, here, list(dict.fromkeys(replace(piece.on, of_way=False) for piece in pieces)))
    shapes = [_shapes(piece, probed, bench.robot.n) for piece in pieces]
    ends = np.cumsum([probed.own, *(len(piece.names) for piece in pieces)]).tolist()
    places = {piece: list(range(a, b)) for piece, a, b in zip(pieces, ends[:-1], ends[1:], strict=True)}
    sizes = [piece.on.kind.prior * piece.on.kind.si for piece in pieces for _ in piece.names]
    prior = np.concatenate([probed.chain.prior[: probed.own], sizes])
    by = np.concatenate([probed.by[:, :, : probed.own], *(columns for columns, _ in shapes)], axis=2)
    full = replace(probed.predicted, position_by=by[:, :3], tangent_by=by[:, 3:])
    offset = np.zeros(len(prior))
    offset[: probed.own] = (probed.p - probed.chain.neutral)[: probed.own]
    beside, alike = (
        residuals(bench.data, full, noise, bench.whitening_group) for noise in (bench.noise, bench.noise_alike)
    )
    return WideLinearisation(
        Linear(beside.r, beside.J, here.fit.residuals.weight, 1 / prior**2, offset, beside.given),
        Linear(alike.r, alike.J, alike.weight, 1 / prior**2, offset, alike.given),
        probed.own,
        places,
        {piece: ranges for piece, (_, ranges) in zip(pieces, shapes, strict=True)},
    )


@dataclass(frozen=True, eq=False)
class _Probed:
    """A fit with a constant amount of every target besides, which is zero."""

    chain: ParametricChain
    p: Array
    own: int  # parameters of the fit itself
    predicted: SensorPrediction
    starts: dict[Target, int]  # where the columns of each target begin

    @cached_property
    def by(self) -> Array:
        """(K, 6, P) positions and tangents by all parameters."""
        by: Array = np.concatenate([self.predicted.position_by, self.predicted.tangent_by], axis=1)
        return by

    @cached_property
    def situations(self) -> dict[str, Situation]:
        """What the terms of each stage know of the poses."""
        return _situations(self.chain, self.p, self.predicted)


def _probed(bench: CorrelatedBench, here: Scored, targets: Sequence[Target]) -> _Probed:
    probes = [_probe(on, bench.robot.n) for on in targets]
    chain = bench.chain([*bench.basis(here.terms), *here.terms, *probes])
    known = values_by_name(here.fit)
    keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
    p = np.array([known.get(key, value) for key, value in zip(keys, chain.neutral.tolist(), strict=True)])
    own = len(p) - sum(len(t.parameters) for t in probes)
    starts = [place.start for place in chain.slices()[len(chain.terms) - len(probes) :]]
    return _Probed(chain, p, own, chain.predict(p), dict(zip(targets, starts, strict=True)))


def _shapes(piece: TermPiece, probed: _Probed, n: int) -> tuple[Array, dict[str, InputRange]]:
    """(K, 6, S) poses by the coefficients of a piece, and the ranges of its inputs."""
    at, start = probed.situations[_stage(piece.on)], probed.starts[replace(piece.on, of_way=False)]
    ranges, columns, by = _ranges(piece, at, n), list[Array](), probed.by
    for name in piece.names:
        axis, part = _split(name, piece.on, n)
        columns.append(by[:, :, start + axis] * parts.amounts(part, at, ranges)[:, None])
    return np.stack(columns, axis=2), ranges


def _split(name: str, on: Target, n: int) -> tuple[int, Part]:
    result = split_name(name, on, n)
    assert result is not None  # it was named by the same rules
    return result


def _probe(on: Target, n: int) -> Term:
    """A constant amount of a target."""
    effect = learned(on, named(on, "constant"), {}, n)
    effect.name = f"probe_{on.effect_name}"
    return Term(effect, effect.parameters_of())


def _stage(on: Target) -> str:
    return "plate" if on.kind_name == "plate" else on.kind.stage


def _situations(chain: ParametricChain, p: Array, predicted: SensorPrediction) -> dict[str, Situation]:
    """What the terms of each stage know of the poses."""
    data, collars = chain.data, chain.collars(p)
    joints = data.theta_commanded[data.rows], data.l_commanded[data.rows]
    directions, tubes = last_directions(data), chain.robot.tubes
    across = np.eye(3)[np.argmin(np.abs(predicted.tangent), axis=1)]
    poses = Poses(predicted.position_m, frames_along(predicted.tangent, across))
    return {
        "drive": Situation(collars.theta, collars.l, directions),
        "mechanics": Situation(*joints, data=data, tubes=tubes),
        "plate": Situation(collars.theta, collars.l, tubes=tubes),
        "sensor": Situation(*joints, poses=poses, data=data),
    }


def _ranges(piece: TermPiece, at: Situation, n: int) -> dict[str, InputRange]:
    results = {}
    for name in piece.names:
        for one in parts.inputs(_split(name, piece.on, n)[1]):
            seen = values(one, at)
            assert seen is not None
            results[one] = InputRange(float(seen.min()), float(seen.max()))
    return results


def reach(bench: CorrelatedBench, table: WideLinearisation, known: Sequence[TermPiece], most: int) -> float:
    """Share of the squares beyond noise that the `most` best pieces close of blocks left out; all poses count alike.

    Each piece is the one that closes most beside those before it.
    """
    columns, left = list(range(table.own)), [_left(bench, table, list(range(table.own)))]
    others = list(known)
    for _ in range(min(most, len(others))):
        tried = [_left(bench, table, [*columns, *table.places[piece]]) for piece in others]
        best = int(np.argmin(tried))
        if tried[best] >= left[-1]:
            break
        left.append(tried[best])
        columns += table.places[others.pop(best)]
    rest = left[0] - bench.plain.floor_m**2
    return (left[0] - left[-1]) / max(rest, 1e-12)


def _left(bench: CorrelatedBench, table: WideLinearisation, columns: list[int]) -> float:
    """Mean square [m^2] of positions on blocks left out, with some of the columns fitted."""
    system = table.alike.columns(columns).refitted()
    sigma_m = bench.noise_alike.position_m * bench.data.over_tip
    return mean_square(left_out_residuals(system, bench.fold)[:, :3] * sigma_m)


DRAWS = 200  # surrogates
TIMES_CHANCE = 1.2  # the gain that traded residuals exceed in 2 % of draws; beside a piece that passed, smooth ones too
LEAST_SHARE = 0.1  # of the squares that remain beyond noise, which a piece has to close of blocks left out
WORTH_MORE = 3.0  # log-likelihood that a piece with more coefficients has to gain besides
TRIED = 4  # pieces that are refitted for good in each round


@dataclass(frozen=True)
class Tried:
    """A piece of a round: gain in held-out log-likelihood, to first order."""

    piece: TermPiece
    gain: float
    certainty: float


@dataclass(frozen=True, eq=False)
class Round:
    """What was tried, best first, and what the best of all pieces reaches by chance."""

    tried: tuple[Tried, ...]
    chance: float
    smooth_chance: float  # the same on surrogates that are as smooth in the joints as what remains
    taken: TermPiece | None


def grown(
    bench: CorrelatedBench,
    chosen: Scored,
    known: Sequence[TermPiece],
    tell: Callable[[str], None],
    with_names: Callable[[Scored], Scored],
    least: float,
    smooth_counts: bool = True,
) -> tuple[Scored, list[Round]]:
    """The set with what was built beside it, if anything, and the rounds that were asked.

    known: pieces that may be built; with_names: adds what the catalogue has beside a set; least: share of the rest that
    pieces must be able to close; smooth_counts: whether pieces beside others have to beat smooth surrogates as well.
    """
    rounds, here = list[Round](), chosen
    known = [piece for piece in known if piece.on.effect_name not in bench.robot.effects]
    while len(rounds) < MOST_EFFECTS:
        tell("building a term beside " + (", ".join(here.names) or "the calibrated robot"))
        table = wide_linearisation(bench, here, known)
        if not rounds and reach(bench, table, known, MOST_EFFECTS) < least:
            break
        taken, there = _round(bench, here, table, known, bool(rounds), smooth_counts)
        rounds.append(taken)
        if there is None:
            return here, rounds
        here = _needed(bench, with_names(there), taken.chance, known=there)
        known = [piece for piece in known if piece != taken.taken]
    return here, rounds


def _round(
    bench: CorrelatedBench,
    here: Scored,
    table: WideLinearisation,
    known: Sequence[TermPiece],
    is_more: bool,
    smooth_counts: bool,
) -> tuple[Round, Scored | None]:
    """is_more: whether a piece was taken before."""
    tried = _tried(bench, table, known)
    beside = [table.beside(one.piece) for one in tried]
    draws = [drawn(here)[:, :DRAWS] for drawn in (bench.traded_draws, bench.null_draws)]
    chance, smooth = null_thresholds(table.here(), beside, bench.null_scores, draws)
    needed = TIMES_CHANCE * chance
    if is_more:
        needed = TIMES_CHANCE * max(chance, smooth) if smooth_counts else chance
    worth = [one for one in tried if one.gain > needed and one.certainty > CERTAIN]
    best: tuple[TermPiece, Scored] | None = None
    for one in sorted(worth[:TRIED], key=lambda one: (len(one.piece.names), known.index(one.piece))):
        there = bench.scored(_with_piece(here.terms, one.piece, table.ranges[one.piece], bench), here.fit)
        if best is None or there.score > best[1].score + WORTH_MORE:  # the simplest of those that do as well
            best = one.piece, there
    if best is None or not _pays_off(bench, here, best[1], needed):
        return Round(tuple(tried), chance, smooth, None), None
    return Round(tuple(tried), chance, smooth, best[0]), bench.corrected(best[1])


def _needed(bench: CorrelatedBench, here: Scored, least: float, known: Scored) -> Scored:
    """Without built terms whose place the names that came besides have taken; the `known` set had none of these."""
    if here is known:
        return here
    for t in (t for t in here.terms if is_built(t)):
        without = bench.scored([other for other in here.terms if other is not t], here.fit)
        if bench.difference(here, without)[0] < least:
            return _needed(bench, bench.corrected(without), least, known)
    return here


def _tried(bench: CorrelatedBench, table: WideLinearisation, known: Sequence[TermPiece]) -> list[Tried]:
    plain = bench.loss(table.here().refitted())
    results = []
    for piece in known:
        gains = bench.by_group((plain - bench.loss(table.beside(piece).refitted())) / 2)
        results.append(Tried(piece, float(gains.sum()), certainty(gains)))
    return sorted(results, key=lambda one: -one.gain)


def _pays_off(bench: CorrelatedBench, here: Scored, there: Scored, needed: float) -> bool:
    """Whether a refitted piece holds, and closes enough of what remains."""
    gain, _ = bench.difference(there, here)
    before, after = mean_square(bench.left_out_m(here)), mean_square(bench.left_out_m(there))
    rest = max(before - bench.plain.floor_m**2, 1e-12)
    return gain > needed and before - after > LEAST_SHARE * rest


def _with_piece(
    terms: Sequence[Term], piece: TermPiece, ranges: dict[str, InputRange], bench: CorrelatedBench
) -> list[Term]:
    """The terms with a piece in the built term of its target."""
    old = next((t for t in terms if t.name == piece.on.effect_name), None)
    names, spans = list[str](), dict(ranges)
    if old is not None:
        assert isinstance(old.effect, Learned)
        names, spans = list(old.effect.parts), {**ranges, **old.effect.ranges}
    names += [name for name in (*piece.names, *_zero(piece)) if name not in names]
    return [*(t for t in terms if t is not old), built_term(piece.on, names, spans, bench.robot.n)]


def _zero(piece: TermPiece) -> list[str]:
    """The constant that goes with a slope whose zero is arbitrary: else that would be a wrong zero of a joint.

    A slope of the drive, and of a precurvature across its plane, which turns a tube as a joint does.
    """
    is_slope = any(part.startswith("slope_") for part in piece.parts)
    is_of_turn = piece.on.kind_name == "bend" or (piece.on.kind.stage == "drive" and not piece.on.of_way)
    return named(piece.on, "constant") if is_slope and is_of_turn else []


def built_term(on: Target, names: Sequence[str], ranges: dict[str, InputRange], n: int) -> Term:
    """With all its parameters at work."""
    effect = learned(on, names, ranges, n)
    return Term(effect, effect.parameters_of())
