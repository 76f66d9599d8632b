"""Loading and release of a pair, step size, energy and slip of simulated histories."""

from dataclasses import dataclass

import numpy as np
from common import finer, panels, save, table
from history_bound import LABELLED, PAIR, PAIR_L_M, THREE, norm_mm, random_path
from matplotlib import colormaps

from ctrplan import Robot
from ctrplan.base.arrays import Array
from ctrplan.mechanics.shapes import LONG_STEPS, Accuracy
from ctrplan.reports import looks

TURNS_DEG = np.array([2, 5, 10, 15, 20, 30, 45, 60, 90, 120])
SHIFTS_MM = np.array([0.1, 0.25, 0.5, 1, 2, 3, 5, 10, 15])


@dataclass(frozen=True)
class Case:
    """A configuration; the innermost pair turns or translates."""

    label: str
    robot: Robot
    theta_deg: tuple[float, ...]
    inner_l_mm: float

    @property
    def place(self) -> tuple[Array, Array]:
        l_mm = np.array([0.0, -17.0, -34.0][: self.robot.n])
        l_mm[-1] = self.inner_l_mm
        return np.radians(self.theta_deg), 1e-3 * l_mm

    @property
    def loaded(self) -> tuple[float, ...]:
        """The innermost pair in its corner, others released."""
        return (*(0.0,) * (self.robot.n - 2), 1.0)


CASES = (
    Case("pair, 60 deg", PAIR, (0, 60), -60.4),
    Case("pair, 120 deg", PAIR, (0, 120), -60.4),
    Case("pair, opposed (180 deg)", PAIR, (0, 180), -60.4),
    Case("three tubes, aligned and 60 deg", THREE, (0, 0, 60), -70.0),
    Case("three tubes, 60 and 40 deg", THREE, (0, 60, 100), -60.0),
    Case("three tubes, opposed (0 and 180 deg)", THREE, (0, 0, 180), -62.8),
)


def corner_m(case: Case) -> tuple[Array, float]:
    """The frictionless tip at the configuration and how far the loaded one is from it [m]."""
    place = case.place
    free_m = case.robot.solve(*place, 0.0, accuracy="certificate").tip_m
    tip_m = case.robot.solve(*place, case.loaded, accuracy="certificate").tip_m
    return free_m, float(np.linalg.norm(tip_m - free_m))


def share_left(case: Case, start: tuple[float, ...] | str, moved: tuple[float, float]) -> float:
    """Share of the corner's deviation after the inner tube has moved to the configuration by (rad, m)."""
    (theta_b, l_b), (free_m, full_m) = case.place, corner_m(case)
    before_theta, before_l = theta_b.copy(), l_b.copy()
    before_theta[-1] -= moved[0]
    before_l[-1] -= moved[1]
    found = case.robot.history(start, accuracy="certificate").follow([before_theta, theta_b], [before_l, l_b])
    return float(norm_mm(found.position_m[-1] - free_m)) * 1e-3 / full_m


def loading(case: Case) -> Array:
    """(T,) share of the corner's deviation after the inner tube has turned by TURNS_DEG from a released state."""
    return np.array([share_left(case, "released", (turn, 0.0)) for turn in np.radians(TURNS_DEG)])


def releasing(case: Case) -> Array:
    """(T,) share of the corner's deviation left after translating by SHIFTS_MM from a loaded state, the worse way."""
    ways = [[share_left(case, case.loaded, (0.0, sign * mm * 1e-3)) for mm in SHIFTS_MM] for sign in (1, -1)]
    return np.max(ways, axis=0)


def release() -> None:
    """Loading against degrees of rotation and release against mm of translation."""
    figure, axes = panels(1, 2, (12, 4.6))
    rows = []
    for k, case in enumerate(CASES):
        loaded, left, (_, full_m) = loading(case), releasing(case), corner_m(case)
        axes[0, 0].plot([0, *TURNS_DEG], [0, *100 * loaded], color=looks.SERIES[k], marker=".", label=case.label)
        axes[0, 1].plot([0, *SHIFTS_MM], [100, *100 * left], color=looks.SERIES[k], marker=".", label=case.label)
        shares = [f"{100 * loaded[turn == TURNS_DEG][0]:.0f} %" for turn in (10, 30, 45, 90)]
        shares += [f"{100 * left[mm == SHIFTS_MM][0]:.1f} %" for mm in (0.5, 2, 10)]
        rows.append((case.label, f"{full_m * 1e3:.2f} mm", *shares))
    axes[0, 0].axhline(95, color="0.6", ls=":")
    axes[0, 1].axhline(10, color="0.6", ls=":")
    axes[0, 0].set(xlabel="rotation of the inner tube from a released state (deg)")
    axes[0, 0].set(ylabel="tip deviation, % of the corner's")
    axes[0, 1].set(xlabel="translation of the inner tube from a loaded state (mm)")
    axes[0, 1].set(ylabel="tip deviation left, % of the corner's")
    axes[0, 0].legend(frameon=False, fontsize=9)
    save(figure, "history/release")
    head = "configuration | corner | 10 deg | 30 deg | 45 deg | 90 deg | left after 0.5 mm | 2 mm | 10 mm"
    table("release", head, rows)


PATHS = 20  # of each robot, for the energy
HALVED_PATHS: dict[Accuracy, int] = {"search": 20, "certificate": 8}


def numerics() -> None:
    for work in (energy, slip_front, halving):
        work()


def halving() -> None:
    """Largest change of any tip of a path when all steps are halved, or long ones; paths without snaps."""
    rows = []
    cases = [(*paths, "halved", finer(2)) for paths in HALVED_PATHS.items()]
    cases.append(("search", HALVED_PATHS["search"], "long", LONG_STEPS))
    for label, robot in LABELLED:
        for accuracy, paths, steps, options in cases:
            changes_mm, snapped = [], 0
            for number in range(paths):
                waypoints = random_path(robot, np.random.default_rng((number, robot.n, 8)))
                one = robot.history(accuracy=accuracy).follow(*waypoints)
                other = robot.history(accuracy=accuracy, options=options).follow(*waypoints)
                if one.snaps.sum() + other.snaps.sum():
                    snapped += 1
                else:
                    changes_mm += norm_mm(one.position_m - other.position_m).tolist()
            share = 100 * np.mean(np.array(changes_mm) <= 0.05)
            shown = [f"{value:.3f}" for value in np.quantile(changes_mm, (0.5, 0.95, 1))]
            rows.append((label, accuracy, steps, paths - snapped, len(changes_mm), *shown, f"{share:.1f} %"))
    head = "robot | mesh | steps | paths | waypoints | median, mm | 95 %, mm | largest, mm | within 0.05 mm"
    table("halving", head, rows)


def energy() -> None:
    """Work of the actuators against elastic energy and friction over random rotations."""
    rows = []
    for label, robot in LABELLED:
        l_b = np.array([0.0, -0.017, -0.07]) if robot.n == 3 else PAIR_L_M
        errors, least, work, loss, snaps = [], 0.0, 0.0, 0.0, 0
        for number in range(PATHS):
            rng = np.random.default_rng((number, robot.n))
            theta_b = np.concatenate([[0.0], rng.uniform(-np.pi, np.pi, robot.n - 1)])
            history = robot.history()
            history.advance(theta_b, l_b)
            for _ in range(3):
                theta_b[1:] += rng.uniform(-2 * np.pi, 2 * np.pi, robot.n - 1)
                step = history.advance(theta_b.copy(), l_b)
                snaps += step.snaps
                if step.snaps:  # kinetic energy is no part of the balance
                    continue
                found = step.energy
                missing = found.work_J - found.elastic_J - found.breakaway_J - found.loss_J
                errors.append(abs(missing) / max(abs(found.work_J), abs(found.elastic_J), found.loss_J))
                least = min(least, found.smallest_loss_J)
                work, loss = work + abs(found.work_J), loss + found.loss_J
        rows.append((label, len(errors), snaps, f"{work:.3f} J", f"{loss:.3f} J",
                     f"{100 * np.median(errors):.2f} %", f"{100 * max(errors):.2f} %", f"{least:.0e} J"))  # fmt: skip
    head = "robot | rotations | snaps | work | friction loss | median imbalance | largest | least loss of a contact"
    table("energy", head, rows)


def slip_front() -> None:
    """phi(s) while a loaded pair is turned back."""
    turns_deg = np.arange(0, 41, 4)
    theta_b = np.radians([0.0, 120.0])
    history = PAIR.history((-1,), accuracy="certificate")
    figure, axes = panels(1, 1, (8, 4.4))
    for turn in turns_deg.tolist():
        (pair,) = history.advance(theta_b + [0, np.radians(turn)], PAIR_L_M).friction
        loaded = pair.force_N > 5e-3 * pair.force_N.max()
        colour = colormaps[looks.HEAT](turn / turns_deg[-1])
        axes[0, 0].plot(1e3 * pair.s_m[loaded], pair.phi[loaded], color=colour, marker=".", label=f"{turn} deg")
    axes[0, 0].set(xlabel="arc length from the plate (mm)", ylabel="friction state of the contacts that carry force")
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=2, title="turned back by")
    save(figure, "history/slip_front")
