"""Tips by what terms may act on, and by every piece: a fit linearised in all of them at once.

An error of a collar acts through d pose / d joint, one of a tube's property through d pose / d parameter, one of the
sensor directly. A piece acts in proportion to its shape, so that one derivative per target is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis.building.dictionary import Piece
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.held_out import Linear
from ctrplan.diagnosis.workbench import Scored, values_by_name
from ctrplan.effects.learned import parts
from ctrplan.effects.learned.inputs import Situation, values
from ctrplan.effects.learned.learned import learned, named, split_name
from ctrplan.effects.learned.ranges import Range
from ctrplan.effects.learned.targets import Target
from ctrplan.experiment.friction_states import last_directions
from ctrplan.pipeline.parametric_chain import ParametricChain, Prediction, Term
from ctrplan.sensor.poses import Poses, frames_along


@dataclass(frozen=True, eq=False)
class Wide:
    """A fit's own columns, first, and those of pieces."""

    whole: Linear
    own: int
    places: dict[Piece, list[int]]
    ranges: dict[Piece, dict[str, Range]]

    def here(self) -> Linear:
        """Of the fit's own columns."""
        return self.whole.columns(list(range(self.own)))

    def beside(self, piece: Piece) -> Linear:
        """With a piece besides."""
        return self.whole.columns([*range(self.own), *self.places[piece]])


def wide(bench: CorrelatedBench, here: Scored, pieces: Sequence[Piece]) -> Wide:
    """Of a fit and pieces that vanish there."""
    targets = list(dict.fromkeys(replace(piece.on, of_way=False) for piece in pieces))
    probes = [_probe(on, bench.robot.n) for on in targets]
    chain = bench._chain([*bench.basis(here.terms), *here.terms, *(p for p in probes)])
    known, neutral = values_by_name(here.fit), iter(chain.neutral)
    keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
    p = np.array([known.get(key, next(neutral)) for key in keys])
    predicted = chain.predict(p)
    own = len(p) - sum(len(t.parameters) for t in probes)
    places = dict(zip(targets, chain.slices()[len(chain.terms) - len(probes) :], strict=True))
    situations = _situations(chain, p, predicted)
    columns, where, ranges, prior = (
        list[Array](),
        dict[Piece, list[int]](),
        dict[Piece, dict[str, Range]](),
        list(chain.prior[:own]),
    )
    by = np.concatenate([predicted.position_by, predicted.tangent_by], axis=1)
    count = own
    for piece in pieces:
        at = situations[_stage(piece.on)]
        ranges[piece] = _ranges(piece, at, bench.robot.n)
        for name in piece.names:
            found = split_name(name, piece.on, bench.robot.n)
            assert found is not None
            axis, part = found
            probe = by[:, :, places[replace(piece.on, of_way=False)].start + axis]
            columns.append(probe * parts.amounts(part, at, ranges[piece])[:, None])
        names = len(piece.names)
        where[piece] = list(range(count, count + names))
        prior += [piece.on.kind.prior * piece.on.kind.si] * names
        count += names
    everything = np.concatenate([by[:, :, :own], np.stack(columns, axis=2)], axis=2)
    full = replace(predicted, position_by=everything[:, :3], tangent_by=everything[:, 3:])
    found_r = residuals(bench.data, full, bench.noise, bench.whitening_group)
    offset = np.concatenate([p[:own] - chain.neutral[:own], np.zeros(count - own)])
    whole = Linear(found_r.r, found_r.J, here.fit.residuals.weight, 1 / np.array(prior) ** 2, offset, found_r.given)
    return Wide(whole, own, where, ranges)


def _probe(on: Target, n: int) -> Term:
    """A constant amount of a target."""
    effect = learned(on, named(on, "constant"), {}, n)
    effect.name = f"probe_{on.effect_name}"
    return Term(effect, effect.parameters_of())


def _stage(on: Target) -> str:
    return "plate" if on.kind_name == "plate" else on.kind.stage


def _situations(chain: ParametricChain, p: Array, predicted: Prediction) -> dict[str, Situation]:
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


def _ranges(piece: Piece, at: Situation, n: int) -> dict[str, Range]:
    found = {}
    for name in piece.names:
        split = split_name(name, piece.on, n)
        assert split is not None
        for one in parts.inputs(split[1]):
            seen = values(one, at)
            assert seen is not None
            found[one] = Range(float(seen.min()), float(seen.max()))
    return found
