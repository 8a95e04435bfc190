"""Handles to drag: at the tool of the goal, which follows, and at the obstacle that is selected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from planner_service.geometry.shapes import Pose
from planner_service.view.updates import update

__all__ = ["Handles"]


class Handles:
    """Arrows, planes and rings to move and turn something.

    Args:
        scene: viser's scene.
        path: The name of their node.
        size: Their length in metres.
        dragged: Called with the pose of the handles in the base frame, and whether they were let go.
    """

    def __init__(self, scene: Any, path: str, size: float, dragged: Callable[[Pose, bool], None]) -> None:
        self._node = scene.add_transform_controls(path, scale=size, depth_test=False, opacity=0.8, visible=False)
        self._dragged = dragged
        self._node.on_update(self._on_update)

    async def _on_update(self, event: Any) -> None:  # not in a thread: updates must keep their order
        if event.client is not None:
            self._dragged(self._pose(), event.phase == "end")

    def _pose(self) -> Pose:
        x, y, z = map(float, self._node.position)
        w, i, j, k = map(float, self._node.wxyz)
        return Pose((x, y, z), (w, i, j, k))

    def show(self, pose: Pose, *, visible: bool) -> None:
        """Put the handles at a pose."""
        if self._pose() != pose:
            self._node.position, self._node.wxyz = pose.position, pose.quaternion
        update(self._node, visible=visible)

    def hide(self) -> None:
        """Show them no longer."""
        update(self._node, visible=False)
