"""How fast the origin of the tool frame moves, at given states and at most along a trajectory.

That speed is not a polynomial in time, so its peak is found by sampling, ever denser around the highest samples.
"""

from __future__ import annotations

import numpy as np

from planner_service.geometry.arrays import FloatArray, cross
from planner_service.native.loading import load_core
from planner_service.path.trajectory import Trajectory
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

__all__ = ["peak_tool_speed", "reference_tool_speed", "tool_speeds"]

SPACING = 0.04
"""Radians of path between the first samples, on average: joints that turn so little hardly bend the tool's path."""

CLOSER_LOOKS = 2

SPLITS = np.arange(33) / 32

MISSED, CLOSER = 0.003, 1024.0
"""Share by which the speed between two first samples may exceed that at them, and the factor by which this shrinks when
samples are 32 times closer: speed is smooth between the ends of pieces of time, which are sampled themselves."""


def peak_tool_speed(robot: Robot, trajectory: Trajectory) -> float:
    """The largest speed in m/s of the tool frame's origin, to about six digits."""
    core = load_core()
    if core is None:
        return reference_tool_speed(robot, trajectory)
    speed: float = core.TrajectoryTables(*trajectory.tables).peak_tool_speed(
        robot.body_table, robot.tool_body, robot.tool_placement[:3, 3].tolist()
    )
    return speed


def reference_tool_speed(robot: Robot, trajectory: Trajectory) -> float:
    """``peak_tool_speed`` in Python: the same bits."""
    if not len(trajectory.durations):
        return 0.0
    t, best, missed = _instants(trajectory), 0.0, MISSED
    for _ in range(CLOSER_LOOKS + 1):
        speeds = tool_speeds(robot, *trajectory.moving(t))
        best = max(best, float(speeds.max()))
        if best == 0.0:  # a tool that joints turn about its own origin, or one that hangs from other joints
            break
        (near,) = (np.maximum(speeds[1:], speeds[:-1]) > best * (1.0 - missed)).nonzero()
        closer = t[near, None] + (t[near + 1] - t[near])[:, None] * SPLITS
        t, missed = np.minimum(closer.reshape(-1), trajectory.duration), missed / CLOSER
    return best


def _instants(trajectory: Trajectory) -> FloatArray:
    """The first samples of a trajectory: the ends of its pieces of time, and more between them where it moves far."""
    starts = trajectory.coefficients[:, 0]
    lengths = np.concatenate([starts[1:], [trajectory.end]]) - starts
    counts = np.maximum(np.ceil(lengths / SPACING), 1.0).astype(np.intp)
    piece = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = trajectory.knots[piece] + trajectory.durations[piece] * (within / counts[piece])
    return np.asarray(np.minimum(np.concatenate([t, [trajectory.duration]]), trajectory.duration))


def tool_speeds(robot: Robot, Q: FloatArray, Qd: FloatArray) -> FloatArray:
    """The speed (m/s) of the tool frame's origin at configurations Q (m, n) with velocities Qd (m, n), shape (m,)."""
    R, t = robot.body_poses_batch(Q, portable=True)
    x, y, z = robot.tool_placement[:3, 3].tolist()
    at = t[:, robot.tool_body] + _turned(R[:, robot.tool_body], (x, y, z))
    chain = chain_to_base(robot.bodies, robot.tool_body)
    if not chain:
        return np.zeros(len(t))
    bodies = [robot.bodies[index] for index in chain]
    axes = np.array([body.axis for body in bodies])[:, :, None, None]  # a row per joint, a column per sample
    columns, origins = R.transpose(1, 3, 2, 0)[chain], t.transpose(1, 2, 0)[chain]
    moves = columns[:, 0] * axes[:, 0] + columns[:, 1] * axes[:, 1] + columns[:, 2] * axes[:, 2]
    turns = [not body.prismatic for body in bodies]
    moves[turns] = cross(moves[turns], at.T - origins[turns], axis=1)
    multipliers = np.array([body.multiplier for body in bodies])[:, None]
    moves *= (Qd.T[[body.q_index for body in bodies]] * multipliers)[:, None]
    velocity = np.add.accumulate(moves, axis=0)[-1]  # in one order: durations depend on it
    return np.asarray(np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2))


def _turned(R: FloatArray, vector: tuple[float, float, float]) -> FloatArray:
    """One vector rotated by many rotations (m, 3, 3); (m, 3)."""
    x, y, z = vector
    return np.asarray(R[:, :, 0] * x + R[:, :, 1] * y + R[:, :, 2] * z)
