"""The server behind the routes: it accepts requests, hands them to workers and keeps the outcomes.

A request is accepted once it is in the store, and answered once its answer is. After a restart whatever was accepted
and has no answer is carried out, which gives the same answer: plans are deterministic.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
import re
import shutil
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from statistics import fmean
from typing import Any

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.files.json_reader import parse_json
from planner_service.files.schema import read_record
from planner_service.parallel.pool import Backend, Raised
from planner_service.planning.request import World
from planner_service.presentation.page import OpenPage, show_page
from planner_service.records.exports.formats import How, Saved, exported, kept, one_motion
from planner_service.records.http.bodies import AfterTask, Body, EditsBody, SceneBody, SceneVersion, read_body
from planner_service.records.http.replies import VERBS, RobotReply
from planner_service.records.plan_file import SavedPlan, plan_or_task
from planner_service.records.scene import PlanReading, SceneRecord
from planner_service.roadmap import RoadmapReference
from planner_service.scene.scene import Scene
from planner_service.serve.jobs import Dispatcher, Task
from planner_service.serve.metrics import Metrics
from planner_service.serve.problems import Problem, Refused, problem_of
from planner_service.serve.state.store import (
    ANY_VERSION,
    ENDED,
    Job,
    ReusedKey,
    StaleVersion,
    State,
    StateUnusable,
    Store,
)
from planner_service.serve.state.store import SceneVersion as SceneEntry
from planner_service.serve.work import Answer, Assignment, Ending, Source, unrun

__all__ = ["PlanningServer", "StoredAnswer", "StoredScene", "listed"]

logger = logging.getLogger(__name__)

MAX_RETRY_AFTER = 60
"""Seconds after which a client that found no room should ask again, at most."""

MAX_FOLLOWERS = 100
"""Clients that follow the stages of requests at the same time."""

MAX_PAGES = 4
"""Pages of the viewer that are open at the same time."""

RECENT = 100
"""Requests whose times say how long one takes."""

KEEP_PAUSE = 1.0
"""Seconds before it is tried again to keep an answer for which the disk had no room."""

SCENES_AT_HAND = 16
"""Scenes that are read from the disk, and checked against their hash, only once while they are used."""


SHORT_BODY = 16_384
"""Bytes of a body that is read at once; a longer one is read in a thread, so that others need not wait for it."""


KEY = re.compile(r"[\x21-\x7e]{1,255}")
"""An idempotency key."""

MAX_POINTS = 50_000
"""Points in time of the motions in an answer: more take seconds to write, in which nobody else is answered."""

PROBLEM = re.compile(rb'\{"type": ?"urn:problem-type:planner-service:')
"""How the answer to a refused request begins."""


@dataclass(frozen=True)
class StoredAnswer:
    """The answer to a request; a problem if it was refused."""

    content: bytes
    refused: bool

    @property
    def status(self) -> int:
        """The HTTP status."""
        return int(json.loads(self.content)["status"]) if self.refused else 200


@dataclass(frozen=True)
class StoredScene:
    """One version of a scene, as clients get it."""

    version: int
    document: bytes


@dataclass(eq=False)
class _Live:
    """A request that has no answer yet, and the events that its followers receive.

    Attributes:
        events: Name and data of every event so far.
        followers: How many clients receive the events as they happen.
        news: Set when an event is added, and replaced by a new one.
        done: Gets the answer after it is in the store, or None when the server stops.
    """

    job: Job
    done: asyncio.Future[StoredAnswer | None]
    began: float = field(default_factory=time.monotonic)
    events: list[tuple[str, Mapping[str, Any]]] = field(default_factory=list)
    followers: int = 0
    ended: bool = False
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def let_go(self) -> None:
        """Let clients go that wait for its answer."""
        self.news.set()
        with suppress(asyncio.InvalidStateError):
            self.done.set_result(None)


@dataclass(frozen=True, eq=False)
class _Ended:
    """What a job has come to."""

    live: _Live
    state: State
    answer: Answer


class PlanningServer:
    """A server for one robot.

    Args:
        world: The robot, how its motions are checked, and the scene that workers prepare for.
        store: Closed by ``stop``.
        backend: Starts workers for a ``ServerWork``, and talks to them.
        capacity: Requests that may wait for a worker.
        poll: As of ``Dispatcher``.
        scenes: Stored unless there is one of that name.
    """

    def __init__(
        self,
        world: World,
        store: Store,
        backend: Backend[Any],
        *,
        capacity: int,
        poll: float,
        scenes: tuple[Scene, ...] = (),
        folder_to_remove: Path | None = None,
    ) -> None:
        self._world, self.store, self._capacity, self._workers = world, store, capacity, backend.max_workers
        self._folder_to_remove = folder_to_remove
        self._dispatcher: Dispatcher[Any] = Dispatcher(backend, self, poll)
        self.metrics = Metrics(lambda: self._dispatcher.waiting, lambda: self._dispatcher.running)
        self._live: dict[str, _Live] = {}
        self._seconds: deque[float] = deque(maxlen=RECENT)
        self._arriving = self._followers = 0
        self._leaving = threading.Event()
        self._unkept: dict[str, _Ended] = {}
        self._keeper = threading.Thread(target=self._keep_again, name="answers to keep", daemon=True)
        self._pages: deque[OpenPage] = deque()
        self._scene_content = lru_cache(SCENES_AT_HAND)(store.content)
        for scene in scenes:
            if all(stored.name != scene.name for stored in store.scenes()):
                store.put_scene(scene.name, scene.hash, _scene_document(scene))
        self.robot_document = RobotReply.of(world).line

    async def start(self) -> None:
        """Start the workers, and what was accepted before."""
        self._loop = asyncio.get_running_loop()
        self._keeper.start()
        await asyncio.to_thread(self._dispatcher.start)
        for job in await asyncio.to_thread(self.store.unfinished):
            await asyncio.to_thread(self._restart, job)

    def leave(self) -> None:
        """Accept nothing more, and let clients go that wait."""
        self._leaving.set()
        for live in list(self._live.values()):
            live.let_go()

    async def stop(self) -> None:
        """End the workers; what they have not answered is carried out after the next start."""
        self.leave()
        try:
            await asyncio.to_thread(self._dispatcher.stop)
            await asyncio.to_thread(self._keeper.join)
            await asyncio.to_thread(self.store.close)
        finally:
            for page in self._pages:
                page.close()
            if self._folder_to_remove is not None:
                shutil.rmtree(self._folder_to_remove, ignore_errors=True)

    def _restart(self, job: Job) -> None:
        """Carry out a job that was accepted before the server was started."""
        live = self._alive(job)
        work = json.loads(self.store.work(job.id))
        left = None if work["deadline"] is None else work["deadline"] - time.time()
        try:
            body = read_body(VERBS[job.kind].body, work["body"].encode(), self._world.robot)
        except InvalidRequest as error:
            self._end(live, Assignment(job.id, job.kind), _refusal(error))
        else:
            self._begin(live, body, work["sources"], left, cancelled=work.get("cancelled", False))

    def _begin(
        self, live: _Live, body: Body, sources: Mapping[str, str], left: float | None, *, cancelled: bool = False
    ) -> None:
        """Have a job carried out that is in the store, unless it was cancelled."""
        job = live.job
        try:
            assignment = self._assignment(job, body, sources)
        except InvalidRequest as error:  # such as a damaged content: it ends the request that reads it, not the server
            self._end(live, Assignment(job.id, job.kind), _refusal(error))
            return
        if cancelled or job.attempts >= MAX_STARTS:
            self._end(live, assignment, Ending.CANCELLED if cancelled else Ending.LOST)
        else:
            self._say(live, "state", {"state": "queued"})
            self._dispatcher.submit(Task(assignment, None if left is None else time.monotonic() + left))

    def _alive(self, job: Job) -> _Live:
        live = self._live[job.id] = _Live(job, self._loop.create_future())
        if self._stopping:
            live.let_go()
        return live

    @property
    def _stopping(self) -> bool:
        return self._leaving.is_set()

    @property
    def ready(self) -> bool:
        """Whether it can plan."""
        return self._dispatcher.ready and not self._stopping and self.store.usable

    # Requests for work.

    def require_room(self, key: str | None) -> None:
        """Return if another request may be accepted, or one with this key was.

        Raises:
            Refused: There is no room, or the server stops, or the key is none.
        """
        if key is not None and not KEY.fullmatch(key):
            raise Refused("malformed", "Idempotency-Key: expected 1 to 255 printable ASCII characters without spaces")
        self._require_open()
        waiting = self._dispatcher.waiting + self._arriving + len(self._unkept)
        if waiting >= self._capacity and not (key is not None and self.store.knows(key)):
            self.metrics.refused.inc()
            raise Refused(
                "queue-full", f"{waiting} requests are waiting", headers={"Retry-After": str(self.retry_after())}
            )

    def _require_open(self) -> None:
        if self._stopping:
            raise Refused("unavailable", "the server is stopping", headers={"Retry-After": "5"})

    def retry_after(self) -> int:
        """Seconds after which a worker probably has time."""
        each = fmean(self._seconds) if self._seconds else 1.0
        return max(1, min(MAX_RETRY_AFTER, math.ceil(self._dispatcher.waiting * each / self._workers)))

    async def accept(self, kind: str, body: bytes, key: str | None) -> str:
        """The id of a new job, or of the one with the same key.

        Raises:
            Refused: The key came with another request.
            InvalidRequest: The body is wrong.
        """
        self._arriving += 1
        try:
            if len(body) <= SHORT_BODY:
                return self._accept(kind, body, key)
            return await asyncio.to_thread(self._accept, kind, body, key)
        finally:
            self._arriving -= 1

    def _accept(self, kind: str, body: bytes, key: str | None) -> str:
        self._require_open()
        try:
            earlier = None if key is None else self.store.accepted(kind, body, key)
            if earlier is not None:  # whether or not what it names is still there
                return earlier.id
            read: Any = read_body(VERBS[kind].body, body, self._world.robot)
            sources = self._sources(read)
            deadline = None if read.deadline is None else time.time() + read.deadline
            work = json.dumps({"body": body.decode(), "sources": sources, "deadline": deadline}).encode()
            job, new = self.store.accept(kind, work, request=body, key=key, uses=list(sources.values()))
        except ReusedKey as error:
            raise Refused("key-reused", str(error)) from None
        if new:
            self.metrics.accepted.labels(kind).inc()
            self._begin(self._alive(job), read, sources, read.deadline)
        return job.id

    def _sources(self, body: Any) -> dict[str, str]:
        """The contents that a request reads, by what they are."""
        sources = {}
        scene, plan = getattr(body, "scene", None), getattr(body, "plan", None)
        if isinstance(scene, AfterTask):
            sources["after"] = self._answer_content("scene.after", scene.after)
        elif isinstance(scene, SceneVersion):
            sources["scene"] = self.store.scene(scene.name, scene.version).content
        elif scene is not None:
            sources["scene"] = self.store.scene(scene).content
        if isinstance(plan, str):
            sources["plan"] = self._answer_content("plan", plan)
        for planner in _planners(body):
            if isinstance(planner, RoadmapReference):
                sources["roadmap"] = self.store.roadmap(planner.hash)
        return sources

    def _answer_content(self, field_name: str, job: str) -> str:
        found = self.store.job(job)
        if found.state is not State.DONE or found.answer is None:
            raise InvalidRequest(field_name, job, f"the id of a finished plan or task; it is {found.state.value}")
        return found.answer

    def _assignment(self, job: Job, body: Body, sources: Mapping[str, str]) -> Assignment:
        read = {"scene": self._scene_content}
        contents = {name: Source(key, read.get(name, self.store.content)(key)) for name, key in sources.items()}
        return Assignment(job.id, job.kind, body, contents)

    # What the dispatcher tells.

    def started(self, task: Task) -> None:
        """See ``Listener``."""
        self._say(self._live[task.id], "state", {"state": "running"})
        self.store.start(task.id)

    def noted(self, task: Task, note: Any) -> None:
        """See ``Listener``."""
        self._say(self._live[task.id], "stage", note)

    def retried(self, task: Task) -> None:
        """See ``Listener``."""
        self.metrics.retried.inc()
        self._say(self._live[task.id], "state", {"state": "retried"})

    def ended(self, task: Task, outcome: Answer | Ending | Raised) -> None:
        """See ``Listener``."""
        live = self._live[task.id]
        self._seconds.append(time.monotonic() - live.began)
        for note in outcome.stages[outcome.told :] if isinstance(outcome, Answer) else ():
            self._say(live, "stage", note)
        self._end(live, task.assignment, outcome)

    def _end(self, live: _Live, assignment: Assignment, outcome: Answer | Ending | Raised) -> None:
        """Keep what a job has come to, and tell it then; what cannot be kept now is tried again until it is."""
        ended = _Ended(live, *self._outcome(assignment, outcome))
        try:
            self._keep_and_tell(ended)
        except StateUnusable as error:
            logger.error("the answer to %s waits to be kept: %s", live.job.id, error)
            self._unkept[live.job.id] = ended

    def _keep_again(self) -> None:
        while not self._leaving.wait(KEEP_PAUSE):
            for job, ended in list(self._unkept.items()):
                with suppress(StateUnusable):
                    self._keep_and_tell(ended)
                    del self._unkept[job]

    def _keep_and_tell(self, ended: _Ended) -> None:
        job, state, answer = ended.live.job, ended.state, ended.answer
        try:
            self._keep(job, state, answer)
        except StateUnusable:
            raise
        except InvalidRequest as error:  # it is too large, or there are too many roadmaps
            logger.error("the answer to %s cannot be kept: %s", job.id, error)
            problem = Problem("not-kept", problem_of(error).detail)
            state, answer = State.REFUSED, Answer(problem.content, False, "NOT_KEPT", refused=True)
            self._keep(job, state, answer)
        self.metrics.ended(job.kind, time.monotonic() - ended.live.began, answer)
        self._say(ended.live, "state", {"state": _shown(state)}, StoredAnswer(answer.content, answer.refused))

    def _keep(self, job: Job, state: State, answer: Answer) -> None:
        if answer.roadmap is not None:
            roadmap_hash, file = answer.roadmap
            self.store.put_roadmap(roadmap_hash, file)
        self.store.end(job.id, state, answer.content, ok=answer.ok, reason=answer.reason)

    def _outcome(self, assignment: Assignment, outcome: Answer | Ending | Raised) -> tuple[State, Answer]:
        if isinstance(outcome, Raised):
            logger.error("a bug: %s", outcome.traceback)
            problem = Problem("internal", "a bug in planner_service; the server's log has more")
            return State.REFUSED, Answer(problem.content, False, "BUG", refused=True)
        ending = outcome if isinstance(outcome, Ending) else None
        if ending is not None:
            outcome = unrun(assignment, self._world, ending)
        assert isinstance(outcome, Answer)
        if ending is Ending.LOST:
            return State.LOST, outcome
        if outcome.reason == Ending.CANCELLED.reason.value:
            return State.CANCELLED, outcome
        return State.REFUSED if outcome.refused else State.DONE, outcome

    def _say(self, live: _Live, name: str, data: Mapping[str, Any], answer: StoredAnswer | None = None) -> None:
        """Tell an event to those who follow a job; from any thread. The loop is woken only if there are any."""

        def wake() -> None:
            if answer is not None:
                live.ended = True
                self._live.pop(live.job.id, None)
                if not live.done.done():
                    live.done.set_result(answer)
            news, live.news = live.news, asyncio.Event()
            news.set()

        live.events.append((name, data))
        if answer is not None or live.followers:
            self._loop.call_soon_threadsafe(wake)

    # What clients ask about jobs.

    async def durable(self) -> None:
        """Return when everything that was accepted survives a power cut."""
        await asyncio.to_thread(self.store.sync)

    async def answer(self, job: str) -> StoredAnswer | None:
        """The answer of a job, None as long as it has none."""
        if job in self._live:
            return None
        found, content = await asyncio.to_thread(self.store.answer, job)
        if found.state not in ENDED:
            return None
        if content is None:
            ending = Ending.LOST if found.state is State.LOST else Ending.CANCELLED
            content = unrun(Assignment(job, ""), self._world, ending).content
            return StoredAnswer(content, True)
        return StoredAnswer(content, PROBLEM.match(content) is not None)

    def pending(self, job: str) -> asyncio.Future[StoredAnswer | None] | None:
        """Gets the answer of a job, None if the server stops before; None for a job that has ended."""
        live = self._live.get(job)
        return None if live is None else live.done

    async def state(self, job: str) -> dict[str, Any]:
        """Where a job without an answer is."""
        found = await asyncio.to_thread(self.store.job, job)
        links = {"self": f"/plans/{job}", "events": f"/plans/{job}/events"}
        position = self._dispatcher.position(job)
        state = "queued" if position is not None else "running"
        return {"id": job, "kind": found.kind, "state": state, "position": position, "links": links}

    def cancel(self, job: str) -> bool:
        """End a job, and after a restart, too; False if it has ended, there is none, or the server stops.

        Raises:
            StateUnusable: It ends, but would be carried out after a restart.
        """
        if self._stopping or not self._dispatcher.cancel(job):
            return False
        with suppress(UnknownName):  # it has ended by now
            work = json.loads(self.store.work(job))
            self.store.change_work(job, json.dumps({**work, "cancelled": True}).encode())
        return True

    def jobs(self, limit: int, after: str | None) -> dict[str, Any]:
        """Jobs, newest first."""
        found = self.store.jobs(limit, before=after)
        plans = [
            {"id": job.id, "kind": job.kind, "state": _shown(job.state), "created": job.accepted}
            | {"ok": job.ok, "reason": job.reason}
            for job in found
        ]
        return {"plans": plans, "next": found[-1].id if len(found) == limit else None}

    async def events(self, job: str) -> AsyncIterator[bytes]:
        """What happens to a job, as server-sent events, from the beginning to its end.

        Raises:
            UnknownName: There is no such job.
            Refused: Too many clients follow one.
        """
        live = self._live.get(job)
        if live is None:
            return _told(await asyncio.to_thread(self.store.job, job))
        if self._followers >= MAX_FOLLOWERS:
            raise Refused("unavailable", f"{MAX_FOLLOWERS} clients follow requests", headers={"Retry-After": "5"})
        return self._follow(live)

    async def _follow(self, live: _Live) -> AsyncIterator[bytes]:
        self._followers += 1
        live.followers += 1  # before it looks at the events: whatever is said from now on wakes it
        try:
            await asyncio.to_thread(self._dispatcher.follow, live.job.id)
            told = 0
            while not self._stopping:
                news, ended, events = live.news, live.ended, live.events[told:]
                for name, data in events:
                    yield _event(name, data)
                told += len(events)
                if ended:
                    return
                await news.wait()
        finally:
            self._followers -= 1
            live.followers -= 1

    async def view(self, job: str) -> str:
        """The address of a page that shows a plan or a task.

        Raises:
            UnknownName: There is no such job.
            Refused: It has no motions.
        """
        answer = await self.answer(job)
        if answer is None:
            raise Refused("in-use", "it is not finished")
        return await asyncio.to_thread(self._shown_page, answer.content)

    async def trajectory(self, job: str, form: str, how: How, segment: str | None) -> tuple[str | bytes, str]:
        """The motions of a plan or a task in a format, or one of them, and what that keeps of the proven curves.

        Raises:
            UnknownName: There is no such job, motion or format.
            InvalidRequest: as of ``exported``.
            Refused: It has no motions.
        """
        answer = await self.answer(job)
        if answer is None:
            raise Refused("in-use", "it is not finished")
        return await asyncio.to_thread(_exported, answer.content, form, how, segment)

    def _shown_page(self, content: bytes) -> str:
        saved = _motions_of(content)
        while len(self._pages) >= MAX_PAGES:
            self._pages.popleft().close()
        shown = saved.result if isinstance(saved, SavedPlan) else saved
        page = show_page(saved.begin, shown, port=0, block=False)
        self._pages.append(page)
        return page.url

    # Scenes: these wait for the disk.

    def scene(self, name: str, version: int | None) -> StoredScene:
        """A version of a scene; the latest by default."""
        entry = self.store.scene(name, version)
        return StoredScene(entry.version, b'{"version":%d,' % entry.version + self.store.content(entry.content)[1:])

    def put_scene(self, name: str, body: bytes, expected: int | None) -> dict[str, Any]:
        """Store a scene; ``expected`` is its version before, 0 if there must be none, None for any."""
        scene = read_body(SceneBody, body, self._world.robot).scene(name)
        return self._put(scene, ANY_VERSION if expected is None else expected or None)

    def edit_scene(self, name: str, body: bytes, expected: int | None) -> dict[str, Any]:
        """Apply edits to a scene, to its latest version if none is expected."""
        edits = read_body(EditsBody, body, self._world.robot)
        while True:
            entry = self.store.scene(name)
            document = parse_json(Path(name), self.store.content(entry.content))
            scene: Scene = read_record(SceneRecord, document, Path(name), PlanReading()).value
            if expected not in (None, entry.version):
                raise StaleVersion(name, expected, entry.version)
            try:
                return self._put(edits.applied(scene), entry.version)
            except StaleVersion:
                if expected is not None:
                    raise

    def _put(self, scene: Scene, expected: int | None) -> dict[str, Any]:
        return listed(self.store.put_scene(scene.name, scene.hash, _scene_document(scene), expected=expected))


def listed(entry: SceneEntry) -> dict[str, Any]:
    """A stored scene without what is in it."""
    return {"name": entry.name, "version": entry.version, "hash": entry.hash}


MAX_STARTS = 2
"""Times that a job is begun by servers that do not stop but are killed."""


def _refusal(error: InvalidRequest) -> Answer:
    """The answer to a request that the store no longer has all contents of."""
    return Answer(problem_of(error).content, False, "DAMAGED", refused=True)


def _planners(body: Any) -> list[Any]:
    """The planners that a body names."""
    requests = [body, getattr(body, "request", None), getattr(getattr(body, "handling", None), "request", None)]
    records = [getattr(request, "planner", None) for request in requests]
    return [record.value for record in records if record is not None]


def _scene_document(scene: Scene) -> bytes:
    return SceneRecord.of(scene).line


def _shown(state: State) -> str:
    return "done" if state is State.REFUSED else state.value


async def _told(job: Job) -> AsyncIterator[bytes]:
    yield _event("state", {"state": _shown(job.state)})


def _event(name: str, data: Mapping[str, Any]) -> bytes:
    return f"event: {name}\ndata: {json.dumps(data)}\n\n".encode("ascii")


def _motions_of(content: bytes) -> Saved:
    """The plan or the task that an answer is."""
    try:
        return plan_or_task("plan", content)
    except InvalidFile:
        raise Refused("in-use", "it is no plan and no task") from None


def _exported(content: bytes, form: str, how: How, segment: str | None) -> tuple[str | bytes, str]:
    saved = _motions_of(content)
    if saved.failure is not None:
        raise Refused("in-use", f"it has no motions: {saved.failure}")
    if segment is not None:
        saved = one_motion(saved, segment)
    motions = [each.result.trajectory for each in saved.segments]
    least = sum(motion.duration for motion in motions if motion is not None) / MAX_POINTS
    if how.dt < least:
        raise InvalidRequest("dt", how.dt, f"at least {least:.3g} s, for at most {MAX_POINTS:,} points in an answer")
    return exported(saved, form, how), kept(saved, form, how)
