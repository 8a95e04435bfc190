"""Engines that answer many items at once: on every core, or on all machines of a Ray cluster."""

from planner_service.parallel.engine import Answers, Engine, InWorker, Limit, Lost, Work
from planner_service.parallel.named import engine_named
from planner_service.parallel.processes import Processes
from planner_service.parallel.ray_engine import Ray
from planner_service.parallel.sequential import Sequential

__all__ = ["Answers", "Engine", "InWorker", "Limit", "Lost", "Processes", "Ray", "Sequential", "Work", "engine_named"]
