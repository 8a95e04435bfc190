"""Is it free? The collision checker, its counts and its edges."""

from planner_service.collision.budget import Cancelled, CancelToken, CheckCounts
from planner_service.collision.checker import CollisionChecker, Contact
from planner_service.collision.edge_sampling import EdgeStep, JointStep, Known, MotionStep

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
