"""The diagnosis as one object and as diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from ctrplan.base.package import __version__, shown
from ctrplan.calibration.estimates import Errors, estimates
from ctrplan.calibration.residuals import Noise
from ctrplan.calibration.robot_content import calibrated_content, model_error_m
from ctrplan.diagnosis.built_term import Built
from ctrplan.diagnosis.conclusion import Judgement, Verdict
from ctrplan.diagnosis.gap import ChiSquare, Fitted, Gap, Place
from ctrplan.diagnosis.hypotheses import Hypothesis, Slip
from ctrplan.diagnosis.next_experiment import Proposal
from ctrplan.diagnosis.posterior_search import Answer
from ctrplan.diagnosis.reading import Reading
from ctrplan.effects.learned.learned import Learned
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

SCHEMA_VERSION = 2
SETS_TOLD = 8  # of the most probable sets of effects, in files and on pages


class ConfirmationResult(Protocol):
    """What other runs say of a diagnosis, `confirmation.py`."""

    @property
    def sentence(self) -> str:
        """Effect by effect."""

    def to_json(self) -> dict[str, Any]:
        """For diagnosis.json."""


@shown
@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `ctrplan diagnose` found; lengths in metres, angles in radians, parameters in their names' units."""

    verdict: Verdict
    judgement: Judgement
    answer: Answer  # every hypothesis that was asked, with its posterior probability
    base: Fitted  # calibrated, without effects
    chosen: Fitted  # with those of the verdict, and what was built
    gap: Gap
    place: Place
    remaining: ChiSquare  # of the poses that were fitted, beside the effects
    next_experiment: str
    proposals: tuple[Proposal, ...]
    not_testable: Mapping[str, str]
    without: tuple[str, ...]  # effects that were left out of the catalogue
    notes: tuple[str, ...]
    robot: Robot
    data: Measurements
    noise: Noise
    coverage: float  # share of the poses that were used
    outlier_rows: tuple[int, ...]  # rows of the file, from 1
    interrupted: bool
    time_s: float
    readings: tuple[Reading, ...] = ()  # other readings of the columns that explain more, where it was fitted as read
    built: Built | None = None  # a term of what the effects leave; of `chosen` too, and no cause
    named_gap: Gap | None = None  # the gap without the built term, where there is one
    confirmations: tuple[ConfirmationResult, ...] = ()  # on other runs, asked once

    def headline(self) -> str:
        """The verdict and its effects, as it shows itself."""
        named = ", ".join(term.name for term in self.listed)
        return f"{self.verdict}{f' ({named})' if named else ''}"

    def show(self, height: int = 700) -> Any:
        """The report as a page within a notebook, so many pixels high; its `save` writes it."""
        import ctrplan  # pages are of a package above, and stand in the public names

        return ctrplan.show(self, height=height)

    @property
    def listed(self) -> tuple[Term, ...]:
        """The effects of the verdict."""
        return tuple(finding.term for finding in self.judgement.findings)

    @property
    def answer_with_built(self) -> Hypothesis:
        """The hypothesis that is handed over."""
        return self.built.hypothesis if self.built else self.judgement.chosen

    def robot_content(self) -> dict[str, Any]:
        """The content of the new robot file: calibrated, with the effects of the verdict, but none of one run alone."""
        effects = [t for t in (*self.listed, *self.built_terms) if not isinstance(t.effect, Slip)]
        return calibrated_content(self.chosen.fit, effects, self.data, self.model_error_m)

    @property
    def built_terms(self) -> tuple[Term, ...]:
        """What was built, as it is handed over."""
        return tuple(t for t in self.chosen.terms if isinstance(t.effect, Learned))

    @property
    def model_error_m(self) -> float:
        """What poses kept aside leave beyond noise, for margins."""
        return model_error_m(self.gap.after_m, self.noise.position_m)

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        judgement = self.judgement
        return {
            "verdict": self.verdict,
            "probability": _probability(judgement.probability),
            "reading": reading_json(self.readings, self.data),
            "effects": [self._effect(k) for k in range(len(judgement.findings))],
            "posterior": self._posterior(),
            "unnamed": judgement.unnamed.to_json(),
            "tubes": [fault.to_json() for fault in judgement.tubes],
            "gap": _gap(self.gap)
            | ({"named_rms_mm": _millimetres(self.named_gap.after.rms_m)} if self.named_gap else {}),
            "where": self.place.sentence,
            "built": self._built(),
            "next_experiment": self.next_experiment,
            "not_testable": dict(self.not_testable),
            "without": list(self.without),
            "calibration": {
                name: asdict(estimate)
                for name, estimate in estimates(self.chosen.fit, self.chosen.fit.chain.terms[0]).items()
            },
            "remaining": {"total": _chi_square(self.remaining), "vault": _chi_square(self.gap.chi_square)},
            "proposals": [_proposal(p) for p in self.proposals],
            "confirmations": [confirmation.to_json() for confirmation in self.confirmations],
            "notes": list(self.notes),
            "coverage": self.coverage,
            "outlier_rows": list(self.outlier_rows),
            "interrupted": self.interrupted,
            "time_s": round(self.time_s, 1),
            "robot_sha256": self.robot.sha256,
            "measurements_sha256": self.data.sha256,
            "ctrplan_version": __version__,
            "schema_version": SCHEMA_VERSION,
        }

    def _posterior(self) -> dict[str, Any]:
        answer = self.answer
        told = list(zip(answer.hypotheses, answer.posterior.tolist(), strict=True))[:SETS_TOLD]
        return {
            "none": _probability(answer.of_none),
            "effects": {name: _probability(share) for name, share in answer.of_effects.items()},
            "sets": [
                {
                    "effects": sorted(h.names),
                    "log_evidence_over_none": round(h.evidence - answer.base.evidence, 2),
                    "probability": _probability(share),
                }
                for h, share in told
            ],
            "asked": len(answer.hypotheses),
        }

    def _effect(self, k: int) -> dict[str, Any]:
        finding = self.judgement.findings[k]
        result = estimates(self.chosen.fit, finding.term)
        return {
            "name": finding.term.name,
            "probability": _probability(finding.probability),
            "alternatives": [a.term.name for a in finding.alternatives],
            "probabilities_of_alternatives": [_probability(a.probability) for a in finding.alternatives],
            "stage": finding.term.effect.stage,
            "parameters": {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in result.items()},
        }

    def _built(self) -> dict[str, Any] | None:
        if not self.built:
            return None
        chain = self.chosen.fit.chain
        values = {t.key: value for t, value in zip(chain.terms, chain.values(self.chosen.fit.p), strict=True)}
        return {
            "terms": [
                {
                    "name": t.name,
                    **t.effect.stated(values[t.key]),
                    "parameters": {
                        name: {"value": e.value, "ci95": list(e.ci95)}
                        for name, e in estimates(self.chosen.fit, t).items()
                    },
                }
                for t in self.built_terms
            ],
            "stage": self.built.stage,
            "log_odds": round(self.built.gain, 2),
            "share_of_unnamed": round(self.built.share, 3),
        }


def reading_json(readings: tuple[Reading, ...], data: Measurements) -> dict[str, Any]:
    """How the file was read, and how it should be where another reading explains more."""
    return {
        "poses": "on a continuous motion" if data.is_stream else "at rest",
        "faults": [reading.to_json() for reading in readings],
    }


def _probability(value: float) -> float:
    return round(min(max(value, 0.0), 1.0), 5)


def _millimetres(value: float) -> float:
    return round(value * 1e3, 4)


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "before_rms_mm": _millimetres(gap.before.rms_m),
        "after_rms_mm": _millimetres(gap.after.rms_m),
        "noise_floor_mm": _millimetres(gap.floor_m),
        "parameters_leave_open_mm": _millimetres(gap.spread_m),
        "radius95_mm": _millimetres(gap.radius_m),
        "heldout_poses": gap.after.poses if gap.is_aside else 0,
        "before_max_mm": _millimetres(gap.before.max_m),
        "after_max_mm": _millimetres(gap.after.max_m),
        "uncalibrated_rms_mm": _millimetres(gap.nominal.rms_m),
        "before": _errors(gap.before),
        "after": _errors(gap.after),
        "regions": {
            name: {"before": _errors(before), "after": _errors(after)} for name, (before, after) in gap.regions.items()
        },
    }


def _errors(errors: Errors) -> dict[str, Any]:
    return {
        "mean_mm": _millimetres(errors.mean_m),
        "rms_mm": _millimetres(errors.rms_m),
        "rms_ci95_mm": [_millimetres(x) for x in errors.rms_ci95_m],
        "p95_mm": _millimetres(errors.p95_m),
        "max_mm": _millimetres(errors.max_m),
        "poses": errors.poses,
    }


def _chi_square(chi_square: ChiSquare) -> dict[str, float]:
    return {"chi_square_per_dof": round(chi_square.ratio, 4), "p": float(f"{chi_square.p:.3g}")}


def _proposal(p: Proposal) -> dict[str, Any]:
    return {
        "theta_deg": [round(x, 2) for x in np.degrees(p.theta_commanded).tolist()],
        "l_mm": [round(x, 3) for x in (p.l_commanded * 1e3).tolist()],
        "expected_log_odds": round(p.log_odds, 2),
        "between": list(p.between),
    }
