"""What has to be in a picture, and the place from which most of it is seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.view.still.camera import Camera
from planner_service.view.still.paint import Line
from planner_service.view.still.raster import EMPTY, KeyArray, cover, nearness_of, projected
from planner_service.view.triangles import Solid, is_ground

__all__ = ["Sights"]

ELEVATION, STEEP = 0.46, 1.0
"""Of the eye above the ground, and above robots that move in a plane."""

FLAT = 0.1
"""Part of their width that these are high at most."""

AZIMUTHS = tuple(math.radians(angle) for angle in (-50, 50, -25, 25, -80, 80, -130, 130))
"""Where the eye may be; the earlier ones are preferred."""

PREFERRED = 1.15
"""How many times as much another one has to show."""

TRIAL = (160, 90)
"""Pixels of the pictures in which the eye's places are compared."""

AROUND = 0.3
"""Part of the diagonal of all robot places by which obstacles beyond them are in the picture."""

LARGE = 2.0
"""Times the same: an obstacle that is larger is in the picture in part."""

ROOM = 0.02
"""Margin around all that is in the picture, as a share of its diagonal."""


@dataclass(frozen=True, eq=False)
class Sights:
    """What is to be seen, all of it in the world.

    Attributes:
        robots: The solids of one robot place or several.
        lines: Tool paths and axes.
    """

    robots: Sequence[Solid]
    obstacles: Sequence[Solid]
    lines: Sequence[Line]

    @cached_property
    def points(self) -> FloatArray:
        """Points (k, 3) to have in the picture: all robots, all lines, and of obstacles what is not far from these."""
        inner = np.concatenate([np.zeros((1, 3)), *(s.vertices for s in self.robots), self._along])
        low, high = inner.min(axis=0), inner.max(axis=0)
        diagonal = math.dist(low.tolist(), high.tolist())
        low, high = low - AROUND * diagonal, high + AROUND * diagonal
        points = [inner]
        for vertices in (solid.vertices for solid in self.obstacles if not is_ground(solid.vertices)):
            bottom, top = vertices.min(axis=0), vertices.max(axis=0)
            if np.all(bottom <= high) and np.all(top >= low):
                whole = math.dist(bottom.tolist(), top.tolist()) <= LARGE * diagonal
                points.append(vertices if whole else np.clip(vertices, low, high))
        return np.concatenate(points)

    def camera(self, size: tuple[int, int]) -> Camera:
        """Where most of the robots and of the lines is not hidden by obstacles, for a picture of (width, height)."""
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        room = ROOM * max(math.dist(low.tolist(), high.tolist()), 0.1)
        offsets = np.array([[x, y, z] for x in (-room, room) for y in (-room, room) for z in (-room, room)])
        points = (self.points[:, None] + offsets).reshape(-1, 3)
        robots, obstacles = _corners(self.robots), _corners(self.obstacles)
        wide, deep, tall = np.ptp(robots.reshape(-1, 3), axis=0).tolist() if len(robots) else (0.0, 0.0, 1.0)
        elevation = STEEP if tall < FLAT * max(wide, deep) else ELEVATION
        best, most = AZIMUTHS[0], 0.0
        for azimuth in AZIMUTHS:
            camera = Camera.around(points, TRIAL, azimuth, elevation)
            front, behind = _trial(camera, robots), _trial(camera, obstacles)
            shown = np.count_nonzero(front < behind) * (1.0 + _part_seen(self._along, behind, camera))
            if shown > most * PREFERRED:
                best, most = azimuth, shown
        return Camera.around(points, size, best, elevation)

    @property
    def _along(self) -> FloatArray:
        return np.concatenate([np.zeros((0, 3)), *(line.points for line in self.lines)])


def _corners(solids: Sequence[Solid]) -> FloatArray:
    return np.concatenate([np.zeros((0, 3, 3)), *(solid.vertices[solid.faces] for solid in solids)])


def _trial(camera: Camera, corners: FloatArray) -> KeyArray:
    return cover(*projected(camera, corners, np.zeros(len(corners), dtype=np.int64)), TRIAL)


def _part_seen(points: FloatArray, keys: KeyArray, camera: Camera) -> float:
    """How many of points (k, 3) in view are nearer than ``keys``, 0 to 1; 1 if there are none."""
    if not len(points):
        return 1.0
    x, y, near = camera.pixels(camera.seen(points)).T
    here = keys[y.astype(np.int64), x.astype(np.int64)]
    return float(np.count_nonzero((here == EMPTY) | (near > nearness_of(here)))) / len(points)
