"""A term that was built of a rest, with what speaks for it; passed by blocks left out, and worse nowhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.building.search import Round, Tried
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.holding import SAYS_SOMETHING, summed
from ctrplan.diagnosis.partial_search import is_built
from ctrplan.diagnosis.partly import Partly, rest_beside
from ctrplan.diagnosis.rest import Rest
from ctrplan.diagnosis.selection import Step
from ctrplan.diagnosis.shares import mean_square
from ctrplan.diagnosis.smooth_evidence import SmoothEvidence
from ctrplan.diagnosis.workbench import Scored, certainty
from ctrplan.effects.learned.learned import Learned
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.term import Term

LEAST_Z = 5.0  # standard errors over blocks
TIMES_CHANCE = 4.0  # the gain that the first piece reaches in 2 % of smooth surrogates, of all pieces together
LEAST_EVIDENCE = 20.0  # logarithm, beside a smooth error: what four choices among 150 pieces may gain, 4 log 150
LEAST_WINNING = 0.85  # of the blocks that say something
LEAST_SHARE = 0.6  # of the squares that remain beyond noise, closed on blocks left out
LEAST_SHARE_ASIDE = 0.4  # of the same, closed on the poses kept aside
MOST_WORSE = 1.05  # of the rms error of any region, with the term over without
LEAST_POSES = 8  # of a region that is asked


@dataclass(frozen=True, eq=False)
class Built:
    """A set of effects with built terms, and their evidence on blocks that were left out."""

    scored: Scored  # named and built
    named: Scored  # without the built ones
    partly: Partly  # what holds of the catalogue beside the built ones, and what the catalogue leaves
    rounds: tuple[Round, ...]
    gain: float
    error: float  # standard error over blocks
    z: float
    winning: float  # share of the blocks that say something
    share: float  # of the rest's squares
    rest: Rest  # what remains beside the built ones as well
    odds: float  # logarithm, of the terms beside an error as smooth as is probable
    evidence: float  # logarithm of that of the whole set there
    is_shown: bool = False  # whether a less probable set passes, so that there is more than a smooth error

    @property
    def terms(self) -> tuple[Term, ...]:
        """The built ones."""
        return tuple(t for t in self.scored.terms if is_built(t))

    @property
    def is_chance(self) -> bool:
        """Whether an error that is smooth in the joints might have let pieces gain as much."""
        if self.is_shown:
            return False
        return self.gain < TIMES_CHANCE * self.rounds[0].smooth_chance or self.odds < LEAST_EVIDENCE

    @property
    def path(self) -> tuple[Step, ...]:
        """The rounds, as steps of a search."""
        return tuple(_step(one) for one in self.rounds)

    @property
    def by_stage(self) -> dict[str, float]:
        """Gain of the best first piece of each stage: what decided which stage it is."""
        found: dict[str, float] = {}
        for one in self.rounds[0].tried:
            found.setdefault(one.piece.on.kind.stage, one.gain)
        return found

    def to_json(self, found: Scored) -> dict[str, Any]:
        """For diagnosis.json, with the coefficients of a fit."""
        return {
            "terms": [_term_json(t, found) for t in found.terms if isinstance(t.effect, Learned)],
            "share_of_rest": round(self.share, 3),
            "gain": round(self.gain, 2),
            "standard_error": round(self.error, 2),
            "z": round(self.z, 2),
            "winning_blocks": round(self.winning, 3),
            "surrogates_98": round(self.rounds[0].smooth_chance, 2),
            "best_gain_by_stage": {stage: round(gain, 1) for stage, gain in self.by_stage.items()},
            "rest_rms_mm": round(self.rest.rms_m * 1e3, 4),
        }


def built_of(found: Partly, rounds: Sequence[Round]) -> Built:
    """What a search ended with, with its evidence."""
    bench, scored = found.bench, found.chosen
    plain = bench.scored([t for t in scored.terms if not is_built(t)], scored.fit)  # beside what is left now
    gains = bench.by_group((plain.held_out - scored.held_out) / 2)
    telling = gains[np.abs(gains) > SAYS_SOMETHING]
    winning = float((telling > 0).mean()) if len(telling) else 0.0
    before, after = mean_square(bench.left_out_m(plain)), mean_square(bench.left_out_m(scored))
    share = (before - after) / max(before - bench.plain.floor_m**2, 1e-12)
    rest = rest_beside(bench, scored, bench.plain)
    probable = SmoothEvidence(bench, scored).highest()
    odds = probable - SmoothEvidence(bench, plain).highest()
    return Built(
        scored, plain, found, tuple(rounds), *summed(gains), certainty(gains), winning, share, rest, odds, probable
    )


def refusals(bench: CorrelatedBench, built: Built) -> list[str]:
    """Why a term is not handed over; empty if it is."""
    errors = [np.linalg.norm(bench.left_out_m(scored), axis=1) for scored in (built.named, built.scored)]
    worse = worse_in(bench.data, errors[0], errors[1])
    said = {
        f"its gain is {built.z:.1f} standard errors above zero over blocks": built.z < LEAST_Z,
        f"its gain of {built.gain:.0f} is what chance may give beside a smooth error": built.is_chance,
        f"only {100 * built.winning:.0f} % of the blocks speak for it": built.winning < LEAST_WINNING,
        f"it closes {100 * built.share:.0f} % of what remains": built.share < LEAST_SHARE,
        f"it is worse on {worse}": bool(worse),
    }
    return [reason for reason, is_one in said.items() if is_one]


def worse_in(data: Measurements, before: Array, after: Array) -> str:
    """The first region in which errors (K,) have grown by more than 5 %, in words; empty if none."""
    for name, inside in regions(data).items():
        if inside.sum() >= LEAST_POSES and _rms(after[inside]) > MOST_WORSE * _rms(before[inside]):
            return name
    return ""


def regions(data: Measurements) -> dict[str, NDArray[np.bool_]]:
    """Masks (K,) of all poses, and of the thirds of each joint's range that changes, rotations modulo a turn."""
    found = {"all poses": np.ones(data.count, bool)}
    theta, l = np.mod(data.theta_commanded[data.rows], 2 * np.pi), data.l_commanded[data.rows]  # noqa: E741
    for kind, columns in (("rotation", theta), ("translation", l)):
        for i, values in enumerate(columns.T, start=1):
            if np.ptp(values) > 1e-3:
                third = np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values, side="right")
                words = ("lowest", "middle", "highest")
                found |= {f"the {words[k]} third of the {kind} of tube {i}": third == k for k in range(3)}
    return found


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def _step(one: Round) -> Step:
    best: Tried = one.tried[0]
    shown = best if one.taken is None else next(tried for tried in one.tried if tried.piece == one.taken)
    name, parts = shown.piece.on.effect_name, shown.piece.parts
    return Step("build", name, parts, round(shown.gain, 2), 0.0, round(one.chance, 2), one.taken is not None)


def _term_json(t: Term, found: Scored) -> dict[str, Any]:
    assert isinstance(t.effect, Learned)
    place = [term.key for term in found.fit.chain.terms].index(t.key)
    stated = t.effect.stated(found.fit.chain.values(found.fit.p)[place])
    coefficients = {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in estimates(found.fit, t).items()}
    return {"name": t.name, **stated, "coefficients": coefficients}
