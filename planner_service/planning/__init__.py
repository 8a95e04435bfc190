"""What ``PlannerService.plan`` runs: a request, the stages in their order, and the result."""

from planner_service.planning.batch import Interrupted
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import Goal, Pace, PlanRequest, World
from planner_service.planning.result import (
    Failure,
    ImproveReport,
    MotionReport,
    Origin,
    PlanResult,
    PolishReport,
    Reason,
    Stage,
    StageReport,
)
from planner_service.planning.roadmap_work import RoadmapUpdate

__all__ = [
    "AllowedStretch",
    "Failure",
    "Goal",
    "ImproveReport",
    "Interrupted",
    "MotionReport",
    "Origin",
    "Pace",
    "PlanRequest",
    "PlanResult",
    "PolishReport",
    "Reason",
    "RoadmapUpdate",
    "Stage",
    "StageReport",
    "World",
]
