"""The samples of all pieces of a path in one table."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.planning.certificate.prediction import start_load
from ctrplan.planning.certificate.walked_piece import Piece
from ctrplan.planning.certified import CertificateSamples
from ctrplan.planning.joint_space import JointSpace
from ctrplan.planning.motion import released_error
from ctrplan.robot.friction_calibration import friction_law

if TYPE_CHECKING:
    from ctrplan.planning.scenario import Scenario


def joined_samples(scenario: Scenario, space: JointSpace, corners: Array, pieces: list[Piece]) -> CertificateSamples:
    """One table over all pieces; the first sample of every piece but the first repeats the last one before it."""
    starts = np.append(0.0, np.cumsum(space.lengths_mm(np.diff(corners, axis=0))))
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in CertificateSamples.__dataclass_fields__}
    load = start_load(scenario)
    for number, piece in enumerate(pieces):
        s = piece.samples
        keep = slice(0 if number == 0 else 1, None)
        joints = piece.start + s.fraction[:, None] * (piece.end - piece.start)
        ends = space.drive.collars(np.array([piece.start, piece.end]))
        loads = friction_law(scenario.robot).load_left(load, *ends, s.fraction)
        load = loads[-1]
        rows: dict[str, NDArray[Any]] = {
            "leg": np.full(len(s.fraction), piece.leg),
            "joints": joints,
            "path_mm": starts[piece.leg] + space.lengths_mm(joints - corners[piece.leg]),
            "bound_m": s.position_m,
            "bound_rad": s.tangent_rad,
            "stability": piece.stability,
            "max_strain": piece.max_strain,
            "clearance_m": piece.clearance_m,
            "motion_m": s.motion_m,
            "tip_m": s.tip_m,
            "released_m": released_error(s, loads),
            "predicted_m": s.position_m,  # until it is simulated
            "play_m": np.full(len(s.fraction), piece.play_m),
            "parameter_bound_m": np.zeros(len(s.fraction)),  # until they are allowed for
            "parameter_clearance_m": np.zeros(len(s.fraction)),
            "parameter_stability": np.zeros(len(s.fraction)),
            "parameter_strain": np.zeros(len(s.fraction)),
        }
        for name, values in rows.items():
            columns[name].append(values[keep])
    return CertificateSamples(**{name: np.concatenate(parts) for name, parts in columns.items()})


def looked_at_samples(samples: CertificateSamples, pieces: list[Piece]) -> CertificateSamples:
    """The table with what a closer look at the pieces found to be left."""

    def column(name: str) -> Array:
        return np.concatenate([getattr(piece, name)[number > 0 :] for number, piece in enumerate(pieces)])

    return replace(
        samples,
        clearance_m=column("clearance_m"),
        stability=column("stability"),
        max_strain=column("max_strain"),
    )
