"""Stored queries without a plan are what they say."""

from __future__ import annotations

from benchmarks.worlds import unsolvable
from planner_service import CollisionChecker
from planner_service.infeasibility import prove_no_path
from planner_service.kinematics.inverse import inverse_is_complete, inverse_kinematics
from planner_service.robot_setup.loading import load_robot


def test_a_pocket_has_free_ends_and_is_proven() -> None:
    pocket = unsolvable.load_pockets()[0]
    robot = load_robot(pocket.robot)
    assert CollisionChecker(robot, pocket.scene).states_are_free([pocket.start, pocket.goal]).all()
    assert prove_no_path(robot, pocket.scene, pocket.start, [pocket.goal]) is not None


def test_no_configuration_of_a_stored_pose_is_free() -> None:
    stored, robot = unsolvable.load_poses(), load_robot(unsolvable.POSES_ROBOT)
    assert len(stored) == 100
    for one in stored[:5]:
        solutions = inverse_kinematics(robot, one.pose)
        assert len(solutions) == one.solutions
        assert inverse_is_complete(robot, one.pose)
        checker = CollisionChecker(robot, one.scene)
        assert not any(checker.state_is_free(q) for q in solutions)
        assert checker.state_is_free(robot.home)
