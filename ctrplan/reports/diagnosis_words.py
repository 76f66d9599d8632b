"""The verdict in sentences."""

from __future__ import annotations

import math

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.calibration.least_squares import Fit
from ctrplan.diagnosis.correlated_bench import FRAME, SHIFT
from ctrplan.diagnosis.held_out import LARGEST_REST, times_noise
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.verdict import Posterior, shown
from ctrplan.measurement.measurements import MOST_ROWS
from ctrplan.pipeline.term import Term

WORTH_TELLING = 0.9  # of the error without them, which frames have to undercut

IN_WORDS = {
    "configuration": "belongs to the configuration",
    "joints": "goes along with the joints",
    "time": "goes along with the time",
    "order": "goes along with the order of the rows",
    "history": "goes along with the way poses were reached",
}


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """What a person can repeat, a wrong tube first."""
    tubes = " and ".join(diagnosis.other_tubes)
    sentence = f"{_verdict(diagnosis)}{_how_probable(diagnosis)}"
    return f"{tubes[0].upper()}{tubes[1:]}. Taken for that, {sentence[0].lower()}{sentence[1:]}" if tubes else sentence


def _how_probable(diagnosis: Diagnosis) -> str:
    """The probability of the verdict, and that of something unknown where it is higher."""
    if diagnosis.posterior is None or diagnosis.verdict_probability is None:
        return ""
    probability, unknown = shown(diagnosis.verdict_probability), diagnosis.posterior.of_unknown
    if diagnosis.verdict == "unexplained" and unknown < 1 / 2:  # that no name is certain is no wager on something else
        return f" That something acts which the catalogue lacks has {shown(unknown)}."
    sentence = f" This verdict has {probability}"
    if diagnosis.verdict in ("partial", "unexplained"):
        return f"{sentence}.{_along(diagnosis.posterior)}"
    if diagnosis.verdict_probability < unknown:
        sentence += f"; that something acts which the catalogue lacks has {shown(unknown)}"
    return f"{sentence}."


def _along(posterior: Posterior) -> str:
    """What something unknown goes along with, where that is more probable than all else."""
    name = max(posterior.along, key=lambda input_name: posterior.along[input_name], default="")
    if not name or min(posterior.along[name], posterior.of_unknown) < 1 / 2:
        return ""
    return f" What is unknown {IN_WORDS[name]}, {shown(posterior.along[name])}."


def probabilities(diagnosis: Diagnosis, k: int) -> str:
    """Probabilities of the k-th effect of the verdict and of what may stand for it, in words; empty without any."""
    if diagnosis.posterior is None:
        return ""
    finding = diagnosis.judgement.findings[k]
    others = [f"{a.term.name} {shown(diagnosis.posterior.of_effect(a.term.name))}" for a in finding.alternatives]
    return " or ".join([shown(diagnosis.posterior.of_effect(finding.term.name)), *others])


def _verdict(diagnosis: Diagnosis) -> str:
    """One sentence about effects."""
    names = " and ".join(_with_alternatives(diagnosis, k) for k in range(len(diagnosis.listed)))
    left = max(
        diagnosis.judgement.adequacy.total.ratio**0.5, times_noise(diagnosis.gap.after.rms_m, diagnosis.gap.floor_m)
    )
    if diagnosis.verdict == "no_missing_effect":
        return f"No missing effect: calibrated, the model agrees with the measurements to their noise{_but(diagnosis)}."
    if diagnosis.verdict == "named":
        them = "it" if len(diagnosis.listed) == 1 else "them"
        agrees = f"With {them} the model agrees with the measurements to their noise{_but(diagnosis)}."
        return f"Missing: {names}. {agrees}{_left_open(diagnosis)}"
    if diagnosis.partial:
        closed = (
            f"{diagnosis.gap.before.rms_m * 1e3:.2f} mm off without and {diagnosis.gap.after.rms_m * 1e3:.2f} mm with"
        )
        more = f" {_built(diagnosis)}" if diagnosis.built else ""
        return f"In part: {names}. Tips are {closed}; something remains that nothing in the catalogue explains.{more}"
    if diagnosis.verdict == "ambiguous":
        return f"Missing: {names}. The data can't tell them apart, both would explain them.{_left_open(diagnosis)}"
    rest = f"what remains is {left:.1f} times the noise"
    if diagnosis.built:
        return f"Unexplained: nothing in the catalogue explains the measurements. {_built(diagnosis)}"
    if diagnosis.together:
        return f"Unexplained: {_together(diagnosis)}; that is in the robot file, no name is certain, {rest}."
    if names:
        return f"Unexplained: {names}; at work, but not alone, {rest}."
    if diagnosis.posterior and diagnosis.posterior.of_unknown < 1 / 2:
        return f"Unexplained: it is not certain what acts, {rest}."
    return f"Unexplained: nothing in the catalogue explains the measurements, {rest}."


def _left_open(diagnosis: Diagnosis) -> str:
    """Why poses kept aside are further off than noise: others do not settle all parameters, or the noise varies."""
    after, floor, left_open = diagnosis.gap.after.rms_m, diagnosis.gap.floor_m, diagnosis.gap.spread_m
    if times_noise(after, floor) <= LARGEST_REST:
        return ""
    off = f" Poses kept aside are {after * 1e3:.2f} mm off, the noise is {floor * 1e3:.2f} mm:"
    if times_noise(after, math.hypot(floor, left_open)) > LARGEST_REST:
        return f"{off} it has heavy tails."
    return f"{off} parameters are uncertain by {left_open * 1e3:.2f} mm there, more configurations would settle them."


def _built(diagnosis: Diagnosis) -> str:
    """What was built and where it acts, as a sentence."""
    where = " and ".join(t.effect.title.removeprefix("a built term of ") for t in diagnosis.built_terms)
    changes = "changes" if len(diagnosis.built_terms) == 1 else "change"
    return f"Built of the rest: {_count(diagnosis)} that {changes} {where}, whatever the cause."


def _together(diagnosis: Diagnosis) -> str:
    """That what some effects do is done, and how probable it is that they do it."""
    terms, posterior = diagnosis.together, diagnosis.posterior
    does, by = ("does", "it") if len(terms) == 1 else ("do", "them")
    likely = f" ({shown(min(posterior.of_effect(t.name) for t in terms))})" if posterior else ""
    names = " and ".join(t.name for t in terms)
    return f"what {names} {does} is done, by {by}{likely} or by another cause"


def effect_lines(diagnosis: Diagnosis) -> list[str]:
    """Per effect its parameters with intervals."""
    lines = []
    for k, t in enumerate(diagnosis.listed):
        values = [f"{name} = {e.shown} ({e.shown_ci95})" for name, e in estimates(diagnosis.chosen.fit, t).items()]
        probable = f" acts with {likely}" if (likely := probabilities(diagnosis, k)) else ""
        lines.append(f"{t.name}{probable} ({t.effect.stage}): {', '.join(values)}")
    if diagnosis.together and lines:
        lines.append(f"{_together(diagnosis)}: it is in the robot file, and no name")
    effects = [*lines, *built_lines(diagnosis), *_free_frame_lines(diagnosis)]
    return [*_frame_lines(diagnosis), *effects, *([rest.sentence] if (rest := diagnosis.rest) else [])]


def _frame_lines(diagnosis: Diagnosis) -> list[str]:
    """What frames found anew do, which are no effect but a registration, where that is a part of the gap."""
    if not diagnosis.framed_gap or diagnosis.framed_gap.after.rms_m > WORTH_TELLING * diagnosis.framed_gap.before.rms_m:
        return []
    before, after = (errors.rms_m * 1e3 for errors in (diagnosis.framed_gap.before, diagnosis.framed_gap.after))
    count = len(np.unique(diagnosis.data.frames))
    whose = (
        "its own frame in the tracker's"
        if count == 1
        else f"a frame of its own in each of {count} set-ups of the tracker"
    )
    if (homings := len(np.unique(diagnosis.data.homings))) > 1:
        whose += f" and zeros of its own after each of {homings} homings"
    return [f"with {whose} the robot is {after:.2f} mm off instead of {before:.2f} mm, before any effect"]


def _free_frame_lines(diagnosis: Diagnosis) -> list[str]:
    """How far the base is turned where that is no name, although a built term stands beside it."""
    chain, p = diagnosis.chosen.fit.chain, diagnosis.chosen.fit.p
    free = [s for t, s in zip(chain.terms, chain.slices(), strict=True) if t.name == FRAME]
    if not diagnosis.built_terms or not free or FRAME in {t.name for t in diagnosis.listed}:
        return []
    turn, shift = np.degrees(np.linalg.norm(p[free[0]][:3])), 1e3 * np.linalg.norm(p[free[0]][3:])
    return [
        f"the base's frame is turned by {turn:.2g} deg and shifted by {shift:.2g} mm, free in every fit: whether that, "
        "the built term or what remains is at work is not told"
    ]


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
    others = (in_figures(diagnosis, alternative.term, alternative.scored.fit) for alternative in finding.alternatives)
    return " or ".join([in_figures(diagnosis, finding.term, diagnosis.chosen.fit), *others])


MOST_NUMBERS = 3  # of an effect that stand in a sentence


def in_figures(diagnosis: Diagnosis, t: Term, fit: Fit) -> str:
    """What an effect does with the values of a fit, and how files say it.

    "tube 2 turns 5 % too far (joint_scale theta_2 = 0.0498)". Values whose intervals hold the neutral one are left out,
    if there are others. In a fit without the term it is its title and name.
    """
    every = estimates(fit, t)
    if not every:
        return f"{t.effect.title} ({t.name})"
    neutral = {parameter.name: parameter.neutral for parameter in t.parameters}
    sure = {name: e for name, e in every.items() if e.differs_from(neutral[name])} or every
    clause = t.effect.in_figures({name: e.value for name, e in sure.items()}, diagnosis.robot)
    if diagnosis.slip and t.name == diagnosis.slip.effect:
        whose, since = ("frame 2 of the tracker", " the tracker") if t.name == SHIFT else ("after homing 2", "")
        clause = clause.replace(whose, f"from row {diagnosis.slip.row} on{since}")
        clause += ", as after the tracker was knocked" if t.name == SHIFT else ", as after a collar slipped"
    numbers = [f"{name} = {e.shown}" for name, e in sure.items()]
    more = f" and {len(numbers) - MOST_NUMBERS} more" if len(numbers) > MOST_NUMBERS else ""
    return f"{clause or t.effect.title} ({t.name} {', '.join(numbers[:MOST_NUMBERS])}{more})"


def headline(diagnosis: Diagnosis) -> str:
    """What is missing, in a few words without names of files."""
    tubes = [clause.partition(":")[0] for clause in diagnosis.other_tubes]
    if diagnosis.verdict == "no_missing_effect":
        return f"{tubes[0][:1].upper()}{tubes[0][1:]}" if tubes else "Nothing is missing"
    titles = tubes + [
        " or ".join(_title(diagnosis, t) for t in (finding.term, *(a.term for a in finding.alternatives)))
        for finding in diagnosis.judgement.findings
    ]
    if diagnosis.verdict in ("partial", "unexplained"):
        titles.append("something that the catalogue does not have" if not titles else "something more")
    text = " and ".join(titles)
    return text[:1].upper() + text[1:]


def _title(diagnosis: Diagnosis, t: Term) -> str:
    if diagnosis.slip is None or t.name != diagnosis.slip.effect:
        return t.effect.title
    return "a tracker that was knocked" if t.name == SHIFT else "a collar that slipped"
