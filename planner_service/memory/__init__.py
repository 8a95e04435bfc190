"""What a cell has learned, as a value: passed from plan to plan and from task to task, and kept in a file."""

from planner_service.memory.memory import NOTHING, Memory

__all__ = ["NOTHING", "Memory"]
