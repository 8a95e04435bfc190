"""A peer for speed: Pinocchio's naive broad phase manager with Coal, one state per call, verdicts by Coal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from benchmarks.pairwise import pairs_of
from planner_service.composite import Solid
from planner_service.geometry import Box, Capsule, Cylinder, Sphere
from planner_service.mesh import Mesh
from planner_service.robot import Robot
from planner_service.scene import Scene

__all__ = ["NaiveManager"]


def _geometry(shape: Solid) -> Any:
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    if isinstance(shape, Capsule):
        return coal.Capsule(shape.radius, shape.length)
    if isinstance(shape, Mesh):
        points = coal.StdVec_Vec3s()
        points.extend([np.array(row) for row in shape.vertices])
        return coal.Convex.convexHull(points, False, "")
    raise TypeError(type(shape).__name__)


class NaiveManager:
    """Judges one state after the other; the pairs are those of ``PairwiseFcl``."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        model = pin.Model()
        joints = [0]
        for body in robot.bodies[1:]:
            kind = pin.JointModelPrismaticUnaligned if body.prismatic else pin.JointModelRevoluteUnaligned
            where = pin.SE3(np.array(body.placement))
            joints.append(model.addJoint(joints[body.parent], kind(np.array(body.axis)), where, body.name))
        self._order = [body.q_index for body in robot.bodies[1:]]
        world = pin.GeometryModel()
        riding = [
            world.addGeometryObject(
                pin.GeometryObject(f"link {k}", joints[s.body], pin.SE3(np.array(s.pose.matrix)), _geometry(s.shape))
            )
            for k, s in enumerate(robot.shapes)
        ]
        standing = [
            world.addGeometryObject(
                pin.GeometryObject(f"scene {k}", 0, pin.SE3(np.array(o.pose.matrix)), _geometry(o.shape))
            )
            for k, o in enumerate(scene.obstacles)
        ]
        own, with_scene = pairs_of(robot, scene)
        for i, j in own:
            world.addCollisionPair(pin.CollisionPair(riding[i], riding[j]))
        for i, k in with_scene:
            world.addCollisionPair(pin.CollisionPair(riding[i], standing[k]))
        self._model, self._data, self._world = model, model.createData(), world
        self._placed = world.createData()
        self._manager = pin.BroadPhaseManager_NaiveCollisionManager(model, world, self._placed)

    def state_is_free(self, q: Sequence[float]) -> bool:
        """Whether no pair touches at q (n,)."""
        configuration = np.array([q[k] for k in self._order])
        return not pin.computeCollisions(self._model, self._data, self._manager, configuration, True)
