"""The routes: which address does what. What is behind them is in ``server.py``."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Any

from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse, RedirectResponse, Response, StreamingResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Receive, Scope, Send

from planner_service.errors import InvalidRequest, MissingDependency
from planner_service.files.package_data import RELEASE
from planner_service.records.http.bodies import EditsBody, SceneBody
from planner_service.records.http.replies import (
    AcceptedReply,
    JobsReply,
    RobotReply,
    RunsReply,
    SceneReply,
    ScenesReply,
    StoredReply,
)
from planner_service.records.http.verbs import ANSWERS, VERBS
from planner_service.serve.documentation import SECURITY, documentation_page, with_models
from planner_service.serve.problems import PROBLEM_JSON, Problem, Refused, problem_of
from planner_service.serve.server import PlanningServer, StoredAnswer
from planner_service.serve.state.content_files import StateUnusable

__all__ = ["create_app"]

JSON = "application/json"

MAX_WAIT = 60
"""Seconds for which a response is held back until there is an answer."""

MAX_ENDING = 1.0
"""Seconds for which the end of a request is waited for that cannot be cancelled any more."""

PREFER_WAIT = re.compile(r"(?:^|[,;\s])wait(?:\s*=\s*\"?(\d{1,9})\"?)?\s*(?:$|[,;])", re.IGNORECASE)
ETAG = re.compile(r'"([1-9]\d{0,14})"')
KEY = re.compile(r"[\x21-\x7e]{1,255}")

Handler = Callable[[Request], Awaitable[Response]]


def create_app(server: PlanningServer) -> FastAPI:
    """The application that answers for a server."""

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        await server.start()
        try:
            yield
        finally:
            await server.stop()

    app = FastAPI(
        title="planner-service",
        version=RELEASE,
        description="Motion planning for a robot arm: every returned plan is proven, every collision check is counted.",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        redirect_slashes=False,
        lifespan=lifespan,
        exception_handlers={Refused: _refused, HTTPException: _http_error, InvalidRequest: _invalid},
    )
    _add_work(app, server)
    _add_plans(app, server)
    _add_scenes(app, server)
    _add_roadmaps(app, server)
    _add_about(app, server)
    return app


# Errors.


def _problem(problem: Problem, headers: Mapping[str, str] | None = None) -> Response:
    return Response(problem.content, problem.status, dict(headers or {}), PROBLEM_JSON)


async def _refused(_: Request, error: Exception) -> Response:
    assert isinstance(error, Refused)
    return _problem(error.problem, error.headers)


async def _invalid(_: Request, error: Exception) -> Response:
    assert isinstance(error, InvalidRequest | MissingDependency)
    problem = problem_of(error)
    return _problem(problem, {"Retry-After": "1"} if problem.status == 503 else None)


async def _http_error(request: Request, error: Exception) -> Response:
    """Of an address or a method that no route has."""
    assert isinstance(error, HTTPException)
    if error.status_code == 405:
        return _problem(Problem("method-not-allowed", f"{request.method} is not for this address"), error.headers)
    return _problem(Problem("not-found" if error.status_code == 404 else "malformed", str(error.detail)))


# Parts of the description.


def _reply(description: str, *models: type) -> dict[str, Any]:
    """A reply that is one of these models."""
    schemas: list[dict[str, Any]] = [{"$ref": f"#/components/schemas/{model.__name__}"} for model in models]
    schema = schemas[0] if len(schemas) == 1 else {"anyOf": schemas}
    return {"description": description, "content": {JSON: {"schema": schema}}}


def _takes(model: type) -> dict[str, Any]:
    schema = {"$ref": f"#/components/schemas/{model.__name__}"}
    return {"requestBody": {"required": True, "content": {JSON: {"schema": schema}}}}


def _header(name: str, description: str) -> dict[str, Any]:
    return {"name": name, "in": "header", "required": False, "description": description, "schema": {"type": "string"}}


def _problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    content = {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/ProblemReply"}}}
    return {status: {"description": "What is wrong", "content": content} for status in statuses}


WAIT = _header("Prefer", f"wait, or wait=SECONDS (at most {MAX_WAIT}): hold the response until there is an answer")
IF_MATCH = _header("If-Match", 'The version that is to be changed, such as "3"')

# Work.


def _add_work(app: FastAPI, server: PlanningServer) -> None:
    """A route for each kind of work: all of them are jobs."""
    work = {f"/{kind}": _working(server, kind) for kind in VERBS}
    app.add_middleware(_Shortcut, work)
    for kind, verb in VERBS.items():
        key = _header("Idempotency-Key", "Sent again, it gets the same answer; and a closed connection cancels nothing")
        app.add_api_route(
            f"/{kind}",
            work[f"/{kind}"],
            methods=["POST"],
            summary=verb.summary,
            operation_id=kind,
            status_code=202,
            response_class=Response,
            responses={
                200: _reply("The answer; that there is no plan is one", *verb.answers),
                202: _reply("Accepted", AcceptedReply),
                **_problems(400, 408, 410, 413, 415, 422, 429, 503, 507),
            },
            openapi_extra={**_takes(verb.body), "parameters": [WAIT, key]},
        )


@dataclass(frozen=True)
class _Shortcut:
    """Takes requests for work past what FastAPI does for routes with dependencies and models, which these have not."""

    app: ASGIApp
    work: Mapping[str, Handler]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        handler = self.work.get(scope["path"]) if scope["type"] == "http" and scope["method"] == "POST" else None
        if handler is None:
            await self.app(scope, receive, send)
            return
        request = Request(scope, receive)
        try:
            response = await handler(request)
        except Refused as error:
            response = await _refused(request, error)
        except (InvalidRequest, MissingDependency) as error:
            response = await _invalid(request, error)
        await response(scope, receive, send)


def _working(server: PlanningServer, kind: str) -> Handler:
    async def work(request: Request) -> Response:
        key = request.headers.get("idempotency-key")
        if key is not None and not KEY.fullmatch(key):
            raise Refused("malformed", "Idempotency-Key: expected 1 to 255 printable ASCII characters without spaces")
        server.require_room(key)
        job = await server.accept(kind, await _json_body(request), key)
        seconds = _seconds_to_wait(request)
        return await _response(server, request, job, seconds, cancel=key is None)

    work.__doc__ = VERBS[kind].body.__doc__
    return work


async def _json_body(request: Request) -> bytes:
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != JSON:
        raise Refused("unsupported-media-type", f"Content-Type: expected {JSON}")
    return await request.body()


def _seconds_to_wait(request: Request) -> int:
    found = PREFER_WAIT.search(request.headers.get("prefer", ""))
    return 0 if found is None else min(MAX_WAIT, int(found[1] or MAX_WAIT))


async def _response(server: PlanningServer, request: Request, job: str, seconds: int, *, cancel: bool) -> Response:
    """The answer of a job if there is one within so many seconds, else where it will be."""
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
        return _answered(answer, {"Content-Location": f"/plans/{job}", **waited})
    await server.durable()
    state = await server.state(job)
    headers = {"Location": f"/plans/{job}", "Retry-After": str(server.retry_after()), **waited}
    return Response(json.dumps(state), 202, headers, JSON)


def _answered(answer: StoredAnswer, headers: Mapping[str, str]) -> Response:
    status = json.loads(answer.content)["status"] if answer.refused else 200
    return Response(answer.content, status, dict(headers), PROBLEM_JSON if answer.refused else JSON)


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


# Plans: the outcome of a request of any kind.


def _add_plans(app: FastAPI, server: PlanningServer) -> None:
    @app.get(
        "/plans",
        summary="List requests, newest first",
        operation_id="list_plans",
        responses={200: _reply("The list", JobsReply), **_problems(400, 404, 503)},
        openapi_extra={
            "parameters": [
                _query("limit", {"type": "integer", "minimum": 1, "maximum": 1000}),
                _query("after", {"type": "string"}),
            ]
        },
    )
    async def list_plans(request: Request) -> Response:
        """Requests that are waiting, running or kept, of every kind."""
        limit = _whole(request, "limit", 100, 1_000)
        return _json(await server.jobs(limit, request.query_params.get("after")))

    @app.get(
        "/plans/{plan}",
        summary="Get the answer of a request",
        operation_id="get_plan",
        responses={
            200: _reply("The plan file, the task file, or the answer of another kind", *ANSWERS),
            202: _reply("It is not finished", AcceptedReply),
            **_problems(404, 408, 410, 422, 503, 507),
        },
        openapi_extra={"parameters": [WAIT]},
    )
    async def get_plan(plan: str, request: Request) -> Response:
        """The file that the library would have saved, byte for byte."""
        await server.require_job(plan)
        return await _response(server, request, plan, _seconds_to_wait(request), cancel=False)

    @app.get(
        "/plans/{plan}/events",
        summary="Follow a request, stage by stage",
        operation_id="get_events",
        response_class=Response,
        responses={
            200: {"description": "Server-sent events", "content": {"text/event-stream": {}}},
            **_problems(404, 503),
        },
    )
    async def get_events(plan: str) -> Response:
        """Events ``state`` and ``stage``: those that have been, and those to come until it is finished."""
        events = await server.events(plan)
        return StreamingResponse(events, media_type="text/event-stream", headers={"Cache-Control": "no-store"})

    @app.get(
        "/plans/{plan}/view",
        summary="Open a plan or a task in the viewer",
        operation_id="view_plan",
        status_code=303,
        response_class=Response,
        responses={303: {"description": "The page is at this address"}, **_problems(404, 409, 422, 503)},
    )
    async def view_plan(plan: str) -> Response:
        """A page of this machine that shows the motions."""
        return RedirectResponse(await server.view(plan), 303)

    @app.delete(
        "/plans/{plan}",
        summary="Cancel a request, or remove its answer",
        operation_id="delete_plan",
        status_code=204,
        responses={202: _reply("It is being cancelled", AcceptedReply), **_problems(400, 404, 503)},
        openapi_extra={"parameters": [_query("finished", {"type": "string", "enum": ["remove", "keep"]})]},
    )
    async def delete_plan(plan: str, request: Request) -> Response:
        """What waits or runs is cancelled, and its answer says so; what is finished is removed, or kept."""
        finished = request.query_params.get("finished", "remove")
        if finished not in ("remove", "keep"):
            raise Refused("malformed", f"finished: got {finished!r:.100}; expected remove, or keep")
        await server.require_job(plan)
        if server.cancel(plan):
            return Response(json.dumps(await server.state(plan)), 202, {"Location": f"/plans/{plan}"}, JSON)
        ending = server.pending(plan)
        if ending is not None:
            await asyncio.wait((ending,), timeout=MAX_ENDING)
            if server.pending(plan) is not None:  # the disk is full, or the server stops
                raise Refused("unavailable", "its answer is not kept yet", headers={"Retry-After": "5"})
        if finished == "remove":
            await server.remove(plan)
        return Response(status_code=204)


def _query(name: str, schema: dict[str, Any]) -> dict[str, Any]:
    return {"name": name, "in": "query", "required": False, "schema": schema}


def _whole(request: Request, name: str, usual: int, most: int) -> int:
    text = request.query_params.get(name)
    if text is None:
        return usual
    if not re.fullmatch("[0-9]{1,15}", text) or not 1 <= int(text) <= most:
        raise Refused("malformed", f"{name}: got {text!r:.100}; expected a whole number from 1 to {most:,}")
    return int(text)


def _json(value: Any, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
    return Response(json.dumps(value, allow_nan=False), status, dict(headers or {}), JSON)


# Scenes.


def _add_scenes(app: FastAPI, server: PlanningServer) -> None:
    @app.get(
        "/scenes",
        summary="List scenes",
        operation_id="list_scenes",
        responses={200: _reply("Scenes", ScenesReply), **_problems(503)},
    )
    async def list_scenes() -> Response:
        """Their names, latest versions and hashes."""
        return _json(await server.scenes())

    version = _query("version", {"type": "integer", "minimum": 1})

    @app.get(
        "/scenes/{name}",
        summary="Get a scene",
        operation_id="get_scene",
        responses={200: _reply("The scene", SceneReply), **_problems(400, 404, 503)},
        openapi_extra={"parameters": [version]},
    )
    async def get_scene(name: str, request: Request) -> Response:
        """Its latest version, or the given one."""
        number = None
        if "version" in request.query_params:
            number = _whole(request, "version", 1, 10**15)
        entry = await server.scene(name, number)
        return Response(entry.document, 200, {"ETag": f'"{entry.version}"'}, JSON)

    changed = {200: _reply("Changed", StoredReply), **_problems(400, 404, 412, 413, 415, 422, 429, 503)}

    @app.put(
        "/scenes/{name}",
        summary="Store a scene",
        operation_id="put_scene",
        response_class=Response,
        responses={**changed, 201: _reply("New", StoredReply)},
        openapi_extra={
            **_takes(SceneBody),
            "parameters": [IF_MATCH, _header("If-None-Match", "* for a new scene only")],
        },
    )
    async def put_scene(name: str, request: Request) -> Response:
        """A new scene, or the next version of one."""
        server.require_room(None)
        must_be_new = request.headers.get("if-none-match")
        if must_be_new not in (None, "*"):
            raise Refused("malformed", "If-None-Match: expected *")
        expected = 0 if must_be_new else _version_to_match(request)
        stored = await server.put_scene(name, await _json_body(request), expected)
        return _stored(stored, 201 if stored["version"] == 1 else 200)

    @app.patch(
        "/scenes/{name}",
        summary="Change a scene",
        operation_id="edit_scene",
        response_class=Response,
        responses=changed,
        openapi_extra={**_takes(EditsBody), "parameters": [IF_MATCH]},
    )
    async def edit_scene(name: str, request: Request) -> Response:
        """All of the edits, in their order, or none: the next version of the scene."""
        server.require_room(None)
        stored = await server.edit_scene(name, await _json_body(request), _version_to_match(request))
        return _stored(stored, 200)

    @app.delete(
        "/scenes/{name}",
        summary="Remove a scene",
        operation_id="delete_scene",
        status_code=204,
        responses=_problems(400, 404, 412, 503),
        openapi_extra={"parameters": [IF_MATCH]},
    )
    async def delete_scene(name: str, request: Request) -> Response:
        """The scene under this name; plans made in it stay."""
        await server.delete_scene(name, _version_to_match(request))
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


def _add_roadmaps(app: FastAPI, server: PlanningServer) -> None:
    @app.get(
        "/roadmaps/{roadmap}",
        summary="Get a roadmap",
        operation_id="get_roadmap",
        response_class=Response,
        responses={
            200: {"description": "Its file", "content": {"application/octet-stream": {}}},
            **_problems(404, 503),
        },
    )
    async def get_roadmap(roadmap: str) -> Response:
        """The npz file of the roadmap with this hash."""
        return Response(await server.roadmap(roadmap), media_type="application/octet-stream")

    @app.delete(
        "/roadmaps/{roadmap}",
        summary="Remove a roadmap",
        operation_id="delete_roadmap",
        status_code=204,
        responses=_problems(404, 503),
    )
    async def delete_roadmap(roadmap: str) -> Response:
        """The roadmap with this hash."""
        await server.delete_roadmap(roadmap)
        return Response(status_code=204)


# The server itself.


def _add_about(app: FastAPI, server: PlanningServer) -> None:
    described = with_models(app)
    app.openapi = described  # type: ignore[method-assign]

    @app.get(
        "/robot", summary="Get the robot", operation_id="get_robot", responses={200: _reply("The robot", RobotReply)}
    )
    async def get_robot() -> Response:
        """Joints, limits, named poses and gripper, and the whole robot as plan files have it."""
        return Response(server.robot_document, media_type=JSON)

    @app.get(
        "/health",
        summary="Whether the server runs",
        operation_id="get_health",
        responses={200: _reply("It does", RunsReply)},
        openapi_extra={"security": []},
    )
    async def get_health() -> Response:
        """It does if this is answered."""
        return _json({"ok": True})

    @app.get(
        "/ready",
        summary="Whether the server can plan",
        operation_id="get_ready",
        responses={200: _reply("It can", RunsReply), **_problems(503)},
        openapi_extra={"security": []},
    )
    async def get_ready() -> Response:
        """Once the first worker is ready, until the server stops."""
        if not server.ready:
            raise Refused("unavailable", "no worker is ready", headers={"Retry-After": "1"})
        return _json({"ok": True})

    @app.get(
        "/metrics",
        summary="Figures for Prometheus",
        operation_id="get_metrics",
        response_class=Response,
        responses={200: {"description": "Text exposition format", "content": {"text/plain": {}}}},
    )
    async def get_metrics() -> Response:
        """Requests, queue, times of stages, counts, and failures by reason."""
        content, kind = server.metrics.exposition()
        return Response(content, headers={"Content-Type": kind})

    @app.get("/openapi.json", include_in_schema=False)
    async def get_openapi() -> Response:
        return _json(described())

    @app.get("/docs", include_in_schema=False)
    async def get_docs() -> Response:
        return HTMLResponse(documentation_page(described()), headers={"Content-Security-Policy": SECURITY})
