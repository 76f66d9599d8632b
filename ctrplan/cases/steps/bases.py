"""Step 2: base poses around the entries, ranked, become bases.csv."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ctrplan.base.arrays import Array
from ctrplan.base.directions import shortest_rotation
from ctrplan.base.units import MM_PER_M
from ctrplan.cases.bases_table import bases_text
from ctrplan.cases.request import patch_radius_m
from ctrplan.cases.steps.scenario import ENTRY_COLUMNS
from ctrplan.cases.work import BASES, ENTRIES, ROBOT, SCENARIO, Step, Work, raw_files
from ctrplan.errors import InputError, NoAnswerError
from ctrplan.planning.placing.base_pose import BasePose
from ctrplan.planning.placing.place import Placement, place
from ctrplan.planning.scenario import Scenario
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.csv_table import CsvTable

CONE_DEG, CANDIDATES = 20.0, 128


class BasesStep(Step):
    """`ctrplan.place` from each entry."""

    name = "bases"
    files = (BASES,)

    def made_from(self, work: Work) -> object:
        said = work.request.part("radius_mm", "cone_deg", "candidates", "seed")
        return [said, work.state(SCENARIO, ROBOT, ENTRIES), raw_files(work.scenario(SCENARIO))]

    def make(self, work: Work) -> str:
        found, reasons, tried = list[BasePose](), list[str](), 0
        for scenario in self._entries(work):
            try:
                placement = self._placed(work, scenario)
                tried += placement.drawn
                found += [pose for pose in placement.poses if pose.reached]
                reasons += [] if placement.poses[0].reached else [placement.sentence.rstrip(".")]
            except NoAnswerError as error:
                reasons.append(str(error).partition(": ")[2].rstrip(".") or str(error))
        if not found:
            place_mm = ", ".join(f"{x:.4g}" for x in work.scenario(SCENARIO).base_position_m * MM_PER_M)
            rule = f"nothing is reached from the entry [{place_mm}] mm: {reasons[0]}"
            raise NoAnswerError(f"{work.file(SCENARIO)}: {rule}. Another entry, --cone-deg or --radius-mm may help.")
        ranked = sorted(found, key=lambda pose: pose.rank)
        write_atomically(work.file(BASES), bases_text(ranked))
        best = ranked[0]
        error_mm = max(target.worst_m for target in best.targets if target.best) * MM_PER_M
        reached = f"{best.reached} of {len(best.targets)} targets"
        return f"{len(ranked)} poses of {tried} tried; the best reaches {reached}, {error_mm:.2f} mm off at worst"

    def _placed(self, work: Work, scenario: Scenario) -> Placement:
        asked = work.request
        placement = place(
            scenario,
            aim_m=scenario.base_position_m + scenario.base_R[:, 2] * _away(scenario),
            radius_m=patch_radius_m(asked),
            cone_rad=math.radians(CONE_DEG if asked.cone_deg is None else asked.cone_deg),
            candidates=asked.candidates or CANDIDATES,
            seed=asked.seed or 0,
            progress=work.progress,
            interrupted=work.stop,
        )
        if work.stop.is_set():
            raise KeyboardInterrupt
        return placement

    def _entries(self, work: Work) -> list[Scenario]:
        """The scenario with its robot at each entry."""
        own = work.scenario(SCENARIO)
        file = work.file(ENTRIES)
        lines = file.read_text().strip().splitlines() if file.exists() else []
        if len(lines) < 2:
            return [own]
        table = CsvTable(str(file), "table of entries")
        for name in ENTRY_COLUMNS.split(","):
            if name not in table.header:
                raise table.fault("is missing in the header", column=name)
        rows = np.column_stack([table.numbers(name) for name in ENTRY_COLUMNS.split(",")]) / MM_PER_M
        return [own, *(_standing(own, row, table, k) for k, row in enumerate(rows))]


def _standing(scenario: Scenario, row: Array, table: CsvTable, k: int) -> Scenario:
    if not np.any(row[3:] - row[:3]) or not np.abs(row).max() < 10:
        raise table.fault("must be two places near each other", k)
    turned = shortest_rotation(row[3:] - row[:3])
    return replace(scenario, base_position_m=row[:3], base_R=turned, sha256="")


def _away(scenario: Scenario) -> float:
    """How far the targets are [m], at least a mm."""
    tips = [goal.tip_m for goal in scenario.targets if goal.tip_m is not None]
    if not tips:
        raise InputError("says nothing of a place: a tip is needed", file=scenario.path, key="goal")
    return max(1e-3, float(np.linalg.norm(np.mean(tips, axis=0) - scenario.base_position_m)))
