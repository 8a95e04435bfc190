"""Planning for one robot in one scene: a request goes in, a timed path and what it cost come out.

request -> ENDPOINTS -> STRAIGHT_LINE -> SEARCH -> SHORTCUT -> POLISH -> CERTIFY -> TIMING
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import Certificate, Certifier, ExemptInterval, GripperMotion
from planner_service.certify.gripper import GripperCertifier
from planner_service.certify.pairs import pairs_of_names
from planner_service.collision import CancelToken, CollisionChecker, EdgeStep, JointStep, MotionStep
from planner_service.collision.budget import Cancelled
from planner_service.concurrency.forks import renew_locks
from planner_service.concurrency.polling import Prepared
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import Composite
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import flag, instance, number, whole
from planner_service.kinematics.constraint_set import constraint_set
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.memory import Memory
from planner_service.path.joint_path import JointPath
from planner_service.planning.batch import Batch
from planner_service.planning.collision_recovery import NoWayOut, WayOut, find_way_out
from planner_service.planning.follow import AllowedStretch, FollowRequest, follow
from planner_service.planning.hull_contacts import only_for_hulls
from planner_service.planning.pipeline import plan, require_plannable
from planner_service.planning.request import Goal, Pace, PlanRequest, World, kept_in, torque_limits
from planner_service.planning.result import Origin, PlanResult, Reason
from planner_service.planning.roadmap_work import Grower, RoadmapUpdate, grow, require_grower, update
from planner_service.presentation.page import OpenPage, Showable, show_page
from planner_service.presentation.progress import bar
from planner_service.provided import Provided
from planner_service.roadmap import Roadmap, Terms
from planner_service.robot.inertia import Payload
from planner_service.robot.model import Robot, joint_vector
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from planner_service.search.problem import SearchOracle, require_seed
from planner_service.search.trace import Tracer
from planner_service.smoothing.smoothing import MIN_BLEND, shortcut
from planner_service.timing.laws import Trapezoidal
from planner_service.timing.torque_limits import TorqueLimits

if TYPE_CHECKING:
    from planner_service.decomposition.no_path import OpenWay
    from planner_service.infeasibility.remedies import Clock, Explanation
    from planner_service.parallel import Engine
    from planner_service.planning.task_result import TaskResult
    from planner_service.replanning.result import Replanned
    from planner_service.timing.laws import Timing

__all__ = ["PlannerService"]

T = TypeVar("T")

solve_task: Provided[..., TaskResult] = Provided()
"""Solves a task."""

MAX_WINDOWS = 4
"""Windows of continuous joints for which a service keeps a checker."""

MAX_WORLDS, FEW_PIECES = 8, 1_000
"""Worlds for which what services need is kept for the next service, and the pieces of obstacles up to which it is."""

os.register_at_fork(after_in_child=renew_locks)


class _Tools:
    """What judges and proves in one world: made once for all services of it, which count apart."""

    def __init__(self, robot: Robot, scene: Scene, edge_step: EdgeStep, allowed: tuple[tuple[str, str], ...]) -> None:
        self.checker = checker = CollisionChecker(robot, scene, edge_step=edge_step, allowed=allowed)
        self.certifier = Prepared(lambda: Certifier(robot, scene, allowed=allowed), quick=checker.quick)
        grips = partial(GripperCertifier, robot, scene, allowed=allowed)
        self.gripper_certifier = Prepared(grips, quick=checker.quick)


class _Same:
    """Stands for one object as a key, whatever it says that it equals."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and self.value is other.value

    def __hash__(self) -> int:
        return id(self.value)


@lru_cache(maxsize=MAX_WORLDS)
def _tools_of(
    robot: Robot, scene: _Same, edge_step: MotionStep | JointStep, allowed: tuple[tuple[str, str], ...], process: int
) -> _Tools:
    """Those of a world before, if they are of this process: a fork may have found them half made."""
    del process
    return _Tools(robot, scene.value, edge_step, allowed)


class PlannerService:
    """Plans motions of one robot in one scene, and counts what that costs.

    Several threads may use it at the same time: each call gets what it would get alone, counts included. After a fork,
    build a new one in the child.

    Args:
        robot: A robot, or the name or file of one (``load_robot``).
        scene: A scene, or the name or file of one (``load_scene``).
        edge_step: How finely edges are sampled; ``MotionStep(0.010)`` if not given.
        allowed: Pairs of link or object names that may touch, beside those the robot allows.
    """

    def __init__(
        self,
        robot: Robot | str | Path,
        scene: Scene | str | Path,
        *,
        edge_step: EdgeStep | None = None,
        allowed: Sequence[tuple[str, str]] = (),
    ) -> None:
        self.robot = robot if isinstance(robot, Robot) else load_robot(robot)
        self.scene = scene if isinstance(scene, Scene) else load_scene(scene)
        if self.scene.constraints:
            constraint_set(self.robot, self.scene.constraints)  # refuses unknown names
        self._edge_step, self._allowed = edge_step, pairs_of_names("allowed", allowed)
        tools = self._tools()
        self._planning = tools.checker.counting_anew()
        self.world = World(self.robot, self.scene, self._planning.allowed, self._planning.edge_step)
        self._certifier, self._gripper_certifier = tools.certifier, tools.gripper_certifier
        self._windows: dict[Robot, tuple[CollisionChecker, Prepared[Certifier]]] = {}
        self._process = os.getpid()

    @classmethod
    def of(cls, world: World) -> PlannerService:
        """A service for a world, such as that of a ``TaskResult``.

        Raises:
            InvalidRequest: its robot, scene and pairs do not go together.
        """
        world = instance("world", world, World, "a World, such as task.world")
        return cls(world.robot, world.scene, edge_step=world.edge_step, allowed=world.allowed)

    @cached_property
    def checker(self) -> CollisionChecker:
        """A checker for questions of your own. Plans have another, so that neither disturbs the counts of the other."""
        return self._planning.counting_anew()

    @property
    def edge_step(self) -> EdgeStep:
        """How finely edges are sampled."""
        return self._planning.edge_step

    @property
    def allowed(self) -> tuple[tuple[str, str], ...]:
        """Pairs of link or object names that may touch, beside those the robot allows; sorted."""
        return self._planning.allowed

    def _tools(self, robot: Robot | None = None) -> _Tools:
        """What judges and proves in this world, or for this robot in its place."""
        robot, step = robot or self.robot, MotionStep() if self._edge_step is None else self._edge_step
        pieces = sum(len(o.shape.pieces) if isinstance(o.shape, Composite) else 1 for o in self.scene.obstacles)
        if pieces <= FEW_PIECES and isinstance(step, MotionStep | JointStep) and type(step) in (MotionStep, JointStep):
            return _tools_of(robot, _Same(self.scene), step, self._allowed, os.getpid())
        return _Tools(robot, self.scene, step, self._allowed)

    def _window(self, q: ArrayLike | None) -> tuple[CollisionChecker, Prepared[Certifier]]:
        """What plans and proves where continuous joints have made some turns; the usual if they have not."""
        robot = self.robot.around(q) if q is not None and any(self.robot.continuous) else self.robot
        if robot is self.robot:
            return self._planning, self._certifier
        known = self._windows.get(robot)
        if known is None:
            tools = self._tools(robot)
            for old in list(self._windows)[: len(self._windows) + 1 - MAX_WINDOWS]:
                self._windows.pop(old, None)
            known = self._windows.setdefault(robot, (tools.checker.counting_anew(), tools.certifier))
        return known

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to another process, a service is built anew there."""
        made = partial(PlannerService, edge_step=self._edge_step, allowed=self._allowed)
        return made, (self.robot, self.scene)

    def with_scene(self, scene: Scene | str | Path) -> PlannerService:
        """A service for the same robot and settings in another scene."""
        return self.changed(scene=scene if isinstance(scene, Scene) else load_scene(scene))

    def changed(self, *, gripper: float | None = None, scene: Scene | None = None) -> PlannerService:
        """A service with the same settings whose gripper stands ``gripper`` metres open, or whose scene is another."""
        other = PlannerService(
            self.robot if gripper is None else self.robot.with_gripper(gripper),
            self.scene if scene is None else scene,
            edge_step=self._edge_step,
            allowed=self._allowed,
        )
        if scene is None:
            other._gripper_certifier = self._gripper_certifier  # which is of all widths
        return other

    def plan(
        self,
        request: PlanRequest,
        *,
        memory: Memory | None = None,
        cancel: CancelToken | None = None,
        trace: bool = False,
    ) -> PlanResult:
        """A timed path from the start to a goal, or the reason why there is none.

        Args:
            request: Start, goal, and what the answer may cost.
            memory: What is remembered of this cell. A motion in it between nearby ends is tried before anything is
                searched: if it is proven, in this scene and with the request's padding, it is the plan. Requests with
                ``polish``, ``improve`` or ``Optimise`` do without.
            cancel: Ends the call before its next check when it is cancelled from another thread.
            trace: Whether ``result.trace`` keeps how the search went; plan and counts are the same.

        Raises:
            InvalidRequest: Start or goal is not n finite numbers (or a pose), the memory is of another robot, or this
                service was built before a fork. That there is no plan is a result, not an error.
        """
        self._require_own_process()
        instance("request", request, PlanRequest, "a PlanRequest")
        flag("trace", trace)
        tracer = Tracer() if trace else None
        checker, certifier = self._window(request.start if not isinstance(request.planner, Roadmap) else None)
        origin = Origin(self.world, request)
        return plan(request, checker, certifier, memory=memory, cancel=cancel, tracer=tracer, origin=origin)

    def explain(
        self,
        request: PlanRequest,
        *,
        plans: int = 60,
        remedies: int = 3,
        time_limit: float | None = None,
        progress: bool | None = None,
        cancel: CancelToken | None = None,
    ) -> Explanation:
        """Why a request has no plan, whether that is proven, and which small changes would give one.

        The plan and the proof that there is none come first. Each change that is suggested was planned, with its proof.
        It takes as long as so many plans; how many are tried does not depend on a clock, unless there is a time limit.

        Args:
            request: As for ``plan``.
            plans: Plans that may be tried.
            remedies: How many are looked for.
            time_limit: Wall seconds for all of it, after which what is known is returned; None for no limit.
            progress: Whether standard error tells how far it is, by a bar or, where it is no terminal, by lines; if not
                given, only in a terminal.
            cancel: Ends the call when cancelled from another thread.

        Raises:
            InvalidRequest: As ``plan``, or a number is none from 1 to 1,000, or ``time_limit`` none from 0 to 86,400.
            Cancelled: by ``cancel``.
        """
        from planner_service.infeasibility.remedies import Clock

        plans, remedies = whole("plans", plans, 1, 1000), whole("remedies", remedies, 1, 1000)
        clock = Clock(None if time_limit is None else number("time_limit", time_limit, "seconds", 0.0, 86_400.0))
        instance("request", request, PlanRequest, "a PlanRequest")
        with bar("plans", progress) as tell:
            return self._explained(request, (plans, remedies), clock, tell, cancel)

    def _explained(
        self,
        request: PlanRequest,
        most: tuple[int, int],
        clock: Clock,
        tell: Callable[[int, int], None] | None,
        cancel: CancelToken | None,
    ) -> Explanation:
        """See ``explain``; ``most`` are the plans that may be tried, and the remedies that are looked for."""
        from planner_service.decomposition.no_path import NoPath, OpenWay, divide
        from planner_service.infeasibility.reached import how_far
        from planner_service.infeasibility.remedies import SEARCHED, Explanation, find_remedies

        charge = _polling(cancel)
        traced = self.plan(clock.hurried(request), trace=True, cancel=cancel)
        charge(0)
        result, grown = replace(traced, trace=None), None if traced.trace is None else traced.trace.graph
        result = replace(result, origin=Origin(self.world, request))
        failure = result.failure
        if failure is None:
            return Explanation(result, None, (), 0)
        no_path, reached, way = result.no_path, None, None
        goals = [goal for goal in request.goals(self.robot) if not isinstance(goal, Pose | PoseGoal)]
        start = np.clip(np.asarray(request.start), *self.robot.bounds)
        every = len(goals) == len(request.goals(self.robot))
        if failure.reason in SEARCHED and every and self.checker.state_is_free(start):  # no way out of a wall
            ends = [np.asarray(goal) for goal in goals]
            found = clock.unless_over(
                lambda polled: divide(self.robot, self.scene, start, ends, self._allowed, charge=polled), charge
            )
            no_path = found if isinstance(found, NoPath) else None
            way = self._along(found, request, cancel) if isinstance(found, OpenWay) else None
        if no_path is not None and failure.reason is not Reason.NO_PATH:
            hulls = only_for_hulls(self.robot, self.scene, no_path.pairs)
            detail = f"{failure.detail}; {no_path}; {hulls}" if hulls else failure.detail
            failure = replace(failure, detail=detail, proven=not hulls)
            result = replace(result, failure=failure)
        if failure.reason in (*SEARCHED, Reason.NO_PATH) and grown is not None:
            ends = [np.asarray(goal) for goal in goals]
            reached = how_far(self.robot, grown, np.asarray(request.start), ends, self._certifier.get().clearances)

        def planned(changed: PlanRequest, scene: Scene) -> PlanResult:
            result = self.with_scene(scene).plan(clock.hurried(changed), cancel=cancel)
            charge(0)
            return replace(result, origin=Origin(replace(self.world, scene=scene), changed))

        helpful, tried = find_remedies(
            self.robot,
            request,
            self.scene,
            failure,
            planned,
            plans=most[0],
            enough=most[1],
            hopeless=no_path is not None,
            clock=clock,
            tell=tell,
        )
        return Explanation(result, no_path, helpful, tried, reached, way, clock.in_time)

    def _along(self, way: OpenWay, request: PlanRequest, cancel: CancelToken | None) -> PlanResult | None:
        """The plan along a way, shorter if that keeps half of its clearance; None if the way is not proven free."""
        checker, certifier = self._window(request.start)

        def followed(points: FloatArray) -> PlanResult:
            blends = np.full(len(points), request.blend)
            asked = FollowRequest(points, (), request.pace, blends, constraints=request.constraints)
            result = follow(asked, checker, certifier, cancel=cancel)
            return replace(result, goal_index=way.goal_index, origin=Origin(self.world, None, asked.pace))

        result = followed(way.points)
        if not result.ok or result.certificate is None:
            return None
        padded = checker.variant(padding=min(0.5 * result.certificate.clearance, request.padding))
        shorter = followed(shortcut(way.points, SearchOracle(padded), np.random.default_rng(request.seed)))
        return shorter if shorter.ok else result

    def plan_many(
        self,
        requests: Iterable[PlanRequest],
        *,
        engine: Engine | None = None,
        progress: bool | None = None,
        finished: Mapping[int, PlanResult] | None = None,
    ) -> list[PlanResult]:
        """The plans of many requests, in their order: bit for bit, and count for count, what ``plan`` returns for each.

        If a worker dies, its request is tried once more, and is then a failure (WORKER_LOST). A worker that is 10 s
        over a time limit is ended (TIMED_OUT). ``result.roadmap`` is None: what was learned stays with the workers.

        Args:
            engine: What runs the plans; ``Processes()``, a process for each core, if not given.
            progress: Whether standard error tells how far it is, by a bar or, where it is no terminal, by lines; if not
                given, only in a terminal.
            finished: Results that are not planned again, by the index of their request: what ``Interrupted.results``
                of an earlier call with the same requests has.

        Raises:
            InvalidRequest: A request cannot be planned; the message names it. In a sequence all are checked first.
            Interrupted: Ctrl-C. It has the ``results`` that were finished.
        """
        self._require_own_process()
        return self._batch.results(requests, engine, progress, finished)

    def plan_stream(
        self, requests: Iterable[PlanRequest], *, engine: Engine | None = None
    ) -> Generator[PlanResult, None, None]:
        """The same as ``plan_many``, one result after the other, for any number of requests: none is kept.

        Take all results or close the generator: its workers live until then.

        Raises:
            InvalidRequest: As ``plan_many``. The requests of an iterator are checked as they are taken.
        """
        self._require_own_process()
        return self._batch.stream(requests, engine)

    @property
    def _batch(self) -> Batch:
        return Batch(
            self.plan, partial(require_plannable, robot=self.robot, scene=self.scene), partial(Origin, self.world)
        )

    def solve(
        self,
        task: Any,
        q: ArrayLike,
        *,
        request: PlanRequest | None = None,
        line_timing: Timing | None = None,
        beam: int = 4,
        searches: int = 200,
        memory: Memory | None = None,
        cancel: CancelToken | None = None,
    ) -> TaskResult:
        """The motions of a ``planner_service.tasks.Task``, every one proven, or which step has no plan, and why.

        Grasps, inverse kinematics branches, lines and placements are chosen so that what follows has a plan, too.

        Args:
            q: Where the robot stands, shape (n,).
            request: Planner, timing, seed, scales, padding, constraints and limits of all motions; its start and goal
                are not used. Its ``time_limit`` holds for each grasp, release and motion on average, its
                ``max_checks`` for each motion.
            line_timing: The timing law along straight and given lines; the request's if None.
            beam: Ways of one stage that are tried with what follows, before the stage ahead of it has to offer another.
                A stage is also given up after so many searches that use up their checks, or prove that there is no way.
            searches: Motions that may be searched for in all.
            memory: What is remembered of this cell, as for ``plan``; ``result.memory`` is what is after the task.
            cancel: Ends the task before its next check when cancelled from another thread.

        Raises:
            UnknownName: A step names an obstacle or a pose that is not there.
            InvalidRequest: A value is of the wrong kind or out of its range, or the robot has no gripper.
        """
        self._require_own_process()
        limits = {"beam": beam, "searches": searches}
        return solve_task(
            self, task, q, request=request, line_timing=line_timing, memory=memory, cancel=cancel, **limits
        )

    def replan(
        self,
        previous: PlanResult | Replanned,
        *,
        at_time: float,
        latency: float = 0.1,
        scene: Scene | str | Path | None = None,
        goal: Goal | None = None,
        request: PlanRequest | None = None,
        cancel: CancelToken | None = None,
    ) -> Replanned:
        """Another motion for a robot that is moving, without a stop, as the scene has changed or the goal has moved.

        The robot goes on along the old motion for ``latency`` seconds, while this call runs. The new motion begins
        there, at its own time 0, with the position, velocity and acceleration that the robot then has. What is left of
        the old motion is kept if it is free and nothing better is found. A contact that was meant on it is still meant
        if the object stands where it stood; if it moved before it was taken, only if ``pick`` would still take it like
        this. If there is no way to the goal, the result is a stop along the old curve, proven in the new scene; if that
        is not free either, the result says that nothing is safe.

        Args:
            previous: The plan being executed, or what this method returned before.
            at_time: Seconds since the start of its trajectory: now.
            latency: Seconds from now to the splice: by then this call must have returned and the new motion been sent.
            scene: The scene from now on; this service's if not given.
            goal: Where to go; where ``previous`` was to go if not given.
            request: Planner, padding, blends, limits and scales; its start and goal are not used. If not given, that
                of the call before; after a plan its request, timed by ``ToppRa`` and with at most 20,000 checks.
            cancel: As in ``plan``.

        Raises:
            InvalidRequest: ``previous`` failed or is of another robot or gripper width, ``at_time`` is not on it,
                ``latency`` is not in [0, 10], the request's timing law is not ``ToppRa``, or the goal is no n finite
                numbers or pose.
        """
        self._require_own_process()
        if scene is not None:
            other = self.with_scene(scene)
            return other.replan(previous, at_time=at_time, latency=latency, goal=goal, request=request, cancel=cancel)
        from planner_service.replanning.replan import replan

        checker, certifier = self._window(_later(previous, at_time, latency))
        replanned = replan(
            previous,
            checker,
            certifier,
            at_time=at_time,
            latency=latency,
            request=request,
            goal=goal,
            cancel=cancel,
        )
        return replace(replanned, result=replace(replanned.result, origin=Origin(self.world, replanned.request)))

    def certify(
        self,
        path: JointPath | ArrayLike,
        *,
        padding: float = 0.0,
        exempt: Sequence[ExemptInterval] = (),
        constraints: Sequence[Constraint] = (),
        part: tuple[float, float] | None = None,
        cancel: CancelToken | None = None,
    ) -> Certificate:
        """The proof that any path is free, between samples too, or where it cannot be proven.

        What it costs is counted in the certificate alone.

        Args:
            path: A ``JointPath``, or waypoints (N, n) of a polyline.
            padding: Metres that every pair is to keep.
            exempt: Stretches on which named pairs are not checked.
            constraints: What must hold all along, beside the constraints of what the robot carries.
            part: From where to where in s to prove it, such as ``certificate.part`` of a motion that was replanned; all
                of it if None.
            cancel: Ends the call when cancelled from another thread.

        Raises:
            InvalidRequest: The path is not one of this robot within its limits, or another value is out of range.
            UnknownName: An exempt pair or a constraint names nothing that is there.
            Cancelled: by ``cancel``.
        """
        self._require_own_process()
        kept = kept_in(self.scene, checked_constraints(constraints))
        charge = None if cancel is None else _polling(cancel)
        certifier = self._certifier.get()
        return certifier.certify(path, padding=padding, exempt=exempt, constraints=kept, part=part, charge=charge)

    def certify_gripper(
        self,
        q: ArrayLike,
        start: float,
        end: float,
        *,
        touching: Sequence[tuple[str, str]] = (),
        reason: str = "",
        cancel: CancelToken | None = None,
    ) -> GripperMotion:
        """The proof that the gripper can open or close while the arm stands at q (n,), or which pair is in the way.

        What it costs is counted in the certificate alone.

        Args:
            start: Metres between the finger pads before, whatever the width of this service's robot.
            end: The same afterwards.
            touching: Pairs that may touch meanwhile, such as the fingers and what they close on.
            reason: Why they may touch.

        Raises:
            InvalidRequest: the robot has no gripper, q is outside its limits, or a width is out of range.
            UnknownName: a pair names nothing that is there.
            Cancelled: by ``cancel``.
        """
        self._require_own_process()
        charge = _polling(cancel)
        certifier = self._gripper_certifier.get()
        return certifier.certify(q, (start, end), touching=touching, reason=reason, charge=charge)

    def follow(
        self,
        waypoints: ArrayLike,
        *,
        contacts: Sequence[AllowedStretch] = (),
        pace: Pace | None = None,
        blends: ArrayLike | None = None,
        min_blend: float = MIN_BLEND,
        padding: float = 0.0,
        constraints: Sequence[Constraint] = (),
        memory: Memory | None = None,
        cancel: CancelToken | None = None,
    ) -> PlanResult:
        """A given polyline, checked as it is, each piece once, then proven and timed; nothing is searched.

        Args:
            waypoints: Shape (N, n).
            contacts: Stretches on which named pairs may touch, where contact is meant.
            pace: How fast; ``Pace(Trapezoidal())`` if not given.
            blends: How wide the corner at each waypoint may be blended at most (rad of path before and after it), shape
                (N,); every corner is a stop if not given.
            min_blend: The narrowest blend (rad); a corner that would need a narrower one is a stop.
            padding: Metres that pairs which may not touch are to keep. The line is not changed: if it comes nearer,
                ``result.padding`` and a note say what it keeps.
            constraints: What must hold all along, beside the constraints of what the robot carries.
            memory: What is remembered of this cell. If a motion between the same ends is, the line is proven without a
                sample; samples are checked only where that is refused.
            cancel: As in ``plan``.

        Raises:
            InvalidRequest: waypoints are not finite rows of n joint values within the limits.
        """
        self._require_own_process()
        pace = Pace(Trapezoidal()) if pace is None else pace
        request = FollowRequest(waypoints, contacts, pace, blends, padding, min_blend, constraints)
        result = follow(request, self._planning, self._certifier, memory=memory, cancel=cancel)
        return replace(result, origin=Origin(self.world, None, pace))

    def torque_limits(self, payload: Payload | None = None, scale: float = 1.0) -> TorqueLimits:
        """The torque limits of the robot with a payload at the tool, and with what it carries here that has a mass.

        ``torque_limits().samples(trajectory).peaks()`` says how close any motion comes to them.

        Args:
            scale: Part in (0, 1] of the joints' efforts.

        Raises:
            InvalidRequest: a body of the robot has no mass, or a joint no effort, in its URDF.
        """
        instance("payload", payload, (Payload, NoneType), "a Payload, or None")
        return torque_limits(self.robot, self.scene, payload, scale)

    def build_roadmap(
        self,
        planner: Grower,
        *,
        seed: int = 0,
        padding: float = 0.001,
        progress: bool | None = None,
        cancel: CancelToken | None = None,
    ) -> Roadmap:
        """A roadmap of the free space for many queries: pass it as ``PlanRequest.planner``.

        What it cost is in ``roadmap.built.counts``; ``planner.max_checks`` limits it.

        Args:
            planner: ``PRM(...)``, ``PRMstar(...)`` or ``LazyPRM(...)``.
            seed: Decides which configurations are drawn.
            padding: Metres that milestones and edges keep from everything: best the padding of the queries to come.
            progress: Whether standard error tells how far it is, by a bar or, where it is no terminal, by lines; if not
                given, only in a terminal.
            cancel: Ends the call when cancelled from another thread.

        Raises:
            InvalidRequest: There is no such planner or seed, or the padding is not a distance.
            Cancelled: ``cancel`` was cancelled; nothing is kept.
        """
        self._require_own_process()
        require_seed(seed)
        require_grower(planner)

        def grown() -> Roadmap:
            with bar("roadmap", progress) as report:
                return grow(planner, self._planning.variant(padding=padding), seed=seed, progress=report)

        return self._limited(grown, cancel)

    def path_memory(self, *, padding: float = 0.001) -> Roadmap:
        """An empty roadmap that remembers every path planned with it: ``result.roadmap`` has one path more.

        Args:
            padding: As in ``build_roadmap``.

        Raises:
            InvalidRequest: a padding that is no distance.
        """
        self._require_own_process()
        checker = self._planning.variant(padding=padding)
        nothing = Roadmap.of(np.zeros((0, self.robot.n)), reach=checker.reach)
        return replace(nothing, terms=Terms.of(checker), remember=True)

    def update_roadmap(self, roadmap: Roadmap, *, cancel: CancelToken | None = None) -> RoadmapUpdate:
        """A roadmap brought up to date with this scene: whatever a change may have touched is checked again.

        ``plan`` does this for the edges that a path needs, this method for all of them, with the roadmap's own padding.

        Args:
            cancel: Ends the call when cancelled from another thread.

        Raises:
            InvalidRequest: It is not a roadmap, or one for other joints.
            Cancelled: ``cancel`` was cancelled; the roadmap is as it was.
        """
        self._require_own_process()
        if not isinstance(roadmap, Roadmap):
            raise InvalidRequest("roadmap", roadmap, "a Roadmap")
        padding = 0.001 if roadmap.terms is None else roadmap.terms.padding
        return self._limited(lambda: update(roadmap, self._planning.variant(padding=padding)), cancel)

    def way_out(self, q: ArrayLike, *, padding: float = 0.001) -> WayOut | None:
        """A proven motion from a colliding q (n,) to a free configuration; q itself if free, None if none is found.

        ``plan`` begins with it where pairs overlap by no more than ``PlanRequest.start_overlap``; here by any depth.

        Args:
            padding: Metres that everything is to keep where it ends, if that can be reached.

        Raises:
            InvalidRequest: q is not n finite joint values within the limits, or the padding not in [0, 0.1].
        """
        self._require_own_process()
        start = joint_vector("q", q, self.robot)
        padding = number("padding", padding, "a number in [0, 0.1]", 0.0, 0.1)
        checker, certifier = self._window(start)

        def found() -> WayOut | None:
            if checker.state_is_free(start):
                return WayOut(JointPath(start[None]), ())
            with suppress(NoWayOut):
                return find_way_out(certifier.get(), start, math.inf, padding)
            return None

        return checker.ledger.held(found)

    def view(
        self,
        shown: Showable | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        block: bool | None = None,
    ) -> OpenPage:
        """Open a page in the browser with the robot, the scene, and a plan or a task, and print its address.

        On the page, joints can be moved and motions planned. It is served until its last window is closed.

        Args:
            shown: What to show beside robot and scene.
            host: The address to serve it at. Anyone who can reach it can use the page.
            port: The first port to try; if it is taken, the next free one.
            block: Whether to return only when the page is closed; if not given, unless this is a notebook or a prompt.

        Raises:
            InvalidRequest: There is no such host or port, or ``shown`` cannot be shown.
            MissingDependency: the extra ``view`` is not installed.
        """
        return show_page(self.world, shown, host=host, port=port, block=block)

    def _limited(self, act: Callable[[], T], cancel: CancelToken | None = None) -> T:
        return self._planning.ledger.held(act, cancel=cancel)

    def _require_own_process(self) -> None:
        if os.getpid() != self._process:
            raise InvalidRequest("service", "built before a fork", "a PlannerService built in this process")


def _polling(cancel: CancelToken | None) -> Callable[[int], None]:
    """Raises once a call is cancelled; charges are ignored."""
    instance("cancel", cancel, (CancelToken, NoneType), "a CancelToken, or None")

    def charge(_: int) -> None:
        if cancel is not None and cancel.cancelled:
            raise Cancelled("cancelled by the caller")

    return charge


def _later(previous: PlanResult | Replanned, at_time: float, latency: float) -> FloatArray | None:
    """Where a motion has a robot once ``replan`` has returned; None if that is to be refused."""
    from planner_service.replanning.result import Replanned

    result = previous.result if isinstance(previous, Replanned) else previous
    trajectory = result.trajectory if isinstance(result, PlanResult) else None
    if trajectory is None:
        return None
    try:
        now, more = (number("time", value, "seconds", -math.inf, math.inf) for value in (at_time, latency))
        return trajectory(min(max(now + more, 0.0), trajectory.duration))
    except InvalidRequest:
        return None
