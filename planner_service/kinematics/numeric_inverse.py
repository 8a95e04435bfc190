"""How close an arm comes to a pose of its tool that may be out of reach: damped least squares, many starts at once.

Each start takes Levenberg-Marquardt steps dq = Jᵀ (J Jᵀ + λ I)⁻¹ e. A joint at a limit stays there while the gradient
pushes it outwards. All starts are stepped together, in elementwise arithmetic,
so that the result of one start depends neither on the others nor on the linear algebra library.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray, cross
from planner_service.geometry.shapes import Pose
from planner_service.robot.kinematic_tree import chain_to_base
from planner_service.robot.model import Robot

__all__ = ["STEPS", "Bounds", "Descent", "approach", "length_scale"]

DAMPING_FLOOR = 1e-11
"""Keeps J Jᵀ invertible at singularities and for arms of fewer than six joints; rounding there is near 1e-13."""

MAX_STEP = 2.0
"""The most that a joint moves (rad) in one step; beyond, the linear model is useless. At 0.5 and 1.0 fewer starts
arrive."""

AT_LIMIT = 1e-12
"""A joint this close to its limit (rad) is on it."""

STEPS = 40
"""The most steps of a start."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING, DAMPING_FACTOR = 1e-2, 1e-9, 1e6, 4.0
"""λ of ``approach``, per largest diagonal entry of J Jᵀ; with the most of it a step is too short to matter."""

ARRIVED_COST = 1e-20
"""Squared error below which ``approach`` has arrived."""

SPAN_SHARE = 0.2
"""A metre counts as a radian at this share of the stretched arm's length. Of 0.1 to 1.0, most starts arrive at 0.1 and
0.2 (40 % on the WidowX AI for random reachable poses, 37 % at 1.0)."""


Bounds = tuple[FloatArray, FloatArray]
"""Lowest and highest values of the joints."""


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the starts ended: ``q`` (m, n), and for each whether its tool is at the pose, ``arrived`` (m,)."""

    q: FloatArray
    arrived: np.ndarray[tuple[int], np.dtype[np.bool_]]


def approach(robot: Robot, pose: Pose, starts: FloatArray, weights: tuple[float, float], *, steps: int) -> FloatArray:
    """Move all starts to where the tool is as close to ``pose`` as it comes from there, within the limits, (m, n).

    Unlike ``descended`` it ends at the least error where the pose is out of reach: λ shrinks with each step that lowers
    the weighted error and grows with each that does not, which is not taken (Marquardt, J. SIAM 11(2), 1963).

    Args:
        starts: Shape (m, n).
        weights: Of the position's error and of the orientation's, on top of ``length_scale``.
    """
    chain = _Chain(robot)
    lower, upper = robot.limits.lower[:, np.newaxis], robot.limits.upper[:, np.newaxis]
    weight = np.repeat(weights, 3)[:, np.newaxis]
    target = pose.rotation, np.array(pose.position)

    def at(q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        error, jacobian, _ = chain.error(q, target)
        return weight * error, weight[:, np.newaxis] * jacobian, _sum_products(weight * error, weight * error)

    q = np.minimum(np.maximum(np.asarray(starts, dtype=np.float64).T, lower), upper)
    error, jacobian, cost = at(q)
    damping = np.full(q.shape[1], FIRST_DAMPING)
    for _ in range(steps):
        rows = _sum_products(jacobian.swapaxes(0, 1), jacobian.swapaxes(0, 1)).max(axis=0)
        move = _step(q, error, jacobian, (lower, upper), damping * rows + DAMPING_FLOOR)
        trial = np.minimum(np.maximum(q + move, lower), upper)
        there = at(trial)
        better = there[2] < cost
        q, error, jacobian, cost = (
            np.where(better, new, old) for new, old in zip((trial, *there), (q, error, jacobian, cost), strict=True)
        )
        damping = np.where(better, np.maximum(damping / DAMPING_FACTOR, LEAST_DAMPING), damping * DAMPING_FACTOR)
        if not np.any((damping < MOST_DAMPING) & (cost > ARRIVED_COST)):
            break
    return np.ascontiguousarray(q.T)


def _step(q: FloatArray, error: FloatArray, jacobian: FloatArray, bounds: Bounds, damping: FloatArray) -> FloatArray:
    """dq (n, m) for configurations (n, m), errors (6, m), Jacobians (6, n, m) and λ (m,)."""
    lower, upper = bounds
    pull = _sum_products(jacobian, error[:, np.newaxis])
    held = ((q <= lower + AT_LIMIT) & (pull < 0.0)) | ((q >= upper - AT_LIMIT) & (pull > 0.0))
    J = np.where(held, 0.0, jacobian)
    columns = J.swapaxes(0, 1)
    normal = _sum_products(columns[:, :, np.newaxis], columns[:, np.newaxis])
    for i in range(6):
        normal[i, i] += damping
    dq = _sum_products(J, _solved(normal, error)[:, np.newaxis])
    longest = np.abs(dq).max(axis=0)
    return np.asarray(dq * (MAX_STEP / np.maximum(longest, MAX_STEP)))


def _sum_products(a: FloatArray, b: FloatArray) -> FloatArray:
    """The sum of a[k] * b[k] over k, in order."""
    total: FloatArray = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """x with ``matrix`` x = ``right``, for positive definite matrices (6, 6, m), by Cholesky decomposition."""
    A, x = matrix.copy(), right.copy()
    size = len(A)
    for j in range(size):
        A[j, j] = np.sqrt(A[j, j])
        A[j + 1 :, j] /= A[j, j]
        x[j] /= A[j, j]
        A[j + 1 :, j + 1 :] -= A[j + 1 :, np.newaxis, j] * A[np.newaxis, j + 1 :, j]
        x[j + 1 :] -= A[j + 1 :, j] * x[j]
    for j in reversed(range(size)):
        x[j] /= A[j, j]
        x[:j] -= A[j, :j] * x[j]
    return x


class _Chain:
    """The bodies between base and tool as arrays; other joints do not move the tool."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        indices = chain_to_base(robot.bodies, robot.tool_body)
        bodies = [robot.bodies[i] for i in indices]
        self._indices = indices
        self._joints = [body.q_index for body in bodies]
        self._multipliers = np.array([body.multiplier for body in bodies])[:, None, None]
        self._slides = np.array([body.prismatic for body in bodies], dtype=np.bool_)
        self._axes = np.array([body.axis for body in bodies]).reshape(-1, 3, 1)
        placement = robot.tool_placement
        self._turn, self._offset = placement[:3, :3], placement[:3, 3]
        self._scale = length_scale(robot)

    def error(self, q: FloatArray, target: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """At q (n, m) the scaled error (6, m), its Jacobian (6, n, m), and the larger error in m and rad (m,)."""
        rotations, positions = self._robot.body_poses_batch(q.T)
        R, t = rotations.transpose(1, 2, 3, 0), positions.transpose(1, 2, 0)
        body = R[self._indices[0]].swapaxes(0, 1)
        tool = _sum_products(body[:, :, np.newaxis], self._turn[:, np.newaxis, :, np.newaxis])
        point = t[self._indices[0]] + _sum_products(body, self._offset[:, np.newaxis, np.newaxis])
        shift = target[1][:, np.newaxis] - point
        turn, angle = _rotation_vector(tool, target[0])
        off = np.maximum(np.sqrt(_sum_products(shift, shift)), angle)
        return np.concatenate([shift * self._scale, turn]), self._jacobian(R, t, point), off

    def _jacobian(self, R: FloatArray, t: FloatArray, point: FloatArray) -> FloatArray:
        axes = _sum_products(R[self._indices].transpose(2, 0, 1, 3), self._axes.swapaxes(0, 1)[..., np.newaxis, :])
        lever = point - t[self._indices]
        linear = np.where(self._slides[:, np.newaxis, np.newaxis], axes, cross(axes, lever, axis=1))
        angular = np.where(self._slides[:, np.newaxis, np.newaxis], 0.0, axes)
        out = np.zeros((6, self._robot.n, point.shape[1]))
        linear, angular = linear * self._scale * self._multipliers, angular * self._multipliers
        for joint, along, about in zip(self._joints, linear, angular, strict=True):
            out[:3, joint] += along
            out[3:, joint] += about
        return out


def _rotation_vector(current: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation vectors (3, m), world axes, from ``current`` (3, 3, m) to ``target`` (3, 3), and their lengths (m,)."""
    E = _sum_products(target.T[:, :, np.newaxis, np.newaxis], current.swapaxes(0, 1)[:, np.newaxis])
    v = np.stack([E[2, 1] - E[1, 2], E[0, 2] - E[2, 0], E[1, 0] - E[0, 1]]) / 2
    sine = np.sqrt(_sum_products(v, v))
    cosine = (E[0, 0] + E[1, 1] + E[2, 2] - 1.0) / 2
    # numpy's arc tangent depends on the instruction set, math's does not
    angle = np.array([math.atan2(s, c) for s, c in zip(sine.tolist(), cosine.tolist(), strict=True)])
    return v * np.where(sine > 0.0, angle / np.where(sine > 0.0, sine, 1.0), 1.0), angle


def length_scale(robot: Robot) -> float:
    """Radians that a metre counts as: one over a share of the stretched arm from first joint to tool."""
    indices = chain_to_base(robot.bodies, robot.tool_body)
    offsets = [robot.bodies[i].placement[:3, 3] for i in indices[:-1]] + [robot.tool_placement[:3, 3]]
    total = sum(math.sqrt(sum(v * v for v in offset.tolist())) for offset in offsets)
    return 1.0 / (SPAN_SHARE * total) if total > 0.0 else 1.0
