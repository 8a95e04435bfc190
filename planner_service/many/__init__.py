"""Many items at once: on every core, or on all machines of a Ray cluster."""

from planner_service.many.cluster import Ray
from planner_service.many.engine import Answers, Engine, InWorker, Limit, Lost, Work
from planner_service.many.named import engine_named
from planner_service.many.processes import Processes
from planner_service.many.sequential import Sequential

__all__ = ["Answers", "Engine", "InWorker", "Limit", "Lost", "Processes", "Ray", "Sequential", "Work", "engine_named"]
