"""report.html of a diagnosis: where it disagrees, what was tried, the verdict, the held-out gap, what is next."""

from __future__ import annotations

import os
from collections.abc import Iterable

from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.sentences import headline, verdict_sentence
from ctrplan.reports.diagnosis_page.figures import gap_figure, path_figure, where_figure
from ctrplan.reports.diagnosis_page.gap_split import built_part, gap_split, rest_lines, share_table
from ctrplan.reports.diagnosis_page.selection_errors import SelectionErrors
from ctrplan.reports.diagnosis_page.tables import (
    calibration_table,
    effect_parts,
    gap_table,
    millimetres,
    proposal_table,
    provenance_table,
    remaining_table,
    step_table,
    trend_table,
)
from ctrplan.reports.glossary import glossary, term
from ctrplan.reports.html_page import Markup, escaped, page, plot, section, tag
from ctrplan.storage.atomic_write import write_atomically

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
        section("What remains", *rest_lines(found), remaining_table(found)),
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
