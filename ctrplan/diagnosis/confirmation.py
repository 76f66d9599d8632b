"""Effects found on some runs, asked once on runs that nothing has read: the same evidence, on new data.

Calibration and effects have the posterior of the first runs as their prior; only the frames between robot and tracker
and the zeros of another homing are free again, as they are after every mounting. Each effect is compared with a model
that was calibrated on the first runs without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ctrplan.base.arguments import Made, checked
from ctrplan.calibration.estimates import Errors, distances, summary
from ctrplan.diagnosis.conclusion import CERTAIN
from ctrplan.diagnosis.hypotheses import Bench, Hypothesis, Slip, bench
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.usable_poses import LEAST_POSES, blocks, thinned, usable_poses
from ctrplan.effects.effect import CATALOGUE
from ctrplan.errors import InputError
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

FRAMES = ("base_misalignment", "frame_shift", "homing_shift")  # of one mounting, found anew in the next


@dataclass(frozen=True)
class ConfirmedEffect:
    """One effect on the new runs: the evidence it gains over a model calibrated without it."""

    name: str
    log_odds: float
    without: Errors
    verdict: str  # "confirmed", "not confirmed", "contradicted"


@dataclass(frozen=True)
class Confirmation:
    """What runs that nothing had read say of a diagnosis."""

    file: str
    sha256: str
    poses: int
    before: Errors  # calibrated without any effect, in frames found anew
    after: Errors  # with all effects
    effects: tuple[ConfirmedEffect, ...]

    @property
    def sentence(self) -> str:
        """Effect by effect."""
        errors = f"{self.before.rms_m * 1e3:.2f} mm rms without effects, {self.after.rms_m * 1e3:.2f} mm with all"
        said = [f"{e.name} {e.verdict} (log odds {e.log_odds:.1f})" for e in self.effects] or ["no effect to confirm"]
        return f"On {self.file or 'new runs'}, which nothing had read: {', '.join(said)}; {errors}, frames found anew."

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "measurements_sha256": self.sha256,
            "poses": self.poses,
            "before_rms_mm": round(self.before.rms_m * 1e3, 4),
            "after_rms_mm": round(self.after.rms_m * 1e3, 4),
            "effects": [
                {
                    "name": e.name,
                    "verdict": e.verdict,
                    "log_odds": round(e.log_odds, 2),
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
    usable = np.flatnonzero(usable_poses(diagnosis.robot, data))
    if len(usable) < LEAST_POSES:
        raise InputError(f"has {len(usable)} usable poses, too few to confirm anything", file=data.file)
    asked = data.subset(thinned(data, usable))
    if data.homing is not None or diagnosis.data.homing is not None:
        asked = replace(asked, homing=data.homings + 1)  # no run of these has the zeros of the first one there
    there = bench(diagnosis.robot, asked, diagnosis.noise, ())
    old, chosen = diagnosis.answer.bench, diagnosis.answer_with_built
    kept = [t for t in chosen.terms if t.name not in FRAMES and not isinstance(t.effect, Slip)]
    whole = _asked(there, chosen)
    effects = []
    for t in kept:
        rest = old.fitted([s for s in chosen.terms if s is not t], chosen.values, chosen.sizes)
        without = _asked(there, rest)
        odds = whole.evidence - without.evidence
        least = math.log(CERTAIN / (1 - CERTAIN))
        verdict = "confirmed" if odds > least else "contradicted" if odds < -least else "not confirmed"
        effects.append(ConfirmedEffect(t.name, odds, _errors(there, without), verdict))
    before = _errors(there, _asked(there, diagnosis.answer.base))
    return Confirmation(data.file or "", data.sha256, asked.count, before, _errors(there, whole), tuple(effects))


def _asked(there: Bench, h: Hypothesis) -> Hypothesis:
    """A hypothesis on new poses, with its posterior as prior and frames that are free."""
    deviations = np.sqrt(np.diag(h.covariance))
    known = [
        Term(
            t.effect,
            tuple(
                replace(q, neutral=float(v) / q.si, start=float(v) / q.si, prior=max(float(d) / q.si, 1e-9))
                for q, v, d in zip(t.parameters, h.p[s], deviations[s], strict=True)
            ),
        )
        for t, s in zip(h.chain.terms, h.chain.slices(), strict=True)
        if t.name not in FRAMES and not isinstance(t.effect, Slip)
    ]
    base, *terms = known
    return there.fitted([*terms, *frames(there.robot, there.data)], {}, there.model.start(), (14, 4), base)


def frames(robot: Robot, data: Measurements) -> list[Term]:
    """One rigid motion, one more for every further frame that the poses are in, and zeros for every further homing."""
    effect = CATALOGUE[FRAMES[0]]
    results = [term(effect, [q.name for q in effect.parameters(robot)], robot)]
    for shift in (CATALOGUE[name] for name in FRAMES[1:]):
        if not shift.untestable(robot, data) and not (data.of_collars and shift.stage == "drive"):
            (names,) = shift.variants(robot, data)
            results.append(term(shift, names, robot))
    return [t for t in results if t.name not in robot.effects]


def _errors(there: Bench, h: Hypothesis) -> Errors:
    prediction = h.chain.predict(h.p, derivatives=False)
    kept = there.sound & prediction.sound
    return summary(distances(prediction, there.data)[kept], blocks(there.data)[kept])
