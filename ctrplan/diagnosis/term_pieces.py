"""What a missing term may be made of: pieces per stage and target that a physical term could have, their derivatives,
and the terms that are made of them.

An error of a collar acts through d pose / d joint, one of a tube's property through d pose / d parameter, one of the
sensor directly. A piece acts in proportion to its shape, so that one derivative per target is enough. Whatever changes
slowly goes with time, which is an input only where what remains goes along with it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.calibration.residuals import residuals
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.linear_fit import Linear
from ctrplan.diagnosis.workbench import Scored, valued
from ctrplan.effects.effect import sliding, turning
from ctrplan.effects.learned import parts
from ctrplan.effects.learned.inputs import InputRange, Situation, Target, values
from ctrplan.effects.learned.learned import Learned, learned, named, split_name
from ctrplan.effects.learned.parts import Part
from ctrplan.measurement.approach import last_directions, time_at_rest_s
from ctrplan.measurement.measurements import Measurements, Poses, frames_along
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term
from ctrplan.robot.robot import Robot

OWN_WAVES, OTHER_WAVES = 6, 3  # highest harmonics: of a joint's own angle, and of others and relative ones
KNOTS = 4  # of a spline
HALF_WAVES = 9  # over the time, as many as a name can say, and no more than configurations; a budget
BUMPS = (3, 4)  # along each axis of the room that the tips have
NEAR_SHARE = 0.05  # of the tips
PLACE = re.compile(r"(slope|square)_[xyz](_times_slope_[xyz])?")  # polynomials of the tip's place


@dataclass(frozen=True)
class TermPiece:
    """Parts that enter together, of one target: a wave's sine and cosine, the knots of a spline."""

    on: Target
    parts: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(name for part in self.parts for name in named(self.on, part))


def pieces(robot: Robot, data: Measurements, named: Sequence[Term] = (), *, in_time: bool = False) -> list[TermPiece]:
    """All that data can tell apart from nothing, but what an effect among `named` is: that has a name, and is asked.

    in_time: those that change with time among them.
    """
    moved = _Moved(robot, data)
    drive = [] if data.of_collars else _drive(moved)  # collars have the drive's terms in them
    names = {(t.name, parameter.name) for t in named for parameter in t.parameters}
    asked = [*drive, *_mechanics(moved), *_sensor(moved), *(_in_time(moved) if in_time else ())]
    return [piece for piece in asked if _as_named(piece) not in names]


def _as_named(piece: TermPiece) -> tuple[str, str] | None:
    """Effect of the catalogue, and a parameter of it, that acts as a piece does."""
    kind, i = piece.on.kind_name, piece.on.tube
    if kind == "sensor" and all(PLACE.fullmatch(part) for part in piece.parts):
        return "sensor_distortion", "x_x_mm"
    if kind not in ("theta", "l"):
        return None
    own, unit = f"{kind}_{i}", "deg" if kind == "theta" else "mm"
    forms = {
        (f"sign_{own}",): ("backlash", f"{own}_{unit}"),
        ("constant",): ("homing_offset", f"{own}_{unit}"),
        (f"slope_{own}",): ("joint_scale", own),
    }
    of_turns = {_wave(1, own): ("eccentricity", f"sin_{i}_deg")} if kind == "theta" else {}
    return (forms | of_turns).get(piece.parts)


class _Moved:
    """What changes in the data: tubes, from 1, that turn and slide; pairs that turn; columns."""

    def __init__(self, robot: Robot, data: Measurements) -> None:
        self.robot, self.data = robot, data
        self.turning, self.sliding = turning(data), sliding(data)
        turns = np.diff(data.theta_commanded[data.rows], axis=1)
        self.pairs = [i + 2 for i in range(data.n - 1) if np.ptp(turns[:, i]) > np.radians(1.0)]
        directions = last_directions(data)
        self.both_ways = [i + 1 for i in range(2 * data.n) if np.ptp(directions[:, i]) > 1]
        self.columns = [name for name, values in data.more.items() if _varies(values[data.rows])]
        self.rest = ["rest"] if np.ptp(time_at_rest_s(data)) > 1.0 else []


def _varies(values: np.ndarray) -> bool:
    return bool(np.all(np.isfinite(values)) and np.ptp(values) > 1e-9)


def _wave(k: int, angle: str) -> tuple[str, ...]:
    return f"sin_{k}_{angle}", f"cos_{k}_{angle}"


def _spline(name: str) -> tuple[str, ...]:
    return tuple(f"knot_{k + 1}_of_{KNOTS}_{name}" for k in range(KNOTS))


def _smooth(names: list[str]) -> Iterator[tuple[str, ...]]:
    for name in names:
        yield (f"slope_{name}",)
        yield _spline(name)


def _drive(moved: _Moved) -> Iterator[TermPiece]:
    angles = [f"theta_{j}" for j in moved.turning]
    for i in moved.turning:
        on = Target("theta", i)
        for angle in angles:
            highest = OWN_WAVES if angle == f"theta_{i}" else OTHER_WAVES
            yield from (TermPiece(on, _wave(k, angle)) for k in range(1, highest + 1))
            yield TermPiece(on, (f"slope_{angle}",))
        yield from (TermPiece(on, _wave(k, f"turn_{j}")) for j in moved.pairs for k in range(1, OTHER_WAVES + 1))
        yield from (TermPiece(on, parts) for parts in _smooth([f"l_{j}" for j in moved.sliding]))
        yield TermPiece(on, ("constant",))
        if i in moved.both_ways:
            yield from _of_way(Target("theta", i, of_way=True), f"sign_theta_{i}", moved)
    for i in moved.sliding:
        on = Target("l", i)
        yield from (TermPiece(on, _wave(k, angle)) for angle in angles for k in (1, 2))
        yield from (TermPiece(on, parts) for parts in _smooth([f"l_{j}" for j in moved.sliding]))
        yield TermPiece(on, ("constant",))
        if moved.data.n + i in moved.both_ways:
            yield from _of_way(Target("l", i, of_way=True), f"sign_l_{i}", moved)


def _of_way(on: Target, sign: str, moved: _Moved) -> Iterator[TermPiece]:
    yield TermPiece(on, (sign,))
    yield from (TermPiece(on, (sign, f"slope_l_{j}_times_{sign}")) for j in moved.sliding)


def _mechanics(moved: _Moved) -> Iterator[TermPiece]:
    n = moved.data.n
    overlaps = [f"overlap_{i}" for i in range(1, n) if moved.sliding]
    loads = [f"load_{i - 1}" for i in moved.pairs]
    smooth = [f"l_{j}" for j in moved.sliding] + moved.columns
    for i, tube in enumerate(moved.robot.tubes, start=1):
        kinds = ("curvature", "bend") if any(s.curvature_per_m for s in tube.sections) else ()
        for kind in (*kinds, *(("stiffness",) if i > 1 else ())):
            on = Target(kind, i)
            yield from (TermPiece(on, parts) for parts in _smooth(smooth))
            yield from (TermPiece(on, (f"slope_{name}",)) for name in (*overlaps, *loads, *moved.rest))
            yield from (TermPiece(on, _wave(k, f"turn_{j}")) for j in moved.pairs for k in (1, 2))
    plate = Target("plate")
    yield from (TermPiece(plate, parts) for parts in _smooth([f"l_{j}" for j in moved.sliding]))
    yield from (TermPiece(plate, _wave(1, f"theta_{j}")) for j in moved.turning)


def _in_time(moved: _Moved) -> Iterator[TermPiece]:
    """Those of tubes and sensor that change with time, at rest only: on a continuous motion everything does."""
    data = moved.data
    if data.time_s is None or data.is_stream:
        return
    targets = dict.fromkeys(
        piece.on for piece in (*_mechanics(moved), *_sensor(moved)) if piece.on.kind_name != "plate"
    )
    for k in range(1, min(HALF_WAVES, len(np.unique(data.configuration))) + 1):
        yield from (TermPiece(on, (f"sin_{k}_over_time", f"cos_{k}_over_time")) for on in targets)


def _bumps(position_m: Array, count: int) -> Iterator[str]:
    """Places, `count` along each axis, that enough of the tips (K, 3) are nearest to, for something beside them."""
    position_m = position_m[np.isfinite(position_m).all(axis=1)]  # markers seen along an axis are nowhere
    if not len(position_m):
        return
    scaled = (position_m - position_m.min(axis=0)) / np.maximum(np.ptp(position_m, axis=0), 1e-9)
    nearest = np.round(scaled * (count - 1)).astype(int) + 1
    for place, number in zip(*np.unique(nearest, axis=0, return_counts=True), strict=True):
        if number >= NEAR_SHARE * len(position_m):
            yield "_times_".join(f"bump_{k}_of_{count}_{axis}" for k, axis in zip(place, "xyz", strict=True))


def _products(names: tuple[str, ...]) -> Iterator[str]:
    return (f"slope_{a}_times_slope_{b}" for a, b in combinations(names, 2))


def _sensor(moved: _Moved) -> Iterator[TermPiece]:
    on = Target("sensor")
    tip, heading = ("x", "y", "z"), ("tx", "ty", "tz") if moved.data.has_tangents else ()
    yield TermPiece(on, tuple(f"slope_{name}" for name in tip))
    for group in (tip, heading):
        yield from (TermPiece(on, (f"slope_{name}",)) for name in group)
        yield from (TermPiece(on, (f"square_{name}", f"slope_{name}")) for name in group)
        yield from (TermPiece(on, (product,)) for product in _products(group))
    if heading:
        yield TermPiece(on, ("square_tx", "square_ty", "slope_tx_times_slope_ty"))
        yield TermPiece(on, tuple(f"slope_{name}" for name in heading))
    yield TermPiece(on, tuple(f"square_{name}" for name in tip) + tuple(_products(tip)))
    yield TermPiece(on, _spline("z"))
    yield from (TermPiece(on, (bump,)) for count in BUMPS for bump in _bumps(moved.data.position_m, count))
    yield from (TermPiece(on, parts) for parts in _smooth(moved.columns))
    yield from (TermPiece(on, (f"slope_{name}",)) for name in moved.rest)


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
    p = valued(chain, here.fit, chain.neutral)
    own = len(p) - sum(len(t.parameters) for t in probes)
    starts = [place.start for place in chain.slices()[len(chain.terms) - len(probes) :]]
    return _Probed(chain, p, own, chain.predict(p), dict(zip(targets, starts, strict=True)))


def _shapes(piece: TermPiece, probed: _Probed, n: int) -> tuple[Array, dict[str, InputRange]]:
    """(K, 6, S) poses by the coefficients of a piece, and the ranges of its inputs."""
    stage = "plate" if piece.on.kind_name == "plate" else piece.on.kind.stage
    at, start = probed.situations[stage], probed.starts[replace(piece.on, of_way=False)]
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
    probe = built_term(on, named(on, "constant"), {}, n)
    probe.effect.name = f"probe_{on.effect_name}"
    return probe


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
    """Ranges of the inputs in the poses; that of the time is the whole experiment's, which poses kept aside are in."""
    results = {}
    for name in piece.names:
        for quantity in parts.inputs(_split(name, piece.on, n)[1]):
            seen = at.data.time_s if quantity == "time" and at.data else values(quantity, at)
            assert seen is not None
            results[quantity] = InputRange(float(seen.min()), float(seen.max()))
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
