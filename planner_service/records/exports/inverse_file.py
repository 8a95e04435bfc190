"""Proofs of complete inverse kinematics, in files, for a verifier that shares no code with this package.

``auditor/verify_inverse.py`` checks one: that each configuration is alone in its box, and that there are no others
within the joint limits; ``docs/guides/proofs-for-others.md`` says what that means.
"""

from __future__ import annotations

import json
import os
from typing import Any

from planner_service.errors import InvalidRequest
from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance
from planner_service.kinematics.complete_inverse import complete_solutions, most_joints, shown_solutions
from planner_service.kinematics.inverse import ToolChain
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.records.evidence import packed
from planner_service.records.plan_file import OURS
from planner_service.records.robot import RobotRecord
from planner_service.robot.model import Robot

__all__ = ["INVERSE_FORMAT", "inverse_document", "save_inverse"]

INVERSE_FORMAT = "planner-service/inverse"
VERSION = 1


def save_inverse(robot: Robot, pose: Pose | PoseGoal, path: str | os.PathLike[str]) -> None:
    """Write all configurations for a pose, and what shows that they are all, to a file, whole or not at all.

    Raises:
        InvalidRequest: ``pose`` is neither a Pose nor a PoseGoal, the arm has more joints than the goal determines, or
            some configurations are in doubt.
        InvalidFile: It cannot be written.
    """
    document = inverse_document(robot, pose)
    write_whole(as_path("path", path), json.dumps(document, allow_nan=False) + "\n", OURS)


def inverse_document(robot: Robot, pose: Pose | PoseGoal) -> dict[str, Any]:
    """What a file holds; see ``save_inverse``."""
    instance("robot", robot, Robot, "a Robot")
    goal = PoseGoal(pose) if isinstance(pose, Pose) else instance("pose", pose, PoseGoal, "a Pose or a PoseGoal")
    chain = ToolChain.of(robot, robot.home)
    arm = chain.robot
    if arm.n > most_joints(goal):
        complete_solutions(arm, goal)  # refuses it
    found, trail = shown_solutions(arm, goal)
    if not found.complete:
        raise InvalidRequest("pose", pose, f"a goal of which nothing is in doubt: {len(found.unresolved)} boxes are")
    at = goal.pose
    room = {
        "position_tolerance": goal.position_tolerance,
        "orientation_tolerance": goal.orientation_tolerance,
        "free_axis": None if goal.free_axis is None else list(goal.free_axis),
        "candidates": goal.candidates,
    }
    return {
        "format": INVERSE_FORMAT,
        "version": VERSION,
        "robot": RobotRecord.of(robot).document(),
        "joints": [robot.joint_names[k] for k in chain.columns],
        "goal": {"pose": {"position": list(at.position), "quaternion_wxyz": list(at.quaternion)}, "room": room},
        "q": found.q.tolist(),
        "lower": found.lower.tolist(),
        "upper": found.upper.tolist(),
        "points": packed(trail.points, "<f8"),
        "domain": packed(trail.domain, "<f8"),
        "found": packed(trail.found.reshape(-1, 5 * arm.n), "<f8"),
        "steps": packed(trail.steps, "<f8"),
        "sums": packed(trail.sums, "<f8"),
        "equations": packed(trail.equations, "<f8"),
        "followed": packed(trail.followed, "<f8"),
    }
