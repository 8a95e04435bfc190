"""What is to be picked, drawn where it shall stand; and where pairs touch that must not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from planner_service.view.nodes.meshes import add_lines, add_mesh
from planner_service.view.state import Errand
from planner_service.view.still.composition import GOAL
from planner_service.view.triangles import crease_lines, triangles_of

__all__ = ["ContactNodes", "ErrandNodes"]

GHOST = 0.3
"""Opacity."""

ANCHORS = ("bottom-left", "top-left", "bottom-right", "top-right")


class ErrandNodes:
    """A ghost of what is to be picked, at its place.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._shown: Errand | None = None
        self._root: Any = None

    def show(self, errand: Errand | None) -> None:
        """Draw it, as soon as its place is known."""
        if errand is self._shown:
            return
        self._shown = errand
        if self._root is not None:
            self._root.remove()
            self._root = None
        if errand is not None and errand.poses:
            pose, triangles = errand.poses[0], triangles_of(errand.target.shape)
            self._root = self._scene.add_frame("/errand", show_axes=False, position=pose.position, wxyz=pose.quaternion)
            add_mesh(self._scene, "/errand/shape", triangles, GOAL.colour, GHOST)
            add_lines(self._scene, "/errand/edges", crease_lines(triangles), GOAL.colour)


class ContactNodes:
    """Points where pairs touch, each with the names of its pair.

    Args:
        scene: viser's scene.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._nodes: list[Any] = []

    def show(self, contacts: Sequence[tuple[tuple[str, str], tuple[float, float, float]]]) -> None:
        """Draw these."""
        for node in self._nodes:
            node.remove()
        self._nodes = []
        for k, ((a, b), position) in enumerate(contacts):
            point = self._scene.add_icosphere(f"/contact/{k}", radius=0.008, color=(255, 230, 0), position=position)
            anchor = ANCHORS[k % len(ANCHORS)]
            self._scene.add_label(f"{point.name}/names", f"{a} × {b}", anchor=anchor, font_screen_scale=0.9)
            self._nodes.append(point)
