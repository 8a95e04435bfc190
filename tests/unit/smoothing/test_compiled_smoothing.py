"""Compiled smoothing against its reference in Python: the same bits, counts and names, wherever a limit ends it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner_service import CollisionChecker, JointPath, load_robot
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray
from planner_service.native.loading import load_core
from planner_service.scene.worlds import load_world
from planner_service.search.edge_cache import SearchOracle
from planner_service.smoothing.smoothing import blended, pulled_in, shortcut, without_short_pieces
from tests.support.discs import DiscWorld
from tests.support.steps import InPython

pytestmark = pytest.mark.skipif(load_core() is None, reason="nothing is compiled here")


def free_path(checker: CollisionChecker, rng: np.random.Generator) -> FloatArray:
    """A free polyline of up to 14 waypoints, some of them twice, with pieces from long to very short."""
    limits = checker.robot.limits
    points: list[FloatArray] = []
    while not points:
        q = rng.uniform(limits.lower, limits.upper)
        points += [q] if checker.state_is_free(q) else []
    for _ in range(60):
        step = rng.choice([0.03, 0.3, 1.0]) * rng.normal(size=len(points[-1]))
        q = np.clip(points[-1] + step, limits.lower, limits.upper)
        if len(points) < 14 and checker.edge_is_free(points[-1], q):
            points += [q] * int(rng.integers(1, 3))
    return np.array(points)


def smoothed(checker: CollisionChecker, path: FloatArray, seed: int, states: int | None = None) -> tuple[Any, ...]:
    """What each step of smoothing makes of a path until a number of states is spent, and what was counted."""
    oracle, made = SearchOracle(checker), list[Any]()
    try:
        with checker.limited(states=states):
            made.append(shortcut(path, oracle, np.random.default_rng(seed)).tolist())
            made.append(pulled_in(np.array(made[-1]), oracle).tolist())
            made.append(without_short_pieces(np.array(made[-1]), oracle).tolist())
            sharp = JointPath(np.array(made[-1]))
            sizes = np.random.default_rng(seed).choice([0.0, 0.1, 0.4], len(sharp.waypoints))
            made.append(blended(sharp, checker.blend_is_free, sizes, oracle=oracle).blends.tolist())
    except CheckBudgetSpent as spent:
        made.append(str(spent))
    return made, checker.counts, checker.ledger.hits, checker.last_hit


@pytest.mark.parametrize(("name", "where"), [("planar2", "discs"), ("wxai", "clutter"), ("panda", "shelf")])
@pytest.mark.parametrize("seed", range(8))
def test_both_find_the_same_path_and_count_the_same_wherever_they_are_ended(name: str, where: str, seed: int) -> None:
    robot, scene, rng = load_robot(name), load_world(where), np.random.default_rng([len(name), seed])
    path = free_path(CollisionChecker(robot, scene), rng)
    whole: int | None = None
    for share in (None, 0.0, 0.1, 0.5, 0.9):
        states = None if share is None or whole is None else int(share * whole)
        checkers = CollisionChecker(robot, scene), CollisionChecker(robot, scene, edge_step=InPython())
        compiled, python = (smoothed(checker, path, seed, states) for checker in checkers)
        assert compiled == python
        whole = compiled[1].states if whole is None else whole


@pytest.mark.parametrize(("size", "left"), [(0.0999, 2), (0.1, 3)])
def test_a_piece_is_short_below_the_same_length_in_both(size: float, left: int) -> None:
    for step in (None, InPython()):
        oracle = SearchOracle(CollisionChecker(load_robot("planar2"), load_world("empty"), edge_step=step))
        assert len(without_short_pieces([[0.0, 0.0], [size, 0.0], [size, 1.0]], oracle)) == left


def test_both_leave_the_generator_at_the_same_number() -> None:
    rngs = []
    for step in (None, InPython()):
        oracle = SearchOracle(CollisionChecker(load_robot("planar2"), load_world("empty"), edge_step=step))
        rngs.append(np.random.default_rng(3))
        shortcut([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], oracle, rngs[-1])
    assert rngs[0].random() == rngs[1].random()


def test_an_oracle_without_a_compiled_part_is_asked_from_python() -> None:
    world = DiscWorld(())
    short = shortcut([[0.0, 0.0], [0.2, 0.2], [0.4, 0.0]], world, np.random.default_rng(0))
    assert short.tolist() == [[0.0, 0.0], [0.4, 0.0]]
    assert world.states > 0
