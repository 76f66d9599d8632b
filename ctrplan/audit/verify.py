"""`ctrplan.verify`: a written plan under judgement, for a given time or amount of work."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ctrplan.audit.audited_plan import AuditedPlan, WorstFigure
from ctrplan.audit.counterexamples import HistoryHunt, StateHunt
from ctrplan.audit.sweep import MotionSweep
from ctrplan.base.arguments import EVENT, PROGRESS, SEED, Choice, Number, Whole, checked
from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import Progress, StageProgress, interrupt_event, part_of
from ctrplan.base.package import shown
from ctrplan.certificate.certificate import SAME, SHARE, Certificate, Difference, Settling, joined_certificates
from ctrplan.certificate.certify import certify, either_arrives
from ctrplan.drive.drive import SAME_JOINTS
from ctrplan.drive.trajectory import PERIOD_S, remade_trajectory, too_fast
from ctrplan.errors import CtrplanError
from ctrplan.files.plan_file import WrittenPlan, check_origin, load_plan
from ctrplan.mechanics.shapes import Accuracy
from ctrplan.planning.endings import settled_again
from ctrplan.planning.goal_states import nearest_turn
from ctrplan.plans.plan import Plan, plan_to_json
from ctrplan.plans.planned_motion import Leg, ReorderReport, follow_the_leader_m, leg_kind
from ctrplan.scenario.joint_space import JointSpace
from ctrplan.scenario.prediction import predict, start_states
from ctrplan.scenario.scenario import Goal, Scenario
from ctrplan.scenario.start_branch import led_on, standing

# Of plan.json, what follows from scenario and legs; None where a hand-made plan says nothing.
KEYS = ("base", "goal", "via", "margins", "cost", "joints", "legs", "certificate", "trajectory", "follow_the_leader_m")
SETTLED = ("min_clearance_m", "goal_predicted_after_m", "duration_s")


def recomputed_differences(plan: WrittenPlan, progress: Progress | None = None) -> tuple[Difference, ...]:
    """Figures of plan.json that do not come out again. Raises CtrplanError where the legs can't be walked at all."""
    certificate = _certificate(plan, progress)
    legs = list(zip(plan.waypoints[:-1], plan.waypoints[1:], strict=True))
    drive = plan.scenario.robot.drive
    rests = [target["leg"] + 1 for target in plan.certificate["targets"]]
    stated_s = (plan.content.get("trajectory") or {}).get("duration_s")
    durations_s = [float(plan.time_s[-1]), *([float(stated_s)] if isinstance(stated_s, (int, float)) else [])]
    trajectory = remade_trajectory(plan.waypoints, drive, _period(plan), rests, durations_s)
    again = Plan(
        scenario=plan.scenario,
        seed=0,
        planner="",
        style="simultaneous",
        legs=tuple(Leg(a, b, leg_kind(drive, a, b)) for a, b in legs),
        certificate=certificate,
        trajectory=trajectory,
        reorder=ReorderReport(0, 0, 0, 0, 0, 0, 0, 0),
        clock_s=0,
        first_found_s=0,
        first_certified_s=0,
        follow_the_leader_m=follow_the_leader_m(plan.scenario.robot, trajectory),
    )
    fresh = json.loads(json.dumps(plan_to_json(again)))
    keys = [key for key in KEYS if plan.content.get(key, ...) is not None]
    results = [d for key in keys for d in _differences(key, plan.content.get(key, ...), fresh[key])]
    stated, settled = plan.content.get("settling"), fresh["settling"]
    if stated is not None and settled is not None:
        results += [d for key in SETTLED for d in _differences(f"settling.{key}", stated.get(key, ...), settled[key])]
    return (*results, *_played(plan))


def _certificate(plan: WrittenPlan, progress: Progress | None) -> Certificate:
    """The legs walked again, stage by stage."""
    if unheld := _unheld(plan):
        raise CtrplanError(f"{plan.file or plan.scenario.name}: {unheld}.")
    stages, first, start = list[Certificate](), 0, plan.scenario.start
    lasts = [target["leg"] for target in plan.certificate["targets"]]
    targets, scenario = plan.scenario.targets, standing(plan.scenario, plan.waypoints[:1])
    if len(lasts) != len(targets) or lasts != sorted(lasts) or lasts[-1] != len(plan.waypoints) - 2:
        rule = f"certificate.targets must be those of the scenario, {len(targets)}, the last one at the end of the legs"
        raise CtrplanError(f"{plan.file or plan.scenario.name}: {rule}.")
    for k, (goal, last) in enumerate(zip(targets, lasts, strict=True)):
        corners = plan.waypoints[first : last + 2]
        corners = corners[:1] if len(corners) == 2 and np.array_equal(*corners) else corners
        stage = replace(scenario, start=start, goal=nearest_turn(scenario, start, goal), via=())
        starts = stages[-1].end_states or None if stages else None
        report = part_of(progress, k, len(targets))
        stages.append(certify(stage, corners, goal_test=either_arrives, starts=starts, progress=report))
        start, first, scenario = corners[-1], last + 1, led_on(scenario, corners)
    joined = joined_certificates(stages)
    return replace(joined, settling=_settling(plan, joined))


def _unheld(plan: WrittenPlan) -> str:
    """What the figures need and no file has; empty where nothing is lacking."""
    is_lost = plan.certificate["start_friction"] == "observed" and plan.scenario.start_state is None
    rule = "predictions start from an observer's state, which no file holds: plan.recheck() where it was planned"
    return rule if is_lost else ""


def _settling(plan: WrittenPlan, certificate: Certificate) -> Settling | None:
    written = plan.content.get("settling")
    if written is None or not written["first_leg"] <= certificate.samples.leg[-1]:
        return None
    turns = np.zeros(plan.waypoints.shape[1])
    swing = Settling(written["amplitude_rad"], turns, written["first_leg"], np.inf, 0.0, 0.0)
    return settled_again(swing, certificate, 0)


def _period(plan: WrittenPlan) -> float:
    period = plan.content["trajectory"]["period_s"]
    return PERIOD_S if period is None else float(period)


def _played(plan: WrittenPlan) -> Iterator[Difference]:
    """Speeds between the trajectory's samples beyond what the drive can do."""
    for name, speed, limit in too_fast(plan.scenario.robot.drive, plan.time_s, plan.position):
        yield Difference(f"largest speed of joint {name!r} in the trajectory", limit, speed)


def _differences(figure: str, stated: Any, result: Any) -> Iterator[Difference]:
    """Where two contents of JSON differ: numbers beyond rounding, the worst of a column."""
    if isinstance(result, dict) and isinstance(stated, dict):
        for key in (*result, *(key for key in stated if key not in result)):
            yield from _differences(f"{figure}.{key}", stated.get(key, ...), result.get(key, ...))
    elif _is_numeric(result) and _is_numeric(stated):
        yield from _numbers_differ(figure, stated, result)
    elif isinstance(result, list) and isinstance(stated, list) and len(result) == len(stated):
        for k, (a, b) in enumerate(zip(stated, result, strict=True), start=1):
            yield from _differences(f"{figure}.{k}", a, b)
    elif stated != result:
        yield Difference(figure, _shown(stated), _shown(result))


def _numbers_differ(figure: str, stated: Any, result: Any) -> Iterator[Difference]:
    a, b = (np.array(value, dtype=np.float64).ravel() for value in (stated, result))
    if len(a) != len(b):
        yield Difference(f"number of {figure}", len(a), len(b))
        return
    off = ~np.isclose(a, b, rtol=SHARE, atol=SAME, equal_nan=True)
    if off.any():
        k = int(np.argmax(np.where(off, np.nan_to_num(np.abs(a - b), nan=np.inf), -1.0)))
        yield Difference(figure, float(a[k]), float(b[k]))


def _is_numeric(value: Any) -> bool:
    """A number, none, or rows of them."""
    if isinstance(value, list):
        return all(map(_is_numeric, value)) and len({len(v) if isinstance(v, list) else -1 for v in value}) <= 1
    return value is None or (isinstance(value, (int, float)) and not isinstance(value, bool))


def _shown(value: Any) -> float | str:
    """A number or a text as it is; NaN for what is neither."""
    if isinstance(value, str):
        return value
    return float(value) if isinstance(value, (int, float)) else np.nan


MESH_M, MESH_RAD = 0.1e-3, 2e-3  # by which tips may miss beyond the tolerance: what meshes differ by


def broken_promises(plan: WrittenPlan) -> tuple[str, ...]:
    """Sentences where the motion is not the one that the scenario wants: limits, and every target in its order.

    A tip arrives if the frictionless one does, or the middle of the simulated ones from the starts that the scenario
    allows.
    """
    scenario, drive = plan.scenario, plan.scenario.robot.drive
    space = JointSpace.of(scenario)
    results = []
    for name, rows in (("the legs", plan.waypoints), ("the trajectory", plan.position)):
        over = np.maximum(rows - drive.upper, drive.lower - rows).max(axis=0)
        k = int(np.argmax(over))
        if over[k] > SAME_JOINTS:
            joint = drive.joints[k]
            beyond = f"{over[k] / joint.si_per_unit:.3g} {joint.unit}"
            results.append(f"{name} take joint {joint.name!r} {beyond} beyond its limit")
        elif not np.all(space.allowed_rows(rows)):
            results.append(f"{name} break the nesting of the tubes")
    lasts = [target["leg"] for target in plan.certificate["targets"]]
    if len(lasts) != len(scenario.targets) or lasts != sorted(lasts) or lasts[-1] != len(plan.waypoints) - 2:
        return (*results, "the plan's targets are not those of the scenario, in its order")
    for goal, target in zip(scenario.targets, plan.certificate["targets"], strict=True):
        results += _missed(plan, space, goal, target)
    return tuple(results)


def _missed(plan: WrittenPlan, space: JointSpace, goal: Goal, target: Mapping[str, Any]) -> list[str]:
    """Why the end of the legs to a target of the certificate is not the goal; empty where it is."""
    scenario, robot, legs = plan.scenario, plan.scenario.robot, plan.waypoints[: target["leg"] + 2]
    name = goal.name or goal.table
    if goal.tip_m is None:
        off = np.abs(space.difference(legs[-1], legs[-1] if goal.joints is None else goal.joints))
        joint = robot.drive.joints[int(np.argmax(off))]
        if off.max() <= SAME_JOINTS:
            return []
        return [f"{name}: joint {joint.name!r} ends {off.max() / joint.si_per_unit:.3g} {joint.unit} beside the goal's"]
    free = robot.mechanics.tips_with_friction(*robot.drive.collars(legs[-1:]), np.zeros((1, robot.n - 1)))
    if _unheld(plan):  # friction from nobody knows where may have been corrected for: what it can do is allowed
        most_rad = None if goal.direction is None else (goal.direction_tolerance_rad or 0.0) + target["bound_rad"]
        goal = replace(goal, tolerance_m=goal.tolerance_m + target["bound_m"], direction_tolerance_rad=most_rad)
    misses = [_miss(scenario, goal, free.position_m[0], free.tangent[0])]
    if any(misses[0]) and not _unheld(plan):
        rows = np.concatenate([legs[:1], *(a + np.linspace(0, 1, 41)[1:, None] * (b - a) for a, b in pairwise(legs))])
        simulated = predict(robot, rows, start_states(scenario))
        tangent = simulated.tangent[:, -1].mean(axis=0)
        misses.append(_miss(scenario, goal, simulated.end_middle_m, tangent / np.linalg.norm(tangent)))
    of_each = zip(*misses, strict=True)  # by distance, by direction: each may be kept by either tip
    return [f"{name}: {sentences[0]}" for sentences in of_each if all(sentences)]


def _miss(scenario: Scenario, goal: Goal, tip_m: Array, tangent: Array) -> tuple[str, str]:
    """Sentences about the distance and the direction of a tip (3,), robot's frame; empty where they are within."""
    off_m = float(np.linalg.norm(scenario.located(tip_m[None])[0] - goal.tip_m))
    far = "" if off_m <= goal.tolerance_m + MESH_M else (
        f"the tip ends {off_m * MM_PER_M:.2f} mm from the target, tolerance {goal.tolerance_m * MM_PER_M:g} mm"
    )  # fmt: skip
    if goal.direction is None or goal.direction_tolerance_rad is None:
        return far, ""
    angle = float(np.arccos(np.clip(scenario.base_R @ tangent @ goal.direction, -1, 1)))
    most = np.degrees(goal.direction_tolerance_rad)
    turned = "" if angle <= goal.direction_tolerance_rad + MESH_RAD else (
        f"the tip ends {np.degrees(angle):.3g} deg off the goal's direction, tolerance {most:g} deg"
    )  # fmt: skip
    return far, turned


WORK = 60_000  # units of the hunt, about as many tenths of a millisecond on a quiet core
TIME, BUDGET = Number(0, 1e6, "s", above=True), Whole(1, 10**10)


@shown
@dataclass(frozen=True, eq=False)
class Verification:
    """What the judge found."""

    plan: WrittenPlan
    worst: tuple[WorstFigure, ...]  # of every claim, by its name
    beside: tuple[WorstFigure, ...]  # with parameters at the ends of their intervals, where that is not claimed
    differences: tuple[Difference, ...]  # figures that do not come out again
    refusal: str  # why the plan is not valid: its own word, or what walking the legs again says; empty if it is
    unchecked: str  # why the figures were not computed anew, which says nothing against them; empty where they were
    missed: tuple[str, ...]  # what the scenario wants and the motion does not do: goals, direction, limits, order
    work: int  # units spent
    snaps: int  # of robots simulated on the way
    interrupted: bool = False

    @property
    def broken(self) -> tuple[WorstFigure, ...]:
        """Claims that are broken, the worst findings of each."""
        return tuple(finding for finding in self.worst if finding.is_broken)

    @property
    def is_kept(self) -> bool:
        """Whether no claim was found broken, and every figure computed anew came out again."""
        return not (self.broken or self.differences or self.refusal or self.missed)

    @property
    def counterexample(self) -> WorstFigure | None:
        """The broken claim that says most: a clearance before all else."""
        order = ("clearance", "worst bound", "bound", "stability", "strain", "predicted")
        return min(self.broken, key=lambda finding: order.index(finding.claim), default=None)


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
    seed has found the same, however busy the machine, more work never less; with `time_s` the hunt goes on until that
    time is over. `accuracy` is that of the mesh on which findings count. Setting `interrupted`, or Ctrl-C, ends it
    early. Raises InputError for files that `ctrplan.load_plan` refuses.
    """
    written = WrittenPlan.of(plan) if isinstance(plan, Plan) else plan
    if not isinstance(written, WrittenPlan):
        written = load_plan(written, scenario)
    check_origin(written)
    report = progress or (lambda *_: None)
    with interrupt_event(interrupted) as stop:
        case = AuditedPlan.of(written, accuracy)
        differences, refusal = _recomputed(written, lambda share: report("recomputing", share))
        histories = HistoryHunt(case, seed)
        _hunt(case, StateHunt(case, seed), histories, _Budget(case, work, time_s, stop, report))
        if not stop.is_set():
            _solve_ends(case)
        worst, beside = (tuple(of[claim] for claim in sorted(of)) for of in (case.worst, case.beside))
        counted = case.work, histories.snaps, stop.is_set()
        missed = broken_promises(written)
        return Verification(written, worst, beside, differences, refusal, _unheld(written), missed, *counted)


def _recomputed(plan: WrittenPlan, progress: object) -> tuple[tuple[Difference, ...], str]:
    """Figures that differ, and why the plan is not valid; empty where it is."""
    if not plan.certificate["valid"]:
        return (), "the plan's own certificate says that it is not valid"
    if _unheld(plan):
        return (), ""
    try:
        return recomputed_differences(plan, progress), ""  # type: ignore[arg-type]
    except CtrplanError as error:
        return (), f"the legs can't be walked again: {error}"


@dataclass(eq=False)
class _Budget:
    """Work that is always done, and time until which the hunt goes on."""

    case: AuditedPlan
    work: int
    time_s: float | None
    stop: threading.Event
    report: StageProgress

    def __post_init__(self) -> None:
        self.began = time.monotonic()

    def is_spent(self) -> bool:
        share = self.case.work / self.work
        if self.time_s is not None:
            share = min(share, (time.monotonic() - self.began) / self.time_s)
        self.report("hunting", min(share, 1.0))
        return share >= 1 or self.stop.is_set()


def _hunt(case: AuditedPlan, states: StateHunt, histories: HistoryHunt, budget: _Budget) -> None:
    """Rounds of the sweep, of states and of histories, the same work each; a robot of one tube has no histories."""
    hunts: list[MotionSweep | StateHunt | HistoryHunt] = [states]
    if case.plan.scenario.anatomy:
        hunts.insert(0, MotionSweep(case))
    if case.pairs:
        hunts.append(histories)
    spent = dict.fromkeys(hunts, 0)
    case.note(case.solved(1.0, (1.0,) * case.pairs))  # something to tell, whenever the hunt is ended
    while spent:
        hunt = min(spent, key=lambda hunt: spent[hunt])
        before = case.work
        for _ in hunt.round():
            if budget.is_spent():
                return
        spent[hunt] += case.work - before
        if budget.is_spent():
            return
        if hunt.is_done:
            del spent[hunt]


def _solve_ends(case: AuditedPlan) -> None:
    """The worst states of each claim once more at either end of every axis of the allowed robots, one by one."""
    for worst in list(case.worst.values()):
        for axis, side in case.robots.ends if worst.before is None else ():
            axes = np.where(np.arange(case.robots.count) == axis, side, worst.axes or case.middle)
            case.note(case.solved(worst.place, worst.phi, axes))
