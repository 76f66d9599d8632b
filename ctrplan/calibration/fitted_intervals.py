"""A fit's 95 % intervals of the robot file's own numbers, and how its errors go together: the table [uncertainty]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ctrplan.calibration.estimates import CI95
from ctrplan.calibration.least_squares import Fit
from ctrplan.effects.effect import Effect
from ctrplan.pipeline.term import Term
from ctrplan.robot.named_numbers import MAGNITUDE, with_values
from ctrplan.robot.robot import Robot
from ctrplan.robot.stated_intervals import StatedIntervals, file_key

DIGITS = 7
HELD = 1e-4  # share of what an earlier fit left uncertain, below which a later one merely held the parameter

Intervals = dict[str, tuple[float, float]]  # name of a number -> ends, SI


def uncertainty_table(found: Fit, effects: Sequence[Term], before: Fit | None = None) -> dict[str, Any]:
    """The table's content. What a second pass held keeps the interval that the first one, `before`, found for it.

    Intervals that the parent has for numbers which were not fitted stay.
    """
    chain = found.chain
    ideal = chain.robot.ideal or chain.robot
    fitted, rows = _of_fit(found, effects, ideal)
    if before is not None:
        earlier, _ = _of_fit(before, effects, ideal)
        wider = {name for name, ends in earlier.items() if np.ptp(fitted[name]) < HELD * np.ptp(ends)}
        fitted |= {name: earlier[name] for name in wider}
        rows = {name: row for name, row in rows.items() if name not in wider}
    if not fitted:
        return _kept(chain.robot.intervals, {})
    names, spread = list(rows), np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    own = np.array([rows[name] for name in names], dtype=int)
    table: dict[str, Any] = _kept(chain.robot.intervals, fitted)
    if len(names) > 1 and np.all(spread[own] > 0):
        shared = (found.covariance / np.outer(spread, spread))[np.ix_(own, own)]
        table["correlated"] = [_file_name(name) for name in names]
        table["correlation"] = np.round(shared, 6).tolist()
    return table


def _of_fit(found: Fit, effects: Sequence[Term], ideal: Robot) -> tuple[Intervals, dict[str, int]]:
    """Intervals of the file's own numbers, and where each of those and of the effects' parameters stands in the fit."""
    spread = CI95 * np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    chain, listed = found.chain, {t.key for t in effects}
    intervals: Intervals = {}
    rows: dict[str, int] = {}
    for t, place, values in zip(chain.terms, chain.slices(), chain.values(found.p), strict=True):
        for j, parameter in zip(range(place.start, place.stop), t.parameters, strict=True):
            if not t.effect.of_the_file:
                if t.key in listed:
                    rows[f"effects.{t.name}.{parameter.name}"] = j
                continue
            ends = [max(found.p[j] - spread[j], chain.lower[j]), min(found.p[j] + spread[j], chain.upper[j])]
            given = [_number(t.effect, parameter.name, end, ideal) for end in ends]
            intervals[given[0][0]] = min(x for _, x in given), max(x for _, x in given)
            rows[given[0][0]] = j
        if t.effect.of_the_file:
            ideal = with_values(ideal, t.effect.mechanics(values, ideal))
    return intervals, rows


def _number(effect: Effect, parameter: str, value: float, ideal: Robot) -> tuple[str, float]:
    """The number of the robot that a parameter is at a value; the magnitude of a precurvature that it scales."""
    named = effect.mechanics({parameter: value}, ideal)
    if len(named) == 1:
        return next(iter(named.items()))
    stem = next(iter(named)).rsplit(".", 1)[0]
    return f"{stem}.{MAGNITUDE}", math.hypot(*named.values())


def _kept(parent: StatedIntervals, fitted: Intervals) -> dict[str, Any]:
    """[uncertainty] without correlations: the parent's intervals of what was not fitted, and the new ones."""
    stems = {name.rsplit(".", 1)[0] for name in fitted if "curvature" in name}
    old = {
        name: ends
        for name, ends in parent.ci95.items()
        if name not in fitted and not ("curvature" in name and name.rsplit(".", 1)[0] in stems)
    }
    merged: Mapping[str, tuple[float, float]] = {**old, **fitted}
    if not merged:
        return {}
    in_file = {name: [_rounded(file_key(name, end)[1]) for end in ends] for name, ends in merged.items()}
    return {"ci95": {_file_name(name): ends for name, ends in in_file.items()}}


def _file_name(name: str) -> str:
    return name if name.startswith("effects.") else file_key(name, 0.0)[0]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
