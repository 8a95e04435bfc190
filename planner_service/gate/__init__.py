"""The gate between a policy and an arm: it lets pass what is proven free, with a proven stop behind it."""

from planner_service.gate.action_gate import ActionGate
from planner_service.gate.decision import Decision
from planner_service.gate.neighbour import Occupied
from planner_service.gate.target_filter import FilteredTarget, TargetFilter
from planner_service.gate.tracking import Course, Setpoint, Tracking, Whereabouts
from planner_service.gate.verdict import Counts, Kind, Refused, Verdict

__all__ = [
    "ActionGate",
    "Counts",
    "Course",
    "Decision",
    "FilteredTarget",
    "Kind",
    "Occupied",
    "Refused",
    "Setpoint",
    "TargetFilter",
    "Tracking",
    "Verdict",
    "Whereabouts",
]
