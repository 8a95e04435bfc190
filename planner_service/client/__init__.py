"""A planner in another process, with the library's verbs: ``Remote`` in place of ``PlannerService``.

``pick``, ``place``, ``plan_pick_place``, ``move_linear`` and ``order`` are called as the library's are, with a
``Remote``; ``plan_cell`` as ``Cell.plan``, with a ``Remote`` and a ``Cell``.
"""

from planner_service.client.cells import plan_cell
from planner_service.client.ordering import order
from planner_service.client.problems import ServerRefused, ServerUnavailable, StaleVersion
from planner_service.client.remote import Remote
from planner_service.client.tasks import move_linear, pick, place, plan_pick_place
from planner_service.records.http.replies import Checked, CheckedState

__all__ = [
    "Checked",
    "CheckedState",
    "Remote",
    "ServerRefused",
    "ServerUnavailable",
    "StaleVersion",
    "move_linear",
    "order",
    "pick",
    "place",
    "plan_cell",
    "plan_pick_place",
]
