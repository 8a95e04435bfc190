from __future__ import annotations

import math
from itertools import pairwise, permutations
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.geometry import FloatArray
from planner_service.planners import PRM
from planner_service.roadmap import Roadmap
from tests.discs import SEALED, WALL, DiscWorld, Stop, across, length

NOTHING: tuple[tuple[float, float, float], ...] = ()

SQUARE = Roadmap([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]], [[0, 1], [0, 2], [1, 3], [2, 3]], neighbours=1)


def shortest_by_trying_all(points: FloatArray, edges: set[tuple[int, int]], start: int, goals: set[int]) -> float:
    """The least length over all simple paths; only for a handful of points."""
    best = float("inf")
    inner = [k for k in range(len(points)) if k != start and k not in goals]
    for goal in goals:
        for count in range(len(inner) + 1):
            for middle in permutations(inner, count):
                path = [start, *middle, goal]
                if all((min(a, b), max(a, b)) in edges for a, b in pairwise(path)):
                    best = min(best, length(points[path]))
    return best


@pytest.mark.parametrize("seed", range(15))
def test_a_query_finds_the_shortest_path(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.random((6, 2))
    edges = {(a, b) for a in range(6) for b in range(a + 1, 6) if rng.random() < 0.4}
    start, goals = rng.random(2), rng.random((2, 2))
    found = Roadmap(points, sorted(edges) or np.zeros((0, 2)), neighbours=2).query(start, goals, DiscWorld(NOTHING))

    everything: FloatArray = np.concatenate([points, start[None], goals])
    for end in (6, 7, 8):
        nearest = sorted(range(6), key=lambda k: float(((points[k] - everything[end]) ** 2).sum()))[:2]
        edges |= {(k, end) for k in nearest}
    best = shortest_by_trying_all(everything, edges, 6, {7, 8})
    assert (float("inf") if found is None else length(found)) == pytest.approx(best, abs=1e-12)


def test_of_equally_short_paths_it_takes_the_one_over_smaller_indices() -> None:
    found = SQUARE.query([-0.1, -0.1], [1.1, 1.1], DiscWorld(NOTHING))
    assert found is not None
    assert found.tolist() == [[-0.1, -0.1], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.1, 1.1]]


def test_an_edge_that_became_blocked_is_gone_round() -> None:
    world = DiscWorld([(0.5, 0.0, 0.1)])
    found = SQUARE.query([-0.1, -0.1], [1.1, 1.1], world)
    assert found is not None
    assert found.tolist() == [[-0.1, -0.1], [0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.1, 1.1]]
    assert world.found_free(found)


def test_a_trusted_roadmap_has_only_the_edges_at_the_ends_judged() -> None:
    world = DiscWorld([(0.5, 0.0, 0.1)])
    assert SQUARE.query([-0.1, -0.1], [1.1, 1.1], world, trusted=True) is not None
    assert world.edges == [((-0.1, -0.1), (0.0, 0.0)), ((1.0, 1.0), (1.1, 1.1))]


def test_only_edges_of_candidate_paths_are_judged_and_none_twice() -> None:
    world = DiscWorld()
    roadmap = PRM(milestones=300).grow(across(world), seed=1)
    query = DiscWorld()
    result = roadmap.search(across(query))
    assert result.waypoints is not None
    assert query.found_free(result.waypoints)
    assert len({frozenset(edge) for edge in query.edges}) == len(query.edges) < 40
    assert len(set(query.judged)) == len(query.judged)


def test_ends_known_to_be_free_are_not_judged() -> None:
    world = DiscWorld(NOTHING)
    SQUARE.query([-0.1, -0.1], [1.1, 1.1], world)
    assert (-0.1, -0.1) not in world.judged
    assert (1.1, 1.1) not in world.judged


def test_the_nearer_of_two_goals_is_reached() -> None:
    problem = across(DiscWorld(), goals=((2.5, 2.5), (1.2, -0.5)))
    result = PRM(milestones=300).grow(problem, seed=0).search(problem)
    assert result.goal_index == 1


def test_no_path_is_none() -> None:
    problem = across(DiscWorld(SEALED))
    assert PRM(milestones=100).grow(problem, seed=0).query(problem.start, problem.goals, problem.oracle) is None
    assert Roadmap(np.zeros((0, 2)), np.zeros((0, 2))).query([0.0, 0.0], [1.0, 1.0], DiscWorld(NOTHING)) is None


def test_an_end_that_is_a_milestone_is_not_repeated() -> None:
    found = SQUARE.query([0.0, 0.0], [1.0, 1.0], DiscWorld(NOTHING))
    assert found is not None
    assert found.tolist() == [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]


def test_edges_grown_by_prm_are_free_and_listed_once() -> None:
    world = DiscWorld(WALL)
    roadmap = PRM(milestones=100, neighbours=5).grow(across(world), seed=2)
    for a, b in roadmap.edges.tolist():
        assert world.found_free(roadmap.milestones[[a, b]])
    pairs = [tuple(edge) for edge in roadmap.edges.tolist()]
    assert pairs == sorted({(min(pair), max(pair)) for pair in pairs})
    assert np.array_equal(roadmap.lengths, [length(roadmap.milestones[edge]) for edge in roadmap.edges.tolist()])


def test_a_limit_comes_out_of_a_query() -> None:
    with pytest.raises(Stop, match="limit"):
        SQUARE.query([-0.1, -0.1], [1.1, 1.1], DiscWorld(NOTHING, limit=3, error=lambda: Stop("limit")))


def test_a_roadmap_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        SQUARE.milestones[0, 0] = 1.0


@pytest.mark.parametrize(
    ("milestones", "edges", "neighbours", "field"),
    [
        ([[float("nan")]], [], 1, "milestones"),
        ([0.0], [], 1, "milestones"),
        ([[0.0], [1.0]], [[0, 2]], 1, "edges"),
        ([[0.0], [1.0]], [[1, 1]], 1, "edges"),
        ([[0.0], [1.0]], [[0, 1]], 0, "neighbours"),
    ],
)
def test_a_roadmap_that_makes_no_sense_is_refused(
    milestones: list[list[float]], edges: list[list[int]], neighbours: int, field: str
) -> None:
    with pytest.raises(InvalidRequest, match=field):
        Roadmap(milestones, edges, neighbours=neighbours)


def test_a_roadmap_of_another_arm_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="a roadmap of 6 joints"):
        SQUARE.search(across(DiscWorld(), n=6))


@pytest.mark.parametrize("milestones", [[[10**400, 0.0]], [["0", "1"]], [[True, False]], [[0.0], [0.0, 1.0]], None])
def test_milestones_that_are_no_real_numbers_are_refused(milestones: Any) -> None:
    with pytest.raises(InvalidRequest, match="milestones: got"):
        Roadmap(milestones, [])


@pytest.mark.parametrize(
    "edges", [[[0, 10**400]], [["0", "1"]], [[0, 0.5]], [0, 1], [[0, 1, 1]], None, [[0, math.inf]]]
)
def test_edges_that_are_no_pairs_of_indices_are_refused(edges: Any) -> None:
    with pytest.raises(InvalidRequest, match="edges: got"):
        Roadmap([[0.0], [1.0]], edges)


@pytest.mark.parametrize("end", [[10**400, 0.0], ["0", "1"], [0.0], [math.nan, 0.0], None])
def test_a_query_from_or_to_nowhere_is_refused(end: Any) -> None:
    roadmap, world = Roadmap([[0.0, 0.0], [1.0, 1.0]], [[0, 1]]), DiscWorld()
    with pytest.raises(InvalidRequest, match="start: got"):
        roadmap.query(end, [0.0, 0.0], world)
    with pytest.raises(InvalidRequest, match="goals: got"):
        roadmap.query([0.0, 0.0], end, world)
