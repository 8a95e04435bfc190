"""Robots and their ghosts as nodes of a viser scene: each mesh is sent once, then only moved and recoloured."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Owner, owner_of
from planner_service.view.nodes.meshes import add_lines, add_mesh
from planner_service.view.still.composition import TOUCHING
from planner_service.view.triangles import TOOL, Colour, crease_lines, placements, robot_solids

__all__ = ["RobotNodes", "colours_of"]

AMBER: Colour = (235, 165, 30)
GHOST = 0.2
"""Opacity of a ghost's faces; its edges are opaque."""


class RobotNodes:
    """The nodes of a robot, or of a ghost of one: translucent, with its edges as lines.

    Args:
        scene: viser's scene.
        root: The name of the parent node.
        ghost: The one colour of a ghost; None for a robot in the colours of its links.

    Attributes:
        root: The parent node, by which all of it is shown or hidden.
        tool: The name of the tool frame's node.
    """

    def __init__(self, scene: Any, root: str, robot: Robot, *, ghost: Colour | None = None) -> None:
        self._robot, self._ghost = robot, ghost
        self.root = scene.add_frame(root, show_axes=False)
        self._solids = {solid.name: solid for solid in robot_solids(robot)}
        links = [*self._solids, TOOL]
        self._frames = {link: scene.add_frame(f"{root}/{k}", show_axes=False) for k, link in enumerate(links)}
        self._meshes, self._edges = dict[str, Any](), dict[str, Any]()
        for k, (name, solid) in enumerate(self._solids.items()):
            triangles, colour = (solid.vertices, solid.faces), ghost or solid.colour
            self._meshes[name] = add_mesh(scene, f"{root}/{k}/shape", triangles, colour, GHOST if ghost else 1.0)
            if ghost:
                self._edges[name] = add_lines(scene, f"{root}/{k}/edges", crease_lines(triangles), ghost)
        self.tool = f"{root}/{len(links) - 1}"
        self._poses: dict[str, FloatArray] = {}
        self._painted: dict[str, Colour] = {}

    def set_robot(self, robot: Robot) -> None:
        """Take over the gripper opening of another value of the same robot."""
        if robot is self._robot or robot.gripper_width == self._robot.gripper_width:
            return
        self._robot = robot
        for solid in robot_solids(robot):
            if not np.array_equal(solid.vertices, self._solids[solid.name].vertices):
                self._solids[solid.name] = solid
                self._meshes[solid.name].vertices = solid.vertices.astype(np.float32)
                if solid.name in self._edges:
                    lines = crease_lines((solid.vertices, solid.faces))
                    self._edges[solid.name].points = lines.astype(np.float32)

    def fade(self, opacity: float) -> None:
        """Make its links opaque (1), translucent or invisible (0)."""
        for mesh in self._meshes.values():
            mesh.visible, mesh.opacity = opacity > 0.0, None if opacity >= 1.0 else opacity
            mesh.cast_shadow = mesh.receive_shadow = opacity >= 1.0

    def move(self, q: FloatArray) -> None:
        """Move the robot to q (n,); only links that moved are sent."""
        for link, T in placements(self._robot, q).items():
            before = self._poses.get(link)
            if before is not None and np.array_equal(before, T):
                continue
            self._poses[link], frame = T, self._frames[link]
            pose = Pose.from_matrix(T)
            frame.position, frame.wxyz = pose.position, pose.quaternion

    def paint(self, colours: dict[Owner, Colour]) -> None:
        """Recolour some links; the others get their own colour back."""
        self._recolour({name: colours.get(Owner(Kind.LINK, name), self._own(name)) for name in self._solids})

    def tint(self, colour: Colour | None) -> None:
        """Recolour all of it; None for its own colours."""
        self._recolour({name: colour or self._own(name) for name in self._solids})

    def _own(self, name: str) -> Colour:
        return self._ghost or self._solids[name].colour

    def _recolour(self, colours: dict[str, Colour]) -> None:
        for name, colour in colours.items():
            if self._painted.get(name, self._own(name)) != colour:
                self._painted[name] = self._meshes[name].color = colour
                if name in self._edges:
                    self._edges[name].colors = np.array(colour, dtype=np.uint8)


def colours_of(
    colliding: Collection[tuple[str, str]], expected: Collection[tuple[str, str]], robot: Robot
) -> dict[Owner, Colour]:
    """Red for links and bodies in collision, amber for those in a contact that is expected."""
    colours = {name: AMBER for pair in expected for name in pair} | {
        name: TOUCHING for pair in colliding for name in pair
    }
    return {owner_of(name, robot): colour for name, colour in colours.items()}
