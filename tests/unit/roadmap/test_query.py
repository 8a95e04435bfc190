"""A query against brute force, over small graphs of which things true and no longer certain are known."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray
from planner_service.roadmap import Roadmap, Verdict
from planner_service.roadmap.verdicts import Knowledge
from planner_service.search.problem import SearchProblem
from tests.support.discs import DiscWorld, GlancingWorld, Stop
from tests.support.roadmaps import nearest_places

STEP = 0.02


class Maze:
    """A few discs, a graph among them, and what is known of it."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.rng = rng
        self.discs = [
            (*rng.random(2).tolist(), float(rng.uniform(0.03, 0.15))) for _ in range(int(rng.integers(0, 16)))
        ]
        points = rng.random((int(rng.integers(1, 11)), 2))
        if seed % 3 == 0 and len(points) > 2:
            points[-1] = points[0]  # the same place twice
        count = len(points)
        every = [(a, b) for a in range(count) for b in range(a + 1, count)]
        edges = [edge for edge in every if rng.random() < rng.choice([0.1, 0.3, 0.6])][:25]
        if seed % 3 == 0 and count > 2 and (0, count - 1) not in edges:
            edges.append((0, count - 1))
        self.judge = DiscWorld(self.discs, step=STEP)
        plain = Roadmap.of(points, edges)
        self.nodes = [self.judge.state_is_free(q) for q in plain.milestones]
        self.edges = [self.free(*plain.milestones[edge]) for edge in plain.edges]
        roadmap = replace(
            plain, milestone_knowledge=self.knowledge(self.nodes), edge_knowledge=self.knowledge(self.edges)
        )
        self.roadmap = roadmap

    def free(self, a: FloatArray, b: FloatArray) -> bool:
        return self.judge.edge_is_free(np.array(a), np.array(b))

    def knowledge(self, truth: list[bool]) -> Knowledge:
        """Some of the truth, and some doubt."""
        told = []
        for free in truth:
            sure = Verdict.FREE if free else Verdict.BLOCKED
            told.append(int(self.rng.choice([0, sure, sure, Verdict.FREE_BEFORE, Verdict.BLOCKED_BEFORE])))
        return replace(Knowledge.none(len(truth)), verdicts=np.array(told, dtype=np.int8))

    def problem(self, world: DiscWorld) -> SearchProblem | None:
        ends: list[list[float]] = [
            q for q in self.rng.random((12, 2)).tolist() if self.judge.state_is_free(np.array(q))
        ]
        points = self.roadmap.milestones
        if self.rng.random() < 0.3:
            ends = [q for q, free in zip(points.tolist(), self.nodes, strict=True) if free] + ends
        if self.rng.random() < 0.3 and any(self.edges):
            a, b = points[self.roadmap.edges[self.edges.index(True)]]
            if self.judge.state_is_free(0.5 * (a + b)):
                ends = [(0.5 * (a + b)).tolist(), *ends]
        if len(ends) < 2:
            return None
        goals = np.array(ends[1 : 1 + int(self.rng.integers(1, 4))])
        return SearchProblem(np.array(ends[0]), goals, np.full(2, -1.0), np.full(2, 2.0), world)

    def joined(self, q: FloatArray) -> set[int]:
        """The milestones that can be reached from q."""
        offered = self.roadmap.milestone_knowledge.verdicts != Verdict.BLOCKED
        found = set()
        for place in nearest_places(self.roadmap.graph, offered, self.roadmap.edge_knowledge.free, q):
            if place.edge < 0:
                found |= {place.milestone} if self.free(q, np.array(place.q)) else set()
            elif self.edges[place.edge] and self.free(q, np.array(place.q)):
                found |= set(self.roadmap.edges[place.edge].tolist())
        return found

    def there_is_a_path(self, problem: SearchProblem) -> bool:
        """Over free edges from where the start is joined to where a goal is, or both on one edge."""
        reached, wanted = self.joined(problem.start), set().union(*map(self.joined, problem.goals))
        grew = True
        while grew:
            grew = False
            for (a, b), free in zip(self.roadmap.edges.tolist(), self.edges, strict=True):
                if free and (a in reached) != (b in reached):
                    reached |= {a, b}
                    grew = True
        return bool(reached & wanted)

    def true(self, roadmap: Roadmap) -> bool:
        """Whether what a roadmap takes for certain is so."""
        for known, truth in ((roadmap.milestone_knowledge, self.nodes), (roadmap.edge_knowledge, self.edges)):
            for verdict, free in zip(known.verdicts.tolist(), truth, strict=True):
                if verdict in (Verdict.FREE, Verdict.BLOCKED) and (verdict == Verdict.FREE) != free:
                    return False
        return True

    def on_free_edges(self, waypoints: FloatArray, world: DiscWorld) -> bool:
        """Whether each piece is part of an edge that was judged free by now."""
        ends = [self.roadmap.milestones[e] for e, free in zip(self.roadmap.edges, self.edges, strict=True) if free]
        free = [(a.tolist(), b.tolist()) for a, b in ends]
        free += [tuple(map(list, edge)) for edge in world.free_edges if len(edge) == 2]  # type: ignore[misc]
        return all(any(lies_on(piece, edge) for edge in free) for piece in pairwise(waypoints.tolist()))


def lies_on(piece: tuple[list[float], list[float]], edge: tuple[list[float], list[float]]) -> bool:
    a, b = edge
    return all(math.dist(a, q) + math.dist(q, b) < math.dist(a, b) + 1e-12 for q in piece)


class Honest:
    """Says of some edges that are free that they are."""

    def __init__(self, maze: Maze) -> None:
        self.maze = maze

    def still_free(self, A: FloatArray, B: FloatArray) -> NDArray[np.bool_]:
        rng = np.random.default_rng(len(A))
        return np.array([rng.random() < 0.6 and self.maze.free(a, b) for a, b in zip(A, B, strict=True)])


@pytest.mark.slow
@pytest.mark.parametrize("some", range(2))
@pytest.mark.parametrize("glances", [False, True])
def test_a_path_is_found_if_and_only_if_there_is_one_and_what_is_learned_is_true(some: int, glances: bool) -> None:
    found = 0
    for seed in range(100 * some, 100 * some + 100):
        maze = Maze(seed)
        world = (GlancingWorld if glances else DiscWorld)(maze.discs, step=STEP)
        problem = maze.problem(world)
        if problem is None:
            continue
        carried = Honest(maze) if seed % 2 else None
        result = maze.roadmap.search(problem, carried=carried)
        assert (result.waypoints is not None) == maze.there_is_a_path(problem), seed
        assert result.roadmap is not None
        assert maze.true(result.roadmap), seed
        if result.waypoints is None:
            continue
        found += 1
        assert result.goal_index is not None
        assert result.waypoints[0].tolist() == problem.start.tolist()
        assert result.waypoints[-1].tolist() == problem.goals[result.goal_index].tolist()
        assert maze.on_free_edges(result.waypoints, world), seed
        again = result.roadmap.search(replace(problem, oracle=DiscWorld(maze.discs, step=STEP)), carried=carried)
        assert again.waypoints is not None
    assert found > 5


@pytest.mark.parametrize("glances", [False, True])
def test_a_query_that_is_stopped_anywhere_stops_and_leaves_the_roadmap_as_it_was(glances: bool) -> None:
    stopped = 0
    for seed in range(40):
        maze = Maze(seed)
        before = maze.roadmap.hash
        for limit in (0, 1, 3, 10):
            world = (GlancingWorld if glances else DiscWorld)(maze.discs, step=STEP, limit=limit)
            problem = maze.problem(world)
            if problem is None:
                continue
            try:
                maze.roadmap.search(problem)
            except Stop:
                stopped += 1
        assert replace(maze.roadmap).hash == before
    assert stopped > 20


def test_an_edge_of_any_length_is_joined() -> None:
    far = Roadmap.of(np.zeros((0, 2))).with_path([[0.0, 0.0], [1e12, 0.0]])
    wide = np.full(2, 1e13)
    world = DiscWorld((), step=1e9)
    found = far.search(SearchProblem(np.array([1e11, 1e6]), np.array([[9e11, 1e6]]), -wide, wide, world))
    assert found.waypoints is not None
