"""Is it free? The collision checker, its counts and its edges."""

from planner_service.collision.checker import CollisionChecker, Contact
from planner_service.collision.edges import EdgeStep, JointStep, Known, MotionStep
from planner_service.collision.ledger import Cancelled, CancelToken, CheckCounts

__all__ = [
    "CancelToken",
    "Cancelled",
    "CheckCounts",
    "CollisionChecker",
    "Contact",
    "EdgeStep",
    "JointStep",
    "Known",
    "MotionStep",
]
