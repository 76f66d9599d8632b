"""report.html of a calibration: errors on poses that it had not seen, what it found, and what the data can't tell."""

from __future__ import annotations

import math
from collections.abc import Iterator

import plotly.graph_objects as go

from ctrplan.calibration.calibrate import Calibration
from ctrplan.calibration.estimates import Errors
from ctrplan.calibration.observed_noise import SURE
from ctrplan.reports import looks
from ctrplan.reports.html_page import FIGURE_TEXT, plot, rendered
from ctrplan.reports.words import term


def calibration_report_html(calibration: Calibration) -> str:
    """The content of report.html."""
    robot = calibration.fit.chain.robot
    kept_aside = [
        (_mm(e.rms_m), term("held-out poses", "rms error after, kept aside")) for e in [calibration.held_out] if e
    ]
    return rendered(
        "calibration.html",
        title=f"Calibration of {robot.name}",
        calibration=calibration,
        robot=robot,
        data=calibration.data,
        headline=headline(calibration),
        sentence=_sentence(calibration),
        standing="good"
        if calibration.fit.converged and not calibration.notes and _has_helped(calibration)
        else "caution",
        figures=[
            (_mm(calibration.nominal.rms_m), term("rms", "rms error before")),
            (_mm(calibration.training.rms_m), term("rms", "rms error after, poses fitted")),
            *kept_aside,
            (_mm(calibration.model_error_m), "model error written into the file"),
            (calibration.training.poses, "poses fitted"),
        ],
        errors=plot(errors_figure(calibration), "errors", with_library=True),
    )


def headline(calibration: Calibration) -> str:
    """Usual errors before and after, on poses kept aside if there are any."""
    after = calibration.held_out or calibration.training
    end = "" if _has_helped(calibration) else ": no better than the robot of the file"
    return f"Errors of {_mm(calibration.nominal.rms_m)} became {_mm(after.rms_m)}{end}"


def errors_figure(calibration: Calibration) -> go.Figure:
    """Usual errors with their intervals, and the largest ones."""
    names, sets = zip(*_sets(calibration), strict=True)
    rms = [1e3 * errors.rms_m for errors in sets]
    ends = [e.rms_ci95_m or (e.rms_m, e.rms_m) for e in sets]
    low, high = ([abs(1e3 * end[k] - r) for end, r in zip(ends, rms, strict=True)] for k in (0, 1))
    bars = {"type": "data", "symmetric": False, "array": high, "arrayminus": low, "color": looks.MUTED}
    figure = go.Figure(go.Bar(x=rms, y=names, orientation="h", name="rms, 95 % interval", error_x=bars))
    figure.data[0].marker.color = [looks.PLATE, *[looks.SERIES[0]] * (len(names) - 1)]
    worst = {"symbol": "line-ns-open", "size": 16, "color": looks.LIMIT, "line": {"width": 3}}
    largest = [1e3 * errors.max_m for errors in sets]
    figure.add_trace(go.Scatter(x=largest, y=names, mode="markers", name="largest", marker=worst))
    figure.update_xaxes(title_text="error of the tip (mm)", rangemode="tozero", gridcolor=looks.GRID)
    figure.update_yaxes(autorange="reversed")
    figure.update_layout(
        height=260, margin={"l": 110, "r": 20, "t": 20, "b": 50}, plot_bgcolor="white", paper_bgcolor="white",
        font=FIGURE_TEXT, legend={"orientation": "h", "y": 1.2},
    )  # fmt: skip
    return figure


def _sets(calibration: Calibration) -> Iterator[tuple[str, Errors]]:
    yield "before", calibration.nominal
    yield "after, fitted", calibration.training
    if calibration.held_out is not None:
        yield "after, kept aside", calibration.held_out


def _sentence(calibration: Calibration) -> str:
    where = "on poses kept aside" if calibration.held_out else "on the poses fitted; none were kept aside"
    after = calibration.held_out or calibration.training
    ended = "" if calibration.fit.converged else " The fit did not converge: its values are not the best ones."
    if not _has_helped(calibration):
        ended += " The fit has not helped: the robot of the file explains the poses as well."
    if missing := what_is_missing(calibration):
        ended += f" {missing[0].upper()}{missing[1:]}: ctrplan diagnose looks for it."
    return (
        f"Tips were {_mm(calibration.nominal.rms_m)} off before (rms), and are {_mm(after.rms_m)} off after, {where}, "
        f"{_mm(after.max_m)} at most.{ended}"
    )


def what_is_missing(calibration: Calibration) -> str:
    """A clause where more is left than the tracker's noise explains; empty where it does, or where noise is unknown."""
    noise, errors = calibration.fit.chain.robot.measurement, calibration.held_out or calibration.training
    if noise is None:
        return ""
    floor, left = noise.position_sigma_m * math.sqrt(3), errors.rms_m
    if left <= floor * (1 + SURE / math.sqrt(6 * errors.poses)):  # what the rms of pure noise may be
        return ""
    return f"{left * 1e3:.2g} mm are left, {floor * 1e3:.2g} mm would be noise: something is missing in the model"


def _has_helped(calibration: Calibration) -> bool:
    after = calibration.held_out or calibration.training
    return after.rms_m < calibration.nominal.rms_m


def _mm(length_m: float) -> str:
    return f"{length_m * 1e3:.2f} mm"
