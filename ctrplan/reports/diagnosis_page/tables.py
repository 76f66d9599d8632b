"""The tables of a diagnosis: trends, effects, gap, proposals, what was tried, what remains, provenance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ctrplan.base.version import __version__
from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.pose_errors import Errors
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.pipeline.term import Term
from ctrplan.reports.diagnosis_page.figures import signature_figure
from ctrplan.reports.diagnosis_page.selection_errors import SelectionErrors
from ctrplan.reports.glossary import term
from ctrplan.reports.html_page import Markup, facts, plot, table, tag


def trend_table(found: Diagnosis) -> Markup:
    """What the residuals go along with."""
    rows = ((t.quantity, f"{100 * t.share:.0f} %", f"{t.p:.3f}") for t in found.place.trends[:6])
    return table(("Goes along with", "Share of the squared residuals", "Chance of that"), rows)


def effect_parts(found: Diagnosis, errors: SelectionErrors) -> Iterator[Markup]:
    """Each effect of the verdict: what it does, drawn, its parameters, and what fits worse in its place."""
    if not found.listed:
        yield tag("p", "None is named.")
    for number, signature in enumerate(errors.signatures):
        effect = signature.term.effect
        yield tag("h3", effect.title[:1].upper() + effect.title[1:])
        yield tag("p", f"{effect.signature[:1].upper()}{effect.signature[1:]}.")
        yield plot(signature_figure(signature), f"signature_{number}", with_library=number == 0, kind="plot twin")
        yield tag("p", "In the file: ", tag("code", f"[effects.{effect.name}]"), f", {effect.equation}.", kind="quiet")
        yield _parameter_table(found, signature.term)
        yield _rival_table(found, signature.term)


def _parameter_table(found: Diagnosis, t: Term) -> Markup:
    rows = (
        (name, e.shown, f"{e.shown_ci95}{', at its bound' if e.at_bound else ''}")
        for name, e in estimates(found.chosen.fit, t).items()
    )
    return table(("Parameter", "Value", term("95 % interval")), rows)


def _rival_table(found: Diagnosis, t: Term) -> Markup:
    rivals = [a for a in found.judgement.compared if t.key not in {other.key for other in a.scored.terms}]
    if not rivals:
        return Markup()
    rows = ((a.term.effect.title, f"{a.behind:.1f}", f"{a.error:.1f}") for a in rivals)
    return table(("In its place", "Predicts worse by (log-likelihood)", "Standard error"), rows)


def gap_table(found: Diagnosis) -> Markup:
    """Errors before and after on the poses kept aside, by region."""
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
    return (
        f"{millimetres(errors.rms_m)} ({low * 1e3:.2f} to {high * 1e3:.2f})",
        millimetres(errors.p95_m),
        millimetres(errors.max_m),
    )


def proposal_table(found: Diagnosis) -> Markup:
    """Configurations that would separate what the data cannot."""
    if not found.proposals:
        return Markup()
    rows = (
        (
            ", ".join(f"{x:.0f}" for x in np.degrees(p.theta_commanded)),
            ", ".join(f"{x:.1f}" for x in p.l_commanded * 1e3),
            " against ".join(p.between),
            p.odds,
        )
        for p in found.proposals
    )
    return table(("theta (deg)", "l (mm)", "Separates", "Expected log-odds"), rows)


def step_table(found: Diagnosis) -> Markup:
    """Every step of the selection."""
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


def remaining_table(found: Diagnosis) -> Markup:
    """What is left, compared with noise."""
    left = found.judgement.adequacy
    named = {
        "all poses of the selection": left.total,
        "between configurations": left.between,
        "between approaches of one configuration": left.within,
        "poses kept aside": found.gap.chi_square,
    }
    rows = ((name, f"{c.ratio:.3f}", f"{c.p:.2g}") for name, c in named.items())
    return table(("Residuals", "Chi-square per degree of freedom", "Probability under noise"), rows)


def calibration_table(found: Diagnosis) -> Markup:
    """Ordinary calibration parameters."""
    values = estimates(found.chosen.fit, found.chosen.fit.chain.terms[0])
    rows = ((name, e.shown, e.shown_ci95) for name, e in values.items())
    return table(("Parameter", "Value", "95 % interval"), rows)


def provenance_table(found: Diagnosis) -> Markup:
    """Files, checksums, time and version."""
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


def millimetres(length_m: float) -> str:
    """To a hundredth, as tables of errors compare them."""
    return f"{length_m * 1e3:.2f} mm"
