"""How far links extend, as they look, beyond the shapes that are checked: where the model of a robot falls short."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planner_service.geometry.arrays import FloatArray, quartered
from planner_service.geometry.composite import extent as extent_of_shape
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import Surface
from planner_service.geometry.shapes import Shape
from planner_service.robot.kinematic_tree import LinkShape
from planner_service.robot.model import Robot
from planner_service.robot_setup.visuals import Visual

__all__ = ["extent", "overhangs"]

STEP = 0.02
"""Metres between points on large triangles: several shapes may cover their corners and not their middles."""
LARGEST = 50
"""Steps along the largest side of a surface."""
AT_ONCE = 100
"""Points whose distance from meshes is computed together."""
EXACT = 1e-6
"""Metres by which an overhang may be larger than said."""
DIRECTIONS = 400
"""In which points on a box, cylinder or sphere are farthest."""


def extent(appearance: Shape | Surface) -> FloatArray:
    """Sizes along x, y and z, in metres, of a shape or surface in its own frame, (3,)."""
    if isinstance(appearance, Surface):
        return np.asarray(np.ptp(appearance.vertices, axis=0))
    return extent_of_shape(appearance)


def overhangs(robot: Robot, visuals: Mapping[str, Sequence[Visual]]) -> dict[str, float]:
    """For each link: how far the farthest point of what it looks like is from the shapes that move with it, in metres.

    Those are the shapes of the link itself and of all others that are fixed to it; infinite if there are none. Surfaces
    are compared at the corners of their triangles, and on large ones about every 2 cm in between.
    """
    found = {}
    for link, elements in visuals.items():
        body, T_body_link = robot.link_frame(link)
        shapes = [item for item in robot.shapes if item.body == body]
        points = [_moved((T_body_link @ item.pose.matrix), _points(item.appearance)) for item in elements]
        found[link] = _farthest(np.concatenate(points), shapes)
    return found


def _moved(T: FloatArray, points: FloatArray) -> FloatArray:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _farthest(points: FloatArray, shapes: Sequence[LinkShape]) -> float:
    """The largest distance of points (k, 3) from the nearest of shapes, to a micrometre."""
    if not shapes:
        return math.inf
    local = [(item.shape, item.pose.inverse().matrix) for item in shapes]
    bounds = np.min([_bound(shape, _moved(T, points)) for shape, T in local], axis=0)
    order, largest = np.argsort(-bounds, kind="stable"), 0.0
    for k in range(0, len(order), AT_ONCE):
        rows = order[k : k + AT_ONCE]
        if bounds[rows[0]] <= largest + EXACT:
            break
        largest = max(
            largest, float(np.min([shape.distance(_moved(T, points[rows])) for shape, T in local], axis=0).max())
        )
    return largest


def _bound(shape: Shape, points: FloatArray) -> FloatArray:
    """Upper bounds (k,) of the distances of points (k, 3) from a shape."""
    return shape.distance_bound(points) if isinstance(shape, Mesh) else shape.distance(points)


def _points(appearance: Shape | Surface) -> FloatArray:
    """Points on a surface, or of a shape those that are farthest in many directions, (k, 3)."""
    if not isinstance(appearance, Surface):
        directions = np.random.default_rng(0).normal(size=(DIRECTIONS, 3))
        return appearance.support(np.concatenate([directions, np.eye(3), -np.eye(3)]))
    step = max(STEP, float(extent(appearance).max()) / LARGEST)
    corners = appearance.vertices[appearance.triangles]
    points = [corners.reshape(-1, 3)]
    while True:
        sides = np.roll(corners, -1, axis=1) - corners
        corners = corners[(sides * sides).sum(axis=-1).max(axis=-1) > step * step]
        if not len(corners):
            return np.unique(np.concatenate(points), axis=0)
        inner, corners = len(corners), quartered(corners)
        points.append(corners[-inner:].reshape(-1, 3))
