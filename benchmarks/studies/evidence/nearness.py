"""How near the shapes of a robot come to each other and to obstacles along a curve, by Pinocchio and Coal."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from typing import Any, NamedTuple

import coal
import numpy as np

from benchmarks.harness.audit import independent
from planner_service import Scene
from planner_service.geometry.arrays import FloatArray
from planner_service.path.joint_path import JointPath

__all__ = ["Near", "Nearness", "Places"]

CANDIDATES, ROUNDS = 4, 20
"""Of places around which a nearer one is looked for, and steps on the way there."""


class Near(NamedTuple):
    """Two shapes, their signed distance in metres, and where on a curve."""

    gap: float
    s: float
    names: tuple[str, str]
    numbers: tuple[int, int]


class Places(NamedTuple):
    """Places s (m,) on a curve, and the frames of the robot's shapes there, (m, k, 3, 4)."""

    s: FloatArray
    frames: FloatArray


class Nearness:
    """Distances of one robot, which comes with the package, and of what stands around it."""

    def __init__(self, robot: str, scene: Scene) -> None:
        self._robot = independent(robot, Scene(attached=scene.attached))
        items = self._robot.geometry.geometryObjects
        frames = [self._robot.model.frames[item.parentFrame] for item in items]
        self._links = [frame.name for frame in frames]
        placements = [frame.placement.inverse() * item.placement for frame, item in zip(frames, items, strict=True)]
        self._local = np.array([placement.homogeneous for placement in placements])
        self._own = [(owner, item.geometry) for owner, item in zip(self._robot.owners, items, strict=True)]
        self._pairs = [(pair.first, pair.second) for pair in self._robot.geometry.collisionPairs]
        self._moving = [k for k, item in enumerate(items) if item.parentJoint]
        self._stand(scene)

    def among(self, scene: Scene) -> Nearness:
        """The same robot, holding the same, among the obstacles of another scene."""
        other = copy(self)
        other._stand(scene)
        return other

    def _stand(self, scene: Scene) -> None:
        checker = independent("planar2", Scene(scene.obstacles))  # any robot: obstacles alone are taken from it
        names = {item.name for item in scene.obstacles}
        items = zip(checker.owners, checker.geometry.geometryObjects, strict=True)
        found = [(owner, item) for owner, item in items if owner in names]
        self._standing = np.array([item.placement.homogeneous[:3] for _, item in found]).reshape(-1, 3, 4)
        self._shapes: list[tuple[str, Any]] = [*self._own, *((owner, item.geometry) for owner, item in found)]
        for _, shape in self._shapes:
            shape.computeLocalAABB()
        self._centres = np.array([shape.aabb_center for _, shape in self._shapes])
        self._radii = np.array([shape.aabb_radius for _, shape in self._shapes])
        numbers = range(len(self._own), len(self._shapes))
        self._first, self._second = np.array([*self._pairs, *((k, j) for k in self._moving for j in numbers)]).T

    def along(self, path: JointPath, s: FloatArray) -> Places:
        """Where the robot's shapes are at places s (m,) of a path."""
        return Places(s, (self._robot.poses_along(path(s), self._links) @ self._local)[:, :, :3])

    def nearer(self, places: Places, limit: float) -> Iterator[Near]:
        """The pairs that are nearer than so many metres, wherever they are."""
        standing = np.broadcast_to(self._standing, (len(places.s), *self._standing.shape))
        frames = np.concatenate([places.frames, standing], axis=1)
        centres = np.einsum("mkij,kj->mki", frames[..., :3], self._centres) + frames[..., 3]
        apart = np.linalg.norm(centres[:, self._first] - centres[:, self._second], axis=2)
        near = np.argwhere(apart - self._radii[self._first] - self._radii[self._second] < limit)
        for place, pair in near.tolist():
            i, j = int(self._first[pair]), int(self._second[pair])
            gap = self._gap(frames[place], i, j)
            if gap < limit:
                yield Near(gap, float(places.s[place]), (self._shapes[i][0], self._shapes[j][0]), (i, j))

    def nearest(self, path: JointPath, places: Places, limit: float) -> Near | None:
        """The nearest of all on a path, looked for around the nearest of some places; None if none of these is near."""
        found = sorted(self.nearer(places, limit))[:CANDIDATES]
        step = float(np.diff(places.s).max(initial=0.0))
        return min((self._around(path, near, step) for near in found), default=None)

    def _around(self, path: JointPath, near: Near, step: float) -> Near:
        low, high = max(near.s - step, 0.0), min(near.s + step, path.length)
        for _ in range(ROUNDS):
            first, second = (self._at(path, s, near) for s in np.linspace(low, high, 4)[1:3])
            low, high = (low, second.s) if first.gap < second.gap else (first.s, high)
            near = min(near, first, second)
        return near

    def _at(self, path: JointPath, s: float, near: Near) -> Near:
        frames = np.concatenate([self.along(path, np.array([s])).frames[0], self._standing])
        return near._replace(gap=self._gap(frames, *near.numbers), s=float(s))

    def _gap(self, frames: FloatArray, i: int, j: int) -> float:
        at = [coal.Transform3s(frames[k][:, :3], frames[k][:, 3]) for k in (i, j)]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        return float(coal.distance(self._shapes[i][1], at[0], self._shapes[j][1], at[1], request, result))
