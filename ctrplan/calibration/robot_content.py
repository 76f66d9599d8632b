"""A fit -> a new robot file: calibrated values with 95 % intervals, effects, and where all of it comes from."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import CHI95, CI95, LEVEL, Array
from ctrplan.base.package import __version__
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.least_squares import Fit, fit
from ctrplan.effects.effect import Effect, Parameter
from ctrplan.errors import CtrplanError
from ctrplan.measurement.approach import friction_state
from ctrplan.measurement.measurements import SAME_TRANSLATION_M, Measurements
from ctrplan.pipeline.chain import taken_along
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.pipeline.tip_table import tip_table
from ctrplan.robot.named_numbers import MAGNITUDE, MOST_RATIO, with_plain_keys, with_values
from ctrplan.robot.robot import Robot, StatedIntervals, file_key

CONSTRAINED = (
    1e-4  # share of what an earlier fit left uncertain, below which a later one merely constrained the parameter
)

Intervals = dict[str, tuple[float, float]]  # name of a number -> ends, SI


def uncertainty_table(result: Fit, effects: Sequence[Term], before: Fit | None = None) -> dict[str, Any]:
    """The table's content. What a second pass held keeps the interval that the first one, `before`, found for it.

    Intervals that the parent has for numbers which were not fitted stay.
    """
    chain = result.chain
    ideal = chain.robot.ideal or chain.robot
    fitted, rows = _of_fit(result, effects, ideal)
    if before is not None:
        earlier, _ = _of_fit(before, effects, ideal)
        wider = {name for name, ends in earlier.items() if np.ptp(fitted[name]) < CONSTRAINED * np.ptp(ends)}
        fitted |= {name: earlier[name] for name in wider}
        rows = {name: row for name, row in rows.items() if name not in wider}
    if not fitted:
        return _kept(chain.robot.intervals, {})
    names, spread = list(rows), np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    own = np.array([rows[name] for name in names], dtype=int)
    table: dict[str, Any] = _kept(chain.robot.intervals, fitted)
    if len(names) > 1 and np.all(spread[own] > 0):
        shared = (result.covariance / np.outer(spread, spread))[np.ix_(own, own)]
        table["correlated"] = [_file_name(name) for name in names]
        table["correlation"] = np.round(shared, 6).tolist()
    return table


def _of_fit(result: Fit, effects: Sequence[Term], ideal: Robot) -> tuple[Intervals, dict[str, int]]:
    """Intervals of the file's own numbers, and where each of those and of the effects' parameters stands in the fit."""
    spread = CI95 * np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    chain, listed = result.chain, {t.key for t in effects}
    intervals: Intervals = {}
    rows: dict[str, int] = {}
    for t, place, values in zip(chain.terms, chain.slices(), chain.values(result.p), strict=True):
        for j, parameter in zip(range(place.start, place.stop), t.parameters, strict=True):
            if not t.effect.of_the_file:
                if t.key in listed:
                    rows[f"effects.{t.name}.{parameter.name}"] = j
                continue
            ends = [max(result.p[j] - spread[j], chain.lower[j]), min(result.p[j] + spread[j], chain.upper[j])]
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


DIGITS = 7  # of numbers in the file


def within_file(result: Fit) -> Fit:
    """The fit `result`; refitted where a tube's Poisson ratio lies outside the range that a robot file may state."""
    chain = result.chain
    terms = [Term(t.effect, tuple(_possible(p) for p in t.parameters)) for t in chain.terms]
    inside = chain.with_terms(terms)
    if np.all(result.p <= inside.upper):
        return result
    return fit(inside, result.noise, result.group, result.p)


def _possible(parameter: Parameter) -> Parameter:
    is_ratio = "poisson_ratio" in parameter.name and parameter.neutral <= MOST_RATIO
    return replace(parameter, upper=min(parameter.upper, MOST_RATIO)) if is_ratio else parameter


def calibrated_content(
    result: Fit, effects: Sequence[Term], data: Measurements, model_error_m: float, before: Fit | None = None
) -> dict[str, Any]:
    """The content of the new file: the parent's with the fitted numbers in it. The parent is not touched.

    Read again it is the robot of the fit: the file's own numbers are those before its effects, and of an effect that
    the parent has already only what was fitted changes. 95 % intervals of effects stand beside their values, those of
    the file's own numbers in [uncertainty]; `before` is the first of two passes.
    """
    chain = result.chain
    content = with_plain_keys(chain.robot.content)
    ideal, tables = chain.robot.ideal or chain.robot, content.setdefault("effects", {})
    for t, values in zip(chain.terms, chain.values(result.p), strict=True):
        if t.effect.of_the_file:
            named = t.effect.mechanics(values, ideal)
            _put(content, named)
            for name, table in taken_along(tables, chain.robot, named).items():
                tables[name] = {key: _rounded(v) if isinstance(v, float) else v for key, v in table.items()}
            ideal = with_values(ideal, named)
    for t in effects:
        fitted, table = estimates(result, t), tables.setdefault(t.name, {})
        table |= t.effect.stated({name: e.value * _si(t, name) for name, e in fitted.items()})
        table |= {name: e.value for name, e in fitted.items()}
        table["ci95"] = {**table.get("ci95", {}), **{name: list(e.ci95) for name, e in fitted.items()}}
    if not tables:
        del content["effects"]
    content.pop("uncertainty", None)
    if uncertainty := uncertainty_table(result, effects, before):
        content["uncertainty"] = uncertainty
    content["model_error_mm"] = _rounded(model_error_m * 1e3)
    memory = friction_memory(chain.installed_at(result.p), data, result.noise.position_m)
    if memory is not None:
        content["friction_memory"] = _rounded(memory)
    content["provenance"] = _provenance(chain, data)
    return content


ERASED = 0.1  # of the bound: less than that the model leaves of two approaches to one configuration
LEAST_PAIRS = 6  # of poses, from which a share is estimated


def friction_memory(robot: Robot, data: Measurements, position_sigma_m: float) -> float | None:
    """Share of the friction bound that contacts keep after slip that erases all in the model; None where data are few.

    Of poses of one configuration, reached in two ways after which the simulated robot stands at one place: the rms of
    half their distance over the bound, noise and what the model leaves taken out in squares.
    """
    group = data.configuration
    repeated = [rows for rows in (np.flatnonzero(group == g) for g in np.unique(group)) if len(rows) > 1]
    if not repeated or np.any(data.seen_marker) or robot.n < 2 or data.of_collars:
        return None
    collars = robot.collars(data.theta_commanded, data.l_commanded)
    rule_m, slides = _by_rule(robot, data, collars), _slides(data)
    pairs: list[tuple[int, int, float]] = []  # of poses, and the bound
    for poses in repeated:
        row = data.rows[poses[0]]
        try:
            bound_m = robot.bound(collars[0][row], collars[1][row]).position_m
        except CtrplanError:  # effects of the drive may leave collars where they do not nest
            continue
        for a, b in itertools.combinations(poses.tolist() if bound_m > 2 * position_sigma_m else (), 2):
            apart_m = np.linalg.norm(rule_m[a] - rule_m[b])
            if slides[a] or slides[b] or not apart_m / 2 >= 2 * ERASED * bound_m:  # off by less than ERASED
                pairs.append((a, b, bound_m))
    predicted = np.full((data.count, 3), np.nan)
    asked = np.unique([pose for a, b, _ in pairs for pose in (a, b)]).astype(np.int_)
    run = data.sequence[data.rows[asked]]
    for number in np.unique(run):
        own = asked[run == number]
        rows = np.flatnonzero(data.sequence[: data.rows[own].max() + 1] == number)
        try:
            path_m = robot.history().follow(collars[0][rows], collars[1][rows]).position_m
        except CtrplanError:
            continue
        predicted[own] = path_m[np.searchsorted(rows, data.rows[own])]
    squares = []
    for a, b, bound_m in pairs:
        model_m = np.linalg.norm(predicted[a] - predicted[b])
        apart_m = np.linalg.norm(data.position_m[a] - data.position_m[b])
        if model_m / 2 < ERASED * bound_m and np.isfinite(apart_m):
            squares.append((apart_m**2 - model_m**2 - 6 * position_sigma_m**2) / (2 * bound_m) ** 2)
    if len(squares) < LEAST_PAIRS:
        return None
    return float(min(np.sqrt(max(np.mean(squares), 0.0)), 1.0))


def _by_rule(robot: Robot, data: Measurements, collars: tuple[Array, Array]) -> Array:
    """(K, 3) [m] tips in the friction states that follow from how poses were approached; NaN where there is none."""
    theta_b, l_b = (joints[data.rows] for joints in collars)
    table = tip_table(robot, theta_b, l_b, friction_state(data))
    return np.where(table.sound[:, None], table.position_m, np.nan)


def _slides(data: Measurements) -> NDArray[np.bool_]:
    """(K,) poses whose run translates a tube, which turns friction axial."""
    moved = np.any(np.abs(np.diff(data.l_commanded, axis=0)) > SAME_TRANSLATION_M, axis=1)
    runs = data.sequence[1:][moved & (np.diff(data.sequence) == 0)]
    slides: NDArray[np.bool_] = np.isin(data.sequence[data.rows], runs)
    return slides


def _si(t: Term, name: str) -> float:
    return next(parameter.si for parameter in t.parameters if parameter.name == name)


def model_error_m(error_m: np.ndarray[Any, np.dtype[np.float64]], position_sigma_m: float) -> float:
    """The radius that holds 95 % of tips beyond noise, from held-out distances (K,) [m]; the noise's in squares.

    It is the distance of rank 0.95 (K + 1): a tip that nothing has read is as likely at each rank among K + 1 (split
    conformal prediction). Of fewer than 19 distances it is the largest.
    """
    rank = min(math.ceil(LEVEL * (len(error_m) + 1)), len(error_m))
    excess = float(np.sort(error_m)[rank - 1]) ** 2 - (CHI95 * position_sigma_m) ** 2
    return math.sqrt(max(excess, 0.0))


def _put(content: dict[str, Any], named: Mapping[str, float]) -> None:
    """Named numbers in SI into the file's own keys."""
    for name, value in named.items():
        kind, place, *rest = name.split(".")
        if kind == "contact" and rest[0] == "friction_coefficient":
            content["contact"][int(place) - 1][rest[0]] = _rounded(value)
        elif kind == "contact":
            content["contact"][int(place) - 1]["clearance_mm"] = _rounded(value * 1e3)
        elif rest[0] == "section":
            section = content["tube"][int(place) - 1]["section"][int(rest[1]) - 1]
            is_length = rest[2] == "length_m"
            section["length_mm" if is_length else rest[2]] = _rounded(value * 1e3 if is_length else value)
        else:
            content["tube"][int(place) - 1][rest[0]] = _rounded(value)


def _provenance(chain: ParametricChain, data: Measurements) -> dict[str, Any]:
    rows, degrees = data.rows, np.degrees(data.theta_commanded)
    relative = np.diff(degrees, axis=1)
    return {
        "made_by": f"ctrplan {__version__}",
        "parent": Path(chain.robot.path).name if chain.robot.path else chain.robot.name,
        "parent_sha256": chain.robot.sha256,
        "data": Path(data.file).name if data.file else "",
        "data_sha256": data.sha256,
        "poses": data.count,
        "relative_rotation_range_deg": _ranges(relative[rows]),
        "translation_range_mm": _ranges(data.l_commanded[rows] * 1e3),
    }


def _ranges(columns: np.ndarray[Any, np.dtype[np.float64]]) -> list[list[float]]:
    return [[_rounded(low), _rounded(high)] for low, high in zip(columns.min(axis=0), columns.max(axis=0), strict=True)]


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
