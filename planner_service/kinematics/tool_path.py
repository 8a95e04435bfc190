"""Paths of the tool frame: lines whose corners are rounded, and circular arcs; and the joint values that follow them.

A path is a table of poses in the base frame, so close together that straight lines between them are within 0.02 mm
of an arc. All of it is scalar arithmetic: which configurations result depends on no processor.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, Vector, cross_of, dot, minus, read_only
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import ToolChain, nearest_configuration, tool_error
from planner_service.kinematics.tool_line import (
    LINE_METRES,
    LINE_RADIANS,
    MAX_HALVINGS,
    MAX_STEP,
    RATE_SLACK,
    SAMPLED_SHARE,
    LineStop,
    LineStopReason,
    ToolLine,
    interpolate,
    require_within_limits,
    rotation_distance,
    stop_at,
    travel,
    without_turns,
)
from planner_service.kinematics.turning_tool import with_turns
from planner_service.path.corner_blend import integral
from planner_service.path.joint_path import MIN_FORWARD
from planner_service.robot.model import Robot

__all__ = ["ToolPath", "circular_arc", "rounded_lines", "walk_tool_path"]

SPACING, TURN = 0.005, 0.03
"""The most (m, rad) between two poses of a path: 0.02 mm between an arc and its chord."""

LEAST_ROWS, MOST_ROWS = 16, 2000
"""Steps of a line, a rounded corner or an arc. The most is for paths beyond the reach of any arm."""

MIN_ZONE = 1e-4
"""Metres. A smaller zone is a stop: its curve would be shorter than what the tool may deviate by."""

MIN_BEND = 1e-4
"""Metres that the middle of three points on an arc is off the line through the others at least."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Poses of the tool frame in the base frame, one after the other.

    Attributes:
        name: What a message calls the path.
        poses: M of them. Between two the position moves linearly, the orientation by the shortest rotation.
        stops: Rows of ``poses`` with a sharp corner, at which the tool stops.
    """

    name: str
    poses: tuple[Pose, ...]
    stops: tuple[int, ...] = ()

    @cached_property
    def knots(self) -> list[float]:
        """Metres travelled up to each pose; where the tool turns by more than 10 rad/m, 0.1 m for each radian."""
        knots = [0.0]
        for a, b in pairwise(self.poses):
            knots.append(knots[-1] + travel(a, b))
        return knots

    def pose(self, at: float) -> Pose:
        """The pose after ``at`` metres."""
        row = min(max(bisect_right(self.knots, at) - 1, 0), len(self.poses) - 2)
        low, high = self.knots[row], self.knots[row + 1]
        if at >= high:
            return self.poses[row + 1]
        return interpolate(self.poses[row], self.poses[row + 1], (at - low) / (high - low))

    @cached_property
    def _columns(self) -> tuple[FloatArray, FloatArray]:
        """The knots (M,), and position and quaternion of each pose as columns (7, M), no sign flipped on the way."""
        rows = [[*self.poses[0].position, *self.poses[0].quaternion]]
        for pose in self.poses[1:]:
            same = math.fsum(a * b for a, b in zip(rows[-1][3:], pose.quaternion, strict=True)) >= 0.0
            rows.append([*pose.position, *(v if same else -v for v in pose.quaternion)])
        return read_only(self.knots), read_only(rows).T

    def poses_at(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (k, 3) and rotation matrices (k, 3, 3) after ``at`` metres, (k,)."""
        knots, columns = self._columns
        x, y, z, qw, qx, qy, qz = (np.interp(at, knots, column) for column in columns)
        norm = np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = qw / norm, qx / norm, qy / norm, qz / norm
        rows = [
            [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy - qw * qz), 2.0 * (qx * qz + qw * qy)],
            [2.0 * (qx * qy + qw * qz), 1.0 - 2.0 * (qx * qx + qz * qz), 2.0 * (qy * qz - qw * qx)],
            [2.0 * (qx * qz - qw * qy), 2.0 * (qy * qz + qw * qx), 1.0 - 2.0 * (qx * qx + qy * qy)],
        ]
        return np.stack([x, y, z], axis=-1), np.moveaxis(np.array(rows), -1, 0)

    @property
    def length(self) -> float:
        """Metres from the first pose to the last, as ``knots`` counts them."""
        return self.knots[-1]


def rounded_lines(poses: Sequence[Pose], zone: float) -> ToolPath:
    """Straight lines from pose to pose, with rounded corners.

    A corner is replaced by a curve from ``zone`` metres before it to as much after it, at most half of either line.
    The curve is that of ``corner_blend``, of position and orientation alike: what is left of the line before it and
    what is done of the line after it add up, so velocity and acceleration are continuous. Where the tool turns on the
    spot or goes back, and where the zone is below 0.1 mm, the corner stays, and is a stop.

    Args:
        poses: At least two.
        zone: Metres.
    """
    lines = list(pairwise(poses))
    sizes = [0.0, *(_zone(a, b, c, zone) for (a, b), (_, c) in pairwise(lines)), 0.0]
    rows, stops = [poses[0]], [0]
    for k, (a, b) in enumerate(lines):
        length = math.dist(a.position, b.position)
        first, last = (size / length if size > 0.0 else 0.0 for size in (sizes[k], sizes[k + 1]))
        steps = _steps(length, rotation_distance(a, b))
        _add(rows, (interpolate(a, b, first + (1.0 - first - last) * i / steps) for i in range(1, steps + 1)))
        if sizes[k + 1] > 0.0:
            _add(rows, _corner(a, b, poses[k + 2], sizes[k + 1]))
        else:
            stops.append(len(rows) - 1)
    return ToolPath("the tool's path", tuple(rows), tuple(stops))


def circular_arc(start: Pose, via: Vector, goal: Pose) -> ToolPath:
    """The arc from ``start`` through the point ``via`` to ``goal``.

    The orientation turns from that of ``start`` to that of ``goal`` by the shortest rotation, evenly along the arc.

    Raises:
        InvalidRequest: Start and goal are less than 0.1 mm apart, or ``via`` is less than 0.1 mm off the line through
            them.
    """
    u, v = minus(via, start.position), minus(goal.position, start.position)
    n, chord = cross_of(u, v), math.hypot(*v)
    if chord < MIN_BEND:
        raise InvalidRequest("goal", goal.position, "a position other than the start's; two arcs make a full circle")
    double_area = math.hypot(*n)
    if double_area < MIN_BEND * chord:
        expected = "a point at least 0.1 mm off the line through start and goal; move_linear moves along a line"
        raise InvalidRequest("via", via, expected)
    w = cross_of([dot(u, u) * b - dot(v, v) * a for a, b in zip(u, v, strict=True)], n)
    x, y, z = (k / (2.0 * double_area * double_area) for k in w)  # from the start to the centre
    radius = math.hypot(x, y, z)
    across = [-k / radius for k in (x, y, z)]
    ahead = cross_of([k / double_area for k in n], across)
    end = (v[0] - x, v[1] - y, v[2] - z)
    angle = math.atan2(dot(end, ahead), dot(end, across)) % math.tau
    steps = max(_steps(radius * angle, rotation_distance(start, goal)), min(math.ceil(angle / TURN), MOST_ROWS))

    def pose(u: float) -> Pose:
        c, s = radius * math.cos(angle * u), radius * math.sin(angle * u)
        sx, sy, sz = start.position
        (ax, ay, az), (bx, by, bz) = across, ahead
        position = (sx + x + c * ax + s * bx, sy + y + c * ay + s * by, sz + z + c * az + s * bz)
        return replace(interpolate(start, goal, u), position=position)

    rows = [start, *(pose(k / steps) for k in range(1, steps)), goal]
    return ToolPath("the circular arc", tuple(rows), (0, len(rows) - 1))


def _add(rows: list[Pose], poses: Iterator[Pose]) -> None:
    """Append those poses that are not where the last one is."""
    rows.extend(pose for pose in poses if travel(rows[-1], pose) > 0.0)


def _steps(metres: float, radians: float) -> int:
    return min(max(LEAST_ROWS, math.ceil(metres / SPACING), math.ceil(radians / TURN)), MOST_ROWS)


def _zone(a: Pose, b: Pose, c: Pose, zone: float) -> float:
    """Metres before and after the corner b that its curve replaces; 0 if it stays a corner."""
    before, after = math.dist(a.position, b.position), math.dist(b.position, c.position)
    size = min(zone, before / 2.0, after / 2.0)
    if size < MIN_ZONE:
        return 0.0
    u, v = minus(b.position, a.position), minus(c.position, b.position)
    forward = math.hypot(*(p / before + q / after for p, q in zip(u, v, strict=True)))
    return size if forward >= MIN_FORWARD else 0.0


def _corner(a: Pose, b: Pose, c: Pose, size: float) -> Iterator[Pose]:
    """The curve round the corner b of the lines from a to b to c."""
    before, after = size / math.dist(a.position, b.position), size / math.dist(b.position, c.position)
    back = replace(b, position=(0.0, 0.0, 0.0)).inverse()
    steps = _steps(2.0 * size, before * rotation_distance(a, b) + after * rotation_distance(b, c))
    for k in range(1, steps + 1):
        y = 2.0 * k / steps - 1.0
        done = float(integral(np.array(y)))
        into = interpolate(a, b, 1.0 - before * (1.0 - (y + 1.0 - done)))
        out = interpolate(b, c, after * done)
        px, py, pz = (p + q - r for p, q, r in zip(into.position, out.position, b.position, strict=True))
        yield replace(
            replace(into, position=(0.0, 0.0, 0.0)) @ back @ replace(out, position=(0.0, 0.0, 0.0)),
            position=(px, py, pz),
        )


def walk_tool_path(
    robot: Robot, q_start: FloatArray, path: ToolPath, *, max_joint_rate: float, free_axis: Vector | None = None
) -> ToolLine:
    """Joint waypoints that move the tool along ``path``, as far as the arm can.

    Each is found by inverse kinematics from the one before. Where a joint would turn by more than 0.2 rad, or by more
    than ``max_joint_rate``, or the tool would leave the path by more than 1 mm or 5 mrad, the piece is halved, and
    finally refused. Joints that do not move the tool stay. Collisions are not checked.

    Args:
        q_start: Shape (n,), within the limits, with the tool at the first pose.
        max_joint_rate: As in ``straight_tool_line``; so is ``free_axis``, a unit vector.

    Raises:
        InvalidRequest: ``q_start`` is outside the limits, or no joint moves the tool.
    """
    robot = robot.around(q_start)
    require_within_limits("q_start", robot, q_start)
    arm, start = with_turns(robot, q_start[np.newaxis], np.zeros(1), free_axis)
    chain = ToolChain.of(arm, start[0])
    own = chain.robot.n - (arm.n - robot.n)
    walk = _PathWalk(chain.robot, chain.of_whole(start[0]), path, max_joint_rate, own)
    stop = next((stop for at in path.knots[1:] if (stop := walk.to(at)) is not None), None)
    fractions = np.array(walk.at) / max(path.length, 1e-300)
    waypoints = chain.whole(np.array(walk.waypoints))
    return without_turns(ToolLine(waypoints, 1.0 if stop is None else stop.fraction, stop, fractions), robot.n)


class _PathWalk:
    """Follows a tool path, collecting waypoints; of the joints the first ``own`` have a limit on their rate.

    Attributes:
        waypoints: Configurations.
        at: Metres travelled up to each.
    """

    def __init__(self, robot: Robot, q: FloatArray, path: ToolPath, rate: float, own: int) -> None:
        self._robot, self._path, self._rate, self._own = robot, path, rate, own
        self.waypoints, self.at = [q], [0.0]

    def to(self, end: float) -> LineStop | None:
        """Continue to ``end``, in halved pieces where that is necessary; returns the reason if that fails."""
        pending, shortest = [end], (end - self.at[-1]) / 2**MAX_HALVINGS
        while pending:
            pose = self._path.pose(pending[-1])
            q = nearest_configuration(self._robot, pose, self.waypoints[-1])
            if q is not None and self._fits(q, pending[-1]):
                self.waypoints.append(q)
                self.at.append(pending.pop())
            elif pending[-1] - self.at[-1] <= shortest * (1.0 + 1e-9):
                return self._stop(pose, q)
            else:
                pending.append((self.at[-1] + pending[-1]) / 2.0)
        return None

    def _fits(self, q: FloatArray, at: float) -> bool:
        before = self.waypoints[-1]
        moves = np.abs(q - before)
        if moves.max() > MAX_STEP or moves[: self._own].max() > self._rate * (at - self.at[-1]) + RATE_SLACK:
            return False
        middle = ((before + q) / 2.0).tolist()
        metres, radians = tool_error(self._robot, middle, self._path.pose((self.at[-1] + at) / 2.0))
        return metres <= SAMPLED_SHARE * LINE_METRES and radians <= SAMPLED_SHARE * LINE_RADIANS

    def _stop(self, pose: Pose, q: FloatArray | None) -> LineStop:
        before, fraction = self.waypoints[-1], self.at[-1] / self._path.length
        stop = stop_at(self._robot, pose, before, q, fraction)
        if q is not None and stop.reason is LineStopReason.SINGULARITY:
            joint = self._robot.joint_names[int(np.abs(q - before).argmax())]
            stop = LineStop(LineStopReason.JOINT_RATE, joint, fraction)
        return replace(stop, name=self._path.name)
