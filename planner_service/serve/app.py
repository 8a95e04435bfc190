"""The routes: which address does what. What is behind them is in ``server.py``."""

from __future__ import annotations

import asyncio
import gzip
import json
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager, suppress
from functools import partial, update_wrapper
from typing import Any

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import RedirectResponse, Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute

from planner_service.errors import InvalidRequest, MissingDependency, UnknownName
from planner_service.records.exports.formats import FORMATS, How
from planner_service.records.http.bodies import EditsBody, SceneBody
from planner_service.records.http.replies import (
    ANSWERS,
    VERBS,
    AcceptedReply,
    JobsReply,
    RobotReply,
    RunsReply,
    SceneReply,
    ScenesReply,
    StoredReply,
    Verb,
)
from planner_service.records.http.robot_by_hash import robot_by_hash
from planner_service.records.http.trajectories import TRAJECTORIES
from planner_service.serve.channel import Channels
from planner_service.serve.docs_page import FILES, SECURITY
from planner_service.serve.documentation import (
    Handler,
    Operation,
    data,
    described,
    header,
    operation,
    query,
    reply,
)
from planner_service.serve.problems import PROBLEM_JSON, Problem, Refused, problem_of
from planner_service.serve.server import PlanningServer, StoredAnswer, listed
from planner_service.serve.state.store import ANY_VERSION, StaleVersion, StateUnusable

__all__ = ["OPERATIONS", "create_app"]

JSON = "application/json"

MAX_WAIT = 60
"""Seconds for which a response is held back until there is an answer."""

MIN_GZIPPED, GZIP_LEVEL = 4_096, 1
"""Bytes from which on answers are sent with gzip to clients that take it; higher levels take longer than they save."""

MAX_ENDING = 1.0
"""Seconds for which the end of a request is waited for that cannot be cancelled any more."""

PREFER_WAIT = re.compile(r"(?:^|[,;\s])wait(?:\s*=\s*\"?(\d{1,9})\"?)?\s*(?:$|[,;])", re.IGNORECASE)
ETAG = re.compile(r'"([1-9]\d{0,14})"')
DECIMAL = re.compile(r"([0-9]{1,9}(\.[0-9]{0,18})?|\.[0-9]{1,18})(e-?[0-9]{1,3})?")


def create_app(server: PlanningServer) -> Starlette:
    """The application that answers for a server."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        await server.start()
        try:
            yield
        finally:
            await server.stop()

    addresses: list[tuple[str, str, Handler]] = [(o.method, o.path, _heeded(o)) for o in OPERATIONS]
    addresses += [("GET", "/openapi.json", get_openapi), *(("GET", path, get_docs) for path in FILES)]
    routes = [Route(path, partial(handler, server), methods=[method]) for method, path, handler in addresses]
    for route in routes:
        (route.methods or set()).discard("HEAD")
    channels = WebSocketRoute("/channel", Channels(server).serve)
    handlers: Any = {
        Refused: _refused,
        HTTPException: _http_error,
        InvalidRequest: _invalid,
        MissingDependency: _invalid,
    }
    app = Starlette(routes=[*routes, channels], lifespan=lifespan, exception_handlers=handlers)
    app.router.redirect_slashes = False
    return app


# Errors.


def _problem(problem: Problem, headers: Mapping[str, str] | None = None) -> Response:
    return Response(problem.content, problem.status, dict(headers or {}), PROBLEM_JSON)


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, Refused)
    return _problem(error.problem, error.headers)


async def _invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, InvalidRequest | MissingDependency)
    if isinstance(error, StaleVersion):
        return _problem(Problem("changed", str(error)))
    if isinstance(error, UnknownName) and request.method in ("GET", "DELETE"):  # the address names it, not a body
        return _problem(Problem("not-found", str(error)))
    problem = problem_of(error)
    return _problem(problem, {"Retry-After": "1"} if problem.status == 503 else None)


async def _http_error(request: Request, error: Exception) -> Response:
    """Of an address or a method that no route has."""
    assert isinstance(error, HTTPException)
    if error.status_code == 405:
        return _problem(Problem("method-not-allowed", f"{request.method} is not for this address"), error.headers)
    return _problem(Problem("not-found" if error.status_code == 404 else "malformed", str(error.detail)))


def _heeded(operation: Operation) -> Handler:
    """A handler that answers once it is known to take all that the address asks, gzipped for who takes that."""
    known = [each["name"] for each in operation.parameters if each["in"] == "query"]
    expected = ", ".join(known) if known else "nothing after a ?"
    kinds = [kind for status, each in operation.replies.items() if status < 300 for kind in each.get("content", ())]
    media = tuple(dict.fromkeys(kinds))

    async def handler(server: PlanningServer, request: Request) -> Response:
        for name in request.query_params:
            if name not in known:
                raise Refused("malformed", f"query: got {name!r:.100}; this address takes {expected}")
        if media and not any(_accepts(request, kind) for kind in media):
            accepted = request.headers.get("accept", "")
            raise Refused("not-acceptable", f"Accept: got {accepted!r:.100}; expected {', '.join(media)}")
        response = await operation.handler(server, request)
        if isinstance(response, StreamingResponse) or len(response.body) < MIN_GZIPPED:
            return response
        response.headers.add_vary_header("Accept-Encoding")
        if _names(request.headers.get("accept-encoding", ""), "gzip", "*"):
            response.body = await asyncio.to_thread(gzip.compress, response.body, GZIP_LEVEL, mtime=0)
            response.headers["Content-Encoding"] = "gzip"
            response.headers["Content-Length"] = str(len(response.body))
        return response

    return handler


def _accepts(request: Request, media: str) -> bool:
    """Whether a client takes a media type; all if it does not say."""
    accepted = request.headers.get("accept", "*/*")
    return accepted == "*/*" or _names(accepted, media, media.partition("/")[0] + "/*", "*/*")


def _names(header: str, *names: str) -> bool:
    """Whether a header lists one of these, and does not refuse it by a quality of 0."""
    for each in header.lower().split(","):
        kind, *parameters = (part.strip() for part in each.split(";"))
        if kind in names:
            return not any(re.fullmatch(r"q\s*=\s*0(\.0{0,3})?", parameter) for parameter in parameters)
    return False


# Work.


async def _work(kind: str, server: PlanningServer, request: Request) -> Response:
    key = request.headers.get("idempotency-key")
    by_hash = _by_hash(request)
    server.require_room(key)
    job = await server.accept(kind, await _json_body(request), key)
    return await _response(server, request, job, by_hash=by_hash, cancel=key is None)


def _by_hash(request: Request) -> bool:
    """Whether a client has the robot."""
    asked = request.query_params.get("robot", "whole")
    if asked not in ("whole", "hash"):
        raise Refused("malformed", f"robot: got {asked!r:.100}; expected hash, or whole")
    return asked == "hash"


async def _json_body(request: Request) -> bytes:
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != JSON:
        raise Refused("unsupported-media-type", f"Content-Type: expected {JSON}")
    return await request.body()


def _seconds_to_wait(request: Request) -> int:
    found = PREFER_WAIT.search(request.headers.get("prefer", ""))
    return 0 if found is None else min(MAX_WAIT, int(found[1] or MAX_WAIT))


async def _response(server: PlanningServer, request: Request, job: str, *, by_hash: bool, cancel: bool) -> Response:
    """The answer of a job if there is one within the seconds that the client waits, else where it will be."""
    seconds = _seconds_to_wait(request)
    waited = {"Preference-Applied": f"wait={seconds}"} if seconds else {}
    pending = server.pending(job)
    if pending is None:
        answer = await server.answer(job)
    else:
        try:
            answer = await _awaited(pending, request, seconds)
        except (asyncio.CancelledError, ClientDisconnect):
            if cancel:
                with suppress(StateUnusable):
                    server.cancel(job)
            raise
    if answer is not None:
        headers = {"Content-Location": f"/plans/{job}", **waited}
        content = robot_by_hash(answer.content) if by_hash and not answer.refused else answer.content
        return Response(content, answer.status, headers, PROBLEM_JSON if answer.refused else JSON)
    await server.durable()
    state = await server.state(job)
    headers = {"Location": f"/plans/{job}", "Retry-After": str(server.retry_after()), **waited}
    return _json(state, 202, headers)


async def _awaited(
    pending: asyncio.Future[StoredAnswer | None], request: Request, seconds: float
) -> StoredAnswer | None:
    """The answer if it is there within so many seconds.

    Raises:
        CancelledError, ClientDisconnect: The client has closed its connection.
    """
    if not seconds:
        return pending.result() if pending.done() else None
    closed = asyncio.ensure_future(_closed(request))
    try:
        await asyncio.wait((pending, closed), timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
        if not pending.done() and closed.done():
            raise ClientDisconnect
        return pending.result() if pending.done() else None
    finally:
        closed.cancel()


async def _closed(request: Request) -> None:
    """Return once the client has closed its connection; the body has been read."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


# What routes take and answer.

WAIT = header(
    "Prefer", f"wait, or wait=SECONDS (at most {MAX_WAIT}): hold the response until there is an answer", "wait"
)
AGAIN = header("Idempotency-Key", "Sent again, it gets the same answer; and a closed connection cancels nothing")
IF_MATCH = header("If-Match", 'The version that is to be changed, such as "3"')
IS_NEW = header("If-None-Match", "* for a new scene only")
VERSION = query("version", {"type": "integer", "minimum": 1}, "Which version; the latest if not given")
PAGE = (
    query("limit", {"type": "integer", "minimum": 1, "maximum": 1000, "default": 100}, "How many at most"),
    query("after", {"type": "string"}, "`next` of the page before"),
)
ROBOT = query(
    "robot",
    {"type": "string", "enum": ["whole", "hash"], "default": "whole"},
    "Whether plans and tasks hold the whole robot, or its hash alone",
)
FINISHED = query(
    "finished", {"type": "string", "enum": ["remove", "keep"], "default": "remove"}, "What becomes of an answer"
)
NEGOTIATED = ("json", "csv", "npy")
"""Formats that are looked at first where only Accept says which."""

DEVIATION = "What is kept of the proven curves, and how far what is drawn between can be from these"
TRAJECTORY = reply("The motions, by `format`", *TRAJECTORIES, Deviation=DEVIATION)
TRAJECTORY["content"] |= {each.media: {"schema": data(each.media)} for each in FORMATS.values() if each.media != JSON}
DONE = {204: {"description": "Done"}}
ETAG_TOLD = "The version, in quotes, for `If-Match`"
SCENE = reply("The scene", SceneReply, ETag=ETAG_TOLD)
CHANGED = {200: reply("Changed", StoredReply, ETag=ETAG_TOLD)}
UNCHANGED = (400, 404, 412, 413, 415, 422, 429, 503)
LATER = {"Location": "Where the answer will be", "Retry-After": "Seconds after which it may be there"}
ACCEPTED = reply("Accepted; there is no answer yet", AcceptedReply, **LATER)
FOUND_AT = "Where the answer stays: `/plans/ID`"


# Plans: the outcome of a request of any kind.


@operation("GET /plans", "List requests, newest first", {200: reply("The list", JobsReply)}, (400, 404, 503), *PAGE)
async def list_plans(server: PlanningServer, request: Request) -> Response:
    """Requests that are waiting, running or kept, of every kind."""
    limit = _whole(request, "limit", 100, 1_000)
    return _json(await asyncio.to_thread(server.jobs, limit, request.query_params.get("after")))


@operation(
    "GET /plans/{plan}",
    "Get the answer of a request",
    {
        200: reply("The plan file, the task file, or the answer of another kind", *ANSWERS, Content_Location=FOUND_AT),
        202: ACCEPTED,
    },
    (400, 404, 408, 410, 422, 503, 507),
    WAIT,
    ROBOT,
)
async def get_plan(server: PlanningServer, request: Request) -> Response:
    """What the library would have saved, on one line."""
    plan, by_hash = request.path_params["plan"], _by_hash(request)
    await asyncio.to_thread(server.store.job, plan)
    return await _response(server, request, plan, by_hash=by_hash, cancel=False)


@operation(
    "GET /plans/{plan}/trajectory",
    "Get the motions of a plan or a task, ready to run",
    {200: TRAJECTORY},
    (400, 404, 406, 409, 422, 503),
    query("format", {"type": "string", "enum": list(FORMATS)}, "Else the first that Accept allows"),
    query("dt", {"type": "number", "exclusiveMinimum": 0, "default": How.dt}, "Seconds between points"),
    query("tolerance", {"type": "number", "default": How.tolerance}, "Radians between the curve and joint moves"),
    query("segment", {"type": "string"}, "One motion of a task: its number from 0, or its name"),
)
async def get_trajectory(server: PlanningServer, request: Request) -> Response:
    """Points in time with the gripper's events, messages of ROS, programs of controllers, or recordings.

    The header ``Deviation`` says what is kept of the proven curve, and how far it can be from what is drawn between.
    """
    asked = request.query_params
    form = asked.get("format")
    if form is None:
        form = next((name for name in (*NEGOTIATED, *FORMATS) if _accepts(request, FORMATS[name].media)), "json")
    elif form in FORMATS and not _accepts(request, FORMATS[form].media):
        raise Refused("not-acceptable", f"Accept: format {form} is {FORMATS[form].media}")
    how = How(_decimal(request, "dt", How.dt), _decimal(request, "tolerance", How.tolerance))
    content, deviation = await server.trajectory(request.path_params["plan"], form, how, asked.get("segment"))
    return Response(content, media_type=FORMATS[form].media, headers={"Deviation": deviation})


@operation(
    "GET /plans/{plan}/events",
    "Follow a request, stage by stage",
    {200: reply("Server-sent events", media="text/event-stream")},
    (404, 503),
)
async def get_events(server: PlanningServer, request: Request) -> Response:
    """Events ``state`` and ``stage``: those that have been, and those to come until it is finished."""
    events = await server.events(request.path_params["plan"])
    return StreamingResponse(events, media_type="text/event-stream", headers={"Cache-Control": "no-store"})


@operation(
    "GET /plans/{plan}/view",
    "Open a plan or a task in the viewer",
    {303: {"description": "The page is at the address in `Location`"}},
    (404, 409, 422, 503),
)
async def view_plan(server: PlanningServer, request: Request) -> Response:
    """A page of this machine that shows the motions."""
    return RedirectResponse(await server.view(request.path_params["plan"]), 303)


@operation(
    "DELETE /plans/{plan}",
    "Cancel a request, or remove its answer",
    DONE | {202: reply("It is being cancelled", AcceptedReply, Location="Where its answer will be")},
    (400, 404, 503),
    FINISHED,
)
async def delete_plan(server: PlanningServer, request: Request) -> Response:
    """What waits or runs is cancelled, and its answer says so; what is finished is removed, or kept."""
    plan, finished = request.path_params["plan"], request.query_params.get("finished", "remove")
    if finished not in ("remove", "keep"):
        raise Refused("malformed", f"finished: got {finished!r:.100}; expected remove, or keep")
    await asyncio.to_thread(server.store.job, plan)
    if server.cancel(plan):
        return _json(await server.state(plan), 202, {"Location": f"/plans/{plan}"})
    ending = server.pending(plan)
    if ending is not None:
        await asyncio.wait((ending,), timeout=MAX_ENDING)
        if server.pending(plan) is not None:  # the disk is full, or the server stops
            raise Refused("unavailable", "its answer is not kept yet", headers={"Retry-After": "5"})
    if finished == "remove":
        await asyncio.to_thread(server.store.delete, plan)
    return Response(status_code=204)


def _whole(request: Request, name: str, usual: int, most: int) -> int:
    text = request.query_params.get(name)
    if text is None:
        return usual
    if not re.fullmatch("[0-9]{1,15}", text) or not 1 <= int(text) <= most:
        raise Refused("malformed", f"{name}: got {text!r:.100}; expected a whole number from 1 to {most:,}")
    return int(text)


def _decimal(request: Request, name: str, usual: float) -> float:
    text = request.query_params.get(name)
    if text is None:
        return usual
    if not DECIMAL.fullmatch(text):
        raise Refused("malformed", f"{name}: got {text!r:.100}; expected a number")
    return float(text)


def _json(value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    return Response(json.dumps(value, allow_nan=False, separators=(",", ":")), status, dict(headers or {}), JSON)


# Scenes.


@operation("GET /scenes", "List scenes", {200: reply("Scenes", ScenesReply)}, (503,))
async def list_scenes(server: PlanningServer, _: Request) -> Response:
    """Their names, latest versions and hashes."""
    return _json({"scenes": [listed(entry) for entry in await asyncio.to_thread(server.store.scenes)]})


@operation("GET /scenes/{name}", "Get a scene", {200: SCENE}, (400, 404, 503), VERSION)
async def get_scene(server: PlanningServer, request: Request) -> Response:
    """Its latest version, or the given one."""
    number = _whole(request, "version", 1, 10**15) if "version" in request.query_params else None
    entry = await asyncio.to_thread(server.scene, request.path_params["name"], number)
    return Response(entry.document, 200, {"ETag": f'"{entry.version}"'}, JSON)


@operation(
    "PUT /scenes/{name}",
    "Store a scene",
    CHANGED | {201: reply("New", StoredReply, ETag=ETAG_TOLD)},
    UNCHANGED,
    IF_MATCH,
    IS_NEW,
    takes=SceneBody,
)
async def put_scene(server: PlanningServer, request: Request) -> Response:
    """A new scene, or the next version of one."""
    server.require_room(None)
    must_be_new = request.headers.get("if-none-match")
    if must_be_new not in (None, "*"):
        raise Refused("malformed", "If-None-Match: expected *")
    expected = 0 if must_be_new else _version_to_match(request)
    stored = await asyncio.to_thread(server.put_scene, request.path_params["name"], await _json_body(request), expected)
    return _stored(stored, 201 if stored["version"] == 1 else 200)


@operation("PATCH /scenes/{name}", "Change a scene", CHANGED, UNCHANGED, IF_MATCH, takes=EditsBody)
async def edit_scene(server: PlanningServer, request: Request) -> Response:
    """All of the edits, in their order, or none: the next version of the scene."""
    server.require_room(None)
    name, body, expected = request.path_params["name"], await _json_body(request), _version_to_match(request)
    try:
        await asyncio.to_thread(server.store.scene, name)
    except UnknownName as error:
        raise Refused("not-found", str(error)) from None
    return _stored(await asyncio.to_thread(server.edit_scene, name, body, expected), 200)


@operation("DELETE /scenes/{name}", "Remove a scene", DONE, (400, 404, 412, 503), IF_MATCH)
async def delete_scene(server: PlanningServer, request: Request) -> Response:
    """The scene under this name; plans made in it stay."""
    expected = _version_to_match(request)
    version = ANY_VERSION if expected is None else expected
    await asyncio.to_thread(server.store.delete_scene, request.path_params["name"], expected=version)
    return Response(status_code=204)


def _stored(stored: Mapping[str, Any], status: int) -> Response:
    return _json(stored, status, {"ETag": f'"{stored["version"]}"'})


def _version_to_match(request: Request) -> int | None:
    text = request.headers.get("if-match")
    if text is None:
        return None
    found = ETAG.fullmatch(text.strip())
    if found is None:
        raise Refused("malformed", f'If-Match: got {text!r:.100}; expected the ETag of a version, such as "3"')
    return int(found[1])


# Roadmaps.


@operation(
    "GET /roadmaps/{roadmap}", "Get a roadmap", {200: reply("Its file", media="application/octet-stream")}, (404, 503)
)
async def get_roadmap(server: PlanningServer, request: Request) -> Response:
    """The npz file of the roadmap with this hash."""
    content = await asyncio.to_thread(server.store.roadmap, request.path_params["roadmap"])
    data = await asyncio.to_thread(server.store.content, content)
    return Response(data, media_type="application/octet-stream")


@operation("DELETE /roadmaps/{roadmap}", "Remove a roadmap", DONE, (404, 503))
async def delete_roadmap(server: PlanningServer, request: Request) -> Response:
    """The roadmap with this hash."""
    await asyncio.to_thread(server.store.delete_roadmap, request.path_params["roadmap"])
    return Response(status_code=204)


# The server itself.


@operation("GET /robot", "Get the robot", {200: reply("The robot", RobotReply)})
async def get_robot(server: PlanningServer, _: Request) -> Response:
    """Joints, limits, named poses and gripper, and the whole robot as plan files have it."""
    return Response(server.robot_document, media_type=JSON)


@operation("GET /health", "Whether the server runs", {200: reply("It does", RunsReply)}, public=True)
async def get_health(_server: PlanningServer, _: Request) -> Response:
    """It does if this is answered."""
    return _json({"ok": True})


@operation("GET /ready", "Whether the server can plan", {200: reply("It can", RunsReply)}, (503,), public=True)
async def get_ready(server: PlanningServer, _: Request) -> Response:
    """Once the first worker is ready, until the server stops."""
    if not server.ready:
        raise Refused("unavailable", "no worker is ready", headers={"Retry-After": "1"})
    return _json({"ok": True})


@operation("GET /metrics", "Figures for Prometheus", {200: reply("Text exposition format", media="text/plain")})
async def get_metrics(server: PlanningServer, _: Request) -> Response:
    """Requests, queue, times of stages, counts, and failures by reason."""
    content, kind = server.metrics.exposition()
    return Response(content, headers={"Content-Type": kind})


async def get_openapi(_server: PlanningServer, _: Request) -> Response:
    """The description of the interface."""
    return _json(described(OPERATIONS))


async def get_docs(_server: PlanningServer, request: Request) -> Response:
    """The same as a page, or a file that the page loads."""
    path, media = FILES[request.scope["route"].path]
    packed = {"Content-Encoding": "gzip"} if path.suffix == ".gz" else {}
    headers = {"Content-Security-Policy": SECURITY, "Cache-Control": "no-cache", **packed}
    return Response(await asyncio.to_thread(path.read_bytes), media_type=media, headers=headers)


# All of them.


def _asked(kind: str, verb: Verb) -> Operation:
    """A request for work of one kind: all of them are jobs."""
    work: Any = update_wrapper(partial(_work, kind), verb.body, ("__doc__",), ())
    answered = reply("The answer; that there is no plan is one", *verb.answers, Content_Location=FOUND_AT)
    replies, refused = (
        {202: ACCEPTED, 200: answered},
        (400, 408, 410, 413, 415, 422, 429, 503, 507),
    )
    parameters = (WAIT, AGAIN, ROBOT) if verb.is_file else (WAIT, AGAIN)
    return Operation("POST", f"/{kind}", verb.summary, work, replies, refused, parameters, verb.body, name=kind)


OPERATIONS: tuple[Operation, ...] = (
    *(_asked(kind, verb) for kind, verb in VERBS.items()),
    *(list_plans, get_plan, get_trajectory, get_events, view_plan, delete_plan),
    *(list_scenes, get_scene, put_scene, edit_scene, delete_scene, get_roadmap, delete_roadmap),
    *(get_robot, get_health, get_ready, get_metrics),
)
"""Every address of the interface."""
