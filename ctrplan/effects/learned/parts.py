"""The parts of a built term: products of few shapes of its inputs, each named in full, and the formula in words.

A name such as `sin_3_theta_2` or `slope_l_3_times_sign_theta_2` says the shape. Every shape is a pure number of at most
about 1, so that a coefficient is the largest amount of its part, in the unit of what it acts on.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import Array
from ctrplan.effects.learned.inputs import AXES, InputRange, Ranges, Situation, Target, clamped, exists, unit, values

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

TIMES = "_times_"
BUMP_WIDTH = 0.7
LARGEST = 1.05  # of any shape: splines swing a little beyond their knots
FORMS = (
    ("wave", re.compile(r"(sin|cos)_([1-9])_(theta_\d+|turn_\d+)")),
    ("swing", re.compile(r"(sin|cos)_([1-9])_over_(time)")),
    ("slope", re.compile(r"slope_(\w+)")),
    ("square", re.compile(r"square_(\w+)")),
    ("knot", re.compile(r"knot_([1-9])_of_([2-9])_(\w+)")),
    ("bump", re.compile(r"bump_([1-9])_of_([2-9])_(\w+)")),
    ("sign", re.compile(r"sign_(theta|l)_([1-9]\d*)")),
    ("constant", re.compile(r"constant")),
)


@dataclass(frozen=True)
class Factor:
    """A shape of one input; `input` is empty where there is none."""

    form: str
    input: str = ""
    numbers: tuple[int, ...] = ()
    word: str = ""

    @property
    def periodic(self) -> bool:
        """Whether whole turns of its input are nothing."""
        return self.form == "wave"

    def __call__(self, at: Situation, ranges: Ranges) -> Array:
        """(K,) of the poses; computed once for a situation and a range of the input."""
        key = self, ranges.get(self.input)
        if key not in at.shapes:
            at.shapes[key] = _SHAPES[self.form](self, at, ranges)
        return at.shapes[key]

    def in_words(self, ranges: Ranges) -> str:
        """The factor as a formula."""
        if self.form == "constant":
            return "1"
        if self.form == "sign":
            return f"sign of the last motion of {self.word}_{self.numbers[0]}"
        if self.form == "wave":
            times = "" if self.numbers[0] == 1 else f"{self.numbers[0]} "
            return f"{self.word}({times}{self.input})"
        span = ranges[self.input]
        if self.form == "swing":
            return f"{self.word}({180 * self.numbers[0]} deg ({self.input} - {span.low:.4g}) / {2 * span.half:.4g})"
        from_middle = f"{'+' if span.middle < 0 else '-'} {abs(span.middle):.4g}"
        scaled = f"({self.input} {from_middle}) / {span.half:.4g}"
        if self.form in ("knot", "bump"):
            place = np.linspace(span.low, span.high, self.numbers[1])[self.numbers[0] - 1]
            shape = "spline" if self.form == "knot" else "bump"
            return f"{shape}({self.input}; 1 at {place:.4g} {unit(self.input)})".replace(" )", ")")
        return f"({scaled})^2" if self.form == "square" else f"({scaled})"


Part = tuple[Factor, ...]


def part(name: str, n: int) -> Part | None:
    """The part of a name without axis and unit, for a robot of n tubes; None where there is none of that name."""
    results = [_factor(factor, n) for factor in name.split(TIMES)]
    return None if None in results else tuple(f for f in results if f is not None)


def inputs(of: Part) -> dict[str, bool]:
    """The inputs of a part, and whether each is periodic alone."""
    return {factor.input: factor.periodic for factor in of if factor.input}


def amounts(of: Part, at: Situation, ranges: Ranges) -> Array:
    """(K,) of a part."""
    product: Array = np.prod([factor(at, ranges) for factor in of], axis=0)
    return product


def _factor(name: str, n: int) -> Factor | None:
    for form, pattern in FORMS:
        result = pattern.fullmatch(name)
        if not result:
            continue
        if form == "constant":
            return Factor(form)
        if form == "sign":
            return Factor(form, numbers=(int(result[2]),), word=result[1]) if int(result[2]) <= n else None
        if not exists(result[result.lastindex or 1], n):
            return None
        if form in ("wave", "swing"):
            return Factor(form, result[3], (int(result[2]),), result[1])
        if form in ("knot", "bump"):
            numbers = int(result[1]), int(result[2])
            return Factor(form, result[3], numbers) if numbers[0] <= numbers[1] else None
        return Factor(form, result[1])
    return None


def _wave(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    angle = np.radians(clamped(factor.input, ranges, at, periodic=True))
    wave: Array = (np.sin if factor.word == "sin" else np.cos)(factor.numbers[0] * angle)
    return wave


def _swing(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    """Half waves from the begin of the range to its end; nothing where nobody knows the time."""
    if values(factor.input, at) is None:
        return np.zeros(at.count)
    angle = np.pi / 2 * factor.numbers[0] * (_scaled(factor, at, ranges) + 1)
    swing: Array = (np.sin if factor.word == "sin" else np.cos)(angle)
    return swing


def _scaled(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    """-1 to 1 over the range."""
    span = ranges[factor.input]
    scaled: Array = (clamped(factor.input, ranges, at) - span.middle) / span.half
    return scaled


def _knot(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    number, count = factor.numbers
    result: Array = _cardinal(count)(_scaled(factor, at, ranges))[:, number - 1]
    return result


@cache
def _cardinal(count: int) -> CubicSpline:
    """Natural cubic splines over -1 to 1, each 1 at one of `count` knots and 0 at the others."""
    from scipy.interpolate import CubicSpline  # slow to import

    return CubicSpline(np.linspace(-1, 1, count), np.eye(count), bc_type="natural")


def _bump(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    """A Gaussian at one of the knots, as wide as `BUMP_WIDTH` of their distance."""
    result: Array = np.exp(-(((_scaled(factor, at, ranges) - _knot_at(factor)) / _width(factor)) ** 2) / 2)
    return result


def _knot_at(factor: Factor) -> float:
    """Its knot, of a range scaled to -1 to 1."""
    number, count = factor.numbers
    return -1 + 2 * (number - 1) / (count - 1)


def _width(bump: Factor) -> float:
    return BUMP_WIDTH * 2 / (bump.numbers[1] - 1)


def _sign(factor: Factor, at: Situation, ranges: Ranges) -> Array:
    if at.directions is None:
        return np.zeros(at.count)
    n, i = at.theta.shape[1], factor.numbers[0] - 1
    last: Array = at.directions[:, i if factor.word == "theta" else n + i]
    return last


_SHAPES: dict[str, Callable[[Factor, Situation, Ranges], Array]] = {
    "wave": _wave,
    "swing": _swing,
    "slope": _scaled,
    "square": lambda factor, at, ranges: _scaled(factor, at, ranges) ** 2,
    "knot": _knot,
    "bump": _bump,
    "sign": _sign,
    "constant": lambda factor, at, ranges: np.ones(at.count),
}


def bends(factor: Factor, span: InputRange) -> Array:
    """(B,) values of a factor's input between which it rises or falls, and is straight or bends to one side."""
    if factor.periodic:
        quarters = np.arange(4 * factor.numbers[0]) * 90.0 / factor.numbers[0]
        if span.is_whole_turn:
            return quarters
        quarters = span.nearest(quarters)  # what leaps, opposite of the middle, begins and ends there
        ends = [span.low, span.high, span.middle + 180.0, span.middle + 180.0]
        return np.append(ends, quarters[(span.low < quarters) & (quarters < span.high)])
    inside = np.zeros(1 if factor.form == "square" else 0)
    if factor.form == "knot":
        slopes = (_cardinal(factor.numbers[1]).derivative(k).roots(extrapolate=False) for k in (1, 2))
        inside = np.concatenate([roots[factor.numbers[0] - 1] for roots in slopes])
    elif factor.form == "bump":
        inside = _knot_at(factor) + np.array([-1.0, 0.0, 1.0]) * _width(factor)
    return np.concatenate([[span.low, span.high], span.middle + span.half * inside[np.abs(inside) < 1]])


def period_deg(of: Part) -> float:
    """The period of a periodic part [deg]; 0 where it has none."""
    waves = [factor.numbers[0] for factor in of if factor.periodic]
    return 360.0 / math.gcd(*waves) if waves else 0.0


def farthest(name: str, span: InputRange, at: Situation, far: NDArray[np.bool_], *, periodic: bool) -> float:
    """The value (K,) of an input that is farthest out of its range, among some poses (K,)."""
    result = values(name, at)
    if result is None:
        return span.middle
    near = span.nearest(result[far]) if periodic else result[far]
    return float(near[np.argmax(np.abs(near - span.middle))])


Parts = Mapping[str, tuple[int, Part]]  # parameter -> axis and part


def formula(parts: Parts, on: Target, ranges: Ranges, values: Mapping[str, float]) -> str:
    """Coefficients [unit] times shapes, axis after axis; rotations in deg, lengths in mm."""
    lines = []
    for k, axis in enumerate(AXES):
        mine = [(name, part) for name, (a, part) in parts.items() if a == k and name in values]
        if mine:
            summands = [_summand(values[name] / on.kind.si, part, on.kind.unit, ranges) for name, part in mine]
            text = " ".join(summands)
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
    if on.kind_name != "sensor" and "time" in names:
        return "like a temperature that rises and falls"
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
