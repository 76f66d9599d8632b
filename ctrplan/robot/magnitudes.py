"""Numbers that are most likely in another unit than the one they are read in, by what they would mean.

Nothing is changed: a sentence names the number, what it would mean, and the unit in which it would mean something.
What tubes can be is wide on purpose, from soft polymer to tungsten, from a needle to an endoscope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from ctrplan.mechanics.tube import Tube
    from ctrplan.robot.robot import Robot

UNITS_M = {"m": 1.0, "mm": 1e-3, "in": 25.4e-3, "cm": 1e-2, "um": 1e-6}  # the likeliest mistake first
IN_WORDS = {"m": "metres", "mm": "millimetres", "in": "inches", "cm": "centimetres", "um": "micrometres"}
YOUNG_PA = 5e7, 1e13  # a soft polymer, and ten diamonds: wrong units are off by a thousand and more
LEAST_ARC_RAD, MOST_ARC_RAD = math.radians(0.3), 4 * math.pi  # of a section that is meant to be bent
WIDE_ARC_RAD = math.radians(225)  # that is doubted where the number makes a radius
OUTER_M = 1e-4, 0.04  # outer diameters
SLENDER = 8.0  # length over outer diameter of the shortest tube
DENSITY = 200.0, 25_000.0  # kg/m^3, foam to platinum
NOISE_M = 2e-6, 0.02  # standard deviation of a tracker
TRAVEL = 0.01  # share of the longest tube that a translation has to span


class Doubt(NamedTuple):
    """A number and what speaks against its unit: the steps of its key, and the rule as the end of a sentence."""

    key: tuple[str | int, ...]
    rule: str


def likely_unit(value_m: float, read_in: str, low_m: float, high_m: float) -> str | None:
    """The unit in which the number that was read as `value_m` would be a length from low to high; None for none."""
    number = value_m / UNITS_M[read_in]
    return next((u for u, si in UNITS_M.items() if u != read_in and low_m <= number * si <= high_m), None)


def reach_m(robot: Robot) -> float:
    """Farthest [m] that any tip can be from the base: the longest tube that is in front of the plate."""
    return max(tube.length_m for tube in robot.tubes)


def implied_young_Pa(tube: Tube) -> float:
    """Young's modulus [Pa] of a tube's bending stiffness and diameters."""
    return tube.bending_stiffness_Nm2 / (math.pi / 64 * (tube.outer_diameter_m**4 - tube.inner_diameter_m**4))


def straightened_strain(tube: Tube) -> float:
    """Largest bending strain of a tube that is held straight."""
    return tube.outer_diameter_m / 2 * max(section.curvature_per_m for section in tube.sections)


def robot_doubts(robot: Robot) -> Iterator[Doubt]:
    """Numbers of a robot that are most likely in another unit, tube by tube."""
    for i, tube in enumerate(robot.tubes):
        yield from _tube_doubts(tube, i)
    yield from _drive_doubts(robot)
    if robot.measurement is not None:
        sigma = robot.measurement.position_sigma_m
        if not NOISE_M[0] <= sigma <= NOISE_M[1]:
            unit = likely_unit(sigma, "mm", 2e-5, 5e-3)
            yield Doubt(("measurement", "position_sigma_mm"), f"is no noise of a tracker{_asked(unit)}")


def _tube_doubts(tube: Tube, i: int) -> Iterator[Doubt]:
    outer = tube.outer_diameter_m
    if not OUTER_M[0] <= outer <= OUTER_M[1]:
        yield Doubt(("tube", i, "outer_diameter_mm"), f"is no tube{_asked(likely_unit(outer, 'mm', 3e-4, 0.02))}")
        return
    if tube.length_m < SLENDER * outer:
        unit = likely_unit(tube.length_m, "mm", 20e-3, 1.0)
        rule = f"is {tube.length_m * 1e3:.3g} mm long, {tube.length_m / outer:.2g} times its diameter"
        yield Doubt(("tube", i), f"{rule}: are its lengths in {IN_WORDS[unit]}?" if unit else rule)
    young = implied_young_Pa(tube)
    if not YOUNG_PA[0] <= young <= YOUNG_PA[1]:
        factors = {"N mm^2": 1e-6, "N cm^2": 1e-4, "kN m^2": 1e3, "MPa m^4": 1e6}
        unit = next((u for u, f in factors.items() if 1e9 <= young * f <= 3e11), None)
        hint = f": is it in {unit}?" if unit else ": are the diameters right?"
        yield Doubt(("tube", i, "bending_stiffness_Nm2"), f"Young's modulus would be {young:.2g} Pa{hint}")
    for k, section in enumerate(tube.sections):
        if doubt := _bend_doubt(tube, section.curvature_per_m, section.length_m):
            yield Doubt(("tube", i, "section", k), doubt)
    density = tube.density_kg_m3
    if density and not DENSITY[0] <= density <= DENSITY[1]:
        hint = ": is it in g/cm^3?" if DENSITY[0] <= density * 1e3 <= DENSITY[1] else ""
        yield Doubt(("tube", i, "density_kg_m3"), f"is no density of a tube{hint}")


def _bend_doubt(tube: Tube, curvature: float, length_m: float) -> str | None:
    if curvature <= 0:
        return None
    outer_m, most = tube.outer_diameter_m / 2, tube.max_strain
    arc, strain = curvature * length_m, curvature * outer_m
    bends = f"bends by a radius of {1e3 / curvature:.4g} mm"
    if arc < LEAST_ARC_RAD:
        times = {"mm": 1e3, "cm": 1e2, "in": 1 / 25.4e-3}
        unit = next((u for u, f in times.items() if math.radians(3) <= arc * f <= 7 and strain * f <= most), None)
        rule = f"{bends}, {math.degrees(arc):.2g} deg over its length"
        return f"{rule}: is its curvature in 1/{unit}?" if unit else rule
    as_radius = 1e3 / curvature  # the number read as a radius in mm
    is_radius = as_radius * outer_m <= most and math.radians(3) <= as_radius * length_m <= WIDE_ARC_RAD
    if not (strain > most or arc > MOST_ARC_RAD or (arc > WIDE_ARC_RAD and is_radius)):
        return None
    rule = f"{bends}, straightened it is strained by {100 * strain:.3g} % of at most {100 * most:.3g} %"
    if arc > WIDE_ARC_RAD:
        rule = f"{bends}, {math.degrees(arc):.3g} deg over its length"
    return f"{rule}: is {curvature:.4g} its radius in mm (radius_mm)?" if is_radius else rule


def _drive_doubts(robot: Robot) -> Iterator[Doubt]:
    longest = reach_m(robot)
    for k, joint in enumerate(robot.drive.joints):
        low, high = float(robot.drive.lower[k]), float(robot.drive.upper[k])
        if not math.isfinite(low) or not math.isfinite(high):
            continue
        span = high - low
        if joint.kind == "translation" and 0 < span < TRAVEL * longest:
            unit = likely_unit(span, "mm", 0.05 * longest, 1.5 * longest)
            if unit is not None:
                yield Doubt(("joint", k), f"travels {span * 1e3:.3g} mm: are its limits in {IN_WORDS[unit]}?")
        if joint.kind == "rotation" and _is_in_radians(math.degrees(span)):
            yield Doubt(("joint", k), f"turns by {math.degrees(span):.4g} deg: are its limits in radians?")


def _is_in_radians(span_deg: float) -> bool:
    """Whether a span of degrees is a half turn, or one or two whole ones, in radians."""
    return any(math.isclose(span_deg, turns * math.pi, rel_tol=5e-3) for turns in (1, 2, 4, 8))


def _asked(unit: str | None) -> str:
    return f": is it in {IN_WORDS[unit]}?" if unit else ""


def one_sentence(sentences: Sequence[str], check: str) -> tuple[str, ...]:
    """The first of the sentences, with how many more there are and what tells them; nothing where there is none."""
    if len(sentences) < 2:
        return tuple(sentences)
    more = len(sentences) - 1
    return (f"{sentences[0].rstrip('.')} ({more} more number{'s' if more > 1 else ''} in doubt: {check}).",)
