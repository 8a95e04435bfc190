"""Paints solids and lines with shading, shadows, outlines and translucent ghosts, smoothed by oversampling."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.view.still.camera import Camera, combined
from planner_service.view.still.raster import EMPTY, KeyArray, cover, nearness_of, numbers_of, projected, ribbon
from planner_service.view.triangles import Colour, Solid

__all__ = ["Drawing", "Line", "paint", "placed"]

Image = NDArray[np.uint8]

FINE = 2
"""Samples per pixel along x and y."""

SKY: tuple[Colour, Colour] = ((255, 255, 255), (240, 243, 247))
"""The background at the top and at the bottom."""

LIGHT = (-0.45, -0.75, -0.48)
"""Direction towards the light: right, down and ahead of the camera, a unit vector up to rounding."""

AMBIENT, BRIGHT = 0.56, 1.06
"""Brightness of a surface that faces away from the light, and of one that faces it, as shares of its colour."""

SHADE = 0.80
"""Brightness in shadow, as a share of the colour."""

SHADOW_MAP, OWN_SIZE = 1400, 900
"""Samples along each side of the shadow map, the picture as the light sees it; of pictures that are less wide than so
many pixels as many as they have."""

BIAS = 2.0
"""Samples of the shadow map by which something must be nearer to the light to cast a shadow on a surface that faces it;
more on a tilted surface, whose depth changes more from one sample to the next."""

GRAZING = 0.15
"""Cosine between the light and the normal of a surface below which no shadow is seen on it."""

OUTLINE = 0.62
"""Brightness of a solid's outline, as a share of its colour."""

LIFT = 0.002
"""Share of its distance by which a line is drawn nearer, so that it is visible on a surface that it lies on."""

HIDDEN = 0.30
"""Opacity of a line where something is in front of it."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line through world points (k, 3), ``width`` pixels wide."""

    points: FloatArray
    colour: Colour
    width: float
    hidden: float = HIDDEN


@dataclass(frozen=True, eq=False)
class Drawing:
    """What to paint, all of it in the world frame.

    Attributes:
        solids: Drawn opaque; they cast shadows.
        ghosts: Groups of solids, each drawn as one translucent surface of the opacity of its first.
        lines: Drawn last, faintly where something is in front of them.
        floor: Lines drawn beneath everything.
    """

    solids: tuple[Solid, ...]
    ghosts: tuple[tuple[Solid, ...], ...] = ()
    lines: tuple[Line, ...] = ()
    floor: tuple[Line, ...] = ()


def placed(solid: Solid, pose: FloatArray) -> Solid:
    """A solid moved into the world by the pose (4, 4) of its frame."""
    return replace(solid, vertices=combined(pose[:3, :3], solid.vertices) + pose[:3, 3], frame=None)


def paint(drawing: Drawing, camera: Camera, size: tuple[int, int]) -> tuple[Image, IntArray]:
    """A picture (height, width, 3), and which of ``solids`` is seen at each pixel, -1 for none.

    Args:
        size: (width, height).
    """
    fine = (size[0] * FINE, size[1] * FINE)
    lens = camera.resized(FINE)
    scene = _Triangles.of(drawing.solids, camera)
    keys = scene.cover(lens, fine)
    owners = scene.owners_at(keys)
    image = _sky(fine)
    seen = np.flatnonzero(keys != EMPTY)
    flat = image.reshape(-1, 3)
    flat[seen] = scene.colours[numbers_of(keys.ravel()[seen])]
    _darken(image, _shadows(scene, camera, keys[::FINE, ::FINE]))
    edges = _edges(owners)
    image[edges] = (image[edges] * OUTLINE).astype(np.uint8)
    _draw_lines(image, keys, drawing.floor, lens)
    ghosts = [_Triangles.of(group, camera) for group in drawing.ghosts]
    _blend_ghosts(image, keys, [(ghost.cover(lens, fine), ghost) for ghost in ghosts])
    _draw_lines(image, keys, drawing.lines, lens)
    return _reduced(image), owners[::FINE, ::FINE]


@dataclass(frozen=True, eq=False)
class _Triangles:
    """Of several solids.

    Attributes:
        corners: In the world, (m, 3, 3).
        colours: Shaded, (m, 3).
        facing: Cosine between the light and their normals, (m,).
        owners: Numbers of the solids, (m,).
        opacity: Of the first solid.
    """

    corners: FloatArray
    colours: Image
    facing: FloatArray
    owners: IntArray
    opacity: float

    @classmethod
    def of(cls, solids: Sequence[Solid], camera: Camera) -> _Triangles:
        counts = [len(solid.faces) for solid in solids]
        corners = np.concatenate([np.zeros((0, 3, 3)), *(solid.vertices[solid.faces] for solid in solids)])
        owners = np.repeat(np.arange(len(solids)), counts)
        colours = np.array([solid.colour for solid in solids], dtype=np.float64).reshape(-1, 3)[owners]
        facing = _facing(corners, combined(camera.axes.T, np.array(LIGHT)))
        tone = AMBIENT + (BRIGHT - AMBIENT) * (0.5 + 0.5 * facing)
        shaded = np.clip(colours * tone[:, None], 0.0, 255.0).astype(np.uint8)
        return cls(corners, shaded, facing, owners, solids[0].opacity if solids else 1.0)

    def cover(self, camera: Camera, size: tuple[int, int]) -> KeyArray:
        return cover(*projected(camera, self.corners, np.arange(len(self.corners))), size)

    def owners_at(self, keys: KeyArray) -> IntArray:
        """The numbers of the solids that keys name, -1 where there is none."""
        out = np.full(keys.shape, -1)
        seen = keys != EMPTY
        out[seen] = self.owners[numbers_of(keys[seen])]
        return out


def _facing(corners: FloatArray, light: FloatArray) -> FloatArray:
    """Cosine between the light and the normals of triangles (m, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    normal = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx])
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    normal /= np.where(length > 0.0, length, 1.0)
    return np.asarray(normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2])


def _sky(size: tuple[int, int]) -> Image:
    width, height = size
    down = (np.arange(height) / (height - 1))[:, None, None]
    colours = np.array(SKY[0]) + down * (np.array(SKY[1]) - np.array(SKY[0]))
    return np.broadcast_to(colours, (height, width, 3)).astype(np.uint8, order="C")


def _darken(image: Image, shadow: FloatArray) -> None:
    """Darken the samples of each pixel by how much of it is in shadow."""
    y, x = np.nonzero(shadow)
    part = (1.0 - (1.0 - SHADE) * shadow[y, x])[:, None]
    for i in range(FINE):
        for j in range(FINE):
            samples = image[i::FINE, j::FINE]
            samples[y, x] = (samples[y, x] * part).astype(np.uint8)


def _edges(owners: IntArray) -> NDArray[np.bool_]:
    """Samples next to one of another solid or of none, on the side of the solid."""
    edges = np.zeros(owners.shape, dtype=bool)
    across, down = owners[:, 1:] != owners[:, :-1], owners[1:] != owners[:-1]
    edges[:, 1:] |= across
    edges[:, :-1] |= across
    edges[1:] |= down
    edges[:-1] |= down
    return edges & (owners >= 0)


def _shadows(scene: _Triangles, camera: Camera, keys: KeyArray) -> FloatArray:
    """The share of each pixel that is in shadow, 0 to 1; 0 for surfaces that face away from the light."""
    out = np.zeros(keys.size)
    where = np.flatnonzero(keys != EMPTY)
    where = where[scene.facing[numbers_of(keys.ravel()[where])] > GRAZING]
    if not len(where):
        return out.reshape(keys.shape)
    side = SHADOW_MAP if keys.shape[1] >= OWN_SIZE else keys.shape[1]
    axes = _light_axes(combined(camera.axes.T, np.array(LIGHT)))
    shown, corners = combined(axes, _points(where, keys, camera)), combined(axes, scene.corners)
    low, high = shown.min(axis=0), shown.max(axis=0)
    high[2] = max(float(high[2]), float(corners[:, :, 2].max()))  # what is above the picture casts shadows, too
    span = np.maximum(high - low, 1e-9)
    scale = np.array([side, side, 1.0]) / span
    keys_of_light = cover((corners - low) * scale, np.arange(len(corners)), (side, side))
    depth = np.where(keys_of_light == EMPTY, 0.0, nearness_of(keys_of_light))
    slope = scene.facing[numbers_of(keys.ravel()[where])]
    sample = float(span[:2].max()) / side
    limit = ((shown[:, 2] - low[2]) + BIAS * sample / slope) * scale[2]
    x, y = (((shown[:, k] - low[k]) * scale[k] - 0.5).astype(np.int64) for k in range(2))
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        out[where] += depth[np.minimum(y + i, side - 1), np.minimum(x + j, side - 1)] > limit
    return out.reshape(keys.shape) / 4.0


def _points(where: IntArray, keys: KeyArray, camera: Camera) -> FloatArray:
    """The world points (k, 3) that the pixels numbered ``where`` show."""
    y, x = np.divmod(where, keys.shape[1])
    ahead = camera.nearest / nearness_of(keys.ravel()[where])
    right, down = ((p + 0.5 - m) * ahead / camera.focal for p, m in zip((x, y), camera.middle, strict=True))
    return combined(camera.axes.T, np.stack([right, down, ahead], axis=-1)) + camera.eye


def _light_axes(light: FloatArray) -> FloatArray:
    """Rows: two directions across the light, and towards it."""
    x, y, z = light.tolist()
    flat = math.hypot(x, y)
    return np.array([[-y / flat, x / flat, 0.0], [-x * z / flat, -y * z / flat, flat], [x, y, z]])


def _blend_ghosts(image: Image, keys: KeyArray, ghosts: Sequence[tuple[KeyArray, _Triangles]]) -> None:
    """Ghosts over the picture where they are nearer than ``keys``, at each sample the farthest first."""
    if not ghosts:
        return
    behind = keys.ravel()
    nearer = [ghost.ravel() < behind for ghost, _ in ghosts]
    where = np.flatnonzero(np.logical_or.reduce(nearer))
    stack = np.stack(
        [np.where(seen[where], ghost.ravel()[where], EMPTY) for seen, (ghost, _) in zip(nearer, ghosts, strict=True)]
    )
    flat = image.reshape(-1, 3)
    colours = flat[where].astype(np.float64)
    edges = [_edges(ghost.owners_at(keys_of_ghost)).ravel()[where] for keys_of_ghost, ghost in ghosts]
    for rank in stack.argsort(axis=0, kind="stable")[::-1]:
        for k, (_, ghost) in enumerate(ghosts):
            rows = np.flatnonzero((rank == k) & (stack[k] != EMPTY))
            over = ghost.colours[numbers_of(stack[k, rows])] * np.where(edges[k][rows], OUTLINE, 1.0)[:, None]
            opacity = np.where(edges[k][rows], 0.5 + 0.5 * ghost.opacity, ghost.opacity)[:, None]
            colours[rows] += opacity * (over - colours[rows])
    flat[where] = colours.astype(np.uint8)


def _draw_lines(image: Image, keys: KeyArray, lines: Sequence[Line], lens: Camera) -> None:
    """Lines over the picture, faintly where they are farther than ``keys``."""
    if not lines:
        return
    strips = [ribbon(lens, line.points, line.width * FINE, LIFT) for line in lines]
    numbers = np.repeat(np.arange(len(lines)), [len(strip) for strip in strips])
    line_keys = cover(np.concatenate(strips), numbers, (keys.shape[1], keys.shape[0])).ravel()
    where = np.flatnonzero(line_keys != EMPTY)
    which = numbers_of(line_keys[where])
    hidden = np.array([line.hidden for line in lines])[which]
    share = np.where(line_keys[where] <= keys.ravel()[where], 1.0, hidden)[:, None]
    flat, colours = image.reshape(-1, 3), np.array([line.colour for line in lines])[which]
    flat[where] = (flat[where] + share * (colours - flat[where])).astype(np.uint8)


def _reduced(image: Image) -> Image:
    """The mean of the samples of each pixel."""
    total = np.zeros((image.shape[0] // FINE, image.shape[1] // FINE, 3), dtype=np.uint16)
    for i in range(FINE):
        for j in range(FINE):
            total += image[i::FINE, j::FINE]
    return (total // FINE**2).astype(np.uint8)
