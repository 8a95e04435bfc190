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

__all__ = ["peak_tool_speed", "tool_speeds"]


def peak_tool_speed(robot: Robot, trajectory: Trajectory) -> float:
    """The largest speed in m/s of the tool frame's origin, to about six digits."""
    speed: float = (
        load_core()
        .TrajectoryTables(*trajectory.tables)
        .peak_tool_speed(robot.body_table, robot.tool_body, robot.tool_placement[:3, 3].tolist())
    )
    return speed


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
