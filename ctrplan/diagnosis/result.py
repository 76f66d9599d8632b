"""The diagnosis as one object and as diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ctrplan.base.package import __version__, shown
from ctrplan.calibration.estimates import Errors, estimates
from ctrplan.calibration.fit_warnings import other_tubes
from ctrplan.calibration.reading import MisreadError, Reading
from ctrplan.calibration.residuals import Noise
from ctrplan.calibration.robot_content import calibrated_content, model_error_m
from ctrplan.diagnosis.adequacy import ChiSquare
from ctrplan.diagnosis.conclusion import Built, Conclusion
from ctrplan.diagnosis.correlated_bench import FRAMES
from ctrplan.diagnosis.held_out import Gap
from ctrplan.diagnosis.next_experiment import Decision, Proposal
from ctrplan.diagnosis.remainder import Place, Remainder
from ctrplan.diagnosis.slips import Slip
from ctrplan.diagnosis.verdict import Judgement, Posterior, Verdict, names_of
from ctrplan.diagnosis.workbench import Scored, SelectionStep
from ctrplan.effects.learned.learned import Learned
from ctrplan.measurement.measurements import Measurements
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot

SCHEMA_VERSION = 1


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

    judgement: Judgement
    base: Scored  # calibrated, without effects
    chosen: Scored  # with those of the verdict
    gap: Gap
    place: Place
    next_experiment: str
    proposals: tuple[Proposal, ...]
    path: tuple[SelectionStep, ...]
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
    partial: Conclusion | None = None  # what remains beside the effects, where that is the verdict
    built: Built | None = None  # a term of what the effects leave; of `chosen` too, and no cause
    named_gap: Gap | None = None  # the gap without the built term, where there is one
    framed_gap: Gap | None = None  # the gap with free frames alone, where something remains
    confirmations: tuple[ConfirmationResult, ...] = ()  # on other runs, asked once
    reading: tuple[Reading, ...] = ()  # how the columns should be read, where the file does not mean what it says
    decisions: tuple[Decision, ...] = ()  # between explanations, by poses measured to decide
    posterior: Posterior | None = None  # of effects and verdict; None where the search was interrupted
    slip: Slip | None = None  # a collar or the tracker stands elsewhere: `data` has another homing or frame from there

    @property
    def verdict(self) -> Verdict:
        """One word for what was found."""
        return self.judgement.verdict

    def headline(self) -> str:
        """The verdict and its effects, as it shows itself."""
        named = ", ".join(term.name for term in self.listed)
        return f"{self.verdict}{f' ({named})' if named else ''}"

    def show(self, height: int = 700) -> Any:
        """The report as a page within a notebook, so many pixels high; its `save` writes it."""
        import ctrplan  # pages are of a package above, and stand in the public names

        return ctrplan.show(self, height=height)

    @cached_property
    def other_tubes(self) -> list[str]:
        """Clauses about tubes that are not those of the robot file.

        Where something remains unexplained calibration may have gone there to hide it: then nothing is said of tubes.
        """
        is_settled = self.verdict in ("named", "no_missing_effect")
        return other_tubes(self.chosen.fit) if is_settled else []

    @property
    def listed(self) -> tuple[Term, ...]:
        """The effects of the verdict."""
        return tuple(finding.term for finding in self.judgement.findings)

    @property
    def together(self) -> tuple[Term, ...]:
        """What these do is done beside the effects of the verdict, by them or by another cause."""
        return self.judgement.together

    @property
    def verdict_probability(self) -> float | None:
        """How probable the verdict is; None where the search was interrupted."""
        return self.posterior.of_verdict(self.verdict, names_of(self.judgement.findings)) if self.posterior else None

    def robot_content(self) -> dict[str, Any]:
        """The content of the new robot file: calibrated, with the effects of the verdict and a free frame in it."""
        frame = [t for t in self.chosen.fit.chain.terms if t.name in FRAMES and t not in self.listed]
        effects = [*self.listed, *self.together, *self.built_terms, *frame]
        return calibrated_content(self.chosen.fit, effects, self.data, self.model_error_m)

    @property
    def rest(self) -> Remainder | None:
        """What remains in the end, beside what is named and built; None where it was not asked."""
        return self.built.rest if self.built else self.partial.rest if self.partial else None

    @property
    def built_terms(self) -> tuple[Term, ...]:
        """What was built, as it is handed over."""
        return tuple(t for t in self.chosen.terms if isinstance(t.effect, Learned))

    @property
    def model_error_m(self) -> float:
        """What the held-out set leaves beyond noise, for margins."""
        return model_error_m(self.gap.after_m, self.noise.position_m)

    def to_json(self) -> dict[str, Any]:
        """The content of diagnosis.json."""
        return {
            "reading": [reading.to_json() for reading in self.reading],
            "other_tubes": self.other_tubes,
            "slip": None if self.slip is None else {"row": self.slip.row, "joint": self.slip.joint},
            "verdict": self.verdict,
            "verdict_probability": None if self.posterior is None else round(self.verdict_probability or 0.0, 4),
            "posterior": self.posterior.to_json() if self.posterior else None,
            "effects": [self._effect(k) for k in range(len(self.judgement.findings))],
            "together": [t.name for t in self.together],
            "gap": _gap(self.gap) | self._partial_gaps(),
            "where": self.place.sentence,
            "rest": self.partial.rest_json() if self.partial else None,
            "built": self.built.to_json(self.chosen) if self.built else None,
            "next_experiment": self.next_experiment,
            "not_testable": dict(self.not_testable),
            "without": list(self.without),
            "calibration": {
                name: asdict(estimate)
                for name, estimate in estimates(self.chosen.fit, self.chosen.fit.chain.terms[0]).items()
            },
            "remaining": {
                name: _chi_square(getattr(self.judgement.adequacy, name)) for name in ("total", "between", "within")
            }
            | {"vault": _chi_square(self.gap.chi_square)},
            "path": [asdict(step) for step in self.path],
            "proposals": [_proposal(p) for p in self.proposals],
            "decisions": [decision.to_json() for decision in self.decisions],
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

    def _partial_gaps(self) -> dict[str, float]:
        gaps = {"framed_rms_mm": self.framed_gap, "named_rms_mm": self.named_gap}
        return {name: _millimetres(gap.after.rms_m) for name, gap in gaps.items() if gap}

    def _probability(self, name: str) -> float | None:
        return round(self.posterior.of_effect(name), 4) if self.posterior else None

    def _effect(self, k: int) -> dict[str, Any]:
        finding = self.judgement.findings[k]
        result = estimates(self.chosen.fit, finding.term)
        return {
            "name": finding.term.name,
            "probability": self._probability(finding.term.name),
            "alternatives": [a.term.name for a in finding.alternatives],
            "alternative_probabilities": {a.term.name: self._probability(a.term.name) for a in finding.alternatives},
            "stage": finding.term.effect.stage,
            "parameters": {name: {"value": e.value, "ci95": list(e.ci95)} for name, e in result.items()},
            **(self.partial.shares_json(finding.term) if self.partial else {}),
        }


def misread_json(error: MisreadError, robot: Robot) -> dict[str, Any]:
    """The content of diagnosis.json where nothing was fitted, because the file does not mean what it says."""
    return {
        "reading": [reading.to_json() for reading in error.readings],
        "verdict": "misread",
        "effects": [],
        "notes": list(error.data.warnings),
        "robot_sha256": robot.sha256,
        "measurements_sha256": error.data.sha256,
        "ctrplan_version": __version__,
        "schema_version": SCHEMA_VERSION,
    }


def _millimetres(value: float) -> float:
    return round(value * 1e3, 4)


def _gap(gap: Gap) -> dict[str, Any]:
    return {
        "before_rms_mm": _millimetres(gap.before.rms_m),
        "after_rms_mm": _millimetres(gap.after.rms_m),
        "noise_floor_mm": _millimetres(gap.floor_m),
        "parameters_leave_open_mm": _millimetres(gap.spread_m),
        "heldout_poses": gap.after.poses,
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
        "rms_ci95_mm": errors.rms_ci95_m and [_millimetres(x) for x in errors.rms_ci95_m],
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
