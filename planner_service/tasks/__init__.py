"""What is made of several plans: pick, place, tool motions, and the best plan of several seeds."""

from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.tasks.pick_place import places_on, plan_pick_place, standing_on
from planner_service.tasks.primitives import pick, place
from planner_service.tasks.seeds import best_of_seeds, plan_seeds
from planner_service.tasks.tool_motions import move_circular, move_linear

__all__ = [
    "Handling",
    "Segment",
    "TaskResult",
    "best_of_seeds",
    "move_circular",
    "move_linear",
    "pick",
    "place",
    "places_on",
    "plan_pick_place",
    "plan_seeds",
    "standing_on",
]
