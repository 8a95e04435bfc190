"""A gripper's fingers and palm in the tool frame: what they can reach of an object, and what of it they stand in."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from planner_service.collision.fcl import FclObjects
from planner_service.geometry.arrays import FloatArray, along, cross
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Pose, Shape
from planner_service.grasping.lines import pieces_of, runs_along
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import Robot

__all__ = ["DEPTHS", "MEANT_OVERLAP", "HandCheck", "Jaw", "axes_of", "grips_at_tips", "jaws_of"]

MEANT_OVERLAP = 0.001
"""Metres by which the models of things that are meant to touch may overlap."""

DEPTHS = (0.0, 0.01, 0.02, 0.03)
"""Metres by which an object may be nearer to the palm than the point between the fingertips: fingers that turn are
nearest to each other farther in, the wider they are open."""

SAME_WIDTH = 1e-6
"""Metres to which widths are rounded down, as to find those of fingers that turn takes time."""

FLUSH = 2.5e-4
"""Metres by which the inner face of a finger may lie behind the face from which the width is measured, where it is to
meet what is between the fingertips."""


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


def grips_at_tips(robot: Robot) -> bool:
    """Whether the line on which the fingers close, through the point between the fingertips, meets both inner faces.

    Then both meet a convex object that has its whole extent along that axis on this line: the line passes through both
    points where the object begins and ends, and fingers that are closer together by more than twice ``FLUSH`` contain
    points between these two. Fingers that turn meet the line elsewhere at each width: False.
    """
    gripper = robot.gripper
    assert gripper is not None
    return gripper.kind == "parallel" and _meets(gripper, robot.tool_placement.tobytes())


@lru_cache(maxsize=64)
def _meets(gripper: Gripper, placement: bytes) -> bool:
    tool, inner = Pose.from_matrix(np.frombuffer(placement).reshape(4, 4)).inverse(), gripper.lower / 2.0 + FLUSH
    closing, met = np.array(gripper.closing), set[float]()
    for item in gripper.shapes(gripper.lower):
        back = (tool @ item.pose).inverse()
        at, way = np.array(back.position)[None], along(back.rotation, closing)[None]
        runs = runs_along(pieces_of(item.shape), at, way)
        for enter, leave in zip(runs.enter.tolist(), runs.leave.tolist(), strict=True):
            met |= {side for side, near in ((1.0, enter), (-1.0, -leave)) if -FLUSH <= near <= inner}
    return len(met) == 2


def _extent(shape: Shape, pose: Pose, axes: FloatArray) -> tuple[list[float], list[float]]:
    """Least and largest coordinates of a shape along axes (3, 3), by rows."""
    local = along(pose.rotation.T, axes)
    at = along(axes, np.array(pose.position))
    low, high = ((shape.support(sign * local) * local).sum(axis=1) + at for sign in (-1.0, 1.0))
    return low.tolist(), high.tolist()


class _Placed(NamedTuple):
    """Where the parts of a hand stand in the tool frame: rotations (p, 3, 3), positions and middles of balls (p, 3)."""

    turns: FloatArray
    places: FloatArray
    middles: FloatArray


class HandCheck:
    """FCL asked which links of a hand overlap an object; no state of the robot is judged, so none is counted."""

    def __init__(self, robot: Robot, solid: Solid) -> None:
        gripper = robot.gripper
        assert gripper is not None
        self._robot, self._gripper = robot, gripper
        self._tool = Pose.from_matrix(robot.tool_placement).inverse()
        palm = [item for item in robot.shapes if item.body == robot.tool_body and item.link not in gripper.links]
        self._fixed = [self._tool @ item.pose for item in palm]
        self._links = [item.link for item in (*gripper.closed, *palm)]
        self._pieces = pieces_of(solid)
        shapes = [*(item.shape for item in (*gripper.closed, *palm)), *self._pieces.kinds]
        self._objects = FclObjects(shapes, lambda k: np.eye(4), {})
        middles, radii = (np.array(each) for each in zip(*(_ball(shape) for shape in shapes), strict=True))
        self._hand_middles, self._hand_radii = middles[: len(self._links)], radii[: len(self._links)]
        kinds = self._pieces.numbers + len(self._links)
        self._middles, self._radii = middles[kinds], radii[kinds]
        self._at_width: dict[float, _Placed] = {}

    def sides(self, links: frozenset[str]) -> set[float]:
        """On which sides of the grip the fingers among some links are, 1 and -1."""
        jaws = jaws_of(self._robot, self._gripper.upper)
        return {jaw.side for item, jaw in zip(self._gripper.closed, jaws, strict=True) if item.link in links}

    def meets(self, seen: Pose, width: float) -> bool:
        """Whether fingers on both sides overlap an object ``width`` metres wide when they try to close to 2 mm less.

        Args:
            seen: The pose of the object in the tool frame, between the fingers.
        """
        less = math.floor((width - 2.0 * MEANT_OVERLAP) / SAME_WIDTH) * SAME_WIDTH
        return len(self.sides(self.touching(seen, max(self._gripper.lower, less)))) == 2

    def touching(self, seen: Pose, width: float) -> frozenset[str]:
        """The links of fingers and palm that overlap the object, with the fingers ``width`` metres apart.

        Args:
            seen: The pose of the object in the tool frame.
        """
        hand = self._placed(width)
        R, at = seen.rotation, np.array(seen.position)
        count = len(self._pieces)
        columns = [along(R, self._pieces.rotations[:, :, k]).reshape(-1, 3) for k in range(3)]
        turns = np.broadcast_to(np.stack(columns, axis=-1), (count, 3, 3))
        places = along(R, self._pieces.positions).reshape(count, 3) + at
        middles = (turns * self._middles[:, None, :]).sum(axis=2) + places
        away = middles - hand.middles[:, None]
        near = np.sqrt((away * away).sum(axis=2)) <= self._radii + self._hand_radii[:, None]
        touched = set[str]()
        for number in np.flatnonzero(near.any(axis=1)).tolist():
            if self._links[number] in touched:
                continue
            self._objects.place(number, hand.turns[number], hand.places[number])
            for piece in np.flatnonzero(near[number]).tolist():
                kind = len(self._links) + int(self._pieces.numbers[piece])
                self._objects.place(kind, turns[piece], places[piece])
                if self._objects.collide(number, kind):
                    touched.add(self._links[number])
                    break
        return frozenset(touched)

    def _placed(self, width: float) -> _Placed:
        if width not in self._at_width:
            poses = [*(self._tool @ item.pose for item in self._gripper.shapes(width)), *self._fixed]
            turns, places = np.stack([pose.rotation for pose in poses]), np.array([pose.position for pose in poses])
            middles = (turns * self._hand_middles[:, None, :]).sum(axis=2) + places
            self._at_width[width] = _Placed(turns, places, middles)
        return self._at_width[width]


def _ball(shape: Shape) -> tuple[FloatArray, float]:
    """Middle (3,) and radius of a ball that contains a shape."""
    axes = np.eye(3)
    low, high = (shape.support(sign * axes).diagonal() for sign in (-1.0, 1.0))
    return 0.5 * (low + high), 0.5 * float(np.sqrt(((high - low) ** 2).sum()))
