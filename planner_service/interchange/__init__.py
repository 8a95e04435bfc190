"""What others write, read; what others read, written. Nothing of ROS is needed."""

from planner_service.interchange.moveit_scene import read_moveit_scene
from planner_service.interchange.problem_set import Problem, ProblemSet, read_problems
from planner_service.interchange.trajectory_out import (
    csv_text,
    joint_trajectory,
    task_csv_text,
    task_trajectories,
    write_csv,
)
from planner_service.interchange.urdf_scene import read_urdf_scene
from planner_service.interchange.worlds import load_world

__all__ = [
    "Problem",
    "ProblemSet",
    "csv_text",
    "joint_trajectory",
    "load_world",
    "read_moveit_scene",
    "read_problems",
    "read_urdf_scene",
    "task_csv_text",
    "task_trajectories",
    "write_csv",
]
