"""Scenes as immutable values, and the files they are read from."""

from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.scene import Attached, Obstacle, Scene, scene_names
from planner_service.scene.sdf_scene import read_sdf_scene
from planner_service.scene.self_filter import remove_robot
from planner_service.scene.urdf_scene import read_urdf_scene

__all__ = [
    "Attached",
    "Obstacle",
    "Scene",
    "load_scene",
    "read_moveit_scene",
    "read_sdf_scene",
    "read_urdf_scene",
    "remove_robot",
    "save_scene",
    "scene_names",
]
