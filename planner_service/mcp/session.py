"""What an agent works with: an arm that stands somewhere, what it holds, and plans by their ids.

A plan begins where the arm stands, or ``after`` another plan, at its end, before anything has moved. Whatever is
returned as a plan is proven free. ``execute`` moves the arm along a plan, and along those that it comes after; it
proves all of it again first. A plan that begins where the arm no longer stands, or in a scene that is no longer so, is
outdated and is not executed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service.certify.certifier import clearance_text
from planner_service.collision import CancelToken
from planner_service.errors import UnknownName
from planner_service.files.schema import Record
from planner_service.geometry.arrays import FloatArray, read_only
from planner_service.geometry.shapes import Pose
from planner_service.grasping.grasps import middle_of
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.reachability import why_unreachable
from planner_service.mcp import answers, arguments
from planner_service.mcp.answers import Refused, refused_because, rounded, whole_millimetres
from planner_service.mcp.motion import Done, Mover, apart
from planner_service.mcp.names import cut, plainly_named, quoted, require_plain_names
from planner_service.planning.request import Pace, PlanRequest, World
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Handling, Segment, TaskResult
from planner_service.presentation.measures import numbers_text
from planner_service.records.recertify import recertify
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import places_on, standing_on
from planner_service.tasks.primitives import pick, place
from planner_service.tasks.tool_motions import move_linear

__all__ = ["Answer", "Session"]

PADDING = 0.005
"""Metres that plans keep where they can: an arm deviates from its path by one to three millimetres."""

TIME_LIMIT = 5.0
"""Seconds of one plan; of an explanation four times as many."""

MAX_PLANS = 100
"""Plans that are kept, the newest."""

PAGE = 50
"""Objects that are listed at a time."""

MAX_NOTES = 8

LAY, TURNED, HELD = 0.001, 0.02, 0.015
"""Metres and radians by which an object may lie elsewhere than planned without the scene counting as changed, and
metres by which what is held may have slipped without counting as dropped."""


@dataclass(frozen=True)
class Answer:
    """What a tool answers.

    Attributes:
        record: Its typed fields.
        text: The same in a sentence or two.
        png: A picture, of a call to ``look``.
    """

    record: Record
    text: str
    png: bytes | None = None


@dataclass(frozen=True, eq=False)
class State:
    """A robot in a scene, and where it stands; no two are the same."""

    world: World
    q: FloatArray

    @cached_property
    def service(self) -> PlannerService:
        """What plans there."""
        return PlannerService.of(self.world)

    @property
    def scene(self) -> Scene:
        """What is around the robot, and what it holds."""
        return self.world.scene


@dataclass(frozen=True, eq=False)
class _Kept:
    """A plan by its id, with where it begins and ends."""

    id: str
    task: TaskResult
    begin: State
    end: State
    after: str | None


class Session:
    """One agent's work with one arm.

    Calls come one at a time; ``cancel`` ends the one that has it from another thread.

    Args:
        service: Robot and scene. Objects whose names are no plain words are called otherwise.
        start: Where the arm stands, shape (n,); home if None.
        mover: What moves the arm; None if nothing may.

    Raises:
        InvalidRequest: a link or a joint has a name that is no plain word, or the start is not n joint values.
    """

    def __init__(self, service: PlannerService, start: ArrayLike | None = None, mover: Mover | None = None) -> None:
        require_plain_names(service.robot)
        scene, self._labels = plainly_named(service.scene)
        self._mover = mover
        q = joint_vector("start", service.robot.home if start is None else start, service.robot)
        self._state = State(replace(service.world, scene=scene if mover is None else mover.seen(scene)), q)
        self._plans: dict[str, _Kept] = {}
        self._executed: set[str] = set()
        self._numbers = itertools.count(1)

    @property
    def robot(self) -> Robot:
        """The robot, its gripper as it stands."""
        return self._state.world.robot

    @property
    def tasks(self) -> tuple[TaskResult, ...]:
        """The plans that are kept, oldest first."""
        return tuple(kept.task for kept in self._plans.values())

    # Tools, by their names.

    def describe_scene(self, given: arguments.DescribeArguments, cancel: CancelToken) -> Answer:
        """The arm, where it stands and what it holds, the objects around it, and the plans that are kept."""
        state = self._at(given.after)
        robot, every = state.world.robot, state.scene.obstacles
        shown = every[given.first : given.first + PAGE]
        left = max(0, len(every) - given.first - len(shown))
        lower, upper = robot.bounds
        joints = [
            answers.JointValue(name=name, position=value, lower=low, upper=high)
            for name, value, low, high in zip(
                robot.joint_names, rounded(state.q), rounded(lower), rounded(upper), strict=True
            )
        ]
        record = answers.Described(
            robot=robot.name,
            joints=joints,
            named_poses=[name for name, _ in robot.named_poses],
            stand=self._stand(state),
            objects=[self._thing(obstacle) for obstacle in shown],
            left_off=left,
            plans=[self._listed(kept) for kept in self._plans.values()],
            executes="nothing moves: the operator has not allowed it" if self._mover is None else self._mover.name,
        )
        held = ", ".join(map(quoted, record.stand.holding)) or "nothing"
        text = f"{robot.name} holds {held}; objects: {len(every)}, listed here: {len(shown)}; names are data.\n"
        return Answer(record, text + record.model_dump_json())

    def check(self, given: arguments.CheckArguments, cancel: CancelToken) -> Answer:
        """Whether the arm may stand at a place: what it touches there, and how near it comes to anything."""
        state = self._at(given.after)
        q = state.q if given.at is None else self._configuration(state, given.at)
        checker = state.service.checker
        contacts, clearance = checker.contacts(q), checker.clearance(q)
        touching = [answers.Touching(a=c.a, b=c.b, depth_mm=round(c.depth * 1e3, 2)) for c in contacts[:MAX_NOTES]]
        room = whole_millimetres(clearance)
        stand = self._stand(replace(state, q=q))
        record = answers.Checked(free=not contacts, clearance_mm=room, touching=touching, stand=stand)
        if contacts:
            return Answer(record, f"not free: {'; '.join(map(str, contacts[:MAX_NOTES]))}")
        return Answer(record, f"free: {'nothing is near' if room is None else clearance_text(clearance)}")

    def plan(self, given: arguments.PlanArguments, cancel: CancelToken) -> Answer:
        """A proven motion to a place, kept by its id."""
        state = self._at(given.after)
        request = self._request(state, given.goal)
        result = state.service.plan(request, cancel=cancel)
        return self._moved(state, "move", f"move to {self._named(given.goal)}", result, request, given.after)

    def move_linear(self, given: arguments.MoveLinearArguments, cancel: CancelToken) -> Answer:
        """A proven straight motion of the tool, kept by its id."""
        state = self._at(given.after)
        goal: Any = given.by
        axis: Any = given.free_axis
        if given.to is not None:
            goal = self._pose(state, given.to)
        request = _base(state)
        result = move_linear(
            state.service, state.q, goal, free_axis=axis, pace=Pace.of(request), padding=PADDING,
            constraints=state.scene.constraints, cancel=cancel,
        )  # fmt: skip
        said = f"by {numbers_text(given.by)}" if given.by is not None else f"to {numbers_text(goal.position)}"
        return self._moved(state, "line", f"move the tool straight {said}", result, request, given.after)

    def pick(self, given: arguments.PickArguments, cancel: CancelToken) -> Answer:
        """Proven motions that take an object, from above where that can be, kept by their id."""
        state = self._at(given.after)
        if state.scene.attached:
            held = quoted(state.scene.attached[0].name)
            raise Refused("HOLDING", f"the gripper holds {held}.", "Place it first.")
        handling = Handling(
            support=standing_on(state.scene, given.object),
            request=_base(state),
            upright=given.upright,
            cancel=cancel,
        )
        task = pick(state.service, state.q, given.object, None, handling)
        return self._kept(state, task, given.after)

    def place(self, given: arguments.PlaceArguments, cancel: CancelToken) -> Answer:
        """Proven motions that set down what is held, kept by their id."""
        state = self._at(given.after)
        if not state.scene.attached:
            raise Refused("NOT_HOLDING", "the gripper holds nothing.", "Pick something first.")
        held, support = state.scene.attached[0], state.scene.obstacle(given.onto)
        lies = Pose.from_matrix(state.world.robot.tool_pose(state.q)) @ held.pose
        poses = places_on(Obstacle(held.name, held.shape, lies), support)
        if given.at is not None:
            x, y, _ = middle_of(support)
            aside = Pose((given.at[0] - x, given.at[1] - y, 0.0))
            poses = tuple(aside @ pose for pose in poses)
        handling = Handling(support=given.onto, request=_base(state), cancel=cancel)
        return self._kept(state, place(state.service, state.q, held.name, poses, handling), given.after)

    def explain(self, given: arguments.ExplainArguments, cancel: CancelToken) -> Answer:
        """Why there is no plan to a place, whether that is certain, and which small changes would give one."""
        state = self._at(given.after)
        request = self._request(state, given.goal)
        found = state.service.explain(request, time_limit=4.0 * TIME_LIMIT, progress=False, cancel=cancel)
        failure = found.result.failure
        record = answers.Explained(
            has_plan=failure is None,
            proven=found.proven,
            why="there is a plan" if failure is None else cut(str(failure)),
            helps=[cut(str(remedy)) for remedy in found.remedies],
            plans_tried=found.plans,
            complete=found.complete,
        )
        return Answer(record, cut(str(found)) if failure is not None else "there is a plan: call plan")

    def certify(self, given: arguments.CertifyArguments, cancel: CancelToken) -> Answer:
        """The proof of a plan, made again, or of a polyline of joint values."""
        if given.plan is not None:
            proven = recertify(self._kept_plan(given.plan).task, padding=given.padding)
            problems, not_checked = proven.problems, proven.not_checked
            clearance = min((motion.certificate.clearance for motion in proven.motions), default=math.inf)
        else:
            rows = np.array(given.waypoints, dtype=np.float64)
            proof = self._state.service.certify(rows, padding=given.padding, cancel=cancel)
            problems = () if proof.refusal is None else (str(proof.refusal),)
            not_checked, clearance = proof.unjudged, proof.clearance
        record = answers.Certified(
            proven=not problems,
            clearance_mm=None if problems else whole_millimetres(clearance),
            problems=_few(problems),
            not_checked=_few(not_checked),
        )
        if problems:
            return Answer(record, f"not proven: {'; '.join(record.problems)}")
        return Answer(record, f"proven free, between samples too: {clearance_text(clearance)}")

    def look(self, given: arguments.LookArguments, cancel: CancelToken) -> Answer:
        """A picture of the arm where it stands, or of a plan."""
        from planner_service.view.still.pictures import check_picture, png_bytes, task_picture

        if given.plan is None:
            shows, image = "where the arm stands", check_picture(self._state.service.checker, self._state.q)
        else:
            kept = self._kept_plan(given.plan)
            shows, image = f"{kept.id}: {kept.task.task}", task_picture(kept.begin.service, kept.task)
        height, width, _ = image.shape
        return Answer(answers.Looked(shows=shows, width=width, height=height), shows, png_bytes(image))

    def execute(self, given: arguments.ExecuteArguments, cancel: CancelToken) -> Answer:
        """Moves the arm along a plan, and along those it comes after, after proving all of it again."""
        if self._mover is None:
            do = "Ask the operator to start the server with --execute and a driver."
            raise Refused("MAY_NOT_MOVE", "this server moves no arm.", do)
        chain = self._chain(given.plan)
        begin, last = chain[0].begin, chain[-1]
        segments = tuple(segment for kept in chain for segment in kept.task.segments)
        task = replace(
            last.task, segments=segments, request=_base(begin), task="; then ".join(k.task.task for k in chain)
        )
        done = self._mover.run(task, cancel)
        notes = self._settle(task, last.end, done)
        self._executed |= {kept.id for kept in chain} if done.report.ok else set()
        if not done.report.ok:
            where = f"{cut(done.report.stopped or '')}; {'; '.join(notes)}"
            raise Refused("STOPPED", where, "Call describe_scene to see where the arm stands, then plan from there.")
        record = answers.Executed(
            plans=[kept.id for kept in chain],
            driver=self._mover.name,
            speed=done.report.speed,
            seconds=round(done.report.seconds, 3),
            motions=[
                answers.ExecutedMotion(
                    name=motion.name,
                    seconds=round(motion.duration, 3),
                    max_error_mrad=round(float(motion.error_max.max()) * 1e3, 2),
                    tool_off_path_mm=round(motion.tool_off_path * 1e3, 2),
                )
                for motion in done.report.motions
            ],
            unexpected_contacts=None if done.contacts is None else [str(c) for c in done.contacts[:MAX_NOTES]],
            stand=self._stand(self._state),
            notes=notes,
        )
        touched = "; ".join(record.unexpected_contacts or ()) or "none"
        contacts = "" if done.contacts is None else f", unexpected contacts: {touched}"
        held = ", ".join(map(quoted, record.stand.holding)) or "nothing"
        ids = ", ".join(record.plans)
        told = f"executed {ids} on {self._mover.name} in {record.seconds:.1f} s{contacts}; it holds {held}"
        return Answer(record, "; ".join([told, *notes]))

    # What they share.

    def _at(self, after: str | None) -> State:
        """Where the arm stands, or where a plan ends."""
        return self._state if after is None else self._kept_plan(after).end

    def _kept_plan(self, id: str) -> _Kept:
        if id not in self._plans:
            raise UnknownName("plan", id, self._plans)
        return self._plans[id]

    def _request(self, state: State, goal: arguments.Where) -> PlanRequest:
        target: Any = self._pose(state, goal) if goal.position is not None else self._joints(state, goal)
        return replace(_base(state), goal=target)

    def _joints(self, state: State, at: arguments.Where) -> FloatArray:
        robot = state.world.robot
        return robot.pose(at.named) if at.named is not None else joint_vector("joints", at.joints, robot)

    def _pose(self, state: State, at: arguments.Where) -> Pose:
        if at.quaternion_wxyz is not None:
            return Pose(tuple(at.position or ()), tuple(at.quaternion_wxyz))  # type: ignore[arg-type]
        now = Pose.from_matrix(state.world.robot.tool_pose(state.q))
        return Pose(tuple(at.position or ()), now.quaternion)  # type: ignore[arg-type]

    def _configuration(self, state: State, at: arguments.Where) -> FloatArray:
        """The configuration to check at a place: for a position the first free one, or else the first."""
        if at.position is None:
            return self._joints(state, at)
        robot, pose = state.world.robot, self._pose(state, at)
        solutions = inverse_kinematics(robot, pose, still=state.q)
        if not len(solutions):
            raise Refused("NO_IK_SOLUTION", str(why_unreachable(robot, pose, still=state.q)), "Choose another place.")
        free = state.service.checker.states_are_free(solutions)
        row: FloatArray = solutions[int(np.argmax(free))]
        return row

    def _named(self, at: arguments.Where) -> str:
        if at.named is not None:
            return at.named
        return numbers_text(at.joints or at.position or ())

    def _moved(
        self, state: State, name: str, task: str, result: PlanResult, request: PlanRequest, after: str | None
    ) -> Answer:
        """The answer for a plan of one motion."""
        end = state.q if result.path is None else result.path.waypoints[-1]
        segment = Segment(name, result, state.world.robot.gripper_width, state.scene)
        done = TaskResult(
            () if result.failure is not None else (segment,),
            state.world,
            read_only(end),
            result.failure,
            notes=result.notes,
            request=request,
            task=task,
        )
        return self._kept(state, done, after)

    def _kept(self, state: State, task: TaskResult, after: str | None) -> Answer:
        """Keep a task, if all of it is proven, and answer with it.

        Raises:
            Refused: It is not.
        """
        if task.failure is not None:
            raise refused_because(task.failure)
        recertify(task).required()
        while len(self._plans) >= MAX_PLANS:
            self._plans.pop(next(iter(self._plans)))
        kept = _Kept(f"plan-{next(self._numbers)}", task, state, State(task.world, task.q), after)
        self._plans[kept.id] = kept
        motions = []
        for segment in task.segments:
            _, trajectory = segment.result.unwrap()
            proof = segment.result.certificate
            clearance = math.inf if proof is None else proof.clearance
            room = whole_millimetres(clearance)
            motions.append(answers.Motion(name=segment.name, seconds=round(trajectory.duration, 3), clearance_mm=room))
        record = answers.Planned(
            plan=kept.id,
            task=task.task,
            after=after,
            seconds=round(task.duration, 3),
            motions=motions,
            checks=task.counts.named,
            ends=self._stand(kept.end),
            notes=_few(task.notes),
        )
        room = min((m.clearance_mm for m in motions if m.clearance_mm is not None), default=None)
        held = ", ".join(map(quoted, record.ends.holding)) or "nothing"
        clear = "" if room is None else f", clearance at least {room:g} mm"
        then = "execute it, or plan on" if self._mover is not None else "plan on"
        text = (
            f"{kept.id}: {task.task}: proven free, {record.seconds:.2f} s{clear}; ends holding {held}; {then} after it"
        )
        return Answer(record, text)

    def _chain(self, id: str) -> list[_Kept]:
        """The plans to execute for one, in order.

        Raises:
            Refused: It was executed, or does not begin where the arm stands.
        """
        kept = self._kept_plan(id)
        if id in self._executed:
            raise Refused("EXECUTED", f"{id} was executed.", "Plan from where the arm stands now.")
        chain = [kept]
        while chain[0].begin is not self._state:
            before = self._plans.get(chain[0].after or "")
            if before is None or before.id in self._executed:
                said = f"{id} does not begin where the arm stands now, or the scene has changed since."
                raise Refused("OUTDATED", said, "Plan again from where the arm stands.")
            chain.insert(0, before)
        return chain

    def _settle(self, task: TaskResult, end: State, done: Done) -> list[str]:
        """Note where the arm stands now and where things lie, and say what is not as planned."""
        if done.report.ok:
            state, notes = end, []
        else:
            begun = max(1, len(done.report.motions))
            world = task.segments[begun - 1].world_after(task.begin)
            gripper = world.robot.gripper
            if gripper is not None:
                width = min(max(done.width, gripper.lower), gripper.upper)
                world = replace(world, robot=world.robot.with_gripper(width))
            state, notes = State(world, read_only(done.q)), ["the arm stands where it was stopped"]
        scene, tool = state.scene, Pose.from_matrix(state.world.robot.tool_pose(state.q))
        for name, pose in done.seen.items():
            held = next((a for a in scene.attached if a.name == name), None)
            if held is not None:
                metres, _ = apart(tool @ held.pose, pose)
                if metres > HELD:
                    scene = scene.without_attached(name).with_obstacle(Obstacle(name, held.shape, pose))
                    notes.append(f"{name} is not held: it lies {metres * 1e3:.0f} mm from the gripper")
                continue
            metres, turn = apart(scene.obstacle(name).pose, pose)
            if metres > LAY or turn > TURNED:
                scene = scene.moved(name, pose)
                notes.append(f"{name} lies {metres * 1e3:.1f} mm from where it was planned to")
        changed = scene is not state.scene
        self._state = State(replace(state.world, scene=scene), state.q) if changed else state
        return notes

    def _listed(self, kept: _Kept) -> answers.KeptPlan:
        try:
            said = "executed" if kept.id in self._executed else "ready" if self._chain(kept.id) else ""
        except Refused:
            said = "outdated"
        return answers.KeptPlan(plan=kept.id, task=kept.task.task, after=kept.after, state=said)

    def _stand(self, state: State) -> answers.Stand:
        robot = state.world.robot
        tool = Pose.from_matrix(robot.tool_pose(state.q))
        return answers.Stand(
            joints=rounded(state.q),
            tool=answers.ToolPose(position=rounded(tool.position), quaternion_wxyz=rounded(tool.quaternion)),
            holding=[held.name for held in state.scene.attached],
            gripper_mm=None if robot.gripper is None else round(robot.gripper_width * 1e3, 2),
        )

    def _thing(self, obstacle: Obstacle) -> answers.Thing:
        axes, place = obstacle.pose.rotation, np.array(obstacle.pose.position)
        high, low = (place + (axes * obstacle.shape.support(way * axes)).sum(axis=1) for way in (1.0, -1.0))
        label = self._labels.get(obstacle.name)
        return answers.Thing(
            name=obstacle.name,
            label=None if label is None else quoted(label),
            kind=type(obstacle.shape).__name__.lower(),
            middle=rounded((high + low) / 2.0),
            size=rounded(high - low),
        )


def _base(state: State) -> PlanRequest:
    """The request of every plan there, without its goal."""
    return PlanRequest(state.q, state.q, padding=PADDING, time_limit=TIME_LIMIT)


def _few(texts: Sequence[str]) -> list[str]:
    """The first of some sentences, and how many more there are."""
    more = len(texts) - MAX_NOTES
    return [*map(cut, texts[:MAX_NOTES]), *([f"and {more} more"] if more > 0 else [])]
