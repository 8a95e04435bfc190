"""The fair baseline for speed: python-fcl asked pair by pair, with everything that can be reused reused.

Forward kinematics once per state, one transform set per shape, one request and one result for all
pairs (the result replaced after a hit: FCL keeps it colliding for ever), and an end at the first
pair that touches. Which pairs there are is worked out here from the robot and the scene, not taken
from the product's checker.
"""

from __future__ import annotations

from collections.abc import Sequence

import fcl
import numpy as np

from planner_service.collision.fcl import geometry_of
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["PairwiseFcl", "pairs_of"]


class PairwiseFcl:
    """Judges one state after the other; a scene without attached objects."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._robot = robot
        shapes = robot.shapes
        self._objects = [fcl.CollisionObject(geometry_of(item.shape)) for item in shapes]
        self._bodies = np.array([item.body for item in shapes])
        placements = np.array([item.pose.matrix for item in shapes])
        self._R, self._t = placements[:, :3, :3].copy(), placements[:, :3, 3].copy()
        standing = [
            fcl.CollisionObject(geometry_of(o.shape), fcl.Transform(o.pose.matrix[:3, :3], o.pose.matrix[:3, 3]))
            for o in scene.obstacles
        ]
        self.self_pairs, self.scene_pairs = pairs_of(robot, scene)
        objects = self._objects
        # Obstacles and the wrist first: what collides most often ends a state soonest.
        by_body = sorted(range(len(shapes)), key=lambda k: -shapes[k].body)
        with_scene = [(objects[k], standing[m]) for k in by_body for j, m in self.scene_pairs if j == k]
        self._pairs = with_scene + [(objects[i], objects[j]) for i, j in self.self_pairs]
        self._request, self._result = fcl.CollisionRequest(), fcl.CollisionResult()

    @property
    def pair_count(self) -> int:
        """Pairs asked about in a free state."""
        return len(self._pairs)

    def state_is_free(self, q: Sequence[float]) -> bool:
        """Whether no pair touches at q (n,)."""
        poses = np.array(self._robot.body_poses(q))[self._bodies]
        R = poses[:, :9].reshape(-1, 3, 3)
        t = poses[:, 9:] + (R * self._t[:, None, :]).sum(axis=-1)
        for item, rotation, translation in zip(self._objects, R @ self._R, t, strict=True):
            item.setTransform(fcl.Transform(rotation, translation))
        request, result = self._request, self._result
        for a, b in self._pairs:
            if fcl.collide(a, b, request, result):
                self._result = fcl.CollisionResult()
                return False
        return True

    def first_collision(self, Q: FloatArray) -> int | None:
        """Row of the first state of Q (m, n) that collides, judged in order."""
        for row, q in enumerate(Q.tolist()):
            if not self.state_is_free(q):
                return row
        return None


def pairs_of(robot: Robot, scene: Scene) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Indices of robot shapes judged against each other, and of (robot shape, obstacle).

    From the robot's own list of link pairs, and every shape on a moving body with every obstacle.
    """
    judged = {frozenset(pair) for pair in robot.link_pairs}
    shapes = robot.shapes
    own = [
        (i, j)
        for i in range(len(shapes))
        for j in range(i + 1, len(shapes))
        if frozenset((shapes[i].link, shapes[j].link)) in judged
    ]
    with_scene = [(k, m) for k, item in enumerate(shapes) if item.body > 0 for m in range(len(scene.obstacles))]
    return own, with_scene
