"""scenarios/studies/entry_ventricle.toml: which pose in the burr hole reaches most; docs/images/entry_study.png.

python benchmarks/entry_study.py FOLDER             # does what is missing of 1,352 tasks, 0.2 s apiece
python benchmarks/entry_study.py FOLDER --read      # draws what is there
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import ctrplan
from ctrplan.reports import looks
from ctrplan.reports.study_page import BasePoses

ROOT = Path(__file__).resolve().parent.parent
STUDY = ROOT / "scenarios" / "studies" / "entry_ventricle.toml"
PICTURE = ROOT / "docs" / "images" / "entry_study.png"
MM_PER_DEG = 2.2  # of positions drawn around the direction that they belong to


@dataclass(frozen=True)
class Panel:
    """One number of each pose."""

    title: str
    values: NDArray[np.float64]
    colours: str = looks.HEAT


def print_poses(poses: BasePoses, tilt_deg: NDArray[np.float64]) -> None:
    print(f"{len(poses.position_mm)} poses, {poses.count[0]} targets each")
    for k in poses.order[:4]:
        place, look = poses.position_mm[k].round(2).tolist(), poses.direction[k].round(3).tolist()
        print(
            f"  at {place} along {look}: {poses.reached[k]} reached, {poses.within[k]} within tolerance, "
            f"{poses.mean[k]:.2f} mm at worst in the mean"
        )
    print(
        f"  of all poses {np.mean(poses.reached == poses.count):.0%} reach all, {np.mean(poses.reached == 0):.0%} none"
    )
    for tilt in sorted(set(tilt_deg.round().tolist())):
        rows = tilt_deg.round() == tilt
        print(
            f"  {tilt:.0f} deg from the middle direction, {rows.sum()} poses: {poses.reached[rows].mean():.1f} reached "
            f"in the mean, {poses.within[rows].mean():.1f} within tolerance, at most {poses.within[rows].max()}"
        )


def draw(poses: BasePoses) -> None:
    """Poses by where they look, those that look the same way laid out as they stand in the burr hole."""
    look = np.degrees(np.arcsin(poses.direction[:, :2])) + poses.position_mm[:, :2] / MM_PER_DEG
    panels = (
        Panel("targets reached", poses.reached.astype(float)),
        Panel("of them within 2 mm whatever friction does", poses.within.astype(float)),
        Panel("error at worst, mean of those reached (mm)", poses.mean, f"{looks.HEAT}_r"),
    )
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.2), layout="constrained")
    for axis, panel in zip(axes, panels, strict=True):
        known = np.isfinite(panel.values)
        axis.scatter(*look[~known].T, s=10, color="#d5d9de", linewidths=0)
        points = axis.scatter(*look[known].T, c=panel.values[known], s=20, cmap=panel.colours, linewidths=0)
        plt.colorbar(points, ax=axis, shrink=0.8)
        axis.plot(*look[poses.order[0]], "o", mfc="none", mec=looks.LIMIT, ms=9, mew=1.5)
        axis.set_title(panel.title, fontsize=10)
        axis.set_xlabel("looks to x (deg)")
        axis.set_aspect("equal")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("looks to y (deg)")
    figure.savefig(PICTURE, dpi=130)
    print(f"  written to {PICTURE.relative_to(ROOT)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--read", action="store_true", help="compute nothing")
    asked = parser.parse_args()
    study = ctrplan.Study.read(STUDY)
    table = ctrplan.load_study(asked.folder) if asked.read else study.run(asked.folder)
    poses = BasePoses.of(table, "worst_mm")
    assert poses is not None and study.entry.bases is not None and study.entry.bases.patch is not None
    middle = np.array(study.entry.bases.patch.normal)
    tilt = np.degrees(np.arccos(np.clip(poses.direction @ middle / np.linalg.norm(middle), -1, 1)))
    print_poses(poses, tilt)
    draw(poses)


if __name__ == "__main__":
    main()
