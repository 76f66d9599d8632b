"""A built term in words: its formula, and what acts in the same way. Never a cause."""

from __future__ import annotations

from collections.abc import Mapping

from ctrplan.effects.learned.inputs import unit
from ctrplan.effects.learned.parts import Part, inputs, period_deg
from ctrplan.effects.learned.ranges import Ranges
from ctrplan.effects.learned.targets import AXES, Target

Parts = Mapping[str, tuple[int, Part]]  # parameter -> axis and part


def formula(parts: Parts, on: Target, ranges: Ranges, values: Mapping[str, float]) -> str:
    """Coefficients [unit] times shapes, axis after axis; rotations in deg, lengths in mm."""
    lines = []
    for k, axis in enumerate(AXES):
        mine = [(name, part) for name, (a, part) in parts.items() if a == k and name in values]
        if mine:
            said = [_summand(values[name] / on.kind.si, part, on.kind.unit, ranges) for name, part in mine]
            text = " ".join(said)
            text = text.removeprefix("+ ") if text.startswith("+") else "-" + text.removeprefix("- ")
            lines.append(f"{axis}: {text}" if on.kind.has_axes else text)
    return f"{on.words} changes by {'; '.join(lines)}"


def likeness(parts: Parts, on: Target) -> str:
    """What acts in the same way, as a remark that names no cause."""
    several = [part for _, part in parts.values()]
    periods = sorted({period for part in several if (period := period_deg(part))}, reverse=True)
    names = list(dict.fromkeys(name for part in several for name in inputs(part)))
    with_period = f" with a period of {', '.join(f'{p:g}' for p in periods)} deg" if periods else ""
    start = f"acts in the {on.kind.stage} on {on.words}{with_period}, going with {', '.join(names) or 'nothing'}"
    return f"{start}: {_like(on, names, periods)}; that is no proof of a cause"


def _like(on: Target, names: list[str], periods: list[float]) -> str:
    own = f"theta_{on.tube}"
    if on.of_way:
        return "like play or friction of the drive"
    if on.kind_name == "theta" and names == [own] and periods:
        return "like an eccentricity" if periods == [360.0] else "like a ripple of gears"
    if on.kind_name == "theta" and any(name.startswith("l_") for name in names):
        return "like a guide that turns a tube while it is pushed"
    if on.kind.stage == "drive":
        return "like cross-talk between joints" if own not in names else "like an uneven gear"
    if on.kind_name == "plate":
        return "like a guide or plate that bends"
    if on.kind_name == "sensor":
        columns = [name for name in names if not unit(name) and name not in ("tx", "ty", "tz")]
        return "like a tracker that drifts with it" if columns or "time" in names else "like a distortion of the sensor"
    return "like a property of the tube that is not the same everywhere"


def _summand(value: float, part: Part, of: str, ranges: Ranges) -> str:
    sign = "-" if value < 0 else "+"
    shapes = [factor.in_words(ranges) for factor in part if factor.form != "constant"]
    unit_word = "%" if of == "percent" else of
    return f"{sign} {' '.join([f'{abs(value):.3g} {unit_word}', *shapes])}"
