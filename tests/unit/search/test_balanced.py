"""The default search: its compiled form against its reference, its limits, and what it does with coarse verdicts."""

from __future__ import annotations

import math
import threading
import time
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planner_service import (
    BalancedRRTConnect,
    Box,
    CancelToken,
    CollisionChecker,
    Cylinder,
    Obstacle,
    Pose,
    Robot,
    Scene,
    load_robot,
    load_scene,
)
from planner_service.collision.budget import Cancelled, CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import polyline_length
from planner_service.search.problem import SearchOracle, SearchProblem, TieredOracle
from tests.reference.edges import ReferenceOracle
from tests.reference.search import ReferenceSearch
from tests.support.optional import present
from tests.support.steps import InPython

CASES = [("planar2", "discs"), ("wxai", "bin"), ("wxai", "clutter"), ("panda", "shelf"), ("wxai_dual", "post")]


def ends(robot: Robot, scene: Scene, seed: int) -> FloatArray:
    """Two free configurations, (2, n)."""
    checker, rng = CollisionChecker(robot, scene), np.random.default_rng(seed)
    drawn = (rng.uniform(robot.limits.lower, robot.limits.upper) for _ in range(1000))
    free = (q for q in drawn if checker.state_is_free(q))
    return np.array([next(free), next(free)])


def problem(checker: CollisionChecker, points: FloatArray, seed: int = 0, **more: Any) -> SearchProblem:
    limits = checker.robot.limits
    oracle = SearchOracle(checker, points[:1], points[1:])
    bounds, poll = (limits.lower, limits.upper), checker.ledger.poll
    return SearchProblem(points[0], points[1:], *bounds, oracle, seed, poll, checker.reach, **more)


def outcome(
    checker: CollisionChecker, points: FloatArray, seed: int, states: int = 20_000, longest: float = math.inf
) -> tuple[Any, ...]:
    """All that a search gives and counts: the path or the limit it met, the trees, the counts and hits, the ends."""
    grown: list[Any] = []
    asked = problem(
        checker, points, seed, grown=lambda nodes, edges: grown.append((nodes.tolist(), edges)), longest=longest
    )
    assert isinstance(asked.oracle, SearchOracle)
    path: Any = None
    try:
        with checker.limited(states=states):
            path = present(BalancedRRTConnect().search(asked).waypoints).tolist()
    except CheckBudgetSpent as spent:
        path = str(spent)
    return path, grown, checker.counts, checker.ledger.hits, asked.oracle.boxed_in(), asked.oracle.last_hit


def reference(
    checker: CollisionChecker, points: FloatArray, seed: int, states: int = 20_000, longest: float = math.inf
) -> tuple[Any, ...]:
    """The same of the search in Python, which asks the checker edge by edge."""
    limits, oracle = checker.robot.limits, ReferenceOracle(checker)
    bounds = limits.lower, limits.upper
    asked = SearchProblem(points[0], points[1:], *bounds, oracle, seed, reach=checker.reach, longest=longest)
    run = ReferenceSearch(asked, BalancedRRTConnect().range, seed)
    path: Any = None
    try:
        with checker.limited(states=states):
            path = [list(q) for q in run.run(tuple(points[0].tolist()), [tuple(points[1].tolist())])]
    except CheckBudgetSpent as spent:
        path = str(spent)
    nodes, edges = run.grown()
    return path, [([list(q) for q in nodes], edges)], checker.counts, checker.ledger.hits


@pytest.mark.parametrize(("name", "where"), CASES)
def test_it_gives_the_bits_and_counts_of_its_reference_with_any_step_and_judge(name: str, where: str) -> None:
    robot, scene = load_robot(name), load_scene(where)
    for seed in range(2):
        points = ends(robot, scene, seed)
        compiled = outcome(CollisionChecker(robot, scene, padding=0.001), points, seed)
        assert compiled == outcome(CollisionChecker(robot, scene, padding=0.001, edge_step=InPython()), points, seed)
        assert compiled[:4] == reference(CollisionChecker(robot, scene, padding=0.001), points, seed)
    if name == "planar2":
        assert compiled == outcome(CollisionChecker(robot, scene, padding=0.001, backend="fcl"), points, seed)


@pytest.mark.parametrize(("name", "where"), CASES)
def test_with_a_bound_it_gives_the_bits_and_counts_of_its_reference_and_no_longer_path(name: str, where: str) -> None:
    robot, scene = load_robot(name), load_scene(where)
    for seed, share in ((0, 1.2), (1, 1.6)):
        points = ends(robot, scene, seed)
        longest = share * math.dist(*points)
        compiled = outcome(CollisionChecker(robot, scene, padding=0.001), points, seed, 3_000, longest)
        assert compiled[:4] == reference(CollisionChecker(robot, scene, padding=0.001), points, seed, 3_000, longest)
        if not isinstance(compiled[0], str):
            assert polyline_length(np.array(compiled[0])) <= longest * (1.0 + 1e-12)


def test_a_bound_that_leaves_nothing_ends_the_search_without_a_path() -> None:
    robot = load_robot("wxai_dual")
    checker = CollisionChecker(robot, load_scene("post"))
    points = ends(robot, load_scene("post"), 0)
    asked = problem(checker, points, longest=0.5 * math.dist(*points))
    assert BalancedRRTConnect().search(asked).waypoints is None


def tight_ends(robot: Robot, scene: Scene, seed: int) -> FloatArray:
    """Two free configurations that are closer to something than 5 mm, (2, n)."""
    checker, rng = CollisionChecker(robot, scene), np.random.default_rng(seed)
    roomy, found = checker.variant(padding=0.005), list[FloatArray]()
    while len(found) < 2:
        free, other = rng.uniform(robot.limits.lower, robot.limits.upper, (2, robot.n))
        if checker.state_is_free(other) or not roomy.state_is_free(free):
            continue
        while roomy.state_is_free(free) or not checker.state_is_free(free):
            middle = (free + other) / 2.0
            free, other = (middle, other) if roomy.state_is_free(middle) else (free, middle)
            if checker.state_is_free(other) and not roomy.state_is_free(other):
                free = other
        found.append(free)
    return np.array(found)


@pytest.mark.parametrize("name", ["wxai", "planar2"])
def test_with_less_padding_near_tight_ends_it_gives_the_same_bits_and_counts(name: str) -> None:
    robot, scene = load_robot(name), load_scene("discs" if name == "planar2" else "shelf")
    for seed in range(3):
        points, outcomes = tight_ends(robot, scene, seed), list[Any]()
        for step in (None, InPython()):
            checker = CollisionChecker(robot, scene, edge_step=step)
            tight = {tuple(q.tolist()): SearchOracle(checker) for q in points}
            oracle = TieredOracle(SearchOracle(checker.variant(padding=0.005), points[:1], points[1:]), tight)
            limits = robot.limits
            asked = SearchProblem(points[0], points[1:], limits.lower, limits.upper, oracle, seed, checker.ledger.poll)
            with checker.limited(states=20_000):
                path = present(BalancedRRTConnect().search(asked).waypoints)
            outcomes.append((path.tolist(), checker.counts, checker.ledger.hits))
            assert all(oracle.edge_is_free(a, b) for a, b in pairwise(path))
        assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("states", [0, 17, 333])
def test_a_budget_of_states_ends_it_at_the_same_state(states: int) -> None:
    robot, scene = load_robot("wxai"), load_scene("clutter")
    points = ends(robot, scene, 3)
    checkers = CollisionChecker(robot, scene), CollisionChecker(robot, scene, edge_step=InPython())
    compiled, plain = (outcome(checker, points, 5, states) for checker in checkers)
    assert compiled == plain
    assert compiled[0] == "the check budget is spent"
    assert checkers[0].counts.states == states


def rods(*places: tuple[float, float]) -> Scene:
    """Thin upright rods around the planar arm."""
    rod = Cylinder(0.01, 0.2)
    return Scene(tuple(Obstacle(f"rod_{k}", rod, Pose((*xy, 0.0))) for k, xy in enumerate(places)))


def boxed_in() -> Scene:
    """The planar arm stretched out backwards is between two plates closer than any motion."""
    plates = [(f"plate_{y:+g}", Box((0.4, 0.1, 0.2)), Pose((-1.3, y, 0.0))) for y in (0.07, -0.07)]
    stop = ("stop", Box((0.02, 0.2, 0.2)), Pose((-1.53, 0.0, 0.0)))
    return Scene(tuple(Obstacle(*each) for each in [*plates, stop]))


def test_another_thread_can_cancel_it_and_the_checker_goes_on() -> None:
    robot, token = load_robot("planar2"), CancelToken()
    checker, points = CollisionChecker(robot, boxed_in()), np.array([[0.0, 0.0], [np.pi, 0.0]])
    asked = problem(checker, points)
    timer = threading.Timer(0.1, token.cancel)
    timer.start()
    before = time.monotonic()
    with checker.limited(token=token), pytest.raises(Cancelled):
        BalancedRRTConnect().search(asked)
    assert time.monotonic() - before < 10.0
    timer.join()
    elsewhere = problem(checker, np.array([[0.0, 0.0], [2.0, 0.5]]))
    assert BalancedRRTConnect().search(elsewhere).waypoints is not None


def test_edges_that_a_first_look_finds_free_are_judged_in_full_before_they_are_a_path() -> None:
    fence = [(1.25 * np.cos(angle), 1.25 * np.sin(angle)) for angle in np.arange(0.5, 6.0, 0.45)]
    robot, scene, refuted = load_robot("planar2"), rods(*fence), 0
    for seed in range(20):
        points = ends(robot, scene, seed)
        checkers = CollisionChecker(robot, scene), CollisionChecker(robot, scene, edge_step=InPython())
        compiled, plain = (outcome(checker, points, seed) for checker in checkers)
        assert compiled == plain
        judge = CollisionChecker(robot, scene)
        assert all(judge.edge_is_free(a, b) for a, b in pairwise(compiled[0]))
        refuted += len(compiled[1][0][0]) < compiled[2].edges
    assert refuted > 0
