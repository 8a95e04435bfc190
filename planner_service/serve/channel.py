"""One connection for many requests: a WebSocket whose frames are msgpack, for controllers that cannot wait for HTTP.

A frame asks: ``{"id", "verb", "body"}``, and may have ``key`` (an idempotency key) and ``robot`` (``whole`` or
``hash``). A frame answers: ``{"id", "status", "job", "answer"}``, with the status, and the answer or the problem, that
``POST /VERB`` would have, and ``retry_after`` where it had that header. Answers come as they are there, in any order;
``id`` is the client's. The verb ``cancel`` ends the request of its ``id``, which is answered as any other.

``MAX_OPEN`` requests of a connection may be without an answer; one more gets 429, as with a full queue. Nothing more is
read from a client that does not read. Once it is closed, requests without a key are cancelled.
"""

from __future__ import annotations

import asyncio
import json
import logging
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from pydantic_core import from_json
from starlette.websockets import WebSocket, WebSocketDisconnect

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.records.http.frames import packed, unpacked
from planner_service.records.http.replies import VERBS
from planner_service.records.http.robot_by_hash import robot_by_hash
from planner_service.serve.problems import Problem, Refused, problem_of
from planner_service.serve.server import PlanningServer, StoredAnswer
from planner_service.serve.state.store import StateUnusable

__all__ = ["Channels"]

logger = logging.getLogger(__name__)

MAX_OPEN = 16
"""Requests of one connection that are not answered yet."""

MAX_CHANNELS = 100
"""Connections at the same time."""

SHORT_ANSWER = 100_000
"""Bytes of an answer that is written as msgpack at once; a longer one in a thread, so that others need not wait."""

ONE_SECOND = {"Retry-After": "1"}

FIELDS = frozenset({"id", "verb", "body", "key", "robot"})

UNSUPPORTED, TRY_LATER = 1003, 1013
"""Codes with which a connection is closed: for text in place of bytes, and for one connection too many."""


@dataclass(frozen=True)
class _Request:
    """What a frame asks."""

    id: int | str
    verb: str
    body: bytes
    key: str | None
    by_hash: bool


class Channels:
    """Answers at the WebSocket of a server."""

    def __init__(self, server: PlanningServer) -> None:
        self._server, self._open = server, 0

    async def serve(self, socket: WebSocket) -> None:
        """Serve one connection until it is closed."""
        await socket.accept()
        if self._open >= MAX_CHANNELS:
            await socket.close(TRY_LATER, f"{MAX_CHANNELS} channels are open")
            return
        self._open += 1
        try:
            await _Channel(self._server, socket).serve()
        finally:
            self._open -= 1


@dataclass(eq=False)
class _Channel:
    """One connection, and what it has asked and has no answer to."""

    server: PlanningServer
    socket: WebSocket
    jobs: dict[int | str, str] = field(default_factory=dict)  # empty until it is accepted
    ended: set[int | str] = field(default_factory=set)  # those that the client has cancelled
    tasks: list[asyncio.Task[None]] = field(default_factory=list)  # the first asked first

    async def serve(self) -> None:
        """Read frames until there are no more."""
        try:
            while (message := await self.socket.receive())["type"] == "websocket.receive":
                if message.get("bytes") is None:
                    with suppress(WebSocketDisconnect, RuntimeError):  # it is closed
                        await self.socket.close(UNSUPPORTED, "frames are msgpack")
                    return
                await self._take(message["bytes"])
        finally:
            for task in reversed(self.tasks):  # so that none begins because the one before it ended
                task.cancel()

    async def _take(self, frame: bytes) -> None:
        """Begin what a frame asks, or say what is wrong with it."""
        asked: int | str | None = None
        try:
            document = _document(frame)
            asked = document["id"]
            if document.get("verb") == "cancel":
                self._cancel(asked)
                return
            request = _request(document)
            if len(self.tasks) >= MAX_OPEN:
                raise Refused("queue-full", f"{MAX_OPEN} requests of this channel are open", headers=ONE_SECOND)
            if request.id in self.jobs:
                raise Refused("malformed", f"id: got {request.id!r:.100}; expected one that no open request has")
        except Refused as error:
            await self._refuse(asked, error)
            return
        self.jobs[request.id] = ""
        task = asyncio.ensure_future(self._answer(request))
        self.tasks.append(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self.tasks.remove(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            logger.error("a bug: %s", error, exc_info=error)

    async def _answer(self, request: _Request) -> None:
        """Do what is asked, and send the answer."""
        try:
            job, answer = await self._work(request)
        except Refused as error:
            await self._refuse(request.id, error)
        except (InvalidRequest, MissingDependency) as error:
            await self._send({"id": request.id, "job": ""}, _problem(problem_of(error)))
        else:
            await self._send({"id": request.id, "job": job}, answer)

    async def _refuse(self, asked: int | str | None, error: Refused) -> None:
        after = error.headers.get("Retry-After")
        told = {} if after is None else {"retry_after": int(after)}
        await self._send({"id": asked, "job": "", **told}, _problem(error.problem))

    async def _send(self, reply: dict[str, Any], answer: StoredAnswer) -> None:
        long = len(answer.content) > SHORT_ANSWER
        content = await asyncio.to_thread(_frame, reply, answer) if long else _frame(reply, answer)
        with suppress(WebSocketDisconnect, RuntimeError):  # it is closed
            await self.socket.send_bytes(content)

    def _cancel(self, asked: int | str) -> None:
        if asked in self.jobs:
            self.ended.add(asked)
            self._end(asked)

    def _end(self, asked: int | str) -> None:
        """Cancel the job of a request if it has one yet, and was cancelled."""
        if self.jobs[asked] and asked in self.ended:
            with suppress(StateUnusable):
                self.server.cancel(self.jobs[asked])

    async def _work(self, request: _Request) -> tuple[str, StoredAnswer]:
        """The job of a request, and its answer once it is there."""
        try:
            self.server.require_room(request.key)
            job = self.jobs[request.id] = await self.server.accept(request.verb, request.body, request.key)
            self._end(request.id)
            try:
                pending = self.server.pending(job)
                answer = await self.server.answer(job) if pending is None else await asyncio.shield(pending)
            except asyncio.CancelledError:
                if request.key is None:
                    with suppress(StateUnusable):
                        self.server.cancel(job)
                raise
        finally:
            del self.jobs[request.id]
            self.ended.discard(request.id)
        if answer is None:
            raise Refused("unavailable", "the server is stopping", headers={"Retry-After": "5"})
        if request.by_hash and not answer.refused:
            answer = StoredAnswer(robot_by_hash(answer.content), False)
        return job, answer


def _document(frame: bytes) -> dict[str, Any]:
    """The map that a frame is, with the id of a request.

    Raises:
        Refused: It is no such thing.
    """
    try:
        document = unpacked(frame)
    except ValueError as error:
        raise Refused("malformed", f"the frame is {error}") from None
    if not isinstance(document, dict) or type(document.get("id")) not in (int, str):
        raise Refused("malformed", "expected a map with id, which is a whole number or a text, verb and body")
    return document


def _request(document: dict[str, Any]) -> _Request:
    """What is asked.

    Raises:
        Refused: There is another member, or one is wrong.
    """
    verb, key, robot = document.get("verb"), document.get("key"), document.get("robot", "whole")
    if unknown := [name for name in document if name not in FIELDS]:
        raise Refused("malformed", f"unknown member {unknown[0]!r:.100}; expected {', '.join(sorted(FIELDS))}")
    if not isinstance(verb, str) or verb not in VERBS:
        raise Refused("malformed", f"verb: got {verb!r:.100}; expected one of {', '.join(VERBS)}, or cancel")
    if key is not None and not isinstance(key, str):
        raise Refused("malformed", f"key: got {key!r:.100}; expected a text")
    if robot not in ("whole", "hash"):
        raise Refused("malformed", f"robot: got {robot!r:.100}; expected hash, or whole")
    try:
        body = json.dumps(document.get("body"), allow_nan=False).encode("ascii")
    except (ValueError, TypeError, RecursionError) as error:
        raise Refused("malformed", f"body: expected what JSON has, too: {error!s:.200}") from None
    return _Request(document["id"], verb, body, key, robot == "hash")


def _problem(problem: Problem) -> StoredAnswer:
    return StoredAnswer(problem.content, True)


def _frame(reply: dict[str, Any], answer: StoredAnswer) -> bytes:
    """The frame that answers."""
    return packed({**reply, "status": answer.status, "answer": from_json(answer.content)})
