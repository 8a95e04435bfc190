"""What a page shows, as a value: where the robot stands, from where to where it is to go, and what was planned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.geometry.shapes import FloatArray, read_only
from planner_service.path.joint_path import JointPath
from planner_service.planners import planner_by_name
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult
from planner_service.presentation.page import Showable
from planner_service.records.plan_file import SavedTask
from planner_service.service import PlannerService
from planner_service.tasks.result import Segment, TaskResult
from planner_service.view.collision_report import Eye, Look
from planner_service.view.playback import Reel

__all__ = ["ViewState"]

PLAN_SECONDS = 10.0
"""That a plan asked for on the page may take."""

TRACED_SECONDS = 1.0
"""That a plan may have taken which is planned once more to see how its search went."""


@dataclass(frozen=True, eq=False)
class ViewState:
    """What a page shows.

    Attributes:
        service: Plans for the robot and the scene as they are now.
        eye: Judges for it.
        q: Where the robot stands, (n,).
        start, goal: From where to where the next plan is to go, each (n,).
        seconds: Where on the reel that is; None if the robot was moved by hand.
        reel: The motions, None without any.
        results: What was planned, each with its name.
        failure: Why there is no plan, or no whole task.
    """

    service: PlannerService
    eye: Eye
    q: FloatArray
    start: FloatArray
    goal: FloatArray
    seconds: float | None = None
    reel: Reel | None = None
    results: tuple[Segment, ...] = ()
    failure: Failure | None = None

    @classmethod
    def of(cls, service: PlannerService, shown: Showable | None = None) -> ViewState:
        """What is to be seen of a plan or a task, at its beginning; without one the robot at home.

        Raises:
            InvalidRequest: it is neither, or of another number of joints.
        """
        home = read_only(service.robot.home)
        state = cls(service, Eye(service), home, home, home)
        if shown is None:
            return state
        if isinstance(shown, PlanResult):
            return state._with_result(shown)
        if isinstance(shown, TaskResult | SavedTask):
            _require_joints(service, [segment.result for segment in shown.segments])
            reel = Reel.of_task(service, shown.segments)
            return replace(state, results=tuple(shown.segments), failure=shown.failure)._with_reel(reel)
        raise InvalidRequest("shown", shown, "a PlanResult, a TaskResult, a SavedTask or None")

    def _with_result(self, result: PlanResult) -> ViewState:
        _require_joints(self.service, [result])
        named = (Segment("plan", _traced(result), self.service.robot.gripper_width),)
        state = replace(self, results=named, failure=result.failure, seconds=None, reel=None)
        request = None if result.origin is None else result.origin.request
        if request is not None:
            start = self._within(np.array(request.start))
            state = replace(state, start=start, q=start, goal=self._within(_goal(request, self)))
        return state._with_reel(Reel.of_result(self.service, result))

    def _with_reel(self, reel: Reel | None) -> ViewState:
        if reel is None:
            return self
        start, goal = reel.ends
        return replace(self, reel=reel, start=start, goal=goal).at(0.0)

    def _within(self, q: FloatArray) -> FloatArray:
        limits = self.service.robot.limits
        return read_only(np.minimum(np.maximum(q, limits.lower), limits.upper))

    def at(self, seconds: float) -> ViewState:
        """The robot where it is on the reel after so many seconds, with what it then carries; NaN changes nothing."""
        if self.reel is None or math.isnan(seconds):
            return self
        seconds = min(max(seconds, 0.0), self.reel.duration)
        moment = self.reel.at(seconds)
        take = moment.take
        return replace(self, service=take.service, eye=take.eye, q=self._within(moment.q), seconds=seconds)

    def posed(self, q: Sequence[float] | FloatArray) -> ViewState:
        """The robot moved by hand to q (n,), within its limits; a joint at NaN stays."""
        moved = np.array(q, dtype=np.float64)
        return replace(self, q=self._within(np.where(np.isnan(moved), self.q, moved)), seconds=None)

    def with_start(self) -> ViewState:
        """The next plan starts where the robot stands."""
        return replace(self, start=self.q)

    def with_goal(self) -> ViewState:
        """The next plan ends where the robot stands."""
        return replace(self, goal=self.q)

    @property
    def look(self) -> Look:
        """What touches where the robot stands, and how much room is left."""
        meant = frozenset[tuple[str, str]]()
        if self.reel is not None and self.seconds is not None:
            meant = self.reel.at(self.seconds).meant
        return self.eye.look(self.q, meant)

    def planned(self, planner: str, seed: int, cancel: CancelToken | None = None) -> ViewState:
        """What a plan from start to goal with the planner of that name comes to.

        Raises:
            InvalidRequest: no such planner or seed.
        """
        request = PlanRequest(self.start, self.goal, planner_by_name(planner), seed=seed, time_limit=PLAN_SECONDS)
        return self._with_result(self.service.plan(request, cancel=cancel, trace=True))


def _traced(result: PlanResult) -> PlanResult:
    """The result with its trace; one that has none is planned once more if quick; the same has to come of it."""
    origin, quick = result.origin, result.deterministic and result.seconds < TRACED_SECONDS
    if result.trace is not None or origin is None or origin.request is None or not quick:
        return result
    again = PlannerService.of(origin.world).plan(origin.request, trace=True)
    return replace(result, trace=again.trace) if _same(result.path, again.path) else result


def _same(path: JointPath | None, other: JointPath | None) -> bool:
    """Whether two plans go the same way; one from a file may have been planned by another release."""
    if path is None or other is None:
        return path is other
    return np.array_equal(path.waypoints, other.waypoints)


def _goal(request: PlanRequest, state: ViewState) -> FloatArray:
    """The first goal that is a configuration; where the robot stands if they are all poses of the tool."""
    goals = request.goals(state.service.robot)
    return next((np.asarray(goal) for goal in goals if isinstance(goal, np.ndarray)), state.goal)


def _require_joints(service: PlannerService, results: Sequence[PlanResult]) -> None:
    n = service.robot.n
    for result in results:
        if result.path is not None and result.path.n != n:
            expected = f"one of {service.robot.name}'s {n}"
            message = f"shown: got a plan of {result.path.n} joints; expected {expected}"
            raise InvalidRequest("shown", result, expected, message=message)
