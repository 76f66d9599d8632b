"""Everything that is true of a robot and its measurement, and the three-tube robot that its user believes in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hidden_effects.contact import Pair
from hidden_effects.equilibrium import Loads
from hidden_effects.mesh import SAME_PLACE_M
from hidden_effects.tube import Array, Section, Tube


@dataclass(frozen=True)
class Motion:
    """Joint rows in the order of time: theta, l (K, n), time_s (K,), sequence (K,)."""

    theta: Array
    l: Array  # noqa: E741
    time_s: Array
    sequence: Array


DriveTerm = Callable[[Motion], Motion]  # commanded -> at the collars
SensorTerm = Callable[[Array, Array, Array], tuple[Array, Array]]  # tips (K, 3), frames (K, 3, 3), time_s -> the same


@dataclass(frozen=True)
class Warming:
    """The precurvature of a tube follows 1 + amplitude sin(2 pi t / period)."""

    tube: int
    amplitude: float
    period_s: float


@dataclass(frozen=True)
class Stiffening:
    """The stiffness of a tube follows 1 + amount (l - middle) / half, l the translation of another one."""

    tube: int
    by: int
    amount: float
    middle_m: float
    half_m: float


@dataclass(frozen=True)
class GuideBend:
    """All in front of the plate is turned by `turn_rad` (3,) times u + bow (u^2 - 1/3), u of a tube's translation."""

    by: int
    turn_rad: tuple[float, float, float]
    bow: float
    middle_m: float
    half_m: float

    def rotations_rad(self, l: Array) -> Array:  # noqa: E741
        """Rotation vectors (K, 3) at translations (K, n)."""
        u = (l[:, self.by] - self.middle_m) / self.half_m
        return np.outer(u + self.bow * (u**2 - 1 / 3), self.turn_rad)


@dataclass(frozen=True)
class Room:
    """A temperature that rises and falls: 21 + amplitude sin(2 pi t / period + phase) [C]."""

    amplitude_C: float
    period_s: float
    phase: float

    def temperature_C(self, time_s: Array) -> Array:
        return np.asarray(21.0 + self.amplitude_C * np.sin(2 * np.pi * time_s / self.period_s + self.phase))


@dataclass(frozen=True)
class World:
    """The true robot: tubes, pairs, loads, and the terms of drive and sensor in the order in which they act."""

    tubes: tuple[Tube, ...]
    pairs: tuple[Pair, ...]
    loads: Loads = field(default_factory=Loads)
    drive: tuple[DriveTerm, ...] = ()
    sensor: tuple[SensorTerm, ...] = ()
    lag_s: float = 0.0  # the pose belongs to the joints of this much earlier
    release_m: float = np.inf  # friction torsion falls to 1/e over this translation
    warming: Warming | None = None
    stiffening: Stiffening | None = None
    guide: GuideBend | None = None
    room: Room | None = None  # logged with the poses
    travel_m: tuple[tuple[float, float], ...] = ()  # of every translation, from that of the tube outside

    @property
    def n(self) -> int:
        return len(self.tubes)

    @property
    def middle_m(self) -> Array:
        """(n,) translations in the middle of their ranges."""
        return np.cumsum([np.mean(ends) for ends in self.travel_m])

    @property
    def half_m(self) -> Array:
        """(n,) how far they reach from there."""
        return np.cumsum([(ends[1] - ends[0]) / 2 for ends in self.travel_m])

    @property
    def withdrawn(self) -> tuple[bool, ...]:
        """(n,) whether a tube's tip may be drawn back behind that of the tube around it."""
        inner = zip(self.travel_m[1:], self.tubes[:-1], self.tubes[1:], strict=True)
        return False, *(ends[0] + own.length_m < around.length_m - SAME_PLACE_M for ends, around, own in inner)

    def tubes_at(self, time_s: float, l_b: Array | None = None) -> tuple[Tube, ...]:
        tubes = self.tubes
        if self.warming is not None:
            factor = 1 + self.warming.amplitude * np.sin(2 * np.pi * time_s / self.warming.period_s)
            tubes = tuple(bent(tube, factor) if i == self.warming.tube else tube for i, tube in enumerate(tubes))
        if self.stiffening is not None and l_b is not None:
            s = self.stiffening
            more = 1 + s.amount * float((l_b[s.by] - s.middle_m) / s.half_m)
            tubes = tuple(stiffened(tube, more) if i == s.tube else tube for i, tube in enumerate(tubes))
        return tubes


def bent(tube: Tube, factor: float) -> Tube:
    """The tube with all its precurvature times `factor`."""
    sections = tuple(
        replace(section, curvature_per_m=(factor * section.curvature_per_m[0], factor * section.curvature_per_m[1]))
        for section in tube.sections
    )
    return replace(tube, sections=sections)


def stiffened(tube: Tube, factor: float) -> Tube:
    """The tube with its stiffness times `factor`."""
    return replace(tube, bending_stiffness_Nm2=factor * tube.bending_stiffness_Nm2)


def believed() -> World:
    """The three-tube robot of Ha et al. 2019, Table II: what the user's robot file says."""
    return paired(THREE, (FIXED, (-0.017, -0.017), INSERTED))


def pair() -> World:
    """The two inner ones of these tubes."""
    return paired(THREE[1:], (FIXED, INSERTED))


def four_tubes() -> World:
    """These tubes, and a thinner one of the same alloy within them, which reaches 10 to 30 mm further."""
    fourth = Tube(0.7e-3, 0.6e-3, 0.0047, 0.3, (Section(0.270, (0, 0)), Section(0.04, (0, 12.0))))
    return paired((*THREE, fourth), (FIXED, (-0.017, -0.017), INSERTED, (-0.0296, -0.0096)))


def withdrawn() -> World:
    """The three tubes, the innermost of which ends up to 43 mm behind the others' tip or in front of it."""
    return paired(THREE, (FIXED, (-0.017, -0.017), (-0.146, -0.060)))


def withdrawn_pair() -> World:
    """The two inner ones, as far apart."""
    return paired(THREE[1:], (FIXED, (-0.146, -0.060)))


CURVED = Section(0.150, (0, 3.77358))
THREE = (
    Tube(1.32e-3, 1.195e-3, 0.0507, 0.3, (CURVED,)),
    Tube(1.1525e-3, 0.975e-3, 0.0507, 0.3, (Section(0.017, (0, 0)), CURVED)),
    Tube(0.9125e-3, 0.8e-3, 0.0145, 0.3, (Section(0.184, (0, 0)), Section(0.0864, (0, 18.1818)))),
)
FIXED, INSERTED = (0.0, 0.0), (-0.098, -0.019)
ROBOTS: dict[str, Callable[[], World]] = {"three tubes": believed, "two tubes": pair, "four tubes": four_tubes}
ROBOTS |= {"three tubes, withdrawn": withdrawn, "two tubes, withdrawn": withdrawn_pair}


def paired(tubes: tuple[Tube, ...], travel_m: tuple[tuple[float, float], ...] = ()) -> World:
    """A frictionless world whose clearances are what the radii leave."""
    pairs = tuple(
        Pair(outer.inner_radius_m - inner.outer_radius_m, 0.0, outer.inner_radius_m, inner.outer_radius_m)
        for outer, inner in zip(tubes[:-1], tubes[1:], strict=True)
    )
    return World(tubes, pairs, travel_m=travel_m)


@dataclass(frozen=True)
class Ordinary:
    """What calibration is for: factors of curvature and of stiffness (the first one 1), Poisson's ratios."""

    curvature: tuple[float, ...]
    stiffness: tuple[float, ...]
    poisson_ratio: tuple[float, ...]

    def of(self, world: World) -> World:
        tubes = tuple(
            replace(bent(tube, u), bending_stiffness_Nm2=tube.bending_stiffness_Nm2 * k, poisson_ratio=nu)
            for tube, u, k, nu in zip(world.tubes, self.curvature, self.stiffness, self.poisson_ratio, strict=True)
        )
        return replace(world, tubes=tubes)

    def vector(self) -> Array:
        return np.array([*self.curvature, *self.stiffness[1:], *self.poisson_ratio])

    @staticmethod
    def from_vector(values: Array) -> Ordinary:
        n = (len(values) + 1) // 3
        v = tuple(values.tolist())
        return Ordinary(v[:n], (1.0, *v[n : 2 * n - 1]), v[2 * n - 1 :])


def draw_ordinary(n: int, rng: np.random.Generator) -> Ordinary:
    """Curvature within 8 %, stiffness ratios within 10 %, Poisson's ratios 0.22 to 0.38."""
    return Ordinary(
        tuple((1 + rng.uniform(-0.08, 0.08, n)).tolist()),
        (1.0, *(1 + rng.uniform(-0.10, 0.10, n - 1)).tolist()),
        tuple(rng.uniform(0.22, 0.38, n).tolist()),
    )
