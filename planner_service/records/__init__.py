"""Plans, tasks, problems and trajectories in files; what is read from a file is proven again before it is used."""

from planner_service.records.evidence import save_plan
from planner_service.records.exports.mujoco_keyframes import keyframes_text
from planner_service.records.exports.trajectory_export import (
    csv_text,
    display_trajectory,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_trajectories,
    write_csv,
    yaml_text,
)
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan, load_plan_or_task, load_task
from planner_service.records.problem_set import Problem, ProblemSet
from planner_service.records.problems import read_problems

__all__ = [
    "Problem",
    "ProblemSet",
    "SavedPlan",
    "SavedTask",
    "csv_text",
    "display_trajectory",
    "joint_trajectory",
    "keyframes_text",
    "load_plan",
    "load_plan_or_task",
    "load_task",
    "read_problems",
    "robot_trajectory",
    "save_plan",
    "task_csv_text",
    "task_trajectories",
    "write_csv",
    "yaml_text",
]
