"""report.html of a calibration: errors on poses that it had not seen, what it found, and what the data can't tell."""

from __future__ import annotations

from collections.abc import Iterator

import plotly.graph_objects as go

from ctrplan.base.package import __version__
from ctrplan.calibration.calibrate import Calibration
from ctrplan.calibration.estimates import Errors
from ctrplan.reports import looks
from ctrplan.reports.html_page import FONT, Markup, facts, page, plot, section, table, tag
from ctrplan.reports.words import glossary, term

WORDS = ("rms", "held-out poses", "95 % interval")
MEANING = (
    "The parameters were chosen so that predicted and measured tips differ as little as possible, in the sense of "
    "least squares. Poses kept aside were not used for that: the error on them is what to expect of new measurements. "
    "What is left there beyond the noise stands in the new robot file as its model error, and margins grow by it."
)


def calibration_report_html(found: Calibration) -> str:
    """The content of report.html."""
    name = found.fit.chain.robot.name
    kind = "good" if found.fit.converged and not found.notes else "caution"
    return page(
        f"Calibration of {name}",
        tag("p", f"Calibration of {name}", kind="kicker"),
        tag("h1", headline(found)),
        tag("p", _sentence(found), kind=f"verdict {kind}"),
        _tiles(found),
        section("Remarks", tag("ul", *(tag("li", note) for note in found.notes))) if found.notes else Markup(),
        section("Errors of the tip, before and after", plot(errors_figure(found), "errors", with_library=True)),
        section("Parameters", _parameter_table(found)),
        _worst_known(found),
        section("What this means", tag("p", MEANING), glossary(*WORDS)),
        section("Where this comes from", _provenance(found)),
    )


def headline(found: Calibration) -> str:
    """Usual errors before and after, on poses kept aside if there are any."""
    after = found.held_out or found.training
    return f"Errors of {_mm(found.nominal.rms_m)} became {_mm(after.rms_m)}"


def errors_figure(found: Calibration) -> go.Figure:
    """Usual errors with their intervals, and the largest ones."""
    names, sets = zip(*_sets(found), strict=True)
    rms = [1e3 * errors.rms_m for errors in sets]
    low, high = ([abs(1e3 * e.rms_ci95_m[k] - r) for e, r in zip(sets, rms, strict=True)] for k in (0, 1))
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
        font={"family": FONT, "color": looks.INK, "size": 13}, legend={"orientation": "h", "y": 1.2},
    )  # fmt: skip
    return figure


def _sets(found: Calibration) -> Iterator[tuple[str, Errors]]:
    yield "before", found.nominal
    yield "after, fitted", found.training
    if found.held_out is not None:
        yield "after, kept aside", found.held_out


def _sentence(found: Calibration) -> str:
    where = "on poses kept aside" if found.held_out else "on the poses fitted; none were kept aside"
    after = found.held_out or found.training
    ended = "" if found.fit.converged else " The fit did not converge: its values are not the best ones."
    return (
        f"Tips were {_mm(found.nominal.rms_m)} off before (rms), and are {_mm(after.rms_m)} off after, {where}, "
        f"{_mm(after.max_m)} at most.{ended}"
    )


def _tiles(found: Calibration) -> Markup:
    shown = [
        (_mm(found.nominal.rms_m), term("rms", "rms error before")),
        (_mm(found.training.rms_m), term("rms", "rms error after, poses fitted")),
        *(
            [(_mm(found.held_out.rms_m), term("held-out poses", "rms error after, kept aside"))]
            if found.held_out
            else []
        ),
        (_mm(found.model_error_m), "model error written into the file"),
        (str(found.training.poses), "poses fitted"),
    ]
    return tag("div", *(tag("div", tag("b", v), tag("span", n), kind="tile") for v, n in shown), kind="tiles")


def _parameter_table(found: Calibration) -> Markup:
    rows = (
        (name, f"{e.value:.6g}", f"{e.ci95[0]:.6g} to {e.ci95[1]:.6g}", "at its bound" if e.at_bound else "")
        for name, e in found.estimates.items()
    )
    return table(("Parameter", "Value", term("95 % interval"), ""), rows)


def _worst_known(found: Calibration) -> Markup:
    """Combinations of parameters, least known first."""
    rows = (
        (" ".join(f"{share:+.2f} {name}" for name, share in c.parameters.items()), f"{100 * c.posterior_share:.0f} %")
        for c in found.combinations[:5]
    )
    head = ("Combination of parameters", "Uncertainty that the data left of the one before")
    return section("What the data say least about", table(head, rows))


def _provenance(found: Calibration) -> Markup:
    robot, data = found.fit.chain.robot, found.data
    return facts(
        [
            ("Robot", f"{robot.name}, {robot.path or 'not from a file'}"),
            ("SHA-256 of the robot", tag("code", robot.sha256)),
            ("Measurements", f"{data.file or 'not from a file'}, {data.count} poses"),
            ("SHA-256 of the measurements", tag("code", data.sha256)),
            ("ctrplan", __version__),
        ]
    )


def _mm(length_m: float) -> str:
    return f"{length_m * 1e3:.2f} mm"
