"""What the page shows, as a value: the configuration, the start and goal of the next plan, and what was planned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planner_service.cell import CellPlan
from planner_service.collision import CancelToken
from planner_service.constraints import Constraint
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.shapes import Box, Pose
from planner_service.kinematics.inverse import closest_configuration
from planner_service.planners import BalancedRRTConnect, planner_by_name
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Failure, PlanResult
from planner_service.planning.task_result import Segment, StepReport, TaskResult
from planner_service.presentation.page import Showable
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import places_on, plan_pick_place
from planner_service.timing.laws import TIMINGS, ToppRa
from planner_service.view.arms_shown import playback_of, segments_of
from planner_service.view.cell.edits import Cell
from planner_service.view.cell.surfaces import Hit
from planner_service.view.collision_report import CollisionReport, CollisionReporter
from planner_service.view.playback import Playback
from planner_service.view.regions import Kept

__all__ = ["Aim", "Choice", "Errand", "ViewState"]

PLAN_SECONDS = 10.0
"""Time limit of a plan made on the page."""

MAX_WAYPOINTS = 50

LEVEL = math.cos(math.radians(5.0))
"""Of the angle by which a surface may lean on which something is placed."""

SPOT = 1e-3
"""Metres: the edges of the box whose top stands for a spot that was pointed at."""


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
class Errand:
    """A pick-and-place that was asked for by pointing.

    Attributes:
        target: What to pick.
        support: The name of what it shall stand on; None as long as that is not known.
        poses: Where it may stand, in the base frame: as it is turned now, then by quarters.
    """

    target: Obstacle
    support: str | None = None
    poses: tuple[Pose, ...] = ()

    def still(self, before: Scene, now: Scene) -> Errand | None:
        """The errand in a scene that was edited: without its spot if that may be another; None without the target."""
        target = next((obstacle for obstacle in now.obstacles if obstacle.name == self.target.name), None)
        if target is None or self.support is None:
            return None if target is None else Errand(target)
        same = target == self.target and before.obstacle(self.support) in now.obstacles
        return self if same else Errand(target)

    def at(self, hit: Hit) -> Errand:
        """The errand with a spot to place it at.

        Raises:
            InvalidRequest: nothing can stand there.
        """
        if hit.name == self.target.name:
            raise InvalidRequest("place", hit.name, "a surface of another obstacle than the one that is picked")
        if hit.normal[2] < LEVEL:
            raise InvalidRequest("place", f"a side of {hit.name}", "a surface that is level")
        x, y, z = hit.point.tolist()
        spot = Obstacle("spot", Box((SPOT, SPOT, SPOT)), Pose((x, y, z - SPOT / 2.0)))
        return replace(self, support=hit.name, poses=places_on(self.target, spot))


@dataclass(frozen=True, eq=False)
class ViewState:
    """What the page shows.

    Attributes:
        base: Plans in the scene as it is before any motion: that of the cell.
        cell: That scene, and what is selected and can be undone in it.
        service: Plans for the robot and the scene as they are now, on the way of a task.
        reporter: Reports collisions for that service.
        q: The configuration shown, (n,).
        start, goal: Start and goal of the next plan, each (n,).
        waypoints: Configurations between them, each (n,), at which the next plan stops.
        seconds: Where q is on the playback's clock; None if the robot was moved by hand.
        playback: The motions, None if there are none.
        results: The plans, each with its name.
        failure: Why there is no plan, or no complete task.
        kept: The constraints of the motion shown, or of the plan that failed; None if there are none.
        wanted: The constraints of the next plan, where they are others than those of what is shown.
        errand: What is to be picked, and where it shall stand; None if nothing is.
        aim: Where the handles of the goal were dragged to; None if they are at its tool.
        saved: What a file of the plan or task holds; None if there is neither, or its world is not known.
    """

    base: PlannerService
    cell: Cell
    service: PlannerService
    reporter: CollisionReporter
    q: FloatArray
    start: FloatArray
    goal: FloatArray
    waypoints: tuple[FloatArray, ...] = ()
    seconds: float | None = None
    playback: Playback | None = None
    results: tuple[Segment, ...] = ()
    failure: Failure | None = None
    kept: Kept | None = None
    wanted: tuple[Constraint, ...] | None = None
    errand: Errand | None = None
    aim: Aim | None = None
    saved: SavedPlan | SavedTask | None = None

    @classmethod
    def of(cls, service: PlannerService, shown: Showable | CellPlan | None = None) -> ViewState:
        """The beginning of a plan or a task; the robot at home if there is none.

        Raises:
            InvalidRequest: ``shown`` is something else, or has another number of joints.
        """
        home = read_only(service.robot.home)
        cell = Cell(service.scene)
        state = cls(service, cell, service, CollisionReporter(service), home, home, home)
        if shown is None:
            return state
        if isinstance(shown, PlanResult):
            return state._with_result(shown)
        if isinstance(shown, TaskResult | SavedTask):
            return state._with_task(service, shown)
        if isinstance(shown, CellPlan):
            return state._with_arms(shown)
        raise InvalidRequest("shown", shown, "a PlanResult, a TaskResult, a SavedTask, a CellPlan or None")

    def _with_arms(self, plan: CellPlan) -> ViewState:
        robot = self.service.robot
        if len(plan.still) != robot.n:
            raise InvalidRequest(
                "shown", f"a plan of {len(plan.still)} joints", f"one of the {robot.n} of {robot.name}"
            )
        named = segments_of(plan, robot.gripper_width)
        state = replace(self, results=named, failure=plan.failure, q=self._within(plan.still))
        return state._with_playback(playback_of(self.service, plan))

    def _with_task(self, service: PlannerService, shown: TaskResult | SavedTask) -> ViewState:
        _require_joints(self.service, [segment.result for segment in shown.segments])
        saved = SavedTask.of(shown) if isinstance(shown, TaskResult) else shown
        results, playback = tuple(shown.segments), Playback.of_task(service, shown.segments)
        state = replace(self, results=results, failure=shown.failure, saved=saved, seconds=None, playback=None)
        return replace(state, wanted=None, aim=None)._with_playback(playback)

    def _with_result(self, result: PlanResult) -> ViewState:
        _require_joints(self.service, [result])
        named = (Segment("plan", result, self.service.robot.gripper_width),)
        saved = None if result.origin is None else SavedPlan.of(result)
        state = replace(self, results=named, failure=result.failure, seconds=None, playback=None, saved=saved, aim=None)
        state = replace(state, wanted=None)
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

    def with_cell(self, cell: Cell) -> ViewState:
        """Another cell, or another obstacle selected; motions planned in another scene are shown no longer."""
        if cell.scene is self.cell.scene:
            return replace(self, cell=cell)
        base = self.base.changed(scene=cell.scene)
        errand = None if self.errand is None else self.errand.still(self.cell.scene, cell.scene)
        return replace(
            self, base=base, cell=cell, service=base, reporter=CollisionReporter(base), seconds=None, playback=None,
            results=(), failure=None, kept=None, wanted=self.keeping, saved=None, errand=errand,
        )  # fmt: skip

    @property
    def steps(self) -> tuple[StepReport, ...]:
        """How the steps of the task that is shown fared; none if it is no task of steps."""
        return self.saved.steps if isinstance(self.saved, SavedTask) else ()

    @property
    def keeping(self) -> tuple[Constraint, ...]:
        """The constraints of the next plan."""
        if self.wanted is not None:
            return self.wanted
        return () if self.kept is None else self.kept.constraints.constraints

    @property
    def drawn(self) -> Kept | None:
        """The constraints to draw: of the next plan, if they are others than those of what is shown."""
        if self.wanted is None:
            return self.kept
        return Kept.of(self.service.robot, self.wanted, np.stack([self.start, self.goal]))

    def with_constraints(self, constraints: Sequence[Constraint]) -> ViewState:
        """The next plan keeps these constraints, and no others.

        Raises:
            InvalidRequest: the robot has none of the links or joints that they name.
        """
        state = replace(self, wanted=tuple(constraints))
        state.drawn  # noqa: B018 - refuses what does not fit the robot
        return state

    def with_waypoint(self) -> ViewState:
        """The next plan stops at the configuration shown before it goes to the goal.

        Raises:
            InvalidRequest: there are too many.
        """
        if len(self.waypoints) >= MAX_WAYPOINTS:
            raise InvalidRequest("waypoints", len(self.waypoints) + 1, f"at most {MAX_WAYPOINTS}")
        return replace(self, waypoints=(*self.waypoints, self.q))

    def picking(self, target: str) -> ViewState:
        """An obstacle that the next task picks, to be placed at a spot that is not known yet.

        Raises:
            UnknownName: there is no such obstacle.
        """
        return replace(self, errand=Errand(self.cell.scene.obstacle(target)))

    def placing(self, hit: Hit) -> ViewState:
        """Where the next task places what it picks; nothing changes if nothing is to be picked.

        Raises:
            InvalidRequest: nothing can stand there.
        """
        return self if self.errand is None else replace(self, errand=self.errand.at(hit))

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
    def tool_of_start(self) -> Pose:
        """Where the tool is at the start, in the base frame."""
        return Pose.from_matrix(self.service.robot.tool_pose(self.start))

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
        """The plan from start to goal as chosen, with its search trace; by the waypoints if there are any, as a task.

        Raises:
            InvalidRequest: there is no such planner, it keeps no constraints but there are some, or a wrong seed.
        """
        request = self._request(choice)
        if not self.waypoints:
            return self._with_result(self.service.plan(request, cancel=cancel, trace=True))
        service, stops = self.service, (self.start, *self.waypoints, self.goal)
        names = ("start", *(f"waypoint {k}" for k in range(1, len(stops) - 1)), "goal")
        segments, failure, q = list[Segment](), None, self.start
        for k, (begin, end) in enumerate(pairwise(stops)):
            result = service.plan(replace(request, start=begin, goal=end), cancel=cancel, trace=True)
            segments.append(Segment(f"{names[k]} -> {names[k + 1]}", result, service.robot.gripper_width))
            failure = result.failure
            if failure is not None:
                break
            q = end
        task = f"by {len(self.waypoints)} waypoints"
        done = TaskResult(tuple(segments), service.world, q, failure, request=request, task=task)
        return self._with_task(service, done)

    def performed(self, choice: Choice, cancel: CancelToken | None = None) -> ViewState:
        """The pick-and-place of ``errand`` from the start and back to it, with constraints and settings as chosen.

        Raises:
            InvalidRequest: it is not known what to pick and where to place it, or the robot has no gripper.
        """
        errand = self.errand
        if errand is None or errand.support is None:
            raise InvalidRequest("errand", errand, "an obstacle to pick and a spot to place it")
        target, onto, request = errand.target.name, errand.support, self._request(choice)
        done = plan_pick_place(self.base, target, onto, request, poses=errand.poses, cancel=cancel)
        return self._with_task(self.base, done)

    def _request(self, choice: Choice) -> PlanRequest:
        return PlanRequest(
            self.start,
            self.goal,
            planner_by_name(choice.planner),
            TIMINGS[choice.timing](),
            seed=choice.seed,
            time_limit=PLAN_SECONDS,
            velocity_scale=choice.velocity_scale,
            acceleration_scale=choice.acceleration_scale,
            constraints=self.keeping,
        )


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
