"""Step size, energy, slip propagation, speed and memory of simulated histories."""

from __future__ import annotations

import resource
import time

import numpy as np
from history_bound import ROBOTS, random_path
from history_page import PAIR, PAIR_L_M, THREE, draw, norm_mm, panels, present, table
from matplotlib import colormaps

from ctrplan.base.arrays import Array
from ctrplan.mechanics.accuracy import Accuracy, HistoryOptions
from ctrplan.reports import looks
from ctrplan.robot.robot import Robot

PATHS = 20  # of each robot, for the energy
HALVED_PATHS: dict[Accuracy, int] = {"search": 20, "certificate": 8}
STEPS = 500  # for the speed
HALVED = HistoryOptions(
    rotation_rad=HistoryOptions.rotation_rad / 2,
    translation_m=HistoryOptions.translation_m / 2,
    state_change=HistoryOptions.state_change / 2,
)


def numerics(write: bool) -> None:
    """All of it."""
    energy(write)
    slip_front(write)
    speed(write)
    halving(write)


def halving(write: bool) -> None:
    """Largest change of any tip of a path when all steps are halved; paths without snaps."""
    rows = []
    for label, robot in ROBOTS:
        for accuracy, paths in HALVED_PATHS.items():
            changes_mm, snapped = [], 0
            for number in range(paths):
                waypoints = random_path(robot, np.random.default_rng((number, robot.n, 8)))
                one = robot.history(accuracy=accuracy).follow(*waypoints)
                other = robot.history(accuracy=accuracy, options=HALVED).follow(*waypoints)
                if one.snaps.sum() + other.snaps.sum():
                    snapped += 1
                else:
                    changes_mm += norm_mm(one.position_m - other.position_m).tolist()
            share = 100 * np.mean(np.array(changes_mm) <= 0.05)
            shown = [f"{value:.3f}" for value in np.quantile(changes_mm, (0.5, 0.95, 1))]
            rows.append((label, accuracy, paths - snapped, len(changes_mm), *shown, f"{share:.1f} %"))
    head = ("robot", "mesh", "paths", "waypoints", "median, mm", "95 %, mm", "largest, mm", "within 0.05 mm")
    present("halving", table(head, rows), write)


def energy(write: bool) -> None:
    """Work of the actuators against elastic energy and friction over random rotations."""
    rows = []
    for label, robot in ROBOTS:
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
    head = (
        "robot",
        "rotations",
        "snaps",
        "work",
        "friction loss",
        "median imbalance",
        "largest",
        "least loss of a contact",
    )
    present("energy", table(head, rows), write)


def slip_front(write: bool) -> None:
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
    axes[0, 0].set_xlabel("arc length from the plate (mm)")
    axes[0, 0].set_ylabel("friction state of the contacts that carry force")
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=2, title="turned back by")
    draw("slip_front", figure, write)


def speed(write: bool) -> None:
    """CPU time of steps, and the growth of memory over more of them."""
    rows = []
    for label, robot in ROBOTS:
        for kind in ("rotation", "translation"):
            theta_b, l_b = fine_path(robot, kind)
            history = robot.history((1,) * (robot.n - 1))
            history.follow(theta_b[:1], l_b[:1])
            begun = time.process_time()
            history.follow(theta_b[1:], l_b[1:])
            taken_s = time.process_time() - begun
            before_kB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            for _ in range(4):
                history.follow(theta_b[::-1], l_b[::-1])
                history.follow(theta_b, l_b)
            grown_kB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kB
            rows.append((label, kind, STEPS, f"{taken_s:.2f} s", f"{grown_kB} kB"))
    head = ("robot", "path", "steps", "CPU time", "growth of memory over 4,000 more")
    present("speed", table(head, rows), write=False)  # printed only


def fine_path(robot: Robot, kind: str) -> tuple[Array, Array]:
    """STEPS waypoints one step apart."""
    part = np.linspace(0, 1, STEPS + 1)[:, None]
    theta_b = np.array([0.0, 0.7, 1.9])[: robot.n] + part * (
        np.array([0.0, 10.0, 25.0])[: robot.n] if kind == "rotation" else 0
    )
    l_b = np.array([0.0, -0.017, -0.07]) if robot is THREE else PAIR_L_M
    back = np.zeros(robot.n)
    back[-1] = -0.03
    return theta_b + 0 * part, l_b + part * (back if kind == "translation" else 0)
