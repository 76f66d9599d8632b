"""Which effects blocks of poses that were left out support although something else remains, and what share each
closes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.diagnosis.correlated_bench import FRAMES, CorrelatedBench
from ctrplan.diagnosis.cross_validation import Linear, left_out_residuals
from ctrplan.diagnosis.workbench import CERTAIN, OVERWHELMING, SURE, Linearisation, Scored, Workbench, certainty, linear
from ctrplan.pipeline.term import Term

LEAST_Z = 4.0  # standard errors over blocks that the gain of an effect must exceed zero by
TIMES_CHANCE = 3.0  # the gain that surrogates of the residual exceed in 2 % of draws
LEAST_WINNING = 0.9  # of the blocks that say something
SAYS_SOMETHING = 0.5  # log-likelihood of a block that tells whether an effect acts
LEAST_ODDS = 7.0  # logarithm of the evidence beside a smooth error: 1,100 to 1, for some hundred variants are asked
LEAST_ODDS_AT_REST = 12.0  # of the same, of poses at rest; nulls had up to 5
LIKELY = 10.0  # of the same, of what is taken for the time being: what else is found may make it probable, or idle
SAME_GAIN = 0.9  # of an effect's own: a competitor that brings as much in its place is told as another name for it


@dataclass(frozen=True)
class Telling:
    """What tells an effect by its odds: their logarithms, at first and in the end, and standard errors over blocks."""

    first: float
    odds: float
    z: float


OF_MOTION = Telling(OVERWHELMING, OVERWHELMING, CERTAIN)
AT_REST = Telling(LIKELY, LEAST_ODDS_AT_REST, SURE)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What speaks for one effect of a set: log-likelihoods of blocks left out, against the set without the effect."""

    term: Term
    gain: float
    error: float  # standard error over blocks
    z: float  # standard errors by which gains of blocks, or their signed roots, lie above zero
    chance: float  # what surrogates of the residual exceed in 2 % of draws
    winning: float  # share of the blocks that it predicts better, of those that say something
    weakest_z: float  # beside the competitor that leaves the least
    weakest: str  # its name
    imitators: tuple[Term, ...]  # competitors beside which little of its gain is left, so that they may stand for it
    shift: float  # of its parameters beside the competitor that moves them most, in standard errors
    shifted_by: str
    odds: float = np.inf  # logarithm of the evidence for it beside a smooth error; infinite where nobody asks for it
    telling: Telling | None = None  # odds that tell it although blocks say little; None where blocks have to

    @property
    def doubts(self) -> list[str]:
        """Why it does not hold; empty if it does."""
        if self.is_certain:
            return []
        results = []
        if self.odds < LEAST_ODDS:
            results.append(f"an error that is smooth in the joints or in time leaves it odds of exp({self.odds:.0f})")
        if self.z < LEAST_Z:
            results.append(f"its gain of {self.gain:.0f} is {self.z:.1f} standard errors above zero over blocks")
        if self.gain < TIMES_CHANCE * self.chance:
            results.append(f"its gain of {self.gain:.0f} is below {TIMES_CHANCE:g} times that of surrogates")
        if self.winning < LEAST_WINNING:
            results.append(f"only {100 * self.winning:.0f} % of the blocks speak for it")
        if self.imitators:
            results.append(f"beside {self.weakest} little of its gain is left")
        if self.shift > SURE:
            results.append(f"beside {self.shifted_by} its parameters leave their intervals")
        return results

    @property
    def is_certain(self) -> bool:
        """Whether its evidence beside smooth errors is enough: blocks may be too few to tell it by themselves."""
        return self.telling is not None and self.odds >= self.telling.odds and self.z >= self.telling.z

    @property
    def is_told_by_odds(self) -> bool:
        """Whether blocks left out would not have told it: then it has to help on poses kept aside."""
        by_blocks = self.z >= LEAST_Z and self.gain >= TIMES_CHANCE * self.chance and self.winning >= LEAST_WINNING
        return self.is_certain and not by_blocks

    @property
    def holds(self) -> bool:
        """Whether it may be named."""
        return not self.doubts

    @property
    def is_one_of_several(self) -> bool:
        """Whether it may be named together with what may stand for it."""
        return len(self.doubts) == bool(self.imitators)


def telling_odds(t: Term, is_stream: bool) -> Telling | None:
    """From which odds beside a smooth error an effect holds although blocks say little; None of what needs blocks.

    That are frames, and on a continuous motion all that does not act by it: a smooth error may be like that.
    """
    if t.name in FRAMES or (is_stream and not acts_by_motion(t)):
        return None
    return OF_MOTION if is_stream else AT_REST


def acts_by_motion(t: Term) -> bool:
    """Whether an effect depends on how fast, or from where, a configuration is approached."""
    return t.effect.stage == "clock" or t.effect.depends_on_history


@dataclass(frozen=True, eq=False)
class Sides:
    """A set with an effect and without it, each linearised where it fits, and all that is fitted there."""

    panel: Linearisation
    among: Sequence[Term]
    gone: Linearisation
    rest: Sequence[Term]


def evidence(bench: Workbench, sides: Sides, t: Term, chance: float) -> Evidence:
    """The evidence for an effect `t` of a set, beside every competitor of the linearisation.

    The set without it is a fit of its own. To first order around the set with it, the rest could stand for it: beside
    a load, how a shape changes with the stiffness of all tubes is what the load does.

    What only refines `t` does not compete with it, nor does what brings as much in its place: beside that
    parameters can be anything, and `in_its_place` tells it.
    """
    panel, among, gone = sides.panel, sides.among, sides.gone
    mine = panel.of(among)
    gains = _gains(bench, mine, gone.of(sides.rest))
    beside: dict[str, tuple[float, float]] = {}
    imitators: dict[str, Term] = {}
    for other in panel.others(among):
        alone = gone.of([*sides.rest, other])
        behind = float(_gains(bench, mine, alone).sum())
        if other.effect.needs == t.name or behind < (1 - SAME_GAIN) * float(gains.sum()):
            continue
        both = panel.of([*among, other])
        kept, moved = beside.get(other.name, (np.inf, 0.0))
        z = certainty(_gains(bench, both, alone))
        if z < min(kept, CERTAIN):
            imitators[other.name] = other
        beside[other.name] = (min(kept, z), max(moved, _shift(panel, among, t, other)))
    weakest = min(beside, key=lambda name: beside[name][0], default="")
    mover = max(beside, key=lambda name: beside[name][1], default="")
    telling = gains[np.abs(gains) > SAYS_SOMETHING]
    return Evidence(
        t,
        *summed(gains),
        certainty(gains),
        chance,
        float((telling > 0).mean()) if len(telling) else 0.0,
        beside[weakest][0] if weakest else np.inf,
        weakest,
        tuple(imitators.values()),
        beside[mover][1] if mover else 0.0,
        mover,
    )


def in_its_place(bench: Workbench, sides: Sides, t: Term) -> list[tuple[Term, float, float]]:
    """Other effects, each in its best variant, and how much better `t` predicts than it in its place; best first."""
    mine = sides.panel.of(sides.among)
    others = [other for other in sides.panel.others(sides.among) if other.effect.needs != t.name]
    results = [(other, *summed(_gains(bench, mine, sides.gone.of([*sides.rest, other])))) for other in others]
    best: dict[str, tuple[Term, float, float]] = {}
    for one in sorted(results, key=lambda one: one[1]):
        best.setdefault(one[0].name, one)
    return list(best.values())


def _gains(bench: Workbench, with_it: Linear, without_it: Linear) -> Array:
    """(B,) by block, of refits to first order."""
    losses = [bench.loss(system.refitted()) for system in (with_it, without_it)]
    return bench.by_group((losses[1] - losses[0]) / 2)


def summed(gains: Array) -> tuple[float, float]:
    """The sum over blocks (B,) and its standard error."""
    return float(gains.sum()), float(np.sqrt(len(gains)) * gains.std(ddof=1))


def _shift(panel: Linearisation, among: Sequence[Term], t: Term, other: Term) -> float:
    """How far the parameters of `t` move when `other` is added, in standard errors beside it, root mean square.

    What is hard to tell from `t` moves it by chance, for its errors are larger then.
    """
    plain, more = panel.of(among), panel.of([*among, other])
    mine = [_places(panel, terms, t) for terms in (among, [*among, other])]
    moved = more.refitted().offset[mine[1]] - plain.refitted().offset[mine[0]]
    spread = more.covariance()[np.ix_(mine[1], mine[1])]
    distance = float(moved @ np.linalg.pinv(spread, hermitian=True) @ moved)
    return float(np.sqrt(max(distance, 0.0) / len(moved)))


def _places(panel: Linearisation, terms: Sequence[Term], t: Term) -> list[int]:
    wanted = {(term.name, q.name) for term in terms for q in term.parameters}
    kept = [key for key in panel.keys if key in wanted]
    return [k for k, (name, _) in enumerate(kept) if name == t.name]


@dataclass(frozen=True)
class Closing:
    """Rms errors [m] without an effect and with it; gap_m: what calibration alone leaves, beyond the noise."""

    without_m: float
    with_m: float
    gap_m: float

    @property
    def share(self) -> float:
        """The share of the gap, in squares. Where effects hide one another, it may be below 0 or above 1."""
        return (self.without_m**2 - self.with_m**2) / max(self.gap_m**2, 1e-12)


@dataclass(frozen=True, eq=False)
class Part:
    """An effect of the verdict, with what it closes of the gap alone, and last of all."""

    evidence: Evidence
    alone: Closing
    last: Closing


def part_of(bench: CorrelatedBench, base: Scored, chosen: Scored, result: Evidence) -> Part:
    """The part of an effect in a set, where `base` is calibrated without effects and without free frames."""
    whole = left_out_residuals(linear(base.fit), bench.fold)[:, :3] * bench.plain.position_m * bench.data.over_tip
    before, after = rms(whole), rms(bench.left_out_m(chosen))
    gap = float(np.sqrt(max(before**2 - bench.plain.floor_m**2, 0.0)))
    none = bench.scored([])
    if result.term.name in FRAMES:
        others = [t for t in none.fit.chain.terms if t.name in FRAMES and t.name != result.term.name]
        alone, last = rms(bench.left_out_m(none, *others)), rms(bench.left_out_m(chosen, result.term))
        return Part(result, Closing(before, alone, gap), Closing(last, after, gap))
    free, alone = rms(bench.left_out_m(none)), rms(bench.left_out_m(bench.scored([result.term], chosen.fit)))
    last = rms(bench.left_out_m(bench.scored([t for t in chosen.terms if t is not result.term], chosen.fit)))
    return Part(result, Closing(free, alone, gap), Closing(last, after, gap))


def rms(error_m: Array) -> float:
    """[m] of errors (K, 3)."""
    return float(np.sqrt(mean_square(error_m)))


def mean_square(error_m: Array) -> float:
    """[m^2] of errors (K, 3)."""
    return float((error_m**2).sum(axis=1).mean())
