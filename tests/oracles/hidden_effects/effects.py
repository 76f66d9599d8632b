"""Effects by name: each changes a world; size 1 leaves about the noise after recalibration (truth.json says what).

An effect is `name(world, draw) -> (world, true parameters)`. Which tube, which direction is drawn; how much follows
from the size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hidden_effects import drive, sensor
from hidden_effects.equilibrium import Loads
from hidden_effects.tube import Array, Kink, Section, Softening, Tube
from hidden_effects.world import DriveTerm, GuideBend, Room, SensorTerm, Stiffening, Warming, World


@dataclass(frozen=True)
class Draw:
    """What an effect is drawn with: size, random generator, duration of the experiment."""

    size: float
    rng: np.random.Generator
    duration_s: float

    def inner_tube(self, n: int) -> int:
        """Any tube but the outermost, which nothing turns."""
        return int(self.rng.integers(1, n))

    def sign(self) -> float:
        return float(self.rng.choice([-1.0, 1.0]))

    def direction(self) -> Array:
        v = self.rng.standard_normal(3)
        return np.asarray(v / np.linalg.norm(v))

    def one_of(self, n: int, tube: int, value: float) -> Array:
        """(n,) with `value` at `tube`."""
        return np.where(np.arange(n) == tube, value, 0.0)


NITINOL_KG_M3 = 6450.0

Parameters = dict[str, Any]  # named as in a diagnosis where that has the same parameter
Effect = Callable[[World, Draw], tuple[World, Parameters]]
CATALOGUE: dict[str, Effect] = {}
UNKNOWN: dict[str, Effect] = {}  # in nobody's catalogue: truth says "unknown"
BUILDABLE: dict[str, Effect] = {}  # in no catalogue either, and not in the bank: what a built term is tried on
TRUTH_NAME = {"homing_rotation": "off_plane_precurvature|homing_offset", "homing_translation": "homing_offset"}
TRUTH_NAME["off_plane_precurvature"] = TRUTH_NAME["homing_rotation"]  # a straight base and one curved section
# drawn among the unknown ones, of which these were: they have a name now
NAMED_SINCE = {"collar_slip": "homing_shift", "tracker_jump": "frame_shift", "kink": "kink"}
TRUTH_NAME |= NAMED_SINCE
CONTINUOUS_ONLY = frozenset({"lag"})


def _register(table: dict[str, Effect]) -> Callable[[Effect], Effect]:
    def add(effect: Effect) -> Effect:
        table[effect.__name__] = effect  # type: ignore[attr-defined]
        return effect

    return add


def truth_name(name: str) -> str:
    """The name in truth.json; a|b where the data can't tell."""
    return TRUTH_NAME.get(name, "unknown" if name in UNKNOWN or name in BUILDABLE else name)


def apply(name: str, world: World, draw: Draw) -> tuple[World, Parameters]:
    return (CATALOGUE.get(name) or UNKNOWN.get(name) or BUILDABLE[name])(world, draw)


def innermost(world: World) -> tuple[float, float]:
    """Middle and half of the range [m] of its translation."""
    return float(world.middle_m[-1]), float(world.half_m[-1])


def by_axis(name: str, values: Array) -> Parameters:
    return {name.format(axis): float(value) for axis, value in zip("xyz", values, strict=True)}


def by_tube(name: str, values: Array) -> Parameters:
    """Tubes counted from 1; those that the effect leaves alone are left out."""
    return {name.format(i + 1): float(value) for i, value in enumerate(values) if value}


def change_tube(world: World, tube: int, change: Callable[[Tube], Tube]) -> World:
    return replace(world, tubes=tuple(change(t) if i == tube else t for i, t in enumerate(world.tubes)))


def change_curved(tube: Tube, change: Callable[[Section], Section]) -> Tube:
    return replace(tube, sections=tuple(change(s) if any(s.curvature_per_m) else s for s in tube.sections))


def add_drive(world: World, term: DriveTerm) -> World:
    return replace(world, drive=(*world.drive, term))


def add_sensor(world: World, term: SensorTerm) -> World:
    return replace(world, sensor=(*world.sensor, term))


@_register(CATALOGUE)
def friction(world: World, draw: Draw) -> tuple[World, Parameters]:
    mu = draw.size * 0.015 * draw.rng.uniform(0.7, 1.3, world.n - 1)
    pairs = tuple(replace(pair, friction=float(m)) for pair, m in zip(world.pairs, mu, strict=True))
    return replace(world, pairs=pairs), {f"mu_{i + 1}": float(m) for i, m in enumerate(mu)}


@_register(CATALOGUE)
def clearance(world: World, draw: Draw) -> tuple[World, Parameters]:
    gaps = np.array([pair.clearance_m for pair in world.pairs]) + draw.size * 0.1e-3 * draw.rng.uniform(
        0.5, 1.5, world.n - 1
    )
    pairs = tuple(replace(pair, clearance_m=float(c)) for pair, c in zip(world.pairs, gaps, strict=True))
    return replace(world, pairs=pairs), {
        f"delta_{i + 1}_mm": 1e3 * (float(c) - pair.clearance_m)
        for i, (c, pair) in enumerate(zip(gaps, world.pairs, strict=True))
    }


@_register(CATALOGUE)
def translation_release(world: World, draw: Draw) -> tuple[World, Parameters]:
    """With the friction it releases; the larger, the shorter the translation it takes."""
    world, parameters = friction(world, replace(draw, size=6.0))
    return replace(world, release_m=2e-3 / draw.size), {**parameters, "release_per_mm": draw.size / 2}


@_register(CATALOGUE)
def nonlinear_elasticity(world: World, draw: Draw) -> tuple[World, Parameters]:
    """One alloy in all tubes: the larger the effect, the earlier and the further it softens."""
    soft = Softening(max(0.006 * 0.8**draw.size, 0.002), max(0.6**draw.size, 0.1))
    world = replace(world, tubes=tuple(replace(tube, softening=soft) for tube in world.tubes))
    return world, {"strain_percent": 100 * soft.strain, "stiffness_fraction": soft.fraction}


@_register(CATALOGUE)
def off_plane_precurvature(world: World, draw: Draw) -> tuple[World, Parameters]:
    tube, angle = draw.inner_tube(world.n), draw.sign() * draw.size * np.deg2rad(1.4)

    def tilt(section: Section) -> Section:
        return replace(
            section, curvature_per_m=(np.tan(angle) * section.curvature_per_m[1], section.curvature_per_m[1])
        )

    world = change_tube(world, tube, lambda t: change_curved(t, tilt))
    section = len(world.tubes[tube].sections)
    return world, {f"delta_{tube + 1}_{section}_per_m": world.tubes[tube].sections[-1].curvature_per_m[0]}


@_register(CATALOGUE)
def varying_precurvature(world: World, draw: Draw) -> tuple[World, Parameters]:
    tube, gradient = int(draw.rng.integers(0, world.n)), draw.sign() * min(draw.size * 0.25, 0.9)
    world = change_tube(world, tube, lambda t: change_curved(t, lambda s: replace(s, gradient=gradient)))
    return world, {f"gradient_{tube + 1}_{len(world.tubes[tube].sections)}": gradient}


@_register(CATALOGUE)
def ovality(world: World, draw: Draw) -> tuple[World, Parameters]:
    tube, e = int(draw.rng.integers(0, world.n)), draw.sign() * min(draw.size * 0.25, 0.7)
    return change_tube(world, tube, lambda t: replace(t, ovality=e)), {"tube": tube + 1, "ovality": e}


@_register(CATALOGUE)
def tip_load(world: World, draw: Draw) -> tuple[World, Parameters]:
    force = draw.size * 0.02 * draw.direction()
    loads = replace(world.loads, tip_force_N=tuple(force.tolist()))
    return replace(world, loads=loads), by_axis("force_{}_N", force)


@_register(CATALOGUE)
def gravity(world: World, draw: Draw) -> tuple[World, Parameters]:
    """Weights of nitinol tubes, filled or heavier: in proportion to their cross sections."""
    down, g = draw.direction(), draw.size * 45.0
    area = np.pi * np.array([tube.outer_radius_m**2 - tube.inner_radius_m**2 for tube in world.tubes])
    weight = NITINOL_KG_M3 * g * area
    tubes = tuple(replace(tube, weight_N_per_m=float(w)) for tube, w in zip(world.tubes, weight, strict=True))
    loads = Loads(world.loads.tip_force_N, (float(down[0]), float(down[1]), float(down[2])))
    return replace(world, tubes=tubes, loads=loads), by_axis("g_{}_m_s2", g * down)


@_register(CATALOGUE)
def shaft_torsion(world: World, draw: Draw) -> tuple[World, Parameters]:
    compliance = draw.size * 4.0 * draw.rng.uniform(0.7, 1.3, world.n) * (np.arange(world.n) > 0)
    tubes = tuple(
        replace(tube, shaft_compliance_rad_per_Nm=float(c)) for tube, c in zip(world.tubes, compliance, strict=True)
    )
    return replace(world, tubes=tubes), by_tube("compliance_{}_rad_per_Nm", compliance)


@_register(CATALOGUE)
def backlash(world: World, draw: Draw) -> tuple[World, Parameters]:
    play = draw.size * np.deg2rad(2.0) * draw.rng.uniform(0.6, 1.4, world.n) * (np.arange(world.n) > 0)
    return add_drive(world, drive.Backlash(play)), by_tube("theta_{}_deg", np.rad2deg(play))


@_register(CATALOGUE)
def homing_rotation(world: World, draw: Draw) -> tuple[World, Parameters]:
    offset = draw.one_of(world.n, draw.inner_tube(world.n), draw.sign() * draw.size * np.deg2rad(1.4))
    return add_drive(world, drive.Offset(offset, 0 * offset)), by_tube("theta_{}_deg", np.rad2deg(offset))


@_register(CATALOGUE)
def homing_translation(world: World, draw: Draw) -> tuple[World, Parameters]:
    offset = draw.one_of(world.n, world.n - 1, draw.sign() * draw.size * 1.5e-3)
    return add_drive(world, drive.Offset(0 * offset, offset)), by_tube("l_{}_mm", 1e3 * offset)


@_register(CATALOGUE)
def joint_scale(world: World, draw: Draw) -> tuple[World, Parameters]:
    turns = draw.one_of(world.n, draw.inner_tube(world.n), draw.sign() * draw.size * 0.022)
    return add_drive(world, drive.Scale(turns, 0 * turns)), by_tube("theta_{}", turns)


@_register(CATALOGUE)
def eccentricity(world: World, draw: Draw) -> tuple[World, Parameters]:
    amplitude = draw.one_of(world.n, draw.inner_tube(world.n), draw.size * np.deg2rad(2.0))
    phase = draw.rng.uniform(-np.pi, np.pi, world.n)
    world = add_drive(world, drive.Eccentricity(amplitude, phase))
    sin_cos = np.rad2deg(amplitude * [np.cos(phase), np.sin(phase)])  # of a sin(theta + p), by sin and cos of theta
    return world, {**by_tube("sin_{}_deg", sin_cos[0]), **by_tube("cos_{}_deg", sin_cos[1])}


@_register(CATALOGUE)
def base_misalignment(world: World, draw: Draw) -> tuple[World, Parameters]:
    turn = draw.rng.standard_normal(3) * [1, 1, 0]
    turn *= draw.size * np.deg2rad(0.4) / np.linalg.norm(turn)
    shift = draw.size * 0.5e-3 * draw.direction()
    world = add_sensor(world, sensor.Misalignment(turn, shift))
    return world, {
        **by_axis("rotation_{}_deg", np.rad2deg(turn)),
        **by_axis("shift_{}_mm", 1e3 * shift),
    }


@_register(CATALOGUE)
def sensor_offset(world: World, draw: Draw) -> tuple[World, Parameters]:
    offset = draw.size * 1.0e-3 * draw.direction()
    return add_sensor(world, sensor.TipOffset(offset)), by_axis("offset_{}_mm", 1e3 * offset)


@_register(CATALOGUE)
def sensor_distortion(world: World, draw: Draw) -> tuple[World, Parameters]:
    wave = np.array([draw.direction() for _ in range(2)]) * 2 * np.pi / draw.rng.uniform(0.2, 0.35)
    amplitude = draw.size * 1.0e-3 * np.array([draw.direction() for _ in range(2)])
    phase = draw.rng.uniform(-np.pi, np.pi, 2)
    return add_sensor(world, sensor.Distortion(amplitude, wave, phase)), {"amplitude_m": amplitude.tolist()}


@_register(CATALOGUE)
def lag(world: World, draw: Draw) -> tuple[World, Parameters]:
    late = draw.size * 0.036
    return replace(world, lag_s=late), {"tau_s": late}


@_register(CATALOGUE)
def drift(world: World, draw: Draw) -> tuple[World, Parameters]:
    rate = draw.size * 1.6e-3 / draw.duration_s * draw.direction()
    return add_sensor(world, sensor.Drift(rate)), by_axis("shift_{}_mm_per_h", 3.6e6 * rate)


@_register(UNKNOWN)
def kink(world: World, draw: Draw) -> tuple[World, Parameters]:
    """A tube permanently bent at one place, out of its plane."""
    tube = draw.inner_tube(world.n)
    length, width = world.tubes[tube].length_m, 4e-3
    turn = draw.sign() * draw.size * np.deg2rad(1.0) / width
    place = float(length - draw.rng.uniform(0.3, 0.7) * world.tubes[tube].sections[-1].length_m)
    bend = Kink(place, width, (turn * 0.97, turn * 0.25))
    return change_tube(world, tube, lambda t: replace(t, kinks=(bend,))), {"tube": tube + 1, "x_m": place}


@_register(UNKNOWN)
def plate_friction(world: World, draw: Draw) -> tuple[World, Parameters]:
    loss = draw.size * np.deg2rad(20.0) / 0.1 * draw.one_of(world.n, world.n - 1, 1.0)
    return add_drive(world, drive.PlateFriction(loss)), {"loss_rad_per_m": loss.tolist()}


@_register(UNKNOWN)
def warming(world: World, draw: Draw) -> tuple[World, Parameters]:
    """The curvature of a tube follows the temperature of the room."""
    change = Warming(draw.inner_tube(world.n), draw.size * 0.04, draw.duration_s / float(draw.rng.uniform(2.2, 4.5)))
    return replace(world, warming=change), {"tube": change.tube + 1, "amplitude": change.amplitude}


@_register(UNKNOWN)
def third_harmonic(world: World, draw: Draw) -> tuple[World, Parameters]:
    amplitude = draw.one_of(world.n, draw.inner_tube(world.n), draw.size * np.deg2rad(2.3))
    phase = draw.rng.uniform(-np.pi, np.pi, world.n)
    return add_drive(world, drive.Eccentricity(amplitude, phase, 3)), {"amplitude_rad": amplitude.tolist()}


@_register(UNKNOWN)
def screw_coupling(world: World, draw: Draw) -> tuple[World, Parameters]:
    rate = draw.one_of(world.n, world.n - 1, draw.sign() * draw.size * np.deg2rad(100.0))
    reference = draw.one_of(world.n, world.n - 1, innermost(world)[0])
    return add_drive(world, drive.Screw(rate, reference)), {"rate_rad_per_m": rate.tolist()}


@_register(UNKNOWN)
def collar_slip(world: World, draw: Draw) -> tuple[World, Parameters]:
    turn = draw.one_of(world.n, draw.inner_tube(world.n), draw.sign() * draw.size * np.deg2rad(5.0))
    when = draw.duration_s * float(draw.rng.uniform(0.35, 0.65))
    return add_drive(world, drive.Slip(turn, when)), {"theta_rad": turn.tolist(), "time_s": when}


@_register(UNKNOWN)
def tracker_jump(world: World, draw: Draw) -> tuple[World, Parameters]:
    shift, when = draw.size * 1.6e-3 * draw.direction(), draw.duration_s * float(draw.rng.uniform(0.35, 0.65))
    return add_sensor(world, sensor.Jump(shift, when)), {"shift_m": shift.tolist(), "time_s": when}


@_register(BUILDABLE)
def cross_talk(world: World, draw: Draw) -> tuple[World, Parameters]:
    """The rotation of one inner tube turns the other one along."""
    share = np.zeros((world.n, world.n))
    turned, turning = draw.rng.permutation(np.arange(1, world.n))[:2]
    share[turned, turning] = draw.sign() * draw.size * 0.022
    return add_drive(world, drive.CrossTalk(share)), {"share": share.tolist()}


@_register(BUILDABLE)
def guide_bend(world: World, draw: Draw) -> tuple[World, Parameters]:
    """The guide bends the more the further the innermost tube is pushed."""
    across = draw.rng.standard_normal(3) * [1, 1, 0]
    turn = draw.size * np.deg2rad(0.8) * across / np.linalg.norm(across)
    bend = GuideBend(world.n - 1, (float(turn[0]), float(turn[1]), 0.0), draw.rng.uniform(-1, 1), *innermost(world))
    return replace(world, guide=bend), {"turn_rad": turn.tolist(), "bow": bend.bow}


@_register(BUILDABLE)
def overlap_stiffness(world: World, draw: Draw) -> tuple[World, Parameters]:
    """A tube is stiffer or softer the further the innermost one is pushed."""
    amount = draw.sign() * min(draw.size * 0.14, 0.7)
    stiffening = Stiffening(draw.inner_tube(world.n), world.n - 1, amount, *innermost(world))
    return replace(world, stiffening=stiffening), {"tube": stiffening.tube + 1, "amount": amount}


@_register(BUILDABLE)
def metal_nearby(world: World, draw: Draw) -> tuple[World, Parameters]:
    """The tracker's field is bent around a place that the tip passes: sharper than any cubic polynomial."""
    angle, width = draw.rng.uniform(-np.pi, np.pi), 0.045
    place = np.array([0.05 * np.cos(angle), 0.05 * np.sin(angle), draw.rng.uniform(0.14, 0.2)])
    shift = draw.size * 3.0e-3 * draw.direction()
    return add_sensor(world, sensor.Metal(shift, place, width)), {"shift_m": shift.tolist(), "place_m": place.tolist()}


@_register(BUILDABLE)
def heading_shift(world: World, draw: Draw) -> tuple[World, Parameters]:
    """A tracker that reads differently by where its coil points."""
    shift = draw.size * 4.0e-3 * draw.direction()
    angle = draw.rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    return add_sensor(world, sensor.Heading(shift, axis)), {"shift_m": shift.tolist(), "axis": axis.tolist()}


@_register(BUILDABLE)
def logged_room(world: World, draw: Draw) -> tuple[World, Parameters]:
    """A temperature that is logged, and does nothing."""
    period_s = draw.duration_s / float(draw.rng.uniform(1.2, 3.5))
    return replace(world, room=Room(4.0, period_s, draw.rng.uniform(-np.pi, np.pi))), {}


@_register(BUILDABLE)
def warm_offset(world: World, draw: Draw) -> tuple[World, Parameters]:
    """What is measured moves with the temperature of the room, which is logged."""
    room = Room(4.0, draw.duration_s / float(draw.rng.uniform(1.2, 3.5)), draw.rng.uniform(-np.pi, np.pi))
    rate = draw.size * 0.4e-3 * draw.direction()
    return add_sensor(replace(world, room=room), sensor.Warm(rate, room)), {"rate_m_K": rate.tolist()}
