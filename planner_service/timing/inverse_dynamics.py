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
        rows = (np.ascontiguousarray(each).reshape(-1, self.robot.n) for each in (q, qd, qdd))
        out: FloatArray = load_core().inverse_dynamics(self.robot.body_table, self._table, *rows, np.array(gravity))
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
