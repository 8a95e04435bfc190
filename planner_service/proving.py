"""Proofs of saved motions made anew: a file may have been changed since it was written."""

from __future__ import annotations

from dataclasses import replace

from planner_service.certify import Certificate
from planner_service.plan_file import SavedPlan, SavedTask
from planner_service.service import PlannerService
from planner_service.view.reel import Reel, Take

__all__ = ["proofs", "proven_anew"]


def proofs(
    plan: SavedPlan | SavedTask, service: PlannerService, *, padding: float | None = None
) -> tuple[tuple[str, Certificate], ...]:
    """The proof of each motion as far as there are any, by name, or where it cannot be proven.

    The motions of a task are judged with the gripper as open as it then is, and with what it then carries: the obstacle
    that the fingers touch as they close. Pairs that the plan says may touch on a stretch are left out there.

    Args:
        service: For the robot and the scene in which the plan begins.
        padding: Metres that every pair is to keep; as in the proof that the plan has if None.

    Raises:
        InvalidRequest: a path is not one of this robot within its limits, or the padding is out of range.
    """
    if isinstance(plan, SavedPlan):
        reel, had = Reel.of_result(service, plan.result), [plan.result.certificate]
    else:
        reel, had = Reel.of_task(service, plan.segments), [part.result.certificate for part in plan.segments]
    takes = () if reel is None else reel.takes
    return tuple((take.name, _proof(take, claimed, padding)) for take, claimed in zip(takes, had, strict=False))


def _proof(take: Take, claimed: Certificate | None, padding: float | None) -> Certificate:
    kept = 0.0 if claimed is None else claimed.padding
    part = None if claimed is None else claimed.part
    path = take.trajectory.path
    return take.service.certify(path, padding=kept if padding is None else padding, exempt=take.exempt, part=part)


def proven_anew(plan: SavedPlan | SavedTask, service: PlannerService) -> SavedPlan | SavedTask:
    """The plan with proofs of its motions as they are now; see ``proofs``."""
    anew = [certificate for _, certificate in proofs(plan, service)]
    if isinstance(plan, SavedPlan):
        return replace(plan, result=replace(plan.result, certificate=anew[0])) if anew else plan
    parts = [
        replace(part, result=replace(part.result, certificate=certificate))
        for part, certificate in zip(plan.segments, anew, strict=False)
    ]
    return replace(plan, segments=(*parts, *plan.segments[len(parts) :]))
