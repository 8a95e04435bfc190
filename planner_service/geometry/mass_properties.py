"""Where the mass of a solid is, if it is spread evenly: its volume, centre and moments of inertia."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, along, dot
from planner_service.geometry.composite import Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere

__all__ = ["MassProperties", "mass_properties"]


class MassProperties(NamedTuple):
    """Of a solid of density 1, in its own frame: volume (m^3), centre (3,), and inertia tensor about it (3, 3)."""

    volume: float
    centre: FloatArray
    tensor: FloatArray


def mass_properties(solid: Solid) -> MassProperties:
    """The volume, centre and inertia of a solid.

    Where pieces of a composite overlap, their mass counts for each of them.

    Raises:
        InvalidRequest: A shape of another kind than those of this package.
    """
    if isinstance(solid, Box):
        xx, yy, zz = (side * side for side in solid.size)
        return _centred(math.prod(solid.size), yy + zz, xx + zz, xx + yy, 12.0)
    if isinstance(solid, Sphere):
        square = solid.radius * solid.radius
        return _centred(4.0 / 3.0 * math.pi * solid.radius * square, square, square, square, 2.5)
    if isinstance(solid, Cylinder):
        return _cylinder(solid.radius, solid.length)
    if isinstance(solid, Capsule):
        return _capsule(solid.radius, solid.length)
    if isinstance(solid, Mesh):
        return _hull(solid)
    if hasattr(solid, "pieces"):
        pieces = [mass_properties(shape) for shape in solid.pieces.shapes]
        return _together(pieces, solid.pieces.frames)
    raise InvalidRequest("shape", solid, "a shape of this package: the mass of others is not known to be anywhere")


def _centred(volume: float, x: float, y: float, z: float, part: float) -> MassProperties:
    return MassProperties(volume, np.zeros(3), np.diag([x, y, z]) * (volume / part))


def _cylinder(radius: float, length: float) -> MassProperties:
    square = radius * radius
    across = 3.0 * square + length * length
    return _centred(math.pi * square * length, across, across, 6.0 * square, 12.0)


def _capsule(radius: float, length: float) -> MassProperties:
    """A cylinder and two half balls, whose centres are 3/8 of the radius beyond its ends."""
    cylinder, ball = _cylinder(radius, length), mass_properties(Sphere(radius))
    moved = length * length / 4.0 + 3.0 / 8.0 * length * radius  # (l/2 + 3r/8)^2 - (3r/8)^2, by Steiner's theorem
    tensor = cylinder.tensor + ball.tensor + np.diag([moved, moved, 0.0]) * ball.volume
    return MassProperties(cylinder.volume + ball.volume, np.zeros(3), tensor)


def _hull(mesh: Mesh) -> MassProperties:
    """The sum of the tetrahedra from a corner to each face; second moments of each are exact (Tonon, 2005)."""
    origin = mesh.vertices[0]
    a, b, c = (mesh.vertices[mesh.faces[:, k]] - origin for k in range(3))
    volumes = np.array([dot(x, np.cross(y, z)) for x, y, z in zip(a, b, c, strict=True)]) / 6.0
    total = a + b + c
    volume = math.fsum(volumes.tolist())
    first = np.array([math.fsum((volumes * total[:, k]).tolist()) for k in range(3)]) / 4.0
    second = np.empty((3, 3))
    for j in range(3):
        for k in range(3):
            squares = a[:, j] * a[:, k] + b[:, j] * b[:, k] + c[:, j] * c[:, k] + total[:, j] * total[:, k]
            second[j, k] = math.fsum((volumes * squares).tolist()) / 20.0
    centre = first / volume
    return MassProperties(volume, origin + centre, _tensor(second - volume * np.outer(centre, centre)))


def _together(pieces: list[MassProperties], frames: FloatArray) -> MassProperties:
    volume = math.fsum(piece.volume for piece in pieces)
    centres = [along(T[:3, :3], piece.centre) + T[:3, 3] for piece, T in zip(pieces, frames, strict=True)]
    centre = np.sum([piece.volume * at for piece, at in zip(pieces, centres, strict=True)], axis=0) / volume
    tensor = np.zeros((3, 3))
    for piece, at, T in zip(pieces, centres, frames, strict=True):
        R, off = T[:3, :3], at - centre
        tensor += along(R, along(R, piece.tensor).T) + _tensor(piece.volume * np.outer(off, off))
    return MassProperties(volume, centre, tensor)


def _tensor(second: FloatArray) -> FloatArray:
    """The inertia tensor of second moments, the integrals of x_j x_k."""
    return np.asarray(np.eye(3) * float(second[0, 0] + second[1, 1] + second[2, 2]) - second)
