"""Robots, scenes and constraints as nodes of a viser scene: each mesh is sent once, then only moved and recoloured."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray, Vector
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.constraint_set import Placed
from planner_service.robot.model import Robot
from planner_service.scene.names import Kind, Owner, owner_of
from planner_service.scene.scene import Attached, Obstacle, Scene
from planner_service.view.regions import Kept, cap, edges, fan, frames_at, rectangles
from planner_service.view.still.composition import KEPT, TOUCHING
from planner_service.view.triangles import GROUND, TOOL, Colour, Solid, placements, robot_solids, scene_solids

__all__ = ["RegionNodes", "RobotNodes", "SceneNodes", "colours_of"]

AMBER: Colour = (235, 165, 30)
BOTH_SIDES = math.pi / 4
"""Radians: bounds on a tilt below this are drawn for the opposite direction, too, as an upright axis of a gripper often
points into the hand."""


def _add(scene: Any, path: str, solid: Solid, colour: Colour, opacity: float) -> Any:
    return scene.add_mesh_simple(
        path,
        solid.vertices.astype(np.float32),
        solid.faces.astype(np.uint32),
        color=colour,
        opacity=None if opacity >= 1.0 else opacity,
        flat_shading=True,
        side="double" if opacity >= 1.0 else "front",
        cast_shadow=opacity >= 1.0,
        receive_shadow=opacity >= 1.0,
    )


class RobotNodes:
    """The nodes of a robot, or of a translucent ghost of one.

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
        opacity = 1.0 if ghost is None else 0.28
        links = [*self._solids, TOOL]
        self._frames = {link: scene.add_frame(f"{root}/{k}", show_axes=False) for k, link in enumerate(links)}
        self._meshes = {
            name: _add(scene, f"{root}/{k}/shape", solid, ghost or solid.colour, opacity)
            for k, (name, solid) in enumerate(self._solids.items())
        }
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


class SceneNodes:
    """The nodes of obstacles, their labels, and what the robot carries.

    Args:
        scene: viser's scene.
        tool: The name of the tool frame's node, the parent of what is carried.
    """

    def __init__(self, scene: Any, tool: str) -> None:
        self._scene, self._tool = scene, tool
        self._bodies: dict[str, Obstacle | Attached] = {}
        self._nodes: dict[str, tuple[Any, Any]] = {}
        self._colours: dict[tuple[str, bool], Colour] = {}
        self._painted: dict[str, Colour] = {}
        self._labels = True
        self._count = 0

    def show(self, scene: Scene) -> None:
        """Draw a scene; nodes of bodies that did not change are kept."""
        standing: dict[str, Obstacle | Attached] = {obstacle.name: obstacle for obstacle in scene.obstacles}
        bodies = standing | {held.name: held for held in scene.attached}
        gone = [name for name, body in self._bodies.items() if bodies.get(name) != body]
        for name in gone:
            for node in self._nodes.pop(name):
                node.remove()
            self._painted.pop(name, None)
        fresh = {name for name, body in bodies.items() if name not in self._nodes}
        if fresh:
            for solid in scene_solids(scene):
                if solid.name in fresh:
                    self._draw(solid)
        self._bodies = bodies

    def _draw(self, solid: Solid) -> None:
        self._count += 1
        colour = self._colours.setdefault((solid.name, solid.frame is None), solid.colour)
        root = f"/scene/{self._count}" if solid.frame is None else f"{self._tool}/{self._count}"
        low, high = solid.vertices.min(axis=0), solid.vertices.max(axis=0)
        middle = (low + high) / 2.0
        if solid.colour == GROUND:  # its middle is below the robot
            middle = 0.9 * np.array([high[0], low[1], 0.0]) + 0.1 * middle
        top = (middle[0], middle[1], high[2]) if solid.frame is None else tuple(middle)
        mesh = _add(self._scene, f"{root}/shape", solid, colour, solid.opacity)
        label = self._scene.add_label(
            f"{root}/name", solid.name, position=top, anchor="bottom-center", font_screen_scale=0.75,
            visible=self._labels and solid.frame is None,
        )  # fmt: skip
        self._nodes[solid.name] = mesh, label

    def paint(self, colours: dict[Owner, Colour]) -> None:
        """Recolour some bodies; the others get their own colour back."""
        for name, (mesh, _) in self._nodes.items():
            own = self._colours[name, isinstance(self._bodies[name], Obstacle)]
            colour = colours.get(Owner(Kind.OBJECT, name), own)
            if self._painted.get(name, own) != colour:
                self._painted[name] = mesh.color = colour

    def label(self, shown: bool) -> None:
        """Show or hide the names of obstacles."""
        if shown == self._labels:
            return
        self._labels = shown
        for name, (_, label) in self._nodes.items():
            label.visible = shown and isinstance(self._bodies[name], Obstacle)


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


def colours_of(
    colliding: Collection[tuple[str, str]], expected: Collection[tuple[str, str]], robot: Robot
) -> dict[Owner, Colour]:
    """Red for links and bodies in collision, amber for those in a contact that is expected."""
    colours = {name: AMBER for pair in expected for name in pair} | {
        name: TOUCHING for pair in colliding for name in pair
    }
    return {owner_of(name, robot): colour for name, colour in colours.items()}
