"""Robots and scenes as JSON objects and as tables."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich import box
from rich.table import Table

from planner_service.errors import MissingDependency
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box
from planner_service.robot.model import Robot, load_robot, robot_names
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = [
    "columns",
    "joint_table",
    "numbers",
    "object_table",
    "pose_table",
    "robot_record",
    "scene_record",
    "shipped_robots",
    "spaced",
]

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def shipped_robots() -> tuple[list[Robot], dict[str, str]]:
    """The robots that come with the package, and why some cannot be loaded: a package they need is not installed."""
    found, missing = [], {}
    for name in robot_names():
        try:
            found.append(load_robot(name))
        except MissingDependency as error:
            missing[name] = str(error)
    return found, missing


def robot_record(robot: Robot) -> dict[str, Any]:
    """A robot's name, joints with limits, poses and gripper."""
    limits = {name: getattr(robot.limits, name).tolist() for name in _LIMITS}
    gripper = robot.gripper
    return {
        "name": robot.name,
        "hash": robot.hash,
        "tool_frame": robot.tool_frame,
        "joints": [
            {"name": joint, **{name: values[k] for name, values in limits.items()}}
            for k, joint in enumerate(robot.joint_names)
        ],
        "poses": {name: q.tolist() for name, q in robot.named_poses},
        "shapes": len(robot.shapes),
        "gripper": None if gripper is None else {"lower": gripper.lower, "upper": gripper.upper},
    }


def scene_record(scene: Scene) -> dict[str, Any]:
    """A scene's name and everything in it, with the words of scene files."""
    return {
        "name": scene.name,
        "description": scene.description,
        "hash": scene.hash,
        "obstacles": [_object(obstacle) for obstacle in scene.obstacles],
        "attached": [{**_object(held), "touch_links": list(held.touch_links)} for held in scene.attached],
    }


def _object(body: Obstacle | Attached) -> dict[str, Any]:
    kind, size = _shape(body)
    position, quaternion = list(body.pose.position), list(body.pose.quaternion)
    return {"name": body.name, kind: size, "position": position, "quaternion_wxyz": quaternion}


def _shape(body: Obstacle | Attached) -> tuple[str, Any]:
    if isinstance(body.shape, Box):
        return "box", list(body.shape.size)
    if isinstance(body.shape, Mesh):
        return "mesh", {"corners": len(body.shape.vertices), "sha256": body.shape.digest}
    return type(body.shape).__name__.lower(), {name: float(value) for name, value in vars(body.shape).items()}


def joint_table(robot: Robot) -> Table:
    """A row per joint: its limits."""
    table = columns(("joint", False), *((name, True) for name in _LIMITS))
    for k, joint in enumerate(robot.joint_names):
        table.add_row(joint, *(f"{getattr(robot.limits, name)[k]:.4f}" for name in _LIMITS))
    return table


def pose_table(robot: Robot) -> Table:
    """A row per named pose."""
    table = columns(("pose", False), ("joint values", False))
    for name, q in robot.named_poses:
        table.add_row(name, numbers(q.tolist()))
    return table


def object_table(scene: Scene) -> Table:
    """A row per obstacle and attached object."""
    bodies: tuple[Obstacle | Attached, ...] = (*scene.obstacles, *scene.attached)
    turned = any(body.pose.quaternion != UPRIGHT for body in bodies)
    heads = ("obstacle", "shape", "size", "position", *(("quaternion wxyz",) if turned else ()))
    table = columns(*((head, False) for head in heads))
    for body in bodies:
        kind, size = _shape(body)
        words = ", ".join(map(_worded, size.items())) if isinstance(size, dict) else spaced(size)
        name = f"{body.name} (attached)" if isinstance(body, Attached) else body.name
        cells = [name, kind, words, spaced(body.pose.position), spaced(body.pose.quaternion)]
        table.add_row(*cells[: len(heads)])
    return table


def _worded(item: tuple[str, float | str]) -> str:
    key, value = item
    return f"{key} {value[:12]}" if isinstance(value, str) else f"{key} {value:g}"


def columns(*heads: tuple[str, bool]) -> Table:
    """A table without lines; a head that is True is of numbers, aligned to the right."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False, padding=(0, 1, 0, 0))
    for head, right in heads:
        table.add_column(head, justify="right" if right else "left", overflow="fold")
    return table


def numbers(values: Iterable[float]) -> str:
    """Numbers as a command line takes them, shortened to a tenth of a milliradian or millimetre."""
    return ",".join(f"{round(value, 4):g}" for value in values)


def spaced(values: Iterable[float]) -> str:
    """Numbers to read, which may be wrapped between any two."""
    return numbers(values).replace(",", ", ")
