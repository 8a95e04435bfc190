"""Scenes as immutable values, and the files they are read from."""

from typing import TYPE_CHECKING

from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Attached, Obstacle, Scene, scene_names

if TYPE_CHECKING:
    from planner_service.scene.moveit_scene import read_moveit_scene
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


def __getattr__(name: str) -> object:
    """A name of what no plan needs, imported with its first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from planner_service.scene.moveit_scene import read_moveit_scene
    from planner_service.scene.sdf_scene import read_sdf_scene
    from planner_service.scene.self_filter import remove_robot
    from planner_service.scene.urdf_scene import read_urdf_scene

    globals().update(read_moveit_scene=read_moveit_scene, read_sdf_scene=read_sdf_scene)
    globals().update(read_urdf_scene=read_urdf_scene, remove_robot=remove_robot)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
