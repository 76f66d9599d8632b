"""Draws docs/images/architecture.svg from the imports of ctrplan/, and lists the packages in docs/architecture.md.

python tools/draw_architecture.py [--image FILE.svg] [--page FILE.md]

Rows of the picture are the layers of the contract in pyproject.toml. An arrow leads from a package to one that it
imports. Arrows that follow from others are left out: where a imports b and b imports c, a may import c without one.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ctrplan"
IMAGE, PAGE = ROOT / "docs" / "images" / "architecture.svg", ROOT / "docs" / "architecture.md"
BEGIN, END = "<!-- packages -->\n", "<!-- end of packages -->\n"
INK, MUTED, EDGE, FILL = "#1F2933", "#5F6B76", "#B8C0C6", "#F4F7FA"
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
WIDTH, ROW, HEIGHT, GAP, LANE = 9.0, 1.0, 0.66, 0.12, 0.16  # of the column of boxes, in the units of the axes


@dataclass(frozen=True)
class Part:
    """A package of ctrplan, or a module beside the packages: its place, size, first sentence and imports."""

    name: str
    layer: int
    files: int
    lines: int
    sentence: str
    imports: frozenset[str]


def layers() -> list[list[str]]:
    """Names of the packages, the highest layer first, as the layers contract has them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (contract,) = (contract for contract in contracts if contract["type"] == "layers")
    return [[name.strip(" ()") for name in re.split(r"[|:]", layer)] for layer in contract["layers"]]


def parts() -> dict[str, Part]:
    """Every package of the contract by its name, the highest layer first."""
    rows = layers()
    names = {name for row in rows for name in row}
    return {name: part(name, layer, names) for layer, row in enumerate(rows) for name in row}


def part(name: str, layer: int, names: set[str]) -> Part:
    """Reads the files of one package."""
    folder = PACKAGE / name
    files = sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    texts = [file.read_text(encoding="utf-8") for file in files]
    trees = [ast.parse(text) for text in texts]
    heads = (folder / "__init__.py", folder.with_suffix(".py"))
    heading = next(
        (ast.get_docstring(tree) or "" for file, tree in zip(files, trees, strict=True) if file in heads), ""
    )
    heading = heading.split("\n\n")[0]
    sentence = " ".join(heading.split()).partition(". ")[0].rstrip(".")
    imported = {target for tree in trees for target in targets(tree)} & names - {name}
    return Part(name, layer, len(files), sum(len(text.splitlines()) for text in texts), sentence, frozenset(imported))


def targets(tree: ast.Module) -> set[str]:
    """The packages of ctrplan that a file imports, imports for types and within functions included."""
    modules = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            modules |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "ctrplan":
            modules |= {f"ctrplan.{name.name}" for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules.add(node.module)
    return {module.split(".")[1] for module in modules if module.startswith("ctrplan.")}


def arrows(by_name: dict[str, Part]) -> list[tuple[str, str]]:
    """Imports that do not follow from others, those of the lowest targets last."""
    reached: dict[str, set[str]] = {}
    for name in reversed(by_name):
        below = by_name[name].imports
        reached[name] = set(below).union(*(reached.get(target, set()) for target in below))
    kept = [
        (name, target)
        for name, entry in by_name.items()
        for target in entry.imports
        if not any(target in reached[other] for other in entry.imports - {target})
    ]
    order = list(by_name)
    return sorted(kept, key=lambda arrow: (order.index(arrow[1]), order.index(arrow[0])))


def lanes(by_name: dict[str, Part], drawn: list[tuple[str, str]]) -> dict[str, int]:
    """A lane beside the boxes for each target of an arrow that skips a layer; targets apart in height share one."""
    spans: dict[str, tuple[int, int]] = {}
    for name, target in drawn:
        top, bottom = by_name[name].layer, by_name[target].layer
        if bottom - top > 1:
            spans[target] = (min(top, spans.get(target, (top, bottom))[0]), bottom)
    chosen: dict[str, int] = {}
    for target, (top, bottom) in sorted(spans.items(), key=lambda item: item[1][1] - item[1][0]):
        taken = {lane for other, lane in chosen.items() if spans[other][0] <= bottom + 1 and spans[other][1] + 1 >= top}
        chosen[target] = next(lane for lane in range(len(spans)) if lane not in taken)
    return chosen


def box_of(entry: Part, by_name: dict[str, Part]) -> tuple[float, float, float]:
    """Left side, lower side and width of a package's box."""
    row = [other.name for other in by_name.values() if other.layer == entry.layer]
    width = (WIDTH - GAP * (len(row) - 1)) / len(row)
    return row.index(entry.name) * (width + GAP), -entry.layer * ROW, width


def draw(by_name: dict[str, Part]) -> Figure:
    """The picture."""
    drawn = arrows(by_name)
    lane_of = lanes(by_name, drawn)
    count = max(entry.layer for entry in by_name.values()) + 1
    right = WIDTH + 0.4 + LANE * (max(lane_of.values(), default=0) + 1)
    figure = Figure(figsize=(0.92 * right, 0.62 * count), facecolor="white")
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.15, right), ylim=(-ROW * (count - 1) - 0.2, HEIGHT + 0.2))
    axes.axis("off")
    for entry in by_name.values():
        draw_box(axes, entry, by_name)
    for name, target in drawn:
        colour = COLOURS[lane_of[target] % len(COLOURS)] if target in lane_of else MUTED
        skips = by_name[target].layer - by_name[name].layer > 1
        x = WIDTH + 0.3 + LANE * lane_of[target] if skips else None
        draw_arrow(axes, by_name[name], by_name[target], by_name, x, colour)
    return figure


def draw_box(axes: Axes, entry: Part, by_name: dict[str, Part]) -> None:
    """A package with its name, its size and, where there is room, its first sentence."""
    x, y, width = box_of(entry, by_name)
    style = "round,pad=0,rounding_size=0.08"
    axes.add_patch(FancyBboxPatch((x, y), width, HEIGHT, boxstyle=style, facecolor=FILL, edgecolor=EDGE, linewidth=0.8))
    size = f"{entry.files} file{'s' if entry.files > 1 else ''}, {entry.lines:,} lines"
    axes.text(x + 0.12, y + 0.42, entry.name, color=INK, fontsize=10, fontweight="bold", va="center")
    if width < WIDTH:
        axes.text(x + 0.12, y + 0.17, size, color=MUTED, fontsize=7, va="center")
        return
    axes.text(x + width - 0.12, y + 0.42, size, color=MUTED, fontsize=7.5, va="center", ha="right")
    axes.text(x + 0.12, y + 0.17, shortened(entry.sentence.replace("`", "")), color=INK, fontsize=7.5, va="center")


def draw_arrow(axes: Axes, start: Part, end: Part, by_name: dict[str, Part], lane_x: float | None, colour: str) -> None:
    """Straight down to the next layer; else to the lane of the target, down, and back to the target."""
    x0, y0, width0 = box_of(start, by_name)
    x1, y1, width1 = box_of(end, by_name)
    head = {"arrowstyle": "-|>", "color": colour, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 8}
    if lane_x is None:
        x = x1 + width1 / 2 if width1 < width0 else x0 + width0 / 2
        axes.annotate("", (x, y1 + HEIGHT), (x, y0), arrowprops=head)
        return
    apart = min(0.3 * (lane_x - WIDTH), 0.24)  # lines to different lanes do not lie on each other
    if width0 < WIDTH:  # out of the lower side, through the gap below the row
        leave = [(x0 + 0.7 * width0, y0), (x0 + 0.7 * width0, y0 + apart - 0.3), (lane_x, y0 + apart - 0.3)]
    else:
        leave = [(WIDTH, y0 + apart), (lane_x, y0 + apart)]
    if width1 < WIDTH:  # into the upper side, through the gap above the row
        enter = [(lane_x, y1 + HEIGHT + apart), (x1 + 0.3 * width1, y1 + HEIGHT + apart)]
        tip = (x1 + 0.3 * width1, y1 + HEIGHT)
    else:
        enter, tip = [(lane_x, y1 + 0.75 * HEIGHT)], (WIDTH, y1 + 0.75 * HEIGHT)
    axes.plot(*zip(*leave, *enter, strict=True), color=colour, linewidth=0.9, solid_joinstyle="round")
    axes.annotate("", tip, enter[-1], arrowprops=head)


def shortened(sentence: str, most: int = 130) -> str:
    """A sentence that fits into a box."""
    return sentence if len(sentence) <= most else sentence[:most].rsplit(" ", 1)[0].rstrip(",;:") + " ..."


def table(by_name: dict[str, Part]) -> str:
    """The packages from top to bottom, each with its first sentence."""
    rows = [f"| `{entry.name}` | {entry.sentence} |\n" for entry in by_name.values()]
    return "".join(["| package | what it is |\n", "|---|---|\n", *rows])


def main() -> None:
    assert __doc__
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--image", type=Path, default=IMAGE, help="where the picture goes")
    parser.add_argument("--page", type=Path, default=PAGE, help="the page whose table is renewed")
    options = parser.parse_args()
    by_name = parts()
    text = options.page.read_text(encoding="utf-8")
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    options.page.write_text(before + BEGIN + table(by_name) + END + after, encoding="utf-8")
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "architecture", "font.family": "sans-serif"}):
        draw(by_name).savefig(options.image, metadata={"Date": None} if options.image.suffix == ".svg" else None)


if __name__ == "__main__":
    main()
