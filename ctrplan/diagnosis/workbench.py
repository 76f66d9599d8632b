"""Fits of the base with sets of effects, their linearisations, and the effects that the data can test."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.calibration.parameters import ABSOLUTE_STIFFNESS, BaseParameters
from ctrplan.calibration.residuals import UNSOUND, Noise, residuals, robust_square
from ctrplan.diagnosis.linear_fit import Linear, widths_of
from ctrplan.effects.effect import CATALOGUE, Effect, Values
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import DRIVEN_ALREADY, ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Candidates:
    """Variants of every testable effect, and the reasons why the rest is not testable."""

    terms: tuple[Term, ...]
    not_testable: Mapping[str, str]
    variants: Mapping[str, int]  # of each effect, of which one acts

    def beside(self, chosen: Sequence[Term]) -> list[Term]:
        """Variants that are not chosen yet and can act: what they need is chosen or can be chosen with them."""
        keys, known = {t.key for t in chosen}, {t.name for t in self.terms} | {t.name for t in chosen}
        return [t for t in self.terms if t.key not in keys and (not t.effect.needs or t.effect.needs in known)]

    def completed(self, chosen: Sequence[Term], added: Term) -> list[Term]:
        """The chosen terms, what the added one needs, and it."""
        missing = added.effect.needs not in ("", *(t.name for t in chosen))
        needed = [t for t in self.terms if missing and t.name == added.effect.needs]
        return [*chosen, *needed, added]


def reduced(catalogue: Mapping[str, Effect], without: Sequence[str], *, key: str = "without") -> dict[str, Effect]:
    """The catalogue without some of its effects. Raises InputError, about `key`, for a name that it does not have."""
    for name in without:
        if name not in catalogue:
            raise InputError(f"must be an effect of the catalogue: {', '.join(catalogue)}", key=key, value=name)
    return {name: effect for name, effect in catalogue.items() if name not in without}


def candidates(
    robot: Robot,
    data: Measurements,
    catalogue: Mapping[str, Effect] = CATALOGUE,
    more: Mapping[str, int] | None = None,
) -> Candidates:
    """Everything in the catalogue, sorted into testable and not; more: effects of whose variants the data have one."""
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
    return Candidates(tuple(terms), reasons, {**Counter(t.name for t in terms), **(more or {})})


WORTH_ANOTHER = 2.0  # of the loss, to fit a set again from another place
CORRECTIONS = {False: 1, True: 2}  # rounds, of poses at rest and of a continuous motion


@dataclass(frozen=True, eq=False)
class Scored:
    """A set of effects and its fit together with the base."""

    terms: tuple[Term, ...]  # without the base
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return tuple(t.name for t in self.terms)

    @cached_property
    def failed(self) -> NDArray[np.bool_]:
        """(K,) poses for which the solver found no equilibrium, so that the fit says nothing about them."""
        unsound: NDArray[np.bool_] = np.isclose(self.fit.residuals.raw_norm, UNSOUND)
        return self.fit.chain.predict(self.fit.p, derivatives=False).failed if unsound.any() else unsound


@dataclass(frozen=True, eq=False)
class Linearisation:
    """A linearisation in the parameters of many effects, (effect, parameter), of which any set can be asked."""

    keys: tuple[tuple[str, str], ...]
    whole: Linear

    def places(self, terms: Sequence[Term]) -> list[int]:
        """Where the parameters of some terms are; the others stay where they are."""
        wanted = {(t.name, q.name) for t in terms for q in t.parameters}
        return [k for k, key in enumerate(self.keys) if key in wanted]


@dataclass(frozen=True, eq=False)
class Screened:
    """A variant beside a fit, linearised there."""

    term: Term
    linear: Linear  # of the columns of base, fit and variant
    owners: tuple[str, ...]  # (P,) the effect of each column
    panel: Linearisation | None = None  # of all variants that act in proportion, if it is among them
    places: Sequence[int] = ()  # (P,) of the columns there


@dataclass(frozen=True)
class SelectionStep:
    """One step of the path: how much more probable (logarithm) the poses are with it."""

    action: str  # "compare", "build"
    effect: str
    parameters: tuple[str, ...]
    gain: float
    taken: bool


Bench = TypeVar("Bench", bound="Workbench")


class Workbench:
    """Everything that stays the same while sets of effects are compared. What it remembers are its own answers."""

    def __init__(self, robot: Robot, data: Measurements, noise: Noise, group: NDArray[np.int_]) -> None:
        """group (K,): poses that are left out together."""
        self.robot, self.data, self.noise, self.group = robot, data, noise, group
        self.pause: Callable[[], None] = lambda: None  # called between fits; may raise to stop
        self._correction: tuple[Array, Array] | None = None
        self._done: dict[frozenset[str], Scored] = {}
        self._before: dict[frozenset[str], Fit] = {}  # beside other friction states and discrepancies
        self._tried: dict[frozenset[str], list[Fit | None]] = {}  # where fits of a set began
        self._sized: dict[Scored, Scored] = {}  # with wide priors
        self._screened: dict[tuple[Scored, frozenset[str]], list[Screened]] = {}

    @property
    def visited(self) -> tuple[Scored, ...]:
        """Sets that were fitted, as far as they still count."""
        return tuple(self._done.values())

    @cached_property
    def whitening_group(self) -> NDArray[np.int_]:
        """(K,) poses that share the model's own numerical error."""
        return np.arange(self.data.count) if self.data.is_stream else self.data.configuration

    def base(self, terms: Sequence[Term]) -> Term:
        """Ordinary calibration; the stiffness of tube 1 only where something else than stiffness carries forces."""
        effect, loaded = BaseParameters(), any(t.effect.scales_with_stiffness for t in terms)
        names = [parameter.name for parameter in effect.parameters(self.robot)]
        return term(effect, [name for name in names if loaded or name != ABSOLUTE_STIFFNESS], self.robot)

    def basis(self, terms: Sequence[Term]) -> list[Term]:
        """What is fitted besides `terms`, whatever they are."""
        return [self.base(terms)]

    def scored(self, terms: Sequence[Term], *near: Fit | None) -> Scored:
        """The base and `terms` fitted together, from the values of a fit in `near` where it has them.

        None in `near` stands for where a fit starts without any. A set that is known already is fitted again from a
        place that promises more: the first fit may have ended in another valley, or where robots snap. One that another
        bench had fitted may start there as well.
        """
        key = frozenset(t.key for t in terms)
        tried = self._tried.setdefault(key, [])
        known = self._done.get(key)
        earlier = [] if known else [f for f in [self._before.get(key)] if f]
        places = [f for f in dict.fromkeys([*earlier, *(near or (None,))]) if not any(f is other for other in tried)]
        if known is None or places:
            self.pause()
            tried += places
            chain = self.chain([*self.basis(terms), *terms])
            start, promised = self._start(chain, places, compared=known is not None)
            if known is None or promised < known.fit.residuals.loss - WORTH_ANOTHER:
                result = Scored(tuple(terms), fit(chain, self.noise, self.whitening_group, start))
                known = result if known is None or result.fit.loss < known.fit.loss else known
                self._done[key] = known
        return known

    def continued(self, scored: Scored) -> Scored:
        """A set whose fit has used up its steps, fitted on from there until it converges or gets no better."""
        while not scored.fit.converged:
            further = replace(scored, fit=fit(scored.fit.chain, self.noise, self.whitening_group, scored.fit.p))
            if further.fit.loss > scored.fit.loss - WORTH_ANOTHER:
                break
            scored = self._done[frozenset(t.key for t in scored.terms)] = further
        return scored

    def chain(self, terms: Sequence[Term]) -> ParametricChain:
        """The chain of terms, with friction as it is known by now."""
        chain = ParametricChain(self.robot, self.data, terms)
        if self._has_friction(terms):
            chain.correction = self._correction
        return chain

    def _has_friction(self, terms: Sequence[Term]) -> bool:
        return bool(self.robot.friction.any()) or any(t.name == "friction" for t in terms)

    def pausing(self: Bench, pause: Callable[[], None]) -> Bench:
        """The bench with something else called between fits."""
        other = copy(self)
        other.pause = pause
        return other

    def corrected(self: Bench, scored: Scored) -> tuple[Bench, Scored]:
        """A bench that has what friction states leave out of a set, and the set fitted there; this one stays."""
        bench = self
        for _ in range(CORRECTIONS[self.data.is_stream] if self._has_friction(scored.terms) else 0):
            bench = bench._beginning(lambda known: not self._has_friction(known.terms))
            bench._correction = friction_correction(scored.fit.chain, scored.fit.p)
            scored = bench.scored(scored.terms, scored.fit)
        return bench, scored

    def _beginning(self: Bench, is_kept: Callable[[Scored], bool] = lambda _: False) -> Bench:
        """Another bench, which remembers of this one's sets those that are kept."""
        other = copy(self)
        other._done = {key: known for key, known in self._done.items() if is_kept(known)}
        other._before = {**self._before, **{key: known.fit for key, known in self._done.items()}}
        other._tried = {key: list(tried) for key, tried in self._tried.items() if key in other._done}
        other._sized, other._screened = {}, {}
        return other

    def _start(self, chain: ParametricChain, near: Sequence[Fit | None], compared: bool = False) -> tuple[Fit, float]:
        """What a fit would be at the one of several starts whose first step promises most, and the loss promised.

        Without anything to compare with nothing is promised.
        """
        places = near or (None,)
        starts = [start for place in places for start in self._starts(chain, place, alone=len(places) == 1)]
        if len(starts) == 1 and not compared:
            starts = [np.clip(starts[0], chain.lower, chain.upper)]
        fits = [fit_at(chain, self.noise, self.whitening_group, start) for start in starts]
        if len(starts) == 1 and not compared:
            return fits[0], np.nan
        promised = [float(robust_square(np.linalg.norm(linear(f).refitted().r, axis=1)).sum()) for f in fits]
        best = int(np.argmin(promised))
        return fits[best], promised[best]

    def _starts(self, chain: ParametricChain, near: Fit | None, alone: bool = True) -> list[Array]:
        """Known values of the parameters, and the effects' own suggestions for those not known yet.

        Far from any fit, and not `alone`, only the one that is nearest to the poses.
        """
        known = near.chain.keys if near else ()
        starts = [valued(chain, near, chain.start)]
        for t in chain.terms:
            if all((t.name, q.name) in known for q in t.parameters):
                continue
            suggestions = t.effect.starts([q.name for q in t.parameters])
            if suggestions != [{}]:
                starts = [_suggested(start, chain, t, values) for start in starts for values in suggestions]
        return starts if near or alone or len(starts) == 1 else [min(starts, key=lambda start: self._off(chain, start))]

    def _off(self, chain: ParametricChain, p: Array) -> float:
        """The loss of the poses at parameters (P,)."""
        seen = chain.predict(np.clip(p, chain.lower, chain.upper), derivatives=False)
        return residuals(self.data, seen, self.noise, self.whitening_group).loss

    def sized(self, scored: Scored) -> Scored:
        """The set with priors of its effects as wide as is most probable, where that is wider than stated.

        Priors say where to look. The size of an effect that is there is for the data to say: a prior that it exceeds
        would draw it in and make its interval too narrow.
        """
        if scored not in self._sized:
            chain = scored.fit.chain
            widths = widths_of(linear(scored.fit), chain.owners, scored.names)
            wide = {name: width.over_stated for name, width in widths.items()}
            terms = [_widened(t, max(1.0, wide.get(t.name, 1.0))) for t in chain.terms]
            freed = fit(chain.with_terms(terms), self.noise, self.whitening_group, scored.fit.p)
            self._sized[scored] = replace(scored, fit=freed) if max(wide.values(), default=1.0) > 1 else scored
        return self._sized[scored]

    def screened(
        self, here: Scored, others: Sequence[Term], completed: Callable[[Sequence[Term], Term], Sequence[Term]]
    ) -> list[Screened]:
        """Variants beside a fit by one Gauss-Newton step each: cheap, for choosing what to fit.

        `completed` adds what a variant needs to the terms that it stands beside.
        """
        key = here, frozenset(t.key for t in others)
        if key in self._screened:
            return self._screened[key]
        panel, screened = self.panel(here, others), list[Screened]()
        for other in others:
            if not self._is_as_in_panel(other):
                screened.append(self._tried_out(here, other, completed))
                continue
            same = [t for t in here.terms if t.name != other.name]
            together = [*self.basis([*same, other]), *same, other]
            places = panel.places(together)
            owners = tuple(panel.keys[k][0] for k in places)
            screened.append(Screened(other, panel.whole.columns(places).refitted(), owners, panel, places))
        self._screened[key] = screened
        return screened

    def _is_as_in_panel(self, other: Term) -> bool:
        """Whether a variant acts in proportion, and the parameters that it lacks do nothing where they are neutral."""
        own = {q.name for q in other.parameters}
        return other.effect.is_linear and not any(
            q.neutral for q in other.effect.parameters(self.robot) if q.name not in own
        )

    def panel(self, here: Scored, others: Sequence[Term]) -> Linearisation:
        """A fit linearised in its own parameters and those of other variants, which vanish there."""
        merged = _merged([*here.terms, *others], self.robot)
        chain = self.chain([*self.basis(merged), *merged])
        p = valued(chain, here.fit, np.array([_vanishing(q.start, q.neutral) * q.si for q in chain.parameters]))
        result = residuals(self.data, chain.predict(p), self.noise, self.whitening_group)
        weight = here.fit.residuals.weight
        whole = Linear(result.r, result.J, weight, 1 / chain.prior**2, p - chain.neutral, result.given)
        return Linearisation(chain.keys, whole)

    def _tried_out(
        self, here: Scored, other: Term, completed: Callable[[Sequence[Term], Term], Sequence[Term]]
    ) -> Screened:
        """A variant that does not act in proportion, linearised where its first step promises most."""
        terms = completed([t for t in here.terms if t.name != other.name], other)
        chain = self.chain([*self.basis(terms), *terms])
        start, _ = self._start(chain, [here.fit])
        return Screened(other, linear(start).refitted(), chain.owners)


def _widened(t: Term, factor: float) -> Term:
    """With priors so many times as wide."""
    return Term(t.effect, tuple(replace(q, prior=factor * q.prior) for q in t.parameters))


def linear(result: Fit) -> Linear:
    """A fit's own linearisation."""
    parts = result.residuals
    return Linear(parts.r, parts.J, parts.weight, result.precision, result.p - result.chain.neutral, parts.given)


def valued(chain: ParametricChain, near: Fit | None, otherwise: Array, but: Collection[str] = ()) -> Array:
    """(P,) SI values of a chain's parameters: those of a fit `near`, else `otherwise` (P,), as for effects in `but`."""
    known = dict(zip(near.chain.keys, near.p.tolist(), strict=True)) if near else {}
    known = {key: value for key, value in known.items() if key[0] not in but}
    return np.array([known.get(key, value) for key, value in zip(chain.keys, otherwise.tolist(), strict=True)])


def _suggested(start: Array, chain: ParametricChain, t: Term, values: Values) -> Array:
    """A start (P,) with values of a term, in the units of their names, that its effect suggests."""
    changed = start.copy()
    for name, value in values.items():
        place = chain.keys.index((t.name, name))
        changed[place] = value * chain.si[place]
    return changed


def _merged(terms: Sequence[Term], robot: Robot) -> list[Term]:
    """One term per effect with the parameters of all its variants."""
    wanted: dict[str, dict[str, None]] = {}
    effects = {t.name: t.effect for t in terms}
    for t in terms:
        wanted.setdefault(t.name, {}).update(dict.fromkeys(p.name for p in t.parameters))
    return [term(effects[name], list(names), robot) for name, names in wanted.items()]


def _vanishing(start: float | None, neutral: float) -> float:
    """Where a variant is linearised: where it vanishes, or as near as its derivative exists."""
    return start if start is not None and 0 < abs(start - neutral) <= 1e-2 else neutral
