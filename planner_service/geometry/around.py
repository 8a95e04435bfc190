"""Convex solids of ours around shapes that other formats have: an ellipsoid, a cone, the half-space below a plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, dot
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Pose

__all__ = ["Plane", "around_cone", "around_ellipsoid"]

BALL_POINTS = 400
"""Points on the unit ball whose hull, scaled, encloses an ellipsoid: it grows by less than 1 %."""

CONE_SIDES = 64
"""Sides of the pyramid around a cone: its corners are 0.12 % farther out."""

PLANE_WIDTH, PLANE_DEPTH = 200.0, 10.0
"""Metres of the box below a plane: an arm reaches no farther, and FCL still judges such a box to a micrometre."""


def around_ellipsoid(radii: Sequence[float]) -> tuple[Mesh, float]:
    """A polytope around the ellipsoid with these half axes (m), and by how many metres it is larger at most."""
    ball = _around_ball()
    growth = (float(np.linalg.norm(ball, axis=1).max()) - 1.0) * max(radii)
    return Mesh(ball * np.array(radii)), growth


@lru_cache(maxsize=1)
def _around_ball() -> FloatArray:
    """Corners (k, 3) whose hull contains the unit ball: points along a spiral, scaled by what their hull lacks."""
    k = np.arange(BALL_POINTS) + 0.5
    z, angle = 1.0 - 2.0 * k / BALL_POINTS, math.pi * (1.0 + math.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z * z)
    points = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
    return points * ((1.0 + 1e-9) / float(Mesh(points).offsets.min()))


def around_cone(radius: float, length: float) -> Mesh:
    """A pyramid around a cone, its tip at +z and its origin half way: each side touches the cone along a line.

    Raises:
        InvalidRequest: a size that is none of a cylinder.
    """
    inside = Cylinder(radius, length)
    out, half = inside.radius / math.cos(math.pi / CONE_SIDES), inside.length / 2
    angles = [2.0 * math.pi * k / CONE_SIDES for k in range(CONE_SIDES)]
    rim = [(out * math.cos(a), out * math.sin(a), -half) for a in angles]
    return Mesh(np.array([*rim, (0.0, 0.0, half)]))


@dataclass(frozen=True)
class Plane:
    """All points x with ``normal . x = height``, the normal of unit length."""

    normal: tuple[float, float, float]
    height: float

    @classmethod
    def of(cls, a: float, b: float, c: float, d: float) -> Plane:
        """The plane ``a x + b y + c z + d = 0``.

        Raises:
            InvalidRequest: it has no normal.
        """
        length = math.hypot(a, b, c)
        if not (0.0 < length < math.inf and abs(d / length) < math.inf):
            raise InvalidRequest("plane", (a, b, c, d), "a, b, c and d, with a, b and c a vector that is not 0")
        return cls((a / length, b / length, c / length), -d / length)

    def below(self, there: Pose | None) -> tuple[Box, Pose | None]:
        """The box below the plane, which stands at ``there``, and where that is.

        Its top lies in the plane, the rest on the side to which the normal does not point, and its middle where the
        plane is nearest to the origin.
        """
        box = Box((PLANE_WIDTH, PLANE_WIDTH, PLANE_DEPTH))
        if there is None:
            return box, None
        x, y, z = (dot(row, self.normal) for row in there.rotation.tolist())
        height = self.height + dot((x, y, z), there.position)
        middle = height - PLANE_DEPTH / 2
        w = 1.0 + z if z >= 0.0 else (x * x + y * y) / (1.0 - z)  # the shortest turn of z onto the normal
        turn = (w, -y, x, 0.0) if w > 0.0 else (0.0, 1.0, 0.0, 0.0)
        length = math.hypot(*turn)
        a, b, c, d = (value / length for value in turn)
        return box, Pose((x * middle + 0.0, y * middle + 0.0, z * middle + 0.0), (a, b + 0.0, c + 0.0, d))  # no -0
