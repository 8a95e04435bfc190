"""The constraints of a request on one robot: their frames found, their bounds as numbers, and violations in words;
and the compiled projector onto them (native/constraints/projector.cpp).

How much of its tolerance a bounded quantity has used is its share: 1 at the bound, more beyond it.

A configuration is projected by damped least squares on the shares of the tolerances that are used (CBiRRT2: Berenson,
Srinivasa & Kuffner, IJRR 30(12), 2011; damping: Wampler, IEEE SMC 16(1), 1986). Only quantities near their bound or
beyond it count, and they are moved well inside: what has room within its tolerance uses it.

This is the search's view; that a whole curve keeps its constraints is proven by code that shares nothing with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from planner_service.constraints.values import Constraint, JointRange, ToolRegion, constraint_names
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, cosines_and_sines, read_only
from planner_service.geometry.shapes import Pose, Sphere
from planner_service.native.loading import load_core
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot
from planner_service.robot.reach import reach_bounds

if TYPE_CHECKING:
    from planner_service.native import _core

__all__ = ["ConstraintSet", "Placed", "Quantity", "constraint_set", "projector_of"]


ROOM = 0.01
"""Metres inside a bound on a coordinate over which its share falls from 1 to 0, if the region is not narrower."""

ROUNDING = 1e-9
"""By which a share may exceed 1: an end that was computed to be on a bound keeps it."""

POINT = 1e-6
"""Metres: the radius of a sphere that stands for a frame's origin."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A region with its frames on a robot.

    Attributes:
        region: The region.
        body: The body that carries the constrained frame.
        at: Pose of the constrained frame in it.
        base: The body that carries the region's frame.
        frame: Pose of the region in it.
        reach: Metres that the constrained frame's origin moves per unit of each joint that moves one of the two bodies
            against the other, at most; 0 for all other joints, (n,).
        turns: Radians that it turns per unit of each of these joints, at most (1 for one that slides), (n,).
        room: Metres over which the share of each coordinate falls from 1 to 0.
    """

    region: ToolRegion
    body: int
    at: Pose
    base: int
    frame: Pose
    reach: FloatArray
    turns: FloatArray
    room: tuple[float, float, float]


@dataclass(frozen=True)
class Quantity:
    """Something that a constraint bounds, at one configuration.

    Attributes:
        name: The constraint.
        what: The quantity: "x", "y", "z", "tilt", "turn", or the name of a joint.
        value: Metres or radians; of a coordinate in the region's frame.
        lower: The least value; -inf for none.
        upper: The largest; inf for none.
        share: The part of the tolerance that is used: 1 at a bound.
        unit: "m" or "rad".
    """

    name: str
    what: str
    value: float
    lower: float
    upper: float
    share: float
    unit: str

    def __str__(self) -> str:
        words = {"tilt": f"{self.name}: tilted by", "turn": f"{self.name}: turned by"}
        begin = words.get(self.what, f"{self.name}: {self.what} is")
        scale, unit = (1e3, "mm") if self.unit == "m" else (1.0, self.unit)
        if self.what in words:
            return f"{begin} {self.value:.3g} {unit}, at most {self.upper:.3g}"
        return f"{begin} {self.value * scale:.4g} {unit}, from {self.lower * scale:.4g} to {self.upper * scale:.4g}"


class ConstraintSet:
    """Constraints on one robot.

    Attributes:
        robot: The robot.
        constraints: As they were given.
        lower, upper: Joint limits, narrowed by each ``JointRange``, (n,).
        regions: The regions, placed.

    Raises:
        UnknownName: A link or a joint is not one of the robot's.
        InvalidRequest: A link is constrained against itself or another that it does not move against, or ranges of
            joints leave nothing.
    """

    def __init__(self, robot: Robot, constraints: Sequence[Constraint]) -> None:
        self.robot, self.constraints = robot, tuple(constraints)
        lower, upper = robot.limits.lower.copy(), robot.limits.upper.copy()
        for k, given in enumerate(self.constraints):
            if isinstance(given, JointRange):
                if given.joint not in robot.joint_names:
                    raise UnknownName("joint", given.joint, robot.joint_names)
                joint = robot.joint_names.index(given.joint)
                lower[joint], upper[joint] = max(lower[joint], given.lower), min(upper[joint], given.upper)
                if not lower[joint] < upper[joint]:
                    expected = (
                        f"a range that overlaps the others' and the joint's limits: {given.joint} has no room left"
                    )
                    raise InvalidRequest(f"constraints[{k}]", given, expected)
        self.lower, self.upper = read_only(lower), read_only(upper)
        numbered = enumerate(self.constraints)
        self.regions = tuple(_placed(robot, f"constraints[{k}]", c) for k, c in numbered if isinstance(c, ToolRegion))

    @property
    def names(self) -> str:
        """What they are called, as part of a sentence."""
        return constraint_names(self.constraints)

    def quantities(self, q: Sequence[float] | FloatArray) -> list[Quantity]:
        """Everything that is bounded, at q (n,)."""
        out: list[Quantity] = []
        values = np.asarray(q, dtype=np.float64).tolist()
        for given in self.constraints:
            if isinstance(given, JointRange):
                joint = self.robot.joint_names.index(given.joint)
                slides = self.robot.sliding[joint]
                value, unit = values[joint], "m" if slides else "rad"
                out.append(_bounded("joint range", given.joint, value, given.lower, given.upper, 1.0, unit))
        bodies = self.robot.body_poses(values)
        for placed in self.regions:
            out += _region_quantities(placed, _pose_of(bodies[placed.base]), _pose_of(bodies[placed.body]))
        return out

    def violation(self, q: Sequence[float] | FloatArray) -> Quantity | None:
        """What is violated most at q (n,); None if all constraints hold there."""
        worst = max(self.quantities(q), key=lambda quantity: quantity.share)
        return worst if worst.share > 1.0 + ROUNDING else None


@lru_cache(maxsize=64)
def constraint_set(robot: Robot, constraints: tuple[Constraint, ...]) -> ConstraintSet:
    """The constraints on a robot; errors as of ``ConstraintSet``."""
    return ConstraintSet(robot, constraints)


def _placed(robot: Robot, field: str, region: ToolRegion) -> Placed:
    body, at = robot.link_frame(robot.tool_frame if region.link is None else region.link)
    base, T = (0, np.eye(4)) if region.relative_to is None else robot.link_frame(region.relative_to)
    if body == base:
        expected = "two links that move against each other"
        raise InvalidRequest(field, (region.link or robot.tool_frame, region.relative_to or "the base"), expected)
    first, second = (set(chain_to_base(robot.bodies, index)) for index in (body, base))
    tool, frame = Pose.from_matrix(at) @ region.tool, Pose.from_matrix(T) @ region.frame
    reach, turns = np.zeros(robot.n), np.zeros(robot.n)
    travel = np.maximum(np.abs(robot.limits.lower), np.abs(robot.limits.upper)).tolist()
    for between, end in ((first - second, (body, tool)), (second - first, (base, frame))):
        bounds = reach_bounds(robot.bodies, travel, [(end[0], Sphere(POINT), end[1])])
        for moved in (robot.bodies[index] for index in between):
            turns[moved.q_index] += abs(moved.multiplier)
        for joint in {robot.bodies[index].q_index for index in between}:
            reach[joint] += max(bounds[joint], POINT)
    room = [min((high - low) / 2.0, ROOM) for low, high in zip(region.lower, region.upper, strict=True)]
    return Placed(region, body, tool, base, frame, read_only(reach), read_only(turns), (room[0], room[1], room[2]))


def _region_quantities(placed: Placed, base: Pose, body: Pose) -> list[Quantity]:
    region = placed.region
    apart = (base @ placed.frame).inverse() @ (body @ placed.at)
    bounds = zip("xyz", apart.position, region.lower, region.upper, placed.room, strict=True)
    out = [
        _bounded(region.name, axis, value, low, high, room, "m")
        for axis, value, low, high, room in bounds
        if math.isfinite(low) or math.isfinite(high)
    ]
    w, x, y, z = apart.quaternion
    if region.tilt is not None:
        tilt = 2.0 * math.atan2(math.hypot(x, y), math.hypot(w, z))
        share = math.sin(tilt / 2.0) / math.sin(region.tilt / 2.0)
        out.append(Quantity(region.name, "tilt", tilt, 0.0, region.tilt, share, "rad"))
    if region.turn is not None:
        turn = 2.0 * math.atan2(abs(z), abs(w))
        share = math.sin(turn / 2.0) / math.sin(region.turn / 2.0)
        out.append(Quantity(region.name, "turn", turn, 0.0, region.turn, share, "rad"))
    return out


def _bounded(name: str, what: str, value: float, low: float, high: float, room: float, unit: str) -> Quantity:
    share = max((low - value) / room, (value - high) / room) + 1.0
    return Quantity(name, what, value, low, high, share, unit)


def _pose_of(body: Sequence[float]) -> Pose:
    a, b, c, d, e, f, g, h, i, x, y, z = body
    return Pose.from_matrix([[a, b, c, x], [d, e, f, y], [g, h, i, z], [0.0, 0.0, 0.0, 1.0]])


def projector_of(constraints: ConstraintSet) -> _core.Projector:
    """The projector onto some constraints."""
    robot, bodies = constraints.robot, _moved_by(constraints)
    numbers = {body: number for number, body in enumerate([0, *bodies])}
    table = robot.body_table[[body - 1 for body in bodies]]
    table[:, 0] = [numbers[robot.bodies[body].parent] for body in bodies]
    joints = [
        [parent, body.q_index, body.prismatic, *body.axis.tolist(), body.multiplier]
        for parent, body in zip(table[:, 0].tolist(), map(robot.bodies.__getitem__, bodies), strict=True)
    ]
    rows = [_row(placed, numbers) for placed in constraints.regions]
    projector: _core.Projector = load_core().Projector(
        table,
        np.array(joints, dtype=np.float64).reshape(-1, 7),
        constraints.lower,
        constraints.upper,
        np.array(rows, dtype=np.float64).reshape(-1, 37 + 2 * robot.n),
    )
    return projector


def _moved_by(constraints: ConstraintSet) -> list[int]:
    """The bodies that the frames of the regions depend on, parents first, without the base."""
    found: set[int] = set()
    for index in (index for placed in constraints.regions for index in (placed.body, placed.base)):
        while index > 0:
            found.add(index)
            index = constraints.robot.bodies[index].parent
    return sorted(found)


def _row(placed: Placed, numbers: Mapping[int, int]) -> list[float]:
    """A region as ``Region`` in native/constraints/projector.hpp."""
    region = placed.region
    frames = [number for pose in (placed.at, placed.frame) for number in _frame(pose.matrix)]
    bounds = [*region.lower, *region.upper, *placed.room, *_bounds(placed)]
    return [
        numbers[placed.body],
        numbers[placed.base],
        *frames,
        *bounds,
        *placed.reach.tolist(),
        *placed.turns.tolist(),
    ]


def _frame(T: FloatArray) -> list[float]:
    """The rotation by rows, then the position."""
    return [*T[:3, :3].ravel().tolist(), *T[:3, 3].tolist()]


def _bounds(placed: Placed) -> tuple[float, float]:
    """The chord of the tilt and the sine of half the turn; inf where there is no bound."""
    angles = [angle for angle in (placed.region.tilt, placed.region.turn) if angle is not None]
    _, sines = cosines_and_sines(np.array([angle / 2.0 for angle in angles]))
    tilt, turn = [*sines.tolist(), math.inf, math.inf][:2]
    return 2.0 * tilt if placed.region.tilt is not None else math.inf, turn
