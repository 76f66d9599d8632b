"""Where the tip gets within 1 and 2 mm, whatever friction does and without regard to it: docs/images/reach_maps.png.

    python benchmarks/reach_maps.py FOLDER              # does what is missing of 2,000 targets each, 0.3 s apiece
    python benchmarks/reach_maps.py FOLDER --read       # draws what is there, also while the studies run

Targets are drawn at random, so that the first of them are a fair sample, too; intervals are 95 % of what a share of so
many draws may be (Wilson).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import ctrplan
from ctrplan.reports import looks

ROOT = Path(__file__).resolve().parent.parent
STUDIES, PICTURE = ROOT / "scenarios" / "studies", ROOT / "docs" / "images" / "reach_maps.png"
NAMES = ("ventricle", "airway")
REGARDS = (("free_within", "without regard to friction"), ("within", "whatever friction does"))
LEVELS = (("within 1 mm", looks.MET), ("within 2 mm", looks.SERIES[1]), ("not", "#c8ccd2"))
Z95 = 1.96


def interval(share: float, count: int) -> tuple[float, float]:
    """Wilson's, of a share of `count` draws."""
    middle = (share + Z95**2 / (2 * count)) / (1 + Z95**2 / count)
    half = Z95 / (1 + Z95**2 / count) * np.sqrt(share * (1 - share) / count + Z95**2 / (4 * count**2))
    return middle - half, middle + half


def print_shares(name: str, table: ctrplan.StudyTable) -> None:
    """A line for each distance."""
    count = len(table)
    for near in (1, 2):
        texts = []
        for column, words in REGARDS:
            share = float(np.mean(table[f"{column}_{near}_mm"] == 1))
            low, high = interval(share, count)
            texts.append(f"{100 * share:5.1f} % ({100 * low:.1f} to {100 * high:.1f}) {words}")
        print(f"  {name:10} {count:5,} targets, within {near} mm: {'; '.join(texts)}")
    lost = (table["free_within_1_mm"] == 1) & (table["within_1_mm"] != 1)
    beyond = np.isfinite(table["worst_mm"])
    z = table["target_z_mm"]
    print(
        f"  {'':10} reached without friction to 1 mm, not with it: {lost.sum():,}, of which {np.sum(lost & ~beyond):,} "
        f"collide in some friction state, {np.sum(lost & beyond):,} stay clear but miss by up to "
        f"{np.nanmax(np.where(lost, table['worst_mm'], np.nan)):.1f} mm, median "
        f"{np.nanmedian(np.where(lost, table['worst_mm'], np.nan)):.1f} mm"
    )
    for low, high in zip(
        *(np.quantile(z, shares) for shares in ((0, 0.25, 0.5, 0.75), (0.25, 0.5, 0.75, 1))), strict=True
    ):
        here = (z >= low) & (z <= high)
        shares = [100 * np.mean(table[f"{column}_1_mm"][here] == 1) for column, _ in REGARDS]
        print(f"  {'':10} z {low:6.1f} to {high:6.1f} mm: {shares[0]:5.1f} % and {shares[1]:5.1f} % within 1 mm")


def draw(axes: Axes, table: ctrplan.StudyTable, column: str, outline: NDArray[np.float64]) -> None:
    """Targets as they are seen along y, the best last, over the anatomy's own shadow."""
    axes.scatter(outline[:, 0], outline[:, 2], s=1.5, color="#eceef1", linewidths=0, rasterized=True)
    one, two = (table[f"{column}_{near}_mm"] == 1 for near in (1, 2))
    groups = ((~two, LEVELS[2]), (two & ~one, LEVELS[1]), (one, LEVELS[0]))
    for rows, (label, colour) in groups:
        axes.scatter(
            table["target_x_mm"][rows], table["target_z_mm"][rows], s=7, color=colour, label=label, linewidths=0
        )
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--read", action="store_true", help="compute nothing")
    parser.add_argument("--picture", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    figure, axes = plt.subplots(1, 4, figsize=(11, 5.6), layout="constrained")
    for k, name in enumerate(NAMES):
        study = ctrplan.Study.read(STUDIES / f"reach_{name}.toml")
        folder = arguments.folder / name
        table = ctrplan.load_study(folder) if arguments.read else study.run(folder)
        print_shares(name, table)
        assert study.scenario is not None
        outline = study.scenario.anatomy[0].shape.surface().vertices_m * 1e3
        for panel, (column, words) in zip(axes[2 * k : 2 * k + 2], REGARDS, strict=True):
            draw(panel, table, column, outline)
            panel.set_title(f"{name}\n{words}", fontsize=10)
            panel.set_xlabel("x (mm)")
    axes[0].set_ylabel("z, from the plate (mm)")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside lower center", ncols=3, frameon=False, markerscale=2)
    figure.savefig(arguments.picture, dpi=130)
    print(f"  written to {arguments.picture}")


if __name__ == "__main__":
    main()
