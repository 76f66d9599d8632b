"""A fit of named parameters, what it leaves and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.calibration.estimates import Estimate, estimates
from ctrplan.calibration.gross_outliers import outlier_sentences
from ctrplan.calibration.identifiability import Combination, combinations
from ctrplan.calibration.least_squares import Fit
from ctrplan.calibration.pose_errors import Errors, distances, summary
from ctrplan.calibration.robot_content import calibrated_content, model_error_m, within_file
from ctrplan.calibration.symptoms import symptoms
from ctrplan.calibration.unsolved import excused, unsolved_sentence
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.friction_path import friction_correction
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fit of named parameters. Estimates are in the units of the names."""

    fit: Fit
    estimates: Mapping[str, Estimate]
    training: Errors
    held_out: Errors | None  # None when no pose was kept aside
    nominal: Errors  # of all poses, with the file's values
    combinations: tuple[Combination, ...]  # least known first
    model_error_m: float
    notes: tuple[str, ...]
    data: Measurements
    first: Fit | None = None  # of two passes

    @property
    def robot(self) -> Robot:
        """The calibrated robot, its effects at work."""
        return self.fit.chain.installed_at(self.fit.p)

    def robot_content(self) -> dict[str, Any]:
        """The content of the new robot file; the parent is not touched."""
        effects = [t for t in self.fit.chain.terms if not t.effect.of_the_file]
        return calibrated_content(self.fit, effects, self.data, self.model_error_m, self.first)


def calibrated(
    passes: Sequence[Fit],
    everything: Measurements,
    everyones: NDArray[np.int_],
    apart: NDArray[np.bool_],
    wrong: NDArray[np.bool_],
) -> Calibration:
    """Of all poses, their groups, those kept aside and those that went wrong, (K,) each."""
    data, group, aside = everything.subset(~wrong), everyones[~wrong], apart[~wrong]
    passes, noticed = [*passes[:-1], within_file(passes[-1])], [symptom.sentence for symptom in symptoms(passes[0])]
    first, found = passes[0], passes[-1]
    robot, terms = found.chain.robot, found.chain.terms
    trained = held = PoseErrors.of(found.chain, found.p, group[~aside])
    if aside.any():
        chain = ParametricChain(robot, data.subset(aside), terms)
        chain.correction = friction_correction(chain, found.p)
        held = PoseErrors.of(chain, found.p, group[aside])
    whole = ParametricChain(robot, data, terms)
    nominal = PoseErrors.of(whole, whole.neutral, group)
    least_known = tuple(combinations(first))
    unknown = [
        f"The data can't tell {' and '.join(c.parameters)} apart from the prior: "
        f"{100 * c.posterior_share:.0f} % of it is left."
        for c in least_known
        if not c.is_known
    ]
    return Calibration(
        fit=found,
        estimates={n: e for f in reversed(passes) for t in f.chain.terms for n, e in estimates(f, t).items()},
        training=trained.errors,
        held_out=held.errors if aside.any() else None,
        nominal=nominal.errors,
        combinations=least_known,
        model_error_m=model_error_m(held.distance_m, found.noise.position_m),
        notes=(
            *data.warnings,
            *unknown,
            *unsolved_sentence(data, nominal.failed, nominal.counted, "with the file's values"),
            *_unsolved(data, aside, trained, held),
            *outlier_sentences(found, everything, wrong),
            *noticed,
        ),
        data=everything,
        first=passes[0] if len(passes) > 1 else None,
    )


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """What a fit leaves of the poses (K,) of a chain."""

    distance_m: Array  # of those that count: not where the model has no solution, unless it has none at too many
    errors: Errors
    failed: NDArray[np.bool_]  # (K,)
    counted: NDArray[np.bool_]  # (K,)

    @classmethod
    def of(cls, chain: ParametricChain, p: Array, group: NDArray[np.int_]) -> PoseErrors:
        """Of a chain at parameters (P,); `group` (K,) numbers the configurations."""
        prediction = chain.predict(p, derivatives=False)
        counted = ~excused(prediction.failed)
        distance = distances(prediction, chain.data)[counted]
        return cls(distance, summary(distance, group[counted]), prediction.failed, counted)


def _unsolved(data: Measurements, aside: NDArray[np.bool_], trained: PoseErrors, held: PoseErrors) -> list[str]:
    failed, counted = np.zeros((2, data.count), bool)
    failed[~aside], counted[~aside] = trained.failed, trained.counted
    if aside.any():
        failed[aside], counted[aside] = held.failed, held.counted
    return unsolved_sentence(data, failed, counted, "calibrated")
