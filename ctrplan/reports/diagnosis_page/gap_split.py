"""The gap in one bar: what the named effects close, what remains, what is noise; and each effect's share in a table."""

from __future__ import annotations

from collections.abc import Sequence

from ctrplan.diagnosis.partly import Partly
from ctrplan.diagnosis.result import Diagnosis
from ctrplan.reports import palette
from ctrplan.reports.html_page import Markup, escaped, table, tag

NAMED, REMAINING, NOISE = palette.SERIES[0], palette.SERIES[1], palette.PLATE
LEAST_SHOWN = 0.002  # of the bar


def gap_split(found: Diagnosis) -> Markup:
    """Of the mean squared error on the poses kept aside, calibrated without effects."""
    gap = found.gap
    whole = max(gap.before.rms_m, gap.after.rms_m, gap.floor_m) ** 2
    noise = min(gap.floor_m, gap.after.rms_m) ** 2 / whole
    remaining = gap.after.rms_m**2 / whole - noise
    names = " and ".join(t.effect.title for t in found.listed) or "effects"
    parts = [
        (f"named: {names}", 1 - remaining - noise, NAMED),
        ("remains, unexplained", remaining, REMAINING),
        ("noise of the measurement", noise, NOISE),
    ]
    shown = [(label, share, colour) for label, share, colour in parts if share > LEAST_SHOWN]
    words = tag("p", "Shares are of squared errors on the poses kept aside, which add up.", kind="quiet small")
    return tag("div", _bar(shown), _key(shown), words)


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
        f'<span style="margin-right: 22px"><i style="{square}; background: {colour}"></i>'
        f"<b>{100 * share:.0f} %</b> {escaped(label)}</span>"
        for label, share, colour in parts
    ]
    return Markup(f"<p>{''.join(entries)}</p>")


def share_table(partly: Partly) -> Markup:
    """Each effect that holds: what it closes of the gap, alone and last, and how sure that is."""
    rows = (
        (
            part.evidence.term.effect.title,
            f"{100 * part.alone:.0f} %",
            f"{100 * part.last:.0f} %",
            f"{part.evidence.z:.1f}",
            f"{100 * part.evidence.winning:.0f} %",
            f"{part.evidence.gain:.0f} ({part.evidence.chance:.0f})",
        )
        for part in partly.parts
    )
    header = (
        "Effect",
        "Closes alone",
        "Closes as the last",
        "Standard errors above none",
        "Blocks that speak for it",
        "Gain (chance)",
    )
    return table(header, rows)


def rest_lines(partly: Partly) -> list[Markup]:
    """What remains: size, memory, what it is fixed to, where; and what was found and does not hold."""
    doubts = [f"{e.term.effect.title}: {'; '.join(e.doubts)}." for e in partly.doubted]
    lines = [tag("p", partly.rest.sentence), tag("p", partly.rest.place)]
    if doubts:
        lines += [
            tag("p", "Found on the way, and not certain enough to be named:"),
            tag("ul", *(tag("li", d) for d in doubts)),
        ]
    return lines
