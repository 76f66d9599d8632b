"""A robot with its effects at work in it: what bounds, plans, goals and the live view evaluate.

Effects of the mechanics are in its tubes, contacts and loads, those of the drive in `drive.collars`, and how late it
follows in `drive.late_s`. The tracker's own delay and effects of the sensor change what is measured, not where the
robot is: the chain has them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctrplan.base.arrays import Array
from ctrplan.drive.legs import Collars
from ctrplan.effects.effect import CATALOGUE, Parameter
from ctrplan.effects.learned import learned as learned_table
from ctrplan.effects.learned.inputs import Situation, unit
from ctrplan.effects.learned.learned import COMMON_NOTES, FILE_NOTES, Learned, effect_of
from ctrplan.measurement.measurements import Poses
from ctrplan.pipeline.chain import Chain
from ctrplan.robot.robot import Robot
from ctrplan.storage.toml_document import Document, interval_fault


def check_effects(robot: Robot, document: Document) -> None:
    """Raises InputError for an effect that is not in the catalogue and for parameters it does not have."""
    for name, table in robot.effects.items():
        if learned_table.is_learned(name):
            for key, rule in learned_table.faults(name, table, COMMON_NOTES, robot.n):
                raise document.fault(rule, "effects", name, *([key] if key else []))
        elif name not in CATALOGUE:
            raise document.fault(f"unknown effect, known ones are {', '.join(CATALOGUE)}", "effects", name)
        known = {parameter.name: parameter for parameter in effect_of(name, table, robot.n).parameters(robot)}
        for key, value in table.items():
            if key in (FILE_NOTES if learned_table.is_learned(name) else COMMON_NOTES):
                continue
            if key not in known:
                raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, key)
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise document.fault("must be a number", "effects", name, key)
            low, high = known[key].lower, known[key].upper
            if not low <= value <= high:
                raise document.fault(f"must be from {low:g} to {high:g}", "effects", name, key)
        _check_intervals(name, table, known, document)


def _check_intervals(name: str, table: Mapping[str, Any], known: Mapping[str, Parameter], document: Document) -> None:
    intervals = table.get("ci95", {})
    if not isinstance(intervals, dict):
        raise document.fault("must be a table of intervals", "effects", name, "ci95")
    for key, ends in intervals.items():
        if key not in known:
            raise document.fault(f"unknown parameter, known ones are {', '.join(known)}", "effects", name, "ci95", key)
        if fault := interval_fault(ends, float(table.get(key, known[key].neutral))):
            raise document.fault(fault, "effects", name, "ci95", key)
        if not (known[key].lower <= ends[0] and ends[1] <= known[key].upper):
            rule = f"must be from {known[key].lower:g} to {known[key].upper:g}"
            raise document.fault(rule, "effects", name, "ci95", key)


def range_notes(
    robot: Robot, theta_commanded: ArrayLike, l_commanded: ArrayLike, poses: Poses | None = None
) -> tuple[str, ...]:
    """One sentence for each input that leaves its range, at rotations (n,) or (K, n) [rad] and translations [m] alike.

    `poses` are the K tips, for terms of the sensor; without them nothing is said about tips.
    """
    built = [given.effect for given in Chain.of(robot).acting if isinstance(given.effect, Learned)]
    if not built:
        return ()
    theta, l = np.atleast_2d(np.asarray(theta_commanded, float)), np.atleast_2d(np.asarray(l_commanded, float))  # noqa: E741
    at = Situation(theta, l, poses=poses, tubes=robot.tubes)
    return tuple(_sentence(effect, name, worst) for effect in built for name, worst in effect.leaves(at).items())


def plan_range_notes(robot: Robot, joints: Array) -> tuple[str, ...]:
    """Where built terms leave their data, as `range_notes`, at joint values (K, m) in the order of the drive."""
    return range_notes(robot, *robot.drive.commanded(joints))


def _sentence(effect: Learned, name: str, worst: float) -> str:
    span, of = effect.ranges[name], unit(name)
    ends = f"{span.low:.4g} to {span.high:.4g} {of}".rstrip()
    where = f"{name} reaches {worst:.4g} {of}".rstrip()
    return f"{effect.name} was built from data with {name} from {ends}; here {where}, and it is held at the edge."


def installed(robot: Robot) -> Robot:
    """The robot of a file with the file's effects at work; itself if it has none."""
    return with_chain(robot, Chain.of(robot)) if robot.effects else robot


def with_chain(robot: Robot, chain: Chain) -> Robot:
    """`robot` with the mechanics and the drive of a chain."""
    built = chain.mechanics
    drive = replace(built.drive, terms=_at_rest(chain), play=_play(chain), late_s=_late_s(chain))
    given = replace(
        robot, tubes=built.tubes, contacts=built.contacts, loads=built.loads, drive=drive, ideal=chain.ideal
    )
    return replace(given, model_error_m=robot.model_error_m + _not_in_shapes_m(chain))


def _not_in_shapes_m(chain: Chain) -> float:
    """How far [m] effects may move any point of the robot that shapes do not have.

    A turn of the plate moves it by its length at the largest angle.
    """
    robot = chain.mechanics
    turn_rad = sum(given.effect.largest_turn_rad(given.values, robot) for given in chain.of_stage("mechanics"))
    shift_m = sum(given.effect.largest_shift_m(given.values, robot) for given in chain.of_stage("mechanics"))
    return turn_rad * max(tube.length_m for tube in robot.tubes) + shift_m


def _at_rest(chain: Chain) -> tuple[DriveAtRest, ...]:
    able = [given for given in chain.on(None, {}).of_stage("drive") if given.effect.acts_at_rest]
    return (DriveAtRest(Chain(chain.ideal, tuple(able))),) if able else ()


def _play(chain: Chain) -> tuple[Array, Array] | None:
    """(n,) [rad], (n,) [m] how far effects that depend on directions move the collars, every way the same.

    Those of several effects add up.
    """
    able = [given for given in chain.on(None, {}).of_stage("drive") if not given.effect.acts_at_rest]
    if not able:
        return None
    n = chain.ideal.n
    moved = [given.effect.play(given.values, n) for given in able]
    return np.sum([m.theta[0] for m in moved], axis=0), np.sum([m.l[0] for m in moved], axis=0)


def _late_s(chain: Chain) -> tuple[Array, Array] | None:
    """(n,), (n,) how much later than commanded collars turn and slide; None of a drive that follows at once."""
    delays = chain.drive_delays_s(chain.ideal.n)
    return (delays[: chain.ideal.n], delays[chain.ideal.n :]) if delays.any() else None


@dataclass(frozen=True)
class DriveAtRest:
    """The drive's stage at collars (K, n), (K, n) whose last directions nobody knows."""

    chain: Chain

    def __call__(self, theta: Array, l: Array) -> tuple[Array, Array]:  # noqa: E741 (as in the equations)
        """Where collars stand that are commanded to theta [rad], l [m]."""
        moved = self.chain.drive(Collars(theta, l), np.zeros((len(theta), 2 * theta.shape[1])))
        return moved.theta, moved.l
