"""`ctrplan.verify`: a written plan under judgement, for a given time or amount of work."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ctrplan.audit.audited_plan import AuditedPlan, WorstFigure
from ctrplan.audit.counterexamples import HistoryHunt, StateHunt
from ctrplan.audit.recomputed import recomputed_differences, robots_at_ends
from ctrplan.base.arguments import EVENT, PROGRESS, SEED, Choice, Number, Whole, checked
from ctrplan.base.long_work import StageProgress, interrupt_event
from ctrplan.certificate.certificate import Difference
from ctrplan.errors import CtrplanError
from ctrplan.files.plan_file import WrittenPlan, load_plan
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.plans.plan import Plan

WORK = 100_000  # units of the hunt, about as many tenths of a millisecond on a quiet core
TIME, BUDGET = Number(0, 1e6, "s", above=True), Whole(1, 10**10)


@dataclass(frozen=True, eq=False)
class Verification:
    """What the judge found."""

    plan: WrittenPlan
    worst: tuple[WorstFigure, ...]  # of every claim, by its name
    beside: tuple[tuple[str, WorstFigure], ...]  # with a parameter at an end of its interval, not claimed
    differences: tuple[Difference, ...]  # figures that do not come out again
    refusal: str  # why the plan is not valid: its own word, or what walking the legs again says; empty if it is
    work: int  # units spent
    snaps: int  # of robots simulated on the way
    interrupted: bool = False

    @property
    def broken(self) -> tuple[WorstFigure, ...]:
        """Claims that are broken, the worst findings of each."""
        return tuple(found for found in self.worst if found.is_broken)

    @property
    def is_kept(self) -> bool:
        """Whether no claim was found broken, and every figure came out again."""
        return not (self.broken or self.differences or self.refusal)

    @property
    def counterexample(self) -> WorstFigure | None:
        """The broken claim that says most: a clearance before all else."""
        order = ("clearance", "worst bound", "bound", "stability", "strain", "predicted")
        return min(self.broken, key=lambda found: order.index(found.claim), default=None)


@checked(
    seed=SEED,
    time_s=TIME,
    work=BUDGET,
    accuracy=Choice("search", "certificate", "exact"),
    progress=PROGRESS,
    interrupted=EVENT,
)
def verify(
    plan: Plan | WrittenPlan | str | os.PathLike[str],
    scenario: str | os.PathLike[str] | None = None,
    *,
    seed: int = 0,
    time_s: float | None = None,
    work: int = WORK,
    accuracy: Accuracy = "certificate",
    progress: StageProgress | None = None,
    interrupted: threading.Event | None = None,
) -> Verification:
    """Judges a plan, or a plan.json with the trajectory.csv beside it; see `docs/planning.md`, Verification.

    Figures are computed anew and compared. Then a counter-example is hunted for: after `work` counted units the same
    seed has found the same, more work never less; with `time_s` the clock ends the hunt. `accuracy` is that of the
    mesh on which findings count. Setting `interrupted`, or Ctrl-C, ends it early. Raises InputError for files that
    `ctrplan.load_plan` refuses.
    """
    written = WrittenPlan.of(plan) if isinstance(plan, Plan) else plan
    if not isinstance(written, WrittenPlan):
        written = load_plan(written, scenario)
    told = progress or (lambda *_: None)
    with interrupt_event(interrupted) as stop:
        case = AuditedPlan.of(written, accuracy)
        differences, refusal = _recomputed(written, lambda share: told("recomputing", share))
        histories = HistoryHunt(case, seed)
        _hunt(case, StateHunt(case, seed), histories, _Budget(case, work, time_s, stop, told))
        worst = tuple(case.worst[claim] for claim in sorted(case.worst))
        beside = () if stop.is_set() else _at_interval_ends(case, worst)
        return Verification(written, worst, beside, differences, refusal, case.work, histories.snaps, stop.is_set())


def _recomputed(plan: WrittenPlan, progress: object) -> tuple[tuple[Difference, ...], str]:
    """Figures that differ, and why the plan is not valid; empty where it is."""
    if not plan.certificate["valid"]:
        return (), "the plan's own certificate says that it is not valid"
    try:
        return recomputed_differences(plan, progress), ""  # type: ignore[arg-type]
    except CtrplanError as error:
        return (), f"the legs can't be walked again: {error}"


@dataclass(eq=False)
class _Budget:
    """Work or time, whichever was given."""

    case: AuditedPlan
    work: int
    time_s: float | None
    stop: threading.Event
    told: StageProgress

    def __post_init__(self) -> None:
        self.began = time.monotonic()

    def is_spent(self) -> bool:
        share = self.case.work / self.work if self.time_s is None else (time.monotonic() - self.began) / self.time_s
        self.told("hunting", min(share, 1.0))
        return share >= 1 or self.stop.is_set()


def _hunt(case: AuditedPlan, states: StateHunt, histories: HistoryHunt, budget: _Budget) -> None:
    """Rounds of both, half of the work each; a robot of one tube has no friction states to come from."""
    spent: dict[StateHunt | HistoryHunt, int] = {states: 0, histories: 0}
    hunts: Sequence[StateHunt | HistoryHunt] = (states, histories) if case.pairs else (states,)
    case.note(case.solved(1.0, (1.0,) * case.pairs))  # something to tell, whenever the hunt is ended
    while True:
        hunt = min(hunts, key=lambda hunt: spent[hunt])
        before = case.work
        for _ in hunt.round():
            if budget.is_spent():
                return
        spent[hunt] += case.work - before
        if budget.is_spent():
            return


def _at_interval_ends(case: AuditedPlan, worst: Sequence[WorstFigure]) -> tuple[tuple[str, WorstFigure], ...]:
    """The worst of each claim where a parameter is at an end of its interval, at the places found."""
    beside: dict[str, tuple[str, WorstFigure]] = {}
    for name, robot in robots_at_ends(case.robot):
        other = replace(case, robot=robot, worst={}, work=0)
        for result in worst:
            if result.before is None:
                other.note(other.solved(result.place, result.phi, result.play))
        for claim, result in other.worst.items():
            if result.worse_than(beside.get(claim, (name, None))[1]):
                beside[claim] = name, result
    return tuple(beside.values())
