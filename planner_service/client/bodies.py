"""What is sent, where it is no record of one value: goals, targets and constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints
from planner_service.files.schema import plain
from planner_service.geometry.shapes import Pose
from planner_service.planning.request import Goal, PlanRequest
from planner_service.records.http.bodies import CertifyBody, sent
from planner_service.records.request import RequestRecord
from planner_service.records.values import PoseRecord

__all__ = ["constraints_body", "goals_body", "request_body", "target_body"]


def request_body(request: PlanRequest) -> dict[str, Any]:
    """A request.

    Raises:
        InvalidRequest: It has a planner or a timing law of the caller's own, which cannot be sent.
    """
    return sent(RequestRecord, "request", request) or {}


def goals_body(goal: Goal | None) -> list[Any] | None:
    """The goals of a request."""
    return None if goal is None else request_body(PlanRequest((), goal))["goals"]


def constraints_body(constraints: Sequence[Constraint]) -> list[Any]:
    """What a motion is to keep."""
    body = sent(CertifyBody, "request", {"constraints": list(checked_constraints(constraints))}) or {}
    kept: list[Any] = body["constraints"]
    return kept


def target_body(target: Any) -> Any:
    """A pose of the tool, a displacement, or several of these."""
    if isinstance(target, list | tuple):
        return [target_body(each) for each in target]
    return sent(PoseRecord, "goal", target) if isinstance(target, Pose) else plain(target)
