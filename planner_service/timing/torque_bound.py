"""How fast torques can change: a bound of their second derivative by time, from bounds of the joints' derivatives.

A torque is tau_a = z_a . sum_i [(c_i - p_a) x m_i (c_i'' + g) + d/dt (R_i I_i R_i^T omega_i)] over the bodies i that
joint a moves. Each factor is bounded in norm, with its derivatives, from the base outwards; derivatives of products
follow Leibniz' rule and those of a rotation exp(axis q(t)) the complete Bell polynomials of abs(q'), abs(q''), ...
Rotations keep norms, so the bound holds for every configuration.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.timing.inverse_dynamics import GRAVITY, InverseDynamics

__all__ = ["torque_curvature"]

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
