"""A fit -> a new robot file: calibrated values, effects with their intervals, and where all of it comes from."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ctrplan.base.version import __version__
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.fitted_intervals import uncertainty_table
from ctrplan.calibration.least_squares import Fit, fit
from ctrplan.effects.effect import Parameter
from ctrplan.experiment.measurements import Measurements
from ctrplan.pipeline.chain import taken_along
from ctrplan.pipeline.parametric_chain import ParametricChain
from ctrplan.pipeline.term import Term
from ctrplan.robot.named_numbers import with_values

DIGITS = 7  # of numbers in the file
LARGEST_POISSON_RATIO = 0.5  # of a robot file; a fit may go beyond, which is a symptom
CHI95 = 2.795  # 95 % of distances of three Gaussian coordinates lie within that many standard deviations


def within_file(found: Fit) -> Fit:
    """`found`; where it has a Poisson's ratio that no tube has, refitted without, for a robot file can't say that."""
    chain = found.chain
    terms = [Term(t.effect, tuple(_possible(p) for p in t.parameters)) for t in chain.terms]
    inside = chain.with_terms(terms)
    if np.all(found.p <= inside.upper):
        return found
    return fit(inside, found.noise, found.group, found.p)


def _possible(parameter: Parameter) -> Parameter:
    is_ratio = "poisson_ratio" in parameter.name
    return replace(parameter, upper=min(parameter.upper, LARGEST_POISSON_RATIO)) if is_ratio else parameter


def calibrated_content(
    found: Fit, effects: Sequence[Term], data: Measurements, model_error_m: float, before: Fit | None = None
) -> dict[str, Any]:
    """The content of the new file: the parent's with the fitted numbers in it. The parent is not touched.

    Read again it is the robot of the fit: the file's own numbers are those before its effects, and of an effect that
    the parent has already only what was fitted changes. 95 % intervals of effects stand beside their values, those of
    the file's own numbers in [uncertainty]; `before` is the first of two passes.
    """
    chain = found.chain
    content: dict[str, Any] = copy.deepcopy(dict(chain.robot.content))
    ideal, tables = chain.robot.ideal or chain.robot, content.setdefault("effects", {})
    for t, values in zip(chain.terms, chain.values(found.p), strict=True):
        if t.effect.of_the_file:
            named = t.effect.mechanics(values, ideal)
            _put(content, named)
            for name, table in taken_along(tables, chain.robot, named).items():
                tables[name] = {key: _rounded(v) if isinstance(v, float) else v for key, v in table.items()}
            ideal = with_values(ideal, named)
    for t in effects:
        fitted, table = estimates(found, t), tables.setdefault(t.name, {})
        table |= t.effect.stated({name: e.value * _si(t, name) for name, e in fitted.items()})
        table |= {name: e.value for name, e in fitted.items()}
        table["ci95"] = {**table.get("ci95", {}), **{name: list(e.ci95) for name, e in fitted.items()}}
    if not tables:
        del content["effects"]
    content.pop("uncertainty", None)
    if uncertainty := uncertainty_table(found, effects, before):
        content["uncertainty"] = uncertainty
    content["model_error_mm"] = _rounded(model_error_m * 1e3)
    content["provenance"] = _provenance(chain, data)
    return content


def _si(t: Term, name: str) -> float:
    return next(parameter.si for parameter in t.parameters if parameter.name == name)


def model_error_m(error_m: np.ndarray[Any, np.dtype[np.float64]], position_sigma_m: float) -> float:
    """What held-out distances (K,) [m] leave beyond noise: their 95th percentile, the noise's taken out in squares."""
    excess = float(np.percentile(error_m, 95)) ** 2 - (CHI95 * position_sigma_m) ** 2
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
