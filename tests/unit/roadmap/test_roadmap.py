from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.planners import PRM, LazyPRM
from planner_service.roadmap import Roadmap, Verdict
from planner_service.roadmap.verdicts import SELF, Knowledge
from planner_service.search.problem import SearchProblem
from tests.support.discs import SEALED, WALL, DiscWorld, across, length
from tests.support.optional import present

NOTHING: tuple[tuple[float, float, float], ...] = ()

CORNERS = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
SIDES = [(0, 1), (0, 2), (1, 3), (2, 3)]
SQUARE = Roadmap.of(CORNERS, SIDES)
JUDGED = Roadmap.judged(CORNERS, SIDES)


def query(start: Any, goals: Any, world: DiscWorld) -> SearchProblem:
    edge = np.full(2, 5.0)
    return SearchProblem(np.array(start), np.atleast_2d(np.array(goals)), -edge, edge, world)


def diagonal(world: DiscWorld) -> SearchProblem:
    return query([-0.1, -0.1], [1.1, 1.1], world)


def test_an_end_is_joined_anywhere_along_a_free_edge() -> None:
    bridge = Roadmap.judged([[0.0, 0.0], [4.0, 0.0]], [(0, 1)])
    found = bridge.search(query([1.0, 0.3], [3.0, 0.3], DiscWorld([(2.0, 0.7, 0.6)])))
    assert found.waypoints is not None
    assert length(found.waypoints) < 3.0
    assert [abs(q[1]) for q in found.waypoints.tolist()[1:-1]] == [0.0] * (len(found.waypoints) - 2)


def test_only_edges_of_candidate_paths_are_judged_and_none_twice() -> None:
    roadmap = LazyPRM(milestones=300).grow(across(DiscWorld()), seed=1)
    world = DiscWorld()
    result = roadmap.search(across(world))
    assert world.found_free(present(result.waypoints))
    assert len({frozenset(edge) for edge in world.edges}) == len(world.edges) < 60 < len(roadmap.edges)
    assert len(set(world.judged)) == len(world.judged)


def test_what_was_learned_is_another_value_and_is_not_asked_again() -> None:
    roadmap = LazyPRM(milestones=300).grow(across(DiscWorld()), seed=1)
    first = roadmap.search(across(DiscWorld()))
    learned = present(first.roadmap)
    assert roadmap.verdicts.any() == np.False_
    assert learned.edge_knowledge.count(Verdict.FREE) > 0
    assert learned.hash != roadmap.hash
    world, once_more = DiscWorld(), DiscWorld()
    again = learned.search(across(world))
    assert again.waypoints is not None
    assert roadmap.search(across(once_more)).waypoints is not None
    assert world.states < once_more.states / 2


def test_no_path_is_none() -> None:
    problem = across(DiscWorld(SEALED))
    assert PRM(milestones=100).grow(problem, seed=0).search(problem).waypoints is None
    assert LazyPRM(milestones=100).search(problem).waypoints is None
    assert Roadmap.of(np.zeros((0, 2))).search(diagonal(DiscWorld(NOTHING))).waypoints is None


def test_prm_remembers_which_edges_it_found_free_and_which_blocked() -> None:
    world, checker = DiscWorld(WALL), DiscWorld(WALL)
    roadmap = PRM(milestones=100, neighbours=5).grow(across(world), seed=2)
    free = roadmap.verdicts == Verdict.FREE
    assert free.sum() > 50
    assert set(roadmap.verdicts.tolist()) == {Verdict.FREE, Verdict.BLOCKED}
    for (a, b), is_free in zip(roadmap.edges.tolist(), free.tolist(), strict=True):
        assert checker.edge_is_free(roadmap.milestones[a], roadmap.milestones[b]) == is_free
    pairs = [tuple(edge) for edge in roadmap.edges.tolist()]
    assert pairs == sorted({(min(pair), max(pair)) for pair in pairs})
    assert np.array_equal(roadmap.lengths, [length(roadmap.milestones[edge]) for edge in roadmap.edges.tolist()])


def test_a_path_is_remembered_as_milestones_and_free_edges() -> None:
    path = [[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0], [2.0, 0.5]]
    more = JUDGED.with_path(path)
    assert more.milestones.tolist() == [*CORNERS, [-1.0, 0.0], [2.0, 0.5]]
    assert more.edges.tolist() == [*map(list, JUDGED.edges.tolist()), [0, 4], [1, 5]]
    assert more.verdicts.tolist() == [Verdict.FREE] * 6
    assert JUDGED.milestones.tolist() == CORNERS
    world = DiscWorld([(0.5, 0.5, 0.3)])
    found = more.search(query(path[0], path[-1], world))
    assert found.waypoints is not None
    assert world.edges == [], "the ends are milestones now, and the way is known"


def test_what_an_obstacle_may_have_changed_is_in_doubt_and_nothing_else() -> None:
    lessons = {
        0: (Verdict.FREE, None),
        1: (Verdict.BLOCKED, "post"),
        2: (Verdict.BLOCKED, "wall"),
        3: (Verdict.BLOCKED, SELF),
        4: (Verdict.BLOCKED, None),
    }
    known = Knowledge.none(6).with_lessons(lessons)
    free, blocked = Verdict.FREE, Verdict.BLOCKED
    doubt = (Verdict.FREE_BEFORE, Verdict.BLOCKED_BEFORE)
    unknown = Verdict.UNKNOWN
    moved = known.after({"post"}, {"post"}, {"post"})
    assert moved.verdicts.tolist() == [doubt[0], doubt[1], blocked, blocked, doubt[1], unknown]
    come = known.after({"ball"}, (), {"ball"})
    assert come.verdicts.tolist() == [doubt[0], blocked, blocked, blocked, blocked, unknown]
    gone = known.after((), {"wall"}, ())
    assert gone.verdicts.tolist() == [free, blocked, doubt[1], blocked, doubt[1], unknown]
    back = come.after((), {"ball"}, ())
    assert back.verdicts.tolist()[0] == free, "what was free of all else is free once the ball has gone again"


def test_a_roadmap_that_makes_no_sense_is_refused() -> None:
    milestones: Any
    edges: Any
    for milestones, edges, field in [
        ([[float("nan")]], [], "milestones"),
        ([0.0], [], "milestones"),
        ([[0.0], [1.0]], [[0, 2]], "edges"),
        ([[0.0], [1.0]], [[1, 1]], "edges"),
        ([[0.0], [1.0]], [[-1, 1]], "edges"),
    ]:
        with pytest.raises(InvalidRequest, match=field):
            Roadmap.of(milestones, edges)


def test_a_reach_that_makes_no_sense_is_refused() -> None:
    reach: Any
    for reach in [[1.0], [1.0, -1.0], [1.0, math.nan], "ab"]:
        with pytest.raises(InvalidRequest, match="reach: got"):
            Roadmap.of(CORNERS, SIDES, reach=reach)


def test_a_roadmap_of_another_arm_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="a roadmap of 6 joints"):
        SQUARE.search(across(DiscWorld(), n=6))


def test_a_path_that_is_none_is_refused() -> None:
    points: Any
    for points in [[[0.0, 0.0]], [[0.0], [1.0]], [[0.0, math.inf], [0.0, 0.0]], None]:
        with pytest.raises(InvalidRequest, match="points: got"):
            SQUARE.with_path(points)
