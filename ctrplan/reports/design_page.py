"""report.html of a search for tube designs: the front, its trade-offs, and what tolerances cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from ctrplan.base.package import __version__
from ctrplan.reports.html_page import Markup, facts, page, plot, section, table, tag
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
PLANNED = (
    "They end at the joints that a design was judged by. Where no way there was certified, one to the tip alone was "
    "sought, which weighs its length against the error. Folders of the plans are in plans/plans, in the table's order."
)
ERROR = (
    "The error at worst is how far from its target friction may leave the tip, whatever its state: the frictionless "
    "tip's distance and the bound together, the mean over all targets. A target that is not reached counts "
)
COSTS = (
    "By how much the mean error at worst grows, to first order, where this alone comes out at the worse end of its "
    "tolerance and the robot is calibrated then: exact derivatives of the bound, tips led back to their targets."
)


def write_design_report(found: TubeDesigns) -> None:
    """Writes it into the search's folder. Raises CtrplanError where the system refuses."""
    write_atomically(found.folder / "report.html", design_report_html(found))


def design_report_html(found: TubeDesigns) -> str:
    """The content of report.html."""
    entries, search = found.entries(), found.search
    return page(
        f"Tube design - {search.name}",
        tag("p", f"Search over {len(search.space.names)} choices, {len(search.points_mm)} targets", kind="kicker"),
        tag("h1", search.name),
        tag("p", _verdict(found, entries), kind=f"verdict {'good' if entries else 'bad'}"),
        _trade_offs(found),
        section("Front", _front(found, entries)) if entries else "",
        section("What tolerances of design 1 cost", _tolerances(entries[0])) if _has_tolerances(entries) else "",
        _plans(found),
        _failures(found),
        section("Where this comes from", _provenance(found)),
    )


def _verdict(found: TubeDesigns, entries: list[dict[str, Any]]) -> str:
    done, given_up, unable = found.counts
    sentence = f"{len(found.archive.all):,} designs were looked at, {given_up:,} of them given up early"
    sentence += f", {unable:,} can't be made or reach nothing. {len(entries)} are on the front."
    if entries:
        best = entries[0]
        first = OBJECTIVES[found.search.entry.objectives[0]]
        sentence += f" The best by {first.name} has {digits(best[first.column])} {first.unit}".rstrip()
        sentence += (
            f", reaches {percent(best['reach'])} of the targets, {percent(best['within'])} within the tolerance "
        )
        sentence += "whatever friction does."
    return sentence


def _trade_offs(found: TubeDesigns) -> Markup:
    names = found.search.entry.objectives
    first, *others = (OBJECTIVES[name] for name in names)
    figure = trade_off_figure(found.table, first, others) if found.front else None
    if figure is None:
        return Markup("")
    hint = ERROR + f"{found.search.entry.unreached_mm:g} mm. Fronts are those of two objectives at a time."
    return section("Trade-off", plot(figure, "trade-off", with_library=True), tag("p", hint, kind="quiet hint"))


def _front(found: TubeDesigns, entries: list[dict[str, Any]]) -> Markup:
    search = found.search
    names = [*dict.fromkeys([*search.entry.objectives, "within"])]
    titles = [OBJECTIVES[name].label if name in OBJECTIVES else "share within tolerance" for name in names]
    rows = []
    for entry in entries[:MOST_ROWS]:
        choices = [_shown(entry["choices"][name]) for name in search.space.names]
        place = f"{ROBOTS}/{entry['number']:02d}.toml"
        link = Markup(f'<a href="{place}">{entry["number"]}</a>')
        rows.append([link, *(_shown(entry[name]) for name in names), *choices])
    more = f" The other {len(entries) - MOST_ROWS} are in front.json." if len(entries) > MOST_ROWS else ""
    hint = f"Nothing is better than these in every objective. Numbers lead to their robot files.{more}"
    return Markup(table(["", *titles, *search.space.labels], rows) + tag("p", hint, kind="quiet hint"))


def _has_tolerances(entries: list[dict[str, Any]]) -> bool:
    return bool(entries) and bool(entries[0]["tolerances"])


def _tolerances(entry: dict[str, Any]) -> Markup:
    rows = [
        [row["name"], f"{row['half_width']:.3g} {row['unit']}".rstrip(), f"{row['costs_mm']:.3f}"]
        for row in entry["tolerances"]
    ]
    total = sum(row["costs_mm"] for row in entry["tolerances"])
    sentence = f"All together {total:.3f} mm; solved at that corner the error is {entry['robust_mm']:.3f} mm, "
    sentence += f"{entry['error_mm']:.3f} mm as designed."
    head = ["Of", "To either side", "Costs (mm)"]
    return Markup(table(head, rows) + tag("p", sentence) + tag("p", COSTS, kind="quiet hint"))


def _plans(found: TubeDesigns) -> Markup:
    rows = found.plans
    if rows is None:
        return Markup("")
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
    head = ["Design", "Targets", "Plans found", "With a valid certificate", "Error at worst, mean (mm)", "Largest (mm)"]
    return section(
        "Plans from the start to every target", Markup(table(head, lines) + tag("p", PLANNED, kind="quiet hint"))
    )


def _failures(found: TubeDesigns) -> Markup:
    rows = found.table
    if rows.done.all():
        return Markup("")
    return section("Designs without an answer", of_reasons(rows))


def _provenance(found: TubeDesigns) -> Markup:
    search = found.search
    seconds = sum(value or 0.0 for value in found.table.columns["seconds"])
    return facts(
        [
            ("Design file", search.document.file or "not from a file"),
            ("Scenario", search.entry.scenario),
            ("Sampler, seed", f"{search.entry.sampler}, {search.entry.seed}"),
            ("Processor time", f"{seconds:,.0f} s"),
            ("ctrplan", __version__),
        ]
    )


def _shown(value: Any) -> str:
    return digits(value) if isinstance(value, float) else str(value)
