"""The gate between a policy and an arm: it lets pass what is proven free, with a proven stop behind it."""

from planner_service.gate.action_gate import ActionGate
from planner_service.gate.tracking import Course, Setpoint, Tracking, Whereabouts
from planner_service.gate.verdict import Counts, Kind, Refused, Verdict

__all__ = ["ActionGate", "Counts", "Course", "Kind", "Refused", "Setpoint", "Tracking", "Verdict", "Whereabouts"]
