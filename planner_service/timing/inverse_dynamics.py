"""Joint torques of a motion by the recursive Newton-Euler algorithm, for many states at once.

tau = M(q) qdd + C(q, qd) qd + g(q), with gravity along -z of the base frame and without friction (Featherstone, Rigid
Body Dynamics Algorithms, 2008, ch. 5; here with all vectors in the axes of the base). The same bits on every processor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import FloatArray, along
from planner_service.native.loading import load_core
from planner_service.robot.inertia import LinkInertia, symmetric
from planner_service.robot.model import Robot

__all__ = ["GRAVITY", "BodyInertia", "InverseDynamics"]

GRAVITY = 9.81
"""m/s^2, along -z of the base frame."""


class BodyInertia(NamedTuple):
    """The mass of a moving body (kg), its centre in the body's frame (3,), and its tensor about that (3, 3)."""

    mass: float
    centre: FloatArray
    tensor: FloatArray


class InverseDynamics:
    """Torques of a robot whose bodies have these masses.

    Attributes:
        bodies: The inertia of each body of the robot, the fixed base first.
    """

    def __init__(self, robot: Robot, masses: Sequence[LinkInertia]) -> None:
        self.robot = robot
        self.bodies = bodies = tuple(
            _merged([item for item in masses if item.body == k]) for k in range(len(robot.bodies))
        )
        self._table = np.array([[body.mass, *body.centre, *body.tensor.ravel()] for body in bodies])

    def torques(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: Sequence[float]) -> FloatArray:
        """Torques (v, m, n) in v cases of motion through each of m configurations.

        Args:
            q: Shape (m, n).
            qd, qdd: Rates and accelerations, (v, m, n).
            gravity: m/s^2 in each case, (v,).
        """
        core = load_core()
        if core is None:
            return self.reference_torques(q, qd, qdd, gravity)
        rows = (np.ascontiguousarray(each).reshape(-1, self.robot.n) for each in (q, qd, qdd))
        out: FloatArray = core.inverse_dynamics(self.robot.body_table, self._table, *rows, np.array(gravity))
        return out

    def reference_torques(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, gravity: Sequence[float]) -> FloatArray:
        """``torques`` in Python: the same bits."""
        rotations, positions = self.robot.body_poses_batch(q, portable=True)
        R = rotations.transpose(1, 2, 3, 0)[:, :, :, None, :]  # body, row, column, case, configuration
        p = positions.transpose(1, 2, 0)[:, :, None, :]
        shape = (3, len(gravity), len(q))
        lift: FloatArray = np.zeros(shape)
        lift[2] = np.asarray(gravity, dtype=np.float64)[:, None]
        still: FloatArray = np.zeros(shape)
        omega, alpha, moved, axes = [still], [still], [lift], [still]
        for k, body in enumerate(self.robot.bodies[1:], start=1):
            w, a, arm = omega[body.parent], alpha[body.parent], p[k] - p[body.parent]
            axis = _times(R[k], body.axis)
            rate, push = (body.multiplier * each[..., body.q_index] for each in (qd, qdd))
            spin, origin = axis * rate, moved[body.parent] + _cross(a, arm) + _cross(w, _cross(w, arm))
            if body.prismatic:
                origin = origin + axis * push + 2.0 * _cross(w, spin)
            else:
                w, a = w + spin, a + axis * push + _cross(w, spin)
            omega.append(w)
            alpha.append(a)
            moved.append(origin)
            axes.append(axis)
        forces, moments = ([np.zeros(shape) for _ in self.robot.bodies] for _ in range(2))  # about each body's origin
        out = np.zeros((len(gravity), len(q), self.robot.n))
        for k in range(len(self.robot.bodies) - 1, 0, -1):
            body, (mass, centre, tensor) = self.robot.bodies[k], self.bodies[k]
            if mass > 0.0:
                w, a, c = omega[k], alpha[k], _times(R[k], centre)
                force = mass * (moved[k] + _cross(a, c) + _cross(w, _cross(w, c)))
                forces[k] += force
                own = tensor[:, :, None, None]
                turning = [_times(R[k], _times(own, _times(R[k].swapaxes(0, 1), v))) for v in (a, w)]
                moments[k] += turning[0] + _cross(w, turning[1]) + _cross(c, force)
            x, y, z = axes[k] * (forces[k] if body.prismatic else moments[k])
            out[..., body.q_index] += body.multiplier * (x + y + z)
            forces[body.parent] += forces[k]
            moments[body.parent] += moments[k] + _cross(p[k] - p[body.parent], forces[k])
        return out


def _merged(masses: Sequence[LinkInertia]) -> BodyInertia:
    """Masses that move as one, by Steiner's theorem."""
    mass = sum(item.mass for item in masses)
    if not mass > 0.0:
        return BodyInertia(0.0, np.zeros(3), np.zeros((3, 3)))
    centre = sum((item.mass * np.array(item.pose.position) for item in masses), np.zeros(3)) / mass
    tensor = np.zeros((3, 3))
    for item in masses:
        R, (x, y, z) = item.pose.rotation, np.array(item.pose.position) - centre
        turned = along(R, along(R, symmetric(item.tensor)).T)  # R tensor R^T
        square = x * x + y * y + z * z
        tensor += turned + item.mass * (np.eye(3) * square - np.array([[u * v for u in (x, y, z)] for v in (x, y, z)]))
    return BodyInertia(mass, centre, tensor)


def _times(A: FloatArray, v: FloatArray) -> FloatArray:
    """Matrices (3, 3, ...) times vectors (3, ...)."""
    return np.asarray(A[:, 0] * v[0] + A[:, 1] * v[1] + A[:, 2] * v[2])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Vector products of vectors (3, ...)."""
    (x, y, z), (u, v, w) = a, b
    first = y * w - z * v
    out = np.empty((3, *first.shape))
    out[0], out[1], out[2] = first, z * u - x * w, x * v - y * u
    return out
