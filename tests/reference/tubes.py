"""Straight edges with room beside them, judged slowly: poses are Pinocchio's, gaps Coal's, and every bound is a sum.

``planner_service/certify/native`` has the same with sifting, one tree for all pairs and numbers that are kept; what it
proves is in ``docs/design/the-gate.md``. Joints that follow others are not known here.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from auditor.checker import IndependentChecker
from planner_service.geometry.arrays import FloatArray

__all__ = ["Joint", "Solid", "Tubes", "approach", "moved_height"]

DEPTH, PARTS = 9, 100
"""Halvings of an edge, and parts of its room that are looked at."""


@dataclass(frozen=True)
class Joint:
    """A joint as it stands: where it is, along what it turns or slides, and the entry of q that moves it."""

    axis: FloatArray
    origin: FloatArray
    slides: bool
    column: int


@dataclass(frozen=True)
class Solid:
    """The hull of corners (k, 3), with a disc across ``normal`` and a ball at every one of its points."""

    corners: FloatArray
    disc: float = 0.0
    ball: float = 0.0
    normal: FloatArray | None = None

    def farthest(self, joint: Joint) -> float:
        """How far a point of it is from the axis of a joint that turns, at most."""
        off = (self.corners - joint.origin) @ _across(joint.axis)
        return math.sqrt(float((off * off).sum(axis=1).max())) + self.disc + self.ball

    def widened(self, v: FloatArray) -> float:
        """By how much its disc changes what v gives a point."""
        return 0.0 if self.normal is None else self.disc * float(np.linalg.norm(v - (v @ self.normal) * self.normal))


def approach(solid: Solid, joints: Sequence[Joint], n: FloatArray, moved: FloatArray, order: int) -> float:
    """How much lower along n a solid gets, at most, while each of its joints moves so far.

    The terms of Taylor's theorem up to ``order`` as they are at each corner, the rest by its norm; a ball around a core
    stays the same ball.

    Args:
        joints: That carry it, the one nearest to it first.
        moved: Of each of these joints.
        order: 0, 1 or 2; of order 0 it is how far any point moves.
    """
    first, second = list[tuple[FloatArray, FloatArray]](), list[tuple[FloatArray, FloatArray]]()
    constant, radii, swept = 0.0, list[float](), 0.0
    for k, joint in enumerate(joints):
        radii.append(1.0 if joint.slides else solid.farthest(joint) + swept)
        swept += radii[-1] * moved[k]
        if order == 0:
            continue
        if joint.slides:
            constant += moved[k] * abs(float(n @ joint.axis))
        else:
            first.append((moved[k] * _cross(n, joint.axis), joint.origin))
        for j, outer in enumerate(joints[: k + 1]):
            share = (0.5 if j == k else 1.0) * moved[j] * moved[k]
            if order == 1 or joint.slides:
                continue
            if outer.slides:
                constant += share * abs(float(n @ _cross(joint.axis, outer.axis)))
            else:  # n (z_k x (z_j x x)) is (((n x z_k) x z_j) x)
                second.append((share * _cross(_cross(n, joint.axis), outer.axis), outer.origin))
    terms, steps = [*first, *second], moved.tolist()
    heights = solid.corners @ n
    lower = heights - sum((np.abs((solid.corners - o) @ v) for v, o in terms), np.zeros(len(heights)))
    discs = sum(solid.widened(v) for v, _ in terms)
    rest = sum(
        math.prod(steps[k] for k in each) * radii[min(each)]
        for each in itertools.product(range(len(joints)), repeat=order + 1)
    ) / math.factorial(order + 1)
    return float(constant + discs + (heights.min() - lower.min()) + rest)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of two vectors: numpy's is for many, and takes forty times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _across(axis: FloatArray) -> FloatArray:
    """The matrix of the cross product with an axis."""
    x, y, z = axis.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def moved_height(solid: Solid, joints: Sequence[Joint], n: FloatArray, by: FloatArray) -> FloatArray:
    """How low along n a solid is once its joints have moved by (m, joints), the one nearest to it first, (m,)."""
    points = np.repeat(solid.corners[None], len(by), axis=0)
    normals = None if solid.normal is None else np.repeat(solid.normal[None], len(by), axis=0)
    for k, joint in enumerate(joints):
        if joint.slides:
            points = points + by[:, k, None, None] * joint.axis
            continue
        turns = _turns(joint.axis, by[:, k])
        points = np.einsum("mij,mkj->mki", turns, points - joint.origin) + joint.origin
        normals = None if normals is None else np.einsum("mij,mj->mi", turns, normals)
    low = (points @ n).min(axis=1) - solid.ball
    if normals is not None:
        low = low - solid.disc * np.sqrt(np.maximum(1.0 - (normals @ n) ** 2, 0.0))
    return np.asarray(low)


def _turns(axis: FloatArray, angles: FloatArray) -> FloatArray:
    K = _across(axis)
    sin, cos = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.asarray(np.eye(3) + sin * K + (1.0 - cos) * (K @ K))


class Tubes:
    """Judges edges of one robot in one scene."""

    def __init__(self, second: IndependentChecker) -> None:
        self._model, self._geometry = second.model, second.geometry
        self._data, self._shapes = self._model.createData(), self._geometry.createData()
        joints = [self._model.joints[self._model.getJointId(name)] for name in second.joints]
        self._slides = [each.shortname().startswith("JointModelP") for each in joints]
        self._columns = [self._model.joints[self._model.getJointId(name)].idx_q for name in second.joints]

    def free(self, a: FloatArray, b: FloatArray, room: FloatArray, enough: float) -> bool:
        """Whether every pair is proven more than ``enough`` metres apart on the edge and beside it."""
        return all(self._apart(k, a, b, room, enough) for k in range(len(self._geometry.collisionPairs)))

    def _apart(self, pair: int, a: FloatArray, b: FloatArray, room: FloatArray, enough: float) -> bool:
        """By the whole room, else by halves of it in the joint that moves the pair most."""
        left = [(a, b, room)]
        for _ in range(PARTS):
            if not left:
                return True
            a, b, room = left.pop()
            if self._free(pair, a, b, room, enough, DEPTH):
                continue
            _, n, sides = self._facing(pair, 0.5 * (a + b))
            moves = [0.0 if self._slides[k] else _closer(sides, n, one) for k, one in enumerate(np.diag(room))]
            side = 0.5 * np.eye(len(room))[int(np.argmax(moves))] * room
            if not side.any() or self._near(pair, 0.5 * (a + b), room, enough):
                return False
            left += [(a - side, b - side, room - side), (a + side, b + side, room - side)]
        return False

    def _near(self, pair: int, q: FloatArray, room: FloatArray, enough: float) -> bool:
        """Whether a pair is too near at q or at a corner of its room, to which its gap shrinks joint by joint."""
        least = self._facing(pair, q)[0]
        for one in np.diag(room):
            (least, _, q), *_ = sorted(
                (self._facing(pair, q + side * one)[0], side, q + side * one) for side in (-1, 1)
            )
            if least <= enough:
                return True
        return least <= enough

    def _free(self, pair: int, a: FloatArray, b: FloatArray, room: FloatArray, enough: float, depth: int) -> bool:
        """By what is known in the middle, else by halves; by none once the room alone is too much."""
        middle, half = 0.5 * (a + b), 0.5 * np.abs(b - a)
        gap, n, sides = self._facing(pair, middle)
        if gap - _closer(sides, n, half + room, enough=gap - enough) > enough:
            return True
        if depth == 0 or not gap - _closer(sides, n, room, enough=gap - enough) > enough:
            return False
        return all(self._free(pair, *ends, room, enough, depth - 1) for ends in ((a, middle), (middle, b)))

    def _facing(self, pair: int, q: FloatArray) -> tuple[float, FloatArray, list[tuple[Solid, list[Joint]]]]:
        """Coal's gap of a pair, the direction from the second to the first, and both with the joints that part them."""
        x = np.empty(self._model.nq)
        x[self._columns] = q
        pin.forwardKinematics(self._model, self._data, x)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._shapes)
        found = pin.computeDistance(self._geometry, self._shapes, pair)
        both = self._geometry.collisionPairs[pair]
        chains = [self._chain(self._geometry.geometryObjects[k].parentJoint) for k in (both.first, both.second)]
        sides = []
        for k, own, other in ((both.first, *chains), (both.second, *chains[::-1])):
            joints = [self._joint(number) for number in own if number not in other]
            sides.append((_solid(self._geometry.geometryObjects[k].geometry, self._shapes.oMg[k]), joints))
        return float(found.min_distance), -np.asarray(found.normal), sides

    def _chain(self, joint: int) -> list[int]:
        out = []
        while joint > 0:
            out.append(joint)
            joint = self._model.parents[joint]
        return out

    def _joint(self, number: int) -> Joint:
        pose, axis = self._data.oMi[number], self._data.joints[number].S.ravel()
        slides = not axis[3:].any()
        column = self._columns.index(self._model.joints[number].idx_q)
        return Joint(pose.rotation @ (axis[:3] if slides else axis[3:]), pose.translation.copy(), slides, column)


def _closer(
    sides: Sequence[tuple[Solid, Sequence[Joint]]], n: FloatArray, moved: FloatArray, *, enough: float = np.inf
) -> float:
    """How much closer two solids get; the least order's answer that is less than ``enough``."""
    out = np.inf
    for order in (0, 1, 2):
        out = min(
            out,
            sum(
                approach(solid, joints, side * n, moved[[joint.column for joint in joints]], order)
                for side, (solid, joints) in zip((1.0, -1.0), sides, strict=True)
            ),
        )
        if out < enough:
            break
    return float(out)


def _solid(shape: Any, pose: Any) -> Solid:
    """A shape of Coal where it stands."""

    def placed(corners: Any) -> FloatArray:
        return np.asarray(np.asarray(corners, dtype=np.float64) @ pose.rotation.T + pose.translation)

    if isinstance(shape, coal.Box):
        return Solid(placed(list(itertools.product(*((-half, half) for half in shape.halfSide)))))
    if isinstance(shape, coal.Sphere):
        return Solid(placed([[0.0, 0.0, 0.0]]), ball=shape.radius)
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        ends = placed([[0.0, 0.0, -shape.halfLength], [0.0, 0.0, shape.halfLength]])
        if isinstance(shape, coal.Capsule):
            return Solid(ends, ball=shape.radius)
        return Solid(ends, disc=shape.radius, normal=pose.rotation[:, 2].copy())
    return Solid(placed(shape.points()))
