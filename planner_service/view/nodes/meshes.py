"""Meshes and outlines as nodes of a viser scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.geometry.arrays import FloatArray
from planner_service.view.triangles import Colour, Form, Triangles, unit_triangles

__all__ = ["OUTLINE", "add_copies", "add_lines", "add_mesh", "copies_colours"]

OUTLINE = 1.5
"""Pixels."""


def add_mesh(
    scene: Any, path: str, triangles: Triangles, colour: Colour, opacity: float = 1.0, *, smooth: bool = False
) -> Any:
    """A node with the triangles of a closed surface, which may be drawn as if it bent where they meet."""
    opaque = opacity >= 1.0
    return scene.add_mesh_simple(
        path,
        triangles[0].astype(np.float32),
        triangles[1].astype(np.uint32),
        color=colour,
        opacity=None if opaque else opacity,
        flat_shading=not smooth,
        side="double" if opaque else "front",
        cast_shadow=opaque,
        receive_shadow=opaque,
    )


def add_copies(scene: Any, path: str, form: Form, turns: FloatArray, places: FloatArray, scales: FloatArray) -> Any:
    """A node with copies of a form, black at first: turns (k, 4) as w, x, y, z, places (k, 3) and scales (k, 3)."""
    vertices, faces = unit_triangles(form)
    return scene.add_batched_meshes_simple(
        path,
        vertices.astype(np.float32),
        faces.astype(np.uint32),
        turns.astype(np.float32),
        places.astype(np.float32),
        batched_scales=scales.astype(np.float32),
        batched_colors=np.zeros((len(places), 3), dtype=np.uint8),
        lod="off",
        flat_shading=form is not Form.SPHERE,
    )


def copies_colours(colours: Sequence[Colour]) -> NDArray[np.uint8]:
    """Colours of copies, (k, 3): viser takes them as amounts of light, but those of other meshes as sRGB."""
    shares = np.array(colours, dtype=np.float64).reshape(-1, 3) / 255.0
    light = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return np.rint(255.0 * light).astype(np.uint8)


def add_lines(scene: Any, path: str, segments: FloatArray, colour: Colour, pixels: float = OUTLINE) -> Any:
    """A node with segments (k, 2, 3) as lines that are as thick from everywhere."""
    lines = segments.astype(np.float32)
    return scene.add_line_segments(path, lines, colour, thickness=pixels, thickness_units="screen")
