"""A certificate's allowance for parameters that are known by intervals, and for a base that is registered so well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ctrplan.planning.certificate.allowances import bound_allowance_m
from ctrplan.planning.certificate.problems import problems_of_limits
from ctrplan.planning.certificate.stated_bounds import StatedBounds
from ctrplan.planning.certificate.walked_piece import Piece
from ctrplan.planning.certified import CertificateSamples
from ctrplan.planning.uncertainty.allowance import parameter_allowance

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def with_parameters(
    scenario: Scenario, pieces: Sequence[Piece], samples: CertificateSamples, bounds: StatedBounds
) -> tuple[CertificateSamples, StatedBounds, list[str]]:
    """Samples and bounds with what is uncertain in them, and sentences about the limits that this breaks.

    The same ones and no sentence where nothing is uncertain.
    """
    allowed = parameter_allowance(scenario, samples.joints)
    if not any(column.any() for column in allowed):
        return samples, bounds, []
    if not np.all(allowed.is_finite):
        leg = samples.leg[int(np.argmin(allowed.is_finite))] + 1
        return samples, bounds, [f"On leg {leg}: a robot within the stated intervals has no equilibrium."]
    bound = allowed.bound_m
    friction = np.minimum(bounds.worst_m, samples.bound_m + bound_allowance_m(scenario.robot, "search"))
    wider = StatedBounds(bounds.goal_m + float(bound[-1]), float((friction + bound).max()))
    found = replace(
        samples,
        bound_m=samples.bound_m + bound,
        clearance_m=samples.clearance_m - allowed.clearance_m,
        stability=samples.stability - allowed.stability,
        max_strain=samples.max_strain + allowed.strain,
        parameter_bound_m=bound,
        parameter_clearance_m=allowed.clearance_m,
        parameter_stability=allowed.stability,
        parameter_strain=allowed.strain,
    )
    return found, wider, problems_of_limits(scenario, pieces, found, lambda: wider)
