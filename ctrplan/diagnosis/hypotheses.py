"""Sets of effects as hypotheses: their priors, their fits, and the evidence of each.

A hypothesis is ordinary calibration and a set of effects, beside all that nobody has named. Parameters are found by
full steps of generalised least squares from the priors' centres, each under the covariance of its own residuals; the
loss may rise in between. Effects that do not act in proportion start from each of their own suggestions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.fit_warnings import PHYSICAL_POISSON, too_many
from ctrplan.calibration.least_squares import Fit, fit
from ctrplan.calibration.parameters import ABSOLUTE_STIFFNESS, BaseParameters
from ctrplan.calibration.residuals import Noise, differences
from ctrplan.diagnosis.mixed_model import MixedModel, Posterior, Sizes
from ctrplan.diagnosis.processes import Processes, friction_states, processes, smooth_axes
from ctrplan.effects.effect import CATALOGUE, DEGREE, MILLIMETRE, Effect, Parameter, Values, sliding, turning
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import followed, friction_correction
from ctrplan.pipeline.parametric_chain import DRIVEN_ALREADY, ParametricChain
from ctrplan.pipeline.term import SensorPrediction, Term, term
from ctrplan.robot.robot import Robot

PRIOR_OF_EFFECT = 0.03  # probability of each effect before any data: about one of thirty acts on a robot
UNSOLVED = 4.0  # deviations that each number of a pose without a solution counts as
ROUNDS, FREE_ROUNDS = 10, 4  # of generalised least squares, of which the first may lead away from the best place
LONGEST_STEP = 2.5  # of a parameter in a round, in deviations of its prior
CONVERGED = 0.2  # log-units that another round promises
OUTLYING = 20.0  # times the noise that a pose may be off that went wrong
PRIOR_OF_OUTLIER = 0.01  # probability that a pose went wrong
MOST_WIDENINGS = 3  # of priors of effects that are larger than they
FIRST_FRICTION = 0.2  # with which histories of a continuous motion are simulated

Key = tuple[str, str]  # effect, parameter


class Slip(Effect):
    """A collar that slips once: a joint is off by a constant from some pose on. It is of a run, not of a robot."""

    name, stage, in_words = "slip", "drive", "slip of a collar"
    equation = "joint = commanded + offset from one pose on"
    signature = "a step between two poses, the same afterwards"
    look_alikes = ("homing_shift",)
    experiment = "repeat the first configurations: a collar that slipped stays where it is"

    def __init__(self, rows: Sequence[int]) -> None:
        """rows: waypoints from which on a joint may be off."""
        self.rows = tuple(rows)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Of every joint and instant; rows count from 1, as in the file."""
        turns = [
            Parameter(f"theta_{i}_from_row_{k + 1}_deg", 8.0, si=DEGREE)
            for i in range(1, robot.n + 1)
            for k in self.rows
        ]
        slides = [
            Parameter(f"l_{i}_from_row_{k + 1}_mm", 2.0, si=MILLIMETRE)
            for i in range(1, robot.n + 1)
            for k in self.rows
        ]
        return (*turns, *slides)

    def variants(self, robot: Robot, data: Measurements) -> list[list[str]]:
        """One for each joint that moves and instant."""
        turns = [[f"theta_{i}_from_row_{k + 1}_deg"] for i in turning(data) for k in self.rows]
        return turns + [[f"l_{i}_from_row_{k + 1}_mm"] for i in sliding(data) for k in self.rows]

    def zeros(self, values: Values, data: Measurements) -> Array:
        """(K, 2 n) off from the instant on."""
        result = np.zeros((data.count, 2 * data.n))
        for name, value in values.items():
            kind, tube, row = slipped(name)
            result[data.rows >= row, tube - 1 + (data.n if kind == "l" else 0)] += value
        return result


def slipped(name: str) -> tuple[str, int, int]:
    """Kind of joint, tube (from 1) and waypoint (from 0) of a slip's parameter."""
    kind, tube, _, _, row, _ = name.split("_")
    return kind, int(tube), int(row) - 1


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of effects fitted beside ordinary calibration and unnamed errors."""

    terms: tuple[Term, ...]  # without calibration
    chain: ParametricChain
    p: Array  # (P,) SI
    covariance: Array  # (P, P)
    evidence: float  # log density of the data, all parameters integrated out
    prior: float  # log odds of the set before any data
    sizes: Sizes
    parts: tuple[str, ...]  # whose sizes these are

    @property
    def named_sizes(self) -> dict[str, float]:
        """Variance over the noise's of each part that nobody has named."""
        return dict(zip(self.parts, self.sizes.vector[:-2].tolist(), strict=True))

    @property
    def score(self) -> float:
        """Log posterior, up to a constant."""
        return self.evidence + self.prior

    @property
    def names(self) -> frozenset[str]:
        """Of the effects."""
        return frozenset(t.name for t in self.terms)

    @property
    def key(self) -> frozenset[str]:
        """Tells sets apart."""
        return frozenset(t.key for t in self.terms)

    @property
    def values(self) -> dict[Key, float]:
        """Every parameter, SI."""
        keys = [(t.name, q.name) for t in self.chain.terms for q in t.parameters]
        return dict(zip(keys, self.p.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class Bench:
    """All that is the same for every hypothesis about some poses; asking it changes nothing but what it remembers."""

    robot: Robot
    data: Measurements
    noise: Noise
    variants: tuple[Term, ...]
    axes: Array  # (K, 2, 2) of tangents
    sound: NDArray[np.bool_]  # (K,) poses that are asked about
    phi: Array | None  # (K, n - 1) friction states of a simulated history
    unnamed: Processes
    robust: Fit  # calibration without anything else
    corrections: dict[str, tuple[Array, Array] | None] = field(default_factory=dict)

    @property
    def model(self) -> MixedModel:
        """What nobody has named."""
        return self.unnamed.model

    def base(self, terms: Sequence[Term]) -> Term:
        """Ordinary calibration; the stiffness of tube 1 only where something else than stiffness carries forces."""
        return base_term(self.robot, terms)

    def chain(self, terms: Sequence[Term], base: Term | None = None) -> ParametricChain:
        """Calibration, ordinary if nothing else is given, and effects along these poses."""
        chain = ParametricChain(self.robot, self.data, [self.base(terms) if base is None else base, *terms])
        if self.rubs(terms):
            chain.followed_phi = self.phi
            chain.correction = self.corrections.get("rest")
        return chain

    def without(self, out: NDArray[np.bool_]) -> Bench:
        """The same without some poses (K,)."""
        return bench(self.robot, self.data, self.noise, self.variants, left_out=out) if out.any() else self

    def rubs(self, terms: Sequence[Term]) -> bool:
        """Whether friction acts."""
        return bool(self.robot.friction.any()) or any(t.name == "friction" for t in terms)

    def linearised(self, chain: ParametricChain, p: Array) -> tuple[Array, Array]:
        """Residuals (K, 5) over the noise, tangents in smooth axes, and their derivatives (K, 5, P)."""
        prediction = chain.predict(p)
        r, J = differences(self.data, prediction, self.noise)
        unsolved = self.sound & ~prediction.sound
        r, J = np.nan_to_num(r), np.nan_to_num(J)
        r[unsolved], J[unsolved] = UNSOLVED * self.data.given[unsolved], 0.0
        return turned(r, self.axes), turned(J, self.axes)

    def log_prior(self, terms: Sequence[Term]) -> float:
        """Log odds of a set, an effect's share divided among its variants; built terms are charged where they are."""
        count = Counter(t.name for t in self.variants)
        odds = np.log(PRIOR_OF_EFFECT / (1 - PRIOR_OF_EFFECT))
        return float(sum(odds - np.log(count[t.name]) for t in terms if count[t.name]))

    def fitted(
        self,
        terms: Sequence[Term],
        near: Mapping[Key, float],
        sizes: Sizes,
        steps: tuple[int, int] = (6, 2),
        base: Term | None = None,
    ) -> Hypothesis:
        """The set of effects, from values `near` where it has them, else from the priors' centres.

        steps: of Newton's method for the sizes, in the first round and in later ones; base: calibration that is known
        otherwise.
        """
        chain = self.chain(terms, base)
        p = np.clip(started(chain, near), chain.lower, chain.upper)
        best: tuple[float, Array, Posterior, Array] | None = None  # with the step from there
        shorter = 1.0
        for number in range(ROUNDS + 1):
            try:
                r, J = self.linearised(chain, p)
            except InputError:  # no robot has these values
                p = 0.5 * (p + (chain.neutral if best is None else best[1]))
                continue
            here = (p - chain.neutral) / chain.prior
            scaled = J * chain.prior
            result = self.model.posterior(r + scaled @ here, scaled, sizes, steps[min(number, 1)])
            value = result.at(here)
            step = np.clip(result.parameters - here, -LONGEST_STEP, LONGEST_STEP)
            if best is None or value > best[0] or number < FREE_ROUNDS:
                shorter, sizes = 1.0, result.sizes
            else:  # it leads away: less far from the best place
                shorter *= 0.4
            if best is None or value > best[0]:
                best = value, p, result, step
            if number and (result.evidence - value < CONVERGED or shorter < 0.1):
                break
            if self.rubs(terms) and number == 1 and not self.data.is_stream and "rest" not in self.corrections:
                self.corrections["rest"] = friction_correction(chain, p)
                chain.correction, best = self.corrections["rest"], None
            if shorter < 1.0 and best is not None:
                p = best[1] + shorter * chain.prior * best[3]
            else:
                p = p + chain.prior * step
            p = np.clip(p, chain.lower, chain.upper)
        if best is None:
            raise InputError("has values that no robot has", key=" and ".join(t.name for t in terms))
        value, p, result, _ = best
        inverse = np.linalg.inv(result.precision)
        covariance: Array = np.asarray(inverse * np.outer(chain.prior, chain.prior), dtype=np.float64)
        return Hypothesis(
            tuple(terms), chain, p, covariance, value, self.log_prior(terms), result.sizes, self.model.names
        )

    def sized(self, h: Hypothesis) -> Hypothesis:
        """The same effects with priors as wide as their estimates are large, and the evidence that it had.

        Priors say where to look. The size of an effect that is there is for the data to say: a prior that it exceeds
        would draw it in and make its interval too narrow.
        """
        for _ in range(MOST_WIDENINGS):
            places = dict(zip([t.key for t in h.chain.terms], h.chain.slices(), strict=True))
            terms = [_widened(t, h.p[places[t.key]]) for t in h.terms]
            if all(a is b for a, b in zip(terms, h.terms, strict=True)):
                break
            h = replace(self.fitted(terms, h.values, h.sizes), evidence=h.evidence)
        return h


def _widened(t: Term, p: Array) -> Term:
    """Priors in proportion to the largest parameter, where that exceeds its own by a tenth."""
    largest = max(abs(v / q.si - q.neutral) / q.prior for q, v in zip(t.parameters, p.tolist(), strict=True))
    if largest < 1.1:
        return t
    return Term(t.effect, tuple(replace(q, prior=q.prior * largest) for q in t.parameters))


def turned(values: Array, axes: Array) -> Array:
    """(K, 5, ...) with the tangent's numbers in other axes (K, 2, 2)."""
    result = values.copy()
    result[:, 3:] = np.einsum("kab,kb...->ka...", axes, values[:, 3:])
    return result


def started(chain: ParametricChain, near: Mapping[Key, float]) -> Array:
    """(P,) known values, and the starts of all others."""
    keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
    return np.array([near.get(key, start) for key, start in zip(keys, chain.start.tolist(), strict=True)])


def base_term(robot: Robot, terms: Sequence[Term]) -> Term:
    """Ordinary calibration with physical Poisson's ratios."""
    effect, loaded = BaseParameters(), any(t.effect.scales_with_stiffness for t in terms)
    names = [q.name for q in effect.parameters(robot) if loaded or q.name != ABSOLUTE_STIFFNESS]
    low, high = PHYSICAL_POISSON
    made = term(effect, names, robot)
    bounded = [
        replace(q, lower=min(low, q.neutral), upper=max(high, q.neutral)) if q.name.startswith("poisson") else q
        for q in made.parameters
    ]
    return Term(effect, tuple(bounded))


def bench(
    robot: Robot,
    data: Measurements,
    noise: Noise,
    variants: Sequence[Term],
    *,
    left_out: NDArray[np.bool_] | None = None,
) -> Bench:
    """For these poses, without those that went wrong, `left_out` (K,)."""
    out = np.zeros(data.count, bool) if left_out is None else left_out
    chain = ParametricChain(robot, data, [base_term(robot, [])])
    robust = _robust_fit(chain, noise, ~out)
    p = robust.p
    prediction = chain.predict(p, derivatives=False)
    axes, sound = smooth_axes(prediction, data), prediction.sound & ~out
    phi = _simulated(robot, data, p)
    asked = replace(data, is_stream=data.is_stream)  # what is remembered of columns goes with the object

    def linearised(probes: Sequence[Term]) -> tuple[SensorPrediction, Array]:
        probing = ParametricChain(robot, asked, [*chain.terms, *probes])
        there = probing.predict(np.concatenate([p, probing.neutral[len(p) :]]))
        J = differences(data, there, noise)[1][:, :, len(p) :]
        return there, turned(np.where(there.sound[:, None, None], np.nan_to_num(J), 0.0), axes)

    def arc(pieces: Robot, probe: Term) -> Array:
        cut = ParametricChain(pieces, replace(data), [probe])
        there = cut.predict(cut.neutral)
        J = differences(data, there, noise)[1]
        return turned(np.where(there.sound[:, None, None], np.nan_to_num(J), 0.0), axes)

    states = friction_states(data, phi)
    unnamed = processes(robot, data, noise, sound, states, linearised, arc)
    seen = None if phi is None else states
    return Bench(robot, data, noise, tuple(variants), axes, sound, seen, unnamed, robust)


def _simulated(robot: Robot, data: Measurements, p: Array) -> Array | None:
    """(K, n - 1) friction states of a continuous motion with usual friction."""
    if not data.is_stream or robot.n < 2:
        return None
    friction = CATALOGUE["friction"]
    rubbing = term(friction, [q.name for q in friction.parameters(robot)], robot)
    chain = ParametricChain(robot, data, [base_term(robot, []), rubbing])
    path = followed(chain, np.concatenate([p, np.full(len(rubbing.parameters), FIRST_FRICTION)]))
    return np.asarray(path.phi)


def _robust_fit(chain: ParametricChain, noise: Noise, asked: NDArray[np.bool_]) -> Fit:
    """Ordinary calibration by Huber's loss: where processes and slopes are asked."""
    kept = np.flatnonzero(asked)
    data = chain.data.subset(kept)
    some = ParametricChain(chain.robot, data, chain.terms)
    return fit(some, noise, np.arange(data.count))


def outliers(whole: Bench, some: Bench, best: Hypothesis, suspected: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(K,) poses that probably went wrong, of all poses, by a hypothesis that was fitted to those not `suspected`.

    Pose by pose a mixture of the model, with the sizes of the hypothesis, and of one as wide as OUTLYING.
    """
    wrong = np.where(suspected, _odds(whole, best) > 0, _odds(some, best) > 0)
    return suspected if too_many(wrong, whole.sound) else wrong


def _odds(whole: Bench, best: Hypothesis) -> Array:
    """(K,) logarithm of the odds that each pose went wrong."""
    model = whole.model
    sizes = model.named(best.named_sizes, best.sizes.noise)
    chain = whole.chain(best.terms)
    r, J = whole.linearised(chain, best.p)
    scaled = J * chain.prior
    off = model.standardised(r + scaled @ ((best.p - chain.neutral) / chain.prior), scaled, sizes)
    count = model.given.sum(axis=1)
    square = (off**2).sum(axis=1) * (1 - OUTLYING**-2)
    odds = 0.5 * square - count * np.log(OUTLYING) + np.log(PRIOR_OF_OUTLIER / (1 - PRIOR_OF_OUTLIER))
    return np.where(count > 0, odds, -np.inf)


def slips(robot: Robot, data: Measurements, most: int) -> list[Term]:
    """Slips of every joint that moves between configurations, at most so many instants; none of continuous motions."""
    if data.is_stream or data.of_collars:
        return []
    first = np.unique(data.configuration, return_index=True)[1]
    rows = data.rows[np.sort(first)][1:]
    kept = (
        rows[np.unique(np.linspace(0, len(rows) - 1, min(len(rows), most)).round().astype(int))] if len(rows) else rows
    )
    effect = Slip(sorted(set(kept.tolist())))
    return [term(effect, names, robot) for names in effect.variants(robot, data)]


@dataclass(frozen=True, eq=False)
class Candidates:
    """Variants of every testable effect, and the reasons why the rest is not testable."""

    terms: tuple[Term, ...]
    not_testable: Mapping[str, str]


def reduced(catalogue: Mapping[str, Effect], without: Sequence[str], *, key: str = "without") -> dict[str, Effect]:
    """The catalogue without some of its effects. Raises InputError, about `key`, for a name that it does not have."""
    for name in without:
        if name not in catalogue:
            raise InputError(f"must be an effect of the catalogue: {', '.join(catalogue)}", key=key, value=name)
    return {name: effect for name, effect in catalogue.items() if name not in without}


def candidates(robot: Robot, data: Measurements, catalogue: Mapping[str, Effect] = CATALOGUE) -> Candidates:
    """Everything in the catalogue, sorted into testable and not."""
    terms: list[Term] = []
    reasons: dict[str, str] = {}
    for name, effect in catalogue.items():
        driven = data.of_collars and effect.stage == "drive"
        if reason := DRIVEN_ALREADY if driven else effect.untestable(robot, data):
            reasons[name] = reason
        elif name in robot.effects:
            reasons[name] = "is in the robot file already"
        else:
            terms += [term(effect, names, robot) for names in effect.variants(robot, data) if names]
    return Candidates(tuple(terms), reasons)
