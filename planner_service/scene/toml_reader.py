"""Scene files: what each key of a scene's TOML file is, declared once for reading and for writing."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, model_validator

from planner_service.constraints.toml_reader import Table as ConstraintTable
from planner_service.constraints.toml_reader import keys_of
from planner_service.constraints.values import MAX_CONSTRAINTS
from planner_service.errors import InvalidRequest
from planner_service.files.schema import FirstOnly, Reading, Record, at_most, of_length, read_record
from planner_service.files.toml_reader import read_tables, toml_value
from planner_service.files.writing import write_whole
from planner_service.geometry.composite import MAX_COMPOUND, Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.mesh_paths import MeshLoader
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.geometry.validation import MAX_LENGTH, checked_name
from planner_service.scene.scene import MAX_OBJECTS, Attached, Obstacle, Scene, checked_colour, checked_description

__all__ = ["MAX_BYTES", "read_scene", "scene_file_text", "write_scene"]

MAX_BYTES = 5_000_000
"""A scene of 10,000 obstacles takes about 2 MB; a larger file is no scene."""

OURS = re.compile(rb"(?:\s|#[^\n]*\n|(?:name|description)[ \t]*=[^\n]*\n)*(?:\[\[(?:obstacle|attached)\]\]|\Z)")
"""How scene files begin."""

CONVEX_KEYS = ("box", "sphere", "cylinder", "capsule", "mesh")
"""Shapes that a part of a compound may have, one of them per table."""

SHAPE_KEYS = (*CONVEX_KEYS, "cloud", "heights", "compound")
"""Shapes that an obstacle may have, one of them per table."""


def read_scene(path: Path) -> Scene:
    """The scene in a TOML file.

    Raises:
        InvalidFile: the file cannot be used; it lists all problems found, not the first.
    """
    document = read_tables(path, MAX_BYTES)
    reading = _SceneReading(meshes=MeshLoader((path.resolve().parent,)))
    scene: Scene = read_record(SceneFile, document, path, reading).value
    return scene


def write_scene(scene: Scene, path: Path) -> None:
    """Write a scene to a TOML file that ``read_scene`` gives back bit for bit, whole or not at all.

    Raises:
        InvalidRequest: the file would be too large to be read again.
        InvalidFile: it cannot be written.
    """
    write_whole(path, scene_file_text(scene), OURS)


def scene_file_text(scene: Scene) -> str:
    """What ``write_scene`` writes.

    Raises:
        InvalidRequest: the file would be too large to be read again.
    """
    content = "\n\n".join(_paragraphs(SceneFile.of(scene).model_dump(exclude_unset=True, by_alias=True))) + "\n"
    if len(content.encode()) > MAX_BYTES:
        raise InvalidRequest("scene", f"{len(content.encode()):,} bytes", f"a scene that fits in {MAX_BYTES:,} bytes")
    return content


def _paragraphs(document: dict[str, Any]) -> Iterator[str]:
    """The keys at the top of a scene file, then its tables one by one."""
    top = {key: value for key, value in document.items() if key not in ("obstacle", "attached")}
    if top:
        yield _lines(top)
    for kind in ("obstacle", "attached"):
        for table in document[kind]:
            yield f"[[{kind}]]\n{_lines(table)}"


def _lines(table: dict[str, Any]) -> str:
    return "\n".join(f"{key} = {toml_value(value)}" for key, value in table.items())


@dataclass
class _SceneReading(Reading):
    """What is known while a scene file is read: where meshes and clouds are read from."""

    meshes: MeshLoader | None = None


# How values are written, for messages.

XYZ, WXYZ = "[x, y, z]", "[w, x, y, z]"
CONSTRAINTS = '[{ kind = "tool region", ... }, ...]'
PARTS = "[{ box = [...], position = [...] }, ...]"
ROUND = "{ radius = ..., length = ... }"
MESH = '"file.stl", { file = "file.stl", scale = [x, y, z] } or { vertices = [[x, y, z], ...] }'
CLOUD = "{ file = ..., resolution = ..., scale = ... } or { cells = [...], resolution = ... }"
HEIGHTS = "{ file = ..., cell = ... } or { values = [...], cell = ... }"


# Kinds of values.


def _checked_length(value: float) -> float:
    if not 0.0 < value <= MAX_LENGTH:
        raise ValueError(f"a positive length up to {MAX_LENGTH:g} m")
    return value


def _checked_coordinate(value: float) -> float:
    if not -MAX_LENGTH <= value <= MAX_LENGTH:
        raise ValueError(f"a number from -{MAX_LENGTH:g} to {MAX_LENGTH:g}")
    return value


def _unit_quaternion(values: list[float]) -> list[float]:
    w, x, y, z = values
    try:
        Pose(quaternion=(w, x, y, z))
    except InvalidRequest:
        raise ValueError(f"a unit quaternion, but its norm is {math.hypot(*values):.6g}") from None
    return values


Length = Annotated[float, AfterValidator(_checked_length)]
Coordinate = Annotated[float, AfterValidator(_checked_coordinate)]
Size = Annotated[list[Length], of_length(3, XYZ)]
Position = Annotated[list[Coordinate], of_length(3, XYZ), Field(description=XYZ)]
Quaternion = Annotated[list[float], of_length(4, WXYZ), AfterValidator(_unit_quaternion)]
Name = Annotated[str, AfterValidator(lambda name: checked_name("name", name)), Field(description="a text")]
Edge = Annotated[float, Field(description="a length in metres")]
Metres = Annotated[Length, Field(description="a length in metres")]


# Tables.


class RoundTable(Record):
    """``cylinder = { radius = ..., length = ... }``, and a capsule."""

    radius: Metres
    length: Metres


class FileTable(Record):
    """What is read from a file in the scene's folder."""

    _meshes: MeshLoader = PrivateAttr(MeshLoader(()))

    def model_post_init(self, context: Any) -> None:
        if isinstance(context, _SceneReading) and context.meshes is not None:
            self._meshes = context.meshes


class HullTable(FileTable):
    """``mesh = { file = "file.stl", scale = [...] }`` or ``{ vertices = [[x, y, z], ...] }``: a convex hull."""

    file: str | None = None
    scale: list[Any] = Field([1.0, 1.0, 1.0])
    vertices: Any = None

    @cached_property
    def value(self) -> Any:
        self._require_one_source()
        return Mesh(self.vertices) if self.file is None else self._meshes.mesh(self.file, self.scale)

    def _require_one_source(self) -> None:
        keys = self.model_fields_set
        if ("file" in keys) == ("vertices" in keys) or ("vertices" in keys and len(keys) > 1):
            raise ValueError(MESH)


class MeshTable(HullTable):
    """As ``HullTable``; with ``pieces`` a mesh that is cut into at most so many convex ones."""

    pieces: int | None = None

    @cached_property
    def value(self) -> Any:
        self._require_one_source()
        if self.file is None or self.pieces is None:
            return super().value
        return Compound.of_pieces(self._meshes.pieces(self.file, self.scale, self.pieces))


class CloudTable(FileTable):
    """``cloud = { file = "scan.ply", resolution = ..., scale = ... }`` or ``{ cells = [[i, j, k], ...],
    resolution = ... }``; ``PointCloud.from_file`` says what a file is read with if it is named alone.
    """

    resolution: Edge | None = None
    scale: float = 1.0
    file: str | None = None
    cells: Any = None

    @cached_property
    def value(self) -> PointCloud:
        if self.file is not None and self.cells is None:
            return self._meshes.cloud(self.file, self.resolution, self.scale)
        if self.file is not None or self.cells is None or self.resolution is None or "scale" in self.model_fields_set:
            raise ValueError(CLOUD)
        return PointCloud.from_cells(self.cells, self.resolution)


class HeightsTable(FileTable):
    """``heights = { file = "ground.npy", cell = ... }`` or ``{ values = [[z, ...], ...], cell = ... }``."""

    cell: Edge
    floor: float = 0.0
    file: str | None = None
    values: Any = None

    @cached_property
    def value(self) -> HeightField:
        if (self.file is None) == (self.values is None):
            raise ValueError(HEIGHTS)
        if self.file is not None:
            return self._meshes.heights(self.file, self.cell, self.floor)
        return HeightField(self.values, self.cell, self.floor)


_ROUND: Mapping[str, Callable[[float, float], Shape]] = {"cylinder": Cylinder, "capsule": Capsule}


def _tables(expected: str) -> BeforeValidator:
    """For a list of tables; ``expected`` says how it is written."""

    def checked(value: Any) -> Any:
        if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
            raise ValueError(expected)
        return value

    return BeforeValidator(checked)


def _as_table(mesh: Any) -> Any:
    """``mesh = "file.stl"`` is short for ``mesh = { file = "file.stl" }``."""
    return {"file": mesh} if isinstance(mesh, str) else mesh


class PartTable(Record):
    """A convex shape at a pose: one part of a compound."""

    box: Size | None = Field(None, description=XYZ)
    sphere: Length | None = None
    cylinder: RoundTable | None = Field(None, description=ROUND)
    capsule: RoundTable | None = Field(None, description=ROUND)
    mesh: Annotated[HullTable | None, BeforeValidator(_as_table)] = Field(None, description=MESH)
    position: Position
    quaternion_wxyz: Quaternion = Field([1.0, 0.0, 0.0, 0.0], description=WXYZ)

    @cached_property
    def value(self) -> tuple[Shape, Pose]:
        return _shape_in(self), _pose(self.position, self.quaternion_wxyz)


class BodyTable(Record):
    """A named solid at a pose: what ``[[obstacle]]`` and ``[[attached]]`` have in common."""

    name: Name
    box: Size | None = Field(None, description=XYZ)
    sphere: Length | None = None
    cylinder: RoundTable | None = Field(None, description=ROUND)
    capsule: RoundTable | None = Field(None, description=ROUND)
    mesh: Annotated[MeshTable | None, BeforeValidator(_as_table)] = Field(None, description=MESH)
    cloud: CloudTable | None = Field(None, description=CLOUD)
    heights: HeightsTable | None = Field(None, description=HEIGHTS)
    compound: Annotated[list[PartTable], _tables(PARTS), at_most(MAX_COMPOUND)] | None = None
    position: Position
    quaternion_wxyz: Quaternion = Field([1.0, 0.0, 0.0, 0.0], description=WXYZ)


class ObstacleTable(BodyTable):
    """``[[obstacle]]``."""

    colour: Annotated[str, AfterValidator(checked_colour), Field(description='"#rrggbb"')] | None = None

    @cached_property
    def value(self) -> Obstacle:
        return Obstacle(self.name, _shape_in(self), _pose(self.position, self.quaternion_wxyz), self.colour)


class AttachedTable(BodyTable):
    """``[[attached]]``."""

    touch_links: Annotated[list[str], FirstOnly()] = Field([], description="a list of texts")
    constraints: Annotated[list[ConstraintTable], _tables(CONSTRAINTS), at_most(MAX_CONSTRAINTS)] = Field([])
    mass: float | None = Field(None, description="kilograms")

    @cached_property
    def value(self) -> Attached:
        pose, kept = _pose(self.position, self.quaternion_wxyz), tuple(table.value for table in self.constraints)
        return Attached(self.name, _shape_in(self), pose, tuple(self.touch_links), kept, self.mass)


class SceneFile(Record):
    """A scene file."""

    name: Annotated[str, AfterValidator(lambda name: name and checked_name("name", name))] = ""
    description: Annotated[str, AfterValidator(checked_description)] = ""
    obstacle: Annotated[list[ObstacleTable], _tables("tables, each headed [[obstacle]]")] = Field([])
    attached: Annotated[list[AttachedTable], _tables("tables, each headed [[attached]]")] = Field([])

    @model_validator(mode="before")
    @classmethod
    def _few(cls, document: dict[str, Any]) -> dict[str, Any]:
        tables = [document.get(kind) for kind in ("obstacle", "attached")]
        count = sum(len(entries) for entries in tables if isinstance(entries, list))
        if count > MAX_OBJECTS:
            expected = f"at most {MAX_OBJECTS:,}"
            message = f"{count:,} obstacles and attached objects; expected {expected}"
            raise InvalidRequest("obstacle", count, expected, message=message)
        return document

    @classmethod
    def of(cls, scene: Scene) -> SceneFile:
        texts = {"name": scene.name, "description": scene.description}
        obstacles = [{**_body_keys(body), **_colour_keys(body)} for body in scene.obstacles]
        attached = [{**_body_keys(held), **_carrying_keys(held)} for held in scene.attached]
        given = {key: text for key, text in texts.items() if text}
        return cls.model_validate({**given, "obstacle": obstacles, "attached": attached})

    @cached_property
    def value(self) -> Scene:
        attached = tuple(table.value for table in self.attached)
        return Scene(tuple(table.value for table in self.obstacle), attached, self.name, self.description)


def _shape_in(table: PartTable | BodyTable) -> Any:
    """The one shape that a table has."""
    known = [key for key in SHAPE_KEYS if key in type(table).model_fields]
    given = [key for key in known if key in table.model_fields_set]
    if len(given) != 1:
        problem = f"two or more shapes, {' and '.join(given)}" if given else "shape is missing"
        expected = f"exactly one of {', '.join(known)}"
        raise InvalidRequest("shape", given, expected, message=f"{problem}; expected {expected}")
    content = getattr(table, given[0])
    if isinstance(content, RoundTable):
        return _ROUND[given[0]](content.radius, content.length)
    if isinstance(content, FileTable):
        return content.value
    if given[0] == "compound":
        return Compound(tuple(part.value for part in content))
    return Sphere(content) if given[0] == "sphere" else Box(tuple(content))


def _pose(position: list[float], quaternion: list[float]) -> Pose:
    (x, y, z), (w, i, j, k) = position, quaternion
    return Pose((x, y, z), (w, i, j, k))


def _body_keys(body: Obstacle | Attached) -> dict[str, Any]:
    return {"name": body.name, **_shape_keys(body.shape), **_pose_keys(body.pose)}


def _colour_keys(obstacle: Obstacle) -> dict[str, Any]:
    return {} if obstacle.colour is None else {"colour": obstacle.colour}


def _carrying_keys(held: Attached) -> dict[str, Any]:
    kept = [keys_of(constraint) for constraint in held.constraints]
    mass = {} if held.mass is None else {"mass": held.mass}
    return {"touch_links": list(held.touch_links), **({"constraints": kept} if kept else {}), **mass}


def _shape_keys(shape: Solid) -> dict[str, Any]:
    """The key of a shape, with what stands under it; a mesh as its corners, so that the file needs no other."""
    if isinstance(shape, Box):
        return {"box": list(shape.size)}
    if isinstance(shape, Sphere):
        return {"sphere": shape.radius}
    if isinstance(shape, Mesh):
        return {"mesh": {"vertices": shape.vertices.tolist()}}
    if isinstance(shape, PointCloud):
        return {"cloud": {"resolution": shape.resolution, "cells": shape.cells.tolist()}}
    if isinstance(shape, HeightField):
        return {"heights": {"cell": shape.cell, "floor": shape.floor, "values": shape.heights.tolist()}}
    if isinstance(shape, Compound):
        return {"compound": [_shape_keys(part) | _pose_keys(pose) for part, pose in shape.parts]}
    if isinstance(shape, Cylinder | Capsule):
        key = "cylinder" if isinstance(shape, Cylinder) else "capsule"
        return {key: {"radius": float(shape.radius), "length": float(shape.length)}}
    raise InvalidRequest("shape", shape, "a shape of this package: others cannot be written to a file")


def _pose_keys(pose: Pose) -> dict[str, Any]:
    """The keys of a pose; the identity rotation is left out."""
    turned = {} if pose.quaternion == (1.0, 0.0, 0.0, 0.0) else {"quaternion_wxyz": list(pose.quaternion)}
    return {"position": list(pose.position), **turned}
