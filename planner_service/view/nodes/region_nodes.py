"""The regions that constraints allow, as nodes of a viser scene, with arrows that show where the robot is in them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, Vector
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.constraint_set import Placed
from planner_service.view.regions import Kept, cap, edges, fan, frames_at, rectangles
from planner_service.view.still.composition import KEPT, TOUCHING

__all__ = ["RegionNodes"]

BOTH_SIDES = math.pi / 4
"""Radians: bounds on a tilt below this are drawn for the opposite direction, too, as an upright axis of a gripper often
points into the hand."""


class RegionNodes:
    """The nodes of the regions that a motion keeps to, and of the arrows that show where the robot is in them.

    Args:
        scene: viser's scene.
        root: The name of the parent node.
        length: Of the arrows, in metres.

    Attributes:
        root: The parent node, by which all of it is shown or hidden.
    """

    def __init__(self, scene: Any, root: str, length: float) -> None:
        self.root = scene.add_frame(root, show_axes=False)
        self._scene, self._length = scene, length
        self._kept: Kept | None = None
        self._frames: list[dict[str, Any]] = []
        self._shapes: list[list[Any]] = []
        self._broken: list[bool] = []

    @property
    def any(self) -> bool:
        """Whether anything is drawn."""
        return any(self._shapes)

    def show(self, kept: Kept | None, q: FloatArray) -> None:
        """Draw the regions of a motion, with the robot at q (n,)."""
        if kept is not self._kept:
            for frame in (frame for frames in self._frames for frame in frames.values()):
                frame.remove()
            self._kept, self._frames, self._shapes, self._broken = kept, [], [], []
            if kept is not None:
                for placed in kept.constraints.regions:
                    self._add(placed, frames_at(kept.constraints.robot, placed, kept.Q).points)
        if kept is not None:
            self._move(kept, q)

    def _add(self, placed: Placed, points: FloatArray) -> None:
        scene, length, root, region = self._scene, self._length, f"{self.root.name}/{len(self._shapes)}", placed.region
        names = ("region", "allowed", "held", "turned")
        self._frames.append({name: scene.add_frame(f"{root}/{name}", show_axes=False) for name in names})
        shapes = []
        corners = rectangles(region, points)
        if len(corners):
            first = 4 * np.arange(len(corners))[:, None, None]
            faces = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
            shapes.append(self._sheet(f"{root}/region/bounds", corners.reshape(-1, 3), faces))
            lines = edges(corners).astype(np.float32)
            shapes.append(
                scene.add_line_segments(f"{root}/region/edges", lines, KEPT, thickness=1.5, thickness_units="screen")
            )
        if region.tilt is not None:
            vertices, faces = cap(region.tilt, 0.9 * length)
            shapes.append(self._sheet(f"{root}/allowed/tilt", vertices, faces))
            if region.tilt < BOTH_SIDES:
                shapes.append(self._sheet(f"{root}/allowed/opposite", -vertices, faces))
            shapes.append(self._arrow(f"{root}/held/axis", (0.0, 0.0, -length), (0.0, 0.0, length)))
        if region.turn is not None:
            shapes.append(self._sheet(f"{root}/allowed/turn", *fan(region.turn, 0.9 * length)))
            shapes.append(self._arrow(f"{root}/turned/axis", (0.0, 0.0, 0.0), (length, 0.0, 0.0)))
        self._shapes.append(shapes)
        self._broken.append(False)

    def _sheet(self, path: str, vertices: FloatArray, faces: IntArray) -> Any:
        return self._scene.add_mesh_simple(
            path, vertices.astype(np.float32), faces.astype(np.uint32), color=KEPT, opacity=0.18, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _arrow(self, path: str, start: Vector, end: Vector) -> Any:
        points, thick = np.array([[start, end]], dtype=np.float32), 0.02 * self._length
        return self._scene.add_arrows(
            path, points, KEPT, shaft_radius=thick, head_radius=3.0 * thick, head_length=8.0 * thick
        )

    def _move(self, kept: Kept, q: FloatArray) -> None:
        for placed, frames in zip(kept.constraints.regions, self._frames, strict=True):
            there = frames_at(kept.constraints.robot, placed, q[None])
            for name, frame in frames.items():
                pose = Pose.from_matrix(getattr(there, name)[0])
                frame.position, frame.wxyz = pose.position, pose.quaternion
        broken = kept.broken(q)
        for shapes, before, now in zip(self._shapes, self._broken, broken, strict=True):
            for shape in shapes if now != before else ():
                if hasattr(shape, "color"):
                    shape.color = TOUCHING if now else KEPT
                else:
                    shape.colors = np.array(TOUCHING if now else KEPT, dtype=np.uint8)
        self._broken = broken
