"""Solids and scenes as JSON objects: meshes, clouds and height fields with all they are made of, to the last bit."""

from __future__ import annotations

import base64
import binascii
import reprlib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, ValidationInfo

from planner_service.errors import InvalidRequest
from planner_service.files.schema import Count, GrownRecord, Reading, Record, Text, at_most
from planner_service.geometry.arrays import FloatArray, IntArray
from planner_service.geometry.composite import MAX_CELLS, Compound, HeightField, PointCloud
from planner_service.geometry.mesh import MAX_HULL, Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.records.values import Constraints, KindRecord, PoseRecord
from planner_service.scene.scene import MAX_OBJECTS, Attached, Obstacle, Scene

__all__ = ["ObstacleRecord", "PlanReading", "SceneRecord", "ShapeRecord", "WorldRecord"]

CORNER = 32
"""Characters of a hull's corner in base64: three numbers of eight bytes."""

MAX_HULLS = 16 * MAX_HULL**2
"""To rebuild a hull takes time in proportion to the square of its corners: as much as sixteen of the largest."""


@dataclass
class PlanReading(Reading):
    """What is known while a plan file is read.

    Attributes:
        hulls: The texts of its meshes: one that occurs twice is rebuilt once.
        work: Sum of their squared corner counts: rebuilding a hull takes time in proportion to that.
    """

    hulls: set[str] = field(default_factory=set)
    work: int = 0


Packed = Annotated[str, Field(max_length=20_000_000)]
"""An array as base64 of its little-endian bytes."""


def packed(array: NDArray[Any], kind: str) -> str:
    """The text of an array; ``kind`` is "<f8" or "<i8"."""
    return base64.b64encode(np.ascontiguousarray(array).astype(kind).tobytes()).decode("ascii")


def unpacked(field: str, text: str, kind: str, columns: int) -> FloatArray:
    """An array (k, columns) from its text.

    Raises:
        InvalidRequest: it is no base64, or not of whole rows.
    """
    expected = f"base64 of rows of {columns} little-endian numbers of eight bytes"
    try:
        data = base64.b64decode(text.encode("ascii"), validate=True)
    except (binascii.Error, ValueError):
        raise InvalidRequest(field, reprlib.repr(text), expected) from None
    if len(data) % (8 * columns):
        raise InvalidRequest(field, f"{len(data)} bytes", expected)
    return np.frombuffer(data, dtype=kind).reshape(-1, columns)


class BoxRecord(KindRecord, makes=Box):
    """A ``Box``.

    Attributes:
        kind: Tells kinds of solids apart.
        size: Full edge lengths along x, y and z, in metres.
    """

    kind: Literal["box"] = "box"


class SphereRecord(KindRecord, makes=Sphere):
    """A ``Sphere``.

    Attributes:
        kind: Tells kinds of solids apart.
        radius: Metres.
    """

    kind: Literal["sphere"] = "sphere"


class CylinderRecord(KindRecord, makes=Cylinder):
    """A ``Cylinder``.

    Attributes:
        kind: Tells kinds of solids apart.
        radius: Metres.
        length: Full length in metres.
    """

    kind: Literal["cylinder"] = "cylinder"


class CapsuleRecord(KindRecord, makes=Capsule):
    """A ``Capsule``.

    Attributes:
        kind: Tells kinds of solids apart.
        radius: Metres.
        length: Metres between the centres of both caps.
    """

    kind: Literal["capsule"] = "capsule"


def _within_reason(vertices: str, info: ValidationInfo) -> str:
    corners = len(vertices) // CORNER
    if corners > MAX_HULL:
        raise ValueError(f"a hull of at most {MAX_HULL:,} corners")
    reading = info.context
    if isinstance(reading, PlanReading) and vertices not in reading.hulls:
        reading.hulls.add(vertices)
        reading.work += corners**2
        if reading.work > MAX_HULLS:
            raise ValueError(f"hulls that take no longer to rebuild than 16 of {MAX_HULL:,} corners, in the whole file")
    return vertices


class MeshRecord(Record):
    """A ``Mesh``: the corners of its hull, packed.

    Attributes:
        kind: Tells kinds of solids apart.
        vertices: The corners of its convex hull in metres, each once: base64 of rows of three little-endian 64-bit
            floats.
    """

    about = Mesh

    kind: Literal["mesh"] = "mesh"
    vertices: Annotated[Packed, AfterValidator(_within_reason)]

    @classmethod
    def fields_of(cls, value: Mesh) -> dict[str, Any]:
        return {"vertices": packed(value.vertices, "<f8")}

    @cached_property
    def value(self) -> Mesh:
        return _hull(self.vertices)


@lru_cache(maxsize=64)
def _hull(vertices: str) -> Mesh:
    """The arms of one robot have the same meshes."""
    return Mesh(unpacked("vertices", vertices, "<f8", 3))


CONVEX: dict[type, type[Record]] = {
    Box: BoxRecord,
    Sphere: SphereRecord,
    Cylinder: CylinderRecord,
    Capsule: CapsuleRecord,
    Mesh: MeshRecord,
}


def _recorded_as(records: dict[type, type[Record]]) -> BeforeValidator:
    """For a solid: its record by its class, which has to be one of these."""

    def record(solid: Any, info: ValidationInfo) -> Any:
        if isinstance(solid, dict | Record) or isinstance(info.context, Reading):
            return solid
        for kind, model in records.items():
            if isinstance(solid, kind):
                return model.of(solid)
        raise InvalidRequest("shape", solid, "a Box, Sphere, Cylinder, Capsule or Mesh: others have no place in a file")

    return BeforeValidator(record)


ShapeRecord = Annotated[
    BoxRecord | SphereRecord | CylinderRecord | CapsuleRecord | MeshRecord,
    Field(discriminator="kind"),
    _recorded_as(CONVEX),
]
"""A convex shape."""


class PartRecord(Record):
    """One of the parts of a ``Compound``.

    Attributes:
        shape: A convex solid.
        pose: Its pose in the compound's own frame.
    """

    shape: ShapeRecord
    pose: PoseRecord

    @cached_property
    def value(self) -> tuple[Shape, Pose]:
        return self.shape.value, self.pose.value


class CompoundRecord(KindRecord):
    """A ``Compound``.

    Attributes:
        kind: Tells kinds of solids apart.
        parts: Its convex parts.
    """

    makes = about = Compound

    kind: Literal["compound"] = "compound"
    parts: Annotated[list[PartRecord], at_most(1_000)]


class CloudRecord(GrownRecord):
    """A ``PointCloud``: its cells, packed; one of the two ways to say which.

    Attributes:
        kind: Tells kinds of solids apart.
        resolution: Edge length of the cubic cells, in metres.
        cells: The indices i, j, k of each occupied cell, which is between index and index + 1 times the resolution:
            base64 of rows of three little-endian 64-bit integers.
        packed: The same, as this package writes it: base64 of zlib of little-endian 32-bit integers, by how much the
            index i of each cell is larger than that of the one before it, of the first than 0, then j, then k.
    """

    about = PointCloud

    kind: Literal["cloud"] = "cloud"
    resolution: float
    cells: Packed | None = None
    packed: Packed | None = None

    @classmethod
    def fields_of(cls, value: PointCloud) -> dict[str, Any]:
        return {"resolution": value.resolution, "packed": _packed_cells(value.cells)}

    @cached_property
    def value(self) -> PointCloud:
        if self.packed is None and self.cells is not None:
            return PointCloud.from_cells(unpacked("cells", self.cells, "<i8", 3), self.resolution)
        if self.packed is None or self.cells is not None:
            raise InvalidRequest("packed", None if self.packed is None else "beside cells", "either cells or packed")
        return PointCloud.from_cells(_unpacked_cells("packed", self.packed), self.resolution)


def _packed_cells(cells: IntArray) -> str:
    """The text of cells (k, 3): neighbours in the list differ by little."""
    steps = np.diff(cells, axis=0, prepend=np.zeros((1, 3), dtype=np.int64)).T
    return base64.b64encode(zlib.compress(np.ascontiguousarray(steps).astype("<i4").tobytes())).decode("ascii")


def _unpacked_cells(field: str, text: str) -> IntArray:
    """Cells (k, 3) from their text.

    Raises:
        InvalidRequest: it is none, or of more cells than a cloud has.
    """
    expected = f"base64 of zlib of the steps of at most {MAX_CELLS:,} cells, three 32-bit integers each"
    unzip, most = zlib.decompressobj(), 12 * MAX_CELLS
    try:
        data = unzip.decompress(base64.b64decode(text.encode("ascii"), validate=True), most + 1)
    except (binascii.Error, ValueError, zlib.error):
        raise InvalidRequest(field, reprlib.repr(text), expected) from None
    if not unzip.eof or unzip.unused_data or len(data) > most or len(data) % 12:
        raise InvalidRequest(field, f"{len(data):,} bytes or more", expected)
    return np.cumsum(np.frombuffer(data, dtype="<i4").reshape(3, -1), axis=1, dtype=np.int64).T


class HeightsRecord(Record):
    """A ``HeightField``: its heights row by row, packed.

    Attributes:
        kind: Tells kinds of solids apart.
        columns: Heights in a row, which runs along x.
        heights: Heights in metres, row by row along y: base64 of little-endian 64-bit floats.
    """

    about = HeightField

    kind: Literal["heights"] = "heights"
    cell: float
    floor: float
    columns: Annotated[Count, Field(ge=1, le=1_000_000)]
    heights: Packed

    @classmethod
    def fields_of(cls, value: HeightField) -> dict[str, Any]:
        heights = {"columns": value.heights.shape[1], "heights": packed(value.heights, "<f8")}
        return {"cell": value.cell, "floor": value.floor, **heights}

    @cached_property
    def value(self) -> HeightField:
        return HeightField(unpacked("heights", self.heights, "<f8", self.columns), self.cell, self.floor)


SolidRecord = Annotated[
    BoxRecord
    | SphereRecord
    | CylinderRecord
    | CapsuleRecord
    | MeshRecord
    | CompoundRecord
    | CloudRecord
    | HeightsRecord,
    Field(discriminator="kind"),
    _recorded_as(CONVEX | {Compound: CompoundRecord, PointCloud: CloudRecord, HeightField: HeightsRecord}),
]
"""What an obstacle or an attached object may be."""


class ObstacleRecord(Record, makes=Obstacle):
    """An ``Obstacle``.

    Attributes:
        name: What messages and contacts call it; no other object of the scene has this name.
        shape: The solid.
        pose: Pose of the shape in the robot's base frame.
    """

    shape: SolidRecord


class AttachedRecord(GrownRecord, makes=Attached):
    """An ``Attached`` object.

    Attributes:
        name: What messages and contacts call it; no other object of the scene has this name.
        shape: The solid that is carried.
        pose: Pose of the shape in the tool frame.
    """

    shape: SolidRecord
    touch_links: Annotated[list[Text], at_most(1_000)]
    constraints: Constraints = Field(default_factory=list)
    mass: float | None = None


class SceneRecord(Record):
    """A ``Scene`` with its hash, which has to be that of its content.

    Attributes:
        name: The name of the scene.
        description: What it is, for a person.
        hash: SHA-256 of all that is in it.
        obstacles: What stands in it.
        attached: What the tool carries.
    """

    about = Scene

    name: Text
    description: str
    hash: Text
    obstacles: Annotated[list[ObstacleRecord], at_most(MAX_OBJECTS)]
    attached: Annotated[list[AttachedRecord], at_most(MAX_OBJECTS)]

    @cached_property
    def value(self) -> Scene:
        arguments = self.arguments
        del arguments["hash"]
        scene = Scene(**arguments)
        if scene.hash != self.hash:
            raise InvalidRequest("hash", self.hash, f"that of the content, {scene.hash}")
        return scene


def _named(entry: Any) -> str:
    return "name" if isinstance(entry, str) else "obstacle"


NameOrObstacle = Annotated[
    Annotated[Text, Tag("name")] | Annotated[ObstacleRecord, Tag("obstacle")], Discriminator(_named)
]


class WorldRecord(Record):
    """What a task's scene has become by a motion: obstacles that are as they were by name, others whole, in order.

    Attributes:
        obstacles: What stands in it: the names of obstacles that are as they were in the task's scene, and other
            obstacles whole.
        attached: What the tool carries.
    """

    obstacles: Annotated[list[NameOrObstacle], at_most(MAX_OBJECTS)]
    attached: Annotated[list[AttachedRecord], at_most(MAX_OBJECTS)]

    @classmethod
    def since(cls, first: Scene, scene: Scene) -> WorldRecord:
        """What has become of the first scene."""
        before = {obstacle.name: obstacle for obstacle in first.obstacles}
        obstacles = [o.name if before.get(o.name) == o else o for o in scene.obstacles]
        return cls.model_validate({"obstacles": obstacles, "attached": list(scene.attached)})

    def scene(self, first: Scene, before: Mapping[str, Obstacle]) -> Scene:
        """The scene; ``before`` are the obstacles of the first one, by name.

        Raises:
            InvalidRequest: a name that is not there, or a name twice.
        """
        obstacles = []
        for entry in self.obstacles:
            if isinstance(entry, str) and entry not in before:
                raise InvalidRequest("obstacles", entry, "the name of an obstacle of the task's scene, or an obstacle")
            obstacles.append(before[entry] if isinstance(entry, str) else entry.value)
        return Scene(tuple(obstacles), tuple(record.value for record in self.attached), first.name, first.description)
