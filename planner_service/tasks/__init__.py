"""What is made of several plans: tasks, pick, place, tool motions, and the best plan of several seeds."""

from planner_service.planning.task_result import Handling, Segment, StepReport, TaskResult
from planner_service.tasks.explanation import explain_task
from planner_service.tasks.pick_place import places_on, plan_pick_place, standing_on
from planner_service.tasks.primitives import pick, pick_steps, place, place_steps
from planner_service.tasks.seeds import best_of_seeds, plan_seeds
from planner_service.tasks.solver import solve
from planner_service.tasks.steps import (
    Alternatives,
    Approach,
    Connect,
    Follow,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    Release,
    Repeat,
    Retreat,
    Step,
    Wait,
)
from planner_service.tasks.task import Task
from planner_service.tasks.tool_motions import move_circular, move_linear
from planner_service.tasks.ways import ProvenWay, proven_ways

__all__ = [
    "Alternatives",
    "Approach",
    "Connect",
    "Follow",
    "Grasp",
    "Handling",
    "MoveCircular",
    "MoveLinear",
    "MoveTo",
    "ProvenWay",
    "Release",
    "Repeat",
    "Retreat",
    "Segment",
    "Step",
    "StepReport",
    "Task",
    "TaskResult",
    "Wait",
    "best_of_seeds",
    "explain_task",
    "move_circular",
    "move_linear",
    "pick",
    "pick_steps",
    "place",
    "place_steps",
    "places_on",
    "plan_pick_place",
    "plan_seeds",
    "proven_ways",
    "solve",
    "standing_on",
]
