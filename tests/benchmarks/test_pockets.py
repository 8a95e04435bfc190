"""Stored queries without a path are what they say."""

from __future__ import annotations

from benchmarks.worlds.pockets import COUNTS, FILE, load, text_of
from planner_service import CollisionChecker
from planner_service.infeasibility import prove_no_path
from planner_service.robot_setup.loading import load_robot


def test_stored_pockets_are_written_as_they_are_read() -> None:
    pockets = load()
    assert text_of(pockets) == FILE.read_text("utf-8")
    kinds = [(pocket.robot, pocket.joints) for pocket in pockets]
    assert {kind: kinds.count(kind) for kind in COUNTS} == COUNTS


def test_a_pocket_has_free_ends_and_is_proven() -> None:
    pocket = load()[0]
    robot = load_robot(pocket.robot)
    assert CollisionChecker(robot, pocket.scene).states_are_free([pocket.start, pocket.goal]).all()
    assert prove_no_path(robot, pocket.scene, pocket.start, [pocket.goal]) is not None
