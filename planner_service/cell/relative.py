"""How motions to goals that depend on other arms are planned: these goals, and then the motions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice, product

import numpy as np
from numpy.typing import ArrayLike

from planner_service.cell.goal_kinds import Anywhere, AtTool
from planner_service.cell.planning import plan_arms
from planner_service.cell.result import CellPlan
from planner_service.cell.services import Services
from planner_service.collision import CancelToken
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Reason
from planner_service.robot.model import joint_vector

__all__ = ["plan_goals"]

ALTERNATIVES = 4
"""Goals of arms that lead to which plans are tried."""

POSES = 4
"""Of a ``PoseGoal``, those that are looked at."""

ENDS = (Reason.START_IN_COLLISION, Reason.PREEMPTED)
"""Failures after which nothing else is tried."""

DRAWS, REFUGES, SINGLY = 64, 12, 4
"""Places to which an arm may give way: how many are drawn, kept, and tried each by itself."""

NEARBY = 0.5
"""Radians or metres by which half of them are away from where the arm stands, in the standard deviation."""


def plan_goals(
    services: Services,
    requests: Mapping[str, PlanRequest],
    goals: Mapping[str, AtTool | Anywhere],
    standing: Mapping[str, FloatArray],
    delay: float,
    cancel: CancelToken | None,
) -> CellPlan:
    """Motions to goals that depend on other arms, in the order of ``checked_goals``.

    A tool that follows goes where the goal of its leader has it; of a leader with several goals, each is tried in turn.
    Arms that may end anywhere stand first, and are given other goals if that does not do.
    """
    tried = list[CellPlan]()
    relative = {name: goal for name, goal in goals.items() if isinstance(goal, AtTool)}
    yielding = [name for name, goal in goals.items() if isinstance(goal, Anywhere)]
    for asked in islice(_followed(services, requests, relative, standing), ALTERNATIVES):
        for turn, waits in _turns(services, asked, yielding, standing):
            tried.append(plan_arms(services, turn, waits, delay, cancel))
            failure = tried[-1].failure
            if failure is None or failure.reason in ENDS:
                return _of_all(tried, relative, [name for name in yielding if name in turn])
    return _of_all(tried, relative, [])


def _of_all(tried: Sequence[CellPlan], goals: Mapping[str, AtTool], gone: Sequence[str]) -> CellPlan:
    """The last plan, with what all of them cost."""
    last = tried[-1]
    notes = (*last.notes, *(f"{name}: gets out of the way" for name in gone)) if last.ok else last.notes
    return replace(
        last,
        rectangles=sum(plan.rectangles for plan in tried),
        distances=sum(plan.distances for plan in tried),
        tried=tuple(each for plan in tried for each in plan.tried),
        notes=notes,
        goals=goals if last.ok else {},
    )


def _followed(
    services: Services,
    requests: Mapping[str, PlanRequest],
    goals: Mapping[str, AtTool],
    standing: Mapping[str, FloatArray],
) -> Iterator[dict[str, PlanRequest]]:
    """Requests in which tools that follow have poses in the cell's frame."""
    leaders = list(dict.fromkeys(goal.arm for goal in goals.values() if goal.arm not in goals))
    led = [list(_ends(services, name, requests.get(name), standing)) for name in leaders]
    for chosen in product(*led):
        asked = dict(requests)
        at = dict[str, FloatArray]()
        for name, (request, tool) in zip(leaders, chosen, strict=True):
            at[name] = tool
            if request is not None:
                asked[name] = request
        for name, goal in goals.items():
            at[name] = at[goal.arm] @ goal.pose.matrix
            asked[name] = replace(asked[name], goal=Pose.from_matrix(at[name]))
        yield asked


def _ends(
    services: Services, name: str, request: PlanRequest | None, standing: Mapping[str, FloatArray]
) -> Iterator[tuple[PlanRequest | None, FloatArray]]:
    """A request with each of its goals alone, and where the tool is then."""
    robot = services.part(name).robot
    if request is None:
        home = services.joined({})[list(services.part(name).columns)]
        yield None, robot.tool_pose(standing.get(name, home))
        return
    for field, goal in request.named_goals():
        if isinstance(goal, PoseGoal):
            for pose in goal.poses()[:POSES]:
                yield replace(request, goal=pose), pose.matrix
        elif isinstance(goal, Pose):
            yield replace(request, goal=goal), goal.matrix
        else:
            q = joint_vector(f"requests[{name!r}].{field}", goal, robot)
            yield replace(request, goal=q), robot.tool_pose(q)


def _turns(
    services: Services,
    requests: Mapping[str, PlanRequest],
    yielding: Sequence[str],
    standing: Mapping[str, FloatArray],
) -> Iterator[tuple[dict[str, PlanRequest], dict[str, FloatArray]]]:
    """What is tried of arms that may end anywhere: all stand, then all may go, to the nearest place or to one each."""
    going = {name: request for name, request in requests.items() if name not in yielding}
    starts = {name: np.asarray(requests[name].start, dtype=np.float64) for name in yielding}
    yield going, {**standing, **starts}
    if not yielding:
        return
    every = {name: _refuges(services, name, requests, standing) for name in yielding}
    if not all(every.values()):
        return
    chosen = {name: tuple(rows) for name, rows in every.items()}
    yield {**requests, **{name: replace(requests[name], goal=rows) for name, rows in chosen.items()}}, {**standing}
    apart = {name: _far_first(services, name, rows) for name, rows in every.items()}
    for k in range(min(SINGLY, *map(len, apart.values()))):
        yield (
            {**requests, **{name: replace(requests[name], goal=rows[k]) for name, rows in apart.items()}},
            {**standing},
        )


def _refuges(
    services: Services, name: str, requests: Mapping[str, PlanRequest], standing: Mapping[str, FloatArray]
) -> list[FloatArray]:
    """Configurations at which an arm stands free while the others are at their starts, the nearest first."""
    part, request = services.part(name), requests[name]
    start, limits = np.asarray(request.start, dtype=np.float64), part.robot.around(request.start).limits
    rng = np.random.default_rng(request.seed)
    lower, upper = np.maximum(limits.lower, start - math.pi), np.minimum(limits.upper, start + math.pi)
    near = np.clip(start + NEARBY * rng.standard_normal((DRAWS // 2, len(start))), lower, upper)
    far = rng.uniform(lower, upper, (DRAWS // 2, len(start)))
    poses = [q for q in part.robot.poses.values() if np.all((limits.lower <= q) & (q <= limits.upper))]
    others: dict[str, ArrayLike] = {
        **standing,
        **{other: each.start for other, each in requests.items() if other != name},
    }
    checker, out = services.whole.checker, list[FloatArray]()
    base = services.joined({other: np.asarray(each, dtype=np.float64) for other, each in others.items()})

    def joined(q: FloatArray) -> FloatArray:
        whole = base.copy()
        whole[list(part.columns)] = q
        return whole

    for q in (*poses, *near, *far):
        moved = np.abs(q - start).max() > 1e-6
        if moved and checker.state_is_free(joined(q)):
            out.append(np.asarray(q))
    out.sort(key=lambda q: joint_distance(start.tolist(), q.tolist()))
    return out[:: max(1, len(out) // REFUGES)][:REFUGES]


def _far_first(services: Services, name: str, rows: Sequence[FloatArray]) -> list[FloatArray]:
    """Those first whose tool is farthest from the other arms' bases."""
    bases = [_base(services, other) for other in services.parts if other != name]
    robot = services.part(name).robot

    def far(q: FloatArray) -> float:
        at = robot.tool_pose(q)[:3, 3]
        return -min((float(np.linalg.norm(at - base)) for base in bases), default=0.0)

    return sorted(rows, key=far)


def _base(services: Services, name: str) -> FloatArray:
    """Where the first joint of an arm is."""
    robot, own = services.robot, services.part(name).columns
    first = next(k for k, body in enumerate(robot.bodies) if body.q_index in own)
    return np.array(robot.body_poses(robot.home)[first][9:])
