"""Searching and shortening on constraints: the compiled form against its reference, and what both promise."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest

from planner_service import BalancedRRTConnect, CollisionChecker, JointPath, Pose, load_robot
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.constraints import InBox
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.constraint_set import ConstraintSet, projector_of
from planner_service.native._core import Projector
from planner_service.scene.loading import load_scene
from planner_service.search.problem import ConstrainedOracle, SearchOracle, SearchProblem
from planner_service.smoothing.smoothing import blended, pulled_in, shortcut_on_constraints, without_short_pieces
from tests.reference.edges import ReferenceOracle
from tests.reference.projector import ReferenceProjector
from tests.reference.search import ReferenceSearch
from tests.support.constraints import CASES, case, kept_configurations
from tests.support.optional import present
from tests.support.steps import InPython

SCENES = {"upright": "bin", "narrow": "shelf", "plane": "post", "line": "empty", "above a bound": "post"}


def outcome(name: str, seed: int, *, step: InPython | None = None, states: int = 20_000) -> tuple[Any, ...]:
    """What a search and each step of smoothing make, and all that is counted."""
    robot, constraints, projector = case(name)
    scene = load_scene(SCENES.get(name, "empty"))
    checker = CollisionChecker(robot, scene, padding=0.001, edge_step=step)
    start, goal = map(
        np.array, kept_configurations(constraints, projector, CollisionChecker(robot, scene, padding=0.001), seed)
    )
    inner = SearchOracle(checker, [start], [goal])
    oracle, made = ConstrainedOracle(inner, projector), list[Any]()
    limits = constraints.lower, constraints.upper
    problem = SearchProblem(start, goal[None], *limits, inner, seed, checker.ledger.poll, projector=projector)
    try:
        with checker.limited(states=states):
            found = BalancedRRTConnect().search(problem).waypoints
            assert found is not None
            made.append(found.tolist())
            made.append(shortcut_on_constraints(found, oracle, np.random.default_rng(seed)).tolist())
            made.append(pulled_in(np.array(made[-1]), oracle).tolist())
            made.append(without_short_pieces(np.array(made[-1]), oracle).tolist())
            path = JointPath(np.array(made[-1]))
            made.append(blended(path, oracle, np.full(len(path.waypoints), 0.5)).blends.tolist())
    except CheckBudgetSpent as spent:
        made.append(str(spent))
    return made, checker.counts, checker.ledger.hits, projector.take()


@pytest.mark.parametrize("name", [name for name in CASES if name not in {"orientation in a box", "both hands"}])
def test_a_search_gives_the_bits_and_counts_of_its_reference(name: str) -> None:
    robot, constraints, projector = case(name)
    scene = load_scene(SCENES.get(name, "empty"))
    for seed in range(2):
        checkers = [CollisionChecker(robot, scene, padding=0.001) for _ in range(3)]
        start, goal = map(np.array, kept_configurations(constraints, projector, checkers[2], seed))
        limits, grown, planner = (constraints.lower, constraints.upper), list[Any](), BalancedRRTConnect()

        def keep(nodes: FloatArray, edges: Any, grown: list[Any] = grown) -> None:
            grown.append((nodes.tolist(), edges))

        inner, plain = SearchOracle(checkers[0], [start], [goal]), ReferenceOracle(checkers[1])
        compiled = SearchProblem(start, goal[None], *limits, inner, seed, grown=keep, projector=projector)
        python = ReferenceProjector(constraints)
        projector.take()
        path, expected = list[Any](), list[Any]()
        with suppress(CheckBudgetSpent), checkers[0].limited(states=250):
            path = present(planner.search(compiled).waypoints).tolist()
        projections = projector.take()
        asked = SearchProblem(start, goal[None], *limits, plain, seed, projector=cast(Projector, python))
        run = ReferenceSearch(asked, planner.range, seed)
        with suppress(CheckBudgetSpent), checkers[1].limited(states=250):
            expected = [list(q) for q in run.run(tuple(start.tolist()), [tuple(goal.tolist())])]
        nodes, edges = run.grown()
        assert path == expected
        assert grown == [([list(q) for q in nodes], edges)]
        assert checkers[0].counts == checkers[1].counts
        assert projections == python.take() > 0


@pytest.mark.parametrize("name", ["upright", "plane", "line"])
def test_shortening_keeps_ends_and_constraints_and_is_never_longer(name: str) -> None:
    robot, _, projector = case(name)
    for seed in range(5):
        (found, short, pulled, tidy, _), *_ = outcome(name, seed)
        for before, after in pairwise((found, short, pulled, tidy)):
            assert (after[0], after[-1]) == (before[0], before[-1])
            assert JointPath(np.array(after)).length <= JointPath(np.array(before)).length * (1.0 + 1e-9)
        for a, b in pairwise(tidy):
            assert max(projector.share(tuple(q)) for q in np.linspace(a, b, 100).tolist()) <= 1.0
    assert robot.n == len(found[0])


@pytest.mark.parametrize("step", [None, InPython()])
def test_a_search_of_which_constraints_leave_nothing_gives_up(step: InPython | None) -> None:
    """A tool held at a point reaches it with two elbows, and with nothing in between."""
    robot = load_robot("planar2")
    at = robot.tool_pose([0.4, 1.0])[:3, 3]
    projector = projector_of(ConstraintSet(robot, [InBox(Pose(tuple(at)), (2e-4, 2e-4, 1.0))]))
    limits, checker = robot.limits, CollisionChecker(robot, load_scene("empty"), edge_step=step)
    other = projector.project((1.4, -1.0))
    assert other is not None
    problem = SearchProblem(
        np.array([0.4, 1.0]), np.array([other]), limits.lower, limits.upper, SearchOracle(checker), projector=projector
    )
    assert BalancedRRTConnect().search(problem).waypoints is None
