"""Grasps: where a gripper may take an object, and what must hold where its fingers touch."""

from planner_service.grasping.antipodal import antipodal_grasps
from planner_service.grasping.grasps import side_grasps, top_grasps
from planner_service.grasping.held import GraspQuality, grasp_quality
from planner_service.grasping.kinds import GraspKind, GraspKinds
from planner_service.grasping.suction import suction_grasps

__all__ = [
    "GraspKind",
    "GraspKinds",
    "GraspQuality",
    "antipodal_grasps",
    "grasp_quality",
    "side_grasps",
    "suction_grasps",
    "top_grasps",
]
