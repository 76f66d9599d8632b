"""A part of the truth: effects that hold although something else remains, and what that is. docs/diagnosis.md, partial.

It begins where nothing in the catalogue leaves noise alone. What no effect explains gets a size and a memory, the
search is repeated beside it, and every effect found has to hold against every competitor, by blocks that were left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrplan.calibration.residuals import Noise
from ctrplan.diagnosis import rest
from ctrplan.diagnosis.blocks import block_split, blocks
from ctrplan.diagnosis.branches import on_one_branch
from ctrplan.diagnosis.candidates import Candidates
from ctrplan.diagnosis.chi_square import Adequacy, remains
from ctrplan.diagnosis.correlated_bench import CorrelatedBench
from ctrplan.diagnosis.held import asked
from ctrplan.diagnosis.holding import Evidence
from ctrplan.diagnosis.localise import localise
from ctrplan.diagnosis.named_beside import named_beside
from ctrplan.diagnosis.partial_search import PartialSelector, is_built
from ctrplan.diagnosis.rest import Rest
from ctrplan.diagnosis.selection import Report, Selection, Step
from ctrplan.diagnosis.shares import Part, mean_square, part_of
from ctrplan.diagnosis.usable_poses import thinned, thinning
from ctrplan.diagnosis.verdict import Judgement, Verdict
from ctrplan.diagnosis.workbench import Scored, Workbench
from ctrplan.experiment.measurements import Measurements
from ctrplan.experiment.split import Split
from ctrplan.pipeline.term import Term
from ctrplan.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Partly:
    """What was found beside a rest, on poses of the selection that stand apart."""

    bench: CorrelatedBench
    split: Split
    block: NDArray[np.int_]  # of all poses
    base: Scored  # calibrated without effects, and without a free frame
    chosen: Scored  # with those that hold
    judgement: Judgement
    parts: tuple[Part, ...]
    rest: Rest
    path: tuple[Step, ...]
    known: Candidates  # that were asked
    doubted: tuple[Evidence, ...]  # effects that were found and do not hold

    def to_json(self) -> dict[str, Any]:
        """What remains, for diagnosis.json."""
        found = self.rest
        return {
            "rms_mm": round(found.rms_m * 1e3, 4),
            **({"memory_rows" if found.memory_in_rows else "memory_s": found.memory and round(found.memory, 3)}),
            "of_configuration": round(found.of_configuration, 3),
            "of_history": round(found.of_history, 3),
            "of_time": round(found.of_time, 3),
            "where": found.place,
            "blocks": len(np.unique(self.bench.group)),
            "poses_compared": self.bench.data.count,
            "restarts": self.bench.restarts,
            "doubted": {e.term.name: e.doubts for e in self.doubted},
        }

    def evidence_json(self, t: Term) -> dict[str, Any]:
        """Why an effect holds, for diagnosis.json."""
        (part,) = (part for part in self.parts if part.evidence.term.key == t.key)
        e = part.evidence
        return {
            "share_of_gap_alone": round(part.alone.share, 3),
            "share_of_gap_last": round(part.last.share, 3),
            "alone_rms_mm": [round(x * 1e3, 4) for x in (part.alone.without_m, part.alone.with_m)],
            "last_rms_mm": [round(x * 1e3, 4) for x in (part.last.without_m, part.last.with_m)],
            "gain": round(e.gain, 2),
            "standard_error": round(e.error, 2),
            "surrogates_98": round(e.chance, 2),
            **({"odds_beside_a_smooth_error": round(e.odds, 1)} if np.isfinite(e.odds) else {}),
            "winning_blocks": round(e.winning, 3),
            "weakest_beside": {"effect": e.weakest, "z": round(e.weakest_z, 2)},
            "most_moved_by": {"effect": e.shifted_by, "standard_errors": round(e.shift, 2)},
        }

    @property
    def is_noise(self) -> bool:
        """Whether nothing but noise remains, so that the ordinary search would name all."""
        return not self.bench.noise.discrepancy or not self.bench.noise.discrepancy.is_there


def partly(
    robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise, known: Candidates, tell: Report
) -> Partly:
    """Searches, asks what holds, and describes the rest; `usable` (K,) are the poses to go by."""
    tell("looking for what holds beside a rest")
    block = blocks(data, _memory(robot, data, usable, noise))
    parts = thinned(block_split(data, usable, block), data)
    if data.is_stream:
        first = _bench(robot, data, noise, parts, block)
        certain = on_one_branch(first, first.begun())
        parts = Split(parts.selection[certain], parts.held_out_set, parts.fold[certain])
    bench = _bench(robot, data, noise, parts, block)
    base = Workbench(robot, bench.data, noise, bench.group, bench.fold).scored([])
    selector = PartialSelector(bench, known, tell)
    return concluded(selector, selector.run(), known, parts, block, base)


def _bench(robot: Robot, data: Measurements, noise: Noise, parts: Split, block: NDArray[np.int_]) -> CorrelatedBench:
    """Of the poses that choose."""
    return CorrelatedBench(robot, data.subset(parts.selection), noise, block[parts.selection], parts.fold)


def concluded(
    selector: PartialSelector,
    searched: Selection,
    known: Candidates,
    parts: Split,
    block: NDArray[np.int_],
    base: Scored,
) -> Partly:
    """What a search ended with, as far as it holds, beside the built terms that are in it.

    What remains is what the catalogue leaves: a built term explains nothing.
    """
    bench = selector.partial_bench
    is_beside = any(is_built(t) for t in searched.chosen.terms) and not bench.data.is_stream
    found = (named_beside if is_beside else asked)(selector, searched.chosen)
    chosen = found.chosen
    beside, named = _by_name(bench, chosen)
    verdict: Verdict = "partial" if found.findings else "unexplained"
    judgement = Judgement(verdict, found.findings, left_by_names(beside, named), found.compared)
    shares = tuple(part_of(bench, base, chosen, e) for e in found.found)
    return Partly(
        bench,
        parts,
        block,
        base,
        chosen,
        judgement,
        shares,
        rest_beside(beside, named, bench.plain),
        (*searched.path, *found.path),
        known,
        found.doubted,
    )


def left_by_names(bench: CorrelatedBench, chosen: Scored) -> Adequacy:
    """Whether noise alone is left without the built terms of a set, against the noise and not beside a rest."""
    beside, named = _by_name(bench, chosen)
    return remains(beside, beside.over_noise(named))


def _by_name(bench: CorrelatedBench, chosen: Scored) -> tuple[CorrelatedBench, Scored]:
    """The set without its built terms, on a bench whose discrepancy is all that these stand for."""
    names = [t for t in chosen.terms if not is_built(t)]
    if len(names) == len(chosen.terms):
        return bench, chosen
    beside = CorrelatedBench(bench.robot, bench.data, bench.plain, bench.group, bench.fold)
    return beside, beside.corrected(beside.scored(names, chosen.fit))


def _memory(robot: Robot, data: Measurements, usable: NDArray[np.bool_], noise: Noise) -> float:
    """Of the calibrated model's errors on a continuous motion, in s, or in rows where these have no times."""
    if not data.is_stream:
        return 0.0
    some = np.flatnonzero(usable)
    some = some[:: thinning(len(some))]
    alone = np.arange(len(some))
    bench = CorrelatedBench(robot, data.subset(some), noise, alone, alone)
    return bench.estimated(bench.scored([])).memory


def rest_beside(bench: CorrelatedBench, chosen: Scored, noise: Noise) -> Rest:
    """What remains beside a set of effects."""
    data, found = bench.data, bench.noise.discrepancy
    error, floor = bench.left_out_m(chosen), noise.floor_m
    size = float(np.sqrt(max(mean_square(error) - floor**2, 0.0)))
    distance = np.linalg.norm(error, axis=1)
    place = localise(data, bench.coloured(chosen.fit.residuals.r), bench.group, distance, floor, "With these effects")
    if data.is_stream:
        shares = rest.shares_of_motion(error, data, bench.group, floor)
        memory = found.memory if found else 0.0
        return Rest(size, memory, *shares, place.sentence, memory_in_rows=data.time_s is None)
    of_time = rest.share_of_time(error, data, bench.group, floor)
    shared = (found.memory if found else 0.0) * (1 - of_time)
    return Rest(size, None, shared, 1 - of_time - shared, of_time, place.sentence)
