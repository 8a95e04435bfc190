"""Drags the selected obstacle: over the surfaces behind it, or freely by its handles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.view.cell.edits import Cell
from planner_service.view.cell.surfaces import Hit, resting
from planner_service.view.nodes.handles import Handles
from planner_service.view.nodes.scene_nodes import SceneNodes
from planner_service.view.triangles import extremes, middle_of

__all__ = ["ObstacleDrag"]


class ObstacleDrag:
    """What a drag of the selected obstacle does; the cell changes when it is let go.

    Args:
        scene: viser's scene.
        size: Of the handles, in metres.
        nodes: The nodes of the obstacles.
        cell: The cell as it is now.
        moved: Called with the pose at which the obstacle is let go.
    """

    def __init__(
        self, scene: Any, size: float, nodes: SceneNodes, cell: Callable[[], Cell], moved: Callable[[Pose], None]
    ) -> None:
        self._nodes, self._cell, self._moved = nodes, cell, moved
        self._handles = Handles(scene, "/cell", size, self._by_handles)
        self._mesh: Any = None
        self._grip = Pose()
        self._aside: FloatArray | None = None
        self._pose: Pose | None = None

    def show(self, *, handles: bool) -> None:
        """Take hold of what is selected now."""
        obstacle, mesh = self._cell().obstacle, self._nodes.selected_mesh
        if obstacle is not None and mesh is not None:
            self._grip = Pose(tuple(middle_of(obstacle.shape).tolist()))
            self._handles.show(obstacle.pose @ self._grip, visible=handles)
        else:
            self._handles.hide()
        if mesh is not self._mesh:
            self._mesh = mesh
            if mesh is not None:
                mesh.on_drag(self._over_surfaces)

    def _by_handles(self, grip: Pose, released: bool) -> None:
        pose = grip @ self._grip.inverse()
        self._nodes.drag(pose)
        if released:
            self._moved(pose)

    async def _over_surfaces(self, event: Any) -> None:  # not in a thread: updates must keep their order
        cell = self._cell()
        if cell.obstacle is None or event.target is not self._mesh:
            return
        eye = np.array(event.client.camera.position)
        hit = cell.surfaces.met_by(eye, np.array(event.end_position) - eye)
        if event.phase == "start":
            middle = extremes(cell.obstacle).mean(axis=0)
            self._aside, self._pose = (None if hit is None else _along(middle - hit.point, hit)), None
        elif hit is not None:
            aside = np.zeros(3) if self._aside is None else _along(self._aside, hit)
            self._pose = resting(cell.obstacle, hit.point + aside, hit.normal)
            self._nodes.drag(self._pose)
        if event.phase == "end" and self._pose is not None:
            self._moved(self._pose)


def _along(vector: FloatArray, hit: Hit) -> FloatArray:
    """The part of a vector that lies in the surface."""
    return np.asarray(vector - hit.normal * float(hit.normal @ vector))
