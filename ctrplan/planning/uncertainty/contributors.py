"""What a worst case is made of, ranked, and what measuring one of its causes would take off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.worst_case import BaseBall

FRICTION, REGISTRATION, PLAY = "friction", "registration", "play of the drive"
UNEXPLAINED, SECOND_ORDER = "what calibration left unexplained", "beyond first order"
OFF = "distance without friction and errors"
SHOWN_M = 0.05e-3  # smaller shares are not in the sentence


@dataclass(frozen=True)
class Contributor:
    """One cause of a worst case."""

    name: str
    share_m: float  # of the worst case; shares add up to it, some may be negative
    saved_m: float  # by how much the worst case would be smaller, were this known exactly


def shares(
    parameters: UncertainParameters,
    direction: Array,
    by: Array,
    offset: Array,
    base: BaseBall,
    lever: Array,
    unexplained_m: float,
) -> dict[str, float]:
    """Shares [m] of a displacement along direction (3,), by (3, P) at offset (P,), with a lever (3,) from the base."""
    found: dict[str, float] = {}
    for title, share in zip(parameters.title, (direction @ by * offset).tolist(), strict=True):
        found[title] = found.get(title, 0.0) + share
    turned = base.rotation_rad * float(np.linalg.norm(np.cross(lever, direction)))
    rest = {REGISTRATION: base.shift_m + turned, UNEXPLAINED: unexplained_m}
    return found | {name: share for name, share in rest.items() if share}


def ranked(given: Mapping[str, float], saved: Mapping[str, float]) -> tuple[Contributor, ...]:
    """The largest share first."""
    rows = sorted(given.items(), key=lambda item: -item[1])
    return tuple(Contributor(name, share, max(saved.get(name, 0.0), 0.0)) for name, share in rows)


def sentence(worst_m: float, contributors: tuple[Contributor, ...]) -> str:
    """As "3.1 mm, of which friction 1.9, registration 0.8; measuring the registration would take 0.6 off"."""
    parts = [f"{c.name} {_digits(c.share_m)}" for c in contributors if c.share_m >= SHOWN_M]
    text = f"{_digits(worst_m)} mm" + (f", of which {', '.join(parts)}" if parts else "")
    best = max(contributors, key=lambda c: c.saved_m, default=None)
    if best is None or best.saved_m < SHOWN_M:
        return text
    return f"{text}; measuring {best.name} would take {_digits(best.saved_m)} off"


def _digits(length_m: float) -> str:
    return f"{length_m * MM_PER_M:.1f}" if length_m < 0.1 else f"{length_m * MM_PER_M:.0f}"
