"""FCL's boolean ``collide`` between convex shapes. The only module that imports fcl.

What FCL gets wrong is kept away from it (measured on 49,000 pose pairs and by hand): half-spaces,
planes and cones are never built, and triangle meshes (which are surfaces) only where no verdict
hangs on them, otherwise their convex hulls; distances, signed distances, penetration depths and
continuous collision are never asked; a result object is replaced after a hit because it stays
"colliding" for ever; poses are finite and orthonormal because they come from our own kinematics
of validated values.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

import fcl
import numpy as np

from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere

__all__ = ["FclObjects", "geometry_of", "surface_geometry"]


def geometry_of(shape: object) -> fcl.CollisionGeometry:
    """FCL's geometry of a convex shape."""
    if isinstance(shape, Box):
        return fcl.Box(*shape.size)
    if isinstance(shape, Sphere):
        return fcl.Sphere(shape.radius)
    if isinstance(shape, Cylinder):
        return fcl.Cylinder(shape.radius, shape.length)
    if isinstance(shape, Capsule):
        return fcl.Capsule(shape.radius, shape.length)
    if isinstance(shape, Mesh):  # each face is told as the number of its corners, then these
        faces = np.concatenate([np.full((len(shape.faces), 1), 3), shape.faces], axis=1)
        return fcl.Convex(shape.vertices, len(faces), faces.astype(np.int32).ravel())
    raise BrokenInvariant(f"FCL is not trusted with a {type(shape).__name__}")


def surface_geometry(vertices: FloatArray, faces: IntArray) -> fcl.CollisionGeometry:
    """FCL's geometry of triangles (t, 3), rows of vertices (n, 3): what is wholly inside of them touches nothing.

    For no verdict on what is free.
    """
    surface = fcl.BVHModel()
    surface.beginModel(len(faces), len(vertices))
    surface.addSubModel(vertices, faces)
    surface.endModel()
    return surface


class FclObjects(threading.local):
    """Collision objects, built at first use and checked in pairs; a check allocates nothing but poses.

    Each thread has its own, for they are moved from question to question; what they are made of is shared.

    Args:
        frame: Where each stands by its number as long as it is not placed elsewhere, a homogeneous matrix.
        geometries: Those built so far, by the number of their shape.
    """

    def __init__(
        self, shapes: Sequence[Shape], frame: Callable[[int], FloatArray], geometries: dict[int, fcl.CollisionGeometry]
    ) -> None:
        self._shapes, self._frame, self._geometries = shapes, frame, geometries
        self._objects: dict[int, fcl.CollisionObject] = {}
        self._request = fcl.CollisionRequest()
        self._result = fcl.CollisionResult()

    def _object(self, index: int) -> fcl.CollisionObject:
        made = self._objects.get(index)
        if made is None:
            geometry, T = self._geometries.get(index), self._frame(index)
            if geometry is None:
                geometry = self._geometries.setdefault(index, geometry_of(self._shapes[index]))
            made = fcl.CollisionObject(geometry, fcl.Transform(T[:3, :3], T[:3, 3]))
            self._objects[index] = made
        return made

    def place(self, index: int, rotation: FloatArray, translation: FloatArray) -> None:
        """Move object ``index`` to a rotation (3, 3) and a translation (3,) in the world."""
        moved = self._object(index)
        moved.setRotation(rotation)  # the bits of a new Transform in a third of the time
        moved.setTranslation(translation)

    def collide(self, a: int, b: int) -> bool:
        """Whether objects a and b touch; gaps within a micrometre of contact are undefined."""
        first, second = self._object(a), self._object(b)
        if fcl.collide(first, second, self._request, self._result) == 0:
            return False
        self._result = fcl.CollisionResult()
        return True
