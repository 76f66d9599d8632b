"""The verdict in sentences."""

from __future__ import annotations

import math

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.gap import LARGEST_REST, times_noise
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.measurement.measurements import MOST_ROWS
from ctrplan.pipeline.term import Term


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """One sentence a person can repeat, with its probability."""
    judgement, gap = diagnosis.judgement, diagnosis.gap
    names = " and ".join(_with_alternatives(diagnosis, k) for k in range(len(diagnosis.listed)))
    tubes = "; ".join(fault.sentence for fault in judgement.tubes)
    also = f" {tubes[:1].upper()}{tubes[1:]}." if tubes else ""
    none = probability(judgement.none)
    if diagnosis.verdict == "wrong_tube":
        return (
            f"{tubes[:1].upper()}{tubes[1:]}. With that, nothing else is missing (probability {none}): the model "
            f"agrees with the measurements to their noise{_but(diagnosis)}."
        )
    if diagnosis.verdict == "no_missing_effect":
        return (
            f"No missing effect (probability {none}): calibrated, the model agrees with the measurements to their "
            f"noise{_but(diagnosis)}."
        )
    if diagnosis.verdict == "named":
        them = "it" if len(diagnosis.listed) == 1 else "them"
        agrees = f"With {them} the model agrees with the measurements to their noise{_but(diagnosis)}."
        return f"Missing: {names}. {agrees}{also}{_left_open(diagnosis)}"
    if diagnosis.verdict == "ambiguous" and not names:
        told = ", ".join(f"{name} {probability(p)}" for name, p in judgement.possible.items())
        return f"Undecided: nothing is missing ({none}), or one of these is: {told}. The poses proposed decide."
    if diagnosis.verdict == "ambiguous":
        return (
            f"Missing: {names}. The data can't tell them apart, both would explain them.{also}{_left_open(diagnosis)}"
        )
    closed = f"{gap.before.rms_m * 1e3:.2f} mm off without and {gap.after.rms_m * 1e3:.2f} mm with"
    more = f" {_built(diagnosis)}" if diagnosis.built else ""
    if diagnosis.verdict == "partial":
        beside = "something remains that nothing in the catalogue explains"
        return f"In part: {names}. Tips are {closed}; {beside}.{more}{also}"
    left = judgement.unnamed.over_noise
    rest = f"what remains is {left:.1f} times the noise" if judgement.unnamed.is_large else "what remains is no noise"
    return f"Unexplained: nothing in the catalogue explains the measurements, {rest}.{more}{also}"


def probability(p: float) -> str:
    """As a reader wants it: never 1."""
    return "above 0.999" if p > 0.999 else "below 0.001" if p < 0.001 else f"{p:.3f}".rstrip("0")


def _left_open(diagnosis: Diagnosis) -> str:
    """Why poses kept aside are further off than noise: others do not settle all parameters."""
    after, floor, left_open = diagnosis.gap.after.rms_m, diagnosis.gap.floor_m, diagnosis.gap.spread_m
    if times_noise(after, floor) <= LARGEST_REST or times_noise(after, math.hypot(floor, left_open)) > LARGEST_REST:
        return ""
    off = f" Poses kept aside are {after * 1e3:.2f} mm off, the noise is {floor * 1e3:.2f} mm:"
    return f"{off} parameters are uncertain by {left_open * 1e3:.2f} mm there, more configurations would settle them."


def _built(diagnosis: Diagnosis) -> str:
    """What was built and where it acts, as a sentence."""
    where = " and ".join(t.effect.title.removeprefix("a built term of ") for t in diagnosis.built_terms)
    changes = "changes" if len(diagnosis.built_terms) == 1 else "change"
    return f"Built of the rest: {_count(diagnosis)} that {changes} {where}, whatever the cause."


def effect_lines(diagnosis: Diagnosis) -> list[str]:
    """Per effect its parameters with intervals."""
    lines = []
    for t in diagnosis.listed:
        values = (f"{name} = {e.shown} ({e.shown_ci95})" for name, e in estimates(diagnosis.chosen.fit, t).items())
        lines.append(f"{t.name} ({t.effect.stage}): {', '.join(values)}")
    return lines


def other_lines(diagnosis: Diagnosis) -> list[str]:
    """What may act besides, what is built, and what nobody has named."""
    lines = []
    if possible := diagnosis.judgement.possible:
        told = ", ".join(f"{name} {probability(p)}" for name, p in list(possible.items())[:4])
        lines.append(f"not certain enough to be named: {told}")
    return [*lines, *built_lines(diagnosis), diagnosis.judgement.unnamed.sentence]


def built_lines(diagnosis: Diagnosis) -> list[str]:
    """What was built of the rest, how it acts, and that it is no cause; with its coefficients."""
    if not diagnosis.built or not diagnosis.named_gap:
        return []
    before, after = (gap.after.rms_m * 1e3 for gap in (diagnosis.named_gap, diagnosis.gap))
    lines = [
        f"built of what remained: {_count(diagnosis)}, with which tips are {after:.2f} mm off "
        f"instead of {before:.2f} mm; "
        "it names no cause"
    ]
    chain = diagnosis.chosen.fit.chain
    values = {t.key: value for t, value in zip(chain.terms, chain.values(diagnosis.chosen.fit.p), strict=True)}
    for t in diagnosis.built_terms:
        stated = t.effect.stated(values[t.key])
        lines.append(f"{t.name} ({t.effect.stage}): {stated['formula']}")
        lines.append(f"{t.name} {stated['may_be']}")
    return lines


def _count(diagnosis: Diagnosis) -> str:
    count = len(diagnosis.built_terms)
    return "a term" if count == 1 else f"{count} terms"


def _but(diagnosis: Diagnosis) -> str:
    """The poses that are not meant, named with a sentence of green."""
    count, rows = len(diagnosis.outlier_rows), ", ".join(map(str, diagnosis.outlier_rows[:MOST_ROWS]))
    more = " ..." if count > MOST_ROWS else ""
    return f", but for {count} {'pose' if count == 1 else 'poses'} left out (row {rows}{more})" if count else ""


def _with_alternatives(diagnosis: Diagnosis, k: int) -> str:
    finding = diagnosis.judgement.findings[k]
    both = [(finding.term, finding.probability), *((a.term, a.probability) for a in finding.alternatives)]
    return " or ".join(f"{in_words(t)}, probability {probability(p)}" for t, p in both)


def in_words(t: Term) -> str:
    """With the name that files and tables have."""
    title = t.effect.title
    return title if title == t.name else f"{title} ({t.name})"


def headline(diagnosis: Diagnosis) -> str:
    """What is missing, in a few words without names of files."""
    judgement = diagnosis.judgement
    if diagnosis.verdict == "no_missing_effect":
        return "Nothing is missing"
    if diagnosis.verdict == "ambiguous" and not judgement.findings:
        return "Undecided: nothing may be missing"
    titles = [
        " or ".join(t.effect.title for t in (finding.term, *(a.term for a in finding.alternatives)))
        for finding in judgement.findings
    ]
    titles += [fault.sentence.split(":")[0] for fault in {f.tube: f for f in judgement.tubes}.values()]
    if diagnosis.verdict in ("partial", "unexplained"):
        titles.append("something that the catalogue does not have" if not titles else "something more")
    text = " and ".join(titles)
    return text[:1].upper() + text[1:]


def in_percent(share: float) -> str:
    """A share for a table."""
    return f"{100 * float(np.clip(share, 0, 1)):.0f} %"
