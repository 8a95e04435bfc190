"""What the robot looks like as nodes of a viser scene, under or in the place of the shapes that are checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from planner_service.errors import PlannerServiceError
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.presentation.tables import markdown_escaped
from planner_service.robot.model import Robot
from planner_service.robot_setup.visuals import Looks, looks_of
from planner_service.view.triangles import visual_solids

__all__ = ["BOTH", "CHECKED", "LOOKS", "WAYS", "LookNodes"]

CHECKED, LOOKS, BOTH = "the shapes that are checked", "what it looks like", "both"
WAYS = (CHECKED, LOOKS, BOTH)
"""How the robot is drawn."""


class LookNodes:
    """The nodes of what a robot looks like; its file is read when they are shown for the first time.

    Args:
        scene: viser's scene.
        root: The name of the parent node.

    Attributes:
        note: What is missing and why, in Markdown; empty if nothing is.
    """

    def __init__(self, scene: Any, root: str) -> None:
        self._scene = scene
        self._root = scene.add_frame(root, show_axes=False, visible=False)
        self._looks: Looks | None = None
        self._frames: dict[str, Any] = {}
        self._poses: dict[str, FloatArray] = {}
        self.note = ""

    @property
    def any(self) -> bool:
        """Whether there is something to show."""
        return bool(self._frames)

    def show(self, robot: Robot, *, visible: bool) -> None:
        """Show or hide the nodes."""
        if visible and self._looks is None:
            self._read(robot)
        self._root.visible = visible and self.any

    def _read(self, robot: Robot) -> None:
        try:
            self._looks = looks_of(robot)
        except PlannerServiceError as error:
            self._looks, self.note = Looks({}, (), {}), markdown_escaped(str(error))
            return
        known = self._looks.placements(robot, robot.home)
        visuals = {link: items for link, items in self._looks.visuals.items() if link in known}
        solids = visual_solids(visuals)
        for k, solid in enumerate(solids):
            self._frames[solid.name] = self._scene.add_frame(f"{self._root.name}/{k}", show_axes=False)
            self._scene.add_mesh_simple(
                f"{self._root.name}/{k}/looks",
                solid.vertices.astype(np.float32),
                solid.faces.astype(np.uint32),
                color=solid.colour,
                side="double",
            )
        missing = [f"{len(self._looks.unread)} visual elements cannot be read"] if self._looks.unread else []
        missing += [f"{len(visuals) - len(solids)} links have too many triangles"] if len(solids) < len(visuals) else []
        self.note = "; ".join(missing) if solids else "nothing is known of what it looks like"

    def move(self, robot: Robot, q: FloatArray) -> None:
        """Move what is shown to q (n,); only links that moved are sent."""
        if self._looks is None or not self._root.visible:
            return
        for link, T in self._looks.placements(robot, q).items():
            before, frame = self._poses.get(link), self._frames.get(link)
            if frame is None or (before is not None and np.array_equal(before, T)):
                continue
            self._poses[link], pose = T, Pose.from_matrix(T)
            frame.position, frame.wxyz = pose.position, pose.quaternion
