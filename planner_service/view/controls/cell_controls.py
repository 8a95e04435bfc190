"""The controls with which a cell is built: what the selected obstacle is, and the files it comes from and goes to."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.scene.scene import Obstacle
from planner_service.view.cell.edits import NEW, Cell
from planner_service.view.cell.folder import UNITS, CellFolder
from planner_service.view.updates import update

__all__ = ["CellControls", "FileControls"]

MAX_NAMES = 300
"""Names in the list of obstacles; the others are selected by a click on them."""

HINT = "Click an obstacle to select it. Drag it to slide it over what is behind it; arrows and rings move it freely."

Edit = Callable[[Cell], Cell]


class CellControls:
    """Lists, fields and buttons.

    Args:
        gui: viser's controls.
        edit: Called with what changes the cell.
        add: Called with the kind of a new obstacle, and the client that asks for it.
        download: Called with the client that is to get the scene as a file.

    Attributes:
        note: A text about what was done, or could not be.
    """

    def __init__(
        self,
        gui: Any,
        edit: Callable[[Edit], None],
        add: Callable[[str, Any], None],
        download: Callable[[Any], None],
    ) -> None:
        self._gui, self._edit = gui, edit
        self._typed: Any = None
        gui.add_markdown(HINT)
        self._names = gui.add_dropdown("obstacle", ("",))
        adding = gui.add_button_group("add", tuple(NEW))
        self._fields = gui.add_folder("selected", visible=False)
        with self._fields:
            self._add_fields()
        self._undo = gui.add_button("undo", visible=False)
        self.note = gui.add_markdown("")
        adding.on_click(lambda event: add(event.target.value, event.client))
        self._names.on_update(self._by_user(lambda: edit(lambda cell: cell.select(self._names.value or None))))
        self._undo.on_click(lambda _: edit(Cell.undone))
        self._download = gui.add_button("download scene", hint="a TOML file, saved by the browser")
        self._download.on_click(lambda event: download(event.client))

    def _add_fields(self) -> None:
        gui = self._gui
        self._name = gui.add_text("name", "")
        self._colour = gui.add_rgb("colour", (0, 0, 0))
        self._size = gui.add_vector3("size (m)", (0.1, 0.1, 0.1), step=0.001)
        self._radius = gui.add_number("radius (m)", 0.1, step=0.001)
        self._length = gui.add_number("length (m)", 0.1, step=0.001)
        self._position = gui.add_vector3("position (m)", (0.0, 0.0, 0.0), step=0.001)
        self._turn = gui.add_vector3(
            "turn (deg)", (0.0, 0.0, 0.0), step=1.0, hint="about x, then y, then z of the base"
        )
        doing = gui.add_button_group("do", ("set down", "copy", "delete"))
        acts = {"set down": Cell.set_down, "copy": Cell.copied, "delete": Cell.deleted}
        doing.on_click(lambda event: self._edit(acts[event.target.value]))
        self._when_set(self._name, lambda cell: cell.renamed(self._name.value))
        self._when_set(self._colour, lambda cell: cell.coloured("#{:02x}{:02x}{:02x}".format(*self._colour.value)))
        self._when_set(self._size, lambda cell: cell.shaped(self._size.value))
        for number in (self._radius, self._length):
            self._when_set(number, lambda cell: cell.shaped(self._round_sizes(cell)))
        for vector in (self._position, self._turn):
            self._when_set(vector, lambda cell: cell.moved(self._pose(cell)))

    def _when_set(self, field: Any, change: Edit) -> None:
        """Edit the cell when a field is set, and leave the field as it is being typed."""

        def typed(cell: Cell) -> Cell:
            changed = change(cell)
            self._typed = field
            return changed

        field.on_update(self._by_user(partial(self._edit, typed)))

    @staticmethod
    def _by_user(act: Callable[[], None]) -> Callable[[Any], None]:
        return lambda event: act() if event.client is not None else None

    def _round_sizes(self, cell: Cell) -> tuple[float, ...]:
        radius = float(self._radius.value)
        return (radius,) if isinstance(cell.obstacle and cell.obstacle.shape, Sphere) else (radius, self._length.value)

    def _pose(self, cell: Cell) -> Pose:
        """As the fields say; the turn is left exactly as it is where its field says the same, rounded."""
        x, y, z = self._position.value
        before = Pose() if cell.obstacle is None else cell.obstacle.pose
        same = tuple(self._turn.value) == turn_of(before)
        return Pose((float(x), float(y), float(z)), (before if same else turned(self._turn.value)).quaternion)

    def show(self, cell: Cell, colour: tuple[int, int, int]) -> None:
        """Show the cell; fields whose values say the same already are left as they are typed.

        Args:
            colour: What the selected obstacle is drawn in.
        """
        names = ("", *(obstacle.name for obstacle in cell.scene.obstacles[:MAX_NAMES]))
        if cell.selected is not None and cell.selected not in names:
            names = (*names, cell.selected)
        if tuple(self._names.options) != names:
            self._names.options = names
        update(self._names, value=cell.selected or "")
        update(self._undo, visible=bool(cell.before))
        obstacle = cell.obstacle
        update(self._fields, visible=obstacle is not None)
        if obstacle is not None:
            self._show_fields(obstacle, colour)
        self._typed = None

    def _set(self, field: Any, value: Any) -> None:
        """Show a value, unless it comes from there: more of it may have been typed by now."""
        if field is not self._typed:
            update(field, value=value)

    def _show_fields(self, obstacle: Obstacle, colour: tuple[int, int, int]) -> None:
        shape, pose = obstacle.shape, obstacle.pose
        self._set(self._name, obstacle.name)
        self._set(self._colour, colour)
        update(self._size, visible=isinstance(shape, Box))
        update(self._radius, visible=isinstance(shape, Sphere | Cylinder | Capsule))
        update(self._length, visible=isinstance(shape, Cylinder | Capsule))
        if isinstance(shape, Box):
            self._set(self._size, shape.size)
        if isinstance(shape, Sphere | Cylinder | Capsule):
            self._set(self._radius, shape.radius)
        if isinstance(shape, Cylinder | Capsule):
            self._set(self._length, shape.length)
        self._set(self._position, pose.position)
        if turned(self._turn.value).quaternion != pose.quaternion:
            self._set(self._turn, turn_of(pose))


class FileControls:
    """A list of files to load obstacles from, and a name to save the scene under.

    Args:
        gui: viser's controls.
        folder: The folder that files are read from and written to.
        name: Of the scene's file, as it is suggested.
        load: Called with the name of a file, and its unit.
        save: Called with the name of a file.
    """

    def __init__(
        self,
        gui: Any,
        folder: CellFolder,
        name: str,
        load: Callable[[str, str], None],
        save: Callable[[str], None],
    ) -> None:
        self._folder = folder
        self._files = gui.add_dropdown("file", ("", *folder.files()))
        self._unit = gui.add_dropdown("unit", tuple(UNITS), hint="of a mesh or a cloud; scenes are in metres")
        self._load = gui.add_button("load", hint="adds the obstacles in the file")
        self._name = gui.add_text("save as", name)
        self._save = gui.add_button("save")
        self._load.on_click(lambda _: load(self._files.value, self._unit.value))
        self._save.on_click(lambda _: save(self._name.value))

    def begin(self) -> None:
        """A file is being read."""
        self._load.label, self._load.disabled = "loading ...", True

    def end(self) -> None:
        """It was read, or not."""
        self._load.label, self._load.disabled = "load", False

    def list_files(self) -> None:
        """List the files anew."""
        files = ("", *self._folder.files())
        if tuple(self._files.options) != files:
            self._files.options = files


def turned(degrees: tuple[float, float, float]) -> Pose:
    """A turn about x, then y, then z of the base frame, by degrees each."""
    pose = Pose()
    for axis, angle in enumerate(degrees):
        half = math.radians(math.remainder(float(angle), 720.0)) / 2.0
        quaternion = [math.cos(half), 0.0, 0.0, 0.0]
        quaternion[1 + axis] = math.sin(half)
        w, i, j, k = quaternion
        pose = Pose(quaternion=(w, i, j, k)) @ pose
    return pose


def turn_of(pose: Pose) -> tuple[float, float, float]:
    """The degrees by which ``turned`` makes the rotation of a pose, to a thousandth."""
    (r00, _, _), (r10, _, _), (r20, r21, r22) = pose.rotation_rows
    flat = math.hypot(r00, r10)
    if flat > 1e-9:
        angles = (math.atan2(r21, r22), math.atan2(-r20, flat), math.atan2(r10, r00))
    else:  # x and z turn about the same line: all of it is given to x
        _, (_, r11, r12), _ = pose.rotation_rows
        angles = (math.atan2(-r12, r11), math.atan2(-r20, flat), 0.0)
    x, y, z = (round(math.degrees(angle), 3) + 0.0 for angle in angles)
    return x, y, z
