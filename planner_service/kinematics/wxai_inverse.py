"""Closed-form inverse kinematics of arms built like the WidowX AI.

Such an arm has a joint about z (the waist), three about parallel y axes (shoulder, elbow, forearm), and one about z and
one about x whose axes cross in a point W (the wrist); nothing is offset sideways. The tool pose alone determines W,
which lies in the arm's vertical plane and so gives the waist angle. In that plane, the direction of the tool's approach
axis gives the wrist's two angles and the forearm's pitch. What remains is a planar chain of two links. A point of the
plane is the complex number x + i z; a rotation by b about y multiplies it by exp(-i b).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

from planner_service.errors import BrokenInvariant, InvalidRequest
from planner_service.geometry.arrays import Vector, vector
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Body, Robot

__all__ = ["WxaiInverse"]

Configuration = tuple[float, ...]
Rows = tuple[Vector, Vector, Vector]

LIMIT_SLACK = 1e-9
"""A joint value at most this far outside its limits (rad) is rounding, and is moved to the limit."""

VERIFIED = 1e-7
"""Metres and radians by which forward kinematics may differ from the pose; rounding makes about 1e-15."""

SINGULAR = 1e-8
"""Closer to an axis than this (m, or sine), the angle about it is only rounding: any angle is a solution."""

SAME = 1e-8
"""Solutions closer than this (rad) in every joint are one."""

SPREAD = 36
"""Angles tried where any angle is a solution, beside those of the given configurations: every ten degrees."""

STRAIGHT = 1e-12
"""How far an axis or a sideways offset of the model may differ from the ideal: by the rounding of written numbers."""

AXES: tuple[int, ...] = (2, 1, 1, 1, 2, 0)


@dataclass(frozen=True)
class WxaiInverse:
    """The inverse kinematics of one robot; all its numbers come from ``robot.bodies``.

    Attributes:
        shoulder: From the waist to the shoulder in the arm's plane, x + i z.
        upper, fore, hand: Likewise from shoulder to elbow, from elbow to forearm joint, and from there to the wrist.
        last: From the wrist to the last body's origin, along the approach axis.
        signs: +1 or -1: the sense in which each joint turns about its axis.
        limits: Lower and upper limit of each joint.
        waist: The waist's axes at q = 0 in the world, as rows; its origin is ``base_offset``.
        tool, tool_offset: Rows and offset of T_body_tool.
    """

    robot: Robot
    shoulder: complex
    upper: complex
    fore: complex
    hand: complex
    last: float
    signs: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    waist: Rows
    base_offset: Vector
    tool: Rows
    tool_offset: Vector

    @staticmethod
    @lru_cache(maxsize=32)
    def of(robot: Robot) -> WxaiInverse:
        """The closed form for ``robot``.

        Raises:
            InvalidRequest: the robot is built differently.
        """
        offsets = _checked_offsets(robot)
        bodies = robot.bodies
        first, tool = bodies[1].placement.tolist(), robot.tool_placement.tolist()
        (sx, _, sz), (ux, _, uz), (fx, _, fz), (gx, _, gz), (last, _, lift) = offsets
        return WxaiInverse(
            robot=robot,
            shoulder=complex(sx, sz),
            upper=complex(ux, uz),
            fore=complex(fx, fz),
            hand=complex(gx, gz + lift),  # the wrist's two axes cross at the height of the last one
            last=last,
            signs=tuple(float(body.axis[axis]) for body, axis in zip(bodies[1:], AXES, strict=True)),
            limits=tuple(zip(robot.limits.lower.tolist(), robot.limits.upper.tolist(), strict=True)),
            waist=_rows([list(column) for column in zip(*(row[:3] for row in first[:3]), strict=True)]),
            base_offset=vector([row[3] for row in first[:3]]),
            tool=_rows(tool),
            tool_offset=vector([row[3] for row in tool[:3]]),
        )

    def solve(self, pose: Pose, near: Sequence[Sequence[float]] = ()) -> list[Configuration]:
        """Every q within the limits that brings the tool to ``pose``, those that reach forward before those backwards.

        Each is verified by forward kinematics.

        Args:
            near: Configurations to stay near if the pose leaves an angle free (approach axis parallel to the shoulder's
                axis, or wrist above the waist): of infinitely many solutions an even spread is returned.
        """
        solutions: list[Configuration] = []
        for angles in self._angles(pose, near):
            for q in self._turned_within(angles):
                if not any(_same(q, other) for other in solutions):
                    self._confirm(q, pose)
                    solutions.append(q)
        return solutions

    def determined(self, pose: Pose) -> bool:
        """Whether ``pose`` leaves no angle free: then ``solve`` returns every solution there is."""
        (x, _, _), wrist = self._target(pose)
        reach = math.hypot(wrist[0], wrist[1])
        if reach < SINGULAR:
            return False
        along = (wrist[0] * x[0] + wrist[1] * x[1]) / reach
        return math.hypot(along, x[2]) >= SINGULAR

    def _angles(self, pose: Pose, near: Sequence[Sequence[float]]) -> Iterator[Configuration]:
        """Joint angles of all candidates, signs not yet applied; the limits only save work here."""
        (x, y, z), wrist = self._target(pose)
        reach = math.hypot(wrist[0], wrist[1])
        ahead = math.atan2(wrist[1], wrist[0])
        waists = [(ahead, reach), (ahead + math.pi, -reach)]
        if reach < SINGULAR:
            waists = [(angle, 0.0) for angle in self._spread([self._about(q, 0, 1) for q in near])]
        for waist, radius in waists:
            if not self._possible(0, waist):
                continue
            c, s = math.cos(waist), math.sin(waist)
            across = c * x[1] - s * x[0]
            along = c * x[0] + s * x[1]
            for yaw, pitch in self._wrist_turns(along, across, x[2], near):
                if not self._possible(4, yaw):
                    continue
                sp, cp = math.sin(pitch), math.cos(pitch)
                up = (sp * c, sp * s, cp)  # the z axis that the wrist's first joint turns about
                _, sine, cosine = _apply((x, y, z), up)
                roll = math.atan2(sine, cosine)
                joint = complex(radius, wrist[2]) - self.hand * complex(cp, -sp) - self.shoulder
                for first, second in self._elbows(joint):
                    yield (waist, first, second, pitch - first - second, yaw, roll)

    def _target(self, pose: Pose) -> tuple[Rows, Vector]:
        """The last body's x, y and z axes, and the wrist point, in the waist's frame."""
        rows = pose.rotation_rows
        axes = [_apply(rows, axis) for axis in self.tool]  # a row of T_body_tool is a body axis, seen from the tool
        offset, origin = self.tool_offset, self.base_offset
        arm = [
            place - start - axes[0][i] * offset[0] - axes[1][i] * offset[1] - axes[2][i] * offset[2]
            for i, (place, start) in enumerate(zip(pose.position, origin, strict=True))
        ]
        x, y, z = (_apply(self.waist, axis) for axis in axes)
        at = _apply(self.waist, arm)
        return (x, y, z), (at[0] - self.last * x[0], at[1] - self.last * x[1], at[2] - self.last * x[2])

    def _wrist_turns(
        self, along: float, across: float, height: float, near: Sequence[Sequence[float]]
    ) -> Iterator[tuple[float, float]]:
        """Wrist yaw and forearm pitch (from the horizontal) that give the approach axis this direction."""
        flat = math.hypot(along, height)
        if flat < SINGULAR:
            yaw = math.copysign(math.pi / 2, across)
            yield from ((yaw, pitch) for pitch in self._spread([self._about(q, 1, 4) for q in near]))
            return
        pitch = math.atan2(-height, along)
        yield math.atan2(across, flat), pitch
        yield math.atan2(across, -flat), pitch + math.pi

    def _elbows(self, joint: complex) -> Iterator[tuple[float, float]]:
        """Shoulder and elbow angles that bring the forearm joint to ``joint``, relative to the shoulder."""
        fold = self.upper.conjugate() * self.fore
        needed = (_square(joint) - _square(self.upper) - _square(self.fore)) / 2
        cosine = needed / abs(fold)
        if abs(cosine) > 1.0:
            if abs(cosine) > 1.0 + 1e-14:
                return
            cosine = math.copysign(1.0, cosine)
        bend = math.acos(cosine)
        for elbow in (cmath.phase(fold) - bend, cmath.phase(fold) + bend):
            arm = self.upper + self.fore * cmath.exp(-1j * elbow)
            yield cmath.phase(arm) - cmath.phase(joint), elbow

    def _about(self, q: Sequence[float], first: int, last: int) -> float:
        return math.fsum(self.signs[i] * q[i] for i in range(first, last))

    def _spread(self, given: list[float]) -> list[float]:
        return [*given, *(2 * math.pi * k / SPREAD for k in range(SPREAD))]

    def _possible(self, joint: int, angle: float) -> bool:
        return bool(_within(self.signs[joint] * angle, *self.limits[joint]))

    def _turned_within(self, angles: Configuration) -> Iterator[Configuration]:
        """The configurations of these angles that lie within the limits."""
        turns = []
        for sign, angle, (low, high) in zip(self.signs, angles, self.limits, strict=True):
            values = _within(sign * angle, low, high)
            if not values:
                return
            turns.append(values)
        yield from product(*turns)

    def _confirm(self, q: Configuration, pose: Pose) -> None:
        T = self.robot.tool_rows(q)
        R, p = pose.rotation_rows, pose.position
        worst = max(abs(T[i][j] - (p[i] if j == 3 else R[i][j])) for i in range(3) for j in range(4))
        if not worst <= VERIFIED:
            raise BrokenInvariant(f"closed form of {self.robot.name!r} is off by {worst:.3g} at q = {q} for {pose}")


def _checked_offsets(robot: Robot) -> list[Vector]:
    """The position of each joint but the first in its parent's frame."""
    bodies = robot.bodies
    problems = []
    if len(bodies) != 7 or robot.tool_body != 6 or [b.parent for b in bodies] != list(range(-1, 6)):
        problems.append("a chain of six joints, the tool on the last")
    else:
        if [body.q_index for body in bodies[1:]] != list(range(6)):
            problems.append("joints listed from the base to the tool")
        for body, axis in zip(bodies[1:], AXES, strict=True):
            unit = [abs(v) for v in body.axis.tolist()]
            if body.prismatic or any(abs(v - (i == axis)) > STRAIGHT for i, v in enumerate(unit)):
                problems.append(f"{body.name} turning about its {'xyz'[axis]} axis")
        problems += [f"{body.name} placed without turn or sideways offset" for body in bodies[2:] if not _plain(body)]
    if problems:
        needs = "; ".join(problems)
        raise InvalidRequest("inverse", robot.inverse, f"'numeric' for robot {robot.name!r}: 'wxai' needs {needs}")
    return [vector(body.placement[:3, 3].tolist()) for body in bodies[2:]]


def _plain(body: Body) -> bool:
    placement = body.placement.tolist()
    turned = any(abs(placement[i][j] - (i == j)) > STRAIGHT for i in range(3) for j in range(3))
    return not turned and abs(placement[1][3]) <= STRAIGHT


def _within(angle: float, low: float, high: float) -> list[float]:
    """All angles within the limits that differ from this one by whole turns; rounding beyond a limit is removed."""
    turn = 2 * math.pi
    base = angle - turn * math.ceil((angle - high - LIMIT_SLACK) / turn)  # the largest within
    angles = []
    while base >= low - LIMIT_SLACK:
        angles.append(min(max(base, low), high))
        base -= turn
    return angles


def _same(a: Configuration, b: Configuration) -> bool:
    return all(abs(x - y) <= SAME for x, y in zip(a, b, strict=True))


def _rows(matrix: list[list[float]]) -> Rows:
    a, b, c = (vector(row[:3]) for row in matrix[:3])
    return a, b, c


def _apply(rows: Sequence[Sequence[float]], v: Sequence[float]) -> Vector:
    (a, b, c), (d, e, f), (g, h, i) = rows
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def _square(value: complex) -> float:
    return value.real * value.real + value.imag * value.imag
