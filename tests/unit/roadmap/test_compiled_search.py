"""The compiled search of a roadmap finds the paths of the Python code, and learns the same."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from planner_service import PRM, InvalidRequest, LazyPRM, PlannerService, PlanRequest, Roadmap
from planner_service.native.loading import load_core
from planner_service.roadmap import graph, nearest, query
from planner_service.roadmap.nearest import nearest_places
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem, SearchSpace
from tests.support.optional import present

if TYPE_CHECKING:
    from planner_service.native import _core

DISCS = PlannerService("planar2", "discs")
DISCS_SPACE = SearchSpace(DISCS.robot.limits.lower, DISCS.robot.limits.upper, SearchOracle(DISCS.checker))


def asked(roadmap: Roadmap) -> list[tuple[object, ...]]:
    """Paths, counts and what was learned of some queries, each of the roadmap that the one before left."""
    rng, found = np.random.default_rng(3), list[tuple[object, ...]]()
    limits, checker = DISCS.robot.limits, DISCS.checker
    Q = rng.uniform(limits.lower, limits.upper, (40, 2))
    free = Q[checker.states_are_free(Q)]
    for k, (start, goal) in enumerate(pairwise(free)):
        result = DISCS.plan(PlanRequest(start, (goal, free[-1 - k]), time_limit=None, planner=roadmap))
        roadmap = result.roadmap or roadmap
        waypoints = None if result.path is None else result.path.waypoints.tobytes()
        stages = [(report.stage, report.counts, report.note) for report in result.stages]
        found.append((waypoints, stages, roadmap.hash))
    return found


@pytest.mark.parametrize("remember", [False, True], ids=["forgets", "remembers"])
@pytest.mark.parametrize("grower", [PRM(milestones=60), LazyPRM(milestones=60)], ids=lambda p: p.name)
def test_queries_are_answered_as_in_python(
    grower: PRM | LazyPRM, remember: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    roadmap = replace(DISCS.build_roadmap(grower, progress=False), remember=remember)
    compiled = asked(roadmap)
    for module in (query, graph, nearest):
        monkeypatch.setattr(module, "load_core", lambda: None)
    assert asked(roadmap) == compiled
    assert any(note.startswith("roadmap") and "try" not in note for _, stages, _ in compiled for *_, note in stages)  # type: ignore[attr-defined]


def of_a_grid(size: int) -> Roadmap:
    """A roadmap in which many places lie equally far away."""
    rows = np.arange(size * size).reshape(size, size)
    beside, above = (
        np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((rows[:, :-1], rows[:, 1:]), (rows[:-1], rows[1:]))
    )
    across = np.stack([rows[:-1, 1:].ravel(), rows[1:, :-1].ravel()], axis=1)
    return Roadmap.of(np.stack(np.divmod(rows.ravel(), size), axis=1) / 2.0, np.concatenate([beside, above, across]))


@pytest.mark.parametrize("share", [0.0, 0.2, 0.6, 1.0])
@pytest.mark.parametrize("size", [0, 3, 40])
@pytest.mark.parametrize("paths", [0, 5])
def test_the_nearest_places_are_those_of_python(
    size: int, paths: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(size)
    for roadmap in (of_a_grid(size), LazyPRM(milestones=400).grow(DISCS_SPACE)) if size else (of_a_grid(0),):
        for _ in range(paths):
            roadmap = roadmap.with_path(rng.integers(0, 40, (4, 2)) / 4.0)
        offered = rng.random(len(roadmap.milestones)) < 0.7, rng.random(len(roadmap.edges)) < share
        for q in [*rng.random((5, 2)) * 10.0, *rng.integers(0, 40, (5, 2)) / 4.0]:
            compiled = [*nearest_places(roadmap.graph, *offered, q)]
            with monkeypatch.context() as patch:
                patch.setattr(nearest, "load_core", lambda: None)
                assert [*nearest_places(roadmap.graph, *offered, q)] == compiled


def test_places_beyond_the_last_that_is_looked_at_are_those_of_python(monkeypatch: pytest.MonkeyPatch) -> None:
    roadmap, rng = of_a_grid(60), np.random.default_rng(5)
    offered, free = np.ones(len(roadmap.milestones), dtype=bool), rng.random(len(roadmap.edges)) < 0.5
    q = np.array([13.317, 14.2041])
    compiled = [*nearest_places(roadmap.graph, offered, free, q)]
    monkeypatch.setattr(nearest, "load_core", lambda: None)
    assert [*nearest_places(roadmap.graph, offered, free, q)] == compiled
    assert 100 < len(compiled) < 1024


@pytest.mark.parametrize("states", [0, 1, 7, 20, 60, 150, 400])
def test_a_query_that_is_stopped_has_learned_what_it_has_in_python(
    states: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    roadmap = DISCS.build_roadmap(LazyPRM(milestones=60), progress=False)
    limits = DISCS.robot.limits
    ends = np.array([-2.5, 2.0]), np.array([[2.2, -2.2]])

    def stopped() -> tuple[object, ...]:
        problem = SearchProblem(*ends, limits.lower, limits.upper, SearchOracle(DISCS.checker))
        before = DISCS.checker.counts
        with DISCS.checker.limited(states=states):
            answer = roadmap.search(problem)
        waypoints = None if answer.waypoints is None else answer.waypoints.tobytes()
        return type(answer.stopped), waypoints, answer.roadmap.hash, DISCS.checker.counts - before

    compiled = stopped()
    monkeypatch.setattr(query, "load_core", lambda: None)
    assert stopped() == compiled


def test_a_milestone_beyond_the_joint_limits_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = DISCS.robot.limits
    start, goal = np.array([-2.5, 2.0]), np.array([[2.2, -2.2]])
    roadmap = Roadmap.of([start, limits.upper + 1.0, goal[0]], [(0, 1), (1, 2)])
    problem = SearchProblem(start, goal, limits.lower, limits.upper, SearchOracle(DISCS.checker))
    before = DISCS.checker.counts
    with pytest.raises(InvalidRequest, match="expected shoulder in"):
        roadmap.search(problem)
    compiled, before = DISCS.checker.counts - before, DISCS.checker.counts
    monkeypatch.setattr(query, "load_core", lambda: None)
    with pytest.raises(InvalidRequest, match="expected shoulder in"):
        roadmap.search(problem)
    assert DISCS.checker.counts - before == compiled


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
