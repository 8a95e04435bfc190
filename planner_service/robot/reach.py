"""Upper bounds of the distance of any point of the robot from each joint axis, which turn joint steps into metres.

If joint i moves by dq_i, no point moves farther than sum_i reach_i |dq_i|. The bound holds over all configurations,
even outside the limits (for a prismatic joint: within its travel). The distance is measured in legs from pivot to
pivot, where a pivot is a point on the axis of a later joint. A pivot is fixed in the bodies on both sides of its joint,
so the length of a leg does not depend on q, and the legs add up to at least the distance (triangle inequality). As long
as the axes are parallel to the first one, only lengths perpendicular to it count.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, Vector, along, cross_of, dot, minus, turned, vector
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.robot.kinematic_tree import Body, chain_to_base

__all__ = ["Placed", "reach_bounds"]

Placed = tuple[int, Shape, Pose]
"""A shape in a body: body index, shape, T_body_shape."""
Balls = tuple[FloatArray, FloatArray]
"""Centres (k, 3) and radii (k,)."""

ROUNDING = 1e-9
"""Relative: far above the rounding error of a few dozen operations, far below any length that matters."""
RIM_SIDES = 32
"""A cylinder's rim is replaced by a polygon around it; 32 sides overshoot its radius by 0.5 %."""
PARALLEL = 1e-18
"""Squared sine of the angle below which two axes count as parallel."""
NEARLY_PARALLEL = 1e-6
"""The same of axes that a file means to be parallel: a quarter turn written as 1.57 is off by 8e-4 rad."""
TILT = 1e-7
"""A hundred times the angle of ``PARALLEL``: no chain has more joints."""


def reach_bounds(bodies: Sequence[Body], travel: Sequence[float], shapes: Iterable[Placed]) -> list[float]:
    """For each joint, in order of q, an upper bound of the distance from its axis of anything that it moves.

    For a prismatic joint 1.0: metres of motion per metre. Where others mimic it, the sum over all of them on the way.

    Args:
        travel: Largest absolute position of each joint, in order of q; used for prismatic ones.
    """
    clouds: dict[int, list[Balls]] = {}
    for body, shape, pose in shapes:
        if body > 0:  # no joint moves what is on the base
            clouds.setdefault(body, []).append(_hull(shape, pose))
    out = [0.0] * len(travel)
    for joint in bodies[1:]:
        if joint.prismatic:
            out[joint.q_index] = max(out[joint.q_index], abs(joint.multiplier))
    for last, hulls in clouds.items():
        cloud = (np.concatenate([points for points, _ in hulls]), np.concatenate([radii for _, radii in hulls]))
        moved = [0.0] * len(travel)
        chain = chain_to_base(bodies, last)[::-1]
        for k, at in enumerate(chain):
            joint = bodies[at]
            far = 1.0 if joint.prismatic else _farthest(chain[k:], bodies, travel, cloud) * (1.0 + ROUNDING)
            moved[joint.q_index] += abs(joint.multiplier) * far
        out = [max(pair) for pair in zip(out, moved, strict=True)]
    return out


def _farthest(chain: Sequence[int], bodies: Sequence[Body], travel: Sequence[float], cloud: Balls) -> float:
    """Bound for the points of the last body of ``chain`` about the axis of its first."""
    about: Vector | None = vector(bodies[chain[0]].axis.tolist())
    pivot: Vector = (0.0, 0.0, 0.0)
    total = 0.0
    for index in chain[1:]:
        body = bodies[index]
        if body.prismatic:  # the pivot slides along with the body
            total += abs(body.multiplier) * travel[body.q_index]
        else:
            axis = turned(vector(body.axis.tolist()), body.placement)
            onto = _nearest(vector(body.placement[:3, 3].tolist()), axis, pivot, about)
            total += float(_across(np.array([minus(onto, pivot)]), about)[0])
            pivot = onto
            if about is not None and not _is_parallel(axis, about):
                about = None
        back = body.placement[:3, :3].T
        about = None if about is None else turned(about, back)
        pivot = turned(minus(pivot, vector(body.placement[:3, 3].tolist())), back)
    points, radii = cloud
    return total + float((_across(points - pivot, about) + radii).max())


def _nearest(origin: Vector, axis: Vector, pivot: Vector, about: Vector | None) -> Vector:
    """The point of a line nearest to ``pivot``, measured perpendicular to ``about`` unless the two are nearly parallel.

    Any point of the line gives a bound. Of two lines that are parallel but for a rounded angle in the file, the point
    nearest across is kilometres away along them, and so would be the next leg.
    """
    offset, along = minus(origin, pivot), axis
    if about is not None and not _is_parallel(axis, about, NEARLY_PARALLEL):
        offset, along = _reject(offset, about), _reject(axis, about)
    t = -dot(offset, along) / dot(along, along)
    return (origin[0] + t * axis[0], origin[1] + t * axis[1], origin[2] + t * axis[2])


def _across(offsets: FloatArray, about: Vector | None) -> FloatArray:
    """Lengths (k,) of vectors (k, 3), or of their parts perpendicular to ``about``.

    ``about`` may differ from the true axis by the angle that counts as parallel, which changes that part by at most the
    angle times the length; adding this keeps the result an upper bound.
    """
    length = _lengths(offsets)
    if about is None:
        return length
    parts = offsets - along(offsets, np.array(about))[:, None] * about
    return np.minimum(length, _lengths(parts) + TILT * length)


def _lengths(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    return np.asarray(np.sqrt(x * x + y * y + z * z))


def _is_parallel(a: Vector, b: Vector, below: float = PARALLEL) -> bool:
    """Whether the squared sine of the angle between two axes is ``below`` that."""
    cross = cross_of(a, b)
    return dot(cross, cross) < below


def _hull(shape: Shape, pose: Pose) -> Balls:
    """Balls whose convex hull contains the shape, in body coordinates."""
    points, radius = _local_hull(shape)
    return along(points, pose.rotation).T + pose.position, np.full(len(points), radius)


def _local_hull(shape: Shape) -> tuple[FloatArray, float]:
    """Centres (k, 3) of such balls in the shape's own frame, and their radius."""
    if isinstance(shape, Box):
        x, y, z = shape.half
        return np.array([(sx * x, sy * y, sz * z) for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]), 0.0
    if isinstance(shape, Sphere):
        return np.zeros((1, 3)), shape.radius
    if isinstance(shape, Capsule):
        return np.array([(0.0, 0.0, end * shape.length / 2) for end in (-1, 1)]), shape.radius
    if isinstance(shape, Cylinder):
        corner = shape.radius / math.cos(math.pi / RIM_SIDES)
        angles = [2.0 * math.pi * k / RIM_SIDES for k in range(RIM_SIDES)]
        rim = [(corner * math.cos(angle), corner * math.sin(angle)) for angle in angles]
        return np.array([(x, y, end * shape.length / 2) for x, y in rim for end in (-1, 1)]), 0.0
    if isinstance(shape, Mesh):
        return shape.vertices, 0.0
    raise BrokenInvariant(f"no hull is known for {type(shape).__name__}")


def _reject(part: Vector, unit: Vector) -> Vector:
    along = dot(part, unit)
    return (part[0] - along * unit[0], part[1] - along * unit[1], part[2] - along * unit[2])
