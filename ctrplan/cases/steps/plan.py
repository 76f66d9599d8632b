"""Step 4: a certified plan from placed.toml, in a folder with its report, its picture and the drive's trajectory."""

from __future__ import annotations

import math

from ctrplan.base.units import MM_PER_M
from ctrplan.cases.bases_table import read_bases
from ctrplan.cases.record import Record
from ctrplan.cases.steps.placed import PlacedStep
from ctrplan.cases.work import BASES, PLACED, PLAN, ROBOT, Step, Work, raw_files
from ctrplan.errors import NoAnswerError
from ctrplan.files.trajectory_file import trajectory_formats
from ctrplan.planning.plan import Plan
from ctrplan.planning.planner import plan
from ctrplan.planning.search.stage_search import Progress
from ctrplan.reports.plan_words.worst_miss import worst_miss
from ctrplan.storage.output_folder import output_folder

TRIES = 3  # base poses that are planned from


class PlanStep(Step):
    """Plans from the base pose that was chosen, and from the next ones of the table where it has no plan."""

    name = "plan"
    files = ()
    results = (f"{PLAN}/plan.json", f"{PLAN}/report.html")

    def made_from(self, work: Work) -> object:
        said = work.request.part("seed", "time_s", "bases")
        return [said, work.state(PLACED, ROBOT), raw_files(work.scenario(PLACED))]

    def make(self, work: Work) -> str:
        from ctrplan.reports.plan_folder import FORMATS, plan_outputs, save_plan  # pictures take a second to import

        output_folder(str(work.file(PLAN)), plan_outputs(trajectory_formats(FORMATS)))
        first = _row(work.record)
        made = self._planned(work)
        save_plan(made, work.file(PLAN))
        work.plan = made
        row = _row(work.record)
        return _sentence(made) if row == first else f"from row {row} of {BASES}: {_sentence(made)}"

    def _planned(self, work: Work) -> Plan:
        asked, record = work.request, work.record
        rows = 1 if record.edited("placed") else len(read_bases(work.file(BASES)))
        number = _row(record)
        last = min(rows, number - 1 + (TRIES if asked.bases is None else asked.bases))

        def report(told: Progress) -> None:
            work.progress(told.stage, told.fraction)

        while True:
            try:
                return plan(
                    work.scenario(PLACED),
                    seed=asked.seed or 0,
                    time_s=asked.time_s,
                    progress=report,
                    interrupted=work.stop,
                )
            except NoAnswerError as error:
                if number >= last or work.stop.is_set():
                    raise
                work.note(f"no plan from row {number} of {BASES}: {error}")
            number += 1
            step = PlacedStep()
            record.begin(step.name)
            sentence = step.make(work, number)
            work.end(step, sentence, number)


def _row(record: Record) -> int:
    """Of the table of bases, the one that stands in placed.toml."""
    return record.steps["placed"].chosen if "placed" in record.steps else 1


def _sentence(made: Plan) -> str:
    """Whether it is certified, where the tip ends at worst, and how near the robot comes."""
    certificate = made.certificate
    miss = worst_miss(made)
    parts = [f"{'certified' if certificate.valid else 'NOT certified'}, {len(made.legs)} legs"]
    parts += [miss.sentence.rstrip(".")] if miss else []
    if math.isfinite(certificate.min_clearance_m):
        parts.append(f"clearance {certificate.min_clearance_m * MM_PER_M:.2f} mm beyond the margins")
    return "; ".join(parts)
