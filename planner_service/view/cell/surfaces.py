"""Where a ray meets a scene, and how a body rests there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.scene.scene import Obstacle, Scene
from planner_service.view.triangles import extremes

__all__ = ["Hit", "Surfaces", "drop", "resting"]

TOUCH = 1e-6
"""Metres from a surface at which a ray has met it."""

STEPS = 400
"""Steps of a ray at most; one that grazes a surface takes many small ones."""

PROBE = 1e-4
"""Metres between the points from whose distances a normal is worked out, and between a surface and their middle."""

ACROSS = 7
"""Rays along each side of a body's outline, seen from above, with which what lies below it is found."""


@dataclass(frozen=True, eq=False)
class Hit:
    """Where a ray meets an obstacle: its name, the point (3,) in the base frame, and the outward normal there (3,)."""

    name: str
    point: FloatArray
    normal: FloatArray


class Surfaces:
    """The surfaces of the obstacles of a scene.

    Args:
        without: The name of an obstacle that is left out.
    """

    def __init__(self, scene: Scene, without: str | None = None) -> None:
        self._obstacles = [obstacle for obstacle in scene.obstacles if obstacle.name != without]

    @cached_property
    def _boxes(self) -> FloatArray:
        """Around each obstacle, (k, 2, 3): its lowest and its highest corner."""
        return np.array([extremes(obstacle) for obstacle in self._obstacles]).reshape(-1, 2, 3)

    def met_by(self, origin: FloatArray, direction: FloatArray) -> Hit | None:
        """The nearest point of an obstacle on a ray that begins outside of it; None if there is none.

        Args:
            direction: Of the ray, of any length but 0.
        """
        length = math.sqrt(float(direction @ direction))
        if not 0.0 < length < math.inf:
            return None
        along, nearest = direction / length, math.inf
        hit: Obstacle | None = None
        enters, leaves = _crossings(origin, along, self._boxes)
        for k in np.argsort(enters).tolist():
            if enters[k] > leaves[k] or enters[k] >= nearest:
                continue
            at = _distance_along(self._obstacles[k], origin, along, float(enters[k]), min(float(leaves[k]), nearest))
            if at is not None:
                nearest, hit = at, self._obstacles[k]
        if hit is None:
            return None
        point = origin + nearest * along
        return Hit(hit.name, point, _normal(hit, point, along))


def _crossings(origin: FloatArray, along: FloatArray, boxes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where a ray enters and leaves each box (k, 2, 3), (k,) each; it misses those that it leaves first."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.sort((boxes - TOUCH * np.array([[1.0], [-1.0]]) - origin) / along, axis=1)
    ends = np.where(np.isnan(ends), np.array([[-np.inf], [np.inf]]), ends)
    return np.maximum(ends[:, 0].max(axis=1, initial=0.0), 0.0), ends[:, 1].min(axis=1, initial=np.inf)


def _distance_along(
    obstacle: Obstacle, origin: FloatArray, along: FloatArray, first: float, last: float
) -> float | None:
    """How far along a ray an obstacle is met between two places; each step is as long as the distance that is left."""
    turn = obstacle.pose.rotation.T
    start, step = turn @ (origin - np.array(obstacle.pose.position)), turn @ along
    at = first
    for _ in range(STEPS):
        left = float(obstacle.shape.distance((start + at * step)[None])[0])
        if left <= TOUCH:
            return at
        at += left
        if at > last:
            return None
    return None


def _normal(obstacle: Obstacle, point: FloatArray, along: FloatArray) -> FloatArray:
    """The direction in which the distance to an obstacle grows, just outside of it; else back along the ray."""
    turn = obstacle.pose.rotation
    middle = turn.T @ (point - 2.0 * PROBE * along - np.array(obstacle.pose.position))
    ends = middle + np.concatenate([np.eye(3), -np.eye(3)]) * PROBE
    there = obstacle.shape.distance(ends)
    slope = turn @ (there[:3] - there[3:])
    length = math.sqrt(float(slope @ slope))
    return -along if length < TOUCH else np.asarray(slope / length)


def resting(obstacle: Obstacle, point: FloatArray, normal: FloatArray) -> Pose:
    """Where an obstacle stands on the plane through ``point`` with that normal, its middle above ``point``, as turned
    now.
    """
    middle = extremes(obstacle).mean(axis=0) - np.array(obstacle.pose.position)
    aside = middle - normal * float(normal @ middle)
    local = obstacle.pose.rotation.T @ -normal
    depth = float(local @ obstacle.shape.support(local))
    x, y, z = (point + normal * depth - aside).tolist()
    return Pose((x, y, z), obstacle.pose.quaternion)


def drop(obstacle: Obstacle, below: Surfaces) -> Pose | None:
    """Where an obstacle comes to stand on what is below its middle, seen from above; None if nothing is there."""
    low, high = extremes(obstacle)
    half, down = (high[2] - low[2]) / 2.0, np.array([0.0, 0.0, -1.0])
    falls = []
    for x in np.linspace(low[0], high[0], ACROSS).tolist():
        for y in np.linspace(low[1], high[1], ACROSS).tolist():
            underside = _distance_along(obstacle, np.array([x, y, low[2]]), -down, 0.0, 2.0 * half + TOUCH)
            hit = below.met_by(np.array([x, y, low[2] + half]), down)
            if underside is not None and hit is not None:
                falls.append(low[2] + underside - hit.point[2])
    if not falls:
        return None
    x, y, z = obstacle.pose.position
    return Pose((x, y, z - float(min(falls))), obstacle.pose.quaternion)
