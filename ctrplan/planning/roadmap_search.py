"""A roadmap that grows: the cheapest path of it, checking only motions that may lie on it; or, sooner, some good path.

Zero-clearance shapes, some thirty times cheaper than a bound, tell which states and motions are worth a check.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from ctrplan.drive import Array
from ctrplan.planning.goals import GoalState
from ctrplan.planning.inverse_kinematics import TipSolver, TipTarget
from ctrplan.planning.motion import HOPELESS_M, MM_PER_M, MotionChecker
from ctrplan.planning.retreat import Roadmap
from ctrplan.planning.search_clock import ROOM_NS

AT_ONCE = 2  # motions checked in parallel; the same everywhere, as it decides what is checked
SURE = 0.3  # of its length is what a motion counts that is known to be valid, while any path will do
NEIGHBOURS = 8
NEAR_MM = 30.0  # of joint length, standard deviation of random states beside others, before their tips are brought back
TIP_STEPS, NEAR_TIP_M = 4, 4e-3  # for that, and how near they must come
TRIES = 4  # random states looked at for each that is added
ROOM_M = 1e-3  # that a random state must have around its zero-clearance shape
# Share of motions that are valid, by the room [m] around their zero-clearance shapes, a line through
# `benchmarks/zero_clearance_rooms.py`
VALID_AT_M, VALID_SHARE = (-0.5e-3, 3e-3), (0.02, 1.0)


class RoadmapSearch:
    """Checks motions of a roadmap when they are needed, and remembers what they cost."""

    def __init__(self, checker: MotionChecker, roadmap: Roadmap, goals: list[GoalState]) -> None:
        """goals: those of the roadmap, in its order, with their bounds."""
        self.checker, self.goals = checker, roadmap.goals
        self.left_m = dict(zip(roadmap.goals.tolist(), (goal.bound_m for goal in goals), strict=True))
        self.joints = np.empty((0, len(checker.space.weights_mm)))
        self.edges = np.empty((0, 2), dtype=int)
        self.length, self.cost, self.hope = np.empty(0), np.empty(0), np.empty(0)
        self.known, self.probed = np.empty(0, dtype=bool), np.empty(0, dtype=bool)
        self.refused = np.empty(0, dtype=int)  # states that are not valid
        self.row: dict[tuple[int, int], int] = {}
        self.extend(roadmap.joints, roadmap.edges)

    def extend(self, joints: Array, edges: NDArray[np.int_]) -> None:
        """Adds states (N, m), counted on from the last one, and motions (E, 2) that there were not."""
        weights, space = self.checker.scenario.cost, self.checker.space
        self.joints = np.concatenate([self.joints, joints])
        self.probed = np.concatenate([self.probed, np.zeros(len(joints), dtype=bool)])
        a, b = edges.T
        delta = space.difference(self.joints[a], self.joints[b])
        length = space.lengths_mm(delta)
        left = np.array([self.left_m.get(int(node), 0.0) for node in b])
        least = weights.path * length + weights.stop * space.legs(delta) + weights.error_goal * left * MM_PER_M + 1e-6
        self.row |= {(int(i), int(j)): k for k, (i, j) in enumerate(edges, len(self.edges))}
        self.edges, self.length = np.concatenate([self.edges, edges]), np.concatenate([self.length, length])
        self.cost = np.concatenate([self.cost, least])  # at least; what it costs where known
        self.known = np.concatenate([self.known, np.zeros(len(edges), dtype=bool)])
        self.hope = np.concatenate([self.hope, np.full(len(edges), np.nan)])  # share; NaN before a look

    def grow(self, rng: np.random.Generator, count: int) -> None:
        """Adds up to `count` random states with room around their zero-clearance shapes.

        Half of them have the tip where that of another state is, of those first from or to which no motion was valid.
        """
        space, q = self.checker.space, self.joints
        found = [self._with_room(self._beside(q[self._troubled(rng, TRIES * count // 2)], rng), count // 2)]
        found.append(self._with_room(space.sample(rng, TRIES * count), count - len(found[0])))
        added = np.concatenate(found)
        everything, edges = np.concatenate([q, added]), set()
        for i in range(len(q), len(everything)):
            apart = np.linalg.norm(space.difference(everything[i], everything) * space.weights_mm, axis=1)
            apart[[0, i]] = np.inf
            others = {*np.argsort(apart)[:NEIGHBOURS].tolist(), int(self.goals[np.argmin(apart[self.goals])])}
            edges |= {(0, i)} | {(i, j) for j in others} | {(j, i) for j in others}
        self.extend(added, np.array(sorted(edges), dtype=int).reshape(-1, 2))

    def add_goals(self, goals: list[GoalState]) -> None:
        """Adds goal states, joined to the start and to the states nearest to them."""
        first = len(self.joints)
        added = np.array([goal.joints for goal in goals]).reshape(-1, self.joints.shape[1])
        edges = set()
        for k, goal in enumerate(goals, first):
            apart = np.linalg.norm(
                self.checker.space.difference(self.joints, goal.joints) * self.checker.space.weights_mm, axis=1
            )
            edges |= {(0, k)} | {(int(i), k) for i in np.argsort(apart)[:NEIGHBOURS]}
            self.left_m[k] = goal.bound_m
        self.goals = np.append(self.goals, np.arange(first, first + len(goals)))
        self.extend(added, np.array(sorted(edges), dtype=int).reshape(-1, 2))

    def _troubled(self, rng: np.random.Generator, count: int) -> NDArray[np.int_]:
        """`count` random states, by how many motions from and to them were refused."""
        refused = self.edges[self.known & ~np.isfinite(self.cost)].ravel()
        weight = 1e-3 + np.bincount(np.concatenate([refused, self.refused]), minlength=len(self.joints))
        return rng.choice(len(weight), size=count, p=weight / weight.sum())

    def _beside(self, q: Array, rng: np.random.Generator) -> Array:
        """Other configurations with the tips of q (K, m)."""
        space = self.checker.space
        solver = TipSolver(space, self.checker.mechanics)
        near = space.wound_into_limits(q + rng.normal(size=q.shape) * NEAR_MM / space.weights_mm)
        allowed = space.allowed_rows(near)
        found = solver.solve(TipTarget(solver.tips(q[allowed])[0]), near[allowed], TIP_STEPS, turned=False)
        self.checker.meter.add(ROOM_NS * TIP_STEPS * len(near))
        return found.joints[found.error_m < NEAR_TIP_M]

    def _with_room(self, q: Array, most: int) -> Array:
        return q[self.checker.rooms([row[None] for row in q]) > ROOM_M][:most]

    def path(self, stop: Callable[[], bool], *, eager: bool) -> Array | None:
        """(K, m) states from the start to a goal; None without a way, or if `stop` came first.

        A motion not checked yet counts its length alone, which is never too dear, so that the path is the cheapest.
        Where `eager`, motions count what it takes to check them, little where they are known to be valid: a path is
        found sooner.
        """
        while len(self.cost) and not stop():
            nodes = self._shortest(self._eager_cost() if eager else self.cost)
            if nodes is None:
                return None
            if self._refuses_a_state(nodes):
                continue
            edges = [self.row[pair] for pair in zip(nodes[:-1], nodes[1:], strict=True)]
            unseen = [k for k in edges if np.isnan(self.hope[k]) and not self.known[k]]
            if unseen and self._finds_doubt(unseen):
                continue
            todo = sorted((k for k in edges if not self.known[k]), key=lambda k: self.hope[k])
            if not todo:
                return self.joints[nodes]
            with ThreadPoolExecutor(AT_ONCE) as pool:
                list(pool.map(self._check, todo[:AT_ONCE]))
        return None

    def known_path(self) -> Array | None:
        """(K, m) the cheapest path of motions known to be valid; None without one."""
        nodes = self._shortest(np.where(self.known, self.cost, np.inf))
        return None if nodes is None else self.joints[nodes]

    def forbid(self, path: Array, reason: str) -> None:
        """Forbids the motions of a path (K, m) of states that failed its certificate."""
        nodes = [int(np.argmin(np.abs(self.joints - q).max(axis=1))) for q in path]
        for a, b in zip(nodes[:-1], nodes[1:], strict=True):
            self.checker.forbid(self.joints[a], self.joints[b], reason)
            self.cost[self.row[a, b]] = np.inf

    def _eager_cost(self) -> Array:
        """What it takes to check them: the length by the share of such motions that are valid."""
        cost = np.where(self.known, SURE, 1 / np.nan_to_num(self.hope, nan=1.0)) * self.length + 1e-6
        return np.where(np.isfinite(self.cost), cost, np.inf)

    def _refuses_a_state(self, nodes: list[int]) -> bool:
        """Looks at the states themselves; whether any of them is not valid, with all motions from and to it."""
        todo = [node for node in nodes if not self.probed[node]]
        with ThreadPoolExecutor(AT_ONCE) as pool:
            motions = list(pool.map(lambda node: self.checker.state(self.joints[node]), todo))
        refused = [node for node, motion in zip(todo, motions, strict=True) if not motion.valid]
        self.probed[todo] = True
        self.refused = np.concatenate([self.refused, np.array(refused, dtype=int)])
        self.cost[np.isin(self.edges, refused).any(axis=1)] = np.inf
        return bool(refused)

    def _finds_doubt(self, rows: list[int]) -> bool:
        """Looks at the zero-clearance shapes along motions; whether there is any new doubt about them."""
        joints, space = self.joints, self.checker.space
        ways = [space.corners(joints[a], joints[b], self.checker.style) for a, b in self.edges[rows]]
        rooms = self.checker.rooms(ways)
        self.hope[rows] = np.interp(rooms, VALID_AT_M, VALID_SHARE)
        self.cost[np.array(rows, dtype=int)[rooms < HOPELESS_M]] = np.inf
        return bool(np.any(self.hope[rows] < 1))

    def _check(self, k: int) -> None:
        a, b = self.edges[k]
        motion = self.checker.motion(self.joints[a], self.joints[b])
        self.cost[k] = (
            self.checker.cost_mm(motion, ends_at_goal=bool(np.isin(b, self.goals))) if motion.valid else np.inf
        )
        self.known[k] = True

    def _shortest(self, cost: Array) -> list[int] | None:
        """Nodes of the cheapest path from node 0 to a goal."""
        is_open, count = np.isfinite(cost), len(self.joints)
        a, b = self.edges[is_open].T
        graph = csr_array((cost[is_open], (a, b)), shape=(count, count))
        distance, before = dijkstra(graph, indices=0, return_predecessors=True)
        goal = int(self.goals[np.argmin(distance[self.goals])])
        if not np.isfinite(distance[goal]):
            return None
        nodes = [goal]
        while nodes[-1] != 0:
            nodes.append(int(before[nodes[-1]]))
        return nodes[::-1]
