"""Grippers as immutable values: what they hold things with, and where their fingers stand.

A parallel gripper has fingers that slide straight, each by half of the width. The fingers of a revolute one turn about
joints that one leader moves; its width, the gap between the finger tips, follows from the shapes. A vacuum gripper has
a cup and no width.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np

from planner_service.geometry.arrays import FloatArray, Vector, axis_matrix, product
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Pose, Shape
from planner_service.robot.kinematic_tree import Body, LinkShape

__all__ = ["FingerTurn", "Gripper", "GripperKind", "reach"]

GripperKind = Literal["parallel", "revolute", "vacuum"]

HALVINGS = 60
"""Of the range of the leader, until its position for a width is exact but for rounding."""

ROOM_STEPS = 17
"""Positions of a turning finger; the room of the fingers of a Kinova is then grown by 0.1 mm."""


@dataclass(frozen=True)
class FingerTurn:
    """A joint of a revolute finger: it turns by ``ratio`` times the leader's position.

    Attributes:
        axis: Unit vector along which it turns, in the body of the palm, with the leader at 0.
        point: A point on that axis, likewise, in metres.
    """

    axis: Vector
    point: Vector
    ratio: float

    def motion(self, position: float) -> FloatArray:
        """4 x 4: where it takes what it carries, with the leader at ``position`` radians."""
        T = np.eye(4)
        T[:3, :3] = rows = axis_matrix(self.axis, self.ratio * position)
        x, y, z = self.point
        T[:3, 3] = [p - (a * x + b * y + c * z) for p, (a, b, c) in zip(self.point, rows, strict=True)]
        return T


@dataclass(frozen=True, eq=False)
class Gripper:
    """A gripper.

    Attributes:
        joints: The finger joints; of a revolute one the leader, and joints that move as far.
        links: The links that they move, with or without collision shapes; the cup of a vacuum gripper.
        lower: Smallest width in metres.
        upper: Largest width in metres.
        closed: The shapes of ``links`` at width 0; of a revolute one with the leader at 0.
        directions: For each of ``closed``, the unit vector in its body along which it opens; none if not parallel.
        approach: Unit vector in the tool frame from the palm to the fingertips, along which a grasp approaches.
        closing: Unit vector in the tool frame along which the fingers move, perpendicular to ``approach``.
        kind: "parallel", "revolute" or "vacuum".
        turns: For each of ``closed`` the joints that turn it, from the palm on, if revolute.
        tips: The two links between which the width is measured, if revolute.
        across: Unit vector from the first to the second in their body, along which it is measured.
        positions: Of the leader in radians, at ``lower`` and at ``upper``.
        radius: Of the cup, in metres; 0 if there is none.
    """

    joints: tuple[str, ...]
    links: tuple[str, ...]
    lower: float
    upper: float
    closed: tuple[LinkShape, ...]
    directions: tuple[tuple[float, float, float], ...]
    approach: tuple[float, float, float]
    closing: tuple[float, float, float]
    kind: GripperKind = "parallel"
    turns: tuple[tuple[FingerTurn, ...], ...] = ()
    tips: tuple[str, ...] = ()
    across: tuple[float, float, float] = (0.0, 0.0, 0.0)
    positions: tuple[float, float] = (0.0, 0.0)
    radius: float = 0.0

    def touching(self, what: str, verb: str) -> str:
        """That it may touch something, and why, in words."""
        if self.kind == "vacuum":
            return f"the cup may touch {what}, which it {verb}s"
        return f"fingers may touch {what}, which they {verb}"

    def shapes(self, width: float) -> tuple[LinkShape, ...]:
        """The finger shapes at ``width``, in the order of ``closed``."""
        if self.kind == "vacuum":
            return self.closed
        if self.kind == "revolute":
            return self.turned(self.position(width))
        moved = []
        for item, direction in zip(self.closed, self.directions, strict=True):
            x, y, z = (p + width / 2 * d for p, d in zip(item.pose.position, direction, strict=True))
            moved.append(replace(item, pose=Pose((x, y, z), item.pose.quaternion)))
        return tuple(moved)

    def turned(self, position: float) -> tuple[LinkShape, ...]:
        """The finger shapes of a revolute gripper with its leader at ``position`` radians."""
        return tuple(_turned(item, turns, position) for item, turns in zip(self.closed, self.turns, strict=True))

    def gap(self, position: float) -> float:
        """Metres between the tips of a revolute gripper with its leader at ``position``; negative if they overlap."""
        pairs = list(zip(self.closed, self.turns, strict=True))
        first, second = (
            [_turned(item, turns, position) for item, turns in pairs if item.link == tip] for tip in self.tips
        )
        back: Vector = (-self.across[0], -self.across[1], -self.across[2])
        return -reach(first, self.across) - reach(second, back)

    def position(self, width: float) -> float:
        """How far the fingers are moved at ``width``: half of it in metres, or the leader's position in radians."""
        if self.kind != "revolute":
            return width / 2.0
        near, far = self.positions
        if not self.lower < width < self.upper:
            return near if width <= self.lower else far
        return _leader(self, width)

    def width_at(self, position: float) -> float:
        """The width for what ``position`` gives."""
        if self.kind != "revolute":
            return 2.0 * position
        return min(max(self.gap(position), self.lower), self.upper)

    def finger_bodies(self, first: int, q_index: int) -> tuple[list[Body], list[LinkShape]]:
        """The fingers as bodies of a robot that one more entry of q moves: by half of the width, or as the leader.

        Args:
            first: The number of bodies that the robot has without them.
            q_index: The number of that entry.
        """
        bodies, shapes, known = list[Body](), list[LinkShape](), dict[tuple[int, tuple[FingerTurn, ...]], int]()
        if self.kind == "parallel":
            for item, direction in zip(self.closed, self.directions, strict=True):
                bodies.append(Body("gripper", item.body, np.eye(4), np.array(direction), True, q_index))
                shapes.append(replace(item, body=first + len(bodies) - 1))
        for item, turns in zip(self.closed, self.turns, strict=False):
            parent, at = item.body, (0.0, 0.0, 0.0)
            for k, turn in enumerate(turns, start=1):
                if (item.body, turns[:k]) not in known:
                    placement = np.eye(4)
                    placement[:3, 3] = _between(at, turn.point)
                    bodies.append(Body("gripper", parent, placement, np.array(turn.axis), False, q_index, turn.ratio))
                    known[item.body, turns[:k]] = first + len(bodies) - 1
                parent, at = known[item.body, turns[:k]], turn.point
            x, y, z = _between(at, item.pose.position)
            shapes.append(replace(item, body=parent, pose=Pose((x, y, z), item.pose.quaternion)))
        return bodies, shapes

    def room(self) -> tuple[LinkShape, ...]:
        """What contains the finger shapes at every width, in the order of ``closed``.

        Of a finger that slides it is the hull of where it begins and ends. Of one that turns it is the hull of where it
        is at some positions, grown by how far it can leave that hull in between: a point that turns at rate w (by all
        its joints together) and is never farther than r from their axes leaves the chord of a step d by at most
        (w d)^2 r / 8, as its acceleration is at most w^2 r.
        """
        if self.kind == "vacuum":
            return self.closed
        near, far = (self.position(width) for width in (self.lower, self.upper))
        positions = np.linspace(near, far, 2 if self.kind == "parallel" else ROOM_STEPS).tolist()
        moved = [self.turned(each) if self.kind == "revolute" else self.shapes(2.0 * each) for each in positions]
        rooms = []
        for k, item in enumerate(self.closed):
            corners = _corners(item.shape)
            at = [corners @ shapes[k].pose.rotation.T + shapes[k].pose.position for shapes in moved]
            turns = self.turns[k] if self.kind == "revolute" else ()
            rate = sum(abs(turn.ratio) for turn in turns)
            chain = [*(np.array([turn.point]) for turn in turns), corners @ item.pose.rotation.T + item.pose.position]
            arm = sum(float(np.linalg.norm(b - a, axis=-1).max()) for a, b in pairwise(chain))
            room = Mesh.around(np.concatenate(at)).grown((rate * (positions[1] - positions[0])) ** 2 * arm / 8.0)
            rooms.append(LinkShape(item.link, item.body, room, Pose()))
        return tuple(rooms)

    def content(self) -> dict[str, object]:
        """Everything that can change a plan."""
        known: dict[str, object] = {
            "joints": self.joints,
            "range": (self.lower, self.upper),
            "closed": [(s.link, s.body, repr(s.shape), repr(s.pose)) for s in self.closed],
            "axes": (self.directions, self.approach, self.closing),
        }
        if self.kind != "parallel":
            turns = [[(turn.axis, turn.point, turn.ratio) for turn in chain] for chain in self.turns]
            known |= {"kind": self.kind, "links": self.links, "turns": turns, "tips": (self.tips, self.across)}
            known |= {"positions": self.positions, "radius": self.radius}
        return known


@lru_cache(maxsize=256)
def _leader(gripper: Gripper, width: float) -> float:
    """The leader's position in radians at a width between the least and the greatest, by halving: it takes 25 ms."""
    near, far = gripper.positions
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if gripper.gap(middle) < width else (near, middle)
    return 0.5 * (near + far)


def _turned(item: LinkShape, turns: Sequence[FingerTurn], position: float) -> LinkShape:
    T = item.pose.matrix
    for turn in reversed(turns):
        T = product(turn.motion(position), T)
    return replace(item, pose=Pose.from_matrix(T))


def _between(start: Sequence[float], end: Sequence[float]) -> Vector:
    x, y, z = (b - a for a, b in zip(start, end, strict=True))
    return (x, y, z)


def _corners(shape: Shape) -> FloatArray:
    """Points (k, 3) whose hull contains the shape: of a mesh its corners, else those of the box around it."""
    if isinstance(shape, Mesh):
        return shape.vertices
    low, high = (np.diagonal(shape.support(sign * np.eye(3))) for sign in (-1.0, 1.0))
    return np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])


def reach(items: Iterable[LinkShape], direction: Vector) -> float:
    """How far shapes extend along a direction of their body, from its origin."""
    u, v, w = direction
    far = -math.inf
    for item in items:
        local = np.array([a * u + b * v + c * w for a, b, c in zip(*item.pose.rotation_rows, strict=True)])
        x, y, z = item.pose.position
        a, b, c = (item.shape.support(local) * local).tolist()
        far = max(far, a + b + c + x * u + y * v + z * w)
    return far
