"""report.html of a study: its question, its results, where they hold, and why not elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ctrplan.base.arrays import Array
from ctrplan.base.package import __version__
from ctrplan.reports.html_page import Markup, explained, facts, page, plot, script, section, table, tag
from ctrplan.reports.study_figures import (
    BASES,
    TARGETS,
    Places,
    map_figure,
    none_is_valid,
    sensitivity_section,
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
from ctrplan.reports.words import digits
from ctrplan.storage.output_folder import write_atomically
from ctrplan.studies.study.analysis import judged_by
from ctrplan.studies.study.study_definition import StudyDefinition
from ctrplan.studies.study.table import StudyTable

COLUMNS = (*(f"base_{axis}_mm" for axis in "xyz"), *(f"base_q{axis}" for axis in "wxyz"))
MOST_ROWS = 20


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
        """Of a study with several base poses, by a column of which less is better; None of another."""
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


def poses_table(rows: StudyTable, judged: Quantity) -> Markup | None:
    """The best poses of a study; None where it has none, or one."""
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
    shown = f"The best {len(lines)} of {len(poses.count)}." if len(lines) < len(poses.count) else ""
    return Markup(table([*head, f"Mean of {judged.label}"], lines) + tag("p", shown, kind="quiet hint"))


def _vector(numbers: Array, places: int) -> str:
    return " ".join(f"{x + 0.0:.{places}f}" for x in numbers.round(places).tolist())


MAP_SCRIPT = """
const begin = () => {
  const plot = document.getElementById('NAME');
  addKey(plot, document.getElementById('key-NAME'));
  keepFitted(plot);
};
if (document.readyState === 'loading') document.addEventListener('DOMContentLoaded', begin); else begin();
"""
MAPS = (
    (TARGETS, "Where: targets", "targets"),
    (BASES, "Where: base poses", "bases"),
)
SEVERAL = (
    "A point that stands for several tasks has their share, the worst of their outcomes, and the mean of their numbers."
)


def write_study_report(study: StudyDefinition, table: StudyTable) -> None:
    """Writes it into the study's folder. Raises CtrplanError where the system refuses."""
    assert table.folder is not None
    write_atomically(table.folder / "report.html", study_report_html(study, table))


def study_report_html(study: StudyDefinition, table: StudyTable) -> str:
    """The content of report.html."""
    shown = quantities(study, table)
    judged = next((quantity for quantity in shown if quantity.column == judged_by(study)), None)
    library = [True]  # the first figure brings plotly.js
    parts = [
        *_maps(study, table, shown, library),
        *_tables(study, table, judged),
        *_trade_off(table, judged, shown, library),
        *sensitivity_section(study, table, judged, library),
    ]
    return page(
        f"Study - {study.name}",
        tag("p", f"Study of {study.count:,} tasks ({study.kind.kind})", kind="kicker"),
        tag("h1", study.name),
        tag("p", _verdict(study, table), kind=f"verdict {'good' if table.done.any() else 'bad'}"),
        _tiles(table, judged),
        *parts,
        section("All numbers", of_numbers(table, shown), of_flags(table, shown)) if shown else "",
        _failures(table),
        section("Where this comes from", _provenance(study, table)),
    )


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


def _tiles(table: StudyTable, judged: Quantity | None) -> Markup:
    import numpy as np

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
    return tag("div", *(tag("div", tag("b", v), tag("span", n), kind="tile") for v, n in shown), kind="tiles")


def _maps(study: StudyDefinition, table: StudyTable, shown: list[Quantity], library: list[bool]) -> list[Markup]:
    found = []
    for where, title, name in MAPS:
        places = Places.of(table, where)
        if places is None:
            continue
        code = script("fit_camera.js") + script("scene_key.js") + MAP_SCRIPT.replace("NAME", name)
        figure = map_figure(study.scenario, table, places, shown)
        drawn = plot(figure, name, with_library=library[0], script=code, kind="plot scene")
        library[0] = False
        key = Markup(f'<div id="key-{name}" class="scene-key"></div>')
        hint = f"{len(places.points_mm):,} points. Choose what is shown above; drag to turn, scroll to zoom. "
        found.append(section(title, drawn, key, tag("p", hint + SEVERAL, kind="quiet hint")))
    return found


def _tables(study: StudyDefinition, table: StudyTable, judged: Quantity | None) -> list[Markup]:
    found = [section(f"By {name}", content) for name, content in along_axes(study, table, judged)]
    if judged is not None:
        if (poses := poses_table(table, judged)) is not None:
            found.insert(0, section("Base poses, the best first", poses))
        found.append(section(f"Best and worst by {judged.name}", of_extremes(study, table, judged)))
    return found


def _trade_off(table: StudyTable, judged: Quantity | None, shown: list[Quantity], library: list[bool]) -> list[Markup]:
    figure = trade_off_figure(table, judged, shown) if judged is not None else None
    if figure is None:
        return []
    drawn = plot(figure, "trade-off", with_library=library[0])
    library[0] = False
    hint = "Every point is a task; on the front, nothing else is better in one number and as good in the other."
    return [section("Trade-off", drawn, tag("p", hint, kind="quiet hint"))]


def _failures(table: StudyTable) -> Markup:
    if table.done.all():
        return Markup("")
    return section("Tasks without an answer", of_reasons(table))


def _provenance(study: StudyDefinition, table: StudyTable) -> Markup:
    main = study.entry.scenario or study.entry.robot or ""
    seconds = sum(value or 0.0 for value in table.columns["seconds"])
    workers = len(set(table.columns["worker"]))
    return facts(
        [
            ("Study", study.document.file or "not from a file"),
            ("Scenario" if study.entry.scenario else "Robot", main),
            ("SHA-256 of the robot", tag("code", study.robot.sha256)),
            ("Seed", str(study.entry.seed)),
            ("Processor time", f"{seconds:,.0f} s on {workers} worker{'s' * (workers != 1)}"),
            ("ctrplan", ", ".join(sorted(set(table.columns["version"]))) or __version__),
        ]
    )
