"""Two planar arms whose ways cross."""

from __future__ import annotations

from planner_service import PlanRequest, Pose, Scene, load_robot
from planner_service.cell import Arm, Cell, CellPlan

__all__ = ["DELAY", "crossing", "two_discs"]

DELAY = 0.1


def two_discs() -> Cell:
    """A planar arm at the origin, and one that faces it."""
    robot = load_robot("planar2")
    facing = Pose((2.2, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return Cell({"left": Arm(robot), "right": Arm(robot, facing)}, Scene())


def crossing(cell: Cell) -> CellPlan:
    """One arm leaves what is between them, and the other comes in."""
    requests = {
        "left": PlanRequest([0.0, 0.1], [1.5, 0.1], velocity_scale=0.2),
        "right": PlanRequest([0.6, 0.1], [-0.6, 0.1]),
    }
    return cell.plan(requests, delay=DELAY)
