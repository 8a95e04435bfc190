"""Curves through joint space, and trajectories along them."""

from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory

__all__ = ["JointPath", "Trajectory"]
