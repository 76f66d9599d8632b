"""report.html of a study: what was asked, what came out, where, and why not elsewhere."""

from __future__ import annotations

from ctrplan.base.version import __version__
from ctrplan.reports.html_page import Markup, explained, facts, page, plot, script, section, tag
from ctrplan.reports.plan_words.numbers import digits
from ctrplan.reports.study_page.maps import BASES, TARGETS, Places, map_figure, none_is_valid
from ctrplan.reports.study_page.poses import poses_table
from ctrplan.reports.study_page.quantities import Quantity, quantities
from ctrplan.reports.study_page.sensitivities import sensitivity_section
from ctrplan.reports.study_page.tables import along_axes, of_extremes, of_flags, of_numbers, of_reasons, percent
from ctrplan.reports.study_page.trade_off import trade_off_figure
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.studies.study.definition import Definition
from ctrplan.studies.study.extremes import judged_by
from ctrplan.studies.study.table import StudyTable

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


def write_study_report(study: Definition, table: StudyTable) -> None:
    """Writes it into the study's folder. Raises CtrplanError where the system refuses."""
    assert table.folder is not None
    write_atomically(table.folder / "report.html", study_report_html(study, table))


def study_report_html(study: Definition, table: StudyTable) -> str:
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


def _verdict(study: Definition, table: StudyTable) -> str:
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


def _maps(study: Definition, table: StudyTable, shown: list[Quantity], library: list[bool]) -> list[Markup]:
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


def _tables(study: Definition, table: StudyTable, judged: Quantity | None) -> list[Markup]:
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


def _provenance(study: Definition, table: StudyTable) -> Markup:
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
