"""report.html of a diagnosis: where it disagrees, what was tried, the verdict, the gap on the test set, what is
next.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ctrplan.base.package import __version__
from ctrplan.calibration.estimates import Errors, estimates
from ctrplan.diagnosis.block_evidence import Closing
from ctrplan.diagnosis.correlated_bench import FRAMES
from ctrplan.diagnosis.partial_diagnosis import PartialDiagnosis
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.sentences import built_lines, headline, verdict_sentence
from ctrplan.effects.learned.inputs import unit
from ctrplan.pipeline.term import Term
from ctrplan.reports import looks
from ctrplan.reports.diagnosis_figures import SelectionErrors, gap_figure, path_figure, signature_figure, where_figure
from ctrplan.reports.html_page import Markup, escaped, facts, page, plot, section, table, tag
from ctrplan.reports.words import glossary, term
from ctrplan.storage.output_folder import write_atomically

NAMED, REMAINING, NOISE, BUILT = looks.SERIES[0], looks.SERIES[1], looks.PLATE, looks.SERIES[2]
FRAMED = looks.SERIES[4]
LEAST_SHOWN = 0.002  # of the bar


def gap_split(found: Diagnosis) -> Markup:
    """Of the mean squared error on the poses kept aside, calibrated without effects."""
    gap = found.gap
    whole = max(gap.before.rms_m, gap.after.rms_m, gap.floor_m) ** 2
    noise = min(gap.floor_m, gap.after.rms_m) ** 2 / whole
    remaining = gap.after.rms_m**2 / whole - noise
    names = " and ".join(t.effect.title for t in found.listed if t.name not in FRAMES) or "effects"
    built = max(found.named_gap.after.rms_m**2 - gap.after.rms_m**2, 0.0) / whole if found.named_gap else 0.0
    built = min(built, max(1 - remaining - noise, 0.0))
    named = max(1 - remaining - noise - built, 0.0)
    framed = max(1 - found.framed_gap.after.rms_m**2 / whole, 0.0) if found.framed_gap else 0.0
    framed = min(framed, named) if any(t.name not in FRAMES for t in found.listed) else named if framed else 0.0
    parts = [
        ("frames of robot and tracker, found with the rest", framed, FRAMED),
        (f"named: {names}", named - framed, NAMED),
        (f"built: {' and '.join(t.effect.title for t in found.built_terms)}", built, BUILT),
        ("remains, unexplained", remaining, REMAINING),
        ("noise of the measurement", noise, NOISE),
    ]
    shown = [(label, share, colour) for label, share, colour in parts if share > LEAST_SHOWN]
    told = [part for part in parts if part in shown or part[2] == NOISE]  # however small the noise is
    words = tag("p", "Shares are of squared errors on the poses kept aside, which add up.", kind="quiet small")
    return tag("div", _bar(shown), _key(told), words)


def _bar(parts: Sequence[tuple[str, float, str]]) -> Markup:
    pieces = [
        f'<div title="{escaped(label)}" style="flex: {share:.4f} 1 0; background: {colour}"></div>'
        for label, share, colour in parts
    ]
    words = ", ".join(f"{label} {100 * share:.0f} %" for label, share, _ in parts)
    style = "display: flex; height: 34px; border-radius: 6px; overflow: hidden; margin: 10px 0"
    return Markup(f'<div role="img" aria-label="{escaped(words)}" style="{style}">{"".join(pieces)}</div>')


def _key(parts: Sequence[tuple[str, float, str]]) -> Markup:
    square = "display: inline-block; width: 11px; height: 11px; border-radius: 3px; margin-right: 6px"
    entries = [
        f'<span style="margin-right: 22px; display: inline-block"><i style="{square}; background: {colour}"></i>'
        f"<b>{_percent(share)}</b> {escaped(label)}</span>"
        for label, share, colour in parts
    ]
    return Markup(f"<p>{''.join(entries)}</p>")


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.01 else "below 1 %"


def _log_odds(odds: float) -> str:
    return f"{odds:.0f}" if np.isfinite(odds) else "not asked"


def share_table(partly: PartialDiagnosis) -> Markup:
    """Each effect that holds: what it closes of the gap, alone and last, and how sure that is.

    With its odds where these were asked for: not of frames of poses at rest, nor of names beside a built term.
    """
    has_odds = any(np.isfinite(part.evidence.odds) for part in partly.parts)
    rows = (
        (
            part.evidence.term.effect.title,
            _closes(part.alone),
            _closes(part.last),
            f"{part.evidence.z:.1f}",
            f"{100 * part.evidence.winning:.0f} %",
            f"{part.evidence.gain:.0f} ({part.evidence.chance:.0f})",
            *([_log_odds(part.evidence.odds)] if has_odds else []),
        )
        for part in partly.parts
    )
    header = (
        "Effect",
        "Error without and with it, alone",
        "Beside all others",
        "Standard errors above none",
        "Blocks that speak for it",
        "Gain (chance)",
        *(["Log-odds beside a smooth error"] if has_odds else []),
    )
    words = (
        "Errors are of poses left out by blocks, rms. The share is of the squared error that calibration alone leaves, "
        "beyond the noise. Where effects hide one another there is none: one of them, alone, makes things worse."
    )
    return tag("div", table(header, rows), tag("p", words, kind="quiet small"))


def _closes(closing: Closing) -> str:
    shown = f"{closing.without_m * 1e3:.2f} to {closing.with_m * 1e3:.2f} mm"
    return f"{shown}, {100 * closing.share:.0f} %" if 0 <= closing.share <= 1 else shown


def built_part(found: Diagnosis) -> list[Markup]:
    """The built terms: what each does and may be, its coefficients, and the ranges outside which it is held."""
    parts = [tag("p", line) for line in built_lines(found)]
    for t in found.built_terms:
        rows = ((name, e.shown, e.shown_ci95) for name, e in estimates(found.chosen.fit, t).items())
        parts.append(table((f"Coefficient of {t.name}", "Value", "95 % interval"), rows))
        ranges = t.effect.stated({}).get("range", {})
        rows = ((name, unit(name), f"{low:.4g} to {high:.4g}") for name, (low, high) in ranges.items())
        parts.append(table(("Input", "Unit", "Range in the data; held at its edge outside"), rows))
    return parts


def remainder_lines(found: Diagnosis) -> list[Markup]:
    """What remains: size, memory, what it is fixed to, where; and what was found and does not hold."""
    if (rest := found.rest) is None:
        return []
    doubted = found.partly.doubted if found.partly else ()
    doubts = [f"{e.term.effect.title}: {'; '.join(e.doubts)}." for e in doubted]
    lines = [tag("p", rest.sentence), tag("p", rest.place)]
    if doubts:
        lines += [
            tag("p", "Found on the way, and not certain enough to be named:"),
            tag("ul", *(tag("li", d) for d in doubts)),
        ]
    return lines


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


WORDS = ("rms", "noise", "held-out poses", "95 % interval")
MEANING = (
    "A quarter of the configurations was set aside before anything was fitted; the errors before and after are on "
    "these poses. Effects were chosen by how well they predict poses left out of the fit, against what the best of all "
    "candidates reaches by chance on pure noise. Every candidate was fitted together with ordinary calibration "
    "(precurvature magnitudes, stiffness ratios, Poisson's ratios).",
    "All is named only if what remains looks like noise. Where it does not, the data show something that the "
    "catalogue does not have. A part of the truth is then said of effects that hold beside every other one, whatever "
    "remains: block after block of poses that were left out, and far above what errors of the same kind reach by "
    "chance. The best of the wrong names is not offered in its place.",
)


def write_diagnosis_report(path: str | os.PathLike[str], found: Diagnosis, errors: SelectionErrors) -> None:
    """Write report.html, one file that loads nothing, whole or not at all."""
    write_atomically(path, diagnosis_report_html(found, errors))


def diagnosis_report_html(found: Diagnosis, errors: SelectionErrors) -> str:
    """The content of report.html."""
    good = found.verdict in ("named", "no_missing_effect") and not found.interrupted
    kind = "good" if good else "caution" if found.partly and not found.interrupted else "bad"
    return page(
        f"Diagnosis of {found.robot.name}",
        tag("p", f"Diagnosis of {found.robot.name}", kind="kicker"),
        tag("h1", headline(found)),
        tag("p", verdict_sentence(found), kind=f"verdict {kind}"),
        _tiles(found),
        section("The gap and what closes it", gap_split(found), *_parts(found)),
        section("On runs that nothing had read", _list(c.sentence for c in found.confirmations))
        if found.confirmations
        else Markup(),
        section("What the model lacks", *effect_parts(found, errors)),
        section("A term built of the rest", *built_part(found)) if found.built else Markup(),
        section(
            "Where model and measurement disagree",
            tag("p", found.place.sentence),
            plot(where_figure(found, errors), "where", with_library=not errors.signatures, kind="plot twin"),
            trend_table(found),
        ),
        section("Before and after, on poses that nothing had seen", plot(gap_figure(found), "gap"), gap_table(found)),
        section("What to measure next", tag("p", found.next_experiment), proposal_table(found)),
        section("What was tried", plot(path_figure(found), "path") if found.path else Markup(), step_table(found)),
        section("What remains", *remainder_lines(found), remaining_table(found)),
        section("Not testable with these data", _list(f"{n}: {why}" for n, why in found.not_testable.items())),
        section("Remarks", _list(found.notes)) if found.notes else Markup(),
        section("Calibrated parameters", calibration_table(found)),
        section("What this means", *(tag("p", text) for text in MEANING), glossary(*WORDS)),
        section("Where this comes from", provenance_table(found)),
    )


def _parts(found: Diagnosis) -> list[Markup]:
    rest = [tag("p", found.rest.sentence)] if found.rest else []
    return [share_table(found.partly), *rest] if found.partly else rest


def _tiles(found: Diagnosis) -> Markup:
    gap = found.gap
    shown = [
        (millimetres(gap.before.rms_m), term("rms", "rms error, calibrated without effects")),
        (millimetres(gap.after.rms_m), term("rms", "rms error with the effects")),
        (millimetres(gap.floor_m), term("noise", "noise of the measurement")),
        (str(gap.after.poses), term("held-out poses", "poses kept aside")),
    ]
    return tag("div", *(tag("div", tag("b", v), tag("span", n), kind="tile") for v, n in shown), kind="tiles")


def _list(texts: Iterable[str]) -> Markup:
    items = [tag("li", text) for text in texts]
    return tag("ul", *items) if items else escaped("none")
