"""report.html of a diagnosis: where it disagrees, what was tried, the verdict, the gap on the test set, what is
next.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.next_experiment import Proposal
from ctrplan.diagnosis.result import SETS_TOLD, Diagnosis
from ctrplan.diagnosis.sentences import built_lines, headline, in_percent, probability, verdict_sentence
from ctrplan.effects.learned.inputs import unit
from ctrplan.pipeline.term import Term
from ctrplan.reports import looks
from ctrplan.reports.diagnosis_figures import SelectionErrors, gap_figure, path_figure, signature_figure, where_figure
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
    names = " and ".join(t.effect.title for t in diagnosis.listed) or "effects"
    built = max(diagnosis.named_gap.after.rms_m**2 - gap.after.rms_m**2, 0.0) / whole if diagnosis.named_gap else 0.0
    built = min(built, max(1 - remaining - noise, 0.0))
    parts = [
        (f"named: {names}", max(1 - remaining - noise - built, 0.0), NAMED),
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


def _sets(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """The most probable sets of effects: names, log evidence over that of none, posterior probability."""
    answer = diagnosis.answer
    told = list(zip(answer.hypotheses, answer.posterior.tolist(), strict=True))[:SETS_TOLD]
    return [
        (", ".join(sorted(h.names)) or "none", f"{h.evidence - answer.base.evidence:.1f}", probability(share))
        for h, share in told
    ]


def _estimated(diagnosis: Diagnosis, t: Term) -> Iterator[tuple[str, str, str]]:
    for name, e in estimates(diagnosis.chosen.fit, t).items():
        yield name, e.shown, e.shown_ci95


def _effects(diagnosis: Diagnosis, errors: SelectionErrors) -> Iterator[dict[str, Any]]:
    """Each effect of the verdict: drawn, its parameters, and what fits worse in its place."""
    for number, signature in enumerate(errors.signatures):
        t, drawn = signature.term, signature_figure(signature)
        finding = next(f for f in diagnosis.judgement.findings if f.term.key == t.key)
        values = estimates(diagnosis.chosen.fit, t).items()
        yield {
            "term": t,
            "figure": plot(drawn, f"signature_{number}", with_library=number == 0, kind="plot twin"),
            "parameters": [(n, e.shown, f"{e.shown_ci95}{', at its bound' if e.at_bound else ''}") for n, e in values],
            "probability": probability(finding.probability),
            "rivals": [(a.term.effect.title, probability(a.probability)) for a in finding.alternatives],
        }


def millimetres(length_m: float) -> str:
    """To a hundredth, as tables of errors compare them."""
    return f"{length_m * 1e3:.2f} mm"


WORDS = ("rms", "noise", "held-out poses", "95 % interval")
MEANING = (
    "One model is behind all figures: ordinary calibration, the effects of the catalogue, and random errors of every "
    "stage that nobody has named, with sizes that the data show. Sets of effects are compared by the probability of "
    "all measurements, every parameter integrated out over what is plausible. The probability of an effect is its "
    "share among all sets; a name is given from 0.99 on.",
    "A quarter of the configurations was set aside before anything was fitted; the errors before and after are on "
    "these poses. Where what nobody has named is larger than half the noise, the data show something that the "
    "catalogue does not have: effects that are certain beside it are listed, and the best of the wrong names is not.",
)


def write_diagnosis_report(path: str | os.PathLike[str], diagnosis: Diagnosis, errors: SelectionErrors) -> None:
    """Write report.html, one file that loads nothing, whole or not at all."""
    write_atomically(path, diagnosis_report_html(diagnosis, errors))


def diagnosis_report_html(diagnosis: Diagnosis, errors: SelectionErrors) -> str:
    """The content of report.html."""
    good = diagnosis.verdict in ("named", "no_missing_effect") and not diagnosis.interrupted
    gap = diagnosis.gap
    return rendered(
        "diagnosis.html",
        title=f"Diagnosis of {diagnosis.robot.name}",
        diagnosis=diagnosis,
        robot=diagnosis.robot,
        data=diagnosis.data,
        headline=headline(diagnosis),
        verdict=verdict_sentence(diagnosis),
        standing="good"
        if good
        else "caution"
        if diagnosis.verdict in ("partial", "wrong_tube") and not diagnosis.interrupted
        else "bad",
        figures=[
            (millimetres(gap.before.rms_m), term("rms", "rms error, calibrated without effects")),
            (millimetres(gap.after.rms_m), term("rms", "rms error with the effects")),
            (millimetres(gap.floor_m), term("noise", "noise of the measurement")),
            (gap.after.poses, term("held-out poses", "poses kept aside")),
        ],
        split=gap_split(diagnosis),
        sets=_sets(diagnosis),
        possible=[(name, probability(p)) for name, p in diagnosis.answer.of_effects.items()],
        readings=[reading.sentence for reading in diagnosis.readings],
        tubes=[fault.sentence for fault in diagnosis.judgement.tubes],
        unnamed=[
            (name, f"{m * 1e3:.3f} mm", in_percent((m / max(diagnosis.judgement.unnamed.rms_m, 1e-12)) ** 2))
            for name, m in diagnosis.judgement.unnamed.parts.items()
        ],
        effects=list(_effects(diagnosis, errors)),
        built_lines=built_lines(diagnosis),
        where=plot(where_figure(diagnosis, errors), "where", with_library=not errors.signatures, kind="plot twin"),
        gap=plot(gap_figure(diagnosis), "gap"),
        path=plot(path_figure(diagnosis), "path"),
        regions=[("all", gap.before, gap.after), *((name, *both) for name, both in gap.regions.items())],
        proposals=[_proposed(proposal) for proposal in diagnosis.proposals],
        remaining=[
            ("all poses of the selection", diagnosis.remaining),
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
    return theta, l, " against ".join(proposal.between), proposal.odds
