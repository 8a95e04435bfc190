"""Shapes, meshes and point clouds as immutable values, and the files they come from."""

from planner_service.geometry.composite import Compound, HeightField, PointCloud
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere

__all__ = ["Box", "Capsule", "Compound", "Cylinder", "HeightField", "Mesh", "PointCloud", "Pose", "Shape", "Sphere"]
