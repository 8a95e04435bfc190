"""What would help a task that has no plan."""

from __future__ import annotations

from planner_service.collision import CancelToken
from planner_service.geometry.validation import instance
from planner_service.infeasibility.remedies import Explanation
from planner_service.planning.task_result import TaskResult
from planner_service.service import PlannerService

__all__ = ["explain_task"]


def explain_task(
    task: TaskResult, *, plans: int = 60, remedies: int = 3, cancel: CancelToken | None = None
) -> Explanation | None:
    """Why the motion has no plan that a task failed at, whether that is proven, and which small changes would give one.

    It is about the last step that was searched for in vain. None if there is none: then ``task.failure`` says what is
    out of reach or touches, and ``task.steps`` how often.

    Args:
        plans: Plans that may be tried.
        remedies: How many changes are looked for.
        cancel: Ends the call when cancelled from another thread.

    Raises:
        InvalidRequest: as ``PlannerService.explain``.
        Cancelled: by ``cancel``.
    """
    instance("task", task, TaskResult, "a TaskResult")
    for step in reversed(task.steps):
        origin = None if step.refused is None or step.failed < step.tried else step.refused.origin
        if origin is not None and origin.request is not None:
            return PlannerService.of(origin.world).explain(
                origin.request, plans=plans, remedies=remedies, cancel=cancel
            )
    return None
