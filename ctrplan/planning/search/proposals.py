"""What a roadmap is offered: states and ways that are likelier free than random ones.

The body of a robot at its goal lies in free space. Bringing the tip back along that body, from goal to plate, by small
steps of inverse kinematics gives configurations that stay near it; driven the other way they are an insertion that
follows its own leader as well as the drive can. A roadmap joins these chains of all goals, the start's among them, by
L-shaped motions, and its cheapest path is found by checking only the motions that matter.

Where there is room, few motions do: a turn that points the robot, an insertion in two legs, and a turn to the goal. Of
random ways like that most are refused by one or two of their zero-clearance shapes.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import ROOM_NS
from ctrplan.motion.checker import MotionChecker
from ctrplan.planning.room import LEAST_HOPE, expected_share
from ctrplan.scenario.tip_solver import GoalState, TipSolver, TipTarget

STATION_MM = 6.0  # along the body between neighbours of a chain
LOST_M = 3e-3  # a tip that can't be brought back any nearer ends its chain
SKIPS = (1, 2, 4, 8)  # stations along a chain that a motion may go
NEIGHBOURS = 4  # in other chains, to either side
MOST_GOALS = 12
FAR_SHARE = 0.6  # of the stations that some chain must reach
NEAR_MM = 30.0  # of joint length: how far beside others random states are looked for, and how much dearer ways are
TIP_STEPS, NEAR_TIP_M = 4, 4e-3  # by which their tips are brought back, and how near they must come


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Configurations (N, m), the start first, and motions that may join them."""

    joints: Array
    edges: NDArray[np.int_]  # (E, 2) from, to
    goals: NDArray[np.int_]  # nodes that are goal states


@dataclass(frozen=True, eq=False)
class TurnedInsertion:
    """A way from the start that turns, is inserted in two legs, and turns to a goal."""

    states: Array  # (2, m) in the midst of the insertion and at its end
    goal: int  # its number
    joints: Array  # (S, m) on the way
    room_m: Array  # (S,) [m] that zero-clearance shapes leave there beyond what is required


def direct_roadmap(checker: MotionChecker, goals: list[GoalState]) -> Roadmap:
    """Start and goals alone."""
    nodes = np.arange(1, 1 + len(goals))
    joints = np.vstack([checker.scenario.start, *(goal.joints for goal in goals)])
    return Roadmap(joints, np.stack([np.zeros_like(nodes), nodes], axis=1), nodes)


def retreat_roadmap(checker: MotionChecker, goals: list[GoalState]) -> Roadmap:
    """Chains from the goals back to the plate, joined to each other and to the start.

    Of many goals, those that would cost least if the way there were free, and as many whose chains are likeliest free.
    Start and goals alone where the drive can't withdraw the robot far along its body.
    """
    start = checker.scenario.start
    chains, stations = _chains(checker, np.array([*(goal.joints for goal in goals), start]))
    chosen = _chosen(checker, goals, chains, stations)
    ends = [goals[k] for k in chosen]
    chains, stations = [chains[k] for k in [*chosen, -1]], [stations[k] for k in [*chosen, -1]]
    if all(len(chain) < FAR_SHARE * count for chain, count in zip(chains[:-1], stations[:-1], strict=True)):
        return direct_roadmap(checker, goals)
    joints, owner, station = [start], [-1], [0]
    for k, chain in enumerate(chains):
        for place, q in enumerate(chain):
            if k == len(ends) and place == 0:
                continue  # the start itself
            joints.append(q)
            owner.append(k)
            station.append(place)
    q = np.array(joints)
    goal_nodes = [
        i for i, (k, place) in enumerate(zip(owner, station, strict=True)) if place == 0 and 0 <= k < len(ends)
    ]
    return Roadmap(
        q, _edges(checker, q, np.array(owner), np.array(station), len(ends)), np.array(goal_nodes, dtype=int)
    )


def _chosen(
    checker: MotionChecker, goals: list[GoalState], chains: list[list[Array]], stations: list[int]
) -> list[int]:
    """Numbers of at most MOST_GOALS goals: half the cheapest if the way were free, half with least of a chain lost."""
    weights, space = checker.scenario.cost, checker.space
    way_mm = space.lengths_mm(space.difference(checker.scenario.start, np.array([goal.joints for goal in goals])))
    cost = weights.path * way_mm + weights.error_goal * MM_PER_M * np.array([goal.bound_m for goal in goals])
    open_stations = [expected_share(checker.rooms([q[None] for q in chain])).sum() for chain in chains[: len(goals)]]
    blocked = np.array(stations[: len(goals)]) - open_stations
    cheap, others = np.split(np.argsort(cost), [MOST_GOALS // 2])
    return [*cheap.tolist(), *others[np.argsort(blocked[others])][: MOST_GOALS // 2].tolist()]


def _chains(checker: MotionChecker, ends: Array) -> tuple[list[list[Array]], list[int]]:
    """For each configuration (G, m): itself, then those with its tip ever further back; and its number of stations."""
    solver = TipSolver(checker.space, checker.mechanics, checker.watch)
    bodies = [_body(checker, q) for q in ends]
    chains = [[q] for q in ends]
    active = list(range(len(ends)))
    for place in range(1, 1 + max(len(body) for body in bodies)):
        active = [k for k in active if place < len(bodies[k])]
        if not active:
            break
        aim = np.array([bodies[k][place] for k in active])
        result = solver.solve(TipTarget(aim), np.array([chains[k][-1] for k in active]), turned=False)
        lost = result.error_m > LOST_M
        for k, q in zip(np.array(active)[~lost].tolist(), result.joints[~lost], strict=True):
            chains[k].append(q)
        active = np.array(active)[~lost].tolist()
    return chains, [len(body) for body in bodies]


def _body(checker: MotionChecker, q: Array) -> Array:
    """(S, 3) points of the zero-clearance centreline from the tip back to the plate, evenly spaced."""
    shape = checker.mechanics.zero_clearance(*checker.space.drive.collars(q), loads=False)
    s = np.arange(shape.s_m[-1], 0.0, -STATION_MM / MM_PER_M)
    return np.stack([np.interp(s, shape.s_m, axis) for axis in shape.centreline_m.T], axis=1)


def _edges(
    checker: MotionChecker, q: Array, owner: NDArray[np.int_], station: NDArray[np.int_], starts_chain: int
) -> NDArray[np.int_]:
    """Forward along each goal's chain, backward along the start's, to near neighbours in others, and from the start."""
    result = {(0, i) for i in range(1, len(q))}
    for i in range(1, len(q)):
        same = np.flatnonzero((owner == owner[i]) & np.isin(np.abs(station - station[i]), SKIPS))
        back = owner[i] == starts_chain
        result |= {(i, int(j)) for j in same if (station[j] > station[i] if back else station[j] < station[i])}
        others = np.flatnonzero((owner != owner[i]) & (owner != starts_chain) & (owner >= 0))
        apart = np.linalg.norm(checker.space.difference(q[i], q[others]) * checker.space.weights_mm, axis=1)
        result |= {(i, int(j)) for j in others[np.argsort(apart)[:NEIGHBOURS]]}
    return np.array(sorted(result), dtype=int).reshape(-1, 2)


def turned_insertions(
    checker: MotionChecker, goals: Array, left_mm: Array, rng: np.random.Generator, count: int, most_mm: float
) -> list[TurnedInsertion]:
    """Those of `count` random ways whose zero-clearance shapes are free of the anatomy, the cheapest first.

    They end at goals (G, m), where the error left costs left_mm (G,). A way that costs more than most_mm by its length,
    stops and error left is left out.
    """
    space, start, is_rotation = checker.space, checker.scenario.start, checker.space.drive.is_rotation
    if checker.field is None or is_rotation.all() or not is_rotation.any():
        return []  # nothing tells which of them are likely free, or there is nothing to turn or to insert
    delta = space.difference(start, goals)
    straight_mm = least_cost_mm(checker, delta) + left_mm
    chance = np.exp((straight_mm.min() - straight_mm) / NEAR_MM)
    goal = rng.choice(len(goals), size=count, p=chance / chance.sum())
    turn = np.zeros((count, is_rotation.size))
    turn[:, is_rotation] = _detours(rng, (delta * space.weights_mm)[goal][:, is_rotation])
    inserted = np.where(is_rotation, start + turn / space.weights_mm, goals[goal])
    inserted = space.wound_into_limits(inserted)
    amid = np.where(is_rotation, inserted, start + rng.uniform(size=inserted.shape) * (inserted - start))
    onward = space.difference(inserted, goals[goal])
    legs = space.difference(start, amid), amid - inserted, onward
    least_mm = np.sum([least_cost_mm(checker, leg) for leg in legs], axis=0) + left_mm[goal]
    is_hopeful = space.allowed_rows(amid) & space.allowed_rows(inserted) & (least_mm < most_mm)
    rows = np.flatnonzero(is_hopeful)[np.argsort(least_mm[is_hopeful])].tolist()
    begun = [space.corners(start, amid[row], checker.style) for row in rows]  # with the start's own winding
    ends = (np.cumsum([inserted[row] - amid[row], onward[row]], axis=0) for row in rows)
    ways = [np.vstack([way, way[-1] + end]) for way, end in zip(begun, ends, strict=True)]
    places = [checker.stations(way) for way in ways]
    return [
        TurnedInsertion(np.stack([amid[row], inserted[row]]), int(goal[row]), joints, room_m)
        for row, joints, room_m in zip(rows, places, _rooms(checker, places), strict=True)
        if room_m.min() >= 0
    ]


def likely_insertions(
    ways: list[TurnedInsertion],
    share_valid: Callable[[Array, Array], Array],
    is_valid: Callable[[Array, float], bool],
    enough: float | None = None,
) -> list[TurnedInsertion]:
    """Those whose places are all likelier valid than not, the likeliest first: where that is in doubt, it is solved.

    share_valid: the probability (S,) that each of the places (S, m) with such rooms (S,) [m] is valid, by all that was
    solved so far; is_valid: solves one of them. Where a doubt is enough, solving ends with the first way of which no
    place is in more doubt than that; others join it that are likely by then.
    """
    solved = [np.zeros(len(way.room_m), dtype=bool) for way in ways]

    def doubt(k: int) -> tuple[float, int, int]:
        share = np.where(solved[k], 1.0, share_valid(ways[k].joints, ways[k].room_m))
        return 1 - float(share.min()), k, int(np.argmin(share))

    result, queue = list[int](), sorted(map(doubt, range(len(ways))))
    while queue and not (result and enough):
        most = doubt(heapq.heappop(queue)[1])  # by all that was solved since
        if queue and most > queue[0]:
            heapq.heappush(queue, most)
            continue
        doubtful, k, place = most
        if doubtful < (enough or 1 / 2):
            result.append(k)
            continue
        if doubtful > 1 - LEAST_HOPE:
            break
        solved[k][place] = is_valid(ways[k].joints[place], float(ways[k].room_m[place]))
        if solved[k][place]:
            heapq.heappush(queue, doubt(k))
    others = sorted(doubt(k) for _, k, _ in queue) if result and enough else ()
    return [ways[k] for k in [*result, *(k for doubtful, k, _ in others if doubtful < 1 / 2)]]


def least_cost_mm(checker: MotionChecker, delta: Array) -> Array:
    """(K,) [mm] what length and stops of L-shaped motions by delta (K, m) cost."""
    weights, space = checker.scenario.cost, checker.space
    least_mm: Array = weights.path * space.lengths_mm(delta) + weights.stop * space.legs(delta)
    return least_mm


def states_beside(checker: MotionChecker, q: Array, rng: np.random.Generator) -> Array:
    """Other configurations with the tips of q (K, m), about NEAR_MM away."""
    space = checker.space
    solver = TipSolver(space, checker.mechanics, checker.watch)
    near = space.wound_into_limits(q + rng.normal(size=q.shape) * NEAR_MM / space.weights_mm)
    allowed = space.allowed_rows(near)
    result = solver.solve(TipTarget(solver.tips(q[allowed])[0]), near[allowed], TIP_STEPS, turned=False)
    checker.meter.add(ROOM_NS * TIP_STEPS * len(near))
    return result.joints[result.error_m < NEAR_TIP_M]


def _detours(rng: np.random.Generator, way: Array) -> Array:
    """(N, r) random places beside straight ways (N, r), each uniform in an ellipsoid about its way.

    To a place and on to the way's end is longer than the way by no more than a random length, NEAR_MM on average.
    """
    length = np.linalg.norm(way, axis=1, keepdims=True)
    whole = length + rng.exponential(NEAR_MM, size=length.shape)
    axis = way / np.maximum(length, 1e-9)
    place = rng.normal(size=way.shape)
    place *= rng.uniform(size=length.shape) ** (1 / way.shape[1]) / np.linalg.norm(place, axis=1, keepdims=True)
    along = np.sum(place * axis, axis=1, keepdims=True)
    wide = np.sqrt(whole**2 - length**2)
    detours: Array = (way + along * axis * whole + (place - along * axis) * wide) / 2
    return detours


def _rooms(checker: MotionChecker, ways: list[Array]) -> list[Array]:
    """Rooms (S,) [m] of zero-clearance shapes on each way (S, m); -inf without a stable solution.

    They are looked at by halves of the ways, each time of those alone that are free so far; NaN where none is needed.
    """
    rooms = [np.full(len(way), np.nan) for way in ways]
    going, parts = list(range(len(ways))), 1
    while going:
        parts *= 2
        todo = [np.unique(np.linspace(0, len(ways[k]) - 1, parts + 1).round().astype(int)) for k in going]
        todo = [at[np.isnan(rooms[k][at])] for k, at in zip(going, todo, strict=True)]
        room_m = checker.state_rooms(np.concatenate([ways[k][at] for k, at in zip(going, todo, strict=True)]))
        for k, at, of_way in zip(going, todo, np.split(room_m, np.cumsum([len(at) for at in todo])[:-1]), strict=True):
            rooms[k][at] = of_way
        going = [k for k in going if not np.nanmin(rooms[k]) < 0 and np.isnan(rooms[k]).any()]
    return rooms
