"""Effects of a diagnosis, compared once on runs that nothing has read.

Frames and zeros of joints are found anew there, as they are after every mounting; all other parameters keep the values
and the uncertainty that they have. An effect is confirmed by the number that named it: the log evidence of the new
poses with it, beside everything that may act unknown, over that of a model that was calibrated without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import Made, checked
from ctrplan.calibration.discrepancy import Linearised
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.calibration.fit_warnings import excused, gross_outliers, too_many
from ctrplan.calibration.least_squares import Fit, fit, fit_at
from ctrplan.diagnosis.correlated_bench import FRAMES, CorrelatedBench, fixed, frames
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.unknown_errors import UnknownErrors
from ctrplan.diagnosis.usable_poses import require_unread, thinning, usable_poses
from ctrplan.diagnosis.verdict import NAMED, log_odds, shown
from ctrplan.diagnosis.workbench import Scored, valued
from ctrplan.effects.learned.learned import Learned
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements, groups
from ctrplan.pipeline.followed_runs import simulated
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.robot.data_rules import require_measured


@dataclass(frozen=True)
class ConfirmedEffect:
    """One effect on the new runs: logarithm of how much more probable it makes them, and errors without it."""

    name: str
    log_bayes_factor: float
    without: Errors

    @property
    def probability(self) -> float:
        """That it acts there, if that is as probable as not beforehand."""
        return float(1 / (1 + np.exp(-self.log_bayes_factor)))

    @property
    def verdict(self) -> str:
        """Confirmed or contradicted with the probability of a name, or neither."""
        if abs(self.log_bayes_factor) < log_odds(NAMED):
            return "not confirmed"
        return "confirmed" if self.log_bayes_factor > 0 else "contradicted"


@dataclass(frozen=True)
class Confirmation:
    """What runs that nothing had read say of a diagnosis."""

    file: str
    sha256: str
    poses: int
    calibrated: Errors  # without any effect, and in the frame that the robot file has
    before: Errors  # the same in frames found anew
    after: Errors  # with all effects
    effects: tuple[ConfirmedEffect, ...]

    @property
    def sentence(self) -> str:
        """Effect by effect."""
        calibrated, before, after = (e.rms_m * 1e3 for e in (self.calibrated, self.before, self.after))
        errors = (
            f"{calibrated:.2f} mm rms calibrated, {before:.2f} mm in frames found anew, {after:.2f} mm with all effects"
        )
        sentences = [f"{e.name} {e.verdict} ({shown(e.probability)})" for e in self.effects] or ["no effect to confirm"]
        return f"On {self.file or 'new runs'}, which nothing had read: {', '.join(sentences)}; {errors}."

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "measurements_sha256": self.sha256,
            "poses": self.poses,
            "calibrated_rms_mm": round(self.calibrated.rms_m * 1e3, 4),
            "before_rms_mm": round(self.before.rms_m * 1e3, 4),
            "after_rms_mm": round(self.after.rms_m * 1e3, 4),
            "effects": [
                {
                    "name": e.name,
                    "verdict": e.verdict,
                    "probability": round(e.probability, 4),
                    "log_bayes_factor": round(e.log_bayes_factor, 2),
                    "without_rms_mm": round(e.without.rms_m * 1e3, 4),
                }
                for e in self.effects
            ],
        }


@checked(diagnosis=Made("Diagnosis"), data=Made("Measurements"))
def confirm(diagnosis: Diagnosis, data: Measurements) -> Confirmation:
    """Compares the effects of a diagnosis with models without them on other runs, once.

    Raises InputError for runs that it has read, and where no pose can be compared.
    """
    require_measured(diagnosis.robot, data)
    require_unread(diagnosis.data, data, "confirm")
    usable = usable_poses(diagnosis.robot, data)
    new = _new(diagnosis, data, usable)
    past = [t for t in diagnosis.built_terms if isinstance(t.effect, Learned) and "time" in t.effect.inputs]
    lasting = _without(diagnosis, *past) if past else diagnosis.chosen.fit  # whatever went with that time is over
    wrong = gross_outliers(new.placed(lasting), data, usable)
    if wrong.any() and not too_many(wrong, usable):
        new = _new(diagnosis, data, usable & ~wrong)
    listed = {t.key for t in (*diagnosis.listed, *diagnosis.built_terms)}
    terms = [t for t in lasting.chain.terms if t.key in listed and t.name not in FRAMES]
    base, whole = new.model(diagnosis.base.fit), new.model(lasting)
    without = [new.model(_without(diagnosis, t, *past)) for t in terms]
    evidence = new.evidences(base, [whole, *without])
    effects = tuple(
        ConfirmedEffect(t.name, evidence[0] - value, new.errors(model.placed, whole.placed))
        for t, model, value in zip(terms, without, evidence[1:], strict=True)
    )
    calibrated = new.as_it_is(diagnosis.base.fit)
    models = calibrated, base.placed, whole.placed
    as_it_is, before, after = (new.errors(fitted, *models) for fitted in models)
    return Confirmation(data.file or "", data.sha256, new.data.count, as_it_is, before, after, effects)


def _new(diagnosis: Diagnosis, data: Measurements, usable: NDArray[np.bool_]) -> NewPoses:
    """The poses to go by, of `usable` ones (K,)."""
    some = np.flatnonzero(usable)
    if not len(some):
        raise InputError("has no usable pose to confirm anything by", file=data.file)
    poses = data.subset(some[:: thinning(len(some))] if data.is_stream else some)
    if data.homing is not None or diagnosis.data.homing is not None:  # no run has the zeros of the first one there
        poses = replace(poses, homing=data.homings + 1)
    chosen = diagnosis.chosen.fit
    noise = replace(diagnosis.noise, discrepancy=chosen.noise.discrepancy)
    return NewPoses(CorrelatedBench(chosen.chain.robot, poses, noise, groups(poses)))


def _without(diagnosis: Diagnosis, *gone: Term) -> Fit:
    """Calibrated again on the poses of the diagnosis without some effects, as the model with them was."""
    whole, names = diagnosis.chosen.fit, {t.name for t in gone}
    if diagnosis.partial:
        bench, kept = diagnosis.partial.bench, [t for t in diagnosis.chosen.terms if t.name not in names]
        return bench.handed_over(bench.scored(kept, whole)).fit
    places = [(t, s) for t, s in zip(whole.chain.terms, whole.chain.slices(), strict=True) if t.name not in names]
    start = np.concatenate([whole.p[place] for _, place in places])
    return fit(whole.chain.with_terms([t for t, _ in places]), whole.noise, whole.group, start)


@dataclass(frozen=True, eq=False)
class _Model:
    """A model in the frames of the new runs; its own parameters are as uncertain as the diagnosis left them."""

    placed: Fit
    seen: Linearised  # one standard normal number for each combination of the parameters that were fitted


@dataclass(frozen=True, eq=False)
class NewPoses:
    """Runs that a diagnosis has not read, and their noise together with what remained of the diagnosis."""

    bench: CorrelatedBench

    @property
    def data(self) -> Measurements:
        """The poses that are compared."""
        return self.bench.data

    def model(self, result: Fit) -> _Model:
        """A model in the frames of these runs, to first order in its own parameters and those of the frames."""
        placed, old = self.placed(result), _of_frames(result)
        free = _of_frames(placed)
        parts = fit_at(placed.chain, self.bench.plain, self.bench.whitening_group, placed.p).residuals
        covariance = result.covariance[np.ix_(~old, ~old)]
        scale = np.sqrt(np.diag(covariance))  # parameters have units of their own
        values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
        known = parts.J[:, :, ~free] @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
        r = parts.r + parts.J[:, :, free] @ (placed.p - placed.chain.neutral)[free]
        precision = np.concatenate([np.ones(known.shape[2]), placed.precision[free]])
        return _Model(placed, Linearised(r, np.concatenate([known, parts.J[:, :, free]], axis=2), precision))

    def evidences(self, base: _Model, models: Sequence[_Model]) -> list[float]:
        """Log evidences of models beside everything unknown; of poses that all can predict, as the first has them."""
        whole = models[0].placed
        failed = np.any([_failed(model.placed) for model in (base, *models)], axis=0)
        root = np.sqrt(np.where(failed, 0.0, whole.residuals.weight))
        seen = [
            Linearised(root[:, None] * m.seen.r, root[:, None, None] * m.seen.J, m.seen.precision)
            for m in (base, *models)
        ]
        errors = UnknownErrors(self.bench, Scored((), base.placed), Scored((), whole), seen[:2], root)
        return [errors.evidence(linearised)[0] for linearised in seen[1:]]

    def errors(self, of: Fit, *others: Fit) -> Errors:
        """Distances of the tips of poses for which these models all have solutions."""
        counted = ~np.any([excused(_failed(fitted)) for fitted in (of, *others)], axis=0)
        distance = distances(of.chain.predict(of.p, derivatives=False), self.data)
        return summary(distance[counted], self.bench.group[counted])

    def as_it_is(self, result: Fit) -> Fit:
        """A model with nothing found anew."""
        return self._fitted(result, [t for t in result.chain.terms if t.name not in FRAMES])

    def placed(self, result: Fit) -> Fit:
        """A model in the frames that these runs show."""
        kept = [t for t in result.chain.terms if t.name not in FRAMES]
        return self._fitted(result, [*kept, *frames(result.chain.robot, self.data)])

    def _fitted(self, result: Fit, terms: Sequence[Term]) -> Fit:
        """The chain of terms with the values that they have in a fit; frames alone are fitted."""
        places = dict(zip([t.key for t in result.chain.terms], result.chain.slices(), strict=True))
        terms = [t if t.name in FRAMES else fixed(t, result.p[places[t.key]]) for t in terms]
        chain = ParametricChain(result.chain.robot, self.data, terms)
        p = valued(chain, result, chain.neutral, but=FRAMES)
        there = simulated(chain.robot, self.data, terms, p)
        return fit(there, self.bench.noise_alike, self.bench.whitening_group, p)


def _of_frames(result: Fit) -> NDArray[np.bool_]:
    """(P,) parameters of frames, and zeros after another homing."""
    return np.isin(result.chain.owners, FRAMES)


def _failed(result: Fit) -> NDArray[np.bool_]:
    """(K,) poses without a solution."""
    failed: NDArray[np.bool_] = result.chain.predict(result.p, derivatives=False).failed
    return failed
