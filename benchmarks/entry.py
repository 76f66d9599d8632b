"""From where the shipped scenarios are best entered: `ctrplan place` beside the pose they have, docs/images/entry.png.

python benchmarks/entry.py                  # 128 candidates each, half a minute of a core apiece
python benchmarks/entry.py --candidates 256 ventricle ribs airway vessel
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import ctrplan
from ctrplan.planning.base_screen import PoseScore, Screen
from ctrplan.planning.place import CONE_RAD, RADIUS_M, Placement, _patch
from ctrplan.reports import looks

ROOT = Path(__file__).resolve().parent.parent
PICTURE = ROOT / "docs" / "images" / "entry.png"


def looked_at(scenario: ctrplan.Scenario, count: int) -> list[PoseScore]:
    """The candidates of `ctrplan place`, those too that seem to reach nothing."""
    patch = _patch(scenario, None, None, RADIUS_M, CONE_RAD)
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
        print(
            f"  {word:5} tilt {np.degrees(pose.tilt_rad):5.1f} deg, {pose.reached} of {len(pose.targets)} reached, "
            f"{worst_mm:.2f} mm at worst, clearance {pose.clearance_m * 1e3:.2f} mm"
        )


def draw(axes: Axes, name: str, worths: list[PoseScore], found: Placement) -> None:
    """Where candidates look, and what they seem to be worth; a ring around what was confirmed."""
    look = np.degrees(np.arcsin(np.array([worth.pose.direction[:2] for worth in worths])))
    tolerance_mm = max(target.goal.tolerance_m for target in found.own.targets) * 1e3
    share = np.array([worth.share * tolerance_mm if worth.possible else np.nan for worth in worths])
    axes.scatter(*look[np.isnan(share)].T, s=9, color="#d5d9de", linewidths=0)
    known = ~np.isnan(share)
    points = axes.scatter(*look[known].T, c=share[known], s=26, cmap=f"{looks.HEAT}_r", linewidths=0)
    plt.colorbar(points, ax=axes, label="worst-case friction error (mm)", shrink=0.7)
    for pose in found.poses:
        if pose.reached:
            axes.plot(*np.degrees(np.arcsin(pose.direction[:2])), "o", mfc="none", mec=looks.INK, ms=8, mew=0.8)
    axes.plot(*np.degrees(np.arcsin(found.own.direction[:2])), "x", color=looks.LIMIT, ms=9, mew=2)
    axes.set_title(name, fontsize=10)
    axes.set_xlabel("looks to x (deg)")
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=["ventricle", "airway", "ribs"])
    parser.add_argument("--candidates", type=int, default=128)
    arguments = parser.parse_args()
    figure, axes = plt.subplots(1, len(arguments.names), figsize=(4 * len(arguments.names), 4), layout="constrained")
    for panel, name in zip(np.atleast_1d(axes), arguments.names, strict=True):
        scenario, begun = ctrplan.load_scenario(ROOT / "scenarios" / f"{name}.toml"), time.process_time()
        found = ctrplan.place(scenario, candidates=arguments.candidates)
        print_best(name, found, time.process_time() - begun)
        draw(panel, name, looked_at(scenario, arguments.candidates), found)
    np.atleast_1d(axes)[0].set_ylabel("looks to y (deg)")
    figure.savefig(PICTURE, dpi=130)
    print(f"written to {PICTURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
