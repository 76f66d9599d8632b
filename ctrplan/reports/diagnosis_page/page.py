"""report.html of a diagnosis: where it disagrees, what was tried, the verdict, the held-out gap, what is next."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np

from ctrplan.base.version import __version__
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.pose_errors import Errors
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.sentences import verdict_sentence
from ctrplan.reports.diagnosis_page.figures import gap_figure, path_figure, where_figure
from ctrplan.reports.html_page import Markup, escaped, facts, page, plot, section, table, tag
from ctrplan.storage.atomic_write import write_atomically

MEANING = (
    "A quarter of the configurations was set aside before anything was fitted; the errors before and after are on "
    "these poses. Effects were chosen by how well they predict poses left out of the fit, against what the best of all "
    "candidates reaches by chance on pure noise. Every candidate was fitted together with ordinary calibration "
    "(precurvature magnitudes, stiffness ratios, Poisson's ratios).",
    "A name is given only if what remains looks like noise. Where it does not, the data show something that the "
    "catalogue does not have, and the best of the wrong names is not offered in its place.",
)


def write_diagnosis_report(path: str | os.PathLike[str], found: Diagnosis) -> None:
    """Write report.html, one file that loads nothing, whole or not at all."""
    write_atomically(path, diagnosis_report_html(found))


def diagnosis_report_html(found: Diagnosis) -> str:
    """The content of report.html."""
    good = found.verdict in ("named", "no_missing_effect") and not found.interrupted
    return page(
        f"Diagnosis of {found.robot.name}",
        tag("p", f"Diagnosis of {found.robot.name}", kind="kicker"),
        tag("h1", found.verdict.replace("_", " ")),
        tag("p", verdict_sentence(found), kind=f"verdict {'good' if good else 'bad'}"),
        _tiles(found),
        section(
            "Where model and measurement disagree", tag("p", found.place.sentence), _figure_where(found), _trends(found)
        ),
        section("Effects", *_effects(found)),
        section("Before and after, on poses that nothing had seen", plot(gap_figure(found), "gap"), _gap(found)),
        section("What to measure next", tag("p", found.next_experiment), _proposals(found)),
        section("What was tried", plot(path_figure(found), "path") if found.path else Markup(), _path(found)),
        section("What remains", _remaining(found)),
        section("Not testable with these data", _list(f"{n}: {why}" for n, why in found.not_testable.items())),
        section("Remarks", _list(found.notes)) if found.notes else Markup(),
        section("Calibrated parameters", _calibration(found)),
        section("What this means", *(tag("p", text) for text in MEANING)),
        section("Where this comes from", _provenance(found)),
    )


def _tiles(found: Diagnosis) -> Markup:
    gap = found.gap
    shown = [
        (_mm(gap.before.rms_m), "rms error, calibrated without effects"),
        (_mm(gap.after.rms_m), "rms error with the effects"),
        (_mm(gap.floor_m), "noise of the measurement"),
        (str(gap.after.poses), "poses kept aside"),
    ]
    return tag("div", *(tag("div", tag("b", v), tag("span", n), kind="tile") for v, n in shown), kind="tiles")


def _figure_where(found: Diagnosis) -> Markup:
    return plot(where_figure(found), "where", with_library=True)


def _trends(found: Diagnosis) -> Markup:
    rows = ((t.quantity, f"{100 * t.share:.0f} %", f"{t.p:.3f}") for t in found.place.trends[:6])
    return table(("Goes along with", "Share of the squared residuals", "Chance of that"), rows)


def _effects(found: Diagnosis) -> Iterator[Markup]:
    if not found.listed:
        yield tag("p", "None is named.")
    for finding in found.judgement.findings:
        effect = finding.term.effect
        yield tag("h3", f"{effect.name} ({effect.stage})")
        yield tag("p", f"{effect.equation}. {effect.signature}.", kind="quiet")
        rows = (
            (name, f"{e.value:.4g}", f"{e.ci95[0]:.4g} to {e.ci95[1]:.4g}{', at its bound' if e.at_bound else ''}")
            for name, e in estimates(found.chosen.fit, finding.term).items()
        )
        yield table(("Parameter", "Value", "95 % interval"), rows)
        rivals = [a for a in found.judgement.compared if finding.term.key not in {t.key for t in a.scored.terms}]
        if rivals:
            yield table(
                ("In its place", "Predicts worse by (log-likelihood)", "Standard error"),
                ((a.term.name, f"{a.behind:.1f}", f"{a.error:.1f}") for a in rivals),
            )


def _gap(found: Diagnosis) -> Markup:
    gap = found.gap
    regions = {"all": (gap.before, gap.after), **gap.regions}
    rows = ((name, str(after.poses), *_errors(before), *_errors(after)) for name, (before, after) in regions.items())
    header = (
        "Region",
        "Poses",
        "Before: rms (95 %)",
        "95th percentile",
        "max",
        "After: rms (95 %)",
        "95th percentile",
        "max",
    )
    return table(header, rows)


def _errors(errors: Errors) -> tuple[str, str, str]:
    low, high = errors.rms_ci95_m
    return f"{_mm(errors.rms_m)} ({low * 1e3:.2f} to {high * 1e3:.2f})", _mm(errors.p95_m), _mm(errors.max_m)


def _proposals(found: Diagnosis) -> Markup:
    if not found.proposals:
        return Markup()
    rows = (
        (
            ", ".join(f"{x:.0f}" for x in np.degrees(p.theta_commanded)),
            ", ".join(f"{x:.1f}" for x in p.l_commanded * 1e3),
            " against ".join(p.between),
            f"{p.log_odds:.1f}",
        )
        for p in found.proposals
    )
    return table(("theta (deg)", "l (mm)", "Separates", "Expected log-odds"), rows)


def _path(found: Diagnosis) -> Markup:
    rows = (
        (
            step.action,
            step.effect,
            ", ".join(step.parameters),
            f"{step.gain:.1f} ± {step.error:.1f}",
            f"{step.threshold:.1f}",
            "taken" if step.taken else "",
        )
        for step in found.path
    )
    return table(("Step", "Effect", "Parameters", "Gain in log-likelihood", "Needed", ""), rows)


def _remaining(found: Diagnosis) -> Markup:
    left = found.judgement.adequacy
    named = {
        "all poses of the selection": left.total,
        "between configurations": left.between,
        "between approaches of one configuration": left.within,
        "poses kept aside": found.gap.chi_square,
    }
    rows = ((name, f"{c.ratio:.3f}", f"{c.p:.2g}") for name, c in named.items())
    return table(("Residuals", "Chi-square per degree of freedom", "Probability under noise"), rows)


def _calibration(found: Diagnosis) -> Markup:
    values = estimates(found.chosen.fit, found.chosen.fit.chain.terms[0])
    rows = ((name, f"{e.value:.4g}", f"{e.ci95[0]:.4g} to {e.ci95[1]:.4g}") for name, e in values.items())
    return table(("Parameter", "Value", "95 % interval"), rows)


def _provenance(found: Diagnosis) -> Markup:
    return facts(
        [
            ("Robot", f"{found.robot.name}, {found.robot.path or 'not from a file'}"),
            ("SHA-256 of the robot", tag("code", found.robot.sha256)),
            (
                "Measurements",
                f"{found.data.file or 'not from a file'}, {found.data.count} poses, {100 * found.coverage:.0f} % used",
            ),
            ("SHA-256 of the measurements", tag("code", found.data.sha256)),
            ("Time", f"{found.time_s:.0f} s"),
            ("ctrplan", __version__),
        ]
    )


def _list(texts: Iterator[str] | tuple[str, ...]) -> Markup:
    items = [tag("li", text) for text in texts]
    return tag("ul", *items) if items else escaped("none")


def _mm(length_m: float) -> str:
    return f"{length_m * 1e3:.2f} mm"
