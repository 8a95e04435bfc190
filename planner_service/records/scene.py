"""Solids and scenes as JSON objects: meshes, clouds and height fields with all they are made of, to the last bit."""

from __future__ import annotations

import base64
import binascii
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo

from planner_service.errors import InvalidRequest
from planner_service.files.schema import Count, Reading, Record, Text, Vector3, Vector4, at_most
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import MAX_HULL, Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Shape, Sphere
from planner_service.scene.scene import MAX_OBJECTS, Attached, Obstacle, Scene

__all__ = ["ObstacleRecord", "PlanReading", "PoseRecord", "SceneRecord", "ShapeRecord", "WorldRecord", "shape_record"]

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


class PoseRecord(Record):
    """A ``Pose``."""

    position: Vector3
    quaternion_wxyz: Vector4

    @classmethod
    def of(cls, pose: Pose) -> PoseRecord:
        return cls(position=list(pose.position), quaternion_wxyz=list(pose.quaternion))

    @cached_property
    def value(self) -> Pose:
        (x, y, z), (w, i, j, k) = self.position, self.quaternion_wxyz
        return Pose((x, y, z), (w, i, j, k))


class BoxRecord(Record):
    """A ``Box``."""

    kind: Literal["box"]
    size: Vector3

    @cached_property
    def value(self) -> Box:
        x, y, z = self.size
        return Box((x, y, z))


class SphereRecord(Record):
    """A ``Sphere``."""

    kind: Literal["sphere"]
    radius: float

    @cached_property
    def value(self) -> Sphere:
        return Sphere(self.radius)


class CylinderRecord(Record):
    """A ``Cylinder``."""

    kind: Literal["cylinder"]
    radius: float
    length: float

    @cached_property
    def value(self) -> Cylinder:
        return Cylinder(self.radius, self.length)


class CapsuleRecord(Record):
    """A ``Capsule``."""

    kind: Literal["capsule"]
    radius: float
    length: float

    @cached_property
    def value(self) -> Capsule:
        return Capsule(self.radius, self.length)


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
    """A ``Mesh``: the corners of its hull, packed."""

    kind: Literal["mesh"]
    vertices: Annotated[Packed, AfterValidator(_within_reason)]

    @cached_property
    def value(self) -> Mesh:
        return _hull(self.vertices)


@lru_cache(maxsize=64)
def _hull(vertices: str) -> Mesh:
    """The arms of one robot have the same meshes."""
    return Mesh(unpacked("vertices", vertices, "<f8", 3))


ShapeRecord = Annotated[
    BoxRecord | SphereRecord | CylinderRecord | CapsuleRecord | MeshRecord, Field(discriminator="kind")
]
"""A convex shape."""


class PartRecord(Record):
    """One of the parts of a ``Compound``."""

    shape: ShapeRecord
    pose: PoseRecord


class CompoundRecord(Record):
    """A ``Compound``."""

    kind: Literal["compound"]
    parts: Annotated[list[PartRecord], at_most(1_000)]

    @cached_property
    def value(self) -> Compound:
        return Compound(tuple((part.shape.value, part.pose.value) for part in self.parts))


class CloudRecord(Record):
    """A ``PointCloud``: its cells, packed."""

    kind: Literal["cloud"]
    resolution: float
    cells: Packed

    @cached_property
    def value(self) -> PointCloud:
        return PointCloud.from_cells(unpacked("cells", self.cells, "<i8", 3), self.resolution)


class HeightsRecord(Record):
    """A ``HeightField``: its heights row by row, packed."""

    kind: Literal["heights"]
    cell: float
    floor: float
    columns: Annotated[Count, Field(ge=1, le=1_000_000)]
    heights: Packed

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
]
"""What an obstacle or an attached object may be."""


def shape_record(shape: Shape) -> Any:
    """The record of a convex shape.

    Raises:
        InvalidRequest: it is of a kind of the caller's own.
    """
    if isinstance(shape, Box):
        return BoxRecord(kind="box", size=list(shape.size))
    if isinstance(shape, Sphere):
        return SphereRecord(kind="sphere", radius=shape.radius)
    if isinstance(shape, Cylinder):
        return CylinderRecord(kind="cylinder", radius=shape.radius, length=shape.length)
    if isinstance(shape, Capsule):
        return CapsuleRecord(kind="capsule", radius=shape.radius, length=shape.length)
    if isinstance(shape, Mesh):
        return MeshRecord(kind="mesh", vertices=packed(shape.vertices, "<f8"))
    raise InvalidRequest("shape", shape, "a Box, Sphere, Cylinder, Capsule or Mesh: others have no place in a file")


def _solid_record(solid: Solid) -> Any:
    if isinstance(solid, Compound):
        parts = [PartRecord(shape=shape_record(shape), pose=PoseRecord.of(pose)) for shape, pose in solid.parts]
        return CompoundRecord(kind="compound", parts=parts)
    if isinstance(solid, PointCloud):
        return CloudRecord(kind="cloud", resolution=solid.resolution, cells=packed(solid.cells, "<i8"))
    if isinstance(solid, HeightField):
        columns, heights = solid.heights.shape[1], packed(solid.heights, "<f8")
        return HeightsRecord(kind="heights", cell=solid.cell, floor=solid.floor, columns=columns, heights=heights)
    return shape_record(solid)


class ObstacleRecord(Record):
    """An ``Obstacle``."""

    name: Text
    shape: SolidRecord
    pose: PoseRecord

    @classmethod
    def of(cls, obstacle: Obstacle) -> ObstacleRecord:
        return cls(name=obstacle.name, shape=_solid_record(obstacle.shape), pose=PoseRecord.of(obstacle.pose))

    @cached_property
    def value(self) -> Obstacle:
        return Obstacle(self.name, self.shape.value, self.pose.value)


class AttachedRecord(Record):
    """An ``Attached`` object."""

    name: Text
    shape: SolidRecord
    pose: PoseRecord
    touch_links: Annotated[list[Text], at_most(1_000)]

    @classmethod
    def of(cls, held: Attached) -> AttachedRecord:
        shape, pose = _solid_record(held.shape), PoseRecord.of(held.pose)
        return cls(name=held.name, shape=shape, pose=pose, touch_links=list(held.touch_links))

    @cached_property
    def value(self) -> Attached:
        return Attached(self.name, self.shape.value, self.pose.value, tuple(self.touch_links))


class SceneRecord(Record):
    """A ``Scene`` with its hash, which has to be that of its content."""

    name: Text
    description: str
    hash: Text
    obstacles: Annotated[list[ObstacleRecord], at_most(MAX_OBJECTS)]
    attached: Annotated[list[AttachedRecord], at_most(MAX_OBJECTS)]

    @classmethod
    def of(cls, scene: Scene) -> SceneRecord:
        return cls(
            name=scene.name,
            description=scene.description,
            hash=scene.hash,
            obstacles=[ObstacleRecord.of(obstacle) for obstacle in scene.obstacles],
            attached=[AttachedRecord.of(held) for held in scene.attached],
        )

    @cached_property
    def value(self) -> Scene:
        obstacles = tuple(record.value for record in self.obstacles)
        scene = Scene(obstacles, tuple(record.value for record in self.attached), self.name, self.description)
        if scene.hash != self.hash:
            raise InvalidRequest("hash", self.hash, f"that of the content, {scene.hash}")
        return scene


def _named(entry: Any) -> str:
    return "name" if isinstance(entry, str) else "obstacle"


NameOrObstacle = Annotated[
    Annotated[Text, Tag("name")] | Annotated[ObstacleRecord, Tag("obstacle")], Discriminator(_named)
]


class WorldRecord(Record):
    """What a task's scene has become by a motion: obstacles that are as they were by name, others whole, in order."""

    obstacles: Annotated[list[NameOrObstacle], at_most(MAX_OBJECTS)]
    attached: Annotated[list[AttachedRecord], at_most(MAX_OBJECTS)]

    @classmethod
    def of(cls, scene: Scene, first: Scene) -> WorldRecord:
        """A scene, told by what it has in common with the first one."""
        before = {obstacle.name: obstacle for obstacle in first.obstacles}
        return cls(
            obstacles=[o.name if before.get(o.name) == o else ObstacleRecord.of(o) for o in scene.obstacles],
            attached=[AttachedRecord.of(held) for held in scene.attached],
        )

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
