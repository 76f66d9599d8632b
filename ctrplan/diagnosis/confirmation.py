"""Effects found on some runs, asked once on runs that nothing has read.

Model and effects stay as they were found; only the frames between robot and tracker are found anew, as they are after
every mounting: for each block of poses by the other blocks. An effect is confirmed where runs are predicted better with
it than by a model that was calibrated without it, block after block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arguments import Made, checked
from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.calibration.fit_warnings import excused, gross_outliers, too_many
from ctrplan.calibration.least_squares import Fit, fit
from ctrplan.calibration.residuals import Noise, residuals, robust_square
from ctrplan.diagnosis.correlated_bench import FRAMES, fixed, frames
from ctrplan.diagnosis.cross_validation import steps_without
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.usable_poses import blocks, usable_poses
from ctrplan.diagnosis.workbench import CERTAIN, SURE, certainty, linear, summed, values_by_name
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.followed_runs import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term

LEAST_BLOCKS = 5
MOST_POSES = 400  # of a continuous motion that are compared


@dataclass(frozen=True)
class ConfirmedEffect:
    """One effect on the new runs: the log-likelihood it gains over a model calibrated without it, and errors."""

    name: str
    gain: float
    error: float  # standard error over blocks
    z: float
    without: Errors
    verdict: str  # "confirmed", "not confirmed", "contradicted"


@dataclass(frozen=True)
class Confirmation:
    """What runs that nothing had read say of a diagnosis."""

    file: str
    sha256: str
    poses: int
    blocks: int
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
        said = [f"{e.name} {e.verdict} ({e.z:.1f} standard errors)" for e in self.effects] or ["no effect to confirm"]
        return f"On {self.file or 'new runs'}, which nothing had read: {', '.join(said)}; {errors}."

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "measurements_sha256": self.sha256,
            "poses": self.poses,
            "blocks": self.blocks,
            "calibrated_rms_mm": round(self.calibrated.rms_m * 1e3, 4),
            "before_rms_mm": round(self.before.rms_m * 1e3, 4),
            "after_rms_mm": round(self.after.rms_m * 1e3, 4),
            "effects": [
                {
                    "name": e.name,
                    "verdict": e.verdict,
                    "gain": round(e.gain, 2),
                    "standard_error": round(e.error, 2),
                    "z": round(e.z, 2),
                    "without_rms_mm": round(e.without.rms_m * 1e3, 4),
                }
                for e in self.effects
            ],
        }


@checked(diagnosis=Made("Diagnosis"), data=Made("Measurements"))
def confirm(diagnosis: Diagnosis, data: Measurements) -> Confirmation:
    """Asks the effects of a diagnosis on other runs, once.

    Raises InputError for runs that it has read, and for too few poses.
    """
    if data.sha256 and data.sha256 == diagnosis.data.sha256:
        raise InputError("must be runs that the diagnosis has not read", file=data.file, key="confirm")
    usable = usable_poses(diagnosis.robot, data)
    new = _new(diagnosis, data, usable)
    wrong = gross_outliers(new.placed(diagnosis.chosen.fit), data, usable)
    if wrong.any() and not too_many(wrong, usable):
        new = _new(diagnosis, data, usable & ~wrong)
    block, count = new.block, len(np.unique(new.block))
    whole, listed = new.predicted(diagnosis.chosen.fit), {t.key for t in (*diagnosis.listed, *diagnosis.built_terms)}
    effects = tuple(
        _confirmed(t, whole, new.predicted(_without(diagnosis, t)), block)
        for t in diagnosis.chosen.fit.chain.terms
        if t.key in listed and t.name not in FRAMES
    )
    models = (new.as_it_is(diagnosis.base.fit), new.predicted(diagnosis.base.fit), whole)
    counted = np.logical_and.reduce([model.counted for model in models])
    calibrated, before, after = (summary(model.distance_m[counted], block[counted]) for model in models)
    file = data.file or ""
    return Confirmation(file, data.sha256, new.data.count, count, calibrated, before, after, effects)


def _new(diagnosis: Diagnosis, data: Measurements, usable: NDArray[np.bool_]) -> _New:
    """The poses to go by, of `usable` ones (K,), in blocks that last as long as can be where no memory is known."""
    some = np.flatnonzero(usable)
    chosen_poses = data.subset(some[:: max(1, -(-len(some) // MOST_POSES))] if data.is_stream else some)
    if (
        data.homing is not None or diagnosis.data.homing is not None
    ):  # no run of these has the zeros of the first one there
        chosen_poses = replace(chosen_poses, homing=data.homings + 1)
    block = blocks(chosen_poses, math.inf if diagnosis.memory is None else diagnosis.memory)
    count = len(np.unique(block))
    if count < LEAST_BLOCKS:
        rule = f"has {count} usable blocks of poses, too few to confirm anything: at least {LEAST_BLOCKS}"
        raise InputError(rule, file=data.file)
    return _New(chosen_poses, _noise(diagnosis), block)


@dataclass(frozen=True, eq=False)
class _Predicted:
    loss: Array  # (K,) robust squares over the noise and the rest
    distance_m: Array  # (K,)
    counted: NDArray[np.bool_]  # (K,) with a solution


def _confirmed(t: Term, whole: _Predicted, rest: _Predicted, block: NDArray[np.int_]) -> ConfirmedEffect:
    counted = whole.counted & rest.counted
    number = np.unique(block[counted], return_inverse=True)[1].ravel()
    gains: Array = np.asarray(np.bincount(number, weights=(rest.loss - whole.loss)[counted] / 2), dtype=np.float64)
    z = certainty(gains) if gains.sum() > 0 else -certainty(-gains)
    verdict = "confirmed" if z > SURE else "contradicted" if z < -CERTAIN else "not confirmed"
    return ConfirmedEffect(t.name, *summed(gains), z, summary(rest.distance_m[counted], block[counted]), verdict)


def _noise(diagnosis: Diagnosis) -> Noise:
    """That of the measurement, and of what remains, which counts as often as poses are independent: by block."""
    rest = diagnosis.chosen.fit.noise.discrepancy
    sizes = (np.hypot(1, rest.position), np.hypot(1, rest.tangent)) if rest else (1.0, 1.0)
    return Noise(diagnosis.noise.position_m * float(sizes[0]), diagnosis.noise.tangent_rad * float(sizes[1]))


def _without(diagnosis: Diagnosis, gone: Term) -> Fit:
    """Calibrated again on the poses of the diagnosis without an effect, as the model with it was."""
    whole = diagnosis.chosen.fit
    if diagnosis.partly:
        bench, kept = diagnosis.partly.bench, [t for t in diagnosis.chosen.terms if t.name != gone.name]
        return bench.handed_over(bench.scored(kept, whole)).fit
    places = [(t, s) for t, s in zip(whole.chain.terms, whole.chain.slices(), strict=True) if t.name != gone.name]
    start = np.concatenate([whole.p[place] for _, place in places])
    return fit(whole.chain.with_terms([t for t, _ in places]), whole.noise, whole.group, start)


@dataclass(frozen=True, eq=False)
class _New:
    """Runs that a diagnosis has not read, with noise and blocks (K,)."""

    data: Measurements
    noise: Noise
    block: NDArray[np.int_]

    def as_it_is(self, result: Fit) -> _Predicted:
        """By a model with nothing found anew."""
        chain, p = self._chain(result, [t for t in result.chain.terms if t.name not in FRAMES])
        prediction = chain.predict(p, derivatives=False)
        distance = distances(prediction, self.data)
        return _Predicted(robust_square(distance / self.noise.position_m), distance, ~excused(prediction.failed))

    def predicted(self, result: Fit) -> _Predicted:
        """Each block by a model in the frames that the other blocks show, to first order; tips are those there."""
        placed = self.placed(result)
        loss, distance, failed = np.empty(self.data.count), np.empty(self.data.count), np.zeros(self.data.count, bool)
        for number, step in steps_without(linear(placed), self.block).items():
            inside = self.block == number
            part = ParametricChain(placed.chain.robot, self.data.subset(inside), placed.chain.terms)
            if placed.chain.correction is not None:
                shift, turn = placed.chain.correction
                part.correction = shift[inside], turn[inside]
            prediction = part.predict(np.clip(placed.p + step, part.lower, part.upper), derivatives=False)
            left = residuals(part.data, prediction, self.noise, np.arange(part.data.count))
            loss[inside], distance[inside] = robust_square(left.norm), distances(prediction, part.data)
            failed[inside] = prediction.failed
        return _Predicted(loss, distance, ~excused(failed))

    def placed(self, result: Fit) -> Fit:
        """A model in the frames that these runs show."""
        kept = [
            fixed(t, result.p[place])
            for t, place in zip(result.chain.terms, result.chain.slices(), strict=True)
            if t.name not in FRAMES
        ]
        chain, p = self._chain(result, [*kept, *frames(result.chain.robot, self.data)])
        return fit(chain, self.noise, np.arange(self.data.count), p)

    def _chain(self, result: Fit, terms: Sequence[Term]) -> tuple[ParametricChain, Array]:
        """The chain of terms with the values that they have in a fit, frames where nothing is displaced."""
        chain = ParametricChain(result.chain.robot, self.data, terms)
        keys = [(t.name, q.name) for t in chain.terms for q in t.parameters]
        known = {key: value for key, value in values_by_name(result).items() if key[0] not in FRAMES}
        p = np.array([known.get(key, value) for key, value in zip(keys, chain.neutral.tolist(), strict=True)])
        chain.correction = friction_correction(chain, p)
        return chain, p
