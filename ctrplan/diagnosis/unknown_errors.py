"""What may act besides on some poses that the catalogue lacks: errors of tips, and processes of the stages.

The kinds are those of docs/diagnosis.md, probabilities. An error of tips acts alone, a process of a stage, seen through
the chain's derivatives, does, or both do; kinds and sizes, alike in their logarithm, are integrated out. Errors of tips
on a continuous motion are forgotten with time, exponentially or as a smooth function does. The error of a tangent is a
small rotation whose axes stay where they are: a tangent that turns shows other components of it.

With B (N, m) the process in its leading modes, of the size s over the noise, and J the derivatives by a set's
parameters with the precision P of their priors, s changes the logarithm of the evidence by

    1/2 sum_i (s^2 u_i^2 / (1 + s^2 v_i) - log(1 + s^2 v_i)),

v_i the eigenvalues of B^T S B, u_i the components of B^T S r along their vectors, S = I - J (J^T J + P)^-1 J^T. Turned
to where it is tridiagonal, with an axis along B^T S r, the matrix says the same by its pivots.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ctrplan.base.arrays import Array
from ctrplan.calibration import residuals
from ctrplan.calibration.discrepancy import (
    POSITION,
    SIZES,
    STRIDE,
    TANGENT,
    Block,
    Linearised,
    Numbered,
    Spectrum,
    block_of,
    decay,
    highest_of,
    integral,
    log_means,
    of_configurations,
)
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.linear_fit import process_gains
from ctrplan.diagnosis.remainder import LEAST_MODE, LENGTHS, QUARTERS, input_distances, kernel_modes, square_distances
from ctrplan.diagnosis.term_pieces import HALF_WAVES, TermPiece, pieces, wide_linearisation
from ctrplan.diagnosis.workbench import Scored, Workbench
from ctrplan.effects.effect import CATALOGUE
from ctrplan.effects.learned.inputs import Target
from ctrplan.measurement.approach import clock
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import term

SENSOR = Target("sensor")
AMOUNTS = ("tip_load", "gravity", "sensor_offset", "base_misalignment")  # which something unknown may let vary
SHORTEST = QUARTERS / (np.pi * HALF_WAVES)  # of time, in which what goes with it does what pieces in time do
RECENT = 8  # peaks beside which processes are remembered, a budget of memory (5 MB each): like sets share theirs
JOINT_LENGTHS = (0.3, 0.6, 1.0, 1.5, 2.5)  # [rad]; longer ones are what frames and offsets are
SMOOTH = (0.7, 1.0)  # share of what configurations differ by that goes along with the joints
MEMORIES = 6  # forgotten ones from a step of the poses to half of the motion, smooth ones from four to twice of it

Along = Literal["configuration", "joints", "time"]  # poses with like errors have the same of these, or are near in it


@dataclass(frozen=True, eq=False)
class SmoothError:
    """How the errors of poses go along with each other; numbers of a fit that do so, of position and of tangent."""

    along: Along
    position: tuple[Numbered, ...]
    tangent: tuple[Numbered, ...]

    def spectrum(self, fit: Linearised, modes: int = 0) -> Spectrum:
        """The spectrum of a fit of these poses beside the error, at every size; its last `modes` are of a process."""
        return Spectrum.apart(fit, self.position, self.tangent, modes=modes)

    def at(self, fit: Linearised, position: float, tangent: float) -> Spectrum:
        """The fit beside the error at one size of each, over the noise."""
        return Spectrum.apart(fit, self.position, self.tangent, (np.array([position]), np.array([tangent])))


def at_rest(data: Measurements, share: float, axes: Array) -> list[SmoothError]:
    """Smooth errors of poses at rest, first of configurations that have nothing in common; share: of a
    configuration's approaches.

    axes (K, 2, 3) are those about which rotations are the two numbers of a tangent.
    """
    number, first, which = np.unique(data.configuration, return_index=True, return_inverse=True)
    square, own = square_distances(data, first.tolist()), np.eye(len(number))
    results = [own]
    kernels = [np.exp(-square / (2 * length**2)) for length in JOINT_LENGTHS[1:]]
    results += [(1 - q) * own + q * kernel for q, kernel in product(SMOOTH, kernels)]
    of_poses = [correlation[np.ix_(which.ravel(), which.ravel())] for correlation in results]
    of_poses = [share * correlation + (1 - share) * np.eye(data.count) for correlation in of_poses]
    one_by_one = _error("configuration", data, of_poses[0], axes)
    along_joints = [_error("joints", data, correlation, axes) for correlation in of_poses[1:]]
    slow = _smooth_in_time(clock(data), 0.5)  # what changes still more slowly is a drift
    in_time = [_error("time", data, correlation, axes) for correlation in slow]
    return [one_by_one, *along_joints, *in_time]


def of_motion(data: Measurements, axes: Array) -> list[SmoothError]:
    """Smooth errors of a continuous motion; axes (K, 2, 3) as of poses at rest."""
    return [_error(kind, data, correlation, axes) for kind, correlation in _correlations(data)]


def _error(along: Along, data: Measurements, correlation: Array, axes: Array) -> SmoothError:
    """With a correlation (K, K) of poses."""
    return SmoothError(along, tuple(_of_coordinates(data, correlation)), tuple(_of_rotations(data, correlation, axes)))


def _correlations(data: Measurements) -> Iterator[tuple[Along, Array]]:
    """What goes along, and (K, K) of the poses of a continuous motion."""
    time, together = clock(data), data.run[:, None] == data.run
    step, whole = _spans(time)
    for memory in np.geomspace(step, max(whole / 2, step), MEMORIES):
        yield "time", decay(time, memory) * together
    for correlation in _smooth_in_time(time, 2.0):
        yield "time", correlation * together
    square = square_distances(data, range(data.count))
    for length in JOINT_LENGTHS:
        yield "joints", np.exp(-square / (2 * length**2))


def _smooth_in_time(time: Array, longest: float) -> Iterator[Array]:
    """(K, K) of memories from four steps of the poses to `longest` times the whole."""
    step, whole = _spans(time)
    for memory in np.geomspace(4 * step, max(longest * whole, 4 * step), MEMORIES):
        yield np.exp(-((time[:, None] - time) ** 2) / (2 * memory**2))


def _spans(time: Array) -> tuple[float, float]:
    """The usual step between poses, and from the first to the last."""
    steps = np.diff(np.sort(time))
    return (float(np.median(steps[steps > 0])), float(np.ptp(time))) if steps.any() else (1.0, 1.0)


def _of_coordinates(data: Measurements, correlation: Array) -> Iterator[Numbered]:
    """Every coordinate of a position alike; those that were measured of the same poses at once."""
    given, numbers = data.given[:, POSITION], _numbers(data)[:, POSITION]
    masks, which = np.unique(given, axis=1, return_inverse=True)
    for k, mask in enumerate(masks.T):
        rows = np.flatnonzero(mask)
        if len(rows):
            yield numbers[np.ix_(rows, np.flatnonzero(which.ravel() == k))], _block(correlation[np.ix_(rows, rows)])


def _of_rotations(data: Measurements, correlation: Array, axes: Array) -> Iterator[Numbered]:
    """A rotation with its own axes, seen about those of each tangent."""
    seen: NDArray[np.bool_] = data.given[:, TANGENT]
    pose = np.nonzero(seen)[0]
    if len(pose):
        along = axes[seen]
        yield _numbers(data)[:, TANGENT][seen][:, None], _block((along @ along.T) * correlation[np.ix_(pose, pose)])


def _numbers(data: Measurements) -> NDArray[np.int_]:
    """(K, 5) where the numbers of the poses are in a fit's."""
    return np.arange(5 * data.count).reshape(-1, 5)


def _block(correlation: Array) -> Block:
    return block_of(np.arange(len(correlation)), correlation)


@dataclass(frozen=True, eq=False)
class Peak:
    """A smooth error with its most probable sizes over the noise, and a process of a stage beside it, if any."""

    error: SmoothError
    position: float
    tangent: float
    process: Array | None = None  # (5 K, m) modes, as large as is most probable

    def evidence(self, fit: Linearised) -> float:
        """Logarithm of the evidence beside an error of this kind, of the sizes that are most probable there."""
        return self.beside(fit).highest()[0] / 2

    def here(self, fit: Linearised) -> float:
        """Logarithm of the evidence beside this error as it is."""
        whole = fit if self.process is None else _with_process(fit, self.process)
        return self.error.at(whole, self.position, self.tangent).without_error / 2

    def beside(self, fit: Linearised) -> Spectrum:
        """A fit beside errors of this kind, of every size, and beside the process."""
        if self.process is None:
            return self.error.spectrum(fit)
        return self.error.spectrum(_with_process(fit, self.process), self.process.shape[1])

    def around(self, fit: Linearised) -> Spectrum:
        """The fit beside this error at sizes within a factor of three of its own."""
        p, t = (int(np.abs(SIZES - size).argmin()) for size in (self.position, self.tangent))
        sizes = SIZES[max(p - STRIDE, 0) : p + STRIDE + 1], SIZES[max(t - STRIDE, 0) : t + STRIDE + 1]
        begin = (min(p, STRIDE) if self.error.position else 0, min(t, STRIDE) if self.error.tangent else 0)
        return replace(Spectrum.apart(fit, self.error.position, self.error.tangent, sizes), begin=begin)

    def over_covariance(self, values: Array) -> Array:
        """(5 K, ...) numbers of a fit over the covariance of noise and smooth error."""
        new = np.array(values)
        for numbers, inverse in self._inverses:
            new[numbers] = np.tensordot(inverse, values[numbers], axes=1)
        return new

    @cached_property
    def _inverses(self) -> list[tuple[NDArray[np.int_], Array]]:
        """Numbers of a fit that go together, and the inverse of their covariance."""
        sized = ((self.error.position, self.position), (self.error.tangent, self.tangent))
        return [
            (numbers, (block.vectors / (1 + size**2 * block.values)) @ block.vectors.T)
            for numbered, size in sized
            if size
            for numbers, block in numbered
        ]


def _with_process(fit: Linearised, modes: Array) -> Linearised:
    """A fit with a process (5 K, m) among its parameters: integrated out, it is in the covariance."""
    J = np.concatenate([fit.J, modes.reshape(*fit.r.shape, -1)], axis=2)
    return Linearised(fit.r, J, np.concatenate([fit.precision, np.ones(modes.shape[1])]))


def without_error(fit: Linearised) -> float:
    """Logarithm of the evidence beside noise alone."""
    own = _with_unit_priors(fit)
    return float(_marginal(own.T @ own))


class UnknownErrors:
    """What may act besides on some poses."""

    def __init__(
        self,
        bench: Workbench,
        base: Scored,
        chosen: Scored,
        ends: Sequence[Linearised],
        counts: Array,
        with_stages: bool = True,
    ) -> None:
        """ends: the two sets, linearised; counts (K,): roots of what poses count; with_stages: or tips alone err."""
        tangent = chosen.fit.chain.predict(chosen.fit.p, derivatives=False).tangent
        axes = np.cross(tangent[:, None], residuals.compared(tangent, bench.data.tangent)[1])
        self.smooth = _smooth(bench.data, axes, ends)
        processes = list(_processes(bench, base, counts)) if with_stages else []
        self.inputs = [name for name, _ in processes]  # of each process
        ends = np.cumsum([0, *(modes.shape[1] for _, modes in processes)]).tolist()
        self._places = [slice(a, b) for a, b in pairwise(ends)]
        self._modes = np.concatenate([np.zeros((5 * bench.data.count, 0)), *(modes for _, modes in processes)], axis=1)
        self._known: dict[object, list[Array]] = {}  # squares of processes, by peak

    def spectra(self, fit: Linearised) -> list[Spectrum]:
        """A fit beside every smooth error, of every size; whoever asks for some of its parameters shares their sums."""
        return [error.spectrum(fit) for error in self.smooth]

    def evidence(self, fit: Linearised, spectra: Sequence[Spectrum] | None = None) -> tuple[float, Peak]:
        """Logarithm of the evidence averaged over kinds and sizes of errors, and the most probable one.

        An error of tips, one of a stage, and both are as probable a priori. Both are sought from either side: the
        process beside the most probable smooth error, and the smooth error beside the most probable process.
        """
        spectra = self.spectra(fit) if spectra is None else spectra
        smooth, peak, _ = self._of_tips(spectra)
        if not self._places:
            return smooth, peak
        gains = self._gains(fit)
        alone = without_error(fit) + float(_averaged(gains.ravel(), axis=0))
        beside = self._gains(fit, peak)
        both = smooth + float(_averaged(beside.ravel(), axis=0))
        k, s = np.unravel_index(int(gains.argmax()), gains.shape)
        other, there = self._beside(_leading(SIZES[s] * self.processes[k]), fit, spectra)
        other += float(_averaged(gains.ravel(), axis=0)) - float(gains.max())
        peaks = [(smooth, peak), (both, peak), (other, there)]
        best = max(peaks, key=lambda pair: pair[0])[1]
        return float(logsumexp([smooth, alone, max(both, other)]) - np.log(3)), best

    def _of_tips(self, spectra: Sequence[Spectrum]) -> tuple[float, Peak, float]:
        """Logarithm of the evidence averaged over smooth errors, and the most probable one with the logarithm of its
        own, at its peak.
        """
        values, peak, own = _over_kinds(self.smooth, spectra)
        return float(_averaged(values, axis=0)), peak, own

    def _beside(self, modes: Array, fit: Linearised, spectra: Sequence[Spectrum]) -> tuple[float, Peak]:
        """Log evidence and peak beside a process (5 K, m), for the likeliest kind of error in what its mean leaves."""
        wide = _with_process(fit, modes)
        J = wide.J.reshape(fit.r.size, -1)
        mean = np.linalg.solve(J.T @ J + np.diag(wide.precision), J.T @ fit.r.ravel())[len(fit.precision) :]
        r = (fit.r.ravel() - modes @ mean).reshape(fit.r.shape)
        of_errors = zip(self.smooth, spectra, strict=True)
        rest = [spectrum.of_residuals(r, error.position, error.tangent) for error, spectrum in of_errors]
        averaged, near, own = self._of_tips(rest)
        highest, position, tangent = near.around(wide).highest()
        return highest / 2 + averaged - own, Peak(near.error, position, tangent, modes)

    def along(self, fit: Linearised) -> dict[str, float]:
        """How probable it is that an unknown error goes along with each input, if it is one of tips or of a stage."""
        smooth = _over_kinds(self.smooth, self.spectra(fit))[0] - np.log(len(self.smooth))
        of_size = self._gains(fit)
        gains = _averaged(of_size, axis=1) - np.log(len(self.inputs) or 1) if len(of_size) else np.zeros(0)
        weights = np.array([*smooth, *(without_error(fit) + gains)])
        names = [*(error.along for error in self.smooth), *self.inputs]
        shares = np.exp(weights - logsumexp(weights))
        return {name: float(shares[[other == name for other in names]].sum()) for name in dict.fromkeys(names)}

    def _gains(self, fit: Linearised, peak: Peak | None = None) -> Array:
        """(M, S) logarithm of what each process, of each size, multiplies the evidence by; beside a smooth error."""
        from scipy.linalg import solve_triangular  # slow to import

        own = _with_unit_priors(fit)
        over = own if peak is None else peak.over_covariance(own)
        whole = own.T @ over
        H, g = whole[:-1, :-1], whole[:-1, -1]
        factor = np.linalg.cholesky(H + _least(H) * np.eye(len(H)))
        of_all = self._modes.T @ over
        taken = solve_triangular(factor, of_all[:, :-1].T, lower=True, check_finite=False)
        along = of_all[:, -1] - taken.T @ solve_triangular(factor, g, lower=True, check_finite=False)
        left = zip(self._places, self._squares(peak), strict=True)
        return process_gains([(square - taken[:, own].T @ taken[:, own], along[own]) for own, square in left], SIZES)

    @property
    def processes(self) -> list[Array]:
        """(5 K, m) modes of each process."""
        return [self._modes[:, own] for own in self._places]

    def _squares(self, peak: Peak | None) -> list[Array]:
        """(m, m) of every process over the noise and the smooth error of a peak."""
        key = None if peak is None else (peak.error, peak.position, peak.tangent)
        if key not in self._known:
            if len(self._known) >= RECENT:
                del self._known[next(iter(self._known))]  # the oldest
            self._known[key] = [B.T @ (B if peak is None else peak.over_covariance(B)) for B in self.processes]
        return self._known[key]


def _with_unit_priors(fit: Linearised) -> Array:
    """(5 K, P + 1) derivatives by parameters over the widths of their priors, then residuals."""
    return np.column_stack([fit.J.reshape(fit.r.size, -1) / np.sqrt(fit.precision), fit.r.ravel()])


def _marginal(square: Array) -> Array:
    """(...) logarithm of the evidence by the squares (..., P + 1, P + 1) of what `_with_unit_priors` has."""
    H, g, of_r = square[..., :-1, :-1], square[..., :-1, -1], square[..., -1, -1]
    logarithm: Array = (integral(H, g, _least(H)) - of_r) / 2
    return logarithm


def _least(H: Array) -> Array:
    """(...) what the priors add to squares (..., P, P), and rounding of the largest of them may not take."""
    least: Array = 1 + 4 * np.finfo(np.float64).eps * np.trace(H, axis1=-2, axis2=-1)
    return least


def _averaged(logarithms: Array, axis: int) -> Array:
    """Logarithms of means."""
    means: Array = logsumexp(logarithms, axis=axis) - np.log(logarithms.shape[axis])
    return means


def _leading(modes: Array) -> Array:
    """(5 K, m) the modes of a process, apart from each other, that are more than a part of the noise."""
    leading: Array = modes[:, (modes**2).sum(axis=0) > LEAST_MODE]
    return leading


def _over_kinds(errors: Sequence[SmoothError], spectra: Sequence[Spectrum]) -> tuple[Array, Peak, float]:
    """(E,) logarithms of the evidence of kinds of errors, each averaged over sizes, as if those of position and tangent
    were apart; the peak of the most probable kind, and the logarithm of the evidence there.

    No average is above its peak: kinds whose peaks are lost to rounding beside the others get no evidence.
    """
    peaks, values = highest_of(spectra), np.full(len(errors), -np.inf)
    order = sorted(range(len(errors)), key=lambda k: -peaks[k][0])
    of_best = log_means([spectra[order[0]]], [peaks[order[0]]])[0]
    there = [k for k in order if peaks[k][0] >= of_best + 2 * np.log(np.finfo(np.float64).eps)]
    values[there] = np.array(log_means([spectra[k] for k in there], [peaks[k] for k in there])) / 2
    best = int(values.argmax())
    return values, Peak(errors[best], *peaks[best][1:]), peaks[best][0] / 2


def _smooth(data: Measurements, axes: Array, ends: Sequence[Linearised]) -> list[SmoothError]:
    """Errors of tips, of poses at rest with as much in common of a configuration's approaches as either set says.

    A set that leaves none says nothing of that. axes (K, 2, 3) are those about which rotations are the two numbers of a
    tangent.
    """
    if data.is_stream:
        return of_motion(data, axes)
    said = [of_configurations(fit, data.configuration) for fit in ends]
    shares = sorted({rest.memory for rest in said if rest.is_there} or {said[0].memory})
    first, *others = (at_rest(data, share, axes) for share in shares)
    return first + [error for more in others for error in more if error.along != "time"]


def _processes(bench: Workbench, base: Scored, counts: Array) -> Iterator[tuple[str, Array]]:
    """The input of every process of a stage, and its modes (5 K, m) over the noise, with mean square 1."""
    data = bench.data
    targets = {piece.on: None for piece in pieces(bench.robot, data) if piece.on.kind_name != "sensor"} | {SENSOR: None}
    constants = {on: TermPiece(on, ("constant",)) for on in targets if not on.of_way}
    plain = CorrelatedBench(bench.robot, data, replace(base.fit.noise, discrepancy=None), bench.group)
    table = wide_linearisation(plain, base, list(constants.values()))
    lengths = {"time": LENGTHS if data.is_stream else (*LENGTHS, SHORTEST)}  # where pieces in time are
    modes = [
        (name if name in ("history", "time") else "joints", kernel_modes(square / length**2))
        for name, square in input_distances(data)
        if square.any()
        for length in lengths.get(name, LENGTHS)
    ]
    seen = {on: table.whole.J[:, :, table.places[piece]] * counts[:, None, None] for on, piece in constants.items()}
    at_sensor = seen.pop(SENSOR)
    pushed = [at_sensor * later[:, None, None] for later in _since_each_configuration(data)]
    yield from (("time", _modes_of_one_size(B)) for B in pushed if B.any())
    rotations = [D for on, D in seen.items() if on.kind_name == "theta"]
    parts = [*seen.values(), *_amounts(plain, base, counts)]
    if len(rotations) > 1:
        parts.append(np.concatenate(rotations, axis=2))  # a cause that all of them share
    for D, (name, phi) in product(parts, modes):
        B = D[..., None] * phi[:, None, None]
        if B.any():
            yield name, _modes_of_one_size(B)


def _amounts(bench: CorrelatedBench, base: Scored, counts: Array) -> Iterator[Array]:
    """(K, 5, P) by the amounts of effects that are neither a tube's nor a joint's, over the widths of their priors."""
    effects = [CATALOGUE[name] for name in AMOUNTS if name not in bench.robot.effects]
    terms = [term(effect, [q.name for q in effect.parameters(bench.robot)], bench.robot) for effect in effects]
    panel = bench.panel(base, terms)
    for places in map(panel.places, ([t] for t in terms)):
        yield panel.whole.J[:, :, places] / np.sqrt(panel.whole.precision[places]) * counts[:, None, None]


def _modes_of_one_size(B: Array) -> Array:
    """(5 K, m) of modes (K, 5, ...), with mean square 1, turned to where they are apart from each other."""
    flat = B.reshape(B.shape[0] * B.shape[1], -1)
    values, vectors = np.linalg.eigh(flat.T @ flat)
    kept = values > LEAST_MODE * values[-1]
    modes: Array = flat @ vectors[:, kept] / np.sqrt(values[kept].sum() / len(flat))
    return modes


def _since_each_configuration(data: Measurements) -> list[NDArray[np.bool_]]:
    """(K,) poses from the first of each configuration but the first on, where poses are at rest."""
    number, first = np.unique(data.configuration, return_index=True)
    later = [] if data.is_stream else sorted(first.tolist())[1:]
    return [np.arange(data.count) >= pose for pose in later]
