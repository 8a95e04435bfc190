"""Searching and shortening on constraints: the compiled form against its reference, and what both promise."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from planner_service import BalancedRRTConnect, CollisionChecker, JointPath, Pose, load_robot
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.constraints import InBox
from planner_service.kinematics.constraint_set import ConstraintSet
from planner_service.kinematics.projection import ReferenceProjector, projector_of
from planner_service.scene.worlds import load_world
from planner_service.search.constrained import ConstrainedOracle
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem
from planner_service.smoothing.constrained import blend_is_kept, shortcut_on_constraints
from planner_service.smoothing.smoothing import blended, pulled_in, without_short_pieces
from tests.support.constraints import CASES, case, kept_configurations
from tests.support.steps import InPython

SCENES = {"upright": "bin", "narrow": "shelf", "plane": "post", "line": "empty", "above a bound": "post"}


def outcome(name: str, seed: int, *, compiled: bool, states: int = 20_000) -> tuple[Any, ...]:
    """What a search and each step of smoothing make, and all that is counted."""
    robot, constraints, projector = case(name)
    scene = load_world(SCENES.get(name, "empty"))
    checker = CollisionChecker(robot, scene, padding=0.001, edge_step=None if compiled else InPython())
    start, goal = map(
        np.array, kept_configurations(constraints, projector, CollisionChecker(robot, scene, padding=0.001), seed)
    )
    if not compiled:
        projector = ReferenceProjector(constraints)
    inner = SearchOracle(checker, [start], [goal])
    oracle, made = ConstrainedOracle(inner, projector), list[Any]()
    assert (oracle.core is not None) == compiled
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

            def is_free(path: JointPath, k: int) -> bool:
                return blend_is_kept(path, k, projector) and checker.blend_is_free(path, k)

            sizes = np.full(len(path.waypoints), 0.5)
            made.append(blended(path, is_free, sizes, oracle=oracle).blends.tolist())
    except CheckBudgetSpent as spent:
        made.append(str(spent))
    return made, checker.counts, checker.ledger.hits, projector.take()


@pytest.mark.parametrize("name", [name for name in CASES if name not in {"orientation in a box", "both hands"}])
def test_compiled_and_in_python_there_are_the_same_bits_and_counts(name: str) -> None:
    for seed in range(2):
        compiled = outcome(name, seed, compiled=True, states=250)
        assert compiled == outcome(name, seed, compiled=False, states=250)
        assert compiled[-1] > 0


def test_a_budget_ends_both_at_the_same_check() -> None:
    whole = outcome("upright", 1, compiled=True)[1].states
    for share in (0.1, 0.5, 0.9):
        states = int(share * whole)
        ended = outcome("upright", 1, compiled=True, states=states)
        assert ended[0][-1] == "the check budget is spent"
        assert ended == outcome("upright", 1, compiled=False, states=states)


@pytest.mark.parametrize("name", ["upright", "plane", "line"])
def test_shortening_keeps_ends_and_constraints_and_is_never_longer(name: str) -> None:
    robot, _, projector = case(name)
    for seed in range(5):
        (found, short, pulled, tidy, _), *_ = outcome(name, seed, compiled=True)
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
    limits, checker = robot.limits, CollisionChecker(robot, load_world("empty"), edge_step=step)
    other = projector.project((1.4, -1.0))
    assert other is not None
    problem = SearchProblem(
        np.array([0.4, 1.0]), np.array([other]), limits.lower, limits.upper, SearchOracle(checker), projector=projector
    )
    assert BalancedRRTConnect().search(problem).waypoints is None
