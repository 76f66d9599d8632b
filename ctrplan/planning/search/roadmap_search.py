"""A roadmap that grows: the cheapest path of it, checking only motions that may lie on it; or, sooner, some good path.

Zero-clearance shapes, some thirty times cheaper than a bound, tell which states and motions are worth a check.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ctrplan.base.arrays import MM_PER_M, Array
from ctrplan.base.long_work import EDGE_NS, counted_aside
from ctrplan.motion.checker import DEFINITE_COLLISION_M, MotionChecker
from ctrplan.planning.goal_states import Trail
from ctrplan.planning.room import LEAST_HOPE, ClearanceSurrogate
from ctrplan.planning.search import proposals
from ctrplan.planning.search.proposals import SKIPS, Roadmap, least_cost_mm
from ctrplan.scenario.tip_solver import GoalState

AT_ONCE = 2  # motions checked in parallel; the same everywhere, as it decides what is checked
SURE = 0.3  # of its length is what a motion counts that is known to be valid, while any path will do
GUESSES = 3  # paths looked at for a motion to check ahead
NEIGHBOURS = 8
AT_MM = 1e-6  # of joint length, within which a place is at a motion's end
TRIES = 4  # random states looked at for each that is added
VALID_JUMPS = 0.05  # of motions along which the zero-clearance tip jumps
WALK_PER_STATE = 30  # solves of a motion's walk for one of a state: with less doubt than that it is walked at once

Result = TypeVar("Result")


class KnownPath(NamedTuple):
    """A path whose motions were all checked."""

    states: Array  # (K, m)
    cost_mm: float


class RoadmapSearch:
    """Checks motions of a roadmap when they are needed, and remembers what they cost."""

    def __init__(self, checker: MotionChecker, roadmap: Roadmap, goals: list[GoalState]) -> None:
        """goals: those of the roadmap, in its order, with their bounds."""
        self.checker, self.goals = checker, roadmap.goals
        self.left_m = dict(zip(roadmap.goals.tolist(), (goal.bound_m for goal in goals), strict=True))
        self.joints: Array = np.empty((0, len(checker.space.weights_mm)))
        self.edges: NDArray[np.int_] = np.empty((0, 2), dtype=int)
        self.length: Array = np.empty(0)
        self.cost: Array = np.empty(0)  # at least; what it is where known
        self.left: Array = np.empty(0)  # cost of the error left if the path ends with that motion; inf but at goals
        self.least: Array = np.empty(0)  # length and stops alone
        self.least_left: Array = np.empty(0)  # bound at the goal alone
        self.clearance = ClearanceSurrogate(checker.space)
        self.place: NDArray[np.int_] = np.empty(0, dtype=int)  # of states there
        self.narrowest: NDArray[np.int_] = np.empty(0, dtype=int)  # place of a motion; its end before a look
        self.jumps: NDArray[np.bool_] = np.empty(0, dtype=bool)  # the zero-clearance tip along it
        self.hope: Array = np.empty(0)  # probability that a motion is valid
        self.needed_m = 0.0  # room around corner shapes that certificates turned out to need
        self.solved_m: Array = np.empty(0)  # the room that motions known to be valid leave around their corner shapes
        self.seen: NDArray[np.bool_] = np.empty(0, dtype=bool)  # the zero-clearance shapes along them
        self.known: NDArray[np.bool_] = np.empty(0, dtype=bool)
        self.queried: NDArray[np.bool_] = np.empty(0, dtype=bool)  # where it is narrowest
        self.probed: NDArray[np.bool_] = np.empty(0, dtype=bool)
        self.refused: NDArray[np.int_] = np.empty(0, dtype=int)  # states that are not valid
        self.row: dict[tuple[int, int], int] = {}
        self._threads = ThreadPoolExecutor(AT_ONCE)  # which end with this search
        self.extend(roadmap.joints, roadmap.edges)
        self._learn(self.place)  # of start and goals, which are solved

    def extend(self, joints: Array, edges: NDArray[np.int_]) -> None:
        """Adds states (N, m), counted on from the last one, and motions (E, 2) that there were not."""
        weights, space = self.checker.scenario.cost, self.checker.space
        room_m = self.checker.rooms([q[None] for q in joints])  # first: a search that ends here has nothing half added
        self.joints = np.concatenate([self.joints, joints])
        self.probed = np.concatenate([self.probed, np.zeros(len(joints), dtype=bool)])
        self.place = np.append(self.place, self.clearance.extend(joints, room_m))
        a, b = edges.T
        delta = space.difference(self.joints[a], self.joints[b])
        length = space.lengths_mm(delta)
        least = least_cost_mm(self.checker, delta) + 1e-6
        left_m = np.array([self.left_m.get(int(node), np.inf) for node in b])
        left = np.where(np.isfinite(left_m), weights.error_goal * np.nan_to_num(left_m, posinf=0.0) * MM_PER_M, np.inf)
        self.row |= {(int(i), int(j)): k for k, (i, j) in enumerate(edges, len(self.edges))}
        self.edges, self.length = np.concatenate([self.edges, edges]), np.concatenate([self.length, length])
        self.cost, self.left = np.concatenate([self.cost, least]), np.concatenate([self.left, left])
        self.least, self.least_left = np.concatenate([self.least, least]), np.concatenate([self.least_left, left])
        self.known = np.concatenate([self.known, np.zeros(len(edges), dtype=bool)])
        self.queried = np.concatenate([self.queried, np.zeros(len(edges), dtype=bool)])
        self.seen = np.concatenate([self.seen, np.zeros(len(edges), dtype=bool)])
        self.solved_m = np.concatenate([self.solved_m, np.full(len(edges), np.nan)])
        self.narrowest = np.concatenate([self.narrowest, self.place[b]])
        self.jumps = np.concatenate([self.jumps, np.zeros(len(edges), dtype=bool)])
        self._weigh()

    def _weigh(self) -> None:
        """Puts the hopes of motions to what is known of clearances now."""
        share = np.maximum(self.clearance.share_valid(), LEAST_HOPE)
        ends = share[self.place[self.edges]].min(axis=1, initial=1.0)
        self.hope = np.minimum(np.minimum(ends, share[self.narrowest]), np.where(self.jumps, VALID_JUMPS, 1.0))

    def _learn(self, places: NDArray[np.int_]) -> None:
        """Takes in what solved places leave."""
        self.checker.meter.add(EDGE_NS * len(self.clearance.room_m) * len(places))
        for place in places.tolist():
            self.clearance.learn(place, self.checker.solved_room_m(self.clearance.joints[place]))
        self._weigh()

    def grow(self, rng: np.random.Generator, count: int, insertions: int = 0) -> None:
        """Adds up to `count` random states that are likely valid, and of so many random insertions those that are.

        Half of the states have the tip where that of another is, of those first from or to which no motion was valid.
        """
        space, q, troubled = self.checker.space, self.joints, self._troubled(rng, TRIES * count // 2)
        beside = self._likely_valid(proposals.states_beside(self.checker, q[troubled], rng), count // 2)
        added = np.concatenate([beside, self._likely_valid(space.sample(rng, TRIES * count), count - len(beside))])
        everything, edges = np.concatenate([q, added]), set()
        for i in range(len(q), len(everything)):
            apart = np.linalg.norm(space.difference(everything[i], everything) * space.weights_mm, axis=1)
            apart[[0, i]] = np.inf
            others = {*np.argsort(apart)[:NEIGHBOURS].tolist(), int(self.goals[np.argmin(apart[self.goals])])}
            edges |= {(0, i)} | {(i, j) for j in others} | {(j, i) for j in others}
        self.extend(added, np.array(sorted(edges), dtype=int).reshape(-1, 2))
        if insertions:
            self._add_insertions(rng, insertions)

    def _add_insertions(self, rng: np.random.Generator, count: int) -> None:
        """Adds those of `count` random insertions that are likely valid, cheaper than the path known.

        Without one, a single way that may be walked at once, and those that are likely when that is there.
        """
        goals, known, first = self.goals, self.known_path(), len(self.joints)
        left_mm = self.checker.scenario.cost.error_goal * MM_PER_M * np.array([self.left_m[k] for k in goals.tolist()])
        most_mm = known.cost_mm if known else np.inf
        ways = proposals.turned_insertions(self.checker, self.joints[goals], left_mm, rng, count, most_mm)
        enough = None if known else 1 / WALK_PER_STATE
        if ways := proposals.likely_insertions(ways, self.clearance.share_valid_at, self._solved_at, enough):
            amid = first + 2 * np.arange(len(ways))
            nodes = np.stack([np.zeros_like(amid), amid, amid + 1, goals[[way.goal for way in ways]]], axis=1)
            edges = np.concatenate([nodes[:, k : k + 2] for k in range(3)])
            self.extend(np.concatenate([way.states for way in ways]), edges)

    def _solved_at(self, joints: Array, room_m: float) -> bool:
        """Whether joints (m,) are valid, which is solved and teaches what to expect of others."""
        is_valid = self.checker.state(joints).valid
        self._learn(self.clearance.extend(joints[None], np.array([room_m])))
        return is_valid

    def add_trails(self, trails: list[Trail]) -> None:
        """Adds goal states a step apart, joined to those ahead in their trail; the last ones also to others."""
        edges = set()
        for trail in trails:
            nodes = [self._node(state) for state in trail]
            edges |= {(nodes[i], nodes[i + skip]) for skip in SKIPS for i in range(len(nodes) - skip)}
            edges |= {(i, nodes[-1]) for i in self._nearest(trail[-1].joints, NEIGHBOURS)}
            edges.add((0, nodes[-1]))
        self._join(edges)

    def add_chains(self, chains: Roadmap) -> None:
        """Adds the chains of another roadmap from the same start, whose goals are known here."""
        known = {q.tobytes(): node for node, q in enumerate(self.joints)}
        new = [q for q in chains.joints if q.tobytes() not in known]
        known |= {q.tobytes(): node for node, q in enumerate(new, len(self.joints))}
        place = np.array([known[q.tobytes()] for q in chains.joints])
        self.extend(np.array(new).reshape(-1, self.joints.shape[1]), np.empty((0, 2), dtype=int))
        self._join({(int(a), int(b)) for a, b in place[chains.edges]})

    def _node(self, goal: GoalState) -> int:
        """The number of a goal state, which is added if it is new."""
        same = np.flatnonzero((self.joints == goal.joints).all(axis=1))
        if len(same):
            return int(same[0])
        node = len(self.joints)
        self.extend(goal.joints[None], np.empty((0, 2), dtype=int))
        self.goals, self.left_m[node] = np.append(self.goals, node), goal.bound_m
        return node

    def _nearest(self, q: Array, count: int) -> list[int]:
        """The states nearest to q (m,), not itself."""
        apart = np.linalg.norm(self.checker.space.difference(self.joints, q) * self.checker.space.weights_mm, axis=1)
        return [int(i) for i in np.argsort(apart) if apart[i] > 0][:count]

    def _join(self, edges: set[tuple[int, int]]) -> None:
        """Adds those motions that there were not."""
        new = sorted((a, b) for a, b in edges if (a, b) not in self.row and a != b)
        self.extend(np.empty((0, self.joints.shape[1])), np.array(new, dtype=int).reshape(-1, 2))

    def _troubled(self, rng: np.random.Generator, count: int) -> NDArray[np.int_]:
        """`count` random states, by how many motions from and to them were refused."""
        refused = self.edges[self.known & ~np.isfinite(self.cost)].ravel()
        weight = 1e-3 + np.bincount(np.concatenate([refused, self.refused]), minlength=len(self.joints))
        return rng.choice(len(weight), size=count, p=weight / weight.sum())

    def _likely_valid(self, q: Array, most: int) -> Array:
        share = self.clearance.share_valid_at(q, self.checker.rooms([row[None] for row in q]))
        return q[share > 1 / 2][:most]

    def any_path(self, stop: Callable[[], bool], least_hope: float = 0.0) -> Array | None:
        """(K, m) states of some good path from the start to a goal; None without a way, or if `stop` came first.

        Motions count what it takes to check them, little where they are known to be valid; those with less hope than
        `least_hope` are left out.
        """
        return self._path(stop, lambda: self._effort(least_hope), is_any_enough=True)

    def cheap_path(self, stop: Callable[[], bool], doubt: float) -> Array | None:
        """(K, m) states of the path that is likely the cheapest; likewise.

        With `doubt` 0 motions not checked count their length and stops alone, which is never too dear, so that the path
        is the cheapest there is, found when all that might be cheaper were checked. With doubt 1 they count what such
        motions cost on average, over the share of them that are valid: a path is found soon. In between, in between.
        """
        return self._path(stop, lambda: self._likely_cost(doubt))

    def _path(
        self, stop: Callable[[], bool], price: Callable[[], tuple[Array, Array]], *, is_any_enough: bool = False
    ) -> Array | None:
        """Checks the motions of the cheapest path, given what they cost and what is left, until one holds.

        Where any will do, and one motion is left to check, that of the path that may be next is checked ahead.
        """
        while len(self.cost) and not stop():
            nodes = self._shortest(*price())
            if nodes is None:
                return None
            edges = self._motions(nodes)
            unseen = [k for k in edges if not (self.seen[k] or self.known[k])]
            if unseen and self._finds_doubt(unseen):
                continue
            if self._refuses_a_state(nodes):
                continue
            unknown = sorted((k for k in edges if not self.known[k]), key=lambda k: self.hope[k])
            doubtful = [k for k in unknown if WALK_PER_STATE * (1 - self.hope[k]) > 1 and not self.queried[k]]
            if self._refuses_a_motion(doubtful[:AT_ONCE]):
                continue
            todo = unknown[:AT_ONCE]
            if not todo:
                return self.joints[nodes]
            ahead = self._likely_next(price, todo) if is_any_enough and len(todo) < AT_ONCE else []
            aside = (partial(self.checker.look_ahead, *self.joints[self.edges[k]]) for k in ahead)
            self._together([*(partial(self._check, k) for k in todo), *aside])
        return None

    def _refuses_a_motion(self, doubtful: list[int]) -> bool:
        """Looks at motions where they are narrowest, before any of their path is walked; whether there were any."""
        places = self.narrowest[doubtful]
        states = self._together([partial(self.checker.state, self.clearance.joints[place]) for place in places])
        refused = [k for k, state in zip(doubtful, states, strict=True) if not state.valid]
        self.queried[doubtful] = True
        self._learn(places)
        self.known[refused], self.cost[refused] = True, np.inf
        return bool(doubtful)

    @property
    def _is_tight(self) -> NDArray[np.bool_]:
        """(E,) motions known to leave less room than certificates need."""
        return self.solved_m < self.needed_m

    def _motions(self, nodes: list[int]) -> list[int]:
        """The motions of a path."""
        return [self.row[pair] for pair in itertools.pairwise(nodes)]

    def _likely_next(self, price: Callable[[], tuple[Array, Array]], todo: list[int]) -> list[int]:
        """A motion to check should those of `todo` be refused; nothing is remembered of how it is found."""
        cost, left = price()
        cost[todo] = np.inf
        for _ in range(GUESSES):
            nodes = self._shortest(cost, left)
            unknown = [k for k in self._motions(nodes) if not self.known[k]] if nodes else []
            if not unknown:
                break
            with counted_aside():
                rooms = self.checker.rooms([self._way(k) for k in unknown])
            if rooms.min() >= DEFINITE_COLLISION_M:
                return [unknown[int(np.argmin(rooms))]]
            cost[unknown[int(np.argmin(rooms))]] = np.inf
        return []

    def _way(self, k: int) -> Array:
        """(K, m) corners of a motion."""
        a, b = self.joints[self.edges[k]]
        return self.checker.space.corners(a, b, self.checker.style)

    def known_path(self, goal: int | None = None) -> KnownPath | None:
        """The cheapest path, to one goal if it is given, of motions that are valid and leave enough room, or None."""
        cost = np.where(self.known & ~self._is_tight, self.cost, np.inf)
        nodes = self._shortest(cost, self._left_at(goal, self.left))
        if nodes is None:
            return None
        motions = self._motions(nodes)
        cost_mm = float(self.cost[motions].sum() + self.left[motions[-1]])
        return KnownPath(self.joints[nodes], cost_mm)

    def promising_goals(self) -> Iterator[int]:
        """Goals, first what promises most of those with a known path, then what does of all others.

        Detours can be shortened, what is left at a goal state stays: a goal promises the mean of what the path there
        likely costs and the least that a straight one does.
        """
        weights, goals, tried = self.checker.scenario.cost, self.goals, np.zeros(len(self.goals), dtype=bool)
        straight_mm = least_cost_mm(self.checker, self.checker.space.difference(self.joints[0], self.joints[goals]))
        least_mm = straight_mm + weights.error_goal * MM_PER_M * np.array([self.left_m[k] for k in goals.tolist()])
        cost, left = np.where(self.known & ~self._is_tight, self.cost, np.inf), self.left
        while True:
            distance, _ = self._tree(cost, left)
            promise_mm = np.where(tried, np.inf, least_mm + distance[goals + len(self.joints)])
            best = int(np.argmin(promise_mm))
            if not np.isfinite(promise_mm[best]):
                return
            tried[best] = True
            yield int(goals[best])
            cost, left = self._likely_cost(1.0)

    def path_to(self, goal: int, stop: Callable[[], bool]) -> Array | None:
        """(K, m) states of the path to a goal that is likely the cheapest; None without a way, or if `stop` came."""
        return self._path(stop, lambda: self._likely_cost(1.0, goal))

    def needs_more(self, path: Array, short_m: float) -> None:
        """Takes in what a certificate found missing [m] of clearance on a path (K, m) of states, whose motions hold."""
        if short_m > 0:
            motions = [self.checker.motion(a, b) for a, b in itertools.pairwise(path)]
            self.needed_m = max(self.needed_m, min(motion.room_m for motion in motions) + short_m)

    def forbid_at(self, path: Array, broken_mm: Array, reason: str) -> None:
        """Forbids the motions of a path (K, m) of states on which its certificate found a limit broken.

        broken_mm (B,): joint lengths from the start. Without any, all motions: it is not known which is to blame.
        """
        space = self.checker.space
        ends = np.append(0.0, np.cumsum(space.lengths_mm(space.difference(path[:-1], path[1:]))))
        is_after, is_before = broken_mm >= ends[:-1, None] - AT_MM, broken_mm <= ends[1:, None] + AT_MM
        broken = np.flatnonzero((is_after & is_before).any(axis=1))
        for k in broken:
            self.forbid(path[k : k + 2], reason)
        if not len(broken):
            self.forbid(path, reason)

    def forbid(self, path: Array, reason: str) -> None:
        """Forbids the motions of a path (K, m) of states that failed its certificate, between equal states too."""
        begins, ends = self.joints[self.edges].transpose(1, 0, 2)
        for a, b in zip(path[:-1], path[1:], strict=True):
            self.checker.forbid(a, b, reason)
            self.cost[np.all(begins == a, axis=1) & np.all(ends == b, axis=1)] = np.inf

    def _effort(self, least_hope: float) -> tuple[Array, Array]:
        """What it takes to check motions: the length by the share of such motions that are valid; whatever is left."""
        is_open = np.isfinite(self.cost) & (self.known | (self.hope >= least_hope))
        hope = np.where(self._is_tight, LEAST_HOPE, self.hope)
        cost = np.where(self.known & ~self._is_tight, SURE, 1 / hope) * self.length + 1e-6
        return np.where(is_open, cost, np.inf), np.where(np.isfinite(self.left), 0.0, np.inf)

    def _likely_cost(self, doubt: float, goal: int | None = None) -> tuple[Array, Array]:
        """What motions cost and leave, at a single goal only if one is given.

        Those that are not checked cost as far above the least as others on average, and by their hope.
        """
        valid, ends = self.known & np.isfinite(self.cost), self.known & np.isfinite(self.cost + self.left)
        dearer = self.cost[valid].sum() / self.least[valid].sum() if valid.any() else 1.0
        worse = self.left[ends].sum() / self.least_left[ends].sum() if self.least_left[ends].any() else 1.0
        worse = max(worse, 1e-9)  # infinity stays, where nothing was left at those that are known
        cost = self.cost * (dearer / self.hope) ** doubt
        cost = np.where(self.known, np.where(self._is_tight, np.inf, self.cost), cost)
        return cost, self._left_at(goal, np.where(self.known, self.left, self.left * worse**doubt))

    def _left_at(self, goal: int | None, left: Array) -> Array:
        """What is left by motions that end at a goal, inf for others; as it is without one."""
        return left if goal is None else np.where(self.edges[:, 1] == goal, left, np.inf)

    def _refuses_a_state(self, nodes: list[int]) -> bool:
        """Looks at the states themselves; whether any of them is not valid, with all motions from and to it."""
        todo = [node for node in nodes if not self.probed[node]]
        motions = self._together([partial(self.checker.state, self.joints[node]) for node in todo])
        refused = [node for node, motion in zip(todo, motions, strict=True) if not motion.valid]
        self.probed[todo] = True
        self._learn(self.place[todo])
        self.refused = np.concatenate([self.refused, np.array(refused, dtype=int)])
        self.cost[np.isin(self.edges, refused).any(axis=1)] = np.inf
        return bool(refused)

    def _finds_doubt(self, rows: list[int]) -> bool:
        """Looks at the zero-clearance shapes along motions; whether there is any new doubt about them."""
        expected = self.hope[rows]
        looks = self.checker.look([self._way(k) for k in rows])
        rooms = np.array([stations.room_m.min() for stations in looks])
        self.jumps[rows] = [stations.jumps for stations in looks]
        joints, room_m = np.concatenate([way.joints for way in looks]), np.concatenate([way.room_m for way in looks])
        firsts = np.cumsum([0, *(len(way.room_m) for way in looks)])
        share = self.clearance.share_valid_at(joints, room_m)
        least = [a + int(np.argmin(share[a:b])) for a, b in itertools.pairwise(firsts.tolist())]
        self.narrowest[rows] = self.clearance.extend(joints[least], room_m[least])
        self.seen[rows] = True
        self._weigh()
        self.cost[np.array(rows, dtype=int)[rooms < DEFINITE_COLLISION_M]] = np.inf
        return bool(np.any(self.hope[rows] < expected))

    def _check(self, k: int) -> None:
        a, b = self.edges[k]
        motion = self.checker.motion(self.joints[a], self.joints[b])
        self.cost[k] = self.checker.cost_mm(motion, ends_at_goal=False) if motion.valid else np.inf
        self.solved_m[k] = motion.room_m
        if motion.valid and np.isfinite(self.left[k]):
            self.left[k] = self.checker.cost_mm(motion, ends_at_goal=True) - self.cost[k]
        self.known[k] = True

    def _shortest(self, cost: Array, left: Array) -> list[int] | None:
        """Nodes of the cheapest path from node 0 to a goal, given what motions cost and, as the last one, leave."""
        distance, before = self._tree(cost, left)
        goal = int(self.goals[np.argmin(distance[self.goals + len(self.joints)])])
        return self._nodes(before, goal) if np.isfinite(distance[goal + len(self.joints)]) else None

    def _tree(self, cost: Array, left: Array) -> tuple[Array, NDArray[np.int_]]:
        """Costs of the cheapest paths from node 0 to all, to pass there and then to end there; and the nodes before."""
        self.checker.meter.add(EDGE_NS * len(cost))
        is_open, count = np.isfinite(cost), len(self.joints)
        last = is_open & np.isfinite(left)
        (a, b), (a_last, b_last) = self.edges[is_open].T, self.edges[last].T
        costs = np.concatenate([cost[is_open], cost[last] + left[last]])
        ways = np.concatenate([a, a_last]), np.concatenate([b, b_last + count])
        graph = csr_array((costs, ways), shape=(2 * count, 2 * count))
        distance, before = dijkstra(graph, indices=0, return_predecessors=True)
        return distance, before

    def _nodes(self, before: NDArray[np.int_], goal: int) -> list[int]:
        """The nodes of the cheapest path that ends at a goal."""
        nodes = [goal, int(before[goal + len(self.joints)])]
        while nodes[-1] != 0:
            nodes.append(int(before[nodes[-1]]))
        return nodes[::-1]

    def _together(self, work: Sequence[Callable[[], Result]]) -> list[Result]:
        """What all of it finds, AT_ONCE in parallel; one alone is not worth a thread."""
        if len(work) < 2:
            return [task() for task in work]
        futures = [self._threads.submit(task) for task in work]
        wait(futures)  # all of them, also where one raises: nothing works on behind whoever asked
        return [future.result() for future in futures]
