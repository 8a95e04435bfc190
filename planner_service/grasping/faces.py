"""The flat faces of an object, on which a cup may lie."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, along, cross
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Shape
from planner_service.grasping.lines import pieces_of
from planner_service.scene.scene import Obstacle

__all__ = ["FlatFace", "flat_faces"]

SAME_PLANE = 1e-6
"""Metres, and difference of unit normals, within which triangles of a hull count as one face."""


@dataclass(frozen=True, eq=False)
class FlatFace:
    """A flat face of an object, in the base frame.

    Attributes:
        outward: Its unit normal, (3,).
        middle: A point in its middle, (3,).
        inward: Unit vectors (e, 3) in its plane, from each straight rim to its inside; none for a disc.
        rims: Where the rims are: the face has ``inward . x >= rims``, (e,).
        radius: Of a disc; infinite for a face with straight rims.
        reach: Metres from the middle to the farthest point of a rim.
    """

    outward: FloatArray
    middle: FloatArray
    inward: FloatArray
    rims: FloatArray
    radius: float
    reach: float

    def room(self, points: FloatArray) -> FloatArray:
        """Metres from points (k, 3) of its plane to its nearest rim, (k,); negative beside the face."""
        away = points - self.middle
        least = self.radius - np.sqrt((away * away).sum(axis=1))
        if len(self.rims):
            least = np.minimum(least, (along(points, self.inward) - self.rims[:, None]).min(axis=0))
        return np.asarray(least)


def flat_faces(target: Obstacle, radius: float) -> Iterator[FlatFace]:
    """The flat faces of the convex pieces of an object that may hold a disc; other pieces may cover parts of them."""
    pieces = pieces_of(target.shape)
    rotations = np.broadcast_to(pieces.rotations, (len(pieces), 3, 3))
    own, place = target.pose.rotation, np.array(target.pose.position)
    for shape, turned, at in zip(pieces.shapes, rotations, pieces.positions, strict=True):
        alone = len(pieces) == 1 and not hasattr(target.shape, "pieces")
        R = own if alone else np.stack([along(own, turned[:, k]) for k in range(3)], axis=1)
        origin = place if alone else along(own, at) + place
        yield from _faces_of(shape, R, origin, radius)


def _faces_of(shape: Shape, R: FloatArray, place: FloatArray, radius: float) -> Iterator[FlatFace]:
    """Of a convex shape whose frame stands so in the base frame."""
    if isinstance(shape, Box):
        for k, size in enumerate(shape.size):
            others = [j for j in range(3) if j != k]
            u, v = (shape.size[j] / 2.0 for j in others)
            if min(u, v) < radius:
                continue
            inward = np.concatenate([sign * R[:, others].T for sign in (1.0, -1.0)])
            rims = (inward * place).sum(axis=1) - np.array([u, v, u, v])
            for outward in (R[:, k], -R[:, k]):
                yield FlatFace(outward, place + size / 2.0 * outward, inward, rims, math.inf, math.hypot(u, v))
    if isinstance(shape, Cylinder) and shape.radius >= radius:
        for outward in (R[:, 2], -R[:, 2]):
            middle = place + shape.length / 2.0 * outward
            yield FlatFace(outward, middle, np.zeros((0, 3)), np.zeros(0), shape.radius, shape.radius)
    if isinstance(shape, Mesh):
        yield from _facets(shape, R, place, radius)


def _facets(mesh: Mesh, R: FloatArray, place: FloatArray, radius: float) -> Iterator[FlatFace]:
    """Of a hull: neighbouring triangles that lie in one plane, together large enough for a disc."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    areas = np.sqrt((cross(b - a, c - a) ** 2).sum(axis=1)) / 2.0
    faces = _in_one_plane(mesh)
    for number in np.flatnonzero(np.bincount(faces, weights=areas) >= math.pi * radius * radius).tolist():
        rows = np.flatnonzero(faces == number)
        normal, area = mesh.normals[rows[areas[rows].argmax()]], areas[rows]
        middle = ((a[rows] + b[rows] + c[rows]) / 3.0 * area[:, None]).sum(axis=0) / area.sum()
        inward, starts = _rims(mesh, rows, normal)
        world = np.stack([along(R, row) for row in inward])
        rims = (inward * starts).sum(axis=1) + (world * place).sum(axis=1)
        corners = mesh.vertices[mesh.faces[rows].reshape(-1)] - middle
        reach = math.sqrt(float((corners * corners).sum(axis=1).max()))
        yield FlatFace(along(R, normal), along(R, middle) + place, world, rims, math.inf, reach)


def _in_one_plane(mesh: Mesh) -> IntArray:
    """The number of the flat face that each triangle of a hull belongs to, (t,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.faces)
    sides = np.sort(np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    order = np.lexsort(sides.T)
    one, two = np.tile(np.arange(count), 3)[order].reshape(-1, 2).T  # each side of a hull is one of two triangles
    flat = np.abs(mesh.normals[one] - mesh.normals[two]).max(axis=1) <= SAME_PLANE
    graph = coo_array((np.ones(int(flat.sum())), (one[flat], two[flat])), (count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def _rims(mesh: Mesh, rows: IntArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The inward unit vectors of the sides of triangles that no two of them share, and a point on each, (e, 3)."""
    sides = np.concatenate([mesh.faces[rows][:, [k, (k + 1) % 3]] for k in range(3)])
    _, which, many = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    outer = sides[many[which.reshape(-1)] == 1]
    starts = mesh.vertices[outer[:, 0]]
    inward = cross(np.broadcast_to(normal, starts.shape), mesh.vertices[outer[:, 1]] - starts)
    return inward / np.sqrt((inward * inward).sum(axis=1))[:, None], starts
