"""Solve a task: choose grasps, inverse kinematics branches, lines and placements so that every motion has a plan.

The stages of a task are solved one after the other, depth first: each yields the ways in which it can be done, and
where what follows has no plan, the next of them is tried. A grasp or placement is tried like this, the cheapest first:

1. whether the arm reaches it, and a place where what is then carried may be set down,
2. its ways without a search, up to the proven lines to it and from it,
3. of what is then carried, whether the release that follows has such a way, and the grasp after that, if there is one,
4. the search of the motion that leads there.

So a grasp whose object could not be set down costs no search. What was found out on the way is kept for when it is
needed. All of this is deterministic: it depends on no clock, unless a time limit ends it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify import GripperMotion
from planner_service.collision import CancelToken, CheckCounts
from planner_service.constraints.values import KeepUpright
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Pose
from planner_service.geometry.validation import instance, whole
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.reachability import why_unreachable
from planner_service.memory.memory import NOTHING, Memory, checked_memory
from planner_service.planning.request import PlanRequest, keeps_torques, require_timing
from planner_service.planning.result import Failure, PlanResult, Reason
from planner_service.planning.result import Stage as PlanStage
from planner_service.planning.task_result import JOIN, Segment, TaskResult
from planner_service.robot.model import joint_vector
from planner_service.service import PlannerService
from planner_service.tasks.contacts import frame_of
from planner_service.tasks.inspector import Inspector, Rank, Visit, steps_of
from planner_service.tasks.look_ahead import LookAhead
from planner_service.tasks.motions import Ended, Motions, NoMotion
from planner_service.tasks.names import require_names
from planner_service.tasks.steps import Follow, Grasp, MoveCircular, MoveLinear, MoveTo, Wait
from planner_service.tasks.task import ChoiceStage, ContactStage, MotionStage, Numbered, Stage, Task
from planner_service.tasks.tool_motions import move_circular, move_linear
from planner_service.tasks.ways import Lines, Way, Ways
from planner_service.timing.laws import Timing

__all__ = ["BEAM", "LEAVE", "SEARCHES", "solve", "solved"]

LEAVE = "leave"
"""The name of the first motion where the robot touches something at its start."""

STAND = "stand"
"""The name of a motion that stays where it is, while the gripper moves."""

BEAM = 4
"""Ways of a stage that are carried forward."""

SEARCHES = 200
"""That a task may try."""

HOPELESS = (Reason.NO_PATH, Reason.CHECK_BUDGET_EXHAUSTED)
"""Why a search fails that took long: of one stage no more than ``beam`` of these are made."""

MAX_WHYS = 8
"""Poses out of reach that are looked at to tell what would bring the tool to the nearest of them."""

SAME = 1e-3
"""Radians (or metres): goals closer than this are one."""


def solve(
    service: PlannerService,
    task: Task,
    q: ArrayLike,
    *,
    request: PlanRequest | None = None,
    line_timing: Timing | None = None,
    beam: int = BEAM,
    searches: int = SEARCHES,
    memory: Memory | None = None,
    cancel: CancelToken | None = None,
) -> TaskResult:
    """``PlannerService.solve``."""
    instance("service", service, PlannerService, "a PlannerService")
    instance("task", task, Task, "a Task")
    require_names(service, task.stages)
    whole("beam", beam, 1, 1_000)
    whole("searches", searches, 1, 1_000_000)
    return solved(service, task, q, request, line_timing, memory, cancel, beam=beam, searches=searches)


def solved(
    service: PlannerService,
    task: Task,
    q: ArrayLike,
    request: PlanRequest | None,
    line_timing: Timing | None,
    memory: Memory | None,
    cancel: CancelToken | None,
    *,
    beam: int = BEAM,
    searches: int = SEARCHES,
    named: bool = True,
) -> TaskResult:
    """The same, of names that are known to be there.

    Args:
        named: Whether a failure begins with the step.
    """
    start = joint_vector("q", q, service.robot)
    instance("request", request, (PlanRequest, type(None)), "a PlanRequest, or None")
    instance("cancel", cancel, (CancelToken, type(None)), "a CancelToken, or None")
    template = replace(request or PlanRequest(start, start), start=start, goal=start)
    if line_timing is not None:
        require_timing(line_timing)
        if keeps_torques(template.timing) and not keeps_torques(line_timing):
            expected = "None, or ToppRa(torque=True): the request keeps torque limits"
            raise InvalidRequest("line_timing", line_timing, expected)
    for step in _grasps(task.stages):
        if step.upright is not None:
            template.require_keeping([KeepUpright((0.0, 0.0, 1.0), step.upright)])
    motions = Motions(template, line_timing, cancel, turns=_turns(task.stages), searches=searches)
    if memory is not None:
        checked_memory(memory, service.robot)
    return _Search(motions, service, task, start, memory, beam, named=named).result()


def _grasps(stages: Sequence[Stage]) -> Iterator[Grasp]:
    """The grasps in stages and in their alternatives."""
    for stage in stages:
        if isinstance(stage, ChoiceStage):
            for branch in stage.branches:
                yield from _grasps(branch)
        elif isinstance(stage, ContactStage) and isinstance(stage.act.step, Grasp):
            yield stage.act.step


def _turns(stages: Sequence[Stage]) -> int:
    """How many stages follow each other at most."""
    return sum(
        max(_turns(branch) for branch in stage.branches) if isinstance(stage, ChoiceStage) else 1 for stage in stages
    )


@dataclass(frozen=True, eq=False)
class _State:
    """How far a task has come.

    Attributes:
        q: Where the robot stands, (n,).
        rest: The stages that are left.
        done: How many stages are behind it.
        began: Where the first motion began, (n,), once the robot had left what it touched; None before.
        grip: What the gripper does before the next motion.
        memory: What is remembered once its motions were made.
        wait: Seconds that the arm stands still before the next motion.
    """

    service: PlannerService
    q: FloatArray
    rest: tuple[Stage, ...]
    done: int = 0
    segments: tuple[Segment, ...] = ()
    began: FloatArray | None = None
    grip: GripperMotion | None = None
    notes: tuple[str, ...] = ()
    memory: Memory = NOTHING
    wait: float = 0.0

    @property
    def pending(self) -> bool:
        """Whether the gripper moves, or the arm waits, before the next motion."""
        return self.grip is not None or self.wait > 0.0

    def after(self, *segments: Segment, **changes: Any) -> _State:
        """The state once a stage is done, by these motions."""
        q = _end(segments[-1].result) if segments else self.q
        if segments and self.wait:
            segments = (replace(segments[0], wait=self.wait), *segments[1:])
        memory = self.memory
        for segment in segments:
            for motion in segment.result.memory.motions[-1:]:
                memory = memory.with_motion(motion, self.service.robot.joint_names)
        known = replace(
            self, memory=memory, segments=(*self.segments, *segments), q=q, rest=self.rest[1:], done=self.done + 1
        )
        return replace(known, **{"grip": None, "wait": 0.0, **changes})


class _Search:
    """One task while it is solved."""

    def __init__(
        self,
        motions: Motions,
        service: PlannerService,
        task: Task,
        start: FloatArray,
        memory: Memory | None,
        beam: int,
        *,
        named: bool,
    ) -> None:
        self._began = time.perf_counter()
        self._motions, self._task, self._start, self._beam = motions, task, start, beam
        self._service = motions.begin(service)
        self._inspector = Inspector(task.stages)
        self._ahead = LookAhead(motions, self._inspector)
        self._lines: dict[tuple[int, PlannerService, bytes], PlanResult | NoMotion] = {}
        self._remembers, self._named = memory is not None, named
        self._deepest = _State(self._service, start, task.stages, memory=memory or NOTHING)
        self._stuck: Visit | None = None
        self._visit: Visit | None = None

    def result(self) -> TaskResult:
        """All motions of the task, or as far as there are plans."""
        try:
            last = self._last()
        except Ended as ended:
            tried = [] if self._visit is None else [*dict.fromkeys(self._visit.tried)][:6]
            detail = "; ".join([ended.failure.detail, *tried])
            late = ended.failure.reason is not Reason.PREEMPTED
            return self._result(self._deepest, replace(ended.failure, detail=detail) if late else ended.failure)
        if last is None:
            assert self._stuck is not None
            return self._result(self._deepest, self._why(self._stuck))
        return self._result(last, None)

    def _last(self) -> _State | None:
        """The state in which the task is done; None if there is none."""
        stack = [iter([self._deepest])]
        while stack:
            state = next(stack[-1], None)
            if state is None:
                stack.pop()
                continue
            if state.done > self._deepest.done:
                self._deepest, self._stuck = state, None
            if not state.rest:
                return self._at_rest(state) if state.pending else state
            stack.append(self._next(state))
        return None

    def _next(self, state: _State) -> Iterator[_State]:
        """The states to which the next stage leads."""
        stage = state.rest[0]
        if isinstance(stage, ChoiceStage):
            for branch in stage.branches:
                yield replace(state, rest=(*branch, *state.rest[1:]))
            return
        self._motions.memory = state.memory if self._remembers else None
        visit = self._visit = Visit(self._inspector, stage, state.service, self._standing(state))
        make = self._contact if isinstance(stage, ContactStage) else self._motion
        count = 0
        for count, after in enumerate(islice(make(state, visit), self._beam), start=1):  # noqa: B007
            yield after
            self._visit, self._motions.memory = visit, state.memory if self._remembers else None
        if count == 0 and self._stuck is None and state.done == self._deepest.done:
            self._stuck = visit

    def _standing(self, state: _State) -> FloatArray:
        """Where the robot stands, within its limits."""
        limits = state.service.robot.around(state.q).limits
        return np.clip(state.q, limits.lower, limits.upper)

    # Contacts.

    def _contact(self, state: _State, visit: Visit) -> Iterator[_State]:
        """The states once the gripper has closed or opened."""
        stage = visit.stage
        assert isinstance(stage, ContactStage)
        ways = self._ahead.ways_of(stage, state.service)
        if stage.connect is None:
            base: _State | None = self._at_rest(state) if state.pending else state
            found = ways.here(state.q, visit)
        else:
            base = self._started(state, visit)
            found = iter(()) if base is None else ways(visit.q, visit)
        if base is None:
            return
        done, unsure, dear = set[tuple[int, int]](), True, 0
        for way in found:
            if (way.number, way.solution) in done:
                continue  # another length of the same
            try:
                after = self._through(base, ways, way, visit)
            except NoMotion as none:
                if way.contact.takes:  # on the way there the gripper is open already
                    ways.told(way.contact, str(none))
                searched = none.result is not None and none.result.origin is not None and none.result.origin.request
                if unsure and searched and stage.connect is not None:
                    unsure = False
                    if self._left(base, visit, stage.connect) is None:
                        return
                failure = None if none.result is None else none.result.failure
                dear += failure is not None and failure.reason in HOPELESS
                if dear == self._beam and stage.connect is not None:
                    why = f"given up: {dear} searches used up their checks, or proved that there is no path"
                    visit.refuse(stage.connect, why, rank=Rank.SEARCH)
                    return
                continue
            done.add((way.number, way.solution))
            yield after

    def _started(self, state: _State, visit: Visit) -> _State | None:
        """The state in which motions can begin; None, and told ``visit``, if they cannot where the robot stands."""
        connect = visit.stage.connect
        assert connect is not None
        last = state.segments[-1].result.origin if state.segments else None
        proven = last is not None and last.world is state.service.world
        if proven or self._motions.stands_free(state.service, state.q, visit.q):
            return state if state.began is not None else replace(state, began=state.q)
        return self._left(state, visit, connect)

    def _left(self, state: _State, visit: Visit, connect: Numbered) -> _State | None:
        """The state once the robot has left what it touches; None, and told ``visit``, if it stands where no motion can
        begin."""
        result, leaves = self._motions.leaving(state.service, state.q, visit.q)
        if result.failure is not None:
            visit.failure = result.failure
            visit.refuse(connect, result.failure.detail, rank=Rank.SEARCH)
            return None
        if not leaves:
            return state if state.began is not None else replace(state, began=state.q)
        width, scene = state.service.robot.gripper_width, state.service.scene
        leave = Segment(LEAVE, result, width, scene, state.grip, wait=state.wait)
        q = _end(result)
        visit.q = q
        began = q if state.began is None else state.began
        return replace(state, segments=(*state.segments, leave), q=q, began=began, grip=None, wait=0.0)

    def _through(self, base: _State, ways: Ways, way: Way, visit: Visit) -> _State:
        """The state once a way was gone.

        Raises:
            NoMotion: One of its motions has no plan, or what follows has none.
        """
        stage = ways.stage
        rest = base.rest[1:]
        self._ahead.require(rest, way, visit)
        if stage.connect is None:
            lines = ways.lines(way, visit)
            self._ahead.look(rest, way, visit)
            self._lines_ahead(rest, way, visit)
            return self._gone(base, ways, way, lines, visit, ())
        before = way.contact.before
        try:
            opening = self._motions.gripper(base.service, visit.q, way.contact.width)
        except NoMotion as none:
            visit.refuse(stage.connect, str(none), rank=Rank.GRIPPER)
            raise
        way = way.turned(before.robot, visit.q)
        lines = ways.lines(way, visit)
        self._ahead.look(rest, way, visit)
        self._lines_ahead(rest, way, visit)
        connect = stage.connect.step
        with visit.trying(stage.connect, f"{connect.name}: ", Rank.SEARCH):
            to = self._motions.searched(before, base.q, way.begin, connect.constraints, one_of_many=True)
        there = way.turned(before.robot, _end(to))
        if there is not way:  # a joint has gone the other way round
            way, lines = there, ways.lines(there, visit)
        if base.pending and opening is not None:
            base = self._at_rest(base)
        motion = Segment(connect.name, to, way.contact.width, before.scene, opening or base.grip)
        return self._gone(base, ways, way, lines, visit, (motion,))

    def _gone(self, base: _State, ways: Ways, way: Way, lines: Lines, visit: Visit, to: tuple[Segment, ...]) -> _State:
        """The state after the motions of a way."""
        inward, outward = ways.segments(way, lines)
        length = f", {way.length(ways.service.robot) * 100:.0f} cm of straight line" if way.inward else ""
        kind = f", {way.kind} grasp" if way.kind else ""
        notes = (f"way {way.number} of {way.of}{kind}{length}", *visit.tried)
        if len(self._task.stages) > 1:
            notes = tuple(f"{ways.stage.act.step}: {note}" for note in notes)
        grip, contact = None if outward else lines.grip, way.contact
        state = base.after(*to, *inward, *outward, service=contact.after, grip=grip, notes=(*base.notes, *notes))
        closed = [*way.q.tolist(), contact.width, contact.then]
        return replace(state, memory=state.memory.with_grip(closed, contact.after.robot.joint_names))

    def _at_rest(self, state: _State) -> _State:
        """The state after a motion that stays where the robot is, while the gripper moves or the arm waits."""
        stays = self._motions.followed(state.service, state.q[None])
        width, scene = state.service.robot.gripper_width, state.service.scene
        motion = Segment(STAND, stays, width, scene, state.grip, self._motions.law, state.wait)
        return replace(state, segments=(*state.segments, motion), grip=None, wait=0.0)

    # Motions.

    def _motion(self, state: _State, visit: Visit) -> Iterator[_State]:
        """The states once a motion was made."""
        stage = visit.stage
        assert isinstance(stage, MotionStage)
        if state.began is None:
            state = replace(state, began=state.q)
        step = stage.motion.step
        if isinstance(step, Wait):
            self._inspector.tried(stage.motion)
            yield state.after(grip=state.grip, wait=state.wait + step.seconds)
            return
        if isinstance(step, MoveTo):
            yield from self._moves(state, stage, visit)
            return
        try:
            if isinstance(step, Follow):
                followed = self._follows(state, stage, visit)
                if followed is not None:
                    yield followed
                return
            result = self._along(stage, state.service, state.q, visit)
            yield state.after(self._segment(state, step.name, result, line=True))
        except NoMotion as none:
            visit.failure = None if none.result is None else none.result.failure

    def _segment(self, state: _State, name: str, result: PlanResult, *, line: bool) -> Segment:
        width, scene = state.service.robot.gripper_width, state.service.scene
        return Segment(name, result, width, scene, state.grip, self._motions.law if line else None)

    def _moves(self, state: _State, stage: MotionStage, visit: Visit) -> Iterator[_State]:
        """To one of the goals first, then to each other one by itself."""
        step: MoveTo = stage.motion.step
        reached: list[FloatArray] = []

        def moved(goal: Any) -> _State | None:
            try:
                with visit.trying(stage.motion, f"{step.name}: ", Rank.SEARCH):
                    result = self._motions.searched(
                        state.service, state.q, goal, step.constraints, one_of_many=bool(reached)
                    )
            except NoMotion as none:
                visit.failure = visit.failure or (None if none.result is None else none.result.failure)
                return None
            reached.append(_end(result))
            return state.after(self._segment(state, step.name, result, line=False))

        try:
            goals = self._goals(state, step)
        except NoMotion as none:
            visit.refuse(stage.motion, str(none))
            return
        first = moved(goals[0] if len(goals) == 1 else list(goals))
        if first is None:
            return
        yield first
        for goal in self._configurations(state, goals):
            if all(np.abs(goal - other).max() > SAME for other in reached):
                other = moved(goal)
                if other is not None:
                    yield other

    def _goals(self, state: _State, step: MoveTo) -> list[Any]:
        if step.goal is None:
            return [state.began]
        robot, frame = state.service.robot, frame_of(state.service, step.frame)

        def placed(goal: Any) -> Any:
            if isinstance(goal, str):
                return robot.pose(goal)
            if frame is None or not isinstance(goal, Pose | PoseGoal):
                return goal
            return frame @ goal if isinstance(goal, Pose) else replace(goal, pose=frame @ goal.pose)

        return [placed(goal) for goal in step.goal]

    def _configurations(self, state: _State, goals: Sequence[Any]) -> Iterator[FloatArray]:
        """The goals as joint values."""
        robot, still = state.service.robot, state.service.robot.unwound(self._standing(state))
        for goal in goals:
            if isinstance(goal, Pose | PoseGoal):
                for pose in [goal] if isinstance(goal, Pose) else goal.poses():
                    yield from self._motions.solutions(robot, pose, still)
            else:
                yield np.asarray(goal, dtype=np.float64)

    def _along(self, stage: MotionStage, service: PlannerService, q: FloatArray, visit: Visit) -> PlanResult:
        """The motion of the tool along a line or an arc from q (n,); planned once and remembered.

        Raises:
            NoMotion: There is none; ``visit`` was told.
        """
        key = (id(stage), service, q.tobytes())
        if key not in self._lines:
            try:
                with visit.trying(stage.motion, f"{stage.motion.step.name}: ", Rank.PROOF):
                    self._lines[key] = self._planned_along(stage.motion.step, service, q)
            except NoMotion as none:
                self._lines[key] = none
        known = self._lines[key]
        if isinstance(known, NoMotion):
            visit.failure = None if known.result is None else known.result.failure
            raise known
        return known

    def _lines_ahead(self, rest: tuple[Stage, ...], way: Way, visit: Visit) -> None:
        """Refuse a way after which the tool cannot go the lines and arcs that follow at once, as with a drawer.

        Raises:
            NoMotion: It cannot.
        """
        service, q = way.contact.after, way.end
        for stage in rest:
            step = stage.motion.step if isinstance(stage, MotionStage) else None
            if isinstance(step, Wait):
                continue
            if not isinstance(stage, MotionStage) or not isinstance(step, MoveLinear | MoveCircular):
                return
            ahead = Visit(self._inspector, stage, service, q)
            try:
                q = _end(self._along(stage, service, q, ahead))
            except NoMotion as none:
                visit.leads_to(ahead)
                assert isinstance(visit.stage, ContactStage)
                why = f"then {step} has no plan: {none}"
                visit.refuse(visit.stage.act, why, f"way {way.number}: {why}", Rank.AHEAD)
                raise NoMotion(why) from none

    def _planned_along(self, step: MoveLinear | MoveCircular, service: PlannerService, q: FloatArray) -> PlanResult:
        frame = frame_of(service, step.frame)

        def placed(target: Any) -> Any:
            if frame is None:
                return target
            if isinstance(target, Pose):
                return frame @ target
            return tuple(float(row @ np.array(target)) for row in frame.rotation)

        def move(**settings: Any) -> PlanResult:
            settings["free_axis"] = step.free_axis
            if isinstance(step, MoveCircular):
                return move_circular(service, q, placed(step.via), placed(step.goal), **settings)
            goals = [placed(target) for target in step.goal]
            return move_linear(service, q, goals[0] if len(goals) == 1 else goals, zone=step.zone, **settings)

        return self._motions.along(move, step.constraints)

    def _follows(self, state: _State, stage: MotionStage, visit: Visit) -> _State | None:
        """Along given waypoints, after the motion to where they begin; None if the robot stands elsewhere."""
        step: Follow = stage.motion.step
        rows = np.array(step.waypoints)
        if rows.shape[1] != state.service.robot.n:
            raise InvalidRequest("waypoints", rows.shape, f"rows of {state.service.robot.n} joint values")
        if stage.connect is None and not np.all(np.abs(rows[0] - state.q) <= JOIN):
            visit.refuse(stage.motion, "it does not begin where the robot stands")
            return None
        with visit.trying(stage.motion, f"{step.name}: ", Rank.PROOF):
            line = self._motions.followed(state.service, rows, (), step.constraints, step.blend)
        to: tuple[Segment, ...] = ()
        if stage.connect is not None:
            connect = stage.connect.step
            with visit.trying(stage.connect, f"{connect.name}: ", Rank.SEARCH):
                result = self._motions.searched(state.service, state.q, rows[0], connect.constraints)
            to = (self._segment(state, connect.name, result, line=False),)
            state = replace(state, grip=None)
        return state.after(*to, self._segment(state, step.name, line, line=True))

    # Results.

    def _why(self, visit: Visit) -> Failure:
        """Why the task ends at a stage: the last of the steps that failed whenever they were tried, and the cause."""
        while visit.ahead is not None and visit.farthest is not None and visit.farthest[0] is Rank.AHEAD:
            visit = visit.ahead
        blocked, tried, step = self._inspector.blocked(), visit.tried, ""
        last = blocked[0] if blocked is not None else visit.farthest[1] if visit.farthest is not None else None
        if last is not None and self._named:
            step = f"{last.step}: "
            tried = [told for number, told, _ in visit.noted if number == last.number] or tried
        if visit.failure is not None:
            return replace(visit.failure, detail=f"{step}{visit.failure.detail}")
        if self._named and blocked is not None and blocked[0] not in tuple(steps_of(visit.stage)):
            report = blocked[1]
            detail = f"{step}{report.failed} of {report.tried} tries failed: {report.why}"
        else:
            number = "the only way has no plan" if visit.ways == 1 else f"none of {visit.ways} ways has a plan"
            none = f"{number}: " if visit.ways else ""
            detail = f"{step}{none}{_by_kind(visit, last) or '; '.join([*dict.fromkeys(tried)][:6])}"
        return self._explained(visit, Failure(PlanStage.ENDPOINTS, Reason.PLANNING_FAILED, detail))

    def _explained(self, visit: Visit, failure: Failure) -> Failure:
        """The failure with why the tool cannot be brought to the nearest of the poses that are out of reach."""
        robot, seed, still = self._service.robot, self._motions.request.seed, visit.service.robot.unwound(visit.q)
        found, unreached = len(visit.kinds) > 1, list(visit.unreached.items())
        if found:  # the usual grasps are the ones to be asked about
            unreached = [each for each in unreached if each[0] <= visit.kinds[0][1]]
        whys = [
            (why.gap, why.turn, number, replace(why, suggestion=None) if found else why)
            for number, pose in unreached[:MAX_WHYS]
            for why in [why_unreachable(robot, pose, seed=seed, still=still)]
        ]
        if not whys:
            return failure
        *_, number, why = min(whys, key=lambda each: each[:3])
        return replace(failure, detail=f"{failure.detail}; way {number} comes nearest: {why}", unreachable=why)

    def _result(self, state: _State, failure: Failure | None) -> TaskResult:
        counts = sum((segment.counts for segment in state.segments), CheckCounts())
        notes = state.notes
        if failure is not None and self._stuck is not None:
            notes = (*notes, *self._stuck.tried)
        return TaskResult(
            state.segments,
            state.service.world,
            state.q,
            failure,
            self._motions.spent - counts,
            notes,
            self._motions.request,
            self._task.name,
            time.perf_counter() - self._began,
            self._inspector.reports(),
            state.memory,
        )


def _by_kind(visit: Visit, last: Numbered | None) -> str:
    """What was in the way of each kind of grasps; empty where there was one kind."""
    if len(visit.kinds) < 2:
        return ""
    parts = []
    for kind, count in visit.kinds:
        here = [(number, told) for number, told, of in visit.noted if of == kind]
        at = [told for number, told in here if last is not None and number == last.number]
        why = "; ".join([*dict.fromkeys(at or [told for _, told in here])][:2])
        parts.append(f"{count} {kind or 'top'} {'grasp' if count == 1 else 'grasps'}: {why}" if count else why)
    return "; ".join(parts)


def _end(result: PlanResult) -> FloatArray:
    end: FloatArray = result.unwrap()[0].waypoints[-1]
    return end
