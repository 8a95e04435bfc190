"""Grasps: where a gripper may take an object, and what must hold where its fingers touch."""

from planner_service.grasping.grasps import top_grasps

__all__ = ["top_grasps"]
