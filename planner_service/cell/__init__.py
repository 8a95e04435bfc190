"""Several arms in one scene, each planned alone and on its own clock, proven against each other."""

from planner_service.cell.arms import Arm
from planner_service.cell.cell import Cell
from planner_service.cell.goal_kinds import Anywhere, AtTool
from planner_service.cell.result import CellPlan, OwnClock

__all__ = ["Anywhere", "Arm", "AtTool", "Cell", "CellPlan", "OwnClock"]
