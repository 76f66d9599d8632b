"""How probable it is that each effect acts, that something acts which the catalogue lacks, and that a verdict is true.

A hypothesis is a set of effects, with or without something unknown besides. Its likelihood is the density of all poses
that choose, with every parameter integrated out over its prior around the set's own fit (Laplace).
An effect acts with a probability that is stated once, shared among its variants; so does something unknown. Posterior
probabilities sum to one over the sets that were compared.

Something unknown does what any effect does: beside noise it wins wherever the true set was not compared. So sets are
searched by this number itself, with one effect more or less than the most probable of each size, nonlinear effects
among them, until none is more probable. What is not worth a fit is compared to first order.

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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration import residuals
from ctrplan.calibration.discrepancy import SIZES, Linearised, of_configurations
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import remainder
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.cross_validation import Linear
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.remainder import QUARTERS, SmoothError, square_distances
from ctrplan.diagnosis.selection import MOST_EFFECTS, REFITTED
from ctrplan.diagnosis.term_dictionary import TermPiece, pieces
from ctrplan.diagnosis.term_search import wide_linearisation
from ctrplan.diagnosis.verdict import ACTS, UNKNOWN_ACTS, Posterior, log_odds, normalised
from ctrplan.diagnosis.workbench import Candidates, Scored, Workbench, linear
from ctrplan.measurement.approach import clock, friction_state, last_directions
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term


@dataclass(frozen=True, eq=False)
class Compared:
    """The posterior over sets that were compared, and those of them that were fitted, most probable first."""

    posterior: Posterior
    sets: tuple[Scored, ...]
    is_alone: bool  # whether nothing unknown acts besides in the first set's more probable hypothesis
    gain: float  # logarithm of how much more probable the first set is than the chosen one


def compared(
    bench: Workbench, chosen: Scored, known: Candidates, more: Sequence[Scored] = (), search: bool = False
) -> Compared:
    """The sets that a bench has fitted, and `more` of the same poses; search: whether more probable ones are sought.

    Built terms are no effects: what they do is done by something unknown.
    """
    base = bench.scored([])
    less = [bench.scored([t for t in chosen.terms if t is not gone], chosen.fit) for gone in chosen.terms]
    among = [one for one in (base, *bench.visited, *more, *less, chosen) if _is_alike(one.fit, chosen.fit)]
    asking = _Asking(bench, known, base, chosen)
    for one in among:
        asking.add(one)
    if search:
        asking.climb()
        if asking.best is not chosen:  # poses count as they do in the most probable set
            asking = _Asking(bench, known, base, asking.best, asking.fitted)
    for here in (base, chosen, asking.best):
        asking.ask_neighbours(here)
    ranked = sorted(asking.fitted, key=asking.weight, reverse=True)
    best = asking.known_sets[ranked[0]]
    is_alone = best.alone > best.beside + log_odds(UNKNOWN_ACTS)
    gain = best.weight - asking.weight(chosen)
    along = asking.errors.along(asking.as_fitted(ranked[0]))
    return Compared(normalised(asking.by_names(), along), tuple(ranked), is_alone, gain)


def posterior(bench: Workbench, chosen: Scored, known: Candidates, more: Sequence[Scored] = ()) -> Posterior:
    """The posterior over the sets that a search on a bench has compared; more: sets that it no longer has."""
    return compared(bench, chosen, known, more).posterior


def _is_alike(fit: Fit, other: Fit) -> bool:
    """Whether two fits are of the same poses over the same noise, so that their evidences compare."""
    return fit.chain.data is other.chain.data and fit.noise.position_m == other.noise.position_m


@dataclass(frozen=True, eq=False)
class _Set:
    """A set as it was fitted, or to first order, with logarithms of its evidence beside noise and something unknown."""

    names: frozenset[str]
    cost: float  # logarithm, of widened priors and of the choice among variants
    alone: float
    beside: float
    peak: Peak

    @property
    def weight(self) -> float:
        """Logarithm of prior times likelihood."""
        prior = len(self.names) * log_odds(ACTS)
        return prior + float(np.logaddexp(self.alone, self.beside + log_odds(UNKNOWN_ACTS)))


class _Asking:
    """What is the same for all sets of a search: poses, how much each counts, errors, and variants of effects."""

    def __init__(
        self, bench: Workbench, known: Candidates, base: Scored, chosen: Scored, fitted: Iterable[Scored] = ()
    ) -> None:
        self.bench, self.known = bench, known
        self.variants = Counter(t.name for t in known.terms)
        self.of_piece = float(np.log(len(pieces(bench.robot, bench.data, known.terms))))  # of which a term is built
        self.root = np.sqrt(np.where(base.failed | chosen.failed, 0.0, chosen.fit.residuals.weight))[:, None]
        ends = [self.as_fitted(scored) for scored in (base, chosen)]
        self.errors = UnknownErrors(bench, base, chosen, ends, self.root[:, 0])
        self.known_sets: dict[Scored, _Set] = {}
        self._evidence: dict[frozenset[str], _Set] = {}
        self._expanded: set[Scored] = set()
        for one in fitted:
            self.add(one)

    @property
    def fitted(self) -> list[Scored]:
        """Sets that were fitted."""
        return list(self.known_sets)

    @property
    def best(self) -> Scored:
        """The most probable of them."""
        return max(self.known_sets, key=self.weight)

    def weight(self, scored: Scored) -> float:
        """Logarithm of prior times likelihood of a set."""
        return self.known_sets[scored].weight

    def add(self, scored: Scored) -> None:
        """A set as it is fitted; to first order without effects of the fit that are always free."""
        if scored in self.known_sets:
            return
        terms, (widths, owners) = self._named(scored), self._widths(scored)
        built = [t for t in scored.terms if is_built(t)]
        of_built = sum(len(t.parameters) for t in built) * self.of_piece
        for name in ("", *(t.name for t in terms if t.name not in scored.names)):
            names = frozenset(t.name for t in terms) - {name}
            cost = self._cost(names, [width for key, width in widths.items() if key != name]) + of_built
            fit = self._linearised(linear(scored.fit), scored.fit.noise, owners, widths, name)
            beside, peak = self.errors.evidence(fit)
            alone = -np.inf if built else without_error(fit) - cost
            result = _Set(names, cost, alone, beside - cost, peak)
            self._note([t for t in terms if t.name != name], result)
            if not name:
                self.known_sets[scored] = result

    def climb(self) -> None:
        """Fits sets of one effect more or less than the most probable of each size, while these are more probable.

        Sizes count as far as one effect's prior odds may hide the better one.
        """
        while True:
            highest, sizes = self.weight(self.best), dict[int, Scored]()
            for scored in sorted(self.known_sets, key=self.weight):
                sizes[len(scored.terms)] = scored
            near = [
                one
                for size, one in sizes.items()
                if size < MOST_EFFECTS and one not in self._expanded and self.weight(one) > highest + log_odds(ACTS)
            ]
            if not near:
                return
            here = max(near, key=self.weight)
            self.bench.pause()
            if (further := self.bench.continued(here)) is not here:
                del self.known_sets[here], self._evidence[_key(self._named(here))]
                self.add(further)
                continue
            self._expanded.add(here)
            for terms in [*self._more(here), *([t for t in here.terms if t is not gone] for gone in here.terms)]:
                self.add(self.bench.scored(terms, here.fit))

    def _more(self, here: Scored) -> list[list[Term]]:
        """The most probable neighbours of a set by their first step, of different effects."""
        best: dict[str, tuple[float, list[Term]]] = {}
        for terms, one in self._neighbours(here):
            name = terms[-1].name
            if name not in best or one.weight > best[name][0]:
                best[name] = one.weight, terms
        return [terms for _, terms in sorted(best.values(), key=lambda one: -one[0])[:REFITTED]]

    def ask_neighbours(self, here: Scored) -> None:
        """Compares a set with one effect more, to first order, where that was not fitted."""
        for terms, one in self._neighbours(here):
            if _key(terms) not in self._evidence:
                self._note(terms, one)

    def _neighbours(self, here: Scored) -> Iterator[tuple[list[Term], _Set]]:
        """Sets of one effect more, or of two where one needs the other, to first order.

        Beside a discrepancy, on a bench of many poses, only effects that act in proportion are asked.
        """
        mine, widths = self.known_sets[here], self._widths(here)[0]
        others = [t for t in self.known.beside(here.terms) if t.name not in {*mine.names, *here.names}]
        if isinstance(self.bench, CorrelatedBench):
            others = [t for t in others if t.effect.is_linear and t.effect.needs in ("", *mine.names)]
        if not others:
            return
        of_peak = mine.peak.evidence(self.as_fitted(here))
        for screened in self.bench.screened(here, others, self.known.completed):
            fit = self._linearised(screened.linear, self.bench.noise, screened.owners, widths)
            terms = self.known.completed(here.terms, screened.term)
            added = [t for t in terms if t.name not in here.names]
            names, choice = frozenset(t.name for t in added), self._cost([t.name for t in added])
            alone = -np.inf if np.isneginf(mine.alone) else without_error(fit) - mine.cost - choice
            beside = mine.beside + mine.peak.evidence(fit) - of_peak - choice
            yield [*self._named(here), *added], _Set(mine.names | names, mine.cost + choice, alone, beside, mine.peak)

    def by_names(self) -> dict[frozenset[str], tuple[float, float]]:
        """Logarithms of the evidence of sets of effects, over their variants."""
        result: dict[frozenset[str], tuple[float, float]] = {}
        for one in self._evidence.values():
            before = result.get(one.names, (-np.inf, -np.inf))
            result[one.names] = tuple(np.logaddexp(before, (one.alone, one.beside)).tolist())
        return result

    def _note(self, terms: Sequence[Term], new: _Set) -> None:
        """Keeps the larger evidence of each set: the fit nearer to the set's most probable place has it."""
        key, old = _key(terms), self._evidence.get(_key(terms), new)
        self._evidence[key] = replace(new, alone=max(old.alone, new.alone), beside=max(old.beside, new.beside))

    def _named(self, scored: Scored) -> list[Term]:
        """Effects of a fit that the catalogue has."""
        return [t for t in scored.fit.chain.terms if t.name in self.variants]

    def _widths(self, scored: Scored) -> tuple[dict[str, float], tuple[str, ...]]:
        """How much wider than stated each effect's prior is most probably; and the effect of each parameter."""
        chain, named = scored.fit.chain, {*(t.name for t in self._named(scored)), *scored.names}
        over = np.abs(scored.fit.p - chain.neutral) / chain.prior
        places = zip(chain.terms, chain.slices(), strict=True)
        widths = {t.name: float(max(1.0, over[place].max())) for t, place in places if t.name in named}
        return widths, tuple(t.name for t in chain.terms for _ in t.parameters)

    def as_fitted(self, scored: Scored) -> Linearised:
        """A set at its own fit."""
        widths, owners = self._widths(scored)
        return self._linearised(linear(scored.fit), scored.fit.noise, owners, widths)

    def _linearised(
        self, fit: Linear, noise: Noise, owners: Sequence[str], widths: Mapping[str, float], without: str = ""
    ) -> Linearised:
        """Residuals at the priors' centres over the noise alone, as poses count; without an effect's parameters."""
        r, J = fit.r, fit.J
        if noise.discrepancy is not None:
            r, J = noise.discrepancy.coloured(r), noise.discrepancy.coloured(J)
        precision = fit.precision / np.square([widths.get(name, 1.0) for name in owners])
        kept = [k for k, name in enumerate(owners) if name != without]
        centred = self.root * (r + J @ fit.offset)
        return Linearised(centred, (self.root[:, :, None] * J)[:, :, kept], precision[kept])

    def _cost(self, names: Iterable[str], widths: Iterable[float] = ()) -> float:
        """Logarithm of what wider priors and the choice of one variant of each effect cost."""
        choice = sum(np.log(max(self.variants[name], 1)) for name in names)
        return float(choice + sum(np.log(width) for width in widths))


def _key(terms: Iterable[Term]) -> frozenset[str]:
    return frozenset(t.key for t in terms)


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
        axes = np.cross(tangent[:, None], residuals.compared(tangent, bench.data.tangent)[1])
        self.smooth = _smooth(bench.data, axes, ends)
        processes = list(_processes(bench, base, counts))
        self.inputs = [name for name, _ in processes]  # of each process
        self.processes = [modes for _, modes in processes]

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

    def along(self, fit: Linearised) -> dict[str, float]:
        """How probable it is that an unknown error goes along with each input, if it is one of tips or of a stage."""
        smooth = [_over_sizes(error, fit)[0] - np.log(len(self.smooth)) for error in self.smooth]
        gains = self._gains(fit.r.ravel(), fit.J.reshape(fit.r.size, -1), fit.precision) - np.log(len(self.inputs) or 1)
        weights = np.array([*smooth, *(without_error(fit) + gains)])
        names = [*(error.along for error in self.smooth), *self.inputs]
        shares = np.exp(weights - logsumexp(weights))
        return {name: float(shares[[one == name for one in names]].sum()) for name in dict.fromkeys(names)}

    def gain(self, r: Array, J: Array, precision: Array, peak: Peak | None = None) -> float:
        """Logarithm of what a process of unknown stage and size multiplies the evidence by."""
        gains = self._gains(r, J, precision, peak)
        return float(logsumexp(gains) - np.log(len(gains))) if len(gains) else -np.inf

    def _gains(self, r: Array, J: Array, precision: Array, peak: Peak | None = None) -> Array:
        """(M,) the same of each process, averaged over its size."""
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
        return np.array(gains)


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


def _processes(bench: Workbench, base: Scored, counts: Array) -> Iterator[tuple[str, Array]]:
    """The input of every process of drive and mechanics, and its modes (5 K, m) over the noise, with mean square 1."""
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
                    yield ("joints" if name == own else name), B / size


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
