"""Tubes for the ventricle, with regard to friction and as the literature designs them: by reach and stability alone.

    python benchmarks/run.py tube_design FOLDER    # two searches of 120 designs, about 8 minutes of a core
    python benchmarks/run.py tube_design FOLDER --trials 400 --plans    # more, and certified plans to all targets

Both searches have the same stock, ranges, targets, sampler, seed and number of designs. The one of the literature sees
no friction: its objectives are the share of targets that the frictionless robot reaches, and the least stability on the
way. Of its front the design with the most reach, then the most stability is taken; of the other the first one. Both,
and the robot that the scenario has, are then looked at with friction from more starts. What is in FOLDER is not done
again.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import SCENARIOS, STUDIES, panels, save, table
from matplotlib.axes import Axes

import ctrplan
from ctrplan import Goal
from ctrplan.base.long_work import one_core
from ctrplan.reports import looks
from ctrplan.studies.target_set import Search, SetValue, set_value

FILE = STUDIES / "design_ventricle.toml"
STARTS = 200  # of inverse kinematics, for the comparison
FRICTION = ("robot.contact.1.friction_coefficient", "robot.contact.2.friction_coefficient")
COLOURS = {"shipped": looks.SERIES[2], "literature": looks.SERIES[1], "with friction": looks.SERIES[0]}


@dataclass(frozen=True, eq=False)
class Judged:
    """A robot, looked at with friction and without."""

    name: str
    rubbing: SetValue
    frictionless: SetValue
    overrides: tuple[str, ...]


def searches(folder: Path, trials: int, workers: int, plans: bool) -> tuple[ctrplan.TubeDesigns, ctrplan.TubeDesigns]:
    """With regard to friction, and as the literature does it."""
    none = [f'set."{key}"=0' for key in FRICTION]
    blind = ["objectives=['reach', 'stability']", "local.designs=0", *none]
    found = []
    for name, own in (("friction", [f"plans={int(plans)}"]), ("literature", blind)):
        search = ctrplan.TubeDesign.read(FILE, [f"trials={trials}", *own])
        found.append(search.run(folder / name, workers=workers))
    return found[0], found[1]


def judge(name: str, search: ctrplan.TubeDesign, overrides: Sequence[str]) -> Judged:
    """Judges a robot by the values given to --set, with the friction of the scenario's robot."""
    own = tuple(text for text in overrides if not text.startswith(FRICTION))
    task = search.job.task
    goals = [Goal(None, point * 1e-3, task["tolerance_mm"] * 1e-3) for point in search.points_mm]
    settings = Search(STARTS, search.entry.seed, search.entry.unreached_mm)
    file = SCENARIOS / "ventricle.toml"
    with one_core():
        rubbing = set_value(ctrplan.load_scenario(file, own), goals, settings)
        bare = set_value(ctrplan.load_scenario(file, [*own, *(f"{key}=0" for key in FRICTION)]), goals, settings)
    return Judged(name, rubbing, bare, own)


def print_table(rows: Sequence[Judged], tolerance_mm: float) -> None:
    cells = []
    for row in rows:
        rub, bare = row.rubbing, row.frictionless
        shares = bare.reach, rub.reach, float(np.mean(rub.errors_mm <= tolerance_mm))
        sizes = rub.error_mm, rub.errors_mm.max(), bare.stability, rub.stability
        cells.append((row.name, *(f"{100 * x:.0f} %" for x in shares), *(f"{x:.2f}" for x in sizes)))
    head = "robot | reach without friction | reach | within tolerance | mean error, mm | largest, mm"
    table("tubes", f"{head} | stability without friction | stability", cells)


def draw_front(axes: Axes, found: ctrplan.TubeDesigns) -> None:
    """Error with tolerances against stability of the search that regards friction, by reach."""
    done = [looked.numbers for looked in found.archive.all if looked.is_done]
    x, y, reach = (np.array([row[name] for row in done]) for name in ("robust_mm", "stability", "reach"))
    points = axes.scatter(x, y, c=reach * 100, s=14, cmap=looks.HEAT, linewidths=0, vmin=0, vmax=100)
    axes.figure.colorbar(points, ax=axes, label="targets reached (%)", shrink=0.8)
    front = np.array([[looked.numbers[name] for name in ("robust_mm", "stability")] for looked in found.front])
    axes.plot(*front.T, "o", mfc="none", mec=looks.INK, ms=7, mew=0.8, label="front")
    axes.set(xscale="log", xlabel="mean error at worst, within tolerances (mm)", ylabel="least stability on the way")
    axes.legend(frameon=False, fontsize=8)


def draw_targets(axes: Axes, rows: Sequence[Judged], unreached_mm: float) -> None:
    """Error at worst of every target, of each robot."""
    width = 0.8 / len(rows)
    for k, row in enumerate(rows):
        at = np.arange(len(row.rubbing.targets)) + (k - (len(rows) - 1) / 2) * width
        axes.bar(at, row.rubbing.errors_mm, width, color=COLOURS[row.name], label=row.name)
    axes.axhline(unreached_mm, color=looks.LIMIT, lw=0.8, ls=":")
    axes.text(-0.4, unreached_mm * 1.01, "not reached", fontsize=8, color=looks.LIMIT, va="bottom")
    axes.set(xlabel="target", ylabel="error at worst (mm)", ylim=(0, 1.12 * unreached_mm))
    axes.legend(frameon=False, fontsize=8)


def draw_tolerances(axes: Axes, entry: dict[str, Any]) -> None:
    """What tolerances of the first design cost."""
    rows = entry["tolerances"][:8][::-1]
    axes.barh([row["name"] for row in rows], [row["costs_mm"] for row in rows], color=looks.SERIES[0])
    axes.tick_params(axis="y", labelsize=8)
    axes.set_xlabel("costs (mm of mean error at worst)")


def print_plans(folder: Path) -> None:
    plans = ctrplan.load_study(folder / "friction" / "plans")
    targets, valid = np.sum(plans["to"] == "joints"), np.nansum(plans["valid"])
    print(f"plans of the first design: {plans.done.sum()} of {targets} found, {valid:.0f} with a valid certificate")
    for to in ("joints", "tip"):  # to the tip where no way to the joints was found
        worst_mm = plans["worst_mm"][plans.done & (plans["to"] == to)]
        print(f"  to {to}: worst case at the goal {np.round(worst_mm, 2).tolist()} mm")


def main() -> None:
    given = common.arguments(__doc__, "folder", trials=120, workers=1, plans=False)
    given.folder = Path(given.folder)
    ours, blind = searches(given.folder, given.trials, given.workers, given.plans)
    first, theirs = ours.entries()[0], max(blind.entries(), key=lambda row: (row["reach"], row["stability"]))
    for name, found in (("with friction", ours), ("literature", blind)):
        done, given_up, unable = found.counts
        seconds = float(np.nansum(found.table["seconds"]))
        print(f"{name}: {done} designs done, {given_up} given up, {unable} unable, {len(found.front)} on the front")
        print(f"  {seconds:.0f} s of processor time")
    for name, entry in (("with friction", first), ("literature", theirs)):
        print(f"{name}, row {entry['row']} ({entry['stage']}): {json.dumps(entry['choices'])}")
    chosen = {"shipped": [], "literature": theirs["set"], "with friction": first["set"]}
    rows = [judge(name, ours.search, overrides) for name, overrides in chosen.items()]
    print_table(rows, ours.search.job.task["tolerance_mm"])
    for row in first["tolerances"]:
        print(f"  {row['name']:32} {row['half_width']:.3g} {row['unit']:5} costs {row['costs_mm']:.4f} mm")
    if given.plans:
        print_plans(given.folder)
    figure, ((left, middle, right),) = panels(1, 3, (13.5, 4))
    draw_front(left, ours)
    draw_targets(middle, rows, ours.search.entry.unreached_mm)
    draw_tolerances(right, first)
    save(figure, "tube_design")
