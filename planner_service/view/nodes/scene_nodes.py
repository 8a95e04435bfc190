"""A scene as nodes of a viser scene: simple shapes are copies of a few meshes, however many there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import PointCloud
from planner_service.geometry.shapes import Capsule, Pose
from planner_service.scene.names import Kind, Owner
from planner_service.scene.scene import Attached, Obstacle, Scene
from planner_service.view.cell.edits import Cell
from planner_service.view.nodes.meshes import add_copies, add_lines, add_mesh, copies_colours
from planner_service.view.triangles import (
    CARRIED,
    Colour,
    Copies,
    Form,
    bounds_of,
    copies_of,
    crease_lines,
    middle_of,
    obstacle_colour,
    triangles_of,
    unit_triangles,
)

__all__ = ["Clicked", "SceneNodes"]

SELECTED: Colour = (0, 110, 255)

Body = Obstacle | Attached

Clicked = Callable[[str, FloatArray, FloatArray], None]
"""Called with the name of an obstacle that was clicked, and the ray of the click: origin and direction, (3,) each."""


class SceneNodes:
    """The nodes of obstacles, and of what the robot carries; one obstacle may be selected, and has its name beside it.

    Args:
        scene: viser's scene.
        tool: The name of the tool frame's node, the parent of what is carried.
        clicked: Called when an obstacle is clicked.
    """

    def __init__(self, scene: Any, tool: str, clicked: Clicked) -> None:
        self._scene, self._tool, self._clicked = scene, tool, clicked
        self._bodies: dict[str, Body] = {}
        self._own: dict[str, Colour] = {}
        self._families: dict[str, Colour] = {}
        self._copies: dict[str, Copies | None] = {}
        self._groups = {form: _Group(scene, form, self._on_click) for form in Form}
        self._single: dict[str, _Single] = {}
        self._shown: Scene | None = None
        self._selected: str | None = None
        self._paints: dict[str, Colour] = {}
        self._label: Any = None
        self._count = 0

    def show(self, scene: Scene, cell: Cell) -> None:
        """Draw a scene that motions made of that of a cell; what did not change is not sent again.

        What was set down has the colour that it had, and is not selected where it is now.
        """
        standing: dict[str, Body] = {obstacle.name: obstacle for obstacle in scene.obstacles}
        bodies, chosen = standing | {held.name: held for held in scene.attached}, cell.obstacle
        there = None if chosen is None else standing.get(chosen.name)
        selected = chosen.name if chosen is not None and there is not None and there.pose == chosen.pose else None
        if scene is self._shown and selected == self._selected:
            return
        for name in [name for name, body in self._bodies.items() if not _alike(bodies.get(name), body)]:
            self._copies.pop(name, None)
            self._own.pop(name, None)
        for name, body in bodies.items():
            if name not in self._copies:
                self._copies[name] = copies_of(body.shape)
            if name not in self._own:
                self._own[name] = self._colour_by(body, cell)
        self._shown, self._bodies, self._selected = scene, bodies, selected
        self._draw()

    def _colour_by(self, body: Body, cell: Cell) -> Colour:
        if isinstance(body, Attached):
            return CARRIED
        before = next((obstacle.colour for obstacle in cell.scene.obstacles if obstacle.name == body.name), None)
        return obstacle_colour(body if body.colour else replace(body, colour=before), self._families)

    def _draw(self) -> None:
        if self._label is not None:
            self._label.remove()
            self._label = None
        grouped: dict[Form, dict[str, Body]] = {form: {} for form in Form}
        single = dict[str, Body]()
        for name, body in self._bodies.items():
            copies = self._copies[name]
            if copies is None or len(copies.centres) > 1 or isinstance(body, Attached) or name == self._selected:
                single[name] = body
            else:
                grouped[copies.form][name] = body
        for name in [name for name, node in self._single.items() if not node.shows(single.get(name))]:
            self._single.pop(name).remove()
        for name, body in single.items():
            if name not in self._single:
                self._single[name] = self._added(name, body)
            self._single[name].move(body)
        for form, members in grouped.items():
            self._groups[form].show({name: (body.pose, self._copies[name]) for name, body in members.items()})
        for name, node in self._single.items():
            node.outline(SELECTED if name == self._selected else None)
        if self._selected is not None:
            self._name_it(self._selected)
        self._colour()

    def _added(self, name: str, body: Body) -> _Single:
        self._count += 1
        root = f"{self._tool}/{self._count}" if isinstance(body, Attached) else f"/scene/{self._count}"
        single = _Single(self._scene, root, body, self._copies[name], self._own[name])
        if isinstance(body, Obstacle):
            single.mesh.on_click(lambda event: self._on_click(name, event))
        return single

    def _on_click(self, name: str, event: Any) -> None:
        self._clicked(name, np.array(event.ray_origin), np.array(event.ray_direction))

    def _name_it(self, name: str) -> None:
        body = self._bodies[name]
        up = body.pose.rotation.T @ np.array([0.0, 0.0, 1.0])
        middle = middle_of(body.shape)
        top = middle + up * float(up @ (body.shape.support(up) - middle))
        self._label = self._scene.add_label(
            f"{self._single[name].root.name}/name", name, position=tuple(top.tolist()), anchor="bottom-center",
            font_screen_scale=0.9,
        )  # fmt: skip

    def drag(self, pose: Pose) -> None:
        """Show the selected obstacle elsewhere, while it is dragged."""
        if self._selected is not None:
            self._single[self._selected].place(pose)

    @property
    def selected_mesh(self) -> Any:
        """The node of the selected obstacle's mesh; None without one."""
        return None if self._selected is None else self._single[self._selected].mesh

    def colour_of(self, name: str | None) -> Colour:
        """The own colour of a body that is shown; black for none."""
        return (0, 0, 0) if name is None else self._own.get(name, (0, 0, 0))

    def paint(self, colours: dict[Owner, Colour]) -> None:
        """Recolour some bodies; the others get their own colour back."""
        paints = {owner.name: colour for owner, colour in colours.items() if owner.kind is Kind.OBJECT}
        if paints != self._paints:
            self._paints = paints
            self._colour()

    def _colour(self) -> None:
        for name, node in self._single.items():
            node.paint(self._paints.get(name, self._own[name]))
        for group in self._groups.values():
            group.paint([self._paints.get(name, self._own[name]) for name in group.names])


def _alike(a: Body | None, b: Body) -> bool:
    """Whether two bodies of one name are drawn alike, wherever they are."""
    return type(a) is type(b) and a is not None and a.shape == b.shape and _colour(a) == _colour(b)


def _colour(body: Body) -> str | None:
    return body.colour if isinstance(body, Obstacle) else None


class _Group:
    """All obstacles of one form: one node."""

    def __init__(self, scene: Any, form: Form, clicked: Callable[[str, Any], None]) -> None:
        self._scene, self._form, self._clicked = scene, form, clicked
        self._node: Any = None
        self.names: tuple[str, ...] = ()
        self._painted: list[Colour] = []

    def show(self, members: dict[str, tuple[Pose, Any]]) -> None:
        """Draw these obstacles, each by its pose and copies."""
        names = tuple(members)
        places = np.array([pose.position for pose, _ in members.values()]).reshape(-1, 3)
        turns = np.array([pose.quaternion for pose, _ in members.values()]).reshape(-1, 4)
        scales = np.array([copies.scales[0] for _, copies in members.values()]).reshape(-1, 3)
        if len(names) != len(self.names):
            if self._node is not None:
                self._node.remove()
            self._node = None
            if names:
                self._node = add_copies(self._scene, f"/scene/{self._form.value}", self._form, turns, places, scales)
                self._node.on_click(self._on_click)
            self._painted = []
        elif names:
            for key, value in (("batched_positions", places), ("batched_wxyzs", turns), ("batched_scales", scales)):
                if not np.array_equal(getattr(self._node, key), value.astype(np.float32)):
                    setattr(self._node, key, value.astype(np.float32))
        self.names = names

    def _on_click(self, event: Any) -> None:
        names = self.names
        if event.instance_index is not None and event.instance_index < len(names):
            self._clicked(names[event.instance_index], event)

    def paint(self, colours: list[Colour]) -> None:
        """Colour the obstacles, in the order of ``names``."""
        if colours != self._painted:
            self._painted = colours
            if self._node is not None:
                self._node.batched_colors = copies_colours(colours)


class _Single:
    """One body that has a node of its own."""

    def __init__(self, scene: Any, root: str, body: Body, copies: Copies | None, colour: Colour) -> None:
        self._scene, self._body, self._painted = scene, body, colour
        self._lines: Any = None
        self.root = scene.add_frame(root, show_axes=False)
        path = f"{root}/shape"
        if copies is None:
            smooth = isinstance(body.shape, Capsule)
            self.mesh = add_mesh(scene, path, triangles_of(body.shape), colour, smooth=smooth)
        else:
            turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(copies.centres), 1))
            self.mesh = add_copies(scene, path, copies.form, turns, copies.centres, copies.scales)
            self.mesh.batched_colors = copies_colours([colour])[0]

    def shows(self, body: Body | None) -> bool:
        """Whether it is the node of that body, wherever that is."""
        return _alike(body, self._body)

    def move(self, body: Body) -> None:
        """Put it where the body is."""
        self._body = body
        self.place(body.pose)

    def place(self, pose: Pose) -> None:
        """Put it at a pose."""
        if tuple(self.root.position) != pose.position or tuple(self.root.wxyz) != pose.quaternion:
            self.root.position, self.root.wxyz = pose.position, pose.quaternion

    def paint(self, colour: Colour) -> None:
        """Colour it."""
        if colour != self._painted:
            self._painted = colour
            if hasattr(self.mesh, "color"):
                self.mesh.color = colour
            else:
                self.mesh.batched_colors = copies_colours([colour])[0]

    def outline(self, colour: Colour | None) -> None:
        """Draw its edges as lines; None for no lines."""
        if (colour is None) == (self._lines is None):
            return
        if colour is None:
            self._lines.remove()
            self._lines = None
        else:
            shape = self._body.shape
            box = _bounds(shape) if isinstance(shape, PointCloud) else crease_lines(triangles_of(shape))
            self._lines = add_lines(self._scene, f"{self.root.name}/edges", box, colour, 2.5)

    def remove(self) -> None:
        """Remove its nodes."""
        self.root.remove()


def _bounds(cloud: PointCloud) -> FloatArray:
    """The edges of the box around a cloud, whose own would hide it."""
    low, high = bounds_of(cloud)
    vertices, faces = unit_triangles(Form.BOX)
    return crease_lines((low + (vertices + 0.5) * (high - low), faces))
