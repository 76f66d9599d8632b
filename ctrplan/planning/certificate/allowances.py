"""What a certificate takes off for what was measured and not proven. docs/certificate.md says where each comes from."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ctrplan.mechanics.accuracy import Accuracy

if TYPE_CHECKING:
    from ctrplan.robot.robot import Robot

SPACING_M = 0.5e-3  # largest motion of a body point of any shape between samples
POINT_SPACING_M = 1e-3  # between the points of a shape
# Friction that differs along the contact of a pair: bodies of simulated histories were at most 0.05 mm beyond those of
# all uniform states (1,632 histories, but for a fold, which is a snap).
UNEVEN_FRICTION_M = 0.05e-3
TIGHT_M = 0.1e-3  # how much less than the clearance of solved shapes is reported where nothing was found below it
SAME_BRANCH_M = 0.5e-3  # between bodies of one friction state, walked to and solved from scratch
# Of bodies that were not solved but interpolated along the path: shares of how much their bending away from the sign
# corners changes over the samples, of that bending, and once more of it from one mesh to another.
BEND_CHANGE, BEND_SHARE, BEND_MESH, BEND_SPREAD = 0.5, 0.05, 0.2, 0.03
BEYOND_BOUND_M = 0.3e-3  # of a simulated tip: histories and bounds may be of different meshes

# Of bodies, against the model of exact geometry: 0.27 mm at most on the search mesh, 0.17 on the certificate mesh, for
# clearances between tubes below 0.1 mm. Wide ones add to it, for the model is of first order in them: 0.44 mm for each
# mm of all pairs together at most (`benchmarks/run.py allowances meshes`).
CERTIFICATE_MESH_M, SEARCH_MESH_M = 0.2e-3, 0.8e-3  # the latter on top of the former
NARROW_M, FIRST_ORDER = 0.05e-3, 0.4
# Of bounds, which are differences of tips on one mesh: 0.23 mm short at most on the search mesh, 0.007 on the
# certificate mesh, and 0.08 for each mm of clearance.
BOUND_CERTIFICATE_MESH_M, BOUND_SEARCH_MESH_M, BOUND_FIRST_ORDER = 0.02e-3, 0.3e-3, 0.1


def mesh_allowance_m(robot: Robot, accuracy: Accuracy) -> float:
    """How far [m] a body point may be from where the model of exact geometry has it."""
    loose = NARROW_M + FIRST_ORDER * float(robot.clearance_m.sum())
    return max(CERTIFICATE_MESH_M, loose) + (SEARCH_MESH_M if accuracy == "search" else 0.0)


def bound_allowance_m(robot: Robot, accuracy: Accuracy) -> float:
    """How much [m] a bound of the tip may be short of the one of exact geometry; 0 without friction."""
    if not robot.friction.any():
        return 0.0
    loose = BOUND_FIRST_ORDER * float(robot.clearance_m.sum())
    return BOUND_CERTIFICATE_MESH_M + loose + (BOUND_SEARCH_MESH_M if accuracy == "search" else 0.0)
