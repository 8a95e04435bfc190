"""A new plan for an arm that is moving: where to leave the old motion, and how to join the new one."""

from planner_service.replanning.result import Outcome, Replanned

__all__ = ["Outcome", "Replanned"]
