"""report.html of a study: its question, its results, where they hold, and why not elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.base.package import __version__
from ctrplan.reports.html_page import plot, rendered, scene_script
from ctrplan.reports.study_figures import (
    BASES,
    TARGETS,
    Places,
    map_figure,
    none_is_valid,
    shown_sensitivity,
    trade_off_figure,
)
from ctrplan.reports.study_tables import (
    Quantity,
    along_axes,
    of_extremes,
    of_flags,
    of_numbers,
    of_reasons,
    percent,
    quantities,
)
from ctrplan.reports.words import digits, explained
from ctrplan.storage.output_folder import write_atomically
from ctrplan.studies.design.search import JOINTS
from ctrplan.studies.design.tube_design import ROBOTS, TubeDesigns
from ctrplan.studies.study.study_definition import StudyDefinition
from ctrplan.studies.study.table import StudyTable, judged_by

COLUMNS = (*(f"base_{axis}_mm" for axis in "xyz"), *(f"base_q{axis}" for axis in "wxyz"))
MOST_ROWS = 30  # base poses or designs that a table lists, the best first


@dataclass(frozen=True, eq=False)
class BasePoses:
    """P poses, each with its rows of the table."""

    position_mm: Array  # (P, 3)
    direction: Array  # (P, 3) of the robot's z axis
    count: NDArray[np.int_]  # (P,) tasks
    reached: NDArray[np.int_]  # of them with an answer
    within: NDArray[np.int_]  # of those within tolerance whatever friction does; 0 where the study says nothing of it
    mean: Array  # of what rows are judged by, over those with an answer; NaN where there is none

    @classmethod
    def of(cls, rows: StudyTable, column: str) -> BasePoses | None:
        """Base poses of a study with several of them, by a column of which less is better; None of another study."""
        if not all(name in rows.columns for name in (*COLUMNS, column)):
            return None
        each = np.column_stack([rows[name] for name in COLUMNS])
        poses, of_row = np.unique(each, axis=0, return_inverse=True)
        of_row = of_row.reshape(-1)
        if len(poses) < 2:
            return None

        def counted(flags: NDArray[np.bool_]) -> NDArray[np.int_]:
            return np.bincount(of_row[flags], minlength=len(poses))

        values = rows[column]
        known = rows.done & np.isfinite(values)
        total = np.bincount(of_row[known], values[known], minlength=len(poses))
        count = counted(known)
        mean = np.divide(total, count, out=np.full(len(poses), np.nan), where=count > 0)
        within = (
            rows["within_tolerance"] == 1 if "within_tolerance" in rows.columns else np.zeros(len(rows), dtype=bool)
        )
        direction = Rotation.from_quat(np.roll(poses[:, 3:], -1, axis=1)).apply([0.0, 0.0, 1.0])
        everything = np.ones(len(rows), dtype=bool)
        return cls(poses[:, :3], direction, counted(everything), counted(rows.done), counted(within), mean)

    @property
    def order(self) -> NDArray[np.int_]:
        """The best first: most with an answer, then most within tolerance, then the least mean."""
        return np.lexsort((np.nan_to_num(self.mean, nan=np.inf), -self.within, -self.reached))


def poses_rows(rows: StudyTable, judged: Quantity) -> dict[str, Any] | None:
    """The best poses of a study, with a header and how many there are; None where it has none, or one."""
    poses = BasePoses.of(rows, judged.column)
    if poses is None:
        return None
    lines = [
        [
            _vector(poses.position_mm[k], 1),
            _vector(poses.direction[k], 3),
            f"{poses.reached[k]} of {poses.count[k]}",
            f"{poses.within[k]}",
            digits(float(poses.mean[k])) if np.isfinite(poses.mean[k]) else "-",
        ]
        for k in poses.order[:MOST_ROWS].tolist()
    ]
    head = ["Position (mm)", "Looks along", "With an answer", "Within tolerance whatever friction does"]
    return {"header": [*head, f"Mean of {judged.label}"], "rows": lines, "all": len(poses.count)}


def _vector(numbers: Array, places: int) -> str:
    return " ".join(f"{x + 0.0:.{places}f}" for x in numbers.round(places).tolist())


MAPS = (
    (TARGETS, "Where: targets", "targets"),
    (BASES, "Where: base poses", "bases"),
)


def write_study_report(study: StudyDefinition, table: StudyTable) -> None:
    """Writes it into the study's folder. Raises CtrplanError where the system refuses."""
    assert table.folder is not None
    write_atomically(table.folder / "report.html", study_report_html(study, table))


def study_report_html(study: StudyDefinition, table: StudyTable) -> str:
    """The content of report.html."""
    shown = quantities(study, table)
    judged = next((quantity for quantity in shown if quantity.column == judged_by(study)), None)
    trade_off = trade_off_figure(table, judged, shown) if judged else None
    sensitive = shown_sensitivity(study, table, judged)
    library = [True]  # the first figure brings plotly.js
    seconds, workers = sum(value or 0.0 for value in table.columns["seconds"]), len(set(table.columns["worker"]))
    return rendered(
        "study.html",
        title=f"Study - {study.name}",
        kicker=f"Study of {study.count:,} tasks ({study.kind.kind})",
        study=study,
        rows=table,
        judged=judged,
        quantities=shown,
        verdict=_verdict(study, table),
        figures=_tiles(table, judged),
        maps=_maps(study, table, shown, library),
        poses=poses_rows(table, judged) if judged else None,
        along=along_axes(study, table, judged),
        extremes=of_extremes(study, table, judged) if judged else [],
        trade_off=_plot(trade_off, "trade-off", library),
        sensitive=sensitive,
        sensitivity_figure=_plot(sensitive["figure"] if sensitive else None, "sensitivity", library),
        numbers=of_numbers(table, shown),
        flags=of_flags(table, shown),
        reasons=of_reasons(table),
        processor_time=f"{seconds:,.0f} s on {workers} worker{'s' * (workers != 1)}",
        versions=", ".join(sorted(set(table.columns["version"]))),
    )


def _plot(figure: Any, name: str, library: list[bool], **options: Any) -> str:
    """Nothing where there is no figure."""
    if figure is None:
        return ""
    drawn = plot(figure, name, with_library=library[0], **options)
    library[0] = False
    return drawn


def _verdict(study: StudyDefinition, table: StudyTable) -> str:
    count, done = len(table), int(table.done.sum())
    sentence = f"{done:,} of {count:,} tasks have an answer."
    if "within_tolerance" in table.columns:
        kept = int((table["within_tolerance"] == 1).sum())
        sentence += f" In {kept:,} of them ({percent(kept / max(count, 1))} of all) the tip stays within tolerance "
        sentence += "whatever friction does."
    if none := int(none_is_valid(table).sum()):
        sentence += f" In {none:,} nothing that reaches keeps all limits and margins."
    if count < study.count:
        sentence += f" {study.count - count:,} tasks are still to be done."
    return sentence


def _tiles(table: StudyTable, judged: Quantity | None) -> list[tuple[str, str]]:
    shown = [(f"{len(table):,}", "tasks"), (percent(float(table.done.mean()) if len(table) else 0.0), "with an answer")]
    if "within_tolerance" in table.columns:
        share = float(np.nan_to_num(table["within_tolerance"]).mean())
        words = explained("within tolerance", "the tip at most the tolerance from the target, whatever friction does")
        shown.append((percent(share), words))
    if judged is not None:
        values = table[judged.column]
        values = values[np.isfinite(values)]
        for pick, word in ((np.min, "least"), (np.median, "median"), (np.max, "largest")):
            shown.append((f"{digits(float(pick(values)))} {judged.unit}".rstrip(), f"{word} {judged.name}"))
    return shown


def _maps(
    study: StudyDefinition, table: StudyTable, shown: list[Quantity], library: list[bool]
) -> list[dict[str, Any]]:
    results = []
    for where, title, name in MAPS:
        if places := Places.of(table, where):
            code = scene_script(name, f"key-{name}")
            figure = map_figure(study.scenario, table, places, shown)
            drawn = _plot(figure, name, library, script=code, kind="plot scene")
            results.append({"title": title, "name": name, "figure": drawn, "points": len(places.points_mm)})
    return results


OBJECTIVES = {
    "error_mm": Quantity("error_mm", "mean error at worst", "mm"),
    "robust_mm": Quantity("robust_mm", "mean error at worst, within tolerances", "mm"),
    "reach": Quantity("reach", "share of targets reached", "", 1),
    "stability": Quantity("stability", "least stability on the way", "", 1),
    "clearance_mm": Quantity("clearance_mm", "least clearance beyond margins", "mm", 1),
}


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
        verdict=_design_verdict(designs, entries),
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


def _design_verdict(designs: TubeDesigns, entries: list[dict[str, Any]]) -> str:
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
