"""Robots and scenes as lists and as JSON objects."""

from __future__ import annotations

from typing import Any

from planner_service.errors import MissingDependency
from planner_service.geometry.composite import Compound, HeightField, PointCloud, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box
from planner_service.planning.result import PlanResult
from planner_service.records import Problem
from planner_service.robot.model import Robot, robot_names
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = ["problem_record", "robot_record", "scene_record", "shipped_robots"]

LIMITS = ("lower", "upper", "velocity", "acceleration", "jerk")


def shipped_robots() -> tuple[list[Robot], dict[str, str]]:
    """The robots that come with the package, and why others cannot be loaded: a package they need is missing."""
    robots, missing = [], {}
    for name in robot_names():
        try:
            robots.append(load_robot(name))
        except MissingDependency as error:
            missing[name] = str(error)
    return robots, missing


def robot_record(robot: Robot) -> dict[str, Any]:
    """A robot's name, joints with limits, poses and gripper."""
    limits = {name: getattr(robot.limits, name).tolist() for name in LIMITS}
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


def problem_record(problem: Problem, result: PlanResult | None) -> dict[str, Any]:
    """A problem's name and size; if it was planned, what came of it."""
    record: dict[str, Any] = {"id": problem.id, "obstacles": len(problem.scene.obstacles)}
    record |= {"joints": list(problem.joint_names) or len(problem.start), "goals": max(1, len(problem.goals))}
    if result is None:
        return record
    failure = None if result.failure is None else str(result.failure)
    record |= {"planned": result.ok, "failure": failure, "seconds": result.seconds, "states": result.counts.states}
    return record | {"length": None if result.path is None else result.path.length}


def scene_record(scene: Scene) -> dict[str, Any]:
    """A scene's name and everything in it, with the keys of scene files."""
    return {
        "name": scene.name,
        "description": scene.description,
        "hash": scene.hash,
        "obstacles": [_body(obstacle) for obstacle in scene.obstacles],
        "attached": [{**_body(held), "touch_links": list(held.touch_links)} for held in scene.attached],
    }


def _body(body: Obstacle | Attached) -> dict[str, Any]:
    position, quaternion = list(body.pose.position), list(body.pose.quaternion)
    return {"name": body.name, **_shape(body.shape), "position": position, "quaternion_wxyz": quaternion}


def _shape(shape: Solid) -> dict[str, Any]:
    if isinstance(shape, Box):
        return {"box": list(shape.size)}
    if isinstance(shape, Mesh):
        return {"mesh": {"corners": len(shape.vertices), "sha256": shape.digest}}
    if isinstance(shape, PointCloud):
        return {"cloud": {"cells": len(shape.cells), "resolution": shape.resolution, "sha256": shape.digest}}
    if isinstance(shape, HeightField):
        return {"heights": {"columns": shape.heights.size, "cell": shape.cell, "sha256": shape.digest}}
    if isinstance(shape, Compound):
        return {"compound": [_shape(part) for part, _ in shape.parts]}
    return {type(shape).__name__.lower(): {name: float(value) for name, value in vars(shape).items()}}
