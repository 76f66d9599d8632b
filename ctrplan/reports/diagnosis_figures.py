"""Figures of a diagnosis report: where the residuals are, what each effect does, the path of the selection, the gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ctrplan.base.arrays import MM_PER_M, ROUNDING_M, Array
from ctrplan.calibration.estimates import distances
from ctrplan.calibration.fit_warnings import excused
from ctrplan.diagnosis.remainder import quantities
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.pipeline.term import Term
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT

PARTS = 8  # of a quantity's range, by rank


@dataclass(frozen=True, eq=False)
class Signature:
    """An effect alone, on the poses of the selection; everything else stays as it was fitted with it."""

    term: Term
    shift_m: Array  # (K,) by which the effect moves the tip; NaN without a solution
    measured_m: Array  # (K,) of the tip beyond the model without the effect, along that shift
    quantity: str  # what the shift goes along with most
    values: Array  # (K,) of it, as `quantities` has them


def signatures(diagnosis: Diagnosis) -> tuple[Signature, ...]:
    """Signatures of the effects that the verdict lists; predicts every pose once more for each of them."""
    known = quantities(diagnosis.base.fit.chain.data)
    return tuple(_signature(diagnosis, term, known) for term in diagnosis.listed)


def _signature(diagnosis: Diagnosis, term: Term, known: Mapping[str, Array]) -> Signature:
    """The chosen model with and without the effect, which is at its neutral values then."""
    chain, p = diagnosis.chosen.fit.chain, diagnosis.chosen.fit.p
    place = next(s for t, s in zip(chain.terms, chain.slices(), strict=True) if t.key == term.key)
    without = p.copy()
    without[place] = chain.neutral[place]
    ends = [chain.predict(at, derivatives=False) for at in (p, without)]
    solved = ~(ends[0].failed | ends[1].failed)
    shift = np.where(solved[:, None], ends[0].position_m - ends[1].position_m, np.nan)
    size = np.linalg.norm(shift, axis=1)
    direction = shift / np.maximum(size, ROUNDING_M)[:, None]
    measured = np.sum((chain.data.position_m - ends[1].position_m) * direction, axis=1)
    shares = {name: _explained(size, values) for name, values in known.items()}
    quantity = max(shares, key=lambda name: shares[name])
    return Signature(term, size, measured, quantity, known[quantity])


def _explained(size: Array, values: Array) -> float:
    """Share of the variance of sizes (K,) that means over parts of a quantity (K,) explain."""
    good = np.isfinite(size) & np.isfinite(values)
    total = float(np.var(size[good])) if good.any() else 0.0
    if total == 0.0:
        return 0.0
    edges = np.quantile(values[good], np.linspace(0, 1, PARTS + 1)[1:-1])
    part, kept = np.searchsorted(edges, values[good], side="right"), size[good]
    means = [(np.sum(part == k), kept[part == k].mean()) for k in np.unique(part)]
    return float(sum(n * (mean - kept.mean()) ** 2 for n, mean in means) / good.sum() / total)


@dataclass(frozen=True, eq=False)
class SelectionErrors:
    """Distances [m] of measured from predicted tips; NaN where one of the models has no solution."""

    calibrated_m: Array  # (K,) without effects
    with_effects_m: Array  # (K,)
    signatures: tuple[Signature, ...]  # of the verdict's effects


def selection_errors(diagnosis: Diagnosis) -> SelectionErrors:
    """Predicts every pose of the selection with the calibrated model, with its effects, and without each of them."""
    data = diagnosis.base.fit.chain.data
    solved = ~(excused(diagnosis.base.failed) | excused(diagnosis.chosen.failed))
    fits = (diagnosis.base.fit, diagnosis.chosen.fit)
    predictions = (fit.chain.predict(fit.p, derivatives=False) for fit in fits)
    before, after = (np.where(solved, distances(prediction, data), np.nan) for prediction in predictions)
    return SelectionErrors(before, after, signatures(diagnosis))


BEFORE, AFTER = looks.LIMIT, looks.SERIES[0]
HEIGHT = 340


def where_figure(diagnosis: Diagnosis, errors: SelectionErrors) -> go.Figure:
    """Distance of every pose of the selection, before and after, against the two quantities it goes along with most."""
    names = [trend.quantity for trend in diagnosis.place.trends[:2]]
    known = quantities(diagnosis.base.fit.chain.data)
    figure = make_subplots(rows=1, cols=len(names), shared_yaxes=True, horizontal_spacing=0.06)
    clouds = [("calibrated", BEFORE, errors.calibrated_m), ("with the effects", AFTER, errors.with_effects_m)]
    for column, name in enumerate(names, start=1):
        values, unit = _shown(name, known[name])
        for label, colour, error_m in clouds if diagnosis.chosen.terms else clouds[:1]:
            cloud = _cloud(values, error_m * MM_PER_M, label, colour, named=column == 1)
            figure.add_trace(cloud, row=1, col=column)
        figure.update_xaxes(title_text=f"{name}{f' ({unit})' if unit else ''}", row=1, col=column)
    figure.add_hline(y=diagnosis.noise.floor_m * MM_PER_M, line={"color": looks.MUTED, "dash": "dash", "width": 1})
    figure.update_yaxes(title_text="error of the tip (mm)", rangemode="tozero", col=1)
    return _styled(figure)


def signature_figure(signature: Signature) -> go.Figure:
    """What the effect does against the quantity it follows, and what was measured against what it does."""
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.11)
    shift, measured = signature.shift_m * MM_PER_M, signature.measured_m * MM_PER_M
    values, unit = _shown(signature.quantity, signature.values)
    figure.add_trace(_cloud(values, measured, "measured", BEFORE, named=True), row=1, col=1)
    figure.add_trace(_cloud(values, shift, "explained by the effect", AFTER, named=True), row=1, col=1)
    figure.add_trace(_cloud(shift, measured, "measured", BEFORE, named=False), row=1, col=2)
    ends = [0.0, float(np.nanmax(shift, initial=0.0))]
    line = {"color": looks.MUTED, "dash": "dash", "width": 1}
    figure.add_trace(go.Scatter(x=ends, y=ends, mode="lines", line=line, showlegend=False), row=1, col=2)
    figure.update_xaxes(title_text=f"{signature.quantity}{f' ({unit})' if unit else ''}", row=1, col=1)
    figure.update_xaxes(title_text="shift explained (mm); dashed: all of it", row=1, col=2)
    figure.update_yaxes(title_text="shift of the tip (mm)", col=1)
    figure.update_yaxes(title_text="shift measured (mm)", col=2)
    return _styled(figure)


def gap_figure(diagnosis: Diagnosis) -> go.Figure:
    """Share of the held-out set's poses with an error up to a value, before and after."""
    figure = go.Figure()
    for label, colour, error in (
        ("calibrated", BEFORE, diagnosis.gap.before_m),
        ("with the effects", AFTER, diagnosis.gap.after_m),
    ):
        ordered = np.sort(error) * MM_PER_M
        share = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
        figure.add_trace(
            go.Scatter(x=ordered, y=share, mode="lines", name=label, line={"color": colour, "shape": "hv"})
        )
    figure.add_vline(x=diagnosis.gap.floor_m * MM_PER_M, line={"color": looks.MUTED, "dash": "dash", "width": 1})
    figure.update_xaxes(title_text="error of the tip (mm), dashed: noise", rangemode="tozero")
    figure.update_yaxes(title_text="poses with at most this error (%)", range=[0, 101])
    return _styled(figure)


def path_figure(diagnosis: Diagnosis) -> go.Figure:
    """Gains of what was tried, step by step."""
    labels = [f"{k}. {step.action} {step.effect}" for k, step in enumerate(diagnosis.path, start=1)]
    gains = [step.gain for step in diagnosis.path]
    figure = go.Figure(
        go.Bar(
            x=gains,
            y=labels,
            orientation="h",
            marker={"color": [AFTER if step.taken else looks.PLATE for step in diagnosis.path]},
            showlegend=False,
        )
    )
    figure.update_yaxes(autorange="reversed")
    figure.update_xaxes(title_text="gain in the logarithm of the probability, blue: taken")
    return _styled(figure, max(220, 24 * len(labels) + 90))


def _cloud(x: Array, y: Array, label: str, colour: str, *, named: bool) -> Any:
    marker = {"size": 5, "color": colour, "opacity": 0.6}
    return go.Scatter(x=x, y=y, mode="markers", name=label, marker=marker, showlegend=named, legendgroup=label)


def _shown(name: str, values: Array) -> tuple[Array, str]:
    if "angle" in name or "rotation" in name:
        return np.degrees(values), "deg"
    if "translation" in name or name.endswith("of the tip"):
        return values * MM_PER_M, "mm"
    return values, "s" if name == "time" else ""


def _styled(figure: Any, height: int = HEIGHT) -> go.Figure:
    axis = {"gridcolor": looks.GRID, "linecolor": looks.GRID, "zeroline": False}
    figure.update_layout(
        height=height,
        margin={"l": 60, "r": 20, "t": 20, "b": 50},
        font=FIGURE_TEXT,
        plot_bgcolor="white",
        paper_bgcolor="white",
        legend={"orientation": "h", "y": 1.12},
        autosize=True,
    )
    figure.update_xaxes(**axis)
    figure.update_yaxes(**axis)
    return figure
