"""Worlds in MoveIt's text format, ``.scene``, both versions of it.

::

    (noname)+          the name of the scene: the whole first line
    * table            an object; the rest of the line is its name
    0.5 0 0.1          newer version only: where the object is, position
    0 0 0 1            and quaternion, x y z w
    1                  so many shapes follow
    box                box x y z (full lengths), sphere radius, cylinder radius length, cone, plane or mesh
    0.4 0.6 0.2
    0 0 0              where the shape is: in the object's frame, in the older version in the world's
    0 0 0 1
    0 0 0 0            its colour: red, green, blue, alpha
    1                  newer version only: so many subframes follow, each a name and a pose
    corner
    0.2 0.3 0.1
    0 0 0 1
    .                  the end

A cone has a radius and a length, its tip at +z and its origin half way; a plane a, b, c and d, for the points where
``a x + b y + c z + d = 0``; a mesh the numbers of its vertices and triangles, then x y z of each vertex and three
vertices, numbered from 0, of each triangle.

Below an object's name a line end is no more than a space. The line after the first object's name tells the version:
the older has the number of shapes there, one word. The grammar is that of ``saveGeometryToStream`` and
``loadGeometryFromStream`` in MoveIt's PlanningScene, and of ``saveAsText`` in its geometric_shapes.
"""

from __future__ import annotations

import math
import os
import reprlib
from pathlib import Path

import numpy as np

from planner_service.errors import InvalidFile
from planner_service.files.reading import as_path, read_bytes
from planner_service.geometry.around import Plane, around_cone
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Pose, Shape, Sphere
from planner_service.scene.obstacle_list import ObstacleList
from planner_service.scene.scene import Scene

__all__ = ["read_moveit_scene"]

MAX_BYTES = 5_000_000
"""As of our own scene files: 10,000 boxes take about 1 MB."""

MAX_LINE = 10_000
"""Characters. MoveIt writes at most four numbers, or a name, in a line."""

UNNAMED = "(noname)"
"""What MoveIt calls a scene that was given no name; each copy of a scene adds a +."""

_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4}
_KINDS = ", ".join((*_SIZES, "mesh"))


def read_moveit_scene(path: str | os.PathLike[str]) -> Scene:
    """The obstacles of a MoveIt ``.scene`` file, in the file's order.

    Poses are taken as they stand: MoveIt's planning frame has to be the robot's base frame. An object of several
    shapes becomes the obstacles ``name``, ``name#2``, ...; colours and subframes are left out.

    What is not a solid of ours becomes one that holds it: a mesh its convex hull; a cone a pyramid of 64 sides around
    it; a plane, which has no inside, a box below it, 200 m x 200 m x 10 m: its top lies in the plane, the rest on the
    side to which the normal (a, b, c) does not point, and its middle where the plane is nearest to the robot's base.

    Raises:
        InvalidFile: with the problems found, up to where there are too many, each with its line: a shape of another
            kind, a plane without a normal, a flat mesh or one whose triangles have other vertices, a size that is not
            positive, a quaternion that is not of unit length, a name that is taken, words that do not belong where they
            are, a missing end.
    """
    path = as_path("path", path)
    reader = _Reader(_lines(path))
    reader.read()
    return reader.found.scene(path, reader.name)


def _lines(path: Path) -> list[str]:
    data = read_bytes(path, MAX_BYTES)
    try:
        lines = data.decode("utf-8-sig").split("\n")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InvalidFile(path, [f"line {line}: not UTF-8: byte {data[error.start]:#04x}"]) from None
    long = [f"line {k}: longer than {MAX_LINE:,} characters" for k, line in enumerate(lines, 1) if len(line) > MAX_LINE]
    if long:
        raise InvalidFile(path, long)
    return lines


class _Torn(Exception):
    """What follows is unclear after a broken entry: reading goes on at the next object."""


class _Words:
    """The words of a file one by one; ``line`` is the number of the line that the last one stands in."""

    def __init__(self, lines: list[str]) -> None:
        self._lines = lines
        self._left: list[str] = []
        self.line = 0

    def take(self, expected: str) -> str:
        """The next word."""
        if not self.has_more():
            raise _Torn(f"line {self.line}: the file ends; expected {expected}")
        return self._left.pop()

    def rest_of_line(self) -> str:
        """The words left in this line, as they stand."""
        rest = self._lines[self.line - 1].strip().partition("*")[2].strip()
        self._left = []
        return rest

    def first_line(self) -> str:
        """The first line as it is."""
        self.line = 1
        return self._lines[0].strip()

    def has_more(self) -> bool:
        """Whether a word is left; if so it is the next."""
        while not self._left and self.line < len(self._lines):
            self.line += 1
            self._left = self._lines[self.line - 1].split()[::-1]
        return bool(self._left)

    def skip_to_object(self, header: int) -> bool:
        """Go to the next object after the one in line ``header``; False if there is none."""
        for k in range(max(self.line, header + 1), len(self._lines) + 1):
            words = self._lines[k - 1].split()
            if words[:1] == ["*"]:
                self.line, self._left = k, words[::-1]
                return True
        return False

    def newer(self) -> bool:
        """Whether the line below the first object's name holds more than one word."""
        for k, line in enumerate(self._lines[1:-1], 1):
            if line.split()[:1] == ["*"]:
                return len(self._lines[k + 1].split()) > 1
        return False


class _Reader:
    def __init__(self, lines: list[str]) -> None:
        self.words = _Words(lines)
        self.found = ObstacleList()
        self.newer = self.words.newer()
        self.header = 1
        self.where = ""
        self.name = ""

    def read(self) -> None:
        """Read everything, and note what is wrong."""
        name = self.words.first_line()
        self.name = "" if name.rstrip("+") == UNNAMED else name
        self.found.attempt("line 1", lambda: Scene(name=self.name))
        going = True
        while going and not self.found.hopeless:
            try:
                going = self.entry()
            except _Torn as torn:
                self.found.problems.append(str(torn))
                going = self.words.skip_to_object(self.header)

    def entry(self) -> bool:
        """Read an object, or the end: then False."""
        expected = "* before an object, or . at the end"
        word = self.words.take(expected)
        if word == "*":
            self.object()
        elif word != ".":
            raise _Torn(f"line {self.words.line}: got {reprlib.repr(word)}; expected {expected}")
        elif self.words.has_more():
            self.found.problems.append(f"line {self.words.line}: words after the end; expected nothing")
        return word == "*"

    def object(self) -> None:
        self.header = self.words.line
        name = self.words.rest_of_line()
        self.where = f"object {reprlib.repr(name)}"
        stands = self.pose("object") if self.newer else Pose()
        for k in range(self.count("shapes")):
            if self.found.hopeless:
                return
            shape = self.shape()
            where = self.at()
            pose = self.pose("shape")
            self.numbers(4, "colour")
            place = None if stands is None or pose is None else stands @ pose
            if isinstance(shape, Plane):
                shape, place = shape.below(place)
            self.found.add(where, name if k == 0 else f"{name}#{k + 1}", shape, place)
        for _ in range(self.count("subframes") if self.newer else 0):
            if self.found.hopeless:
                return
            self.words.take("the name of a subframe")
            self.pose("subframe")

    def shape(self) -> Shape | Plane | None:
        kind = self.words.take(_KINDS)
        where = self.at()
        if kind == "mesh":
            corners = self.mesh()
            return self.found.attempt(where, lambda: Mesh(np.array(corners)))
        if kind not in _SIZES:
            raise _Torn(f"{where}: got {reprlib.repr(kind)}; expected {_KINDS}")
        sizes = self.numbers(_SIZES[kind], kind)
        return self.found.attempt(self.at(), lambda: _shape(kind, sizes))

    def mesh(self) -> list[list[float]]:
        """The vertices of a mesh; its triangles are read only to see that none is missing."""
        count, triangles = self.count("vertices"), self.count("triangles")
        vertices = [self.numbers(3, "vertex") for _ in range(count)]
        for _ in range(3 * triangles):
            if self.count("a vertex") >= count:
                raise _Torn(f"{self.at()}: a triangle of a vertex that is not there; expected 0 to {count - 1}")
        return vertices

    def pose(self, whose: str) -> Pose | None:
        x, y, z = self.numbers(3, f"position of the {whose}")
        qx, qy, qz, qw = self.numbers(4, f"quaternion of the {whose}")
        return self.found.attempt(self.at(), lambda: Pose((x, y, z), (qw, qx, qy, qz)))

    def numbers(self, count: int, what: str) -> list[float]:
        expected = f"{what}: {count} finite number{'s' if count > 1 else ''}"
        return [self.number(self.words.take(f"{expected} ({self.where})"), expected) for _ in range(count)]

    def number(self, word: str, expected: str) -> float:
        try:
            value = float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise _Torn(f"{self.at()}: got {reprlib.repr(word)}; expected {expected}")
        return value

    def count(self, what: str) -> int:
        expected = f"the number of {what}"
        word = self.words.take(f"{expected} ({self.where})")
        if not (word.isascii() and word.isdecimal() and len(word) <= 9):
            raise _Torn(f"{self.at()}: got {reprlib.repr(word)}; expected {expected}")
        return int(word)

    def at(self) -> str:
        return f"line {self.words.line}, {self.where}"


def _shape(kind: str, sizes: list[float]) -> Shape | Plane:
    if kind == "box":
        return Box((sizes[0], sizes[1], sizes[2]))
    if kind == "sphere":
        return Sphere(sizes[0])
    if kind == "plane":
        return Plane.of(*sizes)
    return around_cone(*sizes) if kind == "cone" else Cylinder(*sizes)
