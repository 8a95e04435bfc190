"""What compiled queries of a roadmap refuse."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from planner_service import InvalidRequest, PlannerService, Roadmap
from planner_service.native.loading import load_core
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem, SearchSpace
from tests.support.optional import present

if TYPE_CHECKING:
    from planner_service.native import _core

DISCS = PlannerService("planar2", "discs")
DISCS_SPACE = SearchSpace(DISCS.robot.limits.lower, DISCS.robot.limits.upper, SearchOracle(DISCS.checker))


def of_a_grid(size: int) -> Roadmap:
    """A roadmap in which many places lie equally far away."""
    rows = np.arange(size * size).reshape(size, size)
    beside, above = (
        np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((rows[:, :-1], rows[:, 1:]), (rows[:-1], rows[1:]))
    )
    across = np.stack([rows[:-1, 1:].ravel(), rows[1:, :-1].ravel()], axis=1)
    return Roadmap.of(np.stack(np.divmod(rows.ravel(), size), axis=1) / 2.0, np.concatenate([beside, above, across]))


def test_a_milestone_beyond_the_joint_limits_is_refused() -> None:
    limits = DISCS.robot.limits
    start, goal = np.array([-2.5, 2.0]), np.array([[2.2, -2.2]])
    roadmap = Roadmap.of([start, limits.upper + 1.0, goal[0]], [(0, 1), (1, 2)])
    problem = SearchProblem(start, goal, limits.lower, limits.upper, SearchOracle(DISCS.checker))
    before = DISCS.checker.counts
    with pytest.raises(InvalidRequest, match="expected shoulder in"):
        roadmap.search(problem)
    assert (DISCS.checker.counts - before).states <= 1


def test_graphs_that_are_none_are_refused() -> None:
    core = present(load_core())
    ends, number = np.array([[0, 1]]), np.array([0, 0])
    points, reach, starts, other = np.zeros((2, 2)), np.ones(2), np.array([0, 1, 2]), np.array([1, 0])

    right: dict[str, object] = {"edges": ends, "reach": reach, "starts": starts, "other": other, "number": number}

    def trunk(**wrong: object) -> _core.RoadmapTrunk:
        given = right | wrong
        rows = given["starts"], given["other"], np.ones(2), given["number"], np.zeros(2, dtype=np.int64)
        made: _core.RoadmapTrunk = core.RoadmapTrunk(points, given["edges"], given["reach"], 0.1, *rows)
        return made

    with pytest.raises(ValueError, match="a reach for each joint"):
        trunk(reach=np.ones(3))
    with pytest.raises(ValueError, match="rows and a component"):
        trunk(starts=starts[:2])
    with pytest.raises(ValueError, match="rows of all milestones"):
        trunk(starts=np.array([0, 1, 1]))
    for wrong in ({"edges": ends + 1}, {"other": other + 1}, {"number": number + 1}, {"number": number - 1}):
        with pytest.raises(ValueError, match="no such milestone or edge"):
            trunk(**wrong)
    with pytest.raises(ValueError, match="of the trunk"):
        core.RoadmapGraph(trunk(), points[:1], ends[:0], reach, 0.1, {}, {})
    with pytest.raises(ValueError, match="no such milestone or edge"):
        core.RoadmapGraph(trunk(), points, ends, reach, 0.1, {0: [(5, 1.0, 0)]}, {})


def test_places_and_queries_that_do_not_fit_a_graph_are_refused() -> None:
    core, graph = present(load_core()), of_a_grid(3).graph
    yes, no = np.ones(9, dtype=bool), np.zeros(len(graph.edges), dtype=bool)
    with pytest.raises(ValueError, match="a flag for each"):
        core.Places(graph.compiled, yes[1:], no, True)
    places = core.Places(graph.compiled, yes, no, True)
    with pytest.raises(ValueError, match="as many joints"):
        core.NearestPlaces(places, [0.0])
    known, unknown = np.ones(9, dtype=np.int8), np.zeros(len(no), dtype=np.int8)
    oracle = SearchOracle(DISCS.checker).core
    with pytest.raises(ValueError, match="a verdict on each"):
        core.RoadmapQuery(graph.compiled, places, known[1:], unknown, [0.0, 0.0], [[1.0, 1.0]], oracle)
    for start, goals in (([0.0], [[1.0, 1.0]]), ([0.0, 0.0], [[1.0]]), ([0.0, 0.0], [])):
        with pytest.raises(ValueError, match="as many joints"):
            core.RoadmapQuery(graph.compiled, places, known, unknown, start, goals, oracle)
