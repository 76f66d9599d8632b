"""What does path history do to a robot, and is its simulation right? Figures and tables of docs/history.md.

    python benchmarks/run.py [--write] history [--histories N] [section_v] [loop] [erasure] [bound] [release] [numerics]
        [simulator] [windings [--configurations N]]

All sections if none is named. `bound` simulates 2,000 random histories, which takes tens of minutes; with --histories N
of each robot. section_v: Section V-B of the paper, eight path histories to each of 37 base angles; loop: the hysteresis
of Fig. 1; erasure: corners of friction and the released state at one configuration, driven one way until tips agree;
simulator: tips of the tests' independent rods beside the bound, of random robots of two to five tubes; windings: do
`robot.equilibria`, and what `bound`, `ik` and `view` say of others, have the ends of histories with whole turns?
"""

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from typing import Any

import common
import numpy as np
from common import ROBOTS, panels, save, table
from history_bound import HISTORIES as COUNT
from history_bound import PAIR, PAIR_L_M, ROBOTS_DRAWN, bound, norm_mm, simulator
from history_numerics import numerics, release
from matplotlib.figure import Figure

from ctrplan import Robot, Shape, Status, robot_from_dict
from ctrplan.base.arrays import Array
from ctrplan.base.long_work import cores
from ctrplan.errors import SolverError
from ctrplan.mechanics.equilibria import SAME_SHAPE_M
from ctrplan.mechanics.friction import corner_signs
from ctrplan.mechanics.history import HistoryOptions
from ctrplan.reports import looks
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.storage.toml_document import read_document

COLOURS = (*looks.SERIES, looks.ENVELOPE, looks.CORNER)
ANGLES_DEG = np.arange(0, 361, 10)
OFFSET_DEG, OFFSET_M = 90.0, 10e-3
HISTORIES = {  # name -> direction of the rotation and of the translation by which the configuration is reached
    "rotation +": (1, 0), "rotation -": (-1, 0), "translation +": (0, 1), "translation -": (0, -1),
    "both + +": (1, 1), "both + -": (1, -1), "both - +": (-1, 1), "both - -": (-1, -1),
}  # fmt: skip
OUTER_TIP_M = 0.167
SMALL_GAP_DEG = 1.0  # of the two rotations: below it nothing can be told apart


def relative_angle_deg(shape: Shape) -> float:
    """Angle of the inner tube against the outer one at the outer one's tip."""
    outer, inner = shape.tubes
    return float(np.degrees(np.interp(OUTER_TIP_M, inner.s_m, inner.theta_rad) - outer.theta_rad[-1]))


@cache
def measured() -> tuple[Array, Array, Array, Array]:
    """Relative tip angles (37, 8) [deg] and tips (37, 8, 3) [m], and the frictionless ones (37,), (37, 3).

    Each base angle is one run: eight times out to an offset configuration and back to the target, joints together. It
    starts released, so that the translations come after a rotation has loaded the pair.
    """
    angle = np.empty((len(ANGLES_DEG), len(HISTORIES)))
    tip = np.empty((*angle.shape, 3))
    free_angle, free_tip = np.empty(len(angle)), np.empty((len(angle), 3))
    for i, base_deg in enumerate(ANGLES_DEG):
        target = np.radians([0.0, base_deg])
        history = PAIR.history(accuracy="certificate")
        free = history.advance(target, PAIR_L_M).frictionless
        free_angle[i], free_tip[i] = relative_angle_deg(free), free.tip_m
        for k, (turn, shift) in enumerate(HISTORIES.values()):
            history.advance(target - [0, turn * np.radians(OFFSET_DEG)], PAIR_L_M - [0, shift * OFFSET_M])
            step = history.advance(target, PAIR_L_M)
            assert step.shape.status is Status.CONVERGED and step.snaps == 0
            angle[i, k], tip[i, k] = relative_angle_deg(step.shape), step.shape.tip_m
    return angle, tip, free_angle, free_tip


def section_v() -> None:
    """Figs. 19 to 21, and the statements about them at every base angle."""
    save(fig_19(), "history/fig_19")
    save(fig_20(), "history/fig_20")
    save(fig_21(), "history/fig_21")
    angle, tip, free_angle, free_tip = measured()
    gap = angle[:, 1] - angle[:, 0]  # approached clockwise the inner tube's tip lags behind, ahead of the base
    away_mm = norm_mm(tip - free_tip[:, None])
    told = np.abs(gap) > SMALL_GAP_DEG
    low, high = np.minimum(angle[:, 0], angle[:, 1]), np.maximum(angle[:, 0], angle[:, 1])
    others, between = angle[:, 2:], np.sort(angle[:, 2:4], axis=1)
    translations = np.abs(angle[:, 2] - angle[:, 3]) / np.abs(gap)
    from_free = np.abs(angle[:, 2:4] - free_angle[:, None]).max(axis=1) / np.abs(gap)
    inside = np.all((others >= low[:, None] - 1e-3) & (others <= high[:, None] + 1e-3), axis=1)
    slack = 0.01 * np.abs(gap)[:, None]
    plus = np.abs(angle[:, 4:6] - angle[:, :1]) + np.abs(angle[:, 4:6] - between.mean(axis=1)[:, None])
    minus = np.abs(angle[:, 6:8] - angle[:, 1:2]) + np.abs(angle[:, 6:8] - between.mean(axis=1)[:, None])
    on_way = np.all(plus <= np.abs(angle[:, :1] - between.mean(axis=1)[:, None]) + slack, axis=1)
    on_way &= np.all(minus <= np.abs(angle[:, 1:2] - between.mean(axis=1)[:, None]) + slack, axis=1)
    together = np.maximum(np.abs(angle[:, 4] - angle[:, 5]), np.abs(angle[:, 6] - angle[:, 7])) / np.abs(gap)
    farthest = away_mm[:, :2].min(axis=1) >= away_mm[:, 2:].max(axis=1) - 1e-3
    mean_mm = away_mm[:, :2].mean(axis=1)
    count = f"of {told.sum()}"
    rows = [
        ("the two rotations are the extremes of the relative tip angle", f"{inside[told].sum()} {count}"),
        ("and farthest from the frictionless tip", f"{farthest[told].sum()} {count}"),
        ("the translations agree within 5 % of the gap of the rotations",
         f"{(translations[told] <= 0.05).sum()} {count}, at most {100 * translations[told].max():.2f} %"),
        ("and lie near the frictionless solution (within 5 % of the gap)",
         f"{(from_free[told] <= 0.05).sum()} {count}, at most {100 * from_free[told].max():.2f} %"),
        ("mixed ones lie between their rotation and the translations", f"{on_way[told].sum()} {count}"),
        ("pairwise together by direction of rotation (within 5 % of the gap)",
         f"{(together[told] <= 0.05).sum()} {count}, at most {100 * together[told].max():.1f} %"),
        ("distances are largest near 180 deg", f"{mean_mm.max():.2f} mm at {ANGLES_DEG[mean_mm.argmax()]} deg"),
        ("the tips lie near a plane, turned about the y axis (paper: by 23 deg, within 0.5 mm)",
         "by {:.1f} deg, within {:.2f} mm".format(*plane(tip.reshape(-1, 3)))),
        ("base angles where the rotations differ by less than 1 deg, left out", f"{(~told).sum()}"),
    ]  # fmt: skip
    table("section_v", ("statement", "base angles at which it holds"), rows)


def plane(points: Array) -> tuple[float, float]:
    """Angle [deg] from the x-y plane of the plane that fits best, and the largest distance from it [mm]."""
    centred = points - points.mean(axis=0)
    normal = np.linalg.svd(centred)[2][2]
    return float(np.degrees(np.arccos(abs(normal[2])))), float(1e3 * np.abs(centred @ normal).max())


def fig_19() -> Figure:
    """Relative tip angle, and what friction adds to it."""
    angle, _, free_angle, _ = measured()
    figure, axes = panels(1, 2, (12, 4.6))
    for k, name in enumerate(HISTORIES):
        axes[0, 0].plot(ANGLES_DEG, angle[:, k], color=COLOURS[k], label=name, linewidth=1.4)
        axes[0, 1].plot(ANGLES_DEG, angle[:, k] - free_angle, color=COLOURS[k], marker=".", linewidth=1.2)
    axes[0, 0].plot(ANGLES_DEG, free_angle, "--", color=looks.INK, label="frictionless")
    axes[0, 1].axhline(0, ls="--", color=looks.INK, linewidth=1)
    axes[0, 0].set_ylabel("relative angle at the tip of tube 1 (deg)")
    axes[0, 1].set_ylabel("against the frictionless solution (deg)")
    for ax in axes.flat:
        ax.set(xlabel="relative base angle (deg)", xticks=range(0, 361, 60))
    axes[0, 0].legend(frameon=False, fontsize=9)
    return figure


def fig_20() -> Figure:
    """Tips in two projections."""
    _, tip, _, free_tip = measured()
    figure, axes = panels(1, 2, (11, 5.2))
    for ax, (a, b) in zip(axes.flat, ((0, 1), (0, 2)), strict=True):
        for k in range(2):
            ax.plot(1e3 * tip[:, k, a], 1e3 * tip[:, k, b], color=COLOURS[k], label=list(HISTORIES)[k])
        ax.plot(1e3 * free_tip[:, a], 1e3 * free_tip[:, b], "--", color=looks.INK, label="frictionless", linewidth=1)
        for k, name in enumerate(HISTORIES):
            points = tip[::6, k]
            ax.plot(1e3 * points[:, a], 1e3 * points[:, b], ".", color=COLOURS[k], label=name if k > 1 else None)
        ax.set(xlabel="xyz"[a] + " (mm)", ylabel="xyz"[b] + " (mm)")
        ax.set_aspect("equal", adjustable="datalim")
    axes[0, 0].legend(frameon=False, fontsize=9)
    return figure


def fig_21() -> Figure:
    """Mean distance from the frictionless tip by kind of history."""
    _, tip, _, free_tip = measured()
    away_mm = norm_mm(tip - free_tip[:, None])
    figure, axes = panels(1, 1, (7, 4.2))
    for label, rows, colour in (
        ("rotations", slice(0, 2), COLOURS[0]),
        ("rotations and translations", slice(4, 8), COLOURS[4]),
        ("translations", slice(2, 4), COLOURS[2]),
    ):
        axes[0, 0].plot(ANGLES_DEG, away_mm[:, rows].mean(axis=1), color=colour, label=label)
    axes[0, 0].set(xlabel="relative base angle (deg)", ylabel="mean distance from the frictionless tip (mm)")
    axes[0, 0].set(xticks=range(0, 361, 60), ylim=(0, None))
    axes[0, 0].legend(frameon=False)
    return figure


def loop() -> None:
    """Fig. 1 (b): there and back again, with smaller loops inside."""
    base_deg = np.concatenate([np.arange(0, 361, 4), np.arange(356, -1, -4)])
    inner_deg = np.concatenate([np.arange(*of) for of in ((0, 181, 4), (176, 139, -4), (144, 221, 4), (216, 119, -4))])
    figure, axes = panels(1, 2, (12, 4.6))
    rows = []
    for deg, colour, label in ((base_deg, COLOURS[0], "0 - 360 - 0 deg"), (inner_deg, COLOURS[5], "smaller turns")):
        history = PAIR.history(accuracy="certificate")
        steps = [history.advance(np.radians([0, d]), PAIR_L_M) for d in deg.tolist()]
        angle = np.array([relative_angle_deg(step.shape) for step in steps])
        free = np.array([relative_angle_deg(step.frictionless) for step in steps])
        axes[0, 0].plot(deg, angle, color=colour, label=label)
        axes[0, 1].plot(deg, angle - deg, color=colour)
        if deg is base_deg:
            axes[0, 0].plot(deg, free, "--", color=looks.INK, linewidth=1, label="frictionless")
            axes[0, 1].plot(deg, free - deg, "--", color=looks.INK, linewidth=1)
            there, back = angle[:91], angle[90:][::-1]
            for at in (60, 120, 180, 240, 300):
                k = at // 4
                tips = norm_mm(steps[k].shape.tip_m - steps[180 - k].shape.tip_m)
                rows.append((f"{at} deg", *(f"{x:.1f} deg" for x in (there[k], back[k], free[k])), f"{tips:.1f} mm"))
    axes[0, 0].set_ylabel("relative angle at the tip of tube 1 (deg)")
    axes[0, 1].set_ylabel("tip angle - base angle (deg)")
    for ax in axes.flat:
        ax.set(xlabel="relative base angle (deg)", xticks=range(0, 361, 60))
    axes[0, 0].legend(frameon=False)
    save(figure, "history/fig_1")
    table("loop", "base angle | tip angle, turning + | turning - | frictionless | between the two tips", rows)


def way_to(
    robot: Robot, at: tuple[Array, Array], turn: Any, slide: Any, rows: int, options: HistoryOptions | None = None
) -> tuple[float, list[float]]:
    """Largest distance [mm] of tips at first, and shares of the way after which 1 and 0.1 % of it are left."""
    theta, l = at  # noqa: E741 (as in the equations)
    starts = ["released", *itertools.product((1.0, -1.0), repeat=robot.n - 1)]
    share, tips = np.linspace(0, 1, rows + 1)[:, None], []
    for start in starts:
        tips.append(
            robot.history(start, options=options)
            .follow(theta + share * np.asarray(turn), l + share * np.asarray(slide))
            .position_m
        )
    apart = np.max([np.linalg.norm(a - b, axis=1) for a, b in itertools.combinations(tips, 2)], axis=0)
    last = [np.flatnonzero(apart > left * apart[0]) for left in (0.01, 0.001)]
    return 1e3 * apart[0], [(above[-1] + 1) / rows if above[-1] < rows else np.inf for above in last]


def said(motion: float, unit: str) -> str:
    return f"{motion:.{0 if unit == 'deg' else 1}f} {unit}" if np.isfinite(motion) else "never"


def erasure() -> Iterator[tuple[str, ...]]:
    def row(what: str, motion: str, robot: Robot, at: tuple[Array, Array], turn: Any, slide: Any, rows: int,
            options: HistoryOptions | None = None) -> tuple[str, ...]:  # fmt: skip
        first, left = way_to(robot, at, turn, slide, rows, options)
        scale, unit = (np.degrees(np.abs(turn).max()), "deg") if np.any(turn) else (1e3 * np.abs(slide).max(), "mm")
        return what, motion, f"{first:.1f} mm", *(said(scale * x, unit) for x in left)

    pair, three = (read_document(ROBOTS / name).content for name in ("table_5_pair.toml", "three_tube.toml"))
    slide, turn, place = ((0, 0), (0, 30e-3)), ((0, np.pi), (0, 0)), np.array([0, -90e-3])
    usual = [(angle, mu, None) for mu, angle in itertools.product((0.2, 0.5), (60, 170))]
    for angle, mu, gap in (*usual, (120, 0.2, 0.005), (120, 0.2, 0.15)):
        contact = {**pair["contact"][0], "friction_coefficient": mu, **({} if gap is None else {"clearance_mm": gap})}
        robot, at = robot_from_dict({**pair, "contact": [contact]}), (np.radians([0, angle]), place)
        what = f"pair, {angle} deg, friction {mu}" + (f", clearance {gap} mm" if gap else "")
        yield row(what, "slide", robot, at, *slide, 300)
        if gap is None:
            yield row(what, "turn", robot, at, *turn, 360)
    for slide_mm, turn_deg in ((0.25, 0.5), (0.05, 0.1)):
        options = HistoryOptions(translation_m=1e-3 * slide_mm, rotation_rad=np.radians(turn_deg))
        what, at = f"pair, 120 deg, friction 0.2, steps of {slide_mm} mm, {turn_deg} deg", (np.radians([0, 120]), place)
        for motion, way in (("slide", slide), ("turn", turn)):
            yield row(what, motion, robot_from_dict(pair), at, *way, 300, options)
    robot, at = robot_from_dict(three), (np.radians([0, 60, 40]), np.array([0, -17e-3, -80e-3]))
    yield row("three tubes", "inner slides", robot, at, (0, 0, 0), (0, 0, 40e-3), 200)
    turns = {"inner turns": (0, 0, np.pi), "middle and inner turn": (0, -np.pi, np.pi / 2)}
    for motion, by in {**turns, "all turn together": [np.pi] * 3}.items():
        yield row("three tubes", motion, robot, at, by, (0, 0, 0), 200)


def wound(robot: Robot, q: Array) -> Array:
    """(6,) Whether joints (m,) have several shapes; histories that end there, those on a known shape, those not in the
    one that is solved, and those of them that are told of; whether every state that they go on to is known.
    """
    theta, l = robot.drive.collars(q)  # noqa: E741 (as in the equations)
    shapes, own = robot.equilibria(theta, l).branches, robot.solve(theta, l).tip_m
    is_told = any(np.linalg.norm(shape.tip_m[shape.first] - own) > SAME_SHAPE_M for shape in shapes)
    states = np.vstack([np.zeros(robot.n - 1), corner_signs(robot.n - 1)])
    counts = np.array([len(shapes) > 1, 0, 0, 0, 0, 1])
    for turns in itertools.product((-1, 0, 1), repeat=robot.n - 1):
        before = 2 * np.pi * np.array(turns) if any(turns) else np.full(robot.n - 1, 1.5)
        history = robot.history()
        with suppress(SolverError):
            path = history.follow(np.array([theta - np.append(0, np.cumsum(before)), theta]), np.array([l, l]))
            if path.status[-1] != Status.CONVERGED:
                continue
            tips = np.array([history.tip_beside(phi) for phi in states])
            apart = np.array([np.linalg.norm(shape.tip_m - tips, axis=1) for shape in shapes])
            found = np.nan_to_num(apart, nan=np.inf).min(axis=0)[np.isfinite(tips[:, 0])] < SAME_SHAPE_M
            is_elsewhere = np.linalg.norm(tips[0] - own) > SAME_SHAPE_M
            counts[1:5] += [1, found.any(), is_elsewhere, is_elsewhere and is_told]
            counts[5] &= found.all()
    return counts


def windings(count: int) -> Iterator[tuple[object, ...]]:
    from stated_plans import rvim, table_ii  # robots that the tests wind up

    for name, robot in (("RViM", rvim()), ("Table II", table_ii())):
        joints = JointSpace.of_robot(robot).sample(np.random.default_rng(12), 2 * count)[:count]
        with ThreadPoolExecutor(cores()) as pool:
            yield name, len(joints), *np.sum(list(pool.map(partial(wound, robot), joints)), axis=0)


OF_WINDINGS = "robot | configurations | of several shapes | histories | on a known one | not in that solved | told"
OF_WINDINGS += " | configurations with all states known"


def main() -> None:
    known: dict[str, Any] = {"section_v": section_v, "loop": loop, "release": release, "numerics": numerics}
    known["erasure"] = ("erasure", "robot | motion | apart at first | 1 % is left after | 0.1 %", erasure)
    known |= {"bound": lambda: bound(given.histories), "simulator": lambda: simulator(given.robots)}
    known["windings"] = ("windings", OF_WINDINGS, lambda: windings(given.configurations))
    given = common.arguments(__doc__, ("sections*", known), histories=COUNT, robots=ROBOTS_DRAWN, configurations=500)
    common.sections(given.sections, known)
