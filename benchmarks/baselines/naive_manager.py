"""A peer for speed: Pinocchio's naive broad phase manager with Coal, one state per call, verdicts by Coal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from benchmarks.baselines.pairwise import pairs_of
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["NaiveManager", "models_of"]


def _geometry(shape: Solid) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Cylinder | Capsule):
        return getattr(coal, type(shape).__name__)(shape.radius, shape.length)
    if not isinstance(shape, Mesh):
        raise TypeError(type(shape).__name__)
    points = coal.StdVec_Vec3s()
    points.extend([np.array(row) for row in shape.vertices])
    return coal.Convex.convexHull(points, False, "")


def models_of(robot: Robot, scene: Scene) -> tuple[Any, Any, list[int]]:
    """Pinocchio's model of the robot, its geometry and the scene's with the pairs of ``PairwiseFcl``, and which entry
    of our q each of its joints takes."""
    model = pin.Model()
    joints = [0]
    for body in robot.bodies[1:]:
        kind = pin.JointModelPrismaticUnaligned if body.prismatic else pin.JointModelRevoluteUnaligned
        where = pin.SE3(np.array(body.placement))
        joints.append(model.addJoint(joints[body.parent], kind(np.array(body.axis)), where, body.name))
    world = pin.GeometryModel()

    def added(name: str, joint: int, item: Any) -> int:
        where = pin.SE3(np.array(item.pose.matrix))
        return int(world.addGeometryObject(pin.GeometryObject(name, joint, where, _geometry(item.shape))))

    riding = [added(f"link {k}", joints[shape.body], shape) for k, shape in enumerate(robot.shapes)]
    standing = [added(f"scene {k}", 0, obstacle) for k, obstacle in enumerate(scene.obstacles)]
    own, with_scene = pairs_of(robot, scene)
    for i, j in own:
        world.addCollisionPair(pin.CollisionPair(riding[i], riding[j]))
    for i, k in with_scene:
        world.addCollisionPair(pin.CollisionPair(riding[i], standing[k]))
    return model, world, [body.q_index for body in robot.bodies[1:]]


class NaiveManager:
    """Judges one state after the other; the pairs are those of ``PairwiseFcl``."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self._model, world, self._order = models_of(robot, scene)
        self._data, self._placed = self._model.createData(), world.createData()
        self._world = world  # the manager only refers to it
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(self._model, world, self._placed)

    def state_is_free(self, q: Sequence[float]) -> bool:
        """Whether no pair touches at q (n,)."""
        return not self.collides(np.array([q[k] for k in self._order]))

    def collides(self, configuration: FloatArray) -> bool:
        """Whether a pair touches at a configuration in Pinocchio's order of joints."""
        return bool(pin.computeCollisions(self._model, self._data, self._manager, configuration, True))
