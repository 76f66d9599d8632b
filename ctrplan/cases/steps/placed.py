"""Step 3: the scenario with its base at a row of bases.csv becomes placed.toml."""

from __future__ import annotations

from dataclasses import replace

from ctrplan.base.units import MM_PER_M
from ctrplan.cases.bases_table import read_bases
from ctrplan.cases.work import BASES, PLACED, SCENARIO, Step, Work
from ctrplan.errors import InputError
from ctrplan.files.placed_scenario import content_at
from ctrplan.storage.atomic_write import write_atomically
from ctrplan.storage.toml_document import Document, read_document
from ctrplan.storage.toml_text import toml_text


class PlacedStep(Step):
    """The first row of the table; the plan tries the next ones where that has none."""

    name = "placed"
    files = (PLACED,)

    def made_from(self, work: Work) -> object:
        return work.state(SCENARIO, BASES)

    def make(self, work: Work, number: int = 1) -> str:
        rows = read_bases(work.file(BASES))
        if number > len(rows):
            raise InputError(f"has {len(rows)} poses", file=work.file(BASES), key="row", value=number)
        pose = rows[number - 1].pose
        content = content_at(read_document(work.file(SCENARIO)).content, pose)
        head = f"# Row {number} of {BASES}, by `ctrplan case`. Edit it, and the next run plans from here."
        write_atomically(work.file(PLACED), f"{head}\n{toml_text(content)}")
        kept = replace(
            work.scenario(SCENARIO),
            base_position_m=pose.position_m,
            base_R=pose.R,
            path=str(work.file(PLACED)),
            sha256=Document(content).sha256,
        )
        work.keep(PLACED, kept)
        position = ", ".join(f"{x:.1f}" for x in pose.position_m * MM_PER_M)
        way = ", ".join(f"{x:.3f}" for x in pose.direction)
        return f"row {number} of {BASES}: at [{position}] mm, looking along [{way}]"
