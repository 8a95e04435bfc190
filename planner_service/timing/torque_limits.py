"""Torque limits: the largest torques of a robot's joints with what it carries, and how close a motion comes to them.

Along a path q(s) torques are tau = M(q) q' u + (M(q) q'' + C(q, q') q') x + g(q), with u = d2s/dt2 and x = (ds/dt)^2:
limits of tau are linear in u and x, as those of acceleration are, but for the constant g. Gravity acts along -z of the
base frame; friction is ignored.

A motion is verified between grid points, too. Torques are computed so often that between two samples none can be
higher by more than ``BETWEEN`` of its limit: on a stretch of h seconds a function is at most h^2 / 8 times its largest
second derivative (``torque_bound``) above the line through its ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, IntArray, read_only, set_fields
from planner_service.geometry.validation import instance, number
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Peak, Trajectory
from planner_service.robot.inertia import LinkInertia
from planner_service.robot.model import Robot
from planner_service.timing.profiles import TimingFailed
from planner_service.timing.torque_bound import GRAVITY, InverseDynamics, torque_curvature

__all__ = ["BETWEEN", "EXCESS", "TorqueLimits", "TorqueSamples"]

BETWEEN = 0.0025
"""Share of its limit by which a torque may be higher between two samples than at both."""

EXCESS = 0.005
"""Share by which a verified motion may exceed a torque limit, ``BETWEEN`` included; the rest is for grid points."""

PLACES = 200
"""Of a path at which a reason is looked for why it cannot be travelled."""

MAX_SAMPLES = 500_000
"""A motion that needs more is no motion of a robot."""


@dataclass(frozen=True, eq=False)
class TorqueSamples:
    """Torques of a motion as shares of their limits, at m instants.

    Attributes:
        times: Seconds, (m,).
        moving: What moving takes, (m, n): what slowing down by a factor divides by its square.
        holding: What gravity takes, (m, n).
    """

    times: FloatArray
    moving: FloatArray
    holding: FloatArray

    def factor(self) -> float:
        """How much slower the motion has to be to keep the limits to within ``EXCESS``; at most 1 if it keeps them.

        Infinity if a joint cannot hold the robot somewhere on the way.
        """
        if float(np.abs(self.holding).max()) > 1.0:
            return math.inf
        room = 1.0 + (EXCESS - BETWEEN) - np.where(self.moving > 0.0, self.holding, -self.holding)
        return math.sqrt(float((np.abs(self.moving) / room).max()))

    def peaks(self, factor: float = 1.0) -> tuple[Peak, ...]:
        """For each joint where its torque is largest, the motion being ``factor`` times slower."""
        shares = np.abs(self.moving / (factor * factor) + self.holding)
        rows = shares.argmax(axis=0).tolist()
        return tuple(Peak(float(shares[row, k]), k, float(self.times[row]) * factor) for k, row in enumerate(rows))


@dataclass(frozen=True, eq=False)
class TorqueLimits:
    """The torques that a robot may use, with what it carries.

    Args:
        robot: One whose URDF has masses and efforts.
        loads: What it carries, each as if it were part of a body.
        scale: Share in (0, 1] of the efforts that may be used.

    Attributes:
        limit: The largest torque of each joint (Nm; N of a prismatic one), (n,).

    Raises:
        InvalidRequest: A body of the robot has no mass, or a joint no effort; the message names it.
    """

    robot: Robot
    loads: tuple[LinkInertia, ...] = ()
    scale: float = 1.0
    limit: FloatArray = field(init=False)
    _dynamics: InverseDynamics = field(init=False)

    def __post_init__(self) -> None:
        robot = instance("robot", self.robot, Robot, "a Robot")
        scale = number("scale", self.scale, "a share in (0, 1] of the efforts", math.ulp(0.0), 1.0)
        links = () if robot.dynamics is None else robot.dynamics.links
        dynamics = InverseDynamics(robot, (*links, *self.loads))
        lacking = _lacking(robot, links)
        if lacking:
            message = f"robot {robot.name}: {lacking}, so its torques are not known"
            raise InvalidRequest("robot", robot.name, "a robot whose URDF has masses and efforts", message=message)
        effort = robot.limits.velocity if robot.dynamics is None else robot.dynamics.effort
        set_fields(self, limit=read_only(effort * scale), scale=scale, _dynamics=dynamics)

    def torques(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Torques (m, n) at configurations, rates and accelerations (m, n): Nm, N of prismatic joints."""
        return np.asarray(self._dynamics.torques(q, qd[None], qdd[None], [GRAVITY])[0])

    def objection(self, q: FloatArray) -> str:
        """Which joint cannot hold the robot still at q (n,), and by how much; empty if each can."""
        still = np.zeros((1, self.robot.n))
        held = np.abs(self.torques(q[None], still, still)[0])
        joint = int((held / self.limit).argmax())
        if held[joint] <= self.limit[joint]:
            return ""
        loads = math.fsum(load.mass for load in self.loads)
        what = f"{loads:.4g} kg" if loads > 0.0 else "the arm"
        unit = next("N" if body.prismatic else "Nm" for body in self.robot.bodies[1:] if body.q_index == joint)
        taken = f"{held[joint]:.4g} of {self.limit[joint]:.4g} {unit}"
        return f"{self.robot.joint_names[joint]} cannot hold {what} here: {taken}"

    def objection_on(self, path: JointPath) -> str:
        """The first of some places on a path where a joint cannot hold the robot still, in words; empty if none is."""
        at = np.linspace(0.0, path.length, PLACES)
        found = ((s, self.objection(q)) for s, q in zip(at.tolist(), path(at), strict=True))
        return next((words.replace("here", f"at s = {s:.3g}") for s, words in found if words), "")

    def rows(self, q: FloatArray, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """a, b and c of torques a u + b x + c as shares of their limits, (m, n) each.

        Args:
            q: The path at m points, (m, n).
            first: Its first derivative there, (m, n).
            second: Its second derivative there, (m, n).
        """
        still = np.zeros_like(q)
        rates, accelerations = np.stack([still, first, still]), np.stack([first, second, still])
        a, b, c = self._dynamics.torques(q, rates, accelerations, [0.0, 0.0, GRAVITY]) / self.limit
        return a, b, c

    def samples(self, trajectory: Trajectory) -> TorqueSamples:
        """Torques along a motion, so dense that they are known in between to ``BETWEEN`` of their limits.

        Raises:
            InvalidRequest: The motion has another number of joints.
            TimingFailed: They change too fast to be verified.
        """
        path = instance("trajectory", trajectory, Trajectory, "a Trajectory").path
        if path.n != self.robot.n:
            raise InvalidRequest("trajectory", path.n, f"a motion of {self.robot.n} joints")
        if not len(trajectory.durations):
            still = np.zeros((1, path.n))
            moving, holding = still, self.torques(path.waypoints[:1], still, still) / self.limit
            return TorqueSamples(np.zeros(1), moving, holding)
        with np.errstate(over="ignore", invalid="ignore"):
            counts = self._intervals(trajectory)
        q, qd, qdd, times = _states(trajectory, counts)
        rates, accelerations = (np.stack([each, np.zeros_like(each)]) for each in (qd, qdd))
        moving, holding = self._dynamics.torques(q, rates, accelerations, [0.0, GRAVITY]) / self.limit
        return TorqueSamples(times, moving, holding)

    def _intervals(self, trajectory: Trajectory) -> IntArray:
        """Into how many parts each piece of s(t) is cut by its samples, (m,)."""
        bounds = _rate_bounds(trajectory)
        bending = torque_curvature(self._dynamics, np.abs(trajectory.path.waypoints).max(axis=0), bounds) / self.limit
        parts = np.ceil(trajectory.durations * np.sqrt(bending.max(axis=1) / (8.0 * BETWEEN)))
        if not float(parts.sum()) <= MAX_SAMPLES:
            raise TimingFailed(f"torques change too fast to be verified with {MAX_SAMPLES:,} samples")
        return np.asarray(np.maximum(parts, 1.0), dtype=np.intp)


def _lacking(robot: Robot, links: Sequence[LinkInertia]) -> str:
    """The first link or joint of which something is not known; empty if all is."""
    heavy = {item.body for item in links if item.mass > 0.0}
    for k, body in enumerate(robot.bodies[1:], start=1):
        if k not in heavy:
            link = next((frame.link for frame in robot.link_frames if frame.body == k), f"what {body.name} moves")
            return f"{link} has no mass"
    efforts = [] if robot.dynamics is None else robot.dynamics.effort.tolist()
    without = (name for name, effort in zip(robot.joint_names, efforts, strict=True) if not effort > 0.0)
    return "".join(f"{name} has no effort" for name in list(without)[:1])


def _states(trajectory: Trajectory, counts: IntArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """q, qd, qdd and times at both ends of each part of each piece of s(t), as the piece itself has them."""
    piece = np.repeat(np.arange(len(counts)), counts + 1)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(counts + 1) - (counts + 1), counts + 1)
    x = trajectory.durations[piece] * (place / counts[piece])
    c0, c1, c2, c3 = trajectory.coefficients[piece].T
    ends = np.append(trajectory.coefficients[1:, 0], trajectory.end)
    s = np.minimum(np.maximum(c0 + x * (c1 + x * (c2 + x * c3)), c0), ends[piece])
    v, a = (c1 + x * (2.0 * c2 + 3.0 * c3 * x))[:, None], (2.0 * c2 + 6.0 * c3 * x)[:, None]
    q, first, second = (trajectory.path.on_pieces(trajectory.geometry[piece], s, order) for order in range(3))
    return q, first * v, first * a + second * v * v, trajectory.knots[piece] + x


def _rate_bounds(trajectory: Trajectory) -> list[FloatArray]:
    """Bounds of the first to fourth derivatives of q by time on each piece of s(t), (m, n) each.

    By the chain rule from those of s(t), a cubic, and of q(s), whose blends are of degree six (``corner_blend``).
    """
    h, (_, c1, c2, c3) = trajectory.durations, trajectory.coefficients.T
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = np.clip(np.where(c3 != 0.0, -c2 / (3.0 * c3), 0.0), 0.0, h)
    v = np.max([np.abs(c1 + x * (2.0 * c2 + 3.0 * c3 * x)) for x in (0.0 * h, turning, h)], axis=0)[:, None]
    a = np.maximum(np.abs(2.0 * c2), np.abs(2.0 * c2 + 6.0 * c3 * h))[:, None]
    j = np.abs(6.0 * c3)[:, None]
    q1, q2, q3, q4 = _path_bounds(trajectory)
    return [
        q1 * v,
        q1 * a + q2 * v * v,
        q1 * j + 3.0 * q2 * v * a + q3 * v * v * v,
        q2 * (4.0 * v * j + 3.0 * a * a) + 6.0 * q3 * v * v * a + q4 * v * v * v * v,
    ]


def _path_bounds(trajectory: Trajectory) -> list[FloatArray]:
    """Bounds of the first to fourth derivatives of q by s on each piece of s(t), (m, n) each."""
    path: JointPath = trajectory.path
    pieces = trajectory.geometry
    before, after = (path.on_pieces(pieces, path.breaks[pieces + k], 1) for k in range(2))
    first = np.maximum(np.abs(before), np.abs(after))
    half = (path.breaks[pieces + 1] - path.breaks[pieces])[:, None] / 2.0  # the width d of a blend
    turn = np.where(path.blended[pieces][:, None], np.abs(after - before), 0.0)
    steepest = (0.625, 2.5, 7.5)  # largest derivatives of f(y) = 1/2 + (5 y - y^5) / 8
    return [first, *(turn * slope / half ** (k + 1) for k, slope in enumerate(steepest))]
