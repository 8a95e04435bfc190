"""Robots and scenes as tables: joint limits, named poses, obstacles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Pose
from planner_service.presentation.tables import Block, Table

__all__ = ["length_unit", "robot_blocks", "scene_blocks"]

UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Body(Protocol):
    """See ``planner_service.robot.Body``."""

    @property
    def prismatic(self) -> bool: ...


class Opening(Protocol):
    """See ``Gripper``."""

    @property
    def lower(self) -> float: ...
    @property
    def upper(self) -> float: ...


class Arm(Protocol):
    """See ``Robot``."""

    @property
    def name(self) -> str: ...
    @property
    def joint_names(self) -> Sequence[str]: ...
    @property
    def limits(self) -> object: ...
    @property
    def named_poses(self) -> Sequence[tuple[str, FloatArray]]: ...
    @property
    def tool_frame(self) -> str: ...
    @property
    def bodies(self) -> Sequence[Body]: ...
    @property
    def shapes(self) -> Sequence[object]: ...
    @property
    def gripper(self) -> Opening | None: ...


class Thing(Protocol):
    """See ``Obstacle`` and ``Attached``."""

    @property
    def name(self) -> str: ...
    @property
    def shape(self) -> Solid: ...
    @property
    def pose(self) -> Pose: ...


class World(Protocol):
    """See ``Scene``."""

    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def obstacles(self) -> Sequence[Thing]: ...
    @property
    def attached(self) -> Sequence[Thing]: ...


def length_unit(robot: Arm) -> str:
    """Unit of a path's length: rad, or none if some joints are prismatic."""
    return "" if any(body.prismatic for body in robot.bodies) else "rad"


def robot_blocks(robot: Arm) -> list[Block]:
    """A robot as ``planner-service robots NAME`` prints it."""
    gripper = robot.gripper
    opening = "" if gripper is None else f", gripper {gripper.lower:g} to {gripper.upper:g} m wide"
    shapes, joints = len(robot.shapes), len(robot.joint_names)
    title = f"{robot.name}: {joints} joints, {shapes} collision shapes, tool frame {robot.tool_frame}{opening}"
    units = "rad and s" if length_unit(robot) else "rad and s; m for prismatic joints"
    heads = ("lower", "upper", "velocity", "acceleration", "jerk")
    columns = [getattr(robot.limits, head).tolist() for head in heads]
    rows = [(name, *(f"{value:.4f}" for value in row)) for name, *row in zip(robot.joint_names, *columns, strict=True)]
    poses = [(name, _numbers(q.tolist(), ",")) for name, q in robot.named_poses]
    return [
        title,
        f"Limits in {units}:",
        "",
        Table(("joint", *heads), rows, numeric=heads),
        "",
        Table(("pose", "joint values"), poses),
    ]


def scene_blocks(scene: World) -> list[Block]:
    """A scene as ``planner-service scenes NAME`` prints it."""
    bodies = [(body, body.name) for body in scene.obstacles]
    bodies += [(body, f"{body.name} (attached)") for body in scene.attached]
    title = ": ".join(filter(None, (scene.name or "unnamed scene", " ".join(scene.description.split()))))
    heads = ["obstacle", "shape", "size", "position", "quaternion wxyz"]
    rows: list[tuple[str, ...]] = [
        (name, *_shape_cells(body.shape), _numbers(body.pose.position), _numbers(body.pose.quaternion))
        for body, name in bodies
    ]
    if all(body.pose.quaternion == UPRIGHT for body, _ in bodies):
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return [title, "", Table(heads, rows)]


def _shape_cells(shape: Solid) -> tuple[str, str]:
    """The kind of a shape, and its size in metres."""
    if isinstance(shape, Box):
        return "box", _numbers(shape.size)
    if isinstance(shape, Mesh):
        return "mesh", f"{len(shape.vertices)} corners"
    if isinstance(shape, PointCloud):
        return "point cloud", f"{len(shape.cells):,} cells of {shape.resolution:g}"
    if isinstance(shape, HeightField):
        return "height field", f"{shape.heights.size:,} columns of {shape.cell:g}"
    if isinstance(shape, Compound):
        return "compound", f"{len(shape.parts)} parts"
    sizes = ", ".join(f"{name} {value:g}" for name, value in vars(shape).items())
    return type(shape).__name__.lower(), sizes


def _numbers(values: Iterable[float], separator: str = ", ") -> str:
    """Numbers rounded to a tenth of a milliradian or millimetre."""
    return separator.join(f"{round(value, 4):g}" for value in values)
