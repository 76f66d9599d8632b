"""report.html of a diagnosis: where it disagrees, what was tried, the verdict, the gap on the test set, what is
next.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.conclusion import Part
from ctrplan.diagnosis.correlated_bench import FRAMES
from ctrplan.diagnosis.next_experiment import Proposal
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.effects.learned.inputs import unit
from ctrplan.pipeline.term import Term
from ctrplan.reports import looks
from ctrplan.reports.diagnosis_figures import SelectionErrors, gap_figure, path_figure, signature_figure, where_figure
from ctrplan.reports.diagnosis_words import built_lines, headline, in_figures, probabilities, verdict_sentence
from ctrplan.reports.html_page import plot, rendered
from ctrplan.reports.words import Markup, term
from ctrplan.storage.output_folder import write_atomically

NAMED, REMAINING, NOISE, BUILT = looks.SERIES[0], looks.SERIES[1], looks.PLATE, looks.SERIES[2]
FRAMED = looks.SERIES[4]
LEAST_SHOWN = 0.002  # of the bar


def gap_split(diagnosis: Diagnosis) -> Markup:
    """Parts of the mean squared error on the poses kept aside, calibrated without effects, as a bar with its key."""
    gap = diagnosis.gap
    whole = max(gap.before.rms_m, gap.after.rms_m, gap.floor_m) ** 2
    noise = min(gap.floor_m, gap.after.rms_m) ** 2 / whole
    remaining = gap.after.rms_m**2 / whole - noise
    names = " and ".join(t.effect.title for t in diagnosis.listed if t.name not in FRAMES) or "effects"
    built = max(diagnosis.named_gap.after.rms_m**2 - gap.after.rms_m**2, 0.0) / whole if diagnosis.named_gap else 0.0
    built = min(built, max(1 - remaining - noise, 0.0))
    named = max(1 - remaining - noise - built, 0.0)
    framed = max(1 - diagnosis.framed_gap.after.rms_m**2 / whole, 0.0) if diagnosis.framed_gap else 0.0
    framed = min(framed, named) if any(t.name not in FRAMES for t in diagnosis.listed) else named if framed else 0.0
    parts = [
        ("frames of robot and tracker, found with the rest", framed, FRAMED),
        (f"named: {names}", named - framed, NAMED),
        (f"built: {' and '.join(t.effect.title for t in diagnosis.built_terms)}", built, BUILT),
        ("remains, unexplained", remaining, REMAINING),
        ("noise of the measurement", noise, NOISE),
    ]
    shown = [GapPart(label, share, colour, share > LEAST_SHOWN) for label, share, colour in parts]
    kept = [part for part in shown if part.shown or part.colour == NOISE]  # however small the noise is
    return rendered("diagnosis_gap.html", parts=kept)


@dataclass(frozen=True)
class GapPart:
    """A part of the squared error."""

    label: str
    share: float
    colour: str
    shown: bool  # in the bar


def share_table(parts: Sequence[Part]) -> Markup:
    """Each effect that holds: what it closes of the gap, alone and last, and how sure that is."""
    return rendered("diagnosis_shares.html", parts=parts)


def _estimated(diagnosis: Diagnosis, t: Term) -> Iterator[tuple[str, str, str]]:
    for name, e in estimates(diagnosis.chosen.fit, t).items():
        yield name, e.shown, e.shown_ci95


def _effects(diagnosis: Diagnosis, errors: SelectionErrors) -> Iterator[dict[str, Any]]:
    """Each effect of the verdict: drawn, with its parameters."""
    for number, signature in enumerate(errors.signatures):
        t, drawn = signature.term, signature_figure(signature)
        values = estimates(diagnosis.chosen.fit, t).items()
        yield {
            "term": t,
            "said": in_figures(diagnosis, t, diagnosis.chosen.fit),
            "probable": probabilities(diagnosis, number),
            "figure": plot(drawn, f"signature_{number}", with_library=number == 0, kind="plot twin"),
            "parameters": [(n, e.shown, f"{e.shown_ci95}{', at its bound' if e.at_bound else ''}") for n, e in values],
        }


def millimetres(length_m: float) -> str:
    """To a hundredth, as tables of errors compare them."""
    return f"{length_m * 1e3:.2f} mm"


WORDS = ("rms", "noise", "held-out poses", "95 % interval")
MEANING = (
    "A quarter of the configurations was set aside before anything was fitted; the errors before and after are on "
    "these poses. Sets of effects were compared by how probable they make all other poses, all parameters integrated "
    "out, with and without something unknown besides. Every set was fitted together with ordinary calibration "
    "(precurvature magnitudes, stiffness ratios, Poisson's ratios).",
    "All is named only if what remains looks like noise. Where it does not, the data show something that the "
    "catalogue does not have. A part of the truth is then said of effects that act with a probability of 0.99, "
    "whatever else does. The best of the wrong names is not offered in its place.",
)


def write_diagnosis_report(path: str | os.PathLike[str], diagnosis: Diagnosis, errors: SelectionErrors) -> None:
    """Write report.html, one file that loads nothing, whole or not at all."""
    write_atomically(path, diagnosis_report_html(diagnosis, errors))


def diagnosis_report_html(diagnosis: Diagnosis, errors: SelectionErrors) -> str:
    """The content of report.html."""
    is_settled = diagnosis.verdict in ("named", "no_missing_effect")
    is_told = (is_settled or diagnosis.partial) and not diagnosis.interrupted
    good = is_settled and not (diagnosis.interrupted or diagnosis.reading or diagnosis.other_tubes)
    gap, left = diagnosis.gap, diagnosis.judgement.adequacy
    return rendered(
        "diagnosis.html",
        title=f"Diagnosis of {diagnosis.robot.name}",
        diagnosis=diagnosis,
        robot=diagnosis.robot,
        data=diagnosis.data,
        headline=headline(diagnosis),
        verdict=verdict_sentence(diagnosis),
        standing="good" if good else "caution" if is_told else "bad",
        figures=[
            (millimetres(gap.before.rms_m), term("rms", "rms error, calibrated without effects")),
            (millimetres(gap.after.rms_m), term("rms", "rms error with the effects")),
            (millimetres(gap.floor_m), term("noise", "noise of the measurement")),
            (gap.after.poses, term("held-out poses", "poses kept aside")),
        ],
        split=gap_split(diagnosis),
        shares=share_table(diagnosis.partial.parts) if diagnosis.partial else "",
        effects=list(_effects(diagnosis, errors)),
        built_lines=built_lines(diagnosis),
        where=plot(where_figure(diagnosis, errors), "where", with_library=not errors.signatures, kind="plot twin"),
        gap=plot(gap_figure(diagnosis), "gap"),
        path=plot(path_figure(diagnosis), "path") if diagnosis.path else "",
        regions=[("all", gap.before, gap.after), *((name, *both) for name, both in gap.regions.items())],
        proposals=[_proposed(proposal) for proposal in diagnosis.proposals],
        remaining=[
            ("all poses of the selection", left.total),
            ("between configurations", left.between),
            ("between approaches of one configuration", left.within),
            ("poses kept aside", gap.chi_square),
        ],
        estimated=partial(_estimated, diagnosis),
        mm=millimetres,
        unit=unit,
        MEANING=MEANING,
        WORDS=WORDS,
    )


def _proposed(proposal: Proposal) -> tuple[str, ...]:
    """A configuration that would separate what the data cannot."""
    theta = ", ".join(f"{x:.0f}" for x in np.degrees(proposal.theta_commanded))
    l = ", ".join(f"{x:.1f}" for x in proposal.l_commanded * 1e3)  # noqa: E741
    return theta, l, " against ".join(proposal.between), f"{proposal.log_odds:.1f}"
