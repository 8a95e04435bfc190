"""In which order to make visits, and with which branches: least motion time, proven motions, a proven gap."""

from planner_service.tasks.ordering.moves import Move, order_moves
from planner_service.tasks.ordering.order import order
from planner_service.tasks.ordering.result import FailedLeg, OrderResult, Stop
from planner_service.tasks.ordering.visits import Branch, Visit

__all__ = ["Branch", "FailedLeg", "Move", "OrderResult", "Stop", "Visit", "order", "order_moves"]
