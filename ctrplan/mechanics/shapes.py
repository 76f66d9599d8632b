"""What the mechanics answers: shapes, bounds, and whether they can be relied on. SI units, world frame at the plate."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.errors import InputError
from ctrplan.mechanics.core_errors import input_errors

if TYPE_CHECKING:
    from ctrplan import _model


# What a Shape has along its tubes
ALONG = frozenset({"tubes", "radius_m", "contact_s_m", "contact_force_N", "contact_angle_rad", "max_strain"})


class Status(enum.IntEnum):
    """What a solve found; nothing else promises a tip."""

    CONVERGED = 0  # residual reached, stable
    MULTIPLE = 1  # as CONVERGED, and another stable solution is known
    UNSTABLE = 2  # an equilibrium, but not a minimum of the energy: the robot would snap away from it
    FAILED = 3  # residual not reached
    # as FAILED, of single shapes only: on the way to its equilibrium friction at its full limit twists a tube by a
    # shear strain of more than 0.5, several times what any tube bears
    OVERTWISTED = 4


@dataclass(frozen=True, eq=False)
class TubeShape:
    """One tube from its collar to its tip, N stations."""

    s_m: Array  # (N,) arc length from the front plate
    centreline_m: Array  # (N, 3) world frame
    frames: Array  # (N, 3, 3) material frames, columns are the axes in the world frame
    theta_rad: Array  # (N,) material angle against the tube's twist-free frame
    curvature_per_m: Array  # (N, 3) rotation rate u in the material frame
    strain: Array  # (N,) largest bending strain r_out |u_xy - u_hat_xy|


@dataclass(frozen=True, eq=False)
class Shape:
    """An equilibrium of the robot; the centreline is the innermost tube's."""

    tubes: tuple[TubeShape, ...]  # outermost first
    radius_m: Array  # (N,) outer radius of what is there, at s_m
    contact_s_m: tuple[Array, ...]  # per pair: stations of possible contacts
    contact_force_N: tuple[Array, ...]  # per pair: normal force at each station, a discretised distribution
    contact_angle_rad: tuple[Array, ...]  # per pair: where the inner tube leans, twist-free frame
    status: Status
    residual: float  # largest imbalance of moments over the robot's own, EI * precurvature
    # smallest eigenvalue of the torsional second variation over GJ / L^2 of the innermost tube; NaN along histories
    stability: float
    max_strain: float
    equilibrium: _model.Equilibrium | None = field(default=None, repr=False)  # what the core kept of the solution

    def recheck(self) -> float:
        """`residual` evaluated anew by the core, from theta_rad and contact_force_N as they stand here.

        Offsets and friction are those that were solved for. Of the zero-clearance model all unknowns are. Raises
        InputError for arrays of other lengths, and for a shape that was unpickled, which keeps no solution.
        """
        if self.equilibrium is None:
            raise InputError("keeps no solution that could be checked again", key="shape")
        with input_errors():
            return self.equilibrium.residual([tube.theta_rad for tube in self.tubes], self.contact_force_N)

    @classmethod
    def of_core(cls, kept: _model.Shape, status: Status) -> Shape:
        """What the core keeps of a shape; what it has along its tubes is made when somebody looks at it."""
        shape = cls.__new__(cls)
        vars(shape).update(
            status=status,
            residual=kept.residual,
            stability=kept.stability,
            equilibrium=kept.equilibrium,
            _kept=kept,
        )
        return shape

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """What nobody has looked at before."""
            kept = vars(self).get("_kept")
            if kept is None or name not in ALONG:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            found = tuple(TubeShape(**tube) for tube in kept.tubes()) if name == "tubes" else getattr(kept, name)
            return vars(self).setdefault(name, found)

    def __getstate__(self) -> dict[str, Any]:
        """All fields but the solution, which lives in this process."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "equilibrium"}

    @property
    def s_m(self) -> Array:
        """(N,) arc length of the innermost tube from the front plate."""
        return self.tubes[-1].s_m

    @property
    def centreline_m(self) -> Array:
        """(N, 3) innermost tube, world frame."""
        return self.tubes[-1].centreline_m

    @property
    def tip_m(self) -> Array:
        """(3,) tip of the innermost tube, world frame."""
        kept = vars(self).get("_kept")
        tip: Array = self.centreline_m[-1] if kept is None else kept.tip_m
        return tip

    @property
    def tip_tangent(self) -> Array:
        """(3,) unit tangent at the tip, world frame."""
        kept = vars(self).get("_kept")
        tangent: Array = self.tubes[-1].frames[-1, :, 2] if kept is None else kept.tip_tangent
        return tangent


@dataclass(frozen=True, eq=False)
class Bound:
    """Largest deviations that friction can cause, over sign corners, from the frictionless clearance solution."""

    position_m: float  # of the tip
    tangent_rad: float  # of the tip tangent
    frictionless: Shape  # phi = 0
    corners: tuple[Shape, ...]  # those visited: all, phi in itertools.product((1, -1), repeat=n - 1), or extreme ones
    corner_phi: Array  # (C, n - 1) friction states of the corners, signs per pair, outermost first
    envelope_m: Array  # (N,) of the centreline, at frictionless.s_m
    worst_corner: int  # index of the corner that gives position_m

    @property
    def has_all_corners(self) -> bool:
        """Whether every corner was visited; of extreme ones alone the bound is what a search found."""
        return len(self.corners) == 1 << int(self.corner_phi.shape[1])


@dataclass(frozen=True, eq=False)
class Bounds:
    """`Bound` for K configurations, without the shapes.

    Bounds are NaN where any of the solves failed, all else but residual and status where the frictionless one did.
    """

    position_m: Array  # (K,)
    tangent_rad: Array  # (K,)
    stability: Array  # (K,)
    max_strain: Array  # (K,)
    residual: Array  # (K,)
    status: NDArray[np.int_]  # (K,) values of Status
    tip_m: Array  # (K, 3) frictionless
    tip_tangent: Array  # (K, 3)


@dataclass(frozen=True, eq=False)
class Tips:
    """Tips of K friction states and their derivatives by P parameters, per unit of each in SI units."""

    position_m: Array  # (K, 3)
    tangent: Array  # (K, 3)
    status: NDArray[np.int_]  # (K,) Status; UNSTABLE: the robot would turn away from the solution
    residual: Array  # (K,)
    max_strain: Array  # (K,)
    position_by: Array  # (K, 3, P)
    tangent_by: Array  # (K, 3, P)


@dataclass(frozen=True, eq=False)
class FrictionBodies:
    """The outermost centreline in front of the plate in S friction states, N points at the same arc lengths."""

    point_m: Array  # (S, N, 3)
    radius_m: Array  # (N,) outer radius of what is there
    solved: NDArray[np.bool_]  # (S,)
    max_strain: Array  # (S,) over all tubes
    stability: Array  # (S,) eigenvalue of the Newton matrix nearest to zero over GJ / L^2, friction included
