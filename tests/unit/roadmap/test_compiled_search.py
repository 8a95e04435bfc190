"""The compiled search of a roadmap finds the paths of the Python code, and learns the same."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from planner_service import PRM, LazyPRM, PlannerService, PlanRequest, Roadmap
from planner_service.native.loading import load_core
from planner_service.roadmap import graph, nearest, query
from planner_service.roadmap.nearest import nearest_places
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchSpace
from tests.support.optional import present

DISCS = PlannerService("planar2", "discs")
DISCS_SPACE = SearchSpace(DISCS.robot.limits.lower, DISCS.robot.limits.upper, SearchOracle(DISCS.checker))


def asked(roadmap: Roadmap) -> list[tuple[object, ...]]:
    """Paths, counts and what was learned of some queries, each asked of what the one before left."""
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


def test_neighbours_that_are_none_are_refused() -> None:
    core = present(load_core())
    one, two = np.array([0, 1]), np.array([0, 0])
    with pytest.raises(ValueError, match="rows of all nodes"):
        core.Neighbours(two, one[:1], np.ones(1), two[:1])
    trunk = core.Neighbours(one, np.array([5]), np.ones(1), np.array([0]))
    verdicts = np.zeros(2, dtype=np.uint8)
    with pytest.raises(ValueError, match="a bound and a verdict"):
        core.shortest(trunk, core.AddedNeighbours({}), {}, np.zeros(2), verdicts, verdicts, 0, 1, 100, lambda: None)


def test_places_that_are_none_are_refused() -> None:
    core = present(load_core())
    one, none, reach = np.zeros((1, 2)), np.array([-1]), np.ones(2)
    with pytest.raises(ValueError, match="a reach for each joint"):
        core.PlaceTree(one, none, np.ones(3))
    with pytest.raises(ValueError, match="not finite"):
        core.PlaceTree(one * np.nan, none, reach)
    with pytest.raises(ValueError, match="an edge and a milestone"):
        core.MorePlaces(one, none, np.array([0, 1]))
    tree, no = core.PlaceTree(one, none, reach), np.zeros(0, dtype=bool)
    for more in (core.MorePlaces(one, none, np.array([5])), core.MorePlaces(one, np.array([0]), none)):
        with pytest.raises(ValueError, match="no such milestone or edge"):
            core.nearest_places(tree, None, more, np.array([True]), no, np.zeros(2), 24)
