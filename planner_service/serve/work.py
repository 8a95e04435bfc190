"""What a worker does with a request: it reads the body, plans, and writes the answer as the library would save it.

The answer is bytes, so that the server's own process only stores and forwards.
"""

from __future__ import annotations

import tempfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from planner_service.collision import CancelToken, CheckCounts
from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.json_reader import parse_json
from planner_service.files.schema import Record, read_record, recorded
from planner_service.path.joint_path import JointPath
from planner_service.planning.accounting import told_of_stages
from planner_service.planning.request import PlanRequest, World
from planner_service.planning.result import Failure, Origin, PlanResult, Reason, Stage, StageReport
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.records.cells import SavedCellPlan
from planner_service.records.http import bodies
from planner_service.records.http.bodies import PaceBody
from planner_service.records.http.cell_bodies import PlanCellBody
from planner_service.records.http.replies import (
    VERBS,
    CertificateReply,
    Checked,
    CheckedState,
    CheckReply,
    ExplainReply,
    ProofReply,
    RoadmapReply,
)
from planner_service.records.http.sections import LineSections, ReplannedRecord, remembering
from planner_service.records.plan_file import SavedPlan, SavedTask, plan_or_task
from planner_service.records.recertify import recertify
from planner_service.records.scene import PlanReading, SceneRecord
from planner_service.records.visits import saved_order
from planner_service.replanning.result import Replanned
from planner_service.roadmap import Roadmap, RoadmapReference
from planner_service.robot.model import Robot
from planner_service.serve.problems import Problem, problem_of
from planner_service.service import PlannerService
from planner_service.tasks.ordering import order
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.tasks.primitives import pick, place
from planner_service.tasks.tool_motions import move_linear

__all__ = [
    "Answer",
    "Assignment",
    "Cancellation",
    "Ending",
    "Following",
    "ServerWork",
    "Source",
    "unrun",
]

MAX_SERVICES = 16
"""Worlds for which a worker stays prepared."""

MAX_CANCELLATIONS = 1_000
"""Cancellations that a worker remembers, as one may come before its request."""


class Ending(Enum):
    """Why a request ends before it has its answer: as failures and as problems say it, and in words."""

    CANCELLED = Reason.PREEMPTED, "cancelled", "the request was cancelled"
    DEADLINE = Reason.TIMED_OUT, "deadline-passed", "the deadline passed; whether a path exists is unknown"
    LOST = Reason.WORKER_LOST, "worker-lost", "two workers were lost with it"

    def __init__(self, reason: Reason, problem: str, detail: str) -> None:
        self.reason, self.problem, self.detail = reason, problem, detail


@dataclass(frozen=True)
class Source:
    """A stored content that a request reads: a scene, a plan or task file, or a roadmap.

    Attributes:
        hash: SHA-256 of the data, which the store has checked.
    """

    hash: str
    data: bytes


@dataclass(frozen=True)
class Assignment:
    """A request with all that it reads.

    Attributes:
        kind: One of ``VERBS``.
        body: The body of that kind, read; None for a request that is not carried out and whose answer is no file.
        sources: By what they are: ``scene``, ``after``, ``plan``, ``roadmap``.
    """

    id: str
    kind: str
    body: Any = None
    sources: Mapping[str, Source] = field(default_factory=dict)


@dataclass(frozen=True)
class Cancellation:
    """A note to a worker: end this request."""

    id: str
    ending: Ending


@dataclass(frozen=True)
class Following:
    """A note to a worker: a client wants to be told the stages of this request as they end."""

    id: str


@dataclass(frozen=True)
class Answer:
    """The outcome of a request.

    Attributes:
        content: A plan file, a task file, another JSON object, or a problem if ``refused``.
        ok: Whether what was asked for was found.
        reason: The reason of the failure if not.
        counts: The checks it took.
        stages: Its stages as clients are told them.
        told: How many of them were sent as notes before.
        roadmap: Hash and file of a roadmap that was grown.
    """

    content: bytes
    ok: bool
    reason: str | None = None
    refused: bool = False
    counts: CheckCounts = field(default_factory=CheckCounts)
    stages: tuple[Mapping[str, Any], ...] = ()
    told: int = 0
    roadmap: tuple[str, bytes] | None = None


class ServerWork:
    """Carries out requests for one robot; see ``TalkingWork``.

    Stages are sent as they end only while a client follows the request; a note for each would cost more than a short
    plan's search.

    Args:
        world: The robot, how its motions are checked, and the scene to be prepared for.
    """

    def __init__(self, world: World) -> None:
        self.world = world

    def connect(self, send: Callable[[Any], None]) -> None:
        """Take the function that sends stages as they end."""
        self._send = send
        self._running = ("", CancelToken())
        self._cancelled: OrderedDict[str, Ending] = OrderedDict()
        self._followed = ""
        self._stages: list[Mapping[str, Any]] = []
        self._told = 0
        self._telling = threading.Lock()
        self._services: OrderedDict[tuple[tuple[tuple[str, str], ...], float | None], PlannerService] = OrderedDict()

    def prepare(self) -> None:
        """Load what every plan needs."""
        PlannerService.of(self.world).plan(PlanRequest(self.world.robot.home, self.world.robot.home))

    def told(self, note: Any, /) -> None:
        """Take a cancellation, or that a client follows."""
        if isinstance(note, Following):
            with self._telling:
                self._followed = note.id  # of the request that runs, or is about to
                self._tell()
            return
        assert isinstance(note, Cancellation)
        self._cancelled[note.id] = note.ending
        if len(self._cancelled) > MAX_CANCELLATIONS:
            self._cancelled.popitem(last=False)
        running, token = self._running
        if running == note.id:
            token.cancel()

    def __call__(self, item: Assignment, /) -> Answer:
        cancel = CancelToken()
        self._running = (item.id, cancel)
        if item.id in self._cancelled:
            cancel.cancel()

        def stage_ended(report: StageReport) -> None:
            counts = {"states": report.counts.states, "edges": report.counts.edges}
            note = {"stage": report.stage.value, **counts, "seconds": report.seconds, "note": report.note}
            with self._telling:
                self._stages.append(note)
                self._tell()

        try:
            with told_of_stages(stage_ended):
                answer = self._answer(item, cancel)
        except (InvalidRequest, MissingDependency) as error:
            answer = Answer(problem_of(error).content, False, "INVALID_REQUEST", refused=True)
        except (_Ended, Cancelled):
            answer = unrun(item, self.world, self._cancelled[item.id])
        finally:
            with self._telling:  # a note that was sent later would be taken for one on the next request
                self._running = ("", cancel)
                stages, told = tuple(self._stages), self._told
                self._stages, self._told = [], 0
        return replace(answer, stages=stages, told=told)

    def _tell(self) -> None:
        """Send the stages that were not, if a client follows the request that runs."""
        if self._followed == self._running[0]:
            for note in self._stages[self._told :]:
                self._send(note)
            self._told = len(self._stages)

    def _answer(self, item: Assignment, cancel: CancelToken) -> Answer:
        call = _Call(item, cancel, lambda: self._cancelled.get(item.id), self._service(item))
        made: Answer = KINDS[item.kind](call, item.body)
        return made

    def _service(self, item: Assignment) -> PlannerService:
        """The service for the world of a request."""
        width = getattr(item.body, "gripper_width", None)
        named = tuple((name, source.hash) for name, source in item.sources.items() if name != "roadmap")
        key = (named, width)  # a task is the world that it begins in, or the one after it
        if key not in self._services:
            self._services[key] = PlannerService.of(_world(item, self.world))
            if len(self._services) > MAX_SERVICES:
                self._services.popitem(last=False)
        self._services.move_to_end(key)
        return self._services[key]


class _Ended(Exception):
    """A request whose answer is no file was cancelled."""


@dataclass(frozen=True)
class _Call:
    """One request under way."""

    item: Assignment
    cancel: CancelToken
    ending: Callable[[], Ending | None]
    service: PlannerService

    def poll(self) -> None:
        """Raise if the request was cancelled."""
        if self.cancel.cancelled:
            raise _Ended

    def ended(self, failure: Failure | None) -> Failure | None:
        """The failure, which the deadline is the reason of if it is what cancelled the request."""
        if failure is None or failure.reason is not Reason.PREEMPTED or self.ending() is not Ending.DEADLINE:
            return failure
        return replace(failure, reason=Reason.TIMED_OUT, detail=Ending.DEADLINE.detail)

    def planned(self, result: PlanResult, sections: Mapping[str, Any] | None = None) -> Answer:
        """The plan file of a result."""
        result = replace(result, failure=self.ended(result.failure))
        saved = replace(SavedPlan.of(result), sections=dict(sections or {}))
        return _file_answer(saved, result.failure, result.counts)

    def saved(self, name: str) -> SavedPlan | SavedTask:
        """A plan or a task that the request reads."""
        return plan_or_task(name, self.item.sources[name].data)

    def request(self, request: PlanRequest) -> PlanRequest:
        """The request, with its roadmap instead of the reference to it."""
        if not isinstance(request.planner, RoadmapReference):
            return request
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "roadmap.npz"
            file.write_bytes(self.item.sources["roadmap"].data)
            return replace(request, planner=Roadmap.load(file))


def _world(item: Assignment, world: World) -> World:
    """The world that a request is about: a stored scene, the world after a finished task, or the world of a plan.

    Raises:
        InvalidRequest: A task or a plan was made with another robot, or by a server of an earlier start.
    """
    robot = world.robot
    if "after" in item.sources:
        saved = plan_or_task("after", item.sources["after"].data)
        world = saved.begin
        for segment in _finished(saved).segments:
            world = segment.world_after(world)
        _require_same(robot, world.robot, "scene.after")
    elif "plan" in item.sources:
        world = plan_or_task("plan", item.sources["plan"].data).begin
        _require_same(robot, world.robot, "plan")
    if "scene" in item.sources:
        document = parse_json(Path("scene"), item.sources["scene"].data)
        world = replace(world, scene=read_record(SceneRecord, document, Path("scene"), PlanReading()).value)
    width = getattr(item.body, "gripper_width", None)
    return world if width is None else replace(world, robot=world.robot.with_gripper(width))


def _require_same(robot: Robot, other: Robot, field_name: str) -> None:
    """Refuse a robot that differs in more than how its gripper stands."""
    if robot.opened_like(other).hash != other.hash:
        raise InvalidRequest(field_name, other.name, f"one made with this server's robot, {robot.name}")


def _finished(saved: SavedPlan | SavedTask) -> SavedTask:
    if not isinstance(saved, SavedTask) or saved.failure is not None or not saved.segments:
        raise InvalidRequest("scene.after", "a plan, or a task that has no plan", "the id of a task with all motions")
    return saved


def _file_answer(saved: SavedPlan | SavedTask, failure: Failure | None, counts: CheckCounts) -> Answer:
    reason = None if failure is None else failure.reason.value
    return Answer(saved.compact(), failure is None, reason, counts=counts)


def _json_answer(model: type[Record], value: Any, *, ok: bool = True, counts: CheckCounts | None = None) -> Answer:
    return Answer(
        recorded("answer", lambda: model.of(value)).line, ok, counts=CheckCounts() if counts is None else counts
    )


def unrun(item: Assignment, world: World, ending: Ending) -> Answer:
    """The answer to a request that was not carried out, or not to its end: a file that says so, or a problem."""
    begin, verb = None, VERBS.get(item.kind)
    if verb is not None and verb.is_file:
        with suppress(InvalidRequest):  # it could not be carried out, either
            begin = _world(item, world)
    if begin is None or verb is None:
        problem = Problem(ending.problem, ending.detail, {"reason": ending.reason.value})
        return Answer(problem.content, False, ending.reason.value, refused=True)
    failure = Failure(Stage.ENDPOINTS, ending.reason, ending.detail)
    if verb.is_task:
        return _file_answer(SavedTask(begin, item.kind, (), CheckCounts(), 0.0, failure), failure, CheckCounts())
    request = item.body.request.value if item.kind == "plans" else None
    result = PlanResult(None, None, failure, (), deterministic=False)
    return _file_answer(SavedPlan(begin, request, result), failure, CheckCounts())


# Each kind of request.


def _plan(call: _Call, body: bodies.PlanBody) -> Answer:
    return call.planned(call.service.plan(call.request(body.request.value), cancel=call.cancel))


def _certify(call: _Call, body: bodies.CertifyBody) -> Answer:
    if body.plan is not None:
        saved = call.saved("plan")
        proven = recertify(saved, allowed=saved.allowed)
        return _json_answer(ProofReply, proven, ok=proven.certified)
    path = JointPath(np.array(body.waypoints, dtype=np.float64), np.array(body.blends or (), dtype=np.float64))
    terms = {name: body.arguments[name] for name in ("padding", "exempt", "constraints", "part")}
    certificate = call.service.certify(path, **terms, cancel=call.cancel)
    counts = CheckCounts(distances=certificate.distances)
    return _json_answer(CertificateReply, {"certificate": certificate}, ok=certificate.certified, counts=counts)


def _check(call: _Call, body: bodies.CheckBody) -> Answer:
    checker = call.service.checker.counting_anew()
    states = []
    for q in body.states:
        call.poll()
        free = checker.state_is_free(q)
        states.append(CheckedState(free, () if free else checker.contacts(q)))
    edges = []
    for start, end in body.edges:
        call.poll()
        edges.append(checker.edge_is_free(start, end))
    return _json_answer(CheckReply, Checked(tuple(states), tuple(edges), checker.counts))


def _pick(call: _Call, body: bodies.PickBody) -> Answer:
    handling = _handling(call, body.handling)
    task = pick(call.service, body.q, body.target, body.arguments["grasps"], handling, memory=body.remembered)
    return _task_answer(call, task)


def _place(call: _Call, body: bodies.PlaceBody) -> Answer:
    q = _where(call, body.q)
    handling = _handling(call, body.handling)
    task = place(call.service, q, body.carried, body.arguments["poses"], handling, memory=body.remembered)
    return _task_answer(call, task)


def _pick_place(call: _Call, body: bodies.PickPlaceBody) -> Answer:
    request = call.request(body.plan_request)
    terms: Any = {"poses": body.arguments["poses"], "upright": body.upright, "memory": body.remembered}
    task = plan_pick_place(call.service, body.target, body.onto, request, **terms, cancel=call.cancel)
    return _task_answer(call, task)


def _solve(call: _Call, body: bodies.SolveBody) -> Answer:
    q = _where(call, body.q)
    request = None if body.request is None else call.request(body.request.value)
    law = None if body.line_timing is None else body.line_timing.value
    terms: Any = {"line_timing": law, "beam": body.beam, "searches": body.searches, "memory": body.remembered}
    return _task_answer(call, call.service.solve(body.value, q, request=request, **terms, cancel=call.cancel))


def _order(call: _Call, body: bodies.OrderBody) -> Answer:
    q = _where(call, body.q)
    settings = PlanRequest(q, q) if body.request is None else body.request.value
    request = call.request(replace(settings, start=q, goal=q))
    terms: Any = {"end": body.end, "gap": body.gap, "plans": body.plans, "cancel": call.cancel}
    return _saved_answer(call, saved_order(order(call.service, body.value, request, **terms)))


def _where(call: _Call, q: Any) -> Any:
    """Where the robot stands: as is said, or where the task before ended."""
    if q is not None:
        return q
    path = _finished(call.saved("after")).segments[-1].result.path
    assert path is not None
    return path.waypoints[-1]


def _handling(call: _Call, body: bodies.HandlingBody | None) -> Handling:
    handling = Handling() if body is None else body.value
    request = None if handling.request is None else call.request(handling.request)
    return replace(handling, request=request, cancel=call.cancel)


def _task_answer(call: _Call, task: TaskResult) -> Answer:
    return _saved_answer(call, remembering(SavedTask.of(task), task.memory))


def _saved_answer(call: _Call, saved: SavedTask) -> Answer:
    saved = replace(saved, failure=call.ended(saved.failure))
    return _file_answer(saved, saved.failure, saved.counts)


def _move_linear(call: _Call, body: bodies.MoveLinearBody) -> Answer:
    given = body.arguments
    for name in ("deadline", "scene", "gripper_width"):
        del given[name]
    result = move_linear(call.service, given.pop("start"), given.pop("goal"), cancel=call.cancel, **given)
    said = {"fraction": result.fraction, "pace": body.pace}
    return call.planned(result, LineSections.of(said).document())


def _replan(call: _Call, body: bodies.ReplanBody) -> Answer:
    saved = call.saved("plan")
    if not isinstance(saved, SavedPlan):
        raise InvalidRequest("plan", body.plan, "the id of a plan, not of a task")
    terms = {"at_time": body.at_time, "latency": body.latency, "goal": body.goal}
    request = None if body.request is None else call.request(body.request.value)
    replanned = call.service.replan(_previous(saved), request=request, cancel=call.cancel, **terms)
    section = ReplannedRecord.of(replace(replanned, failure=call.ended(replanned.failure)))
    return call.planned(replanned.result, {"replanned": section.document()})


def _previous(saved: SavedPlan) -> PlanResult | Replanned:
    """The motion that a plan file of this server holds."""
    pace = LineSections.of_plan(saved, "plan").pace or PaceBody()
    origin = Origin(saved.begin, saved.request, pace.value if saved.request is None else None)
    result = replace(saved.result, origin=origin)
    if "replanned" not in saved.sections or saved.request is None:
        return result
    return replace(ReplannedRecord.of_plan(saved, "plan"), result=result)


def _explain(call: _Call, body: bodies.ExplainBody) -> Answer:
    request = call.request(body.request.value)
    terms: Any = {name: body.arguments[name] for name in ("plans", "remedies", "time_limit")}
    explained = call.service.explain(request, **terms, progress=False, cancel=call.cancel)
    return _json_answer(ExplainReply, (explained, call.service.world), counts=explained.result.counts)


def _plan_cell(call: _Call, body: PlanCellBody) -> Answer:
    plan = body.asked(call.service.robot, call.service.scene).plan(call.cancel)
    saved = SavedCellPlan.of(replace(plan, failure=call.ended(plan.failure)))
    reason = None if saved.failure is None else saved.failure.reason.value
    return Answer(saved.compact(), plan.ok, reason, counts=plan.counts)


def _roadmaps(call: _Call, body: bodies.RoadmapBody) -> Answer:
    planner: Any = body.planner.value
    roadmap = call.service.build_roadmap(planner, seed=body.seed, padding=body.padding, cancel=call.cancel)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "roadmap.npz"
        roadmap.save(file)
        data = file.read_bytes()
    assert roadmap.built is not None
    answer = _json_answer(RoadmapReply, roadmap, counts=roadmap.built.counts)
    return replace(answer, roadmap=(roadmap.hash, data))


KINDS: Mapping[str, Callable[[_Call, Any], Answer]] = {
    "plans": _plan,
    "certify": _certify,
    "check": _check,
    "pick": _pick,
    "place": _place,
    "pick_place": _pick_place,
    "solve": _solve,
    "order": _order,
    "move_linear": _move_linear,
    "replan": _replan,
    "explain": _explain,
    "plan_cell": _plan_cell,
    "roadmaps": _roadmaps,
}
