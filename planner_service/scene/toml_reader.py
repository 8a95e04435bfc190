"""TOML files of shapes and poses: read with all their problems told at once, written whole or not at all."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from typing import Any, TypeVar

from planner_service.errors import InvalidRequest
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import MeshShelf
from planner_service.geometry.shapes import MAX_LENGTH, Box, Capsule, Cylinder, Pose, Shape, Sphere

__all__ = [
    "MAX_BYTES",
    "SHAPE_KEYS",
    "Table",
    "pose_texts",
    "shape_key",
    "shape_text",
]

T = TypeVar("T")

MAX_BYTES = 5_000_000
"""A scene of 10,000 obstacles takes about 2 MB; a larger file is no scene."""

CONVEX_KEYS = ("box", "sphere", "cylinder", "capsule", "mesh")
"""Shapes that a compound may have, one of them per table."""

SHAPE_KEYS = (*CONVEX_KEYS, "cloud", "heights", "compound")
"""What ``Table.solid`` reads, one of them per table."""

POSE_KEYS = ("position", "quaternion_wxyz")

MAX_PROBLEMS = 1_000
"""Of a file, told one by one."""

MAX_HINTS = 100
"""Spelling hints per file: finding one takes far longer than naming the problem."""


class Table:
    """A TOML table read key by key; what is wrong goes to ``problems``, and None comes back in its place.

    Args:
        where: How problems begin, such as ``obstacle 3 'post'``; empty for the top of the file.
        problems: The list that all tables of a file share.
        shelf: Where meshes are read from.
    """

    def __init__(self, where: str, content: dict[str, Any], problems: list[str], shelf: MeshShelf) -> None:
        self.where = where
        self.content = content
        self._problems = problems
        self._shelf = shelf

    def inner(self, where: str, content: dict[str, Any]) -> Table:
        """A table of the same file."""
        return Table(where, content, self._problems, self._shelf)

    def problem(self, text: str) -> None:
        """Note one problem of this table; those after the first ``MAX_PROBLEMS`` are not told one by one."""
        if len(self._problems) < MAX_PROBLEMS:
            self._problems.append(f"{self.where}: {text}" if self.where else text)
        elif len(self._problems) == MAX_PROBLEMS:
            self._problems.append("and more")

    def attempt(self, make: Callable[[], T]) -> T | None:
        """What ``make`` returns, or None if it refuses: its reason becomes a problem."""
        try:
            return make()
        except InvalidRequest as error:
            self.problem(str(error))
            return None

    def allow_only(self, keys: Iterable[str]) -> None:
        """Note every other key, with the nearest one that is allowed."""
        allowed = tuple(keys)
        for key in self.content:
            if key in allowed:
                continue
            near = get_close_matches(key, allowed, n=1) if len(self._problems) < MAX_HINTS else []
            hint = f"did you mean {near[0]!r}?" if near else f"allowed: {', '.join(allowed)}"
            self.problem(f"unknown key {reprlib.repr(key)}; {hint}")

    def text(self, key: str) -> str | None:
        """The text under ``key``, or None if the key is missing (no problem) or holds something else (one)."""
        value = self.content.get(key)
        if value is None or isinstance(value, str):
            return value
        self.problem(f"{key}: got {_shown(value)}; expected a text")
        return None

    def texts(self, key: str) -> tuple[str, ...]:
        """The texts under ``key``; none if the key is missing."""
        value = self.content.get(key, [])
        if isinstance(value, list) and all(isinstance(item, str) for item in value):
            return tuple(value)
        self.problem(f"{key}: got {_shown(value)}; expected a list of texts")
        return ()

    def tables(self, key: str) -> list[dict[str, Any]]:
        """The array of tables under ``key``; empty if the key is missing."""
        value = self.content.get(key, [])
        if isinstance(value, list) and all(isinstance(item, dict) for item in value):
            return value
        self.problem(f"{key}: got {_shown(value)}; expected tables, each headed [[{key}]]")
        return []

    def solid(self) -> Solid | None:
        """The one shape among the table's keys."""
        shapes = [self._solid(key) for key in self._keys(SHAPE_KEYS)]  # of two, both are read, for their own problems
        return shapes[0] if len(shapes) == 1 else None

    def _solid(self, key: str) -> Solid | None:
        if key == "cloud":
            return self._cloud()
        if key == "heights":
            return self._heights()
        if key == "mesh" and isinstance(self.content[key], dict) and "pieces" in self.content[key]:
            return self._cut()
        return self._compound() if key == "compound" else self._shape(key)

    def _keys(self, among: Sequence[str]) -> list[str]:
        """The keys of shapes in the table, which should be one."""
        keys = [key for key in among if key in self.content]
        if len(keys) != 1:
            found = f"two or more shapes, {' and '.join(keys)}" if keys else "shape is missing"
            self.problem(f"{found}; expected exactly one of {', '.join(among)}")
        return keys

    def pose(self) -> Pose | None:
        """The pose of ``position``, which must be there, and ``quaternion_wxyz``, which need not."""
        position = self._numbers("position", "xyz", self._number)
        quaternion: list[float] | None = [1.0, 0.0, 0.0, 0.0]
        if "quaternion_wxyz" in self.content:
            quaternion = self._numbers("quaternion_wxyz", "wxyz", self._number)
        if quaternion is None:
            return None
        w, x, y, z = quaternion
        norm = math.sqrt(w * w + x * x + y * y + z * z)
        try:
            turned = Pose(quaternion=(w, x, y, z))
        except InvalidRequest:
            self.problem(f"quaternion_wxyz: got {quaternion}; expected a unit quaternion, but its norm is {norm:.6g}")
            return None
        return None if position is None else Pose((position[0], position[1], position[2]), turned.quaternion)

    def _shape(self, key: str) -> Shape | None:
        value = self.content[key]
        if key == "box":
            size = self._numbers(key, "xyz", self._positive)
            return None if size is None else Box((size[0], size[1], size[2]))
        if key == "sphere":
            radius = self._positive(key, value)
            return None if radius is None else Sphere(radius)
        if key == "mesh":
            return self._mesh(value)
        if not isinstance(value, dict):
            self.problem(f"{key}: got {_shown(value)}; expected {{ radius = ..., length = ... }}")
            return None
        inner = self.inner(f"{self.where}: {key}", value)
        inner.allow_only(("radius", "length"))
        radius, length = inner._length("radius"), inner._length("length")
        if radius is None or length is None:
            return None
        return Cylinder(radius, length) if key == "cylinder" else Capsule(radius, length)

    def _mesh(self, value: Any) -> Mesh | None:
        """A hull by the name of a file, or by the points in the file at hand."""
        inner = self._mesh_table(value)
        if inner is None:
            return None
        if "vertices" in inner.content:
            inner.allow_only(("vertices",))
            return inner.attempt(lambda: Mesh(inner.content["vertices"]))
        inner.allow_only(("file", "scale"))
        name, scale = inner.text("file"), inner.content.get("scale", [1.0, 1.0, 1.0])
        return None if name is None else inner.attempt(lambda: self._shelf.mesh(name, scale))

    def _cut(self) -> Compound | None:
        """The convex pieces of a mesh file."""
        inner = self._mesh_table(self.content["mesh"])
        if inner is None:
            return None
        inner.allow_only(("file", "scale", "pieces"))
        name, scale, most = inner.text("file"), inner.content.get("scale", [1.0, 1.0, 1.0]), inner.content["pieces"]
        if name is None:
            return None
        return inner.attempt(lambda: Compound.of_pieces(self._shelf.pieces(name, scale, most)))

    def _mesh_table(self, value: Any) -> Table | None:
        table = {"file": value} if isinstance(value, str) else value
        if not isinstance(table, dict) or ("file" in table) == ("vertices" in table):
            expected = '"file.stl", { file = "file.stl", scale = [x, y, z] } or { vertices = [[x, y, z], ...] }'
            self.problem(f"mesh: got {_shown(value)}; expected {expected}")
            return None
        return self.inner(f"{self.where}: mesh" if self.where else "mesh", table)

    def _cloud(self) -> PointCloud | None:
        """A cloud by the name of a file, or by its cells."""
        inner = self._described("cloud", ("file", "cells"), "resolution", ("resolution",))
        if inner is None:
            return None
        cell = inner._length("resolution")
        if cell is None:
            return None
        if "cells" in inner.content:
            return inner.attempt(lambda: PointCloud.from_cells(inner.content["cells"], cell))
        name = inner.text("file")
        return None if name is None else inner.attempt(lambda: self._shelf.cloud(name, cell))

    def _heights(self) -> HeightField | None:
        """A height field by the name of a file, or by its numbers."""
        inner = self._described("heights", ("file", "values"), "cell", ("cell", "floor"))
        if inner is None:
            return None
        cell, floor = inner._length("cell"), inner._number("floor", inner.content.get("floor", 0.0))
        if cell is None or floor is None:
            return None
        if "values" in inner.content:
            return inner.attempt(lambda: HeightField(inner.content["values"], cell, floor))
        name = inner.text("file")
        return None if name is None else inner.attempt(lambda: self._shelf.heights(name, cell, floor))

    def _described(self, key: str, sources: tuple[str, str], size: str, rest: tuple[str, ...]) -> Table | None:
        """The table under ``key``, of what comes from one of two sources and has a size."""
        value = self.content[key]
        if not isinstance(value, dict) or (sources[0] in value) == (sources[1] in value):
            expected = f"{{ {sources[0]} = ..., {size} = ... }} or {{ {sources[1]} = [...], {size} = ... }}"
            self.problem(f"{key}: got {_shown(value)}; expected {expected}")
            return None
        inner = self.inner(f"{self.where}: {key}" if self.where else key, value)
        inner.allow_only((*sources, *rest))
        return inner

    def _compound(self) -> Compound | None:
        value = self.content["compound"]
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            self.problem(f"compound: got {_shown(value)}; expected [{{ box = [...], position = [...] }}, ...]")
            return None
        parts = []
        for k, item in enumerate(value, 1):
            inner = self.inner(f"{self.where}: compound {k}" if self.where else f"compound {k}", item)
            inner.allow_only((*CONVEX_KEYS, *POSE_KEYS))
            shapes, pose = [inner._shape(key) for key in inner._keys(CONVEX_KEYS)], inner.pose()
            parts += [(shape, pose) for shape in shapes[:1] if shape is not None and pose is not None]
        return self.attempt(lambda: Compound(tuple(parts))) if len(parts) == len(value) else None

    def _length(self, key: str) -> float | None:
        if key in self.content:
            return self._positive(key, self.content[key])
        self.problem(f"{key} is missing; expected a length in metres")
        return None

    def _numbers(self, key: str, axes: str, read: Callable[[str, Any], float | None]) -> list[float] | None:
        if key not in self.content:
            self.problem(f"{key} is missing; expected [{', '.join(axes)}]")
            return None
        value = self.content[key]
        if not isinstance(value, list) or len(value) != len(axes):
            self.problem(f"{key}: got {_shown(value)}; expected [{', '.join(axes)}]")
            return None
        found = [read(f"{key} {axis}", item) for axis, item in zip(axes, value, strict=True)]
        numbers = [number for number in found if number is not None]
        return numbers if len(numbers) == len(axes) else None

    def _number(self, label: str, value: Any) -> float | None:
        if _is_number(value) and -MAX_LENGTH <= value <= MAX_LENGTH:
            return float(value)
        self.problem(f"{label}: got {_shown(value)}; expected a number from -{MAX_LENGTH:g} to {MAX_LENGTH:g}")
        return None

    def _positive(self, label: str, value: Any) -> float | None:
        if _is_number(value) and 0 < value <= MAX_LENGTH:
            return float(value)
        self.problem(f"{label}: got {_shown(value)}; expected a positive length up to {MAX_LENGTH:g} m")
        return None


def shape_key(shape: Solid) -> str:
    """Under which key a file has a shape."""
    return _KEYS.get(type(shape).__name__, type(shape).__name__.lower())


_KEYS = {"PointCloud": "cloud", "HeightField": "heights"}


def shape_text(shape: Solid) -> str:
    """A shape as TOML, read again as an equal one."""
    if isinstance(shape, Box):
        return repr(list(shape.size))
    if isinstance(shape, Sphere):
        return repr(shape.radius)
    if isinstance(shape, Mesh):
        return f"{{ vertices = {shape.vertices.tolist()!r} }}"
    if isinstance(shape, PointCloud):
        return f"{{ resolution = {shape.resolution!r}, cells = {shape.cells.tolist()!r} }}"
    if isinstance(shape, HeightField):
        return f"{{ cell = {shape.cell!r}, floor = {shape.floor!r}, values = {shape.heights.tolist()!r} }}"
    if isinstance(shape, Compound):
        parts = [
            ", ".join([f"{shape_key(part)} = {shape_text(part)}", *pose_texts(pose)]) for part, pose in shape.parts
        ]
        return f"[{', '.join(f'{{ {part} }}' for part in parts)}]"
    return f"{{ {', '.join(f'{key} = {float(value)!r}' for key, value in vars(shape).items())} }}"


def pose_texts(pose: Pose) -> list[str]:
    """The lines of a pose; a turn by nothing is left out."""
    lines = [f"position = {list(pose.position)!r}"]
    if pose.quaternion != (1.0, 0.0, 0.0, 0.0):
        lines.append(f"quaternion_wxyz = {list(pose.quaternion)!r}")
    return lines


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    try:
        return reprlib.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "an integer of thousands of digits"
