"""How probable it is that each effect acts, that something acts which the catalogue lacks, and that a verdict is true.

A hypothesis is a set of effects, with or without something unknown besides. Its likelihood is the density of all poses
that choose, with every parameter integrated out over its prior around the set's own fit (Laplace). An effect acts with
a probability that is stated once, shared among its variants; so does something unknown. Posterior probabilities sum to
one over what the search compared: nothing, every set that was fitted, and nothing and the chosen set with one effect
more, to first order.

Priors of parameters say where to look. How wide they have to be is itself uncertain: a width w times the stated one has
the density 1 / w^2 for w > 1, and stands at its most probable value.

An unknown error of tips belongs to the configuration, or is smooth in the joints or in time. One of a stage is a
zero-mean Gaussian process of an angle, a travel, a precurvature, a stiffness or the tilt of the plate, seen through the
chain's derivatives: of its own joint, of all joints, of all joints and the way they were reached, or of time. Either
acts alone, or both do; kinds and sizes, alike in their logarithm, are integrated out. Processes contain what named
effects do (constants, slopes, first waves): an effect has to be more probable than something unknown at its stage.

With B (N, m) the process in its leading modes, of the size s over the noise, and J the derivatives by a set's
parameters with the precision P of their priors, s changes the logarithm of the evidence by

    1/2 sum_i (s^2 u_i^2 / (1 + s^2 v_i) - log(1 + s^2 v_i)),

v_i the eigenvalues of B^T S B, u_i the components of B^T S r along their vectors, S = I - J (J^T J + P)^-1 J^T.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration.discrepancy import SIZES, Linearised, of_configurations
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise, compared
from ctrplan.diagnosis import remainder
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.remainder import QUARTERS, SmoothError, square_distances
from ctrplan.diagnosis.term_dictionary import TermPiece, pieces
from ctrplan.diagnosis.term_search import wide_linearisation
from ctrplan.diagnosis.verdict import Verdict
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench
from ctrplan.measurement.approach import clock, friction_state, last_directions
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term

ACTS = 0.03  # prior probability that an effect of the catalogue acts: of some 20, one in every other robot
UNKNOWN_ACTS = 0.1  # the same of something that the catalogue lacks


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, whether something unknown acts besides, and the logarithm of prior times likelihood."""

    names: frozenset[str]
    has_unknown: bool
    weight: float


@dataclass(frozen=True, eq=False)
class Posterior:
    """Probabilities of hypotheses that exclude each other."""

    hypotheses: tuple[Hypothesis, ...]

    @cached_property
    def probabilities(self) -> Array:
        """(H,) of the hypotheses; they sum to one."""
        weights = np.array([one.weight for one in self.hypotheses])
        probabilities: Array = np.exp(weights - logsumexp(weights))
        return probabilities

    def of_effect(self, *names: str) -> float:
        """That at least one of these effects acts."""
        return self._of(bool(one.names & set(names)) for one in self.hypotheses)

    @property
    def of_unknown(self) -> float:
        """That something acts which the catalogue lacks."""
        return self._of(one.has_unknown for one in self.hypotheses)

    def of_verdict(self, verdict: Verdict, listed: Sequence[Collection[str]]) -> float:
        """That a verdict is true; listed: names of each finding, the effect and what may stand for it.

        "Named" and "ambiguous" say that one of each finding acts and nothing else does, "partial" that one of each
        acts, "unexplained" that something unknown does besides.
        """

        def holds(one: Hypothesis) -> bool:
            acts = all(one.names & set(names) for names in listed)
            if verdict == "partial":
                return acts
            if verdict == "unexplained":
                return acts and one.has_unknown
            return acts and len(one.names) == len(listed) and not one.has_unknown

        return self._of(holds(one) for one in self.hypotheses)

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json: that nothing acts, that something unknown does, and each effect that may."""
        names = sorted({name for one in self.hypotheses for name in one.names})
        effects = {name: round(self.of_effect(name), 3) for name in names}
        return {
            "nothing": round(self.of_verdict("no_missing_effect", ()), 4),
            "unknown": round(self.of_unknown, 4),
            "effects": {name: p for name, p in effects.items() if p > 0},
            "sets_compared": len(self.hypotheses),
        }

    def _of(self, hits: Iterable[bool]) -> float:
        return float(min(1.0, self.probabilities[np.fromiter(hits, bool, len(self.hypotheses))].sum()))


def shown(probability: float) -> str:
    """In words: two digits, never certain."""
    if probability > 0.995:
        return "probability above 0.99"
    return f"probability {probability:.2f}" if probability >= 0.005 else "probability below 0.01"


def normalised(evidence: Mapping[frozenset[str], tuple[float, float]]) -> Posterior:
    """The posterior from log evidences of sets, without and with an unknown error; -inf where that was not asked."""
    results = []
    for names, values in evidence.items():
        for has_unknown, value in enumerate(values):
            prior = len(names) * _log_odds(ACTS) + has_unknown * _log_odds(UNKNOWN_ACTS)
            results.append(Hypothesis(names, bool(has_unknown), prior + value))
    return Posterior(tuple(results))


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def posterior(bench: Workbench, chosen: Scored, known: Candidates, more: Sequence[Scored] = ()) -> Posterior:
    """The posterior over the sets that a search on a bench has compared; more: sets that it no longer has.

    Built terms are no effects: what they do is done by something unknown.
    """
    base = bench.scored([])
    less = [bench.scored([t for t in chosen.terms if t is not gone], chosen.fit) for gone in chosen.terms]
    among = [one for one in (base, *bench.visited, *more, *less, chosen) if _is_alike(one.fit, chosen.fit)]
    asking = _Asking(bench, known, base, chosen)
    fitted = {frozenset(t.key for t in one.terms): one for one in among}.values()
    sets = [asking.whole(one) for one in fitted]
    sets += [asking.whole(one, without=name) for one in fitted for name in asking.free(one)]
    results = asking.evidences(sets)
    for here in (base, chosen) if chosen.terms else (base,):
        results += asking.one_more(here)
    evidence: dict[frozenset[str], tuple[float, float]] = {}
    refitted = {names for names, _ in results[: len(sets)]}
    for k, (names, values) in enumerate(results):
        if k < len(sets) or names not in refitted:  # a fit says more than a first step
            before = evidence.get(names, (-np.inf, -np.inf))
            evidence[names] = (float(np.logaddexp(before[0], values[0])), float(np.logaddexp(before[1], values[1])))
    return normalised(evidence)


def _is_alike(fit: Fit, other: Fit) -> bool:
    """Whether two fits are of the same poses over the same noise, so that their evidences compare."""
    return fit.chain.data is other.chain.data and fit.noise.position_m == other.noise.position_m


@dataclass(frozen=True, eq=False)
class _Set:
    """A set, linearised at its own fit over the noise alone."""

    names: frozenset[str]
    fit: Linearised
    cost: float  # logarithm, of widened priors and of the choice among variants
    has_built: bool

    @cached_property
    def alone(self) -> float:
        """Logarithm of the evidence beside noise alone, up to what is the same for every set of these poses."""
        return -np.inf if self.has_built else without_error(self.fit) - self.cost

    def beside(self, errors: UnknownErrors) -> tuple[float, Peak]:
        """Logarithm of the evidence beside something unknown, and the most probable smooth error."""
        value, peak = errors.evidence(self.fit)
        return value - self.cost, peak


Evidences = tuple[frozenset[str], tuple[float, float]]  # of a set: beside noise alone, and beside an unknown error


class _Asking:
    """What is the same for all sets of a search: poses, how much each counts, errors, and variants of effects."""

    def __init__(self, bench: Workbench, known: Candidates, base: Scored, chosen: Scored) -> None:
        self.bench, self.known = bench, known
        self.variants = Counter(t.name for t in known.terms)
        self.of_piece = float(np.log(len(pieces(bench.robot, bench.data, known.terms))))  # of which a term is built
        self.root = np.sqrt(np.where(base.failed | chosen.failed, 0.0, chosen.fit.residuals.weight))[:, None]
        ends = {scored: self.whole(scored) for scored in (base, chosen)}
        self.errors = UnknownErrors(bench, base, chosen, [one.fit for one in ends.values()], self.root[:, 0])
        self.beside = {scored: (one, *one.beside(self.errors)) for scored, one in ends.items()}

    def free(self, scored: Scored) -> list[str]:
        """Effects that are in a fit although they are not in its set: frames of a bench where these are always free."""
        return [t.name for t in scored.fit.chain.terms if t.name in self.variants and t.name not in scored.names]

    def whole(self, scored: Scored, without: str = "") -> _Set:
        """A set as it is fitted; to first order without an effect of the fit."""
        fit, own, widths = scored.fit, self._named(scored) - {without}, self._widths(scored)
        owners = [t.name for t in fit.chain.terms for _ in t.parameters]
        kept = [k for k, name in enumerate(owners) if name != without]
        r, J = self._linear(fit.residuals.r, fit.residuals.J, fit.p - fit.chain.neutral, fit.noise)
        precision = fit.precision / np.square([widths.get(name, 1.0) for name in owners])
        cost = sum(np.log(widths[name]) for name in widths if name != without) + self._choice(own)
        built = sum(len(t.parameters) for t in scored.terms if is_built(t))
        return _Set(own, Linearised(r, J[:, :, kept], precision[kept]), float(cost + built * self.of_piece), built > 0)

    def _named(self, scored: Scored) -> frozenset[str]:
        return frozenset({t.name for t in scored.fit.chain.terms} & set(self.variants))

    def _widths(self, scored: Scored) -> dict[str, float]:
        """By effect of a fit, how much wider than stated its prior is most probably."""
        chain, named = scored.fit.chain, {*self._named(scored), *scored.names}
        over = np.abs(scored.fit.p - chain.neutral) / chain.prior
        places = zip(chain.terms, chain.slices(), strict=True)
        return {t.name: float(max(1.0, over[place].max())) for t, place in places if t.name in named}

    def evidences(self, sets: Sequence[_Set]) -> list[Evidences]:
        """Logarithms of the evidence of sets that were solved as they are."""
        return [(one.names, (one.alone, one.beside(self.errors)[0])) for one in sets]

    def one_more(self, here: Scored) -> list[Evidences]:
        """Logarithms of the evidence of a set and any effect beside it that acts in proportion, to first order."""
        beside, unknown, peak = self.beside[here]
        names, variants = {*self._named(here), *here.names}, self.known.beside(here.terms)
        others = [t for t in variants if t.name not in names and t.effect.is_linear and t.effect.needs in ("", *names)]
        if not others:
            return []
        panel = self.bench.panel(here, others)
        r, J = self._linear(panel.whole.r, panel.whole.J, panel.whole.offset, self.bench.noise)
        widths = self._widths(here)
        precision = panel.whole.precision / np.square([widths.get(name, 1.0) for name, _ in panel.keys])

        def part(*more: Term) -> Linearised:
            wanted = {(t.name, q.name) for t in self._all([*here.terms, *more]) for q in t.parameters}
            columns = [k for k, key in enumerate(panel.keys) if key in wanted]
            return Linearised(r, J[:, :, columns], precision[columns])

        own = part()
        plain = without_error(own), peak.evidence(own)
        results = []
        for other in others:
            wider, choice = part(other), self._choice([other.name])
            gains = without_error(wider) - plain[0] - choice, peak.evidence(wider) - plain[1] - choice
            results.append((beside.names | {other.name}, (beside.alone + gains[0], unknown + gains[1])))
        return results

    def _all(self, terms: Sequence[Term]) -> list[Term]:
        return [*self.bench.basis(terms), *terms]

    def _linear(self, r: Array, J: Array, offset: Array, noise: Noise) -> tuple[Array, Array]:
        """Residuals (K, 5) at the priors' centres and derivatives (K, 5, P) over the noise alone, as poses count."""
        if noise.discrepancy is not None:
            r, J = noise.discrepancy.coloured(r), noise.discrepancy.coloured(J)
        return self.root * (r + J @ offset), self.root[:, :, None] * J

    def _choice(self, names: Iterable[str]) -> float:
        """Logarithm of what the choice of one variant of each effect costs."""
        return float(sum(np.log(max(self.variants[name], 1)) for name in names))


LEAST_MODE = 0.02  # of the largest: modes of a process that are smaller are left out


@dataclass(frozen=True, eq=False)
class Peak:
    """A smooth error with its most probable sizes over the noise."""

    error: SmoothError
    position: float
    tangent: float

    def evidence(self, fit: Linearised) -> float:
        """Logarithm of the evidence beside it."""
        return float(self.error.at(fit, self.position, self.tangent).evidences(slice(0, 1), 0)[0]) / 2

    def whitened(self, values: Array) -> Array:
        """(5 K, ...) numbers of a fit over the roots of noise and error, up to a rotation."""
        new = np.array(values)
        for numbered, size in ((self.error.position, self.position), (self.error.tangent, self.tangent)):
            for numbers, block in numbered if size else ():
                root = block.vectors / np.sqrt(1 + size**2 * block.values)
                new[numbers] = np.tensordot(root.T, values[numbers], axes=1)
        return new


def without_error(fit: Linearised) -> float:
    """Logarithm of the evidence beside noise alone."""
    r, J, scale = fit.r.ravel(), fit.J.reshape(fit.r.size, -1), 1 / np.sqrt(fit.precision)
    factor = np.linalg.cholesky((J.T @ J) * np.outer(scale, scale) + np.eye(len(scale)))
    z = np.linalg.solve(factor, scale * (J.T @ r))
    return float(z @ z - r @ r) / 2 - float(np.log(np.diag(factor)).sum())


class UnknownErrors:
    """What may act besides on some poses."""

    def __init__(
        self, bench: Workbench, base: Scored, chosen: Scored, ends: Sequence[Linearised], counts: Array
    ) -> None:
        """ends: the two sets, linearised; counts (K,): roots of what each pose counts."""
        tangent = chosen.fit.chain.predict(chosen.fit.p, derivatives=False).tangent
        axes = np.cross(tangent[:, None], compared(tangent, bench.data.tangent)[1])
        self.smooth = _smooth(bench.data, axes, ends)
        self.processes = list(_processes(bench, base, counts))

    def evidence(self, fit: Linearised) -> tuple[float, Peak]:
        """Logarithm of the evidence averaged over kinds and sizes of errors, and the most probable smooth one.

        An error of tips, one of a stage, and both are as probable a priori.
        """
        averaged = [_over_sizes(error, fit) for error in self.smooth]
        values = np.array([value for value, _ in averaged])
        peak = averaged[int(values.argmax())][1]
        alone = without_error(fit) + self.gain(fit.r.ravel(), fit.J.reshape(fit.r.size, -1), fit.precision)
        r, J = peak.whitened(fit.r.ravel()), peak.whitened(fit.J.reshape(fit.r.size, -1))
        smooth = float(logsumexp(values) - np.log(len(values)))
        both = smooth + self.gain(r, J, fit.precision, peak)
        return float(logsumexp([smooth, alone, both]) - np.log(3)), peak

    def gain(self, r: Array, J: Array, precision: Array, peak: Peak | None = None) -> float:
        """Logarithm of what a process of unknown stage and size multiplies the evidence by."""
        if not self.processes:
            return -np.inf
        scale = 1 / np.sqrt(precision)
        factor = np.linalg.cholesky((J.T @ J) * np.outer(scale, scale) + np.eye(len(scale)))
        taken = np.linalg.solve(factor, (J * scale).T)  # (P, N), whose square is J H^-1 J^T
        left = r - taken.T @ (taken @ r)
        gains = []
        for B in self.processes:
            over = peak.whitened(B) if peak else B
            by = taken @ over
            values, vectors = np.linalg.eigh(over.T @ over - by.T @ by)
            along, v = (vectors.T @ (over.T @ left)) ** 2, np.maximum(values, 0.0)
            square = SIZES[:, None] ** 2
            gain = (square * along / (1 + square * v) - np.log1p(square * v)).sum(axis=1) / 2
            gains.append(logsumexp(gain) - np.log(len(SIZES)))
        return float(logsumexp(gains) - np.log(len(gains)))


def _over_sizes(error: SmoothError, fit: Linearised) -> tuple[float, Peak]:
    """Logarithm of the evidence averaged over sizes, as if those of position and tangent were apart; and its peak."""
    spectrum = error.spectrum(fit)
    highest, position, tangent = spectrum.highest()
    p = int(np.abs(spectrum.position.size - position).argmin())
    t = int(np.abs(spectrum.tangent.size - tangent).argmin())
    lines = spectrum.evidences(slice(None), t), np.atleast_1d(spectrum.evidences(p, slice(None)))
    spread = sum(float(logsumexp((line - highest) / 2)) - np.log(len(line)) for line in lines)
    return highest / 2 + spread, Peak(error, position, tangent)


def _smooth(data: Measurements, axes: Array, ends: Sequence[Linearised]) -> list[SmoothError]:
    """Errors of tips, of poses at rest with as much in common of a configuration's approaches as either set says.

    axes (K, 2, 3) are those about which rotations are the two numbers of a tangent.
    """
    if data.is_stream:
        return remainder.of_motion(data, axes)
    shares = sorted({of_configurations(fit, data.configuration).memory for fit in ends})
    first, *others = (remainder.at_rest(data, share, axes) for share in shares)
    return first + [error for more in others for error in more if error.along != "time"]


def _processes(bench: Workbench, base: Scored, counts: Array) -> Iterator[Array]:
    """(5 K, m) modes of every process of drive and mechanics, over the noise, of a mean square of 1."""
    data = bench.data
    targets = {piece.on: None for piece in pieces(bench.robot, data) if piece.on.kind_name != "sensor"}
    constants = {on: TermPiece(on, ("constant",)) for on in targets if not on.of_way}
    plain = CorrelatedBench(bench.robot, data, replace(base.fit.noise, discrepancy=None), bench.group, bench.fold)
    table = wide_linearisation(plain, base, list(constants.values()))
    modes = {name: _modes(square) for name, square in _distances(data)}
    seen = {on: table.whole.J[:, :, table.places[piece]] * counts[:, None, None] for on, piece in constants.items()}
    rotations = [D for on, D in seen.items() if on.kind_name == "theta"]
    parts = [(f"{on.kind_name}_{on.tube}", D) for on, D in seen.items()]
    if len(rotations) > 1:
        parts.append(("rotations", np.concatenate(rotations, axis=2)))  # a cause that all of them share
    for own, D in parts:
        for name, phi in modes.items():
            if name in ("joints", "history", "time", own):
                B = (D[..., None] * phi[:, None, None]).reshape(D.shape[0] * D.shape[1], -1)
                size = np.sqrt((B**2).sum() / len(B))
                if size > 0:
                    yield B / size


def _distances(data: Measurements) -> Iterator[tuple[str, Array]]:
    """Squares (K, K) of distances of poses in the inputs of a process, in radians or what counts as much."""
    joints, time = square_distances(data, range(data.count)), clock(data)
    yield "joints", joints
    history = np.hstack([friction_state(data), last_directions(data)])
    yield "history", joints + ((history[:, None] - history) ** 2).sum(axis=2)
    yield "time", (QUARTERS * (time[:, None] - time) / max(float(np.ptp(time)), 1e-9)) ** 2
    theta, l = data.theta_commanded[data.rows], data.l_commanded[data.rows]  # noqa: E741
    for i in range(data.n):
        yield f"theta_{i + 1}", 4 * np.sin((theta[:, i, None] - theta[:, i]) / 2) ** 2
        yield f"l_{i + 1}", ((l[:, i, None] - l[:, i]) / remainder.ROOM_M) ** 2


def _modes(square: Array) -> Array:
    """(K, m) of a process that changes over a radian, or what counts as much."""
    values, vectors = np.linalg.eigh(np.exp(-square / 2))
    kept = values > LEAST_MODE * values[-1]
    modes: Array = vectors[:, kept] * np.sqrt(values[kept])
    return modes
