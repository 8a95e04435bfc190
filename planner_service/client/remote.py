"""A planner in another process: the library's verbs, answered by a server, with the library's types as answers.

Nothing that a server says is believed: what it sends is read as strictly as a file, and a plan counts as one that
another process made. Whoever moves an arm proves it again with a robot and a scene of their own
(``records/recertify.py``), as ``execute`` does.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import cached_property, partial, wraps
from pathlib import Path
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, TypeVar

from numpy.typing import ArrayLike

from planner_service import tasks
from planner_service.certify import Certificate, ExemptInterval
from planner_service.client.answer import Answer
from planner_service.client.claims import (
    of_server,
    require_asked,
    require_carried,
    require_there,
    sure_grasps,
    task_result,
)
from planner_service.client.connection import Connection
from planner_service.client.problems import ServerUnavailable
from planner_service.client.server import Server
from planner_service.client.threads import Threads
from planner_service.collision import CancelToken, EdgeStep
from planner_service.collision.budget import Cancelled
from planner_service.constraints import Constraint
from planner_service.constraints.values import checked_constraints, constraint_names
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.geometry.validation import flag, instance, items, numbers, whole
from planner_service.infeasibility.remedies import Explanation
from planner_service.memory import Memory
from planner_service.memory.memory import checked_memory
from planner_service.path.joint_path import JointPath
from planner_service.planning.batch import Batch
from planner_service.planning.pipeline import require_plannable
from planner_service.planning.request import Goal, Pace, PlanRequest, World, kept_in
from planner_service.planning.result import Origin, PlanResult, Reason
from planner_service.planning.roadmap_work import Grower, require_grower
from planner_service.planning.task_result import Handling, TaskResult
from planner_service.presentation.progress import bar
from planner_service.records.http.bodies import sent
from planner_service.records.http.replies import (
    VERBS,
    CertificateReply,
    Checked,
    CheckReply,
    ExplainReply,
    RoadmapReply,
)
from planner_service.records.http.sections import ReplannedRecord, memory_of, read_reply
from planner_service.records.plan_file import SavedPlan
from planner_service.records.plan_reader import PlanReader
from planner_service.records.request import goals_of
from planner_service.replanning.result import Replanned, request_for, underway
from planner_service.roadmap import Roadmap
from planner_service.robot.model import Robot, joint_vector
from planner_service.scene.scene import Scene
from planner_service.search.problem import require_seed
from planner_service.service import PlannerService
from planner_service.tasks.solver import BEAM, SEARCHES
from planner_service.tasks.steps import Grasp
from planner_service.tasks.task import Task
from planner_service.timing.laws import Timing

__all__ = ["Remote", "unless_cancelled"]

P = ParamSpec("P")
T = TypeVar("T")

PATIENCE = 60.0

AT_ONCE = 8
"""Requests of ``plan_many`` that are sent before the first is answered."""

MAX_AT_ONCE = 256

SENT_AGAIN = 5
"""Times that a scene of one's own is sent again for a request; other clients may delete it."""


def unless_cancelled(verb: Callable[Concatenate[Remote, P], T]) -> Callable[Concatenate[Remote, P], T]:
    """The verb, whose answer is the library's in this process if it was cancelled before it is asked."""

    @wraps(verb)
    def called(remote: Remote, /, *args: P.args, **named: P.kwargs) -> T:
        given = (*args, *named.values())
        tokens = [value.cancel if isinstance(value, Handling) else value for value in given]
        if any(isinstance(token, CancelToken) and token.cancelled for token in tokens):
            here: Callable[..., T] = getattr(PlannerService, verb.__name__, None) or getattr(tasks, verb.__name__)
            return here(instance("remote", remote, Remote, "a Remote")._here, *args, **named)
        return verb(instance("remote", remote, Remote, "a Remote"), *args, **named)

    return called


class Remote:
    """Plans motions of a server's robot in one scene, as ``PlannerService`` does in this process.

    Several threads may use it at the same time. Plans have the bits and the counts that the library gives; they have
    no ``roadmap`` and no ``trace``. A connection that is lost is made again, and no request is done twice.

    Args:
        url: The server, such as ``http://127.0.0.1:8080``.
        scene: The name of a scene that the server has, whose latest version is meant, or a scene of your own, which is
            sent to the server when it is first used and deleted by ``close``.
        token: The server's token; None if it has none. Over http anyone on the way can read it.
        patience: Seconds for which a request is tried while the server cannot be reached or has no room.
        channel: Whether plans and all else that takes work are asked for over the server's channel, in msgpack, which
            takes less time than HTTP; the answers are the same.

    Raises:
        InvalidRequest: ``url`` is no address of a server, or another value is out of range.
        ServerUnavailable: there is no server, or it is not ready for as long as ``patience`` lasts.
        ServerRefused: the token is wrong, or the server has no such scene.
        MissingDependency: the extra ``client`` is not installed, which a channel needs.
    """

    def __init__(
        self,
        url: str,
        scene: Scene | str,
        *,
        token: str | None = None,
        patience: float = PATIENCE,
        channel: bool = False,
    ) -> None:
        server = Server(Connection(url, token, patience, channel=flag("channel", channel)))
        self._enter(server, server.world.robot, scene)

    def _enter(self, server: Server, robot: Robot, scene: Scene | str) -> None:
        self._server = server
        self._version: int | None = None
        if not isinstance(scene, Scene):
            scene, self._version = server.scenes.stored(instance("scene", scene, str, "a Scene, or the name of one"))
        self.world = replace(server.world, robot=robot, scene=scene)

    def _in(self, robot: Robot, scene: Scene | str) -> Remote:
        other = object.__new__(Remote)
        other._enter(self._server, robot, scene)
        return other

    def __repr__(self) -> str:
        return f"<Remote: {self.robot.name} in {self.scene.name or 'unnamed scene'}, {self._server.connection.url}>"

    def __enter__(self) -> Remote:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Delete scenes of your own from the server and close the connections, also those of ``with_scene``'s."""
        with closing(self._server.connection):
            self._server.scenes.forget()

    @property
    def robot(self) -> Robot:
        """The server's robot, with its gripper as it stands."""
        return self.world.robot

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.world.scene

    @property
    def allowed(self) -> tuple[tuple[str, str], ...]:
        """Pairs of link or object names that may touch, beside those the robot allows; sorted."""
        return self.world.allowed

    @property
    def edge_step(self) -> EdgeStep | None:
        """How finely edges are sampled; None if it is a rule of the server's own."""
        return self.world.edge_step

    def with_scene(self, scene: Scene | str) -> Remote:
        """The same server with another scene: one of your own, or the latest version of one that it has.

        Raises:
            ServerRefused: the server has no such scene.
        """
        return self._in(self.robot, scene)

    def store_scene(self, name: str, scene: Scene, *, version: int | None = None) -> int:
        """Store a scene under a name, for all clients of the server; the version that it then has.

        Whoever uses an earlier version goes on with that until they ask again, by ``with_scene(name)``.

        Args:
            version: Which version it replaces, 0 if there is none yet; None for whichever there is.

        Raises:
            StaleVersion: the server has another version by now.
            InvalidRequest: the server takes no such name, or the scene has no place in a file.
        """
        before = None if version is None else whole("version", version, 0, 2**53)
        return self._server.scenes.put(name, scene, before=before)

    def changed(self, *, gripper: float | None = None, scene: Scene | None = None) -> Remote:
        """The same server where the gripper stands ``gripper`` metres open, or with another scene."""
        other = self._in(
            self.robot if gripper is None else self.robot.with_gripper(gripper),
            self.scene if scene is None else scene,
        )
        other._version = self._version if scene is None else None
        return other

    def of(self, world: World) -> Remote:
        """A ``Remote`` on the same server that plans in another world, such as the one a ``TaskResult`` ends with.

        Raises:
            InvalidRequest: the world has another robot, or is checked in another way.
        """
        world = instance("world", world, World, "a World, such as task.world")
        robot = self.robot.opened_like(world.robot)
        if (robot.hash, self.allowed, self.edge_step) != (world.robot.hash, world.allowed, world.edge_step):
            raise InvalidRequest("world", world.robot.name, f"a world of the server's robot, {self.robot.name}")
        return self._in(robot, world.scene)

    # What is asked.

    @unless_cancelled
    def plan(self, request: PlanRequest, *, cancel: CancelToken | None = None) -> PlanResult:
        """A timed path from the start to a goal, or the reason why there is none; see ``PlannerService.plan``.

        Args:
            request: A roadmap as its planner has to be one that the server has grown (``build_roadmap``).
            cancel: Withdraws the request when it is cancelled from another thread.

        Raises:
            InvalidRequest: As ``PlannerService.plan``, or planner or timing law are not of this package.
            ServerUnavailable: the server cannot be reached, or has no room.
        """
        instance("request", request, PlanRequest, "a PlanRequest")
        require_plannable(request, self.robot, self.scene)
        answer = self._work("plans", {"request": request}, cancel)
        result = self._saved_plan(answer, answer.document(), request).result
        if result.trajectory is not None and result.trajectory.part is not None:
            raise InvalidFile(answer.url, ["trajectory.part: expected a motion along the whole path"])
        return result

    def plan_many(
        self,
        requests: Iterable[PlanRequest],
        *,
        at_once: int = AT_ONCE,
        progress: bool | None = None,
        finished: Mapping[int, PlanResult] | None = None,
    ) -> list[PlanResult]:
        """The plans of many requests, in their order; see ``PlannerService.plan_many``.

        Args:
            at_once: Requests that are sent before the first is answered; best twice the server's workers.
            progress: Whether standard error tells how far it is, by a bar or, where it is no terminal, by lines; if not
                given, only in a terminal.
            finished: Results that are not planned again, as in ``PlannerService.plan_many``.

        Raises:
            InvalidRequest: A request cannot be planned; the message names it.
            ServerUnavailable: As ``plan``.
            Interrupted: Ctrl-C. It has the ``results`` that were finished.
        """
        return self._batch.results(requests, _threads(at_once), progress, finished)

    def plan_stream(
        self, requests: Iterable[PlanRequest], *, at_once: int = AT_ONCE
    ) -> Generator[PlanResult, None, None]:
        """The same as ``plan_many``, one result after the other; see ``PlannerService.plan_stream``.

        Raises:
            InvalidRequest: As ``plan_many``.
            ServerUnavailable: As ``plan``.
        """
        return self._batch.stream(requests, _threads(at_once))

    @property
    def _batch(self) -> Batch:
        require = partial(require_plannable, robot=self.robot, scene=self.scene)
        return Batch(self.plan, require, partial(Origin, self.world, elsewhere=True))

    @unless_cancelled
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
        """The proof that any path is free, between samples too; see ``PlannerService.certify``.

        Raises:
            InvalidRequest: As ``PlannerService.certify``.
            Cancelled: ``cancel`` was cancelled.
            ServerUnavailable: As ``plan``.
        """
        stretches = items("exempt", exempt, ExemptInterval, "a list of ExemptInterval")
        curve = path if isinstance(path, JointPath) else JointPath(numbers("path", path, "waypoints of shape (N, n)"))
        body = {
            "waypoints": curve.waypoints,
            "blends": curve.blends,
            "padding": padding,
            "exempt": stretches,
            "constraints": checked_constraints(constraints),
            "part": part,
        }
        answer = self._work("certify", body, cancel)
        certificate: Certificate = answer.read(CertificateReply).certificate.value
        names = constraint_names(kept_in(self.scene, constraints)) if certificate.certified else ""
        asked = padding, stretches, None if part is None else tuple(part), names
        kept = ", ".join(dict.fromkeys(each.name for each in certificate.kept))
        if asked != (certificate.padding, certificate.exempt, certificate.part, kept):
            raise InvalidFile(answer.url, ["certificate: of something else than was asked"])
        return certificate

    def check(self, states: Sequence[ArrayLike] = (), edges: Sequence[tuple[ArrayLike, ArrayLike]] = ()) -> Checked:
        """Which configurations and straight edges are free, as a ``CollisionChecker`` says.

        Args:
            states: Configurations, shape (n,) each.
            edges: Pairs of configurations.

        Raises:
            InvalidRequest: One is not n finite numbers.
            ServerUnavailable: As ``plan``.
        """
        rows = [self._joints(f"states[{k}]", q) for k, q in enumerate(states)]
        pairs = [[self._joints(f"edges[{k}]", q) for q in edge] for k, edge in enumerate(edges)]
        answer = self._work("check", {"states": rows, "edges": pairs})
        checked: Checked = answer.read(CheckReply).value
        if (len(checked.states), len(checked.edges)) != (len(rows), len(pairs)):
            raise InvalidFile(answer.url, [f"expected {len(rows)} states and {len(pairs)} edges"])
        return checked

    @unless_cancelled
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
        """Why a request has no plan, and which small changes would give one; see ``PlannerService.explain``.

        Raises:
            InvalidRequest: As ``PlannerService.explain``.
            Cancelled: ``cancel`` was cancelled.
            ServerUnavailable: As ``plan``.
        """
        instance("request", request, PlanRequest, "a PlanRequest")
        require_plannable(request, self.robot, self.scene)
        body = {"request": request, "plans": plans, "remedies": remedies, "time_limit": time_limit}
        with bar("explaining", progress):
            answer = self._work("explain", body, cancel)
        document = answer.document()
        plan = document.get("result")
        document["result"] = self._reader.shared(plan if isinstance(plan, dict) else {}, answer.url)
        read = read_reply(ExplainReply, document, answer.url, self.robot.n)
        require_asked(answer, read.result.value.request, request)
        explained: Explanation = read.value
        explained = replace(explained, result=of_server(explained.result, self.world, request))
        changes = []
        if explained.way is not None:
            require_there(answer, request, explained.way, self.robot)
        for remedy in explained.remedies:
            require_there(answer, remedy.request, remedy.result, self.robot)
            scene = replace(remedy.scene, name=self.scene.name)
            result = of_server(remedy.result, replace(self.world, scene=scene), remedy.request)
            changes.append(replace(remedy, scene=scene, result=result))
        way = None if explained.way is None else of_server(explained.way, self.world, None, Pace.of(request))
        return replace(explained, remedies=tuple(changes), way=way)

    def replan(
        self,
        previous: PlanResult | Replanned,
        *,
        at_time: float,
        latency: float = 0.1,
        scene: Scene | str | None = None,
        goal: Goal | None = None,
        request: PlanRequest | None = None,
        cancel: CancelToken | None = None,
    ) -> Replanned:
        """Another motion for a robot that is moving, without a stop; see ``PlannerService.replan``.

        Args:
            previous: What this server has planned or replanned, and still keeps.

        Raises:
            InvalidRequest: As ``PlannerService.replan``, or this server has not made ``previous``.
            ServerUnavailable: As ``plan``.
        """
        if scene is not None:
            other = self.with_scene(scene)
            return other.replan(previous, at_time=at_time, latency=latency, goal=goal, request=request, cancel=cancel)
        old = underway(previous, self.robot, at_time, latency)
        new = request_for(previous, old, request, goal)  # refuses what cannot be kept
        if cancel is not None and cancel.cancelled:
            terms: Any = {"at_time": at_time, "latency": latency, "goal": goal, "request": request}
            return self._here.replan(previous, cancel=cancel, **terms)
        body = {
            "plan": self._server.plan_of(previous.trajectory),
            "at_time": at_time,
            "latency": latency,
            "goals": None if goal is None else goals_of(goal),
            "request": request,
        }
        answer = self._work("replan", body, cancel)
        plan = self._saved_plan(answer, answer.document(), new)
        failure = plan.result.failure
        if "replanned" not in plan.sections and failure is not None:  # no worker came to it, or workers were lost
            if failure.reason is Reason.PREEMPTED:
                raise Cancelled(failure.detail)
            raise ServerUnavailable(answer.url, failure.detail)
        return ReplannedRecord.of_plan(plan, answer.url)

    @unless_cancelled
    def solve(
        self,
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
        """All motions of a task, or the step that has none; see ``PlannerService.solve``.

        Raises:
            UnknownName: As ``PlannerService.solve``.
            InvalidRequest: Likewise, or a step has no place in a file.
            ServerUnavailable: As ``plan``.
        """
        instance("task", task, Task, "a Task")
        start = joint_vector("q", q, self.robot)
        instance("request", request, (PlanRequest, type(None)), "a PlanRequest, or None")
        body = {
            "q": start,
            "steps": task.steps,
            "name": task.name,
            "request": request,
            "line_timing": line_timing,
            "beam": whole("beam", beam, 1, 1_000),
            "searches": whole("searches", searches, 1, 1_000_000),
        }
        asked = PlanRequest(start, start) if request is None else replace(request, start=start, goal=start)
        return self._task("solve", body, asked, cancel, memory=memory, grasps=sure_grasps(task.stages))

    @unless_cancelled
    def build_roadmap(
        self, planner: Grower, *, seed: int = 0, padding: float = 0.001, cancel: CancelToken | None = None
    ) -> Roadmap:
        """A roadmap of the free space for many queries, which the server keeps; see ``PlannerService.build_roadmap``.

        Raises:
            InvalidRequest: As ``PlannerService.build_roadmap``.
            Cancelled: ``cancel`` was cancelled.
            ServerUnavailable: As ``plan``.
        """
        require_seed(seed)
        require_grower(planner)
        body = {"planner": planner, "seed": seed, "padding": padding}
        built = self._work("roadmaps", body, cancel).read(RoadmapReply).id
        answer = self._server.connection.fetch("GET", f"/roadmaps/{built}")
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "roadmap.npz"
            file.write_bytes(answer.data)
            roadmap = Roadmap.load(file)
        if roadmap.hash != built:
            raise InvalidFile(answer.url, [f"hash: got {roadmap.hash}; expected {built!r:.100}"])
        return roadmap

    # How it is asked.

    def _work(self, kind: str, given: Mapping[str, Any], cancel: CancelToken | None = None) -> Answer:
        """The answer to a request in this world; what is given are values by the fields of its body."""
        if cancel is not None:
            instance("cancel", cancel, CancelToken, "a CancelToken, or None")
        stored = {"name": self.scene.name, "version": self._version}
        model, world = VERBS[kind].body, {"scene": "own" if self._version is None else stored, **given}
        if "gripper_width" in model.model_fields and self.robot.gripper is not None:
            world["gripper_width"] = self.robot.gripper_width
        body = sent(model, world)
        connection, scenes = self._server.connection, self._server.scenes
        if self._version is not None:
            return connection.work(kind, body, cancel)
        left = SENT_AGAIN
        while True:
            own = scenes.reference(self.scene, again=left < SENT_AGAIN)
            try:
                return connection.work(kind, {**body, "scene": own}, cancel)
            except UnknownName as error:  # another client with the same scene has deleted it
                if not left or error.kind not in ("scene", f"version of scene {own['name']}"):
                    raise
            left -= 1

    def _joints(self, name: str, q: ArrayLike) -> list[float]:
        values: list[float] = joint_vector(name, q, self.robot).tolist()
        return values

    @property
    def _here(self) -> PlannerService:
        """The library in this process, which ends what was cancelled before it was asked."""
        return PlannerService.of(self.world)

    @cached_property
    def _reader(self) -> PlanReader:
        return PlanReader(self.world)

    def _saved_plan(
        self, answer: Answer, document: Mapping[str, Any], request: PlanRequest | None = None, pace: Pace | None = None
    ) -> SavedPlan:
        plan = self._reader.plan(document, answer.url, request)
        if request is not None and (plan.request is not None or plan.result.ok):
            require_asked(answer, plan.request, request)
            require_there(answer, request, plan.result, self.robot)
        self._server.remember(plan.result.trajectory, answer.job)
        return replace(plan, request=request, result=of_server(plan.result, self.world, request, pace))

    def _task(
        self,
        kind: str,
        body: Mapping[str, Any],
        request: PlanRequest,
        cancel: CancelToken | None,
        *,
        memory: Memory | None = None,
        taken: str = "",
        upright: Iterable[Constraint] | None = None,
        grasps: Sequence[Grasp] = (),
    ) -> TaskResult:
        """The outcome of a task.

        Args:
            request: The request of all its motions; it starts where the robot stands.
            memory: What is remembered before it; None to remember nothing.
            taken: The object that is carried with one of the constraints ``upright``, if these are given; no more of
                them are asked for than need be.
            grasps: Those that a task with all motions has: what they take is carried, as upright as they ask for.
        """
        known = checked_memory(memory, self.robot)
        answer = self._work(kind, {**body, "memory": memory}, cancel)
        saved = self._reader.task(answer.document(), answer.url)
        if saved.segments:
            require_asked(answer, saved.request, request)
            require_there(answer, request, saved.segments[0].result, self.robot, task=True)
        learned = memory_of(saved, answer.url)
        task = task_result(saved, request, known if learned is None else learned)
        scenes = [task.world.scene, *(segment.scene for segment in task.segments if segment.scene is not None)]
        held = [each for scene in scenes for each in scene.attached if each.name == taken]
        for constraint in () if upright is None else upright:
            held = [each for each in held if constraint not in each.constraints]
            if not held:
                break
        if held and upright is not None:
            raise InvalidFile(answer.url, [f"{taken}: carried without the constraint that was asked for"])
        if task.ok:
            require_carried(answer, grasps, [each for scene in scenes for each in scene.attached])
        return task


def _threads(at_once: int) -> Threads:
    return Threads(whole("at_once", at_once, 1, MAX_AT_ONCE))
