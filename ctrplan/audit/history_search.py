"""The hunt over what the robot may have done before the plan: turns back and forth, small and large ones, simulated.

Small turns leave friction states that no corner has. Large ones reach other equilibria, which the way then starts from.
The robot follows the way from there; its bodies are looked at where the least clearance was found so far.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ctrplan.audit.case import Case, Finding
from ctrplan.audit.state_search import worse
from ctrplan.base.arrays import Array
from ctrplan.errors import CtrplanError, SolverError
from ctrplan.mechanics.accuracy import Accuracy
from ctrplan.mechanics.history import History
from ctrplan.mechanics.shapes import Status

GRID = 64  # places of the way where tips are looked at
STEP_RAD, STEP_M = 0.05, 0.5e-3  # of a history, for counting its work
STEP_WORK: dict[Accuracy, int] = {"search": 8, "certificate": 20, "exact": 20}
SMALL_DEG, LARGE_DEG = (1.0, 30.0), (30.0, 180.0)
MOST_TURNS = 4
KEPT = 0.5  # share of histories that are the worst one so far, changed a little


@dataclass(frozen=True, eq=False)
class Before:
    """What happened before the start: joints (H, m) driven through, and the friction state at the first."""

    joints: Array
    phi: tuple[float, ...]


class HistoryHunt:
    """Simulated histories one by one; their sequence depends on the seed and on what was found."""

    def __init__(self, case: Case, seed: int) -> None:
        """case: what is judged."""
        self.case = case
        self.rng = np.random.default_rng([seed, 2])
        ends = case.way.places_of(np.arange(len(case.plan.waypoints), dtype=np.float64))
        self.grid = np.unique(np.concatenate([np.linspace(0, 1, GRID), ends]))
        self.kept: dict[str, tuple[float, Before]] = {}
        self.starts = [(0.0,) * case.pairs, *_corners(case.pairs)]
        self.number = 0
        self.snaps = 0  # of simulated robots on the way
        self.mesh: Accuracy = "certificate" if case.accuracy == "exact" else case.accuracy

    def round(self) -> Iterator[None]:
        """One history on the coarse mesh; once more on the judge's where it is the worst of its kind."""
        before = self._drawn()
        found = self._driven(before, self._end(), "search")
        self._note(found)
        yield
        for aim in ("clearance", "bound"):
            worst = max((f for f in found if f.claim == aim), key=worse, default=None)
            if worst is not None and worse(worst) > self.kept.get(aim, (-np.inf, before))[0]:
                self.kept[aim] = worse(worst), before
                if self.mesh != "search":
                    self._note(self._driven(before, worst.place, self.mesh, looks=(worst.place,)))
                yield

    def _note(self, found: list[Finding]) -> None:
        """What counts: on the judge's mesh; predictions on the coarse one, where certificates make them."""
        self.case.note([f for f in found if f.accuracy == ("search" if f.claim == "predicted" else self.mesh)])

    def _drawn(self) -> Before:
        """The starts that certificates simulate, each second; else turns, or the worst ones with other amplitudes."""
        number, self.number = self.number, self.number + 1
        if number % 2 == 0 and number // 2 < len(self.starts):
            return Before(np.empty((0, len(self.case.way.joints[0]))), self.starts[number // 2])
        if self.kept and self.rng.random() < KEPT:
            _, worst = list(self.kept.values())[number % len(self.kept)]
            if len(worst.joints):
                turns = worst.joints - self.case.way.joints[0]
                return replace(worst, joints=self._turned(turns * self.rng.uniform(0.6, 1.5, turns.shape)))
        return Before(self._turned(self._turns(*(LARGE_DEG if number % 4 < 2 else SMALL_DEG))), self.starts[0])

    def _turns(self, low_deg: float, high_deg: float) -> Array:
        """(H, m) joint motions: some turns of amplitudes between the two, of all joints or of neighbours against each
        other.
        """
        count = int(self.rng.integers(1, MOST_TURNS + 1))
        amplitude = np.radians(np.exp(self.rng.uniform(np.log(low_deg), np.log(high_deg), (count, 1))))
        rotates = self.case.robot.drive.is_rotation
        share = self.rng.uniform(-1, 1, (count, len(rotates)))
        if self.rng.integers(2):
            relative = np.cumsum(self.rng.choice((-1.0, 1.0), (count, self.case.robot.n)), axis=1)
            share = np.linalg.lstsq(self.case.robot.drive.matrix_theta, relative.T, rcond=None)[0].T
        turns: Array = np.where(rotates, amplitude * share, 0.0)
        return turns

    def _turned(self, turns: Array) -> Array:
        """(H, m) joints that turns (H, m) away from the start reach within limits."""
        drive = self.case.robot.drive
        joints: Array = np.clip(self.case.way.joints[0] + turns, drive.lower, drive.upper)
        return joints

    def _end(self) -> float:
        """How far the way is followed: to its end, or to where little clearance was found."""
        tight = self.case.worst.get("clearance")
        if self.number <= 2 * len(self.starts) or tight is None:
            return 1.0
        return (1.0, tight.place, float(self.rng.random() ** 2))[self.number % 3]

    def _driven(self, before: Before, end: float, mesh: Accuracy, looks: tuple[float, ...] = ()) -> list[Finding]:
        """Findings along the way until `end`."""
        case = self.case
        tight = case.worst.get("clearance")
        seen = {end, *looks, *([tight.place] if tight is not None and tight.place <= end else [])}
        if case.plan.scenario.anatomy and not looks:
            seen |= {float(x) for x in self.rng.choice(self.grid, 2) if x <= end}
        places = np.unique([0.0, *self.grid[self.grid <= end], *seen])
        history = case.robot.history(before.phi, accuracy=mesh)
        try:
            self._approach(history, before, mesh)
            found = self._followed(history, before, places, seen, mesh)
        except (SolverError, CtrplanError):  # there is no equilibrium to come from, or tubes that do not nest
            return []
        return [replace(f, accuracy=mesh) for f in found]

    def _approach(self, history: History, before: Before, mesh: Accuracy) -> None:
        start = self.case.way.joints[0]
        rows = np.array([*before.joints, start])
        collars = self.case.robot.drive.collars(rows)
        history.follow(*collars)
        self._count(np.vstack([rows, rows[:1]]) if len(rows) == 1 else rows, mesh)

    def _followed(
        self, history: History, before: Before, places: Array, seen: set[float], mesh: Accuracy
    ) -> list[Finding]:
        case, begin = self.case, 0
        found: list[Finding] = []
        joints = np.array([case.way.joints_at(place) for place in places])
        theta, l = case.robot.drive.collars(joints)  # noqa: E741 (as in the equations)
        self._count(joints, mesh)
        case.work += 2 * len(places)
        free = case.robot.mechanics.tips_with_friction(theta, l, np.zeros((len(places), case.pairs)), accuracy=mesh)
        for k in [k for k, place in enumerate(places) if place in seen]:
            path = history.follow(theta[begin : k + 1], l[begin : k + 1])
            self.snaps += int(np.nan_to_num(path.snaps).sum())
            off = np.linalg.norm(path.position_m - free.position_m[begin : k + 1], axis=1)
            found += self._tips(path.position_m, off, places[begin : k + 1], before)
            if path.status[-1] == Status.FAILED:
                break
            if case.plan.scenario.anatomy:
                shape = history.advance(theta[k], l[k]).shape
                found += case.of_shape(shape, None, float(places[k]), before.phi, before=before.joints)
            begin = k + 1
        return found

    def _tips(self, tips: Array, off: Array, places: Array, before: Before) -> list[Finding]:
        """The worst against the bound, and against the certificate's own prediction where it simulated the same."""
        case, claims = self.case, ["bound", "worst bound", *([] if len(before.joints) else ["predicted"])]
        found = []
        for claim in claims:
            excess = np.array([d - case.stated(claim, p) for d, p in zip(off, places, strict=True)])
            if np.isfinite(excess).any():
                k = int(np.nanargmax(excess))
                found.append(
                    case.finding(claim, float(off[k]), float(places[k]), before.phi, tips[k], before=before.joints)
                )
        return found

    def _count(self, joints: Array, mesh: Accuracy) -> None:
        steps = np.abs(np.diff(joints, axis=0)) / np.where(self.case.robot.drive.is_rotation, STEP_RAD, STEP_M)
        self.case.work += STEP_WORK[mesh] * int(np.ceil(steps.max(axis=1, initial=0.0)).sum() + 1)


def _corners(pairs: int) -> list[tuple[float, ...]]:
    return [tuple(np.where([k >> j & 1 for j in range(pairs)], -1.0, 1.0).tolist()) for k in range(2**pairs)]
