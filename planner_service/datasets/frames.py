"""The motions of a task sampled at a frame rate: robot, gripper and object in every frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.path.trajectory import Trajectory
from planner_service.planning.task_result import Segment, require_joined
from planner_service.robot.model import Robot
from planner_service.scene.scene import Obstacle

__all__ = ["EpisodeMotion", "Frames", "frames", "timeline"]


@dataclass(frozen=True, eq=False)
class EpisodeMotion:
    """One motion of an episode, and the wait at its end.

    Attributes:
        begins: When it begins, in seconds since the beginning of the episode.
        settle: Seconds the robot then stands still until it no longer vibrates.
        width, next_width: Metres between the finger pads during this motion and during the next one.
        gripping: Seconds the gripper takes to move from one to the other.
        carrying: Whether the robot carries the object.
    """

    name: str
    trajectory: Trajectory
    begins: float
    settle: float
    width: float
    next_width: float
    gripping: float
    carrying: bool

    @property
    def stops(self) -> float:
        """When the motion ends, in seconds since the beginning of the episode."""
        return self.begins + self.trajectory.duration

    @property
    def ends(self) -> float:
        """When the next motion begins, in seconds since the beginning of the episode."""
        return self.stops + self.settle + self.gripping


@dataclass(frozen=True, eq=False)
class Frames:
    """m frames, the first at 0, the last not before the end of the last motion.

    Attributes:
        q: Shape (m, n).
        width: Metres between the finger pads, shape (m,).
        target: The object's position and quaternion (w, x, y, z), shape (m, 7).
    """

    q: FloatArray
    width: FloatArray
    target: FloatArray


def timeline(segments: Sequence[Segment], carrying: Sequence[str], gripper_speed: float) -> tuple[EpisodeMotion, ...]:
    """The motions in order; where the gripper's width changes, the robot settles and waits for the gripper.

    Args:
        carrying: Names of the motions during which the robot carries the object.
        gripper_speed: Speed of the opening in m/s.

    Raises:
        InvalidRequest: a motion does not begin where the last one ends.
    """
    require_joined(segments)
    parts: list[EpisodeMotion] = []
    begins = 0.0
    for k, segment in enumerate(segments):
        _, trajectory = segment.result.unwrap()
        then = segments[k + 1].width if k + 1 < len(segments) else segment.width
        motion = segment.result.motion
        settle = motion.settle_time if motion is not None and then != segment.width else 0.0
        gripping = abs(then - segment.width) / gripper_speed
        part = EpisodeMotion(
            segment.name, trajectory, begins, settle, segment.width, then, gripping, segment.name in carrying
        )
        parts.append(part)
        begins = part.ends
    return tuple(parts)


def frames(robot: Robot, parts: Sequence[EpisodeMotion], target: Obstacle, fps: int) -> Frames:
    """The frames of an episode, up to the first one at which everything is at rest."""
    times = np.arange(math.ceil(parts[-1].ends * fps) + 1) / fps
    first = np.searchsorted([part.begins for part in parts], times, side="right") - 1
    q: list[FloatArray] = []
    width: list[FloatArray] = []
    poses: list[FloatArray] = []
    pose = target.pose
    for k, part in enumerate(parts):
        since = times[first == k] - part.begins
        Q = part.trajectory(np.minimum(since, part.trajectory.duration))
        q.append(Q)
        width.append(_widths(part, since))
        if part.carrying:
            starts, stops = (_tool(robot, part.trajectory(t)) for t in (0.0, part.trajectory.duration))
            held = starts.inverse() @ pose
            poses.append(np.array([_seven(_tool(robot, row) @ held) for row in Q]).reshape(-1, 7))
            pose = stops @ held
        else:
            poses.append(np.tile(_seven(pose), (len(Q), 1)))
    return Frames(np.concatenate(q), np.concatenate(width), np.concatenate(poses))


def _widths(part: EpisodeMotion, since: FloatArray) -> FloatArray:
    if part.gripping == 0.0:
        return np.full(len(since), part.width)
    moved = (since - (part.trajectory.duration + part.settle)) / part.gripping
    return part.width + (part.next_width - part.width) * np.clip(moved, 0.0, 1.0)


def _tool(robot: Robot, q: FloatArray) -> Pose:
    return Pose.from_matrix(robot.tool_pose(q))


def _seven(pose: Pose) -> list[float]:
    return [*pose.position, *pose.quaternion]
