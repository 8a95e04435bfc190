"""Compiled smoothing against its reference in Python: the same bits, counts and names, wherever a limit ends it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planner_service import CollisionChecker, JointPath, load_robot
from planner_service.collision.budget import CheckBudgetSpent
from planner_service.geometry.arrays import FloatArray
from planner_service.scene.loading import load_scene
from planner_service.search.problem import SearchOracle
from planner_service.smoothing.smoothing import MIN_BLEND, blended, pulled_in, shortcut, without_short_pieces
from tests.reference import smoothing as reference
from tests.reference.edges import ReferenceOracle
from tests.support.discs import DiscWorld
from tests.support.steps import InPython


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
            made.append(blended(sharp, oracle, sizes).blends.tolist())
    except CheckBudgetSpent as spent:
        made.append(str(spent))
    return made, checker.counts, checker.ledger.hits, checker.last_hit


def plainly(checker: CollisionChecker, path: FloatArray, seed: int) -> tuple[Any, ...]:
    """The same in Python."""
    oracle = ReferenceOracle(checker)
    made: list[Any] = [reference.shortcut(path, oracle, np.random.default_rng(seed))]
    made.append(reference.pulled_in(made[-1], oracle))
    made.append(reference.without_short_pieces(made[-1], oracle))
    sharp = JointPath(np.array(made[-1]))
    sizes = np.random.default_rng(seed).choice([0.0, 0.1, 0.4], len(sharp.waypoints))
    widths = reference.blended(sharp, checker.blend_is_free, sizes, MIN_BLEND).blends.tolist()
    chains = [[list(q) for q in chain] for chain in made]
    return [*chains, widths], checker.counts, checker.ledger.hits, checker.last_hit


@pytest.mark.parametrize(("name", "where"), [("planar2", "discs"), ("wxai", "clutter"), ("panda", "shelf")])
@pytest.mark.parametrize("seed", range(3))
def test_it_finds_the_path_of_its_reference_at_the_same_counts(name: str, where: str, seed: int) -> None:
    robot, scene, rng = load_robot(name), load_scene(where), np.random.default_rng([len(name), seed])
    path = free_path(CollisionChecker(robot, scene), rng)
    assert smoothed(CollisionChecker(robot, scene), path, seed) == plainly(CollisionChecker(robot, scene), path, seed)


@pytest.mark.parametrize(("name", "where"), [("planar2", "discs"), ("wxai", "clutter")])
@pytest.mark.parametrize("seed", range(3))
def test_with_a_step_of_ones_own_path_and_counts_are_the_same_wherever_it_is_ended(
    name: str, where: str, seed: int
) -> None:
    robot, scene, rng = load_robot(name), load_scene(where), np.random.default_rng([len(name), seed])
    path = free_path(CollisionChecker(robot, scene), rng)
    whole: int | None = None
    for share in (None, 0.0, 0.1, 0.5, 0.9):
        states = None if share is None or whole is None else int(share * whole)
        checkers = CollisionChecker(robot, scene), CollisionChecker(robot, scene, edge_step=InPython())
        compiled, python = (smoothed(checker, path, seed, states) for checker in checkers)
        assert compiled == python
        whole = compiled[1].states if whole is None else whole


@pytest.mark.parametrize(("size", "left"), [(0.0999, 2), (0.1, 3)])
def test_a_piece_is_short_below_a_length(size: float, left: int) -> None:
    oracle = SearchOracle(CollisionChecker(load_robot("planar2"), load_scene("empty")))
    assert len(without_short_pieces([[0.0, 0.0], [size, 0.0], [size, 1.0]], oracle)) == left


def test_an_oracle_of_ones_own_is_asked() -> None:
    world = DiscWorld(())
    short = shortcut([[0.0, 0.0], [0.2, 0.2], [0.4, 0.0]], world, np.random.default_rng(0))
    assert short.tolist() == [[0.0, 0.0], [0.4, 0.0]]
    assert world.states > 0
