"""Plans of several arms by a planner in another process, called as the library's are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell import Anywhere, AtTool, Cell, CellPlan
from planner_service.cell.cell import MAX_DELAY
from planner_service.cell.goal_kinds import checked_goals, off
from planner_service.client.remote import Remote
from planner_service.collision import CancelToken
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.validation import instance, number
from planner_service.planning.pipeline import require_plannable
from planner_service.planning.request import PlanRequest
from planner_service.records.cells.cell_file import SavedCellPlan, cell_plan_of
from planner_service.records.cells.prove import SAME_TOOL
from planner_service.records.request import RequestRecord, astray

__all__ = ["plan_cell"]


def plan_cell(
    remote: Remote,
    cell: Cell,
    requests: Mapping[str, PlanRequest],
    *,
    goals: Mapping[str, AtTool | Anywhere] | None = None,
    standing: Mapping[str, ArrayLike] | None = None,
    delay: float = 0.0,
    cancel: CancelToken | None = None,
) -> CellPlan:
    """Motions of several arms, each on its own clock; see ``Cell.plan``.

    What comes back begins and ends as was asked, in this cell, and claims the delay; ``prove_cell`` proves it here.

    Args:
        cell: The server's robot at places, or divided into arms, in the scene of ``remote``.

    Raises:
        UnknownName: No such arm.
        InvalidRequest: As ``Cell.plan``, or another robot or scene than the server's.
        ServerUnavailable: As ``Remote.plan``.
    """
    instance("remote", remote, Remote, "a Remote")
    instance("cell", cell, Cell, "a Cell")
    number("delay", delay, f"seconds in [0, {MAX_DELAY:g}]", 0.0, MAX_DELAY)
    instance("requests", requests, Mapping, "requests by the names of arms")
    still = {} if standing is None else instance("standing", standing, Mapping, "joints by the names of arms")
    robots = [cell.layout.whole] if cell.layout.whole is not None else [arm.robot for arm in cell.layout.arms.values()]
    for robot in robots:
        if robot is None or robot.hash != remote.robot.hash:
            raise InvalidRequest(
                "cell", getattr(robot, "name", None), f"arms of the server's robot, {remote.robot.name}"
            )
    if cell.scene.hash != remote.scene.hash:
        raise InvalidRequest("cell.scene", cell.scene.name, "the scene of the Remote")
    for name, request in requests.items():
        instance(f"requests[{name!r}]", request, PlanRequest, "a PlanRequest")
        require_plannable(request, cell.arm(name).robot, cell.scene)
    depending = checked_goals({} if goals is None else goals, requests, cell.arms)
    if cancel is not None and instance("cancel", cancel, CancelToken, "a CancelToken, or None").cancelled:
        return cell.plan(requests, goals=goals, standing=standing, delay=delay, cancel=cancel)
    begin = cell.joined({**still, **{name: request.start for name, request in requests.items()}})
    body = {"arms": list(_arms(cell, requests, depending, still)), "delay": delay}
    answer = remote._work("plan_cell", body, cancel)
    saved = cell_plan_of(Path(answer.url), answer.document())
    wrong = [*_other(cell, saved), *_not_asked(cell, saved.plan, requests, depending, begin, delay)]
    if wrong:
        raise InvalidFile(answer.url, wrong)
    return replace(saved.plan, layout=cell.layout)


def _arms(
    cell: Cell,
    requests: Mapping[str, PlanRequest],
    goals: Mapping[str, AtTool | Anywhere],
    standing: Mapping[str, ArrayLike],
) -> Iterator[dict[str, Any]]:
    layout = cell.layout
    for name in cell.arms:
        goal = goals.get(name)
        yield {
            "name": name,
            "base": layout.arms[name].base if layout.whole is None else None,
            "joints": None if layout.whole is None else list(layout.groups[name]),
            "tool": layout.tools.get(name),
            "carried": list(layout.carried.get(name, ())),
            "request": requests.get(name),
            "at_tool": goal if isinstance(goal, AtTool) else None,
            "anywhere": isinstance(goal, Anywhere),
            "stands": standing.get(name),
        }


def _other(cell: Cell, saved: SavedCellPlan) -> Iterator[str]:
    """How the cell of an answer is another one."""
    asked = SavedCellPlan.of(replace(saved.plan, layout=cell.layout)).document()
    answered = saved.document()
    for key in ("arms", "robots", "scene"):
        if answered[key] != asked[key]:
            yield f"{key}: other ones than were sent"


def _not_asked(
    cell: Cell,
    plan: CellPlan,
    requests: Mapping[str, PlanRequest],
    goals: Mapping[str, AtTool | Anywhere],
    begin: Any,
    delay: float,
) -> Iterator[str]:
    """What of a plan is not as was asked."""
    near = max((request.start_tolerance for request in requests.values()), default=0.0)
    if np.abs(plan.still - begin).max() > near + SAME_TOOL:
        yield "still: arms stand elsewhere"
    if plan.failure is not None:
        return
    if not plan.tolerates >= delay:
        yield f"tolerates: got {plan.tolerates:g}; expected {delay:g} s at least"
    if dict(plan.goals) != {name: goal for name, goal in goals.items() if isinstance(goal, AtTool)}:
        yield "arms: other tools were to be at each other than was asked"
    moved = {name for clock in plan.clocks for name in clock.arms}
    free = {name for name, goal in goals.items() if isinstance(goal, Anywhere)}
    if not requests.keys() - free <= moved <= requests.keys():
        yield f"clocks: got motions of {sorted(moved)}; expected those of {sorted(requests)}"
        return
    for clock in plan.clocks:
        answered = None if clock.plan.origin is None else clock.plan.origin.request
        if answered is None or not _kept(answered, [requests[name] for name in clock.arms]):
            yield f"{' and '.join(clock.arms)}: another request than was sent"
    end = plan(plan.duration)
    for clock in plan.clocks:
        for name in clock.arms:
            goal, request, robot = goals.get(name), requests[name], cell.arm(name).robot
            if isinstance(goal, AtTool):
                own, other = (cell.arm(each).robot.tool_pose(cell.of_arm(each, end)) for each in (name, goal.arm))
                if not max(off(goal, own, other)) <= SAME_TOOL:
                    yield f"{name}: its tool does not end where it was to be at {goal.arm}"
            elif goal is None and len(clock.arms) == 1:
                ends = [replace(clock.plan, goal_index=k) for k in range(len(request.named_goals()))]
                if all(astray(request, each, robot) for each in ends):
                    yield f"{name}: {astray(request, ends[0], robot)}"


def _kept(answered: PlanRequest, asked: Sequence[PlanRequest]) -> bool:
    """Whether a motion is what arms ask for, but for its ends: at most as fast, with all constraints and the rest."""
    if any(constraint not in answered.constraints for request in asked for constraint in request.constraints):
        return False
    if len(asked) > 1:  # planned as one robot, which may have to be slower
        return all(
            answered.velocity_scale <= request.velocity_scale
            and answered.acceleration_scale <= request.acceleration_scale
            and answered.padding >= request.padding
            for request in asked
        )
    (request,) = asked
    same = replace(answered, start=request.start, goal=request.goal, constraints=request.constraints)
    return bool(RequestRecord.of(same) == RequestRecord.of(request))
