"""Other ways from a path's start to its end: what reordering chooses from, and what it is compared with."""

from __future__ import annotations

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.units import MM_PER_M
from ctrplan.drive.legs import merge_legs
from ctrplan.planning.certificate.prediction import goal_error, start_states
from ctrplan.planning.motion import MotionChecker
from ctrplan.planning.planned_motion import ComparedWay, leg_kind

HELD_BACK_M = (2e-3, 5e-3, 10e-3)  # of a translation, driven after the last rotation
RELEASED_M = 10e-3  # of translation after which nothing more is gained (Section V-B)


def held_back(checker: MotionChecker, corners: Array) -> list[Array]:
    """The path (K, m) with some translation moved behind its last rotation, so that the last leg releases friction.

    A translation before that rotation stops short or goes too far by a little; where there is none, the tubes retreat
    and come back. Empty where the path ends with a long translation anyway.
    """
    is_rotation = checker.space.drive.is_rotation
    steps = np.diff(corners, axis=0)
    rotations = np.flatnonzero(np.any(steps[:, is_rotation], axis=1))
    if not len(rotations) or np.abs(steps[rotations[-1] + 1 :, ~is_rotation]).sum() >= RELEASED_M:
        return []
    last = int(rotations[-1])
    ways = []
    for joint in np.flatnonzero(~is_rotation):
        for length in HELD_BACK_M:
            for offset in (length, -length):
                shift = np.where(np.arange(len(is_rotation)) == joint, offset, 0.0)
                rest = corners[last + 2 :] if last + 2 < len(corners) else corners[-1:]
                way = [*corners[: last + 1], corners[last] + shift, corners[last + 1] + shift, *rest]
                if last > 0 and not np.any(steps[last - 1, is_rotation]):
                    del way[last]  # the translation before the rotation goes there at once
                ways.append(merge_legs(np.array(way)))
    return [way for way in ways if checker.space.allowed(way)]


def translations_first(checker: MotionChecker, corners: Array) -> Array:
    """(K, m) all translations of the path at once, then all its rotations."""
    a, b = corners[0], corners[-1]
    return merge_legs(np.array([a, np.where(checker.space.drive.is_rotation, a, b), b]))


def straight_line(corners: Array) -> Array:
    """(2, m) all joints of the path together."""
    return corners[[0, -1]]


def alternative(checker: MotionChecker, name: str, corners: Array) -> ComparedWay:
    """What a way (K, m) would leave at the goal, and why it must not be driven if so."""
    length = sum(checker.space.length_mm(step) for step in np.diff(corners, axis=0))
    scenario, is_allowed = checker.scenario, checker.space.allowed(corners)
    error = goal_error(scenario.robot, corners, start_states(scenario)) if is_allowed else np.inf
    return ComparedWay(name, error, float(length), checker.along(corners).reason)


def changes(checker: MotionChecker, before: Array, after: Array) -> tuple[str, ...]:
    """Sentences about what reordering did to a path (K, m), now (L, m)."""
    if before.shape == after.shape and np.array_equal(before, after):
        return ("Nothing was reordered: no other order is valid and better.",)
    sentences = [f"{_kinds(checker, before)} became {_kinds(checker, after)}."]
    beyond = _excess(after, before)[~checker.space.drive.is_rotation]
    if beyond.max(initial=0.0) > 0:
        shown = f"{beyond.max() * MM_PER_M:.1f} mm"
        sentences.append(
            f"The tubes retreat by {shown} before the last rotation and come back, which releases friction."
        )
    return tuple(sentences)


def _kinds(checker: MotionChecker, corners: Array) -> str:
    kinds = [leg_kind(checker.space.drive, a, b) for a, b in zip(corners[:-1], corners[1:], strict=True)]
    return f"{len(kinds)} leg{'' if len(kinds) == 1 else 's'} ({', '.join(kinds)})"


def _excess(after: Array, before: Array) -> Array:
    """(m,) joint travel that the path has gained, half of it out and half back."""
    travel: Array = (np.abs(np.diff(after, axis=0)).sum(axis=0) - np.abs(np.diff(before, axis=0)).sum(axis=0)) / 2
    return np.where(travel > 1e-9, travel, 0.0)
