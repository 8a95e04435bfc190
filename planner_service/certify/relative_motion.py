"""Where one frame of a robot is in another, and how strongly that curves along a path: for proofs of constraints alone.

Between the two frames lies a serial chain of joints: those that move one of them but not the other. A joint inside both
moves them alike and is not on it; one that carries the frame of reference is on it turned round. Joint 1 is the nearest
to the frame of reference, and each joint turns about, or slides along, its own z axis.

Along a curve q(s) let ``v_i`` and ``a_i`` bound abs(dq_i/ds) and abs(d2q_i/ds2) of the joints on the chain.

Position p, in the frame of reference. Let ``J_j`` be its derivative by q_j. For i <= j the derivative of ``J_j`` by q_i
is the vector product of the unit axis of i with ``J_j``, and zero if i slides: joint i moves all that is beyond it as
one. Where a joint mimics another, q_j stands for its own value, a multiple of an entry of q. So

    abs(p'') <= sum_j r_j v_j (t_j v_j + 2 sum_(i<j) t_i v_i) + sum_j r_j a_j,

where t is 1 for joints that turn and 0 for those that slide, and ``r_j >= abs(J_j)`` is the largest distance of p from
axis j, or 1 if it slides.

Orientation, as a unit quaternion Q that is continuous in s. Each derivative by an angle multiplies one factor of the
product by half a unit quaternion, so, with ``w = sum_j t_j v_j`` and ``b = sum_j t_j a_j``,

    abs(Q') <= w / 2,    abs(Q'') <= w^2 / 4 + b / 2.

All arithmetic is elementwise, in one fixed order, and so are sines and cosines: equal bits on every processor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, cosines_and_sines, vector
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Body, Robot

__all__ = ["Rates", "RelativeMotion"]

Columns = list[FloatArray]


class Rates(NamedTuple):
    """How fast a frame may move and turn on stretches of a curve, per unit of s or of s squared; (m,) each.

    Attributes:
        position: abs(p''), metres.
        turning: w, radians: a bound of the angular velocity.
        orientation: abs(Q'').
    """

    position: FloatArray
    turning: FloatArray
    orientation: FloatArray


class RelativeMotion:
    """The pose of ``outer``, fixed to one body of a robot, in ``inner``, fixed to another, as a function of q.

    Args:
        inner: The body that carries the frame of reference, and the pose of that frame in it.
        outer: The same of the frame that is looked at.

    Attributes:
        joints: The entry of q of each joint on the chain, from ``inner`` outwards, (k,).
    """

    def __init__(self, robot: Robot, inner: tuple[int, Pose], outer: tuple[int, Pose]) -> None:
        steps, last = _chain(robot.bodies, inner, outer)
        bodies = [robot.bodies[step.body] for step in steps]
        self.joints: IntArray = np.array([body.q_index for body in bodies], dtype=np.intp)
        self._times = np.array([step.sign * body.multiplier for step, body in zip(steps, bodies, strict=True)])[:, None]
        self._turns = [not body.prismatic for body in bodies]
        self._end = np.array(last.position)[:, None], np.array(last.quaternion)[:, None]
        self._frames = [(_columns(step.pose.rotation_rows), np.array(step.pose.position)[:, None]) for step in steps]
        self._quaternions = [_columns(_left(step.pose.quaternion)) for step in steps]
        self._offsets = [step.pose.position for step in steps] + [last.position]

    def positions(self, q: FloatArray) -> FloatArray:
        """Origin of ``outer`` in ``inner`` at configurations q (m, n), (3, m) metres."""
        values = self._values(q)
        cosines, sines = cosines_and_sines(values)
        p = np.broadcast_to(self._end[0], (3, len(q)))
        for j in range(len(self.joints) - 1, -1, -1):
            x, y, z = p
            if self._turns[j]:
                x, y = cosines[j] * x - sines[j] * y, sines[j] * x + cosines[j] * y
            else:
                z = z + values[j]
            (a, b, c), offset = self._frames[j]
            p = a * x + b * y + c * z + offset
        return np.asarray(p)

    def orientations(self, q: FloatArray) -> FloatArray:
        """Orientation of ``outer`` in ``inner`` at q (m, n), continuous in q: unit quaternions (w, x, y, z), (4, m)."""
        cosines, sines = cosines_and_sines(0.5 * self._values(q))
        Q = np.broadcast_to(self._end[1], (4, len(q)))
        for j in range(len(self.joints) - 1, -1, -1):
            w, x, y, z = Q
            if self._turns[j]:
                c, s = cosines[j], sines[j]
                w, x, y, z = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
            one, two, three, four = self._quaternions[j]
            Q = one * w + two * x + three * y + four * z
        return np.asarray(Q)

    def size(self, farthest: FloatArray) -> float:
        """Metres between the two frames at most where no abs(q) is larger than ``farthest`` (n,)."""
        return self._reach(farthest)[1]

    def rates(self, speeds: FloatArray, bends: FloatArray, farthest: FloatArray) -> Rates:
        """The bounds of the module's head.

        Args:
            speeds, bends: Bounds of abs(dq/ds) and abs(d2q/ds2) of all joints, (m, n) each.
            farthest: Bounds of abs(q), (n,).
        """
        position, turning, bending = (np.zeros(len(speeds)) for _ in range(3))
        sizes = np.abs(self._times)[:, 0]
        for j, size, reach, turns in zip(self.joints, sizes, self._reach(farthest)[0], self._turns, strict=True):
            v, a = size * speeds[:, j], size * bends[:, j]
            if turns:
                position += reach * (v * (v + 2.0 * turning) + a)
                turning += v
                bending += a
            else:
                position += 2.0 * v * turning + a
        return Rates(position, turning, 0.25 * turning * turning + 0.5 * bending)

    def _reach(self, farthest: FloatArray) -> tuple[list[float], float]:
        """Bounds of abs(dp/dq) of each joint on the chain, and of the distance between the two frames."""
        reach, beyond = [0.0] * len(self._turns), 0.0
        for k in range(len(reach) - 1, -1, -1):
            x, y, z = self._offsets[k + 1]  # z is the axis of joint k
            turns = self._turns[k]
            reach[k] = math.sqrt(x * x + y * y) + beyond if turns else 1.0
            beyond += math.sqrt(x * x + y * y + z * z) + (
                0.0 if turns else abs(float(self._times[k, 0])) * float(farthest[self.joints[k]])
            )
        x, y, z = self._offsets[0]
        return reach, beyond + math.sqrt(x * x + y * y + z * z)

    def _values(self, q: FloatArray) -> FloatArray:
        """What the bodies on the chain move by, those that it meets from outside negated, (k, m)."""
        return np.asarray(q.T.take(self.joints, axis=0) * self._times)


class _Step(NamedTuple):
    """A joint on a chain: the body that it moves, the sign of q, and its frame in that of the one before."""

    body: int
    sign: float
    pose: Pose


def _chain(bodies: Sequence[Body], inner: tuple[int, Pose], outer: tuple[int, Pose]) -> tuple[list[_Step], Pose]:
    """The joints from one frame to another, and the pose of the latter after the last of them."""
    inwards, outwards = (_to_base(bodies, body) for body, _ in (inner, outer))
    while inwards and outwards and inwards[-1] == outwards[-1]:
        inwards.pop()
        outwards.pop()
    steps, pose = [], inner[1].inverse()
    for index in inwards:
        along, placement = _aligned(bodies[index])
        steps.append(_Step(index, -1.0, pose @ along))
        pose = along.inverse() @ placement.inverse()
    for index in reversed(outwards):
        along, placement = _aligned(bodies[index])
        steps.append(_Step(index, 1.0, pose @ placement @ along))
        pose = along.inverse()
    return steps, pose @ outer[1]


def _to_base(bodies: Sequence[Body], index: int) -> list[int]:
    out = []
    while index > 0:
        out.append(index)
        index = bodies[index].parent
    return out


def _aligned(body: Body) -> tuple[Pose, Pose]:
    """A rotation that takes z to the axis of a body's joint, and the placement of that joint."""
    x, y, z = vector(body.axis.tolist())
    if z > -0.5:
        norm = math.sqrt(x * x + y * y + (1.0 + z) * (1.0 + z))
        quaternion = ((1.0 + z) / norm, -y / norm, x / norm, 0.0)
    else:  # half a turn about what is half way between z and the axis
        half = (x, y, 1.0 + z) if x * x + y * y > 0.0 else (1.0, 0.0, 0.0)
        norm = math.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
        quaternion = (0.0, half[0] / norm, half[1] / norm, half[2] / norm)
    return Pose(quaternion=quaternion), Pose.from_matrix(body.placement)


def _columns(rows: Sequence[Sequence[float]]) -> Columns:
    return [np.array(column)[:, None] for column in zip(*rows, strict=True)]


def _left(quaternion: Sequence[float]) -> list[list[float]]:
    """The matrix that multiplies by a quaternion from the left."""
    w, x, y, z = quaternion
    return [[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]]
