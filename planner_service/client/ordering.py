"""Visits put in order by a planner in another process, as ``planner_service.tasks.ordering.order`` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from numpy.typing import ArrayLike

from planner_service.client.claims import require_asked, require_there, task_result
from planner_service.client.problems import ServerUnavailable
from planner_service.client.remote import Remote
from planner_service.collision import CancelToken
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import in_file, instance, number, whole
from planner_service.planning.request import PlanRequest, clamped
from planner_service.planning.result import Reason
from planner_service.planning.task_result import require_joined
from planner_service.records.http.sections import read_reply
from planner_service.records.request import reached
from planner_service.records.visits import ORDER, OrderRecord
from planner_service.robot.model import joint_vector
from planner_service.tasks.ordering import Branch, OrderResult, Visit
from planner_service.tasks.ordering import order as order_here
from planner_service.tasks.ordering.visits import require_visits

__all__ = ["order"]


def order(
    remote: Remote,
    visits: Sequence[Visit],
    request: PlanRequest,
    *,
    end: ArrayLike | None = None,
    gap: float = 0.05,
    plans: int = 3000,
    cancel: CancelToken | None = None,
) -> OrderResult:
    """The order of visits that takes least time, each motion proven; see ``planner_service.tasks.ordering.order``.

    Of legs without a plan and of branches that are not used it names the first 1,000 of each. The bounds are what the
    server says.

    Args:
        visits: At most 500; their branches are joint values and poses, without motions of their own.

    Raises:
        InvalidRequest: As the library's, or a branch cannot be sent.
        UnknownName: As the library's.
        Cancelled: ``cancel`` was cancelled.
        ServerUnavailable: As ``Remote.plan``.
    """
    instance("remote", remote, Remote, "a Remote")
    instance("request", request, PlanRequest, "a PlanRequest")
    instance("cancel", cancel, (CancelToken, type(None)), "a CancelToken, or None")
    if cancel is not None and cancel.cancelled:
        return order_here(remote._here, visits, request, end=end, gap=gap, plans=plans, cancel=cancel)
    chains, _ = require_visits(visits)
    start = joint_vector("request.start", request.start, remote.robot)
    last = start if end is None else joint_vector("end", end, remote.robot)
    body = {
        "q": start,
        "visits": list(visits),
        "end": last,
        "request": request,
        "gap": number("gap", gap, "a share from 0 to 10", 0.0, 10.0),
        "plans": whole("plans", plans, 1, 1_000_000),
    }
    answer = remote._work("order", body, cancel)
    saved = remote._reader.task(answer.document(), answer.url)
    if ORDER not in saved.sections:  # no worker came to it, or workers were lost
        detail = "no order" if saved.failure is None else saved.failure.detail
        if saved.failure is not None and saved.failure.reason is Reason.PREEMPTED:
            raise Cancelled(detail)
        raise ServerUnavailable(answer.url, detail)
    record = read_reply(OrderRecord, saved.sections[ORDER], answer.url)
    asked = replace(request, start=start, goal=start)
    if saved.segments:
        require_asked(answer, saved.request, asked)
        require_there(answer, asked, saved.segments[0].result, remote.robot, task=True)
    task = replace(task_result(saved, asked), request=request)
    found = in_file(Path(answer.url), lambda: record.result(task))
    if found.ok:
        in_file(Path(answer.url), lambda: require_joined(task.segments))
        problems = _unmade(chains, found) or _elsewhere(remote, chains, found, request, last)
        if problems:
            raise InvalidFile(answer.url, [f"stops: {problems}"])
    return found


def _unmade(chains: Sequence[Sequence[Visit]], found: OrderResult) -> str:
    """What of an order is not as it must be; empty if all visits are there once, and none too early."""
    at = {name: k for k, name in enumerate(found.order)}
    if sorted(at) != sorted(visit.name for chain in chains for visit in chain) or len(at) != len(found.order):
        return "expected each visit once"
    for chain in chains:
        for one, two in pairwise(chain):
            if at[two.name] != at[one.name] + 1:
                return f"{two.name} does not follow {one.name}"
        for name in chain[0].after:
            if at[name] > at[chain[0].name]:
                return f"{chain[0].name} comes before {name}"
    return ""


def _elsewhere(
    remote: Remote,
    chains: Sequence[Sequence[Visit]],
    found: OrderResult,
    request: PlanRequest,
    last: FloatArray,
) -> str:
    """Which visit is made where it has no such branch; empty if none is."""
    ways = {visit.name: visit.ways for chain in chains for visit in chain}

    def made(way: Branch | Pose | FloatArray, at: FloatArray) -> bool:
        goal = way.q if isinstance(way, Branch) else way
        given = goal if isinstance(goal, Pose) else clamped(goal, remote.robot, request.start_tolerance)
        return reached(given, at, remote.robot)

    for stop in found.stops:
        at, given = stop.leg.unwrap()[0].waypoints[-1], ways[stop.name]
        numbered = all(isinstance(way, Branch) for way in given)
        fitting = given[stop.branch : stop.branch + 1] if numbered else given
        if not any(made(way, at) for way in fitting):
            return f"{stop.name} is made where it has no branch {stop.branch}"
    end = found.task.segments[-1].result.unwrap()[0].waypoints[-1]
    return "" if made(last, end) else "the last motion ends elsewhere"
