"""The gap in one bar: what is named, what is built, what remains, what is noise; and each effect's share in a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ctrplan.calibration.estimates import estimates
from ctrplan.diagnosis.frames import FRAMES
from ctrplan.diagnosis.partly import Partly
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.diagnosis.sentences import built_lines
from ctrplan.diagnosis.shares import Closing
from ctrplan.effects.learned.inputs import unit
from ctrplan.reports import palette
from ctrplan.reports.html_page import Markup, escaped, table, tag

NAMED, REMAINING, NOISE, BUILT = palette.SERIES[0], palette.SERIES[1], palette.PLATE, palette.SERIES[2]
FRAMED = palette.SERIES[4]
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


def share_table(partly: Partly) -> Markup:
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


def rest_lines(found: Diagnosis) -> list[Markup]:
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
