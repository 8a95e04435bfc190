"""Executes motions of several arms, each with a driver of its own, that stop together if one is late."""

from planner_service.execute.cells.lanes import execute_cell
from planner_service.execute.cells.report import ArmCourse, CellReport, CellStopped

__all__ = ["ArmCourse", "CellReport", "CellStopped", "execute_cell"]
