"""Made-up measurements: random configurations, each approached from both sides and after a decreasing oscillation."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ctrplan.base.arrays import Array
from ctrplan.calibration.parameters import BaseParameters
from ctrplan.effects.effect import CATALOGUE
from ctrplan.files.robot_file import robot_from_dict
from ctrplan.measurement.measurements import Measurements, is_streamed
from ctrplan.mechanics.core import Mechanics
from ctrplan.mechanics.shapes import Status, Tips
from ctrplan.pipeline import tip_table
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term, term
from ctrplan.robot.robot import Robot

QUARTER = np.radians(90.0)
OSCILLATION = np.radians([40.0, -36.0, 32.0, -28.0, 24.0, -20.0, 16.0, -12.0, 8.0, -4.0])
SIGMA_M, SIGMA_RAD = 0.1e-3, np.radians(0.15)


def pair_robot(**keys: object) -> Robot:
    """Two tubes, quick to solve."""
    outer = {"length_mm": 60, "curvature_x_per_m": 0, "curvature_y_per_m": 5.0}
    straight = {"length_mm": 30, "curvature_x_per_m": 0, "curvature_y_per_m": 0}
    inner = {"length_mm": 70, "curvature_x_per_m": 0, "curvature_y_per_m": 9.0}
    content = {
        "name": "pair",
        "tube": [
            _tube(2.4, 2.0, 0.04, [outer]),
            _tube(1.9, 1.6, 0.02, [straight, inner]),
        ],
        "contact": [{"friction_coefficient": 0.0}],
        "measurement": {"position_sigma_mm": SIGMA_M * 1e3, "tangent_sigma_deg": float(np.degrees(SIGMA_RAD))},
    }
    return robot_from_dict(content | keys)


def _tube(outer: float, inner: float, stiffness: float, sections: list[dict[str, float]]) -> dict[str, object]:
    return {
        "outer_diameter_mm": outer,
        "inner_diameter_mm": inner,
        "bending_stiffness_Nm2": stiffness,
        "poisson_ratio": 0.3,
        "section": sections,
    }


def waypoints(robot: Robot, count: int, seed: int = 0) -> Measurements:
    """`count` configurations from every side by 90 degrees and after an oscillation; poses are zero."""
    rng = np.random.default_rng(seed)
    n = robot.n
    free = [outer.length_m - inner.length_m for outer, inner in itertools.pairwise(robot.tubes)]
    rows, sequence, run = [], [], 0
    for _ in range(count):
        theta = rng.uniform(-np.pi, np.pi, n)
        theta[0] = 0.0
        l = np.concatenate([[0.0], np.cumsum([share * rng.uniform(0.1, 0.6) for share in free])])  # noqa: E741
        signs = itertools.product((1, -1), repeat=n - 1)
        approaches = [[QUARTER * np.array(sign)] for sign in signs] + [[a * np.ones(n - 1) for a in OSCILLATION]]
        for turns in approaches:
            for turn in [*turns, np.zeros(n - 1)]:
                rows.append([*(theta - np.concatenate([[0.0], np.cumsum(turn)])), *l])
                sequence.append(run)
            run += 1
    table, runs = np.array(rows), np.array(sequence)
    last = np.flatnonzero(np.diff(runs, append=run) != 0)
    nothing = np.zeros((len(last), 3))
    time_s = np.arange(len(runs), dtype=float)
    return Measurements(
        runs, table[:, :n], table[:, n:], last, nothing, nothing, time_s, is_streamed(runs, last, table)
    )


def chain_of(robot: Robot, data: Measurements, effects: Mapping[str, list[str] | None]) -> ParametricChain:
    """A chain with the base and effects, all parameters or the named ones."""
    base = BaseParameters()
    names = [parameter.name for parameter in base.parameters(robot)]
    terms: list[Term] = [term(base, names, robot)]
    for name, chosen in effects.items():
        effect = CATALOGUE[name]
        terms.append(term(effect, chosen or [p.name for p in effect.parameters(robot)], robot))
    return ParametricChain(robot, data, terms)


def measured(
    robot: Robot,
    data: Measurements,
    values: Mapping[str, Mapping[str, float]] | None = None,
    seed: int = 1,
    noise: float = 1.0,
) -> Measurements:
    """Poses of the chain with some values, in their names' units, and Gaussian noise."""
    given = values or {}
    chain = chain_of(robot, data, {name: list(v) for name, v in given.items() if name != "calibration"})
    p = chain.neutral.copy()
    for t, place in zip(chain.terms, chain.slices(), strict=True):
        for j, parameter in zip(range(place.start, place.stop), t.parameters, strict=True):
            p[j] = given.get(t.name, {}).get(parameter.name, parameter.neutral) * parameter.si
    found = chain.predict(p, derivatives=False)
    rng = np.random.default_rng(seed)
    position = found.position_m + noise * SIGMA_M * rng.standard_normal(found.position_m.shape)
    turn = noise * SIGMA_RAD * rng.standard_normal(found.tangent.shape)
    tangent = found.tangent + np.cross(turn, found.tangent)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return Measurements(
        data.sequence,
        data.theta_commanded,
        data.l_commanded,
        data.rows,
        position,
        tangent,
        data.time_s,
        data.is_stream,
        file="made up",
    )


def write_csv(path: Path, data: Measurements) -> None:
    """In the format of the reader."""
    n = data.n
    header = ["sequence", "time_s", *(f"theta_{i + 1}_rad" for i in range(n)), *(f"l_{i + 1}_m" for i in range(n))]
    lines = [",".join([*header, "x_m", "y_m", "z_m", "tx", "ty", "tz"])]
    pose = {int(row): [*p, *t] for row, p, t in zip(data.rows, data.position_m, data.tangent, strict=True)}
    for k in range(len(data.sequence)):
        time = 0.0 if data.time_s is None else data.time_s[k]
        cells = [
            str(data.sequence[k]),
            repr(float(time)),
            *map(repr, map(float, [*data.theta_commanded[k], *data.l_commanded[k]])),
        ]
        cells += [repr(float(x)) for x in pose[k]] if k in pose else [""] * 6
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")


def without_solutions(data: Measurements, configurations: list[int], patch: pytest.MonkeyPatch) -> set[int]:
    """The solver fails in some configurations from now on, 3 mm off; rows of the file that are measured there."""
    lost = np.isin(data.configuration, configurations)
    theta, solve = data.theta_commanded[data.rows][lost], Mechanics.tips_with_friction

    def failing(self: Mechanics, theta_b: Array, *arguments: object, **keys: object) -> Tips:
        tips = solve(self, theta_b, *arguments, **keys)  # type: ignore[arg-type]
        off = (np.abs(theta_b[:, None] - theta[None]).max(axis=2) < 1e-6).any(axis=1)
        status, position = tips.status.copy(), tips.position_m.copy()
        status[off], position[off] = Status.FAILED, position[off] + [3e-3, 0, 0]
        return replace(tips, status=status, position_m=position)

    patch.setattr(Mechanics, "tips_with_friction", failing)
    patch.setattr(tip_table, "_remembered", tip_table._remembered.__wrapped__)  # none of before or after
    return set((data.rows[lost] + 1).tolist())
