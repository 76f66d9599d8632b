"""Linearised pieces of a missing term, and terms that are made of them.

An error of a collar acts through d pose / d joint, one of a tube's property through d pose / d parameter, one of the
sensor directly. A piece acts in proportion to its shape, so that one derivative per target is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.cross_validation import Linear
from ctrplan.diagnosis.term_dictionary import TermPiece
from ctrplan.diagnosis.workbench import Scored, values_by_name
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
    own: int
    places: dict[TermPiece, list[int]]
    ranges: dict[TermPiece, dict[str, InputRange]]


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
    parts = residuals(bench.data, full, bench.noise, bench.whitening_group)
    return WideLinearisation(
        Linear(parts.r, parts.J, here.fit.residuals.weight, 1 / prior**2, offset, parts.given),
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


def is_built(t: Term) -> bool:
    """Whether it was built of a rest, and is no name."""
    return isinstance(t.effect, Learned)


def with_piece(
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
