"""report.html of a search for tube designs: the front, its trade-offs, and what tolerances cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrplan.base.package import __version__
from ctrplan.reports.html_page import plot, rendered
from ctrplan.reports.study_figures import trade_off_figure
from ctrplan.reports.study_tables import Quantity, of_reasons, percent
from ctrplan.reports.words import digits
from ctrplan.storage.output_folder import write_atomically
from ctrplan.studies.design.search import JOINTS
from ctrplan.studies.design.tube_design import ROBOTS, TubeDesigns

OBJECTIVES = {
    "error_mm": Quantity("error_mm", "mean error at worst", "mm"),
    "robust_mm": Quantity("robust_mm", "mean error at worst, within tolerances", "mm"),
    "reach": Quantity("reach", "share of targets reached", "", 1),
    "stability": Quantity("stability", "least stability on the way", "", 1),
    "clearance_mm": Quantity("clearance_mm", "least clearance beyond margins", "mm", 1),
}
MOST_ROWS = 30


def write_design_report(designs: TubeDesigns) -> None:
    """Writes it into the search's folder. Raises CtrplanError where the system refuses."""
    write_atomically(designs.folder / "report.html", design_report_html(designs))


def design_report_html(designs: TubeDesigns) -> str:
    """The content of report.html."""
    entries, search, objectives = designs.entries(), designs.search, designs.search.entry.objectives
    names = [*dict.fromkeys([*objectives, "within"])]
    first, *others = (OBJECTIVES[name] for name in objectives)
    trade_off = trade_off_figure(designs.table, first, others) if designs.front else None
    seconds = sum(value or 0.0 for value in designs.table.columns["seconds"])
    return rendered(
        "design.html",
        title=f"Tube design - {search.name}",
        kicker=f"Search over {len(search.space.names)} choices, {len(search.points_mm)} targets",
        search=search,
        entries=entries,
        verdict=_verdict(designs, entries),
        trade_off="" if trade_off is None else plot(trade_off, "trade-off", with_library=True),
        names=names,
        titles=[OBJECTIVES[name].label if name in OBJECTIVES else "share within tolerance" for name in names],
        shown=lambda value: digits(value) if isinstance(value, float) else str(value),
        plans=_plans(designs),
        reasons=of_reasons(designs.table),
        provenance=[
            ("Design file", search.document.file or "not from a file"),
            ("Scenario", search.entry.scenario),
            ("Sampler, seed", f"{search.entry.sampler}, {search.entry.seed}"),
            ("Processor time", f"{seconds:,.0f} s"),
            ("ctrplan", __version__),
        ],
        MOST_ROWS=MOST_ROWS,
        ROBOTS=ROBOTS,
    )


def _verdict(designs: TubeDesigns, entries: list[dict[str, Any]]) -> str:
    done, given_up, unable = designs.counts
    sentence = f"{len(designs.archive.all):,} designs were looked at, {given_up:,} of them given up early"
    sentence += f", {unable:,} can't be made or reach nothing. {len(entries)} are on the front."
    if entries:
        best = entries[0]
        first = OBJECTIVES[designs.search.entry.objectives[0]]
        sentence += f" The best by {first.name} has {digits(best[first.column])} {first.unit}".rstrip()
        sentence += (
            f", reaches {percent(best['reach'])} of the targets, {percent(best['within'])} within the tolerance "
        )
        sentence += "whatever friction does."
    return sentence


def _plans(designs: TubeDesigns) -> list[list[str]]:
    """A row for each design whose plans were made."""
    rows = designs.plans
    if rows is None:
        return []
    lines = []
    for number in sorted(set(rows.columns["design"])):
        own = rows["design"] == number
        to_joints = sum(to == JOINTS for to in rows["to"][own & rows.done])
        targets = len({*zip(*(rows[f"target_{axis}_mm"][own] for axis in "xyz"), strict=True)})
        worst_mm = rows["worst_mm"][own & rows.done] if rows.done.any() else rows["design"][:0]
        valid = int((rows["valid"][own] == 1).sum()) if rows.done.any() else 0
        shown = [digits(float(pick(worst_mm))) for pick in (np.mean, np.max)] if len(worst_mm) else ["-", "-"]
        found_of = f"{len(worst_mm)}, {to_joints} of them to the design's joints"
        lines.append([f"{number:.0f}", f"{targets}", found_of, f"{valid}", *shown])
    return lines
