"""What must hold where fingers may touch an object: the grasp is sound, and the tool goes straight to it."""

from __future__ import annotations

import math

import numpy as np

from planner_service.collision import CollisionChecker
from planner_service.geometry.arrays import FloatArray, cross
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import width_across
from planner_service.grasping.hand import MEANT_OVERLAP, HandCheck, grips_at_tips
from planner_service.grasping.held import Held, held_by
from planner_service.kinematics.tool_line import LINE_METRES, LINE_RADIANS
from planner_service.path.joint_path import JointPath
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = [
    "LONGEST_APPROACH",
    "LOOSE_GRASP",
    "MEANT_OVERLAP",
    "PUSHED_ASIDE",
    "grasp_objection",
    "hand_objection",
    "reach_objection",
    "rim_gaps",
    "tool_frames",
    "tool_line",
    "unwanted",
]

LONGEST_APPROACH = 0.10
"""Metres of straight motion before and after a contact, at most."""

LOOSE_GRASP = 0.01
"""Metres by which the point between the fingertips may miss the object: the pads reach that far."""

LOOSE_CUP = 0.002
"""Metres that the rim of a cup may be away from what it takes: it yields as far."""

RIM_POINTS = 16

PUSHED_ASIDE = 0.003
"""Metres by which closing fingers may push the object aside: the error of a grasp from a camera."""

MISSED = "the fingers would not reach both sides of {}"

SLACK = 1.1
"""Factor on the tolerance with which straight tool lines are planned."""

SPACING = 0.005
"""Radians of path between samples of the tool, which moves a few millimetres meanwhile."""

MAX_SAMPLES = 4000
"""A line of 10 cm needs a hundred. An arm that turns about its tool all the time is refused."""

Pair = tuple[str, str]


def grasp_objection(target: Obstacle, grasp: Pose, robot: Robot, hand: HandCheck | None = None) -> str:
    """Why fingers that close at a grasp, or its cup, would not hold an object where it stands; empty if they would.

    Args:
        hand: The robot's hand and the object, if there is one already.
    """
    gripper = robot.gripper
    if gripper is None:
        return f"{robot.name} has no gripper"
    if gripper.kind == "vacuum":
        away = max(rim_gaps(target, grasp, gripper))
        return f"the cup is up to {away * 1000:.1f} mm away from {target.name}" if away > LOOSE_CUP else ""
    held = held_by(target, grasp, robot)
    if held.beyond > LOOSE_GRASP:
        return f"the fingertips are {held.beyond * 1000:.0f} mm away from {target.name}"
    if held.width > gripper.upper:
        wide, most = held.width * 1000, gripper.upper * 1000
        return f"{target.name} is {wide:.1f} mm wide between fingers that open {most:.1f} mm"
    if held.aside > PUSHED_ASIDE:
        return f"closing would push {target.name} {held.aside * 1000:.0f} mm aside"
    if not held.reached:
        return MISSED.format(target.name)
    if held.straight and grips_at_tips(robot):
        return ""
    return _closed_objection(target, grasp, robot, held, hand)


def _closed_objection(target: Obstacle, grasp: Pose, robot: Robot, held: Held, hand: HandCheck | None) -> str:
    """Why fingers would not stop where they are said to meet a part of an object."""
    gripper = robot.gripper
    assert gripper is not None
    x, y, z = (held.shift * axis for axis in gripper.closing)  # by which they push the object
    seen, hand = Pose((x, y, z)) @ grasp.inverse() @ target.pose, hand or HandCheck(robot, target.shape)
    if held.whole:  # what the palm touches is for the checker to find
        return "" if hand.meets(seen, held.width) else MISSED.format(target.name)
    return hand_objection(hand, target, seen, held.width)


def hand_objection(hand: HandCheck, target: Obstacle, seen: Pose, width: float) -> str:
    """Why a hand would not hold an object between fingers ``width`` metres apart; FCL decides, to a millimetre."""
    inside = hand.touching(seen, width + 2.0 * MEANT_OVERLAP)
    if inside:
        links = ", ".join(sorted(inside))
        return f"closed to {width * 1000:.1f} mm, the gripper would stand inside {target.name}: {links}"
    return "" if hand.meets(seen, width) else MISSED.format(target.name)


def rim_gaps(target: Obstacle, grasp: Pose, gripper: Gripper) -> list[float]:
    """Metres between an object and points of a cup at a grasp: its middle, and some of its rim."""
    x, y = np.array(gripper.closing), cross(np.array(gripper.approach), np.array(gripper.closing))
    angles = np.arange(RIM_POINTS)[:, None] * (2.0 * math.pi / RIM_POINTS)
    rim = gripper.radius * (np.cos(angles) * x + np.sin(angles) * y)
    T = (target.pose.inverse() @ grasp).matrix
    points = (np.vstack([np.zeros(3), rim])[:, None, :] * T[:3, :3]).sum(axis=2) + T[:3, 3]
    found: list[float] = np.asarray(target.shape.distance(points)).tolist()
    return found


def unwanted(checker: CollisionChecker, q: FloatArray, pairs: tuple[Pair, ...]) -> str:
    """Which of ``pairs`` overlaps at q by more than touching, or what else touches, in words; empty if nothing does."""
    for c in checker.contacts(q):
        if (c.a, c.b) not in pairs:
            return f"{c.a} x {c.b} touch"
        if c.depth > MEANT_OVERLAP:
            return f"{c.a} would stand {c.depth * 1000:.1f} mm inside {c.b}"
    return ""


def tool_line(
    robot: Robot, path: JointPath, near: float, far: float, longest: float, *, any_direction: bool = False
) -> tuple[FloatArray, str]:
    """Configurations (m, n) of a path from a contact at s = ``near`` to ``far``, and what is wrong there, or "".

    The tool has to stay on the straight line along its approach, or in ``any_direction``, go at most ``longest`` metres
    away, and never back.
    """
    count = math.ceil(abs(far - near) / SPACING)
    if count > MAX_SAMPLES:
        return np.zeros((0, path.n)), f"the stretch is {abs(far - near):.3g} rad long, which no straight tool line is"
    samples = path(near + (far - near) * (np.arange(count + 1) / max(count, 1)))
    places, turns = tool_frames(robot, samples)
    moved = places - places[0]
    approach = np.zeros(3) if robot.gripper is None else turns[0] @ np.array(robot.gripper.approach)
    if any_direction:
        away = math.sqrt(float((moved[-1] ** 2).sum()))
        approach = moved[-1] / -away if away > 0.0 else np.zeros(3)
    travel = -(moved * approach).sum(axis=1)
    aside = np.sqrt(((moved + travel[:, None] * approach) ** 2).sum(axis=1))
    turned = np.sqrt(((turns - turns[0]) ** 2).sum(axis=(1, 2)) / 2.0)
    backwards = float(np.diff(travel).min(initial=0.0))
    if aside.max() > SLACK * LINE_METRES or turned.max() > SLACK * LINE_RADIANS or backwards < -LINE_METRES / 10.0:
        line = "its straight line" if any_direction else "the straight line along its approach"
        return samples, f"the tool leaves {line} there"
    if travel.max() > longest + SLACK * LINE_METRES:
        return (
            samples,
            f"the tool is {travel.max() * 1000:.0f} mm away there; at most {longest * 1000:.0f} mm are meant",
        )
    return samples, ""


def tool_frames(robot: Robot, Q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (m, 3) and rotations (m, 3, 3) of the tool frame at Q (m, n)."""
    turns, places = robot.body_poses_batch(Q)
    at, T = robot.tool_body, robot.tool_placement
    return np.asarray(turns[:, at] @ T[:3, 3] + places[:, at]), np.asarray(turns[:, at] @ T[:3, :3])


def reach_objection(
    checker: CollisionChecker,
    path: JointPath,
    begin: float,
    target: Obstacle,
    pairs: tuple[Pair, ...],
    *,
    before: Obstacle,
) -> str:
    """Why fingers should not go along a path from s = ``begin`` to its end to take what has moved; empty if they may.

    Asks the checker, which counts a state every 5 mrad.

    Args:
        target: The object as it is.
        pairs: The fingers and the object, as contacts name them: these may touch, nothing else.
        before: The object as it was when the path was planned.
    """
    robot = checker.robot
    if robot.gripper is None:
        return f"{robot.name} has no gripper"
    tool = Pose.from_matrix(robot.tool_pose(path.waypoints[-1]))
    width, planned_width = (width_across(item, tool, robot) for item in (target, before))
    if abs(width - planned_width) > MEANT_OVERLAP:
        return f"{target.name} is {width * 1000:.1f} mm wide between the fingers, not {planned_width * 1000:.1f} mm"
    samples, objection = tool_line(robot, path, path.length, begin, LONGEST_APPROACH)
    objection = grasp_objection(target, tool, robot) or objection
    if objection:
        return objection
    inside = np.clip(samples, *robot.bounds)
    return next(filter(None, (unwanted(checker, q, pairs) for q in inside)), "")
