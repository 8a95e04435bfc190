"""Joint torques of motions, and how fast they can change: a bound of their second derivative by time.

Torques are those of the recursive Newton-Euler algorithm, many states at once, with the same bits on every processor:
tau = M(q) qdd + C(q, qd) qd + g(q), with gravity along -z of the base frame and without friction (Featherstone, Rigid
Body Dynamics Algorithms, 2008, ch. 5; here with all vectors in the axes of the base).

A torque is tau_a = z_a . sum_i [(c_i - p_a) x m_i (c_i'' + g) + d/dt (R_i I_i R_i^T omega_i)] over the bodies i that
joint a moves. Each factor is bounded in norm, with its derivatives, from the base outwards; derivatives of products
follow Leibniz' rule and those of a rotation exp(axis q(t)) the complete Bell polynomials of abs(q'), abs(q''), ...
Rotations keep norms, so the bound holds for every configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import FloatArray, along
from planner_service.native.loading import load_core
from planner_service.robot.inertia import LinkInertia, symmetric
from planner_service.robot.model import Robot

__all__ = ["GRAVITY", "BodyInertia", "InverseDynamics", "torque_curvature"]


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


Jet = list[FloatArray]
"""Bounds of the norm of a quantity and of its derivatives by time, each of shape (k,)."""


def torque_curvature(dynamics: InverseDynamics, q: FloatArray, rates: Sequence[FloatArray]) -> FloatArray:
    """Bounds of abs(d2 tau/dt2) of each joint on k stretches of time, shape (k, n).

    Args:
        q: Bounds of abs(q), shape (n,); they count for prismatic joints only.
        rates: Bounds of the absolute first to fourth derivatives of q, four of shape (k, n).
    """
    bodies, count = dynamics.robot.bodies, len(rates[0])
    one: FloatArray = np.ones(count)
    zero: FloatArray = np.zeros(count)
    still: Jet = [zero] * 4
    rotation: list[Jet] = [[one, *still]]
    origin: list[Jet] = [[zero, *still]]
    omega: list[Jet] = [still]
    for body in bodies[1:]:
        share = abs(body.multiplier)
        carried, u = rotation[body.parent], [share * rate[:, body.q_index] for rate in rates]
        offset = math.sqrt(sum(x * x for x in body.placement[:3, 3].tolist()))
        place = [o + offset * r for o, r in zip(origin[body.parent], carried, strict=True)]
        if body.prismatic:
            slide = _product(carried, [one * (share * q[body.q_index]), *u])
            rotation.append(carried)
            origin.append([o + s for o, s in zip(place, slide, strict=True)])
            omega.append(omega[body.parent])
        else:
            rotation.append(_product(carried, _turn(u)))
            origin.append(place)
            spin = _product(carried[:4], u)
            omega.append([w + s for w, s in zip(omega[body.parent], spin, strict=True)])
    forces, moments = [], []  # m (c'' + g) and the change of angular momentum, up to their second derivatives
    levers: list[Jet] = []
    for k, (mass, centre, tensor) in enumerate(dynamics.bodies):
        reach = math.sqrt(sum(x * x for x in centre.tolist()))
        levers.append([o + reach * r for o, r in zip(origin[k], rotation[k], strict=True)])
        forces.append([mass * (levers[k][2] + GRAVITY), mass * levers[k][3], mass * levers[k][4]])
        largest = float(np.abs(np.linalg.eigvalsh(tensor)).max())
        spins = _product(_product(rotation[k][:4], rotation[k][:4]), omega[k])
        moments.append([largest * each for each in spins[1:]])
    out = np.zeros((count, dynamics.robot.n))
    for a, body in enumerate(bodies[1:], start=1):
        total: Jet = [zero] * 3
        for i in _moved_by(dynamics, a):
            if not dynamics.bodies[i].mass > 0.0:
                continue
            push = forces[i]
            if not body.prismatic:
                lever = [x - y for x, y in zip(levers[i][:3], origin[a], strict=False)]
                push = [f + m for f, m in zip(_product(lever, forces[i]), moments[i], strict=True)]
            total = [x + y for x, y in zip(total, push, strict=True)]
        out[:, body.q_index] += abs(body.multiplier) * _product(rotation[body.parent][:3], total)[2]
    return out


def _moved_by(dynamics: InverseDynamics, a: int) -> list[int]:
    """Body a and those that it carries."""
    carried = {a}
    for k, body in enumerate(dynamics.robot.bodies):
        if body.parent in carried:
            carried.add(k)
    return sorted(carried)


def _product(a: Jet, b: Jet) -> Jet:
    """Leibniz' rule, for as many derivatives as both have."""
    out = []
    for k in range(len(a)):
        total = a[0] * b[k]
        for j in range(1, k + 1):
            total = total + math.comb(k, j) * (a[j] * b[k - j])
        out.append(total)
    return out


def _turn(u: Jet) -> Jet:
    """A rotation about a fixed axis by an angle whose derivatives have these bounds, from the first to the fourth."""
    a, b, c, d = u
    square = a * a
    return [np.ones_like(a), a, b + square, c + 3.0 * a * b + a * square,
            d + 4.0 * a * c + 3.0 * b * b + 6.0 * square * b + square * square]  # fmt: skip
