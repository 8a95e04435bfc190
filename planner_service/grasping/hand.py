"""A gripper's fingers and palm in the tool frame: what they can reach of an object, and what of it they stand in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from planner_service.collision.fcl import FclObjects
from planner_service.geometry.arrays import FloatArray, along, cross
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Pose, Shape
from planner_service.grasping.lines import pieces_of
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot

__all__ = ["HandCheck", "Jaw", "axes_of", "jaws_of"]


class Jaw(NamedTuple):
    """A part of a finger as it is seen along the axis on which the fingers close.

    Attributes:
        side: 1 for the finger on that axis' positive side, -1 for the other.
        low, high: Where it begins and ends along the approach, and along the third axis, in metres from the tool frame.
        recess: Metres by which its inner face lies behind the face between which the width is measured.
    """

    side: float
    low: tuple[float, float]
    high: tuple[float, float]
    recess: float


def axes_of(gripper: Gripper) -> FloatArray:
    """The tool frame's axes of approach and closing, and the third one, as rows (3, 3)."""
    x, y = np.array(gripper.approach), np.array(gripper.closing)
    return np.stack([x, y, cross(x, y)])


def jaws_of(robot: Robot, width: float) -> tuple[Jaw, ...]:
    """The parts of the fingers of a gripper that is open by ``width`` metres, seen along the axis of closing."""
    gripper = robot.gripper
    assert gripper is not None
    if gripper.kind == "parallel":
        width = gripper.lower  # they slide along that axis, so that they look alike at every width
    return _jaws(gripper, robot.tool_placement.tobytes(), width)


@lru_cache(maxsize=64)
def _jaws(gripper: Gripper, placement: bytes, width: float) -> tuple[Jaw, ...]:
    tool = Pose.from_matrix(np.frombuffer(placement).reshape(4, 4)).inverse()
    axes = axes_of(gripper)
    opened: dict[str, list[float]] = {}
    for item in gripper.shapes(gripper.upper):
        low, high = _extent(item.shape, tool @ item.pose, axes)
        opened.setdefault(item.link, []).append(low[1] + high[1])
    jaws = []
    for item in gripper.shapes(width):
        side = 1.0 if sum(opened[item.link]) > 0.0 else -1.0
        low, high = _extent(item.shape, tool @ item.pose, axes)
        inner = low[1] if side > 0.0 else -high[1]
        jaws.append(Jaw(side, (low[0], low[2]), (high[0], high[2]), max(0.0, inner - width / 2.0)))
    return tuple(jaws)


def _extent(shape: Shape, pose: Pose, axes: FloatArray) -> tuple[list[float], list[float]]:
    """Least and largest coordinates of a shape along axes (3, 3), by rows."""
    local = along(pose.rotation.T, axes)
    at = along(axes, np.array(pose.position))
    low, high = ((shape.support(sign * local) * local).sum(axis=1) + at for sign in (-1.0, 1.0))
    return low.tolist(), high.tolist()


@dataclass(frozen=True)
class _Part:
    link: str
    shape: Shape


class HandCheck:
    """FCL asked which links of a hand overlap an object; no state of the robot is judged, so none is counted."""

    def __init__(self, robot: Robot, solid: Solid) -> None:
        gripper = robot.gripper
        assert gripper is not None
        self._robot, self._gripper, self._tool = robot, gripper, Pose.from_matrix(robot.tool_placement).inverse()
        palm = [item for item in robot.shapes if item.body == robot.tool_body and item.link not in gripper.links]
        self._pieces = pieces_of(solid)
        parts = [_Part(item.link, item.shape) for item in (*gripper.closed, *palm)]
        self._parts, self._fixed = parts, [self._tool @ item.pose for item in palm]
        shapes = [*(part.shape for part in parts), *self._pieces.kinds]
        self._objects = FclObjects(shapes, lambda k: np.eye(4), {})
        self._balls = [_ball(shape) for shape in shapes]
        kinds = self._pieces.numbers + len(parts)
        self._middles = np.array([middle for middle, _ in self._balls])[kinds]
        self._radii = np.array([radius for _, radius in self._balls])[kinds]

    def sides(self, links: frozenset[str]) -> set[float]:
        """On which sides of the grip the fingers among some links are, 1 and -1."""
        jaws = jaws_of(self._robot, self._gripper.upper)
        return {jaw.side for item, jaw in zip(self._gripper.closed, jaws, strict=True) if item.link in links}

    def touching(self, seen: Pose, width: float) -> frozenset[str]:
        """The links of fingers and palm that overlap the object, with the fingers ``width`` metres apart.

        Args:
            seen: The pose of the object in the tool frame.
        """
        moved = [self._tool @ item.pose for item in self._gripper.shapes(width)]
        R, at = seen.rotation, np.array(seen.position)
        count = len(self._pieces)
        rotations = np.broadcast_to(self._pieces.rotations, (count, 3, 3))
        turns = np.stack([along(R, rotations[:, :, k]) for k in range(3)], axis=-1).reshape(count, 3, 3)
        places = along(R, self._pieces.positions).reshape(count, 3) + at
        middles = (turns * self._middles[:, None, :]).sum(axis=2) + places
        touched = set[str]()
        for number, (part, pose) in enumerate(zip(self._parts, [*moved, *self._fixed], strict=True)):
            if part.link in touched:
                continue
            middle, radius = self._balls[number]
            away = middles - (along(pose.rotation, middle) + np.array(pose.position))
            near = np.flatnonzero(np.sqrt((away * away).sum(axis=1)) <= self._radii + radius).tolist()
            if near:
                self._objects.place(number, pose.rotation, np.array(pose.position))
            for piece in near:
                kind = len(self._parts) + int(self._pieces.numbers[piece])
                self._objects.place(kind, turns[piece], places[piece])
                if self._objects.collide(number, kind):
                    touched.add(part.link)
                    break
        return frozenset(touched)


def _ball(shape: Shape) -> tuple[FloatArray, float]:
    """Middle (3,) and radius of a ball that contains a shape."""
    axes = np.eye(3)
    low, high = (shape.support(sign * axes).diagonal() for sign in (-1.0, 1.0))
    return 0.5 * (low + high), 0.5 * float(np.sqrt(((high - low) ** 2).sum()))
