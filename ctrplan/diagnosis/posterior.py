"""How probable it is that each effect acts, that something acts which the catalogue lacks, and that a verdict is true.

Priors and likelihood are those of docs/diagnosis.md, probabilities; what something unknown may be, `unknown_errors.py`
has. Posterior probabilities sum to one over the sets that were compared.

Something unknown does what any effect does: beside noise it wins wherever the true set was not compared. So sets are
searched by this number itself, with one effect more or less than the most probable of each size, nonlinear effects
among them, until none is more probable. What is not worth a fit is compared to first order.

How wide the priors of parameters have to be is itself uncertain, or an effect with a wide one would lose to another
that does the same to the tips: a width w times the stated one has the density 2 / (pi (1 + w^2)), and is integrated out
around its most probable value, one effect at a time. An effect that is a hundredth of what its prior states pays for
that once, and not once for each of its parameters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.special import logsumexp

from ctrplan.calibration.discrepancy import Linearised, Spectrum
from ctrplan.calibration.least_squares import Fit
from ctrplan.diagnosis.correlated_bench import FRAMES, HOMED, SHIFT
from ctrplan.diagnosis.linear_fit import STATED, Linear, Width, widths_of
from ctrplan.diagnosis.term_pieces import is_built, pieces
from ctrplan.diagnosis.unknown_errors import Peak, UnknownErrors, without_error
from ctrplan.diagnosis.verdict import ACTS, NAMED, UNKNOWN_ACTS, Posterior, log_odds, normalised
from ctrplan.diagnosis.workbench import (
    Bench,
    Candidates,
    Linearisation,
    Scored,
    Screened,
    SelectionStep,
    Teller,
    Workbench,
    linear,
)
from ctrplan.effects.effect import CATALOGUE
from ctrplan.pipeline.term import Term

MOST_EFFECTS = 4  # of a set
REFITTED = 5  # different effects that are fitted for good beside a set
WINDOW = 30.0  # in the logarithm: sets that are less probable are not weighed again, a budget; they move by a few
VAIN = 2 * log_odds(ACTS)  # what brings nothing loses no more: its prior odds, and as much again for its parameters
ROUNDS = 3  # of a search, each with the friction states and the rest that the set before leaves

Promise = tuple[float, list[Term]]  # the weight of a set to first order, and its terms


@dataclass(frozen=True, eq=False)
class Compared:
    """The posterior over sets that were compared, and those of them that were fitted, most probable first."""

    posterior: Posterior
    sets: tuple[Scored, ...]
    base: Scored  # without effects

    def places(self, terms: Sequence[Term]) -> list[Fit]:
        """Where a set was when it was last fitted, if it was."""
        return _places(self.sets[::-1], terms)


def compared(bench: Workbench, begun: Scored, known: Candidates) -> Compared:
    """The most probable sets from one on, and what stands near them, beside the friction states of the bench.

    Built terms are no effects: what they do is done by something unknown.
    """
    return _searched(bench, begun, known, Teller()).compared(begun)


def _searched(
    bench: Workbench,
    begun: Scored,
    known: Candidates,
    tell: Teller,
    earlier: Sequence[Scored] = (),
    rivals: Sequence[Scored] = (),
) -> _Comparison:
    """The sets that a search from one on comes to, before the neighbours of the best are weighed.

    earlier: sets fitted beside other friction states or another rest, where fits begin; rivals: those compared anew.
    """
    base = begun if not begun.terms else bench.scored([], *_places(earlier, []), begun.fit, None)
    anew = [bench.scored(s.terms, s.fit) for s in rivals if not bench.stands(s) and s.terms != begun.terms]
    fitted = [base, *(scored for scored in earlier if bench.stands(scored)), *anew]
    comparison = _Comparison(bench, known, base, begun, fitted, earlier)
    comparison.climb(tell)
    if comparison.best is not begun:  # poses count as they do in the most probable set
        likely = dict.fromkeys([comparison.as_known(base), comparison.as_known(begun), *comparison.likely])
        comparison = _Comparison(bench, known, base, comparison.best, likely, earlier)
    comparison.compare_less(comparison.best)
    return comparison


def _places(earlier: Sequence[Scored], terms: Sequence[Term]) -> list[Fit]:
    """Where a set was when it was last fitted, if it was."""
    return [scored.fit for scored in earlier if _key(scored.terms) == _key(terms)][-1:]


def settled(
    bench: Bench, here: Scored, known: Candidates, tell: Teller
) -> tuple[Bench, Compared, Scored, tuple[SelectionStep, ...]]:
    """The most probable set from one on, on a bench with what friction states and the rest are beside it, and the path
    taken.
    """
    path, earlier, rivals = list[SelectionStep](), list[Scored](), list[Scored]()
    while True:
        tell("comparing sets of effects beside " + (", ".join(here.names) or "the calibrated robot"))
        comparison, before = _searched(bench, here, known, tell, earlier, rivals), here
        best = comparison.best
        bench, here = bench.corrected(best)
        if _key(best.terms) == _key(before.terms):
            return bench, comparison.compared(before), here, tuple(path)
        names = tuple(q.name for t in best.terms for q in t.parameters)
        gain = comparison.weight(best) - comparison.weight(comparison.as_known(before))
        path.append(SelectionStep("compare", " and ".join(best.names), names, round(gain, 2), bool(names)))
        if here is best or len(path) == ROUNDS:
            return bench, comparison.compared(before), here, tuple(path)
        earlier += comparison.known_sets
        rivals = comparison.rivals


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


class _Comparison:
    """What is the same for all sets of a search: poses, how much each counts, errors, and variants of effects."""

    def __init__(
        self,
        bench: Workbench,
        known: Candidates,
        base: Scored,
        chosen: Scored,
        fitted: Iterable[Scored],
        earlier: Sequence[Scored],
    ) -> None:
        self.bench, self.known, self.base, self.earlier = bench, known, base, earlier
        self.of_piece = float(np.log(len(pieces(bench.robot, bench.data, known.terms))))  # of which a term is built
        self.root = np.sqrt(np.where(base.failed | chosen.failed, 0.0, chosen.fit.residuals.weight))
        ends = [self.as_fitted(scored) for scored in (base, chosen)]
        self.errors = UnknownErrors(bench, base, chosen, ends, self.root)
        self.known_sets: dict[Scored, _Set] = {}  # with all frames that are free
        self._fits: dict[frozenset[str], Scored] = {}  # the last of each set
        self._weights: dict[Scored, float] = {}  # with some of them or none
        self._evidence: dict[frozenset[str], _Set] = {}  # of sets that were fitted
        self._promised: dict[frozenset[str], _Set] = {}  # of others, to first order
        self._expanded: set[Scored] = set()
        self._near: dict[Scored, list[tuple[list[Term], _Set, Screened]]] = {}
        self._peaks: dict[Scored, float] = {}
        for scored in (chosen, *fitted):
            self.add(scored)

    @property
    def likely(self) -> list[Scored]:
        """Those that another weighing of the poses may make the most probable."""
        highest = self.weight(self.best)
        return [scored for scored in self.known_sets if self.weight(scored) > highest - WINDOW]

    @property
    def rivals(self) -> list[Scored]:
        """Those probable enough to take a name from the most probable."""
        highest = self.weight(self.best)
        return [scored for scored in self.known_sets if self.weight(scored) > highest - log_odds(NAMED)]

    @property
    def best(self) -> Scored:
        """The most probable of them."""
        return max(self.known_sets, key=self.weight)

    def compared(self, chosen: Scored) -> Compared:
        """The posterior, with what stands near the base, the set that was begun with, and the best one."""
        for here in dict.fromkeys(self.as_known(scored) for scored in (self.base, chosen, self.best)):
            if here in self.likely:
                self.compare_neighbours(here)
        ranked = sorted(self.known_sets, key=self.weight, reverse=True)
        along = self.errors.along(self.as_fitted(ranked[0]))
        if self.bench.data.time_s is None:  # rows are all that is known of it
            along = {"order" if name == "time" else name: share for name, share in along.items()}
        return Compared(normalised(self.by_names(), along, self._inputs()), tuple(ranked), self.as_known(self.base))

    def as_known(self, scored: Scored) -> Scored:
        """The set as it is fitted by now: further on where its fit had used up its steps."""
        return self._fits[_key(scored.terms)]

    def weight(self, scored: Scored) -> float:
        """Logarithm of prior times likelihood of a set, whichever of the frames that are free in it act."""
        return self._weights[scored]

    def add(self, scored: Scored) -> None:
        """A set as it is fitted, beside everything unknown; to first order without any of the frames that are free.

        Beside the same error where that is hopeless.
        """
        if scored in self.known_sets:
            return
        self._fits[_key(scored.terms)] = scored
        widths, owners = self._of_fit(scored)
        whole = linear(scored.fit).widened(owners, widths).centred(scored.fit.noise, self.root)
        terms, weights = self._named(scored), list[float]()
        built = sum(map(is_built, scored.terms))
        spectra, complete = self.errors.spectra(whole), list[_Set]()
        for gone in self._frames(scored):
            names = frozenset(t.name for t in terms) - gone
            cost = self._cost(names, widths, built)
            kept = [k for k, name in enumerate(owners) if name not in gone]
            fit = Linearised(whole.r, whole.J[:, :, kept], whole.precision[kept])
            lost = complete[0].peak.here(whole) - complete[0].peak.here(fit) if complete else 0.0
            if lost > WINDOW:
                beside, peak = complete[0].beside + complete[0].cost - lost, complete[0].peak
            else:
                beside, peak = self.errors.evidence(fit, [spectrum.of(kept) for spectrum in spectra])
            alone = -np.inf if built else without_error(fit) - cost
            result = _Set(names, cost, alone, beside - cost, peak)
            _note(self._evidence, [t for t in terms if t.name not in gone], result)
            weights.append(result.weight)
            if not gone:
                complete, self.known_sets[scored] = [result], result
        self._weights[scored] = float(logsumexp(weights))

    def _forget(self, scored: Scored) -> None:
        """Takes a set back whose fit had not come to its end."""
        del self.known_sets[scored]
        for gone in self._frames(scored):
            del self._evidence[_key(t for t in self._named(scored) if t.name not in gone)]

    def _frames(self, scored: Scored) -> list[frozenset[str]]:
        """Frames that may be gone from a set, in all ways, none first."""
        free = [t.name for t in self._named(scored) if t.name not in scored.names]
        return [frozenset(some) for count in range(len(free) + 1) for some in combinations(free, count)]

    def climb(self, tell: Teller) -> None:
        """Fits sets of one effect more or less than the most probable of each size, while these are more probable.

        Sizes count as far as one effect's prior odds may hide the better one.
        """
        while True:
            highest, sizes = self.weight(self.best), dict[int, Scored]()
            for scored in sorted(self.known_sets, key=self.weight):
                sizes[len(scored.terms)] = scored
            near = [
                scored
                for size, scored in sizes.items()
                if size < MOST_EFFECTS
                and scored not in self._expanded
                and self.weight(scored) > highest + log_odds(ACTS)
            ]
            if not near:
                return
            here = max(near, key=self.weight)
            tell.pause()
            if (further := self.bench.continued(here)) is not here:
                self._forget(here)
                self.add(further)
                continue
            self._expanded.add(here)
            more = ((enlarged.weight, [*here.terms, *added]) for added, enlarged, _ in self._neighbours(here))
            for promises in (more, *(self._replaced(here, gone) for gone in here.terms)):
                for variants in self._worth_a_fit(here, promises):
                    self._fit_best(variants, here)

    def _fit_best(self, variants: Sequence[Promise], here: Scored) -> None:
        """Variants of an effect beside a set, the most promising first, until none promises more than one has.

        Each is fitted from there or from where fits start, whichever promises more.
        """
        highest = -np.inf
        for promised, terms in variants:
            if promised <= highest:
                return
            highest = max(highest, self.known_sets[self._fitted(terms, here)].weight)

    def _fitted(self, terms: Sequence[Term], here: Scored) -> Scored:
        """A set near another one, as it is fitted then: from where it was, from there, or from where fits start."""
        known, places = self._fits.get(_key(terms)), (*_places(self.earlier, terms), here.fit, None)
        scored = self.bench.improved(known, here.fit) if known else self.bench.scored(terms, *places)
        self.add(scored)
        return scored

    def _worth_a_fit(self, here: Scored, promises: Iterable[Promise]) -> list[list[Promise]]:
        """Promised sets near another by the effect that they end with, the most probable first."""
        variants: dict[str, list[Promise]] = {}
        for weight, terms in promises:
            if weight > self.known_sets[here].weight + VAIN:
                variants.setdefault(terms[-1].name if terms else "", []).append((weight, terms))
        ranked = [sorted(several, key=lambda variant: -variant[0]) for several in variants.values()]
        return sorted(ranked, key=lambda several: -several[0][0])[:REFITTED]

    def _replaced(self, here: Scored, gone: Term) -> Iterator[Promise]:
        """Sets without an effect of a set, with each that may be added or none, to first order.

        Those that leave the poses too far off, for as much as fewer parameters cost less, are not weighed.
        """
        rest = [t for t in here.terms if t is not gone]
        own = linear(here.fit)
        near = [(added, screened.linear, screened.owners) for added, _, screened in self._neighbours(here)]
        for added, whole, owners in [*near, ([], own, here.fit.chain.owners)]:
            if any(t.effect.needs == gone.name for t in (*rest, *added)):
                continue
            kept = np.array(owners) != gone.name
            left = whole.without(~kept).refitted()
            if max(left.evidence - own.evidence, (own.loss - left.loss) / 2) > VAIN:
                lacking = self._lacking(here, gone, added, left, np.array(owners)[kept].tolist())
                yield lacking.weight, [*rest, *added]

    def _lacking(self, here: Scored, gone: Term, added: Sequence[Term], left: Linear, owners: Sequence[str]) -> _Set:
        """A set near another one, with others in the place of an effect, to first order; owners of its parameters."""
        names = (self.known_sets[here].names - {gone.name}) | {t.name for t in added}
        widths = widths_of(left, owners, {*names, *here.names} - {gone.name})
        built = sum(is_built(t) for t in here.terms if t is not gone)
        fit = left.widened(owners, widths).centred(self.bench.noise, self.root)
        return self._first_order(here, names, self._cost(names, widths, built), built, fit)

    def _first_order(
        self,
        here: Scored,
        names: frozenset[str],
        cost: float,
        built: int,
        fit: Linearised,
        beside_peak: float | None = None,
    ) -> _Set:
        """A set near another one that is known, beside the same error of the sizes that are most probable there.

        built: how many of its terms are; beside_peak: logarithm of its evidence there, where that is known.
        """
        mine = self.known_sets[here]
        alone = -np.inf if built else without_error(fit) - cost
        of_fit = mine.peak.evidence(fit) if beside_peak is None else beside_peak
        beside = mine.beside + mine.cost + of_fit - self._of_peak(here) - cost
        return _Set(names, cost, alone, beside, mine.peak)

    def _of_peak(self, here: Scored) -> float:
        """Logarithm of the evidence of a set beside its most probable error, asked once."""
        if here not in self._peaks:
            self._peaks[here] = self.known_sets[here].peak.evidence(self.as_fitted(here))
        return self._peaks[here]

    def compare_less(self, here: Scored) -> None:
        """Compares a set with those of one effect less, to first order where that makes them hopeless."""
        for gone in here.terms:
            rest, kept = [t for t in here.terms if t is not gone], np.array(here.fit.chain.owners) != gone.name
            left = linear(here.fit).without(~kept).refitted()
            lacking = self._lacking(here, gone, [], left, np.array(here.fit.chain.owners)[kept].tolist())
            if lacking.weight > self.known_sets[here].weight - WINDOW:
                self._fitted(rest, here)
            elif _key(rest) not in self._fits:
                _note(self._promised, [t for t in self._named(here) if t.name != gone.name], lacking)

    def compare_neighbours(self, here: Scored) -> None:
        """Compares a set with one effect more, to first order."""
        for added, neighbour, _ in self._neighbours(here):
            _note(self._promised, [*self._named(here), *added], neighbour)

    def _neighbours(self, here: Scored) -> list[tuple[list[Term], _Set, Screened]]:
        """Those of a set, asked once."""
        if here not in self._near:
            self._near[here] = list(self._added(here))
        return self._near[here]

    def _added(self, here: Scored) -> Iterator[tuple[list[Term], _Set, Screened]]:
        """Effects that may be added, one or two where one needs the other, and the sets with them to first order."""
        mine = self.known_sets[here]
        others = [t for t in self.known.beside(here.terms) if t.name not in {*mine.names, *here.names}]
        if not others:
            return
        built, wide = sum(map(is_built, here.terms)), dict[Linearisation, Spectrum]()
        for screened in self.bench.screened(here, others, self.known):
            added = [t for t in self.known.completed(here.terms, screened.term) if t.name not in here.names]
            names = mine.names | {t.name for t in added}
            widths = widths_of(screened.linear, screened.owners, {*names, *here.names})
            fit = screened.linear.widened(screened.owners, widths).centred(self.bench.noise, self.root)
            cost = self._cost(names, widths, built)
            if (panel := screened.panel) is None:
                of_fit = mine.peak.evidence(fit)
            else:  # what all variants have in common is worked out once
                if panel not in wide:
                    wide[panel] = mine.peak.beside(panel.whole.centred(self.bench.noise, self.root))
                moved = -panel.whole.offset  # others stay where they were linearised
                moved[screened.places] = 0.0
                of_fit = wide[panel].of(screened.places, fit.precision, moved).highest()[0] / 2
            yield added, self._first_order(here, names, cost, built, fit, of_fit), screened

    def by_names(self) -> dict[frozenset[str], tuple[float, float]]:
        """Logarithms of the evidence of sets of effects, over their variants."""
        result: dict[frozenset[str], tuple[float, float]] = {}
        for compared_set in {**self._promised, **self._evidence}.values():
            before = result.get(compared_set.names, (-np.inf, -np.inf))
            result[compared_set.names] = tuple(np.logaddexp(before, (compared_set.alone, compared_set.beside)).tolist())
        return result

    def _inputs(self) -> dict[str, str]:
        """What each effect, tested or not, goes along with: the way poses were reached, the time, or the joints."""
        effects = {**CATALOGUE, **{t.name: t.effect for t in self.known.terms}}
        return {
            name: "history" if e.depends_on_history else "time" if e.needs_time or name in (SHIFT, HOMED) else "joints"
            for name, e in effects.items()
        }

    def _named(self, scored: Scored) -> list[Term]:
        """Effects of a fit that the catalogue has, and frames."""
        return [t for t in scored.fit.chain.terms if t.name in self.known.variants or t.name in FRAMES]

    def _of_fit(self, scored: Scored) -> tuple[dict[str, Width], tuple[str, ...]]:
        """How wide each effect's prior is, and the effect of each parameter."""
        owners = scored.fit.chain.owners
        named = {*(t.name for t in self._named(scored)), *scored.names}
        return widths_of(linear(scored.fit), owners, named), owners

    def as_fitted(self, scored: Scored) -> Linearised:
        """A set at its own fit."""
        widths, owners = self._of_fit(scored)
        return linear(scored.fit).widened(owners, widths).centred(scored.fit.noise, self.root)

    def _cost(self, names: Iterable[str], widths: Mapping[str, Width], built: int) -> float:
        """Logarithm of what the choice of one variant of each effect, of its width and of built terms cost."""
        variants = (float(np.log(self.known.variants.get(name, 1))) for name in names)
        return sum(variants) + sum(widths.get(name, STATED).cost for name in names) + built * self.of_piece


def _note(known: dict[frozenset[str], _Set], terms: Sequence[Term], new: _Set) -> None:
    """Keeps the larger evidence of each set: the fit nearer to the set's most probable place has it."""
    key, old = _key(terms), known.get(_key(terms), new)
    known[key] = replace(new, alone=max(old.alone, new.alone), beside=max(old.beside, new.beside))


def _key(terms: Iterable[Term]) -> frozenset[str]:
    return frozenset(t.key for t in terms)
