"""Taking the robot out of what a depth camera sees, so that the rest can be an obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray, along, blocks, quartered
from planner_service.geometry.composite import Composite, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Pose, Shape
from planner_service.geometry.validation import MAX_LENGTH, cloud, finite_numbers, instance, items, margin_of
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached

__all__ = ["remove_robot"]

MAX_POINTS = 5_000_000
"""Points of one call: more than any depth camera has."""

INWARD, ROUNDING = 1e-6, 1e-9
"""Metres behind a face to which a projection goes, so that it ends inside; what rounding may change of a distance."""

MAX_SAMPLES = 20_000
"""Points of a hull's surface from which on no face is divided: a tree of them is built in 5 ms."""

PROJECTIONS = 12
"""Projections into a hull at most."""


def remove_robot(
    points: ArrayLike, robot: Robot, q: ArrayLike, margin: float, attached: Sequence[Attached] = ()
) -> FloatArray:
    """The points (m, 3) that are farther than ``margin`` from the robot and from what it carries, in their order.

    Distances are those to the collision shapes at q, of all links, exact up to rounding. A ``PointCloud`` of what is
    left consists of whole cells, which reach ``resolution * sqrt(3)`` beyond a point at most: with a margin above that,
    and above the padding of the plans, none of them touches the robot at q.

    Args:
        points: Shape (n, 3), in metres in the robot's base frame.
        q: Shape (n,), where the robot was when they were measured; its gripper is as wide as ``robot`` says.
        margin: Metres. How far off points of the robot are: noise, calibration, motion during the measurement.
        attached: What it carries, as ``scene.attached``.

    Raises:
        InvalidRequest: points that are not finite (a camera's missing depths), beyond 1 km, of another shape or more
            than 5,000,000; not n finite joint values; a margin that is negative or above 1 km.
    """
    expected = f"finite points (n, 3) in metres, up to {MAX_LENGTH:g}, at most {MAX_POINTS:,} of them"
    rows = cloud("points", points, expected, 0, MAX_POINTS, MAX_LENGTH)
    instance("robot", robot, Robot, "a Robot")
    joints = finite_numbers("q", q, robot.n)
    held = items("attached", attached, Attached, "a sequence of Attached")
    pieces, near = _pieces(robot, joints, held), np.zeros(len(rows), dtype=np.bool_)
    if pieces:
        _mark(near, np.arange(len(rows)), rows, pieces, margin_of(margin))
    return np.asarray(rows[~near])


@dataclass(frozen=True, eq=False)
class _Piece:
    """A convex shape with its pose in the base frame, and the box around it there."""

    shape: Shape
    rotation: FloatArray
    position: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def at(cls, shape: Shape, T: FloatArray) -> _Piece:
        R, t = T[:3, :3], T[:3, 3]
        high, low = (np.diag(along(shape.support(sign * R), R)) + t for sign in (1.0, -1.0))
        return cls(shape, R, t, low, high)

    def near(self, points: FloatArray, margin: float) -> BoolArray:
        """Of points (k, 3), whether they are within ``margin``."""
        local = np.ascontiguousarray(along(points - self.position, self.rotation.T).T)
        if isinstance(self.shape, Mesh):
            return _near_mesh(self.shape, local, margin)
        return np.asarray(self.shape.distance(local) <= margin)


def _pieces(robot: Robot, q: FloatArray, attached: Sequence[Attached]) -> list[_Piece]:
    """All that moves with the robot and all that it stands on, neighbours beside each other."""
    frames = list(map(body_matrix, robot.body_poses(q)))
    pieces = [_Piece.at(item.shape, frames[item.body] @ item.pose.matrix) for item in robot.shapes]
    tool = frames[robot.tool_body] @ robot.tool_placement
    for held in attached:
        pieces += [_Piece.at(shape, tool @ held.pose.matrix @ T) for shape, T in _convex(held.shape)]
    return pieces


def _convex(solid: Solid) -> list[tuple[Shape, FloatArray]]:
    """Convex shapes and their frames in a solid's."""
    if isinstance(solid, Composite):
        return list(zip(solid.pieces.shapes, solid.pieces.frames, strict=True))
    return [(solid, Pose().matrix)]


def _mark(near: BoolArray, numbers: IntArray, points: FloatArray, pieces: Sequence[_Piece], margin: float) -> None:
    """Mark in ``near`` the points within ``margin`` of a piece: of half of the pieces those in the box around them.

    Args:
        numbers: Which entries of ``near`` the points (k, 3) are.
    """
    low = np.min([piece.low for piece in pieces], axis=0) - (margin + ROUNDING)
    high = np.max([piece.high for piece in pieces], axis=0) + (margin + ROUNDING)
    for axis in range(3):
        inside = np.flatnonzero((points[:, axis] >= low[axis]) & (points[:, axis] <= high[axis]))
        numbers, points = numbers[inside], points[inside]
    if not len(points):
        return
    if len(pieces) == 1:
        near[numbers[pieces[0].near(points, margin)]] = True
        return
    middle = len(pieces) // 2
    _mark(near, numbers, points, pieces[:middle], margin)
    left = ~near[numbers]
    _mark(near, numbers[left], points[left], pieces[middle:], margin)


def _near_mesh(mesh: Mesh, points: FloatArray, margin: float) -> BoolArray:
    """Whether points (k, 3) are within ``margin`` of a hull; those that no bound decides are measured."""
    from scipy.spatial import cKDTree

    surface = _surface(mesh, margin / 2.0, min(len(points), MAX_SAMPLES))
    near: BoolArray = cKDTree(surface).query(points, distance_upper_bound=margin)[0] <= margin - ROUNDING
    open_ = np.flatnonzero(~near)
    for rows in blocks(len(open_), len(mesh.faces)):
        some = open_[rows]
        least, most = _bounds(mesh, points[some], margin)
        near[some] = most <= margin
        unsure = some[(least <= margin) & (margin < most)]
        if len(unsure):
            near[unsure] = mesh.distance(points[unsure]) <= margin
    return near


def _surface(mesh: Mesh, spacing: float, most: int) -> FloatArray:
    """Points of a hull's surface (m, 3), about as close as ``spacing``, or ``most`` to four times as many."""
    triangles = mesh.vertices[mesh.faces]
    while len(triangles) < most:
        edges = np.roll(triangles, -1, axis=1) - triangles
        long = (edges * edges).sum(axis=-1).max(axis=1) > spacing * spacing
        if not long.any():
            break
        triangles = np.concatenate([triangles[~long], quartered(triangles[long])])
    return np.concatenate([mesh.vertices, triangles.mean(axis=1)])


def _bounds(mesh: Mesh, points: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Distances between which those of points (k, 3) to a hull are, close enough mostly to compare with ``margin``.

    At least how far a point is above any face; at most how far it is from where projections onto the highest face of
    the moment lead into the hull (Agmon, Canad. J. Math. 6, 1954). That way is a direction to look back along, too:
    nothing of the hull is farther in it than its farthest corner.
    """
    least, most, ends = np.full(len(points), -np.inf), np.full(len(points), np.inf), points.copy()
    left = np.arange(len(points))
    for step in range(PROJECTIONS):
        heights = along(mesh.normals, ends[left]) - mesh.offsets
        face = heights.argmax(axis=1)
        height = heights[np.arange(len(left)), face]
        if step == 0:
            least = height - ROUNDING
        inside = height <= -ROUNDING
        moved = points[left] - ends[left]
        most[left[inside]] = np.sqrt((moved * moved).sum(axis=1))[inside] + (ROUNDING if step else 0.0)
        on = ~inside & (least[left] <= margin)
        left, face, height = left[on], face[on], height[on]
        ends[left] -= (height + INWARD)[:, np.newaxis] * mesh.normals[face]
    open_ = np.flatnonzero((least <= margin) & (margin < most))
    back = points[open_] - ends[open_]
    length = np.sqrt((back * back).sum(axis=1))
    farthest = along(mesh.vertices, back).max(axis=1, initial=-np.inf)
    least[open_] = np.maximum(least[open_], ((points[open_] * back).sum(axis=1) - farthest) / length - ROUNDING)
    return least, most
