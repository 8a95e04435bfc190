"""What the page shows, as a value: the configuration, the start and goal of the next plan, and what was planned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner_service.collision import CancelToken
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.shapes import Pose
from planner_service.kinematics.inverse import closest_configuration
from planner_service.planners import BalancedRRTConnect, planner_by_name
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult
from planner_service.planning.task_result import Segment, TaskResult
from planner_service.presentation.page import Showable
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.service import PlannerService
from planner_service.timing.laws import TIMINGS, ToppRa
from planner_service.view.collision_report import CollisionReport, CollisionReporter
from planner_service.view.playback import Playback
from planner_service.view.regions import Kept

__all__ = ["Aim", "Choice", "ViewState"]

PLAN_SECONDS = 10.0
"""Time limit of a plan made on the page."""


@dataclass(frozen=True)
class Choice:
    """How the next plan is made: the names of planner and timing law, the seed, and shares of the limits."""

    planner: str = BalancedRRTConnect.name
    timing: str = ToppRa.name
    seed: int = 0
    velocity_scale: float = 1.0
    acceleration_scale: float = 1.0


@dataclass(frozen=True)
class Aim:
    """A tool pose that the goal was dragged to, in the base frame, and whether the tool reaches it there."""

    pose: Pose
    reached: bool


@dataclass(frozen=True, eq=False)
class ViewState:
    """What the page shows.

    Attributes:
        service: Plans for the robot and the scene as they are now.
        reporter: Reports collisions for that service.
        q: The configuration shown, (n,).
        start, goal: Start and goal of the next plan, each (n,).
        seconds: Where q is on the playback's clock; None if the robot was moved by hand.
        playback: The motions, None if there are none.
        results: The plans, each with its name.
        failure: Why there is no plan, or no complete task.
        kept: The constraints of the motion shown, or of the plan that failed; None if there are none.
        aim: Where the handles of the goal were dragged to; None if they are at its tool.
        saved: What a file of the plan or task holds; None if there is neither, or its world is not known.
    """

    service: PlannerService
    reporter: CollisionReporter
    q: FloatArray
    start: FloatArray
    goal: FloatArray
    seconds: float | None = None
    playback: Playback | None = None
    results: tuple[Segment, ...] = ()
    failure: Failure | None = None
    kept: Kept | None = None
    aim: Aim | None = None
    saved: SavedPlan | SavedTask | None = None

    @classmethod
    def of(cls, service: PlannerService, shown: Showable | None = None) -> ViewState:
        """The beginning of a plan or a task; the robot at home if there is none.

        Raises:
            InvalidRequest: ``shown`` is something else, or has another number of joints.
        """
        home = read_only(service.robot.home)
        state = cls(service, CollisionReporter(service), home, home, home)
        if shown is None:
            return state
        if isinstance(shown, PlanResult):
            return state._with_result(shown)
        if isinstance(shown, TaskResult | SavedTask):
            _require_joints(service, [segment.result for segment in shown.segments])
            playback = Playback.of_task(service, shown.segments)
            saved = SavedTask.of(shown) if isinstance(shown, TaskResult) else shown
            state = replace(state, results=tuple(shown.segments), failure=shown.failure, saved=saved)
            return state._with_playback(playback)
        raise InvalidRequest("shown", shown, "a PlanResult, a TaskResult, a SavedTask or None")

    def _with_result(self, result: PlanResult) -> ViewState:
        _require_joints(self.service, [result])
        named = (Segment("plan", result, self.service.robot.gripper_width),)
        saved = None if result.origin is None else SavedPlan.of(result)
        state = replace(self, results=named, failure=result.failure, seconds=None, playback=None, saved=saved, aim=None)
        request = None if result.origin is None else result.origin.request
        if request is not None:
            start = self._within(np.array(request.start))
            state = replace(state, start=start, q=start, goal=self._within(_goal(request, self)))
            kept = Kept.of(self.service.robot, result.constraints, np.stack([state.start, state.goal]))
            state = replace(state, kept=kept)
        return state._with_playback(Playback.of_result(self.service, result))

    def _with_playback(self, playback: Playback | None) -> ViewState:
        if playback is None:
            return self
        start, goal = playback.ends
        return replace(self, playback=playback, start=start, goal=goal).at(0.0)

    def _within(self, q: FloatArray) -> FloatArray:
        return read_only(np.clip(q, *self.service.robot.bounds))

    def at(self, seconds: float) -> ViewState:
        """The playback at a time on its clock, with what the robot then carries; NaN changes nothing."""
        if self.playback is None or math.isnan(seconds):
            return self
        seconds = min(max(seconds, 0.0), self.playback.duration)
        frame = self.playback.at(seconds)
        clip = frame.clip
        q = self._within(frame.q)
        return replace(self, service=clip.service, reporter=clip.reporter, q=q, seconds=seconds, kept=clip.kept)

    def posed(self, q: Sequence[float] | FloatArray) -> ViewState:
        """The robot moved by hand to q (n,), kept within its limits; a joint given as NaN stays."""
        moved = np.array(q, dtype=np.float64)
        return replace(self, q=self._within(np.where(np.isnan(moved), self.q, moved)), seconds=None)

    def with_start(self) -> ViewState:
        """The next plan starts at the configuration shown."""
        return replace(self, start=self.q)

    def with_goal(self) -> ViewState:
        """The next plan ends at the configuration shown."""
        return replace(self, goal=self.q, aim=None)

    def aimed(self, pose: Pose) -> ViewState:
        """The next plan ends with the tool at a pose, or as near as the search from the last goal comes to it."""
        goal, arrived = closest_configuration(self.service.robot.around(self.goal), pose, self.goal)
        return replace(self, goal=goal, aim=Aim(pose, reached=arrived))

    def released(self) -> ViewState:
        """The handles of the goal are back at its tool."""
        return replace(self, aim=None)

    @property
    def tool_of_goal(self) -> Pose:
        """Where the handles of the goal are, in the base frame."""
        return Pose.from_matrix(self.service.robot.tool_pose(self.goal)) if self.aim is None else self.aim.pose

    @property
    def goal_objection(self) -> str:
        """Why the next plan cannot end at the goal, for a person; empty if nothing is known against it."""
        if self.aim is not None and not self.aim.reached:
            return "not reached by the tool"
        contacts = self.reporter.report(self.goal).contacts
        return ", ".join(f"{contact.a} × {contact.b}" for contact in contacts)

    @property
    def report(self) -> CollisionReport:
        """Contacts and clearance of the configuration shown."""
        expected = frozenset[tuple[str, str]]()
        if self.playback is not None and self.seconds is not None:
            expected = self.playback.at(self.seconds).expected
        return self.reporter.report(self.q, expected)

    def planned(self, choice: Choice, cancel: CancelToken | None = None) -> ViewState:
        """The plan from start to goal as chosen, with its search trace; it keeps what ``kept`` does.

        Raises:
            InvalidRequest: there is no such planner, it keeps no constraints but there are some, or a wrong seed.
        """
        constraints = () if self.kept is None else self.kept.constraints.constraints
        request = PlanRequest(
            self.start,
            self.goal,
            planner_by_name(choice.planner),
            TIMINGS[choice.timing](),
            seed=choice.seed,
            time_limit=PLAN_SECONDS,
            velocity_scale=choice.velocity_scale,
            acceleration_scale=choice.acceleration_scale,
            constraints=constraints,
        )
        return self._with_result(self.service.plan(request, cancel=cancel, trace=True))


def _goal(request: PlanRequest, state: ViewState) -> FloatArray:
    """The first goal that is a configuration; the state's goal if all of them are tool poses."""
    goals = request.goals(state.service.robot)
    return next((np.asarray(goal) for goal in goals if isinstance(goal, np.ndarray)), state.goal)


def _require_joints(service: PlannerService, results: Sequence[PlanResult]) -> None:
    n = service.robot.n
    for result in results:
        if result.path is not None and result.path.n != n:
            expected = f"one of {service.robot.name}'s {n}"
            message = f"shown: got a plan of {result.path.n} joints; expected {expected}"
            raise InvalidRequest("shown", result, expected, message=message)
