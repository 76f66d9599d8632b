"""Numbers that are most likely in another unit than the one they are read in, by what they would mean.

Nothing is changed: a sentence names the number, what it would mean, and the unit in which it would mean something.
What tubes can be is wide on purpose, from soft polymer to tungsten, from a needle to an endoscope.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ctrplan.base.arrays import UNIT_WORDS, UNITS_M, are_degrees, are_radians, in_radians
from ctrplan.drive.drive import UNITS
from ctrplan.robot.robot import diametral_gap_m

if TYPE_CHECKING:
    from ctrplan.drive.drive import Joint
    from ctrplan.mechanics.tube import Tube, TubeSection
    from ctrplan.robot.robot import Robot

YOUNG_PA = 5e7, 1.2e12  # a soft polymer, and diamond, the stiffest that there is
WALL = 10.0  # times by which rounded diameters of thin walls may make an implied modulus greater
USUAL_YOUNG_PA = 1e9, 3e11  # of a reading that explains a number
METALS_PA = (2.8e10, 8.3e10), (1.8e11, 2.15e11)  # nickel-titanium (martensite to austenite) and steel, by data sheets
PERCENT_RATIO = 20.0, 50.0  # Poisson's ratio of solids, in %
METAL_RATIO = 0.25, 0.36  # Poisson's ratio of steel, nickel-titanium and titanium
MOST_ARC_RAD = 4 * math.pi  # of a section
USUAL_ARC_RAD = math.radians(10), math.radians(225)  # of a reading that explains a number
MOST_ELASTIC = 0.12  # strain from which no stiff tube comes back: superelastic ones bear a tenth
OUTER_M = 1e-4, 0.04  # outer diameters
USUAL_OUTER_M = 3e-4, 0.02  # of a reading that explains a number
SLENDER = 8.0  # length over outer diameter of the shortest tube
DENSITY = 200.0, 25_000.0  # kg/m^3, foam to platinum
NOISE_M = 2e-6, 0.02  # standard deviation of a tracker
# Least and most that there is, then those of a reading that explains a number
TANGENT_NOISE = 0.02, 30.0, 0.1, 10.0  # deg, standard deviation of a measured direction
FINE_TURN = 0.005, 5.0, 0.01, 2.0  # deg within which a drive follows
FINE_WAY_M = 5e-7, 1e-3, 1e-6, 5e-4  # m within which a drive follows
FINEST_ERROR_M = 1e-5  # of a model, less than any tracker tells
SOFTER = 300.0  # times by which a neighbour's Young's modulus is greater: metal beside a soft polymer
MOST_FRICTION = 1.0  # of dry metal on metal
WRITTEN = 9  # digits behind the point that a change of units leaves as they were
WRITTEN_M = 1e-6  # to which diameters and clearances are written
ONCE_S = 0.5, 300.0  # s that a drive takes for a whole turn, or for the length of the robot, at full speed
SPEED: dict[str, tuple[float, float]] = {"rotation": (5.0, 360.0), "translation": (1.0, 50.0)}  # deg/s, mm/s, usual
RISE_S = 2e-3, 4.0, 0.02, 1.0  # s to full speed, and to full acceleration
TRAVEL, MOST_TRAVEL = 0.01, 20.0  # lengths of the longest tube that a translation spans
GREATER_SHEAR = -0.5 + 1e-9  # Poisson's ratio from which on the shear modulus is Young's and more


class Doubt(NamedTuple):
    """A number and what speaks against its unit: the steps of its key, and the rule as the end of a sentence.

    otherwise: the rule where the file says the same by a Young's or shear modulus, or by a radius. No rule: no doubt.
    """

    key: tuple[str | int, ...]
    rule: str
    otherwise: str | None = None


def likely_units(value_m: float, read_in: str, low_m: float, high_m: float) -> list[str]:
    """The units in which the number that was read as `value_m` would be a length from low to high, usual ones first."""
    number = value_m / UNITS_M[read_in]
    return [unit for unit, si in UNITS_M.items() if unit != read_in and low_m <= number * si <= high_m]


def reach_m(robot: Robot) -> float:
    """Farthest [m] that any tip can be from the base: the longest tube that is in front of the plate."""
    return max(tube.length_m for tube in robot.tubes)


def implied_young_Pa(tube: Tube) -> float:
    """Young's modulus [Pa] of a tube's bending stiffness and diameters; infinite for walls of no area in doubles."""
    second_moment = math.pi / 64 * (tube.outer_diameter_m**4 - tube.inner_diameter_m**4)
    return tube.bending_stiffness_Nm2 / second_moment if second_moment > 0 else math.inf


def straightened_strain(tube: Tube) -> float:
    """Largest bending strain of a tube that is held straight."""
    return tube.outer_diameter_m / 2 * max(section.curvature_per_m for section in tube.pieces)


def robot_doubts(robot: Robot) -> Iterator[Doubt]:
    """Numbers of a robot that are most likely in another unit, tube by tube."""
    yield from tube_doubts(robot)
    radii = _radii_doubt(robot)
    yield from radii
    yield from _softness_doubts(robot)
    yield from _metal_doubt(robot)
    for i in range(len(robot.contacts)):
        yield from _contact_doubts(robot, i, not radii)
    yield from _drive_doubts(robot)
    yield from _rate_doubts(robot)
    yield from _fineness_doubts(robot)
    if robot.measurement is not None:
        sigma = robot.measurement.position_sigma_m
        if not NOISE_M[0] <= sigma <= NOISE_M[1]:
            units = likely_units(sigma, "mm", 2e-5, 5e-3)
            yield Doubt(("measurement", "position_sigma_mm"), f"is no noise of a tracker{_unit_question(units)}")
        if (turned := robot.measurement.tangent_sigma_rad) is not None:
            yield from _small("tangent_sigma_deg", "measurement", math.degrees(turned), TANGENT_NOISE, ANGLES)
    for k, marker in enumerate(robot.markers):
        if 0 < marker.distance_m < OUTER_M[0] and (
            units := likely_units(marker.distance_m, "mm", 1e-3, reach_m(robot))
        ):
            rule = f"is less than the thinnest tube is wide{_unit_question(units[:1])}"
            yield Doubt(("marker", k, f"from_{marker.end}_mm"), rule)
    if 0 < robot.model_error_m < FINEST_ERROR_M and (units := likely_units(robot.model_error_m, "mm", 1e-4, 0.02)):
        rule = f"is finer than any robot's shape is known{_unit_question(units[:1])}"
        yield Doubt(("model_error_mm",), rule)
    if robot.model_error_m > 0.1 * reach_m(robot):
        rule = f"is more than a tenth of the robot's {reach_m(robot) * 1e3:.3g} mm"
        yield Doubt(("model_error_mm",), rule + _unit_question(likely_units(robot.model_error_m, "mm", 0, 0.01)))


def tube_doubts(robot: Robot) -> Iterator[Doubt]:
    """Numbers of the tubes by themselves that are most likely in another unit."""
    for i, tube in enumerate(robot.tubes):
        yield from _tube_doubts(tube, i)


def _tube_doubts(tube: Tube, i: int) -> Iterator[Doubt]:
    outer = tube.outer_diameter_m
    if not OUTER_M[0] <= outer <= OUTER_M[1]:
        yield Doubt(
            ("tube", i, "outer_diameter_mm"), f"is no tube{_unit_question(likely_units(outer, 'mm', *USUAL_OUTER_M))}"
        )
        return
    if tube.length_m < SLENDER * outer:
        rule = f"is {tube.length_m * 1e3:.3g} mm long, {tube.length_m / outer:.2g} times its diameter"
        units = likely_units(tube.length_m, "mm", 20e-3, 1.0)
        yield Doubt(("tube", i), rule + _unit_question(units, "are its lengths in"))
    yield from _stiffness_doubts(tube, i)
    if 0 < tube.collar_length_m < outer and (units := likely_units(tube.collar_length_m, "mm", 1e-3, 0.1)):
        yield Doubt(("tube", i, "collar_length_mm"), f"is shorter than the tube is wide{_unit_question(units)}")
    straight = _aside_m(tube) < outer
    for k, section in enumerate(tube.sections):
        if section.length_m < outer / 4 and (units := likely_units(section.length_m, "mm", 5e-3, 1.0)):
            rule = f"is shorter than a quarter of the tube's diameter{_unit_question(units)}"
            yield Doubt(("tube", i, "section", k, "length_mm"), rule)
        elif doubt := _bend_doubt(tube, section, straight=straight):
            yield Doubt(("tube", i, "section", k), *doubt)
    density = tube.density_kg_m3
    if density and not DENSITY[0] <= density <= DENSITY[1]:
        hint = ": is it in g/cm^3?" if DENSITY[0] <= density * 1e3 <= DENSITY[1] else ""
        yield Doubt(("tube", i, "density_kg_m3"), f"is no density of a tube{hint}")


def _stiffness_doubts(tube: Tube, i: int) -> Iterator[Doubt]:
    young, outer = implied_young_Pa(tube), tube.outer_diameter_m
    low, high = USUAL_YOUNG_PA
    if not YOUNG_PA[0] <= young <= YOUNG_PA[1]:
        of_EI = {"N mm^2": 1e-6, "N cm^2": 1e-4, "lb in^2": 2.87e-3, "kN m^2": 1e3, "MPa m^4": 1e6}
        of_E = {"MPa": 1e-3, "N/cm^2": 1e-5, "ksi": 6.895e-3, "Pa": 1e-9, "TPa": 1e3}
        sizes = {"in inches": 25.4, "in centimetres": 10.0, "in metres": 1e3, "radii": 2.0}
        bore = [
            word
            for word, k in sizes.items()
            if low <= young / k**4 <= high and USUAL_OUTER_M[0] <= outer * k <= USUAL_OUTER_M[1]
        ]
        rules = []
        for factors in (of_EI, of_E):
            units = [unit for unit, factor in factors.items() if low <= young * factor <= high]
            questions = [f"is it in {_or(units)}"] if units else []
            questions += [f"are the diameters {_or(bore)}"] if bore else []
            hint = ", or ".join(questions) or "are the diameters right"
            rules.append(f"Young's modulus would be {young:.2g} Pa: {hint}?")
        thin = YOUNG_PA[1] < young <= WALL * YOUNG_PA[1]
        yield Doubt(("tube", i, "bending_stiffness_Nm2"), "" if thin else rules[0], rules[1])
    if tube.poisson_ratio <= GREATER_SHEAR:
        times = 0.5 / (1 + tube.poisson_ratio)  # of Young's modulus
        units = [unit for unit, factor in {"MPa": 1e-3, "ksi": 6.895e-3}.items() if 0.2 <= times * factor <= 0.7]
        rule = f"shear modulus would be {times:.3g} times Young's, of materials it is a third to a half"
        yield Doubt(("tube", i, "poisson_ratio"), rule, f"{rule}: is it in {_or(units)}?" if units else rule)
    if PERCENT_RATIO[0] <= tube.poisson_ratio <= PERCENT_RATIO[1]:
        rule = f"makes the shear modulus {2 * (1 + tube.poisson_ratio):.3g} times less than Young's: is it in %?"
        yield Doubt(("tube", i, "poisson_ratio"), rule, rule.partition(":")[0])
    if tube.max_strain > MOST_ELASTIC and young > low:
        rule = f"no material of {young / 1e9:.2g} GPa bears {100 * tube.max_strain:.3g} % and comes back: is it in %?"
        yield Doubt(("tube", i, "max_strain"), rule)


def _radii_doubt(robot: Robot) -> list[Doubt]:
    """Doubts about outer diameters that would be radii: such a tube is sixteen times too stiff for its size and metal.

    Thin walls may be so by rounding: it counts where all tubes are, or where one has room to be twice as wide.
    """
    implied = [implied_young_Pa(tube) for tube in robot.tubes]
    stiff = [i for i, young in enumerate(implied) if any(low <= young / 16 <= high for low, high in METALS_PA)]
    if len(stiff) == robot.n:
        implied_text = f"makes Young's moduli of {', '.join(f'{young:.3g}' for young in implied)} Pa"
        stiff = [0]
    else:
        stiff = [i for i in stiff if i and 2 * robot.tubes[i].outer_diameter_m < robot.tubes[i - 1].inner_diameter_m]
        implied_text = f"makes a Young's modulus of {implied[stiff[0]]:.3g} Pa" if stiff else ""
    rule = f"{implied_text}, sixteen times that of a usual metal: are these radii?"
    return [Doubt(("tube", i, "outer_diameter_mm"), rule) for i in stiff[:1]]


def _softness_doubts(robot: Robot) -> Iterator[Doubt]:
    """Tubes that are softer than the stiffest one beyond what materials of one robot differ by."""
    young = [implied_young_Pa(tube) for tube in robot.tubes]
    for i, own in enumerate(young):
        if YOUNG_PA[0] <= own and SOFTER * own < (most := max(young)) <= YOUNG_PA[1]:
            rule = f"Young's modulus would be {own:.2g} Pa, {most / own:.2g} times less than another tube's"
            yield Doubt(("tube", i, "bending_stiffness_Nm2"), f"{rule}: is it right?", f"{rule}: is it in TPa?")


def _metal_doubt(robot: Robot) -> Iterator[Doubt]:
    """Whether all tubes are a thousand times softer than a metal with the Poisson's ratio of one.

    So soft are rubbery polymers, which keep their volume nearly: their ratio is two fifths to a half.
    """
    for tube in robot.tubes:
        is_metal = any(low <= 1e3 * implied_young_Pa(tube) <= high for low, high in METALS_PA)
        if not is_metal or not METAL_RATIO[0] <= tube.poisson_ratio <= METAL_RATIO[1]:
            return
    young, ratio = implied_young_Pa(robot.tubes[0]), robot.tubes[0].poisson_ratio
    rule = f"Young's modulus would be {young:.2g} Pa, of rubber, and Poisson's ratio {ratio:.3g}, as of a metal"
    yield Doubt(("tube", 0, "bending_stiffness_Nm2"), f"{rule}: is it in kN m^2?", f"{rule}: is it in TPa?")


def _contact_doubts(robot: Robot, i: int, are_diameters: bool) -> Iterator[Doubt]:
    """Doubts about the pair i (from 0): its stated clearance by the gap of the diameters, and its friction."""
    stated, gap = robot.contacts[i].clearance_m, diametral_gap_m(robot.tubes, i)
    key: tuple[str | int, ...] = ("contact", i, "clearance_mm")
    left = f"the {gap * 1e3:.4g} mm that the diameters leave on every side"
    if stated is not None and abs(stated - 2 * gap) <= WRITTEN_M and are_diameters:
        hint = "is it the difference of diameters, or are the diameters radii?"
        yield Doubt(key, f"is twice {left}: {hint}")
    elif stated is not None and (units := likely_units(stated, "mm", 0.9 * gap, 1.1 * gap)):
        yield Doubt(key, f"is not {left}{_unit_question(units[:1])}")
    outer, inner = robot.tubes[i], robot.tubes[i + 1]
    if stated is None and are_diameters and 2 * inner.outer_diameter_m < outer.inner_diameter_m:
        rule = f"leaves {gap * 1e3:.3g} mm on every side, room for a tube twice as wide: are its diameters radii?"
        yield Doubt(("tube", i + 1, "outer_diameter_mm"), rule)
    if (most := robot.contacts[i].friction_coefficient[1]) > MOST_FRICTION:
        rule = f"rubs more than dry metal on metal, {MOST_FRICTION:g} at most"
        yield Doubt(("contact", i, "friction_coefficient"), f"{rule}: is it in %?" if most <= 100 else rule)


def _aside_m(tube: Tube) -> float:
    """How far [m] the free tip of a tube is from the straight on at its base, for small angles."""
    aside = turned = 0.0
    for section in tube.sections:
        aside += turned * section.length_m + section.curvature_per_m * section.length_m**2 / 2
        turned += section.curvature_per_m * section.length_m
    return aside


def bend_readings(tube: Tube, section: TubeSection) -> tuple[list[str], list[str]]:
    """What the number of a bend would be, given as a curvature [1/m] or as a radius [mm], for its arc to be usual."""
    curvature, radius_mm = section.curvature_per_m, 1e3 / section.curvature_per_m
    as_curvature = {f"its curvature in 1/{unit}": curvature / UNITS_M[unit] for unit in ("mm", "cm", "in")}
    as_curvature |= {"its radius in mm (radius_mm)": 1e3 / curvature}
    as_curvature |= {f"its radius in {UNIT_WORDS[unit]}": 1 / curvature / UNITS_M[unit] for unit in ("cm", "in")}
    as_radius = {f"its radius in {UNIT_WORDS[unit]}": 1 / radius_mm / UNITS_M[unit] for unit in ("cm", "in", "m")}
    as_radius["its curvature in 1/m (curvature_y_per_m)"] = radius_mm
    lengths = [
        f"its length in {UNIT_WORDS[unit]}"
        for unit in likely_units(section.length_m, "mm", 5e-3, 1.0)
        if USUAL_ARC_RAD[0] <= curvature * section.length_m * UNITS_M[unit] / UNITS_M["mm"] <= USUAL_ARC_RAD[1]
    ]
    usual = [
        [word for word, per_m in words.items() if _is_usual(tube, section, per_m)] + lengths
        for words in (as_curvature, as_radius)
    ]
    return usual[0], usual[1]


def _is_usual(tube: Tube, section: TubeSection, curvature: float) -> bool:
    arc = curvature * section.length_m
    return USUAL_ARC_RAD[0] <= arc <= USUAL_ARC_RAD[1] and curvature * tube.outer_diameter_m / 2 <= tube.max_strain


def _bend_doubt(tube: Tube, section: TubeSection, *, straight: bool) -> tuple[str, str] | None:
    """Two rules, for a curvature and for a radius; straight: of a tube that goes aside by less than its diameter."""
    curvature, most = section.curvature_per_m, tube.max_strain
    if curvature <= 0:
        return None
    arc, strain = curvature * section.length_m, curvature * tube.outer_diameter_m / 2
    readings, wide = bend_readings(tube, section), arc > USUAL_ARC_RAD[1]
    is_explained = (straight or wide) and any(readings)
    if not (is_explained or strain > most or arc > MOST_ARC_RAD):
        return None
    rule = f"bends by a radius of {1e3 / curvature:.4g} mm"
    if straight or wide:
        rule += f", {math.degrees(arc):{'.2g' if straight else '.3g'}} deg over its length"
    else:
        rule += f", straightened it is strained by {100 * strain:.3g} % of at most {100 * most:.3g} %"
    numbers = ("", "") if straight else (f"{curvature:.4g} ", f"{1e3 / curvature:.4g} ")
    first, second = (
        f"{rule}: is {n}{_or(words)}?" if words else rule for n, words in zip(numbers, readings, strict=True)
    )
    return first, second


def _or(words: Sequence[str]) -> str:
    return " or ".join(words)


def _drive_doubts(robot: Robot) -> Iterator[Doubt]:
    longest, drive = reach_m(robot), robot.drive
    if in_radians(np.degrees(drive.home_theta_rad).tolist()) is not None:
        yield Doubt(("home", "theta_deg"), "are whole parts of a turn in radians: are they in radians?")
    if are_degrees(np.round(drive.home_theta_rad, WRITTEN)):
        yield Doubt(("home", "theta_deg"), "are whole numbers of radians: are they degrees given for radians?")
    moved = float(np.abs(drive.home_l_m).max())
    if 0 < moved < TRAVEL / 10 * longest and "m" in likely_units(moved, "mm", 0.05 * longest, longest):
        yield Doubt(("home", "l_mm"), f"moves bases by {moved * 1e3:.3g} mm at most: are these in metres?")
    for k, joint in enumerate(drive.joints):
        low, high = float(drive.lower[k]), float(drive.upper[k])
        if not math.isfinite(low) or not math.isfinite(high):
            continue
        span = high - low
        travel = span * float(np.abs(joint.moves).max())  # of the tube that it moves most
        if joint.kind == "translation" and 0 < travel < TRAVEL * longest:
            units = likely_units(travel, "mm", 0.05 * longest, 1.5 * longest)
            if units:
                rule = f"travels {travel * 1e3:.3g} mm"
                yield Doubt(("joint", k), rule + _unit_question(units, "are its limits in"))
        if joint.kind == "translation" and travel > MOST_TRAVEL * longest:
            rule = f"moves a tube by {travel:.3g} m within its limits, the robot is {longest * 1e3:.3g} mm long"
            yield Doubt(("joint", k, "moves"), f"{rule}: are these m per m?")
        if joint.kind == "rotation" and are_radians(np.degrees([low, high])):
            yield Doubt(("joint", k), f"turns by {math.degrees(span):.4g} deg: are its limits in radians?")
        if joint.kind == "rotation" and are_degrees(np.round([low, high], WRITTEN)):
            rule = f"turns by {math.degrees(span):.4g} deg: are its limits degrees given for radians?"
            yield Doubt(("joint", k), rule)


ANGLES = {"radians": 180 / math.pi, "arcminutes": 1 / 60}  # deg
LENGTHS = {UNIT_WORDS[unit]: si for unit, si in UNITS_M.items() if unit in ("m", "um")}


def _rate_doubts(robot: Robot) -> Iterator[Doubt]:
    """Speeds by the time for a turn or the robot's length, accelerations and jerks by the time to reach them."""
    for k, joint in enumerate(robot.drive.joints):
        unit, si = UNITS[joint.kind]
        rates = joint.max_velocity / si, joint.max_acceleration / si, joint.max_jerk / si
        other = ("rad", 180 / math.pi) if joint.kind == "rotation" else ("m", 1e3)
        other_units = [(f"{other[0]}/s{power}", other[1]) for power in ("", "^2", "^3")]
        minutes = [(f"{unit}/min{power}", 60.0**-n) for n, power in enumerate(("", "^2", "^3"), start=1)]
        for n, name in enumerate(("velocity", "acceleration", "jerk")):
            key = ("joint", k, f"max_{name}_{unit}_s{'' if n == 0 else n + 1}")
            readings = {words: rates[n] * factor for words, factor in (other_units[n], minutes[n])}
            in_code = rates[n] / other[1]  # of a number that was said in the file's unit to code, which has SI
            if float(f"{in_code:.4g}") == float(f"{in_code:.9g}"):
                readings[f"{unit}/s{('', '^2', '^3')[n]} given for {other_units[n][0]}"] = in_code
            doubt = _speed_doubt(robot, joint, readings, rates) if n == 0 else _rise_doubt(rates, n, readings)
            if doubt:
                yield Doubt(key, doubt)
                break


def _speed_doubt(
    robot: Robot, joint: Joint, readings: dict[str, float], rates: tuple[float, float, float]
) -> str | None:
    speed, gear = rates[0], float(np.abs(joint.moves).max())
    usual = [words for words, x in readings.items() if SPEED[joint.kind][0] <= x * gear <= SPEED[joint.kind][1]]
    turns = joint.kind == "rotation"
    whole, of = (
        (360.0, "a turn") if turns else (reach_m(robot) * 1e3, f"the {reach_m(robot) * 1e3:.3g} mm of the robot")
    )
    once = whole / (speed * gear)
    if usual and (not ONCE_S[0] <= once <= ONCE_S[1] or turns and are_radians([speed])):
        return f"takes {once:.3g} s for {of}: is it in {_or(usual)}?"
    if _is_beyond(rise := speed / rates[1]):
        usual = [words for words in usual if RISE_S[2] <= readings[words] / rates[1] <= RISE_S[3]]
        return f"is reached after {rise:.3g} s: is it in {_or(usual)}?" if usual else None
    return None


def _rise_doubt(rates: tuple[float, float, float], n: int, readings: dict[str, float]) -> str | None:
    """A doubt about an acceleration (n = 1) or a jerk (n = 2), by how long full speed or acceleration takes with it."""
    usual = [words for words, x in readings.items() if RISE_S[2] <= rates[n - 1] / x <= RISE_S[3]]
    if usual and _is_beyond(rise := rates[n - 1] / rates[n]):
        return f"brings full {('speed', 'acceleration')[n - 1]} after {rise:.3g} s: is it in {_or(usual)}?"
    return None


def _is_beyond(rise_s: float) -> bool:
    return not RISE_S[0] <= rise_s <= RISE_S[1]


def _fineness_doubts(robot: Robot) -> Iterator[Doubt]:
    """How exactly the drive is said to follow."""
    fine = robot.drive.execution
    yield from _small("rotation_deg", "execution", math.degrees(fine.rotation_rad), FINE_TURN, ANGLES)
    in_mm = {words: 1e3 * si for words, si in LENGTHS.items()}
    yield from _small("translation_mm", "execution", fine.translation_m * 1e3, [1e3 * x for x in FINE_WAY_M], in_mm)


def _small(key: str, table: str, value: float, limits: Sequence[float], factors: dict[str, float]) -> Iterator[Doubt]:
    """A deviation, by what deviations are: limits are the least and the most, and those of a reading that explains."""
    low, high, *usual = limits
    units = [words for words, factor in factors.items() if usual[0] <= value * factor <= usual[1]]
    if value and not low <= value <= high and units:
        rule = f"is {'finer' if value < low else 'coarser'} than any such part"
        yield Doubt((table, key), f"{rule}: is it in {_or(units)}?")


def _unit_question(units: Sequence[str], question: str = "is it in") -> str:
    return f": {question} {in_words(units)}?" if units else ""


def in_words(units: Sequence[str]) -> str:
    """Units of lengths as a sentence asks for them."""
    return " or ".join(UNIT_WORDS[unit] for unit in units)


def summarised(sentences: Sequence[str], check: str) -> tuple[str, ...]:
    """The first of the sentences, with how many more there are and what tells them; nothing where there is none."""
    if len(sentences) < 2:
        return tuple(sentences)
    more = len(sentences) - 1
    return (f"{sentences[0].rstrip('.')} ({more} more number{'s' if more > 1 else ''} in doubt: {check}).",)
