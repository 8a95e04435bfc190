"""Whether answers of complete inverse kinematics are true, by interval arithmetic that shares no code with them.

Numbers are pairs of arrays, low and high; each operation rounds outwards by a unit in the last place. Axes and poses
are multiplied out along the chain of bodies, and a box is believed if Krawczyk's operator maps it into itself
(Computing 4, 1969): then it holds exactly one solution.
"""

from __future__ import annotations

import math

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Robot

__all__ = ["complaints"]

Interval = tuple[FloatArray, FloatArray]


def complaints(robot: Robot, pose: Pose, q: FloatArray, lower: FloatArray, upper: FloatArray) -> list[str]:
    """What is wrong with solutions q (k, n) and their boxes, for an arm with six joints."""
    found = []
    for k, (at, low, high) in enumerate(zip(q, lower, upper, strict=True)):
        if not np.all((robot.limits.lower <= low) & (low <= at) & (at <= high) & (high <= robot.limits.upper)):
            found.append(f"{k}: outside the limits, or not in its box")
        elif not _exactly_one(robot, pose, at, low, high):
            found.append(f"{k}: not proven to be alone in its box")
        found += [f"{k} and {j}: boxes meet" for j in range(k) if np.all((low <= upper[j]) & (lower[j] <= high))]
    return found


def _exactly_one(robot: Robot, pose: Pose, q: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    value, _ = _residual(robot, pose, (q, q))
    _, slope = _residual(robot, pose, (low, high))
    try:
        Y = np.asarray(np.linalg.inv((slope[0] + slope[1]) / 2.0), dtype=np.float64)
    except np.linalg.LinAlgError:
        return False
    linear = _minus(_exact(np.eye(robot.n)), _product(_exact(Y), slope))
    moved = _product(_exact(Y), tuple(v[:, None] for v in value))  # type: ignore[arg-type]
    rest = _product(linear, tuple(v[:, None] for v in _minus((low, high), _exact(q))))  # type: ignore[arg-type]
    image = _plus(_minus(_exact(q[:, None]), moved), rest)
    return bool(np.all(image[0][:, 0] > low) and np.all(image[1][:, 0] < high))


def _residual(robot: Robot, pose: Pose, q: Interval) -> tuple[Interval, Interval]:
    """Six numbers (6,) that are 0 at the pose, and their derivatives (6, n), over a box of configurations."""
    chain = []
    index = robot.tool_body
    while index > 0:
        chain.append(robot.bodies[index])
        index = robot.bodies[index].parent
    axes = []
    T = _exact(np.eye(4).reshape(4, 4))
    for body in reversed(chain):
        T = _product(T, _exact(body.placement))
        angle = _times(_exact(np.array(body.multiplier)), (q[0][body.q_index], q[1][body.q_index]))
        axis = _product(_part(T, slice(3), slice(3)), _exact(body.axis[:, None]))
        axes.append((body, axis, _part(T, slice(3), slice(3, 4))))
        T = _product(T, _motion(body.axis, angle, slides=body.prismatic))
    T = _product(T, _exact(robot.tool_placement))
    R, p = _part(T, slice(3), slice(3)), _part(T, slice(3), slice(3, 4))
    back = _exact(pose.rotation.T)
    value = np.zeros((2, 6))
    slope = np.zeros((2, 6, robot.n))
    value[:, :3] = [v[:, 0] for v in _minus(p, _exact(np.array(pose.position)[:, None]))]
    value[:, 3:] = _vee(_product(back, R))
    for body, axis, origin in axes:
        if body.prismatic:
            moves, turns = axis, _exact(np.zeros(3))
        else:
            moves = _product(_skew(axis), _minus(p, origin))
            turns = _vee(_product(back, _product(_skew(axis), R)))
        column = np.concatenate([[v[:, 0] for v in moves], turns], axis=1)
        scaled = _times(_exact(np.array(body.multiplier)), (column[0], column[1]))
        slope[:, :, body.q_index] = _plus((slope[0][:, body.q_index], slope[1][:, body.q_index]), scaled)
    return (value[0], value[1]), (slope[0], slope[1])


def _motion(axis: FloatArray, angle: Interval, *, slides: bool) -> Interval:
    low, high = np.eye(4), np.eye(4)
    if slides:
        low[:3, 3], high[:3, 3] = _times(_exact(axis), angle)
        return low, high
    middle, half = (angle[0] + angle[1]) / 2.0, (angle[1] - angle[0]) / 2.0 + 1e-15
    cosine, sine = (
        _out((np.array(f(middle)) - half - 1e-15, np.array(f(middle)) + half + 1e-15)) for f in (math.cos, math.sin)
    )
    x, y, z = axis.tolist()
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = _plus(_exact(np.eye(3)), _times(sine, _exact(K)))
    turned = _plus(turned, _times(_minus(_exact(np.array(1.0)), cosine), _product(_exact(K), _exact(K))))
    low[:3, :3], high[:3, :3] = turned
    return low, high


def _vee(W: Interval) -> Interval:
    """Half of W - W' as a vector."""
    skew = _minus(W, (W[0].T, W[1].T))
    return tuple(0.5 * np.array([S[2, 1], S[0, 2], S[1, 0]]) for S in skew)  # type: ignore[return-value]


def _skew(v: Interval) -> Interval:
    low, high = v[0][:, 0], v[1][:, 0]
    out = np.zeros((2, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, j, i], out[:, i, j] = (low[k], high[k]), (-high[k], -low[k])
    return out[0], out[1]


def _exact(x: FloatArray) -> Interval:
    return (x, x)


def _part(T: Interval, rows: slice, columns: slice) -> Interval:
    return T[0][rows, columns], T[1][rows, columns]


def _out(x: Interval) -> Interval:
    return np.nextafter(x[0], -np.inf), np.nextafter(x[1], np.inf)


def _plus(x: Interval, y: Interval) -> Interval:
    return _out((x[0] + y[0], x[1] + y[1]))


def _minus(x: Interval, y: Interval) -> Interval:
    return _out((x[0] - y[1], x[1] - y[0]))


def _times(x: Interval, y: Interval) -> Interval:
    products = np.stack([x[i] * y[j] for i in (0, 1) for j in (0, 1)])
    return _out((products.min(axis=0), products.max(axis=0)))


def _product(A: Interval, B: Interval) -> Interval:
    """The matrix product."""
    total: Interval | None = None
    for k in range(A[0].shape[1]):
        term = _times((A[0][:, k, None], A[1][:, k, None]), (B[0][None, k], B[1][None, k]))
        total = term if total is None else _plus(total, term)
    assert total is not None
    return total
