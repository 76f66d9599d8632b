"""What a worst case is made of, ranked, and what measuring one of its causes would take off."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.uncertain.parameters import UncertainParameters
from ctrplan.uncertain.worst_case import BaseBall

FRICTION, REGISTRATION, PLAY = "friction", "registration", "play of the drive"
UNEXPLAINED, SECOND_ORDER = "what calibration left unexplained", "beyond first order"
OFF = "distance without friction and errors"
OFF_DIRECTION = "angle without friction and errors"
SHOWN_M, SHOWN_RAD = 0.05e-3, math.radians(0.05)  # smaller shares are not in the sentence


@dataclass(frozen=True)
class Contributor:
    """One cause of a worst case."""

    name: str
    share_m: float  # of the worst case; shares add up to it, some may be negative
    saved_m: float  # by how much the worst case would be smaller, were this known exactly


@dataclass(frozen=True)
class TurnContributor:
    """The same of an angle."""

    name: str
    share_rad: float
    saved_rad: float


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
    return tuple(Contributor(*row) for row in _ranked(given, saved))


def ranked_turns(given: Mapping[str, float], saved: Mapping[str, float]) -> tuple[TurnContributor, ...]:
    """The largest share first."""
    return tuple(TurnContributor(*row) for row in _ranked(given, saved))


def sentence(worst_m: float, contributors: tuple[Contributor, ...]) -> str:
    """As "3.1 mm, of which friction 1.9, registration 0.8; measuring the registration would take 0.6 off"."""
    causes = [(c.name, c.share_m, c.saved_m) for c in contributors]
    return _told(f"{_digits(worst_m)} mm", [(n, _digits(a), _digits(b), a, b) for n, a, b in causes], SHOWN_M)


def turn_sentence(worst_rad: float, contributors: tuple[TurnContributor, ...]) -> str:
    """As "3.1 deg, of which friction 1.9, registration 0.8; measuring the registration would take 0.6 off"."""
    causes = [(c.name, c.share_rad, c.saved_rad) for c in contributors]
    told = [(n, f"{math.degrees(a):.1f}", f"{math.degrees(b):.1f}", a, b) for n, a, b in causes]
    return _told(f"{math.degrees(worst_rad):.1f} deg", told, SHOWN_RAD)


def _ranked(given: Mapping[str, float], saved: Mapping[str, float]) -> list[tuple[str, float, float]]:
    rows = sorted(given.items(), key=lambda item: -item[1])
    return [(name, share, max(saved.get(name, 0.0), 0.0)) for name, share in rows]


def _told(whole: str, causes: Iterable[tuple[str, str, str, float, float]], shown: float) -> str:
    """Causes are name, share and saving in digits, and as numbers."""
    known = list(causes)
    parts = [f"{name} {digits}" for name, digits, _, share, _ in known if share >= shown]
    text = whole + (f", of which {', '.join(parts)}" if parts else "")
    best = max(known, key=lambda cause: cause[4], default=None)
    if best is None or best[4] < shown:
        return text
    return f"{text}; measuring {best[0]} would take {best[2]} off"


def _digits(length_m: float) -> str:
    return f"{length_m * MM_PER_M:.1f}" if length_m < 0.1 else f"{length_m * MM_PER_M:.0f}"
