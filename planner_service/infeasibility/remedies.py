"""What would help where there is no plan: small changes, each of which was tried and gives a proven plan.

Candidates come cheapest first: an end that touches something is left or moved out of it, the tool is turned, a
constraint is relaxed, an object is moved just far enough, and last an object is taken away. A candidate whose
ends still collide is not planned. What is spent is a number of plans, so the answer is the same on every machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TypeVar

import numpy as np

from planner_service.certify import MAX_OVERLAP
from planner_service.collision import CollisionChecker
from planner_service.constraints.values import Constraint, ToolRegion
from planner_service.decomposition.no_path import NoPath
from planner_service.geometry.arrays import FloatArray, product
from planner_service.geometry.shapes import Pose
from planner_service.infeasibility.reached import Reached
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult, Reason, Stage
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Obstacle, Scene

__all__ = ["SEARCHED", "Clock", "Explanation", "Remedy", "find_remedies"]

MOVES = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
"""Metres by which an object is moved; between the last that fails and the first that helps it is halved."""

HALVINGS = 4

DEEPER = 1e-4
"""Metres by which a moved object may stand deeper in another: bounds on depths are no finer."""

DIRECTIONS = {
    "up": (0.0, 0.0, 1.0),
    "along +x": (1.0, 0.0, 0.0),
    "along -x": (-1.0, 0.0, 0.0),
    "along +y": (0.0, 1.0, 0.0),
    "along -y": (0.0, -1.0, 0.0),
    "down": (0.0, 0.0, -1.0),
}

TURNS = (0.1, 0.2, 0.4, 0.8)
"""Radians by which the tool is turned at its goal, about each of its own axes."""

RELAXED = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Radians to which a tilt is relaxed."""

BLAMED = 4
"""Objects that are moved or taken away."""

REMOVALS = BLAMED + 1
"""Plans that the other steps leave for the last: taking each of these objects away, and all."""

TRY_CHECKS, MORE_CHECKS = 20_000, 200_000
"""States that a try may check, if the request does not allow fewer; and where more of them are the remedy."""

SEARCHED = (Reason.PLANNING_FAILED, Reason.TIMED_OUT, Reason.CHECK_BUDGET_EXHAUSTED)

SHOWN = 16
"""Configurations of a goal shown with what each collides with."""

T = TypeVar("T")

Planned = Callable[[PlanRequest, Scene], PlanResult]
Tell = Callable[[int, int], None] | None


class OutOfTime(Exception):
    """The time limit of an explanation has passed."""


class Clock:
    """What is left of a time limit.

    Attributes:
        in_time: Whether nothing was ended by it so far.
    """

    def __init__(self, seconds: float | None) -> None:
        self._end = None if seconds is None else time.monotonic() + seconds
        self.in_time = True

    def require(self) -> None:
        """Raise if it is over.

        Raises:
            OutOfTime: It is.
        """
        if self._end is not None and time.monotonic() >= self._end:
            self.in_time = False
            raise OutOfTime

    def hurried(self, request: PlanRequest) -> PlanRequest:
        """A request with no more time than is left."""
        if self._end is None:
            return request
        left = max(0.0, self._end - time.monotonic())
        return replace(request, time_limit=left if request.time_limit is None else min(left, request.time_limit))

    def unless_over(self, act: Callable[[Callable[[int], None]], T], charge: Callable[[int], None]) -> T | None:
        """What ``act`` returns, which charges all the while; None if the time is over before."""

        def polled(number: int) -> None:
            charge(number)
            self.require()

        try:
            return act(polled)
        except OutOfTime:
            return None


@dataclass(frozen=True, eq=False)
class Remedy:
    """A change that gives a plan.

    Attributes:
        text: What to do, such as "move wine_glass up by 21 mm".
        request: The request with it.
        scene: The scene with it.
        result: The plan that it gives, proven as any.
    """

    text: str
    request: PlanRequest
    scene: Scene
    result: PlanResult

    def __str__(self) -> str:
        return self.text


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why there is no plan, and what helps.

    Attributes:
        result: The outcome of the request as it is.
        no_path: The proof that there is no path at all, if one was found.
        remedies: Changes that give a plan, cheapest first; none if there is a plan, or nothing that was tried helps.
        plans: How many plans were tried.
        reached: How far the search came, if there was one and its planner says what it grew.
        way: A proven plan along a way that dividing joint space found and the search did not, for robots of up to four
            joints; it may keep less than the padding. Its ``goal_index`` says which goal it reaches.
        complete: False if a time limit ended it.
    """

    result: PlanResult
    no_path: NoPath | None
    remedies: tuple[Remedy, ...]
    plans: int
    reached: Reached | None = None
    way: PlanResult | None = None
    complete: bool = True

    @property
    def proven(self) -> bool:
        """Whether it is certain that no plan exists."""
        return self.result.failure is not None and self.result.failure.proven

    def __str__(self) -> str:
        if self.result.failure is None:
            return "there is a plan"
        lines = [f"no plan: {self.result.failure}"]
        told = self.no_path is None or str(self.no_path) in lines[0]
        lines += [] if told else [str(self.no_path)]
        lines += ["proven: no plan exists for this request"] if self.proven else []
        lines += [f"it would end at {one}" for one in self.result.failure.colliding[:SHOWN]]
        more = len(self.result.failure.colliding) - SHOWN
        lines += [f"and so on: {more} more configurations, all in collision"] if more > 0 else []
        lines += [] if self.reached is None else [str(self.reached)]
        lines += [] if self.way is None else [f"yet a way was found by dividing joint space: {_told(self.way)}"]
        lines += [f"this helps: {remedy}" for remedy in self.remedies]
        lines += [] if self.remedies else [f"nothing that was tried helps ({self.plans} plans)"]
        return "\n".join(lines if self.complete else [*lines, "the time limit passed before everything was tried"])


def _told(way: PlanResult) -> str:
    assert way.certificate is not None
    assert way.trajectory is not None
    return f"{way.trajectory.duration:.1f} s, at least {way.certificate.clearance * 1e3:.2f} mm clear"


class _Spent(Exception):
    """The plans that a step may try are used up."""


class _Enough(Exception):
    """Enough remedies are found."""


class _Trials:
    """Plans tried, without those saved for later steps, and what helped."""

    def __init__(self, robot: Robot, planned: Planned, plans: int, enough: int, clock: Clock, tell: Tell) -> None:
        self.robot, self._planned, self._left, self._enough = robot, planned, plans, enough
        self._clock, self._tell = clock, tell
        self.plans = self.saved = 0
        self.found: list[Remedy] = []

    def gives(self, request: PlanRequest, scene: Scene, checks: int = TRY_CHECKS) -> PlanResult | None:
        """The plan that a change gives, if it gives one."""
        if self.plans >= self._left - self.saved:
            raise _Spent
        self._clock.require()
        self.plans += 1
        if self._tell is not None:
            self._tell(self.plans, self._left)
        checks = min(request.max_checks, checks)
        result = self._planned(replace(request, max_checks=checks, time_limit=None), scene)
        return result if result.ok else None

    def keep(self, text: str, request: PlanRequest, scene: Scene, result: PlanResult) -> None:
        self.found.append(Remedy(text, request, scene, result))
        if len(self.found) == self._enough:
            raise _Enough

    def offer(self, text: str, request: PlanRequest, scene: Scene) -> bool:
        """Try a change and keep it if it helps."""
        result = self.gives(request, scene)
        if result is not None:
            self.keep(text, request, scene, result)
        return result is not None


def find_remedies(
    robot: Robot,
    request: PlanRequest,
    scene: Scene,
    failure: Failure,
    planned: Planned,
    *,
    plans: int,
    enough: int,
    hopeless: bool,
    clock: Clock,
    tell: Tell = None,
) -> tuple[tuple[Remedy, ...], int]:
    """Changes to a request or its scene that give a plan, and how many plans were tried.

    Args:
        planned: Plans a request in a scene.
        plans: How many plans may be tried.
        enough: How many remedies are looked for.
        hopeless: Whether it is proven that no path exists, so that searching on is no use.
        clock: Ends it.
        tell: Told before each plan how many there are with it, and how many may be tried.
    """
    trials = _Trials(robot, planned, plans, enough, clock, tell)
    steps = [_searched_longer] if failure.reason in SEARCHED and not hopeless else []
    steps += [_left_start, _moved_end, _turned, _relaxed]
    steps += [_moved_objects, _without_objects] if failure.reason is not Reason.NO_IK_SOLUTION else []
    kept = min(REMOVALS, plans // 2) if _without_objects in steps else 0
    for step in steps:
        trials.saved = 0 if step is _without_objects else kept
        try:
            step(request, scene, failure, trials)
        except _Spent:
            continue
        except (_Enough, OutOfTime):
            break
    return tuple(trials.found), trials.plans


def _searched_longer(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """The same request with more checks and no clock."""
    longer = replace(request, max_checks=max(request.max_checks, MORE_CHECKS), time_limit=None)
    result = trials.gives(longer, scene, MORE_CHECKS)
    if result is not None:
        trials.keep(f"search on: {result.counts.states:,} states without a time limit suffice", longer, scene, result)


def _left_start(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """A start that collides, left by a way out."""
    if failure.reason is Reason.START_IN_COLLISION and failure.contacts:
        enough = math.ceil(1e4 * failure.contacts[0].depth + 1e-3) / 1e4
        if request.start_overlap < enough <= MAX_OVERLAP:
            text = f"begin with a way out of the collision, with start_overlap={enough:g}"
            trials.offer(text, replace(request, start_overlap=enough), scene)


def _moved_end(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """The end that collides, moved to the nearest free configuration."""
    if failure.nearest_free is None:
        return
    near, start = failure.nearest_free, failure.reason is Reason.START_IN_COLLISION
    text = f"{'start from' if start else 'go to'} {np.round(near, 4).tolist()}, the nearest free configuration found"
    trials.offer(text, replace(request, start=near) if start else replace(request, goal=near), scene)


def _turned(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """The tool turned at its goal."""
    if not isinstance(request.goal, Pose):
        return
    why = failure.unreachable
    if why is not None and why.suggestion is not None:
        trials.offer(f"the goal {why.suggestion}", replace(request, goal=why.suggestion.pose), scene)
    if why is not None:
        near = np.round(why.nearest, 4).tolist()
        trials.offer(f"go to {near}, which comes nearest", replace(request, goal=why.nearest), scene)
    T = request.goal.matrix
    for angle in TURNS:
        for axis, name in enumerate("xyz"):
            for sign in (1.0, -1.0):
                goal = Pose.from_matrix(product(T, _about(axis, sign * angle)))
                text = f"turn the tool by {sign * angle:g} rad about its {name}"
                if trials.offer(text, replace(request, goal=goal), scene):
                    return


def _about(axis: int, angle: float) -> FloatArray:
    T, (i, j) = np.eye(4), [(1, 2), (2, 0), (0, 1)][axis]
    T[i, i] = T[j, j] = math.cos(angle)
    T[j, i] = math.sin(angle)
    T[i, j] = -T[j, i]
    return T


def _relaxed(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """Each constraint on a tilt relaxed; each constraint left out."""
    for k, constraint in enumerate(request.constraints):
        rest = request.constraints[:k], request.constraints[k + 1 :]
        if isinstance(constraint, ToolRegion) and constraint.tilt is not None:
            for tilt in (angle for angle in RELAXED if angle > 1.2 * constraint.tilt):
                turn = constraint.turn if tilt <= math.pi / 2 else None
                wider = (*rest[0], _region(constraint, tilt=tilt, turn=turn), *rest[1])
                if trials.offer(f"relax {constraint.name} to {tilt:g} rad", replace(request, constraints=wider), scene):
                    break
    for k, constraint in enumerate(request.constraints):
        fewer = (*request.constraints[:k], *request.constraints[k + 1 :])
        trials.offer(f"leave out {_called(constraint)}", replace(request, constraints=fewer), scene)


def _region(region: ToolRegion, **changes: object) -> ToolRegion:
    return ToolRegion(**{item.name: getattr(region, item.name) for item in fields(ToolRegion)} | changes)


def _called(constraint: Constraint) -> str:
    return constraint.name if isinstance(constraint, ToolRegion) else f"the range of {constraint.joint}"


def _moved_objects(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """Objects in the way, each moved just far enough and not into others, the shortest move first."""
    blamed = list(_blamed(scene, failure))
    stood = {one.name: _overlaps(trials.robot, request, scene, one) for one in blamed}
    helped = set[str]()
    for before, distance in zip((0.0, *MOVES), MOVES, strict=False):
        for direction, axis in DIRECTIONS.items():
            for one in blamed:
                moved = _with_moved(scene, one, axis, distance)
                if one.name in helped or not _has_room(trials.robot, request, moved, one.name, stood[one.name]):
                    continue
                result = trials.gives(request, moved)
                if result is not None:
                    helped.add(one.name)
                    shift = partial(_with_moved, scene, one, axis)
                    least, result = _least(request, trials, shift, before, distance, result)
                    if _has_room(trials.robot, request, shift(least), one.name, stood[one.name]):
                        text = f"move {one.name} {direction} by {least * 1e3:.0f} mm"
                        trials.keep(text, request, shift(least), result)


def _least(
    request: PlanRequest,
    trials: _Trials,
    moved: Callable[[float], Scene],
    low: float,
    high: float,
    result: PlanResult,
) -> tuple[float, PlanResult]:
    """The least distance that helps, in whole millimetres, between one that does not and one that does."""
    for _ in range(HALVINGS):
        middle = math.ceil(500.0 * (low + high)) / 1e3
        if not low < middle < high:
            break
        try:
            better = trials.gives(request, moved(middle))
        except _Spent:
            break
        low, high, result = (low, middle, better) if better is not None else (middle, high, result)
    return high, result


def _overlaps(robot: Robot, request: PlanRequest, scene: Scene, one: Obstacle) -> dict[str, float]:
    """How deep an obstacle stands in others, in metres, at most: it is judged as if the tool held it there."""
    q = np.clip(request.start, *robot.bounds)
    in_tool = product(Pose.from_matrix(robot.tool_pose(q)).inverse().matrix, one.pose.matrix)
    held = Attached(one.name, one.shape, Pose.from_matrix(in_tool))
    others = tuple(other for other in scene.obstacles if other.name != one.name)
    checker = CollisionChecker(robot, Scene(others, attached=(held,)))
    pairs = {frozenset((contact.a, contact.b)): contact.depth for contact in checker.contacts(q)}
    return {other.name: pairs[pair] for other in others if (pair := frozenset((one.name, other.name))) in pairs}


def _has_room(robot: Robot, request: PlanRequest, scene: Scene, name: str, before: dict[str, float]) -> bool:
    """Whether a moved obstacle stands in no other one deeper than it did."""
    now = _overlaps(robot, request, scene, scene.obstacle(name))
    return all(depth <= before.get(other, 0.0) + DEEPER for other, depth in now.items())


def _with_moved(scene: Scene, one: Obstacle, axis: tuple[float, float, float], distance: float) -> Scene:
    x, y, z = (p + distance * d for p, d in zip(one.pose.position, axis, strict=True))
    moved = replace(one, pose=Pose((x, y, z), one.pose.quaternion))
    return replace(scene, obstacles=tuple(moved if other is one else other for other in scene.obstacles))


def _without_objects(request: PlanRequest, scene: Scene, failure: Failure, trials: _Trials) -> None:
    """Objects in the way taken away, one at a time; all of them where none suffices."""
    blamed, helped = list(_blamed(scene, failure)), False
    for one in blamed:
        rest = tuple(other for other in scene.obstacles if other is not one)
        helped |= trials.offer(f"remove {one.name}", request, replace(scene, obstacles=rest))
    if len(blamed) > 1 and not helped:
        rest = tuple(other for other in scene.obstacles if other not in blamed)
        names = ", ".join(one.name for one in blamed)
        trials.offer(f"remove {names}", request, replace(scene, obstacles=rest))


def _blamed(scene: Scene, failure: Failure) -> Iterator[Obstacle]:
    """The obstacles that are in the way, the most so first; all, if nothing is known of them."""
    named = [name for contact in failure.contacts for name in (contact.a, contact.b)]
    named += [name for a, b, _ in failure.blocked_by for name in (a, b)]
    order = list(dict.fromkeys(name.removesuffix(" (object)") for name in named))
    known = [obstacle for name in order for obstacle in scene.obstacles if obstacle.name == name]
    rest = [obstacle for obstacle in scene.obstacles if obstacle not in known]
    search = failure.stage is not Stage.ENDPOINTS
    yield from (known + rest if search or not known else known)[:BLAMED]
