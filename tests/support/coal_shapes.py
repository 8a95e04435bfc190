"""Shapes as Coal has them."""

from __future__ import annotations

from typing import Any

import coal

from auditor.checker import hull_of
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Sphere

__all__ = ["coal_shape"]


def coal_shape(shape: Any) -> Any:
    """Of a convex shape of ours, in its own frame."""
    if isinstance(shape, Mesh):
        return hull_of(shape.vertices)
    if isinstance(shape, Box):
        return coal.Box(*shape.size)
    if isinstance(shape, Sphere):
        return coal.Sphere(shape.radius)
    return (coal.Cylinder if isinstance(shape, Cylinder) else coal.Capsule)(shape.radius, shape.length)
