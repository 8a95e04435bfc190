"""Stored poses and requests without a plan are what they say."""

from __future__ import annotations

from benchmarks.worlds import blocked_poses, failures
from planner_service import CollisionChecker
from planner_service.kinematics.inverse import inverse_is_complete, inverse_kinematics
from planner_service.robot_setup.loading import load_robot


def test_stored_failures_are_written_as_they_are_read() -> None:
    stored = failures.load()
    assert failures.text_of(stored) == failures.FILE.read_text("utf-8")
    assert len(stored) == failures.COUNT
    assert {one.kind for one in stored} == {kind for kind, _ in failures.KINDS}


def test_no_configuration_of_a_stored_pose_is_free() -> None:
    stored, robot = blocked_poses.load(), load_robot(blocked_poses.ROBOT)
    assert blocked_poses.text_of(stored) == blocked_poses.FILE.read_text("utf-8")
    assert len(stored) == blocked_poses.COUNT
    for one in stored[:5]:
        solutions = inverse_kinematics(robot, one.pose)
        assert len(solutions) == one.solutions
        assert inverse_is_complete(robot, one.pose)
        checker = CollisionChecker(robot, one.scene)
        assert not any(checker.state_is_free(q) for q in solutions)
        assert checker.state_is_free(robot.home)
