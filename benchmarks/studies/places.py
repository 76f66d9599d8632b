"""Where the tip gets and from where: reach maps, entries of scenarios, poses in a burr hole, with their pictures.

    python benchmarks/run.py places reach FOLDER   # reach_maps.png, 4,000 targets, 0.3 s apiece
    python benchmarks/run.py places entry [--candidates 128] [SCENARIO ...]   # entry.png
    python benchmarks/run.py places poses FOLDER   # entry_study.png, 1,352 tasks, 0.2 s apiece

reach: where the tip gets within 1 and 2 mm, whatever friction does and without regard to it. Targets are drawn at
random, so that the first of them are a fair sample, too; intervals are 95 % of what a share of so many draws may be
(Wilson). entry: `ctrplan place` beside the pose that a scenario has. poses: which pose in the burr hole of
scenarios/studies/entry_ventricle.toml reaches most. What is in FOLDER is not done again.
Pictures of docs/images are renewed by `run.py --write places ...`.
"""

import sys
import time
from pathlib import Path

import common
import numpy as np
from common import SCENARIOS, SHIPPED, STUDIES, panels, save
from matplotlib.axes import Axes

import ctrplan
from ctrplan import Placement
from ctrplan.base.arrays import Array
from ctrplan.planning.place import CONE_RAD, RADIUS_M, PoseScore, Screen, _patch
from ctrplan.reports import looks
from ctrplan.reports.study_page import BasePoses
from ctrplan.uncertainty.worst_case import wilson

NAMES = ("ventricle", "airway")
REGARDS = (("free_within", "without regard to friction"), ("within", "whatever friction does"))
LEVELS = (("within 1 mm", looks.MET), ("within 2 mm", looks.SERIES[1]), ("not", "#c8ccd2"))


def print_shares(name: str, table: ctrplan.StudyTable) -> None:
    """A line for each distance."""
    for near in (1, 2):
        texts = []
        for column, words in REGARDS:
            reached = table[f"{column}_{near}_mm"] == 1
            low, high = wilson(reached)
            texts.append(f"{100 * reached.mean():5.1f} % ({100 * low:.1f} to {100 * high:.1f}) {words}")
        print(f"  {name:10} {len(table):5,} targets, within {near} mm: {'; '.join(texts)}")


def draw_reach(axes: Axes, table: ctrplan.StudyTable, column: str, outline: Array) -> None:
    """Targets as they are seen along y, the best last, over the anatomy's own shadow."""
    axes.scatter(outline[:, 0], outline[:, 2], s=1.5, color="#eceef1", linewidths=0, rasterized=True)
    one, two = (table[f"{column}_{near}_mm"] == 1 for near in (1, 2))
    groups = ((~two, LEVELS[2]), (two & ~one, LEVELS[1]), (one, LEVELS[0]))
    for rows, (label, colour) in groups:
        axes.scatter(
            table["target_x_mm"][rows], table["target_z_mm"][rows], s=7, color=colour, label=label, linewidths=0
        )
    axes.set_aspect("equal")


def reach(folder: Path) -> None:
    figure, (axes,) = panels(1, 4, (11, 5.6))
    for k, name in enumerate(NAMES):
        study = ctrplan.Study.read(STUDIES / f"reach_{name}.toml")
        table = study.run(folder / name)
        print_shares(name, table)
        assert study.scenario is not None
        outline = study.scenario.anatomy[0].shape.surface().vertices_m * 1e3
        for panel, (column, words) in zip(axes[2 * k : 2 * k + 2], REGARDS, strict=True):
            draw_reach(panel, table, column, outline)
            panel.set_title(f"{name}\n{words}", fontsize=10)
            panel.set_xlabel("x (mm)")
    axes[0].set_ylabel("z, from the plate (mm)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=3, frameon=False, markerscale=2)
    save(figure, "reach_maps")


def looked_at(scenario: ctrplan.Scenario, count: int) -> list[PoseScore]:
    """The candidates of `ctrplan place`, those too that seem to reach nothing."""
    patch = _patch(scenario, None, None, None, RADIUS_M, CONE_RAD)
    screen, found = Screen(scenario, patch, np.random.default_rng(0)), []
    for pose in patch.poses(0):
        if screen.is_clear(pose):
            found += screen.look([pose])
        if len(found) == count:
            return found
    return found


def print_best(name: str, found: Placement, took_s: float) -> None:
    """The scenario's own pose and the best."""
    print(f"{name}: {found.sentence} ({took_s:.0f} s of processor time)")
    for word, pose in (("own", found.own), ("best", found.poses[0])):
        worst_mm = max((target.worst_m for target in pose.targets if target.best), default=np.nan) * 1e3
        reached = f"{pose.reached} of {len(pose.targets)} reached, {worst_mm:.2f} mm at worst"
        tilt, room = np.degrees(pose.tilt_rad), 1e3 * pose.clearance_m
        print(f"  {word:5} tilt {tilt:5.1f} deg, {reached}, clearance {room:.2f} mm")


def draw_entry(axes: Axes, name: str, worths: list[PoseScore], found: Placement) -> None:
    """Where candidates look, and what they seem to be worth; a ring around what was confirmed."""
    look = np.degrees(np.arcsin(np.array([worth.pose.direction[:2] for worth in worths])))
    tolerance_mm = max(target.goal.tolerance_m for target in found.own.targets) * 1e3
    share = np.array([worth.share * tolerance_mm if worth.possible else np.nan for worth in worths])
    draw_values(axes, name, look, share, f"{looks.HEAT}_r", "worst-case friction error (mm)")
    for pose in found.poses:
        if pose.reached:
            axes.plot(*np.degrees(np.arcsin(pose.direction[:2])), "o", mfc="none", mec=looks.INK, ms=8, mew=0.8)
    axes.plot(*np.degrees(np.arcsin(found.own.direction[:2])), "x", color=looks.LIMIT, ms=9, mew=2)


def draw_values(axes: Axes, title: str, look: Array, values: Array, colours: str, label: str = "") -> None:
    """Values (K,) of poses in colours where they look (K, 2) [deg], grey where there is none."""
    known = np.isfinite(values)
    axes.scatter(*look[~known].T, s=10, color="#d5d9de", linewidths=0)
    points = axes.scatter(*look[known].T, c=values[known], s=22, cmap=colours, linewidths=0)
    axes.figure.colorbar(points, ax=axes, label=label, shrink=0.75)
    axes.set(xlabel="looks to x (deg)", aspect="equal")
    axes.set_title(title, fontsize=10)


def entry(names: list[str], candidates: int) -> None:
    figure, (axes,) = panels(1, len(names), (4 * len(names), 4))
    for panel, name in zip(axes, names, strict=True):
        scenario, begun = ctrplan.load_scenario(SCENARIOS / f"{name}.toml"), time.process_time()
        found = ctrplan.place(scenario, candidates=candidates)
        print_best(name, found, time.process_time() - begun)
        draw_entry(panel, name, looked_at(scenario, candidates), found)
    axes[0].set_ylabel("looks to y (deg)")
    save(figure, "entry")


ENTRY_STUDY = STUDIES / "entry_ventricle.toml"
MM_PER_DEG = 2.2  # of positions drawn around the direction that they belong to


def print_poses(poses: BasePoses, tilt_deg: Array) -> None:
    print(f"{len(poses.position_mm)} poses, {poses.count[0]} targets each")
    k = poses.order[0]
    place, look = poses.position_mm[k].round(2).tolist(), poses.direction[k].round(3).tolist()
    print(f"  best at {place} along {look}: {poses.reached[k]} reached, {poses.within[k]} within tolerance,")
    print(f"  {poses.mean[k]:.2f} mm at worst in the mean")
    for tilt in sorted(set(tilt_deg.round().tolist())):
        rows = tilt_deg.round() == tilt
        reached, within = poses.reached[rows].mean(), poses.within[rows]
        shown = f"{reached:.1f} reached, {within.mean():.1f} within tolerance, at most {within.max()}"
        print(f"  {tilt:.0f} deg from the middle direction, {rows.sum()} poses: {shown}")


def draw_poses(poses: BasePoses) -> None:
    """Poses by where they look, those that look the same way laid out as they stand in the burr hole."""
    look = np.degrees(np.arcsin(poses.direction[:, :2])) + poses.position_mm[:, :2] / MM_PER_DEG
    panels = {
        "targets reached": (poses.reached.astype(float), looks.HEAT),
        "of them within 2 mm whatever friction does": (poses.within.astype(float), looks.HEAT),
        "error at worst, mean of those reached (mm)": (poses.mean, f"{looks.HEAT}_r"),
    }
    figure, (axes,) = panels(1, 3, (13, 4.2))
    for axis, (title, (values, colours)) in zip(axes, panels.items(), strict=True):
        draw_values(axis, title, look, values, colours)
        axis.plot(*look[poses.order[0]], "o", mfc="none", mec=looks.LIMIT, ms=9, mew=1.5)
    axes[0].set_ylabel("looks to y (deg)")
    save(figure, "entry_study")


def poses_of_study(folder: Path) -> None:
    study = ctrplan.Study.read(ENTRY_STUDY)
    poses = BasePoses.of(study.run(folder), "worst_mm")
    assert poses is not None and study.entry.bases is not None and study.entry.bases.patch is not None
    middle = np.array(study.entry.bases.patch.normal)
    tilt = np.degrees(np.arccos(np.clip(poses.direction @ middle / np.linalg.norm(middle), -1, 1)))
    print_poses(poses, tilt)
    draw_poses(poses)


def main() -> None:
    given = common.arguments(__doc__, ("section", ("reach", "entry", "poses")), "names*", candidates=128)
    if given.section == "entry":
        entry(common.chosen(given.names or ["ventricle", "airway", "ribs"], SHIPPED), given.candidates)
    elif len(given.names) != 1:
        sys.exit(f"{given.section} needs the folder of its study, and nothing else")
    else:
        {"reach": reach, "poses": poses_of_study}[given.section](Path(given.names[0]))
