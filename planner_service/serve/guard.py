"""What is looked at before a request is: where it comes from, whether it has the token, and how large it is."""

from __future__ import annotations

import hmac
import re
from collections.abc import Sequence
from dataclasses import dataclass

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner_service.errors import InvalidRequest
from planner_service.serve.docs_page import FILES
from planner_service.serve.problems import PROBLEM_JSON, Problem

__all__ = ["MAX_BODY", "MAX_HEAD", "Guard", "checked_origins"]

MAX_BODY = 20_000_000
"""Bytes of a body."""

MAX_HEAD = 32_000
"""Bytes of an address and the headers."""

OPEN = frozenset({"/health", "/ready", "/openapi.json", *FILES})
"""Addresses that need no token; a browser sends none when it opens the documentation, which is no secret."""

LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


ORIGIN = re.compile(r"https?://[a-z0-9.-]{1,253}(:[0-9]{1,5})?|https?://\[[0-9a-f:.]{2,45}\](:[0-9]{1,5})?")

SENT = "authorization, content-type, idempotency-key, if-match, if-none-match, prefer"
"""Headers that pages of allowed origins may send,"""

TOLD = "content-location, deviation, etag, location, preference-applied, retry-after"
"""and those that they may read."""


def checked_origins(origins: Sequence[str]) -> frozenset[str]:
    """Origins as browsers write them.

    Raises:
        InvalidRequest: One is none, such as an address with a path.
    """
    for each in origins:
        if not ORIGIN.fullmatch(each.lower()):
            raise InvalidRequest("--allow-origin", each, "an origin, such as http://localhost:5173, without a path")
    return frozenset(each.lower() for each in origins)


class _TooLarge(Exception):
    """A body is larger than it may be."""


@dataclass(frozen=True)
class Guard:
    """An application behind the checks.

    Attributes:
        token: The bearer token that clients must send; None if no token is needed.
        origins: Pages of these origins may use the server as its own may.
        hosts: The accepted values of the ``Host`` header, ports included, so that a foreign host name that resolves to
            this machine is refused (DNS rebinding). None accepts any: the token then protects the server.
    """

    app: ASGIApp
    token: str | None
    hosts: frozenset[str] | None
    origins: frozenset[str] = frozenset()

    @staticmethod
    def loopback(port: int) -> frozenset[str]:
        """The names of this machine for itself."""
        return frozenset(f"{name}:{port}" for name in LOOPBACK) | (frozenset(LOOPBACK) if port == 80 else frozenset())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        problem = None if scope["type"] == "lifespan" else self._problem(scope)
        if scope["type"] != "http":
            await (self.app if problem is None else _refusal(problem))(scope, receive, send)
            return
        page = Headers(scope=scope).get("origin", "").lower()
        if page in self.origins:
            send = _told_to(page, send)
            if scope["method"] == "OPTIONS":  # a browser asks before it sends the token
                allowed = {
                    "access-control-allow-methods": "GET, POST, PUT, PATCH, DELETE",
                    "access-control-max-age": "600",
                }
                await Response(None, 204, allowed | {"access-control-allow-headers": SENT})(scope, receive, send)
                return
        if problem is not None:
            await _refusal(problem)(scope, receive, send)
            return
        began = over = False
        left = MAX_BODY

        async def limited() -> Message:
            nonlocal left, over
            message = await receive()
            left -= len(message.get("body", b""))
            if left < 0:
                over = True
                raise _TooLarge
            return message

        async def watched(message: Message) -> None:
            nonlocal began
            if began or not over:  # else the application would answer that it failed
                began = True
                await send(message)

        try:
            await self.app(scope, limited, watched)
        except _TooLarge:
            if not began:
                await _refusal(Problem("too-large", f"a body has at most {MAX_BODY:,} bytes"))(scope, receive, send)
        except ClientDisconnect:  # within its body
            return

    def _problem(self, scope: Scope) -> Problem | None:
        size = sum(len(name) + len(value) for name, value in scope["headers"]) + len(scope["query_string"])
        if size + len(scope["path"]) > MAX_HEAD:
            return Problem("header-too-large", f"a request has at most {MAX_HEAD:,} bytes before its body")
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if self.hosts is not None and (len(hosts) != 1 or hosts[0].lower() not in self.hosts):
            return Problem("wrong-host", "Host: expected this machine's address and port")
        own = {f"http://{host.lower()}" for host in hosts}
        origins = {origin.lower() for origin in headers.getlist("origin")}
        if not origins <= own | self.origins:
            return Problem("cross-origin", "Origin: pages of other origins are not served, but by --allow-origin")
        if not origins & self.origins and headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return Problem("cross-origin", "Sec-Fetch-Site: pages of other origins are not served")
        if self.token is not None and scope["path"] not in OPEN:
            sent = headers.getlist("authorization")
            if len(sent) != 1 or not hmac.compare_digest(sent[0].encode(), f"Bearer {self.token}".encode()):
                return Problem("unauthorized", "Authorization: expected Bearer and the token")
        if any(not each.isdecimal() or int(each) > MAX_BODY for each in headers.getlist("content-length")):
            return Problem("too-large", f"a body has at most {MAX_BODY:,} bytes")
        return None


def _told_to(page: str, send: Send) -> Send:
    """Responses that a page of an allowed origin may read."""

    async def told(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers["access-control-allow-origin"] = page
            headers["access-control-expose-headers"] = TOLD
            headers.add_vary_header("Origin")
        await send(message)

    return told


def _refusal(problem: Problem) -> Response:
    headers = {"connection": "close"} | ({"www-authenticate": "Bearer"} if problem.status == 401 else {})
    return Response(problem.content, problem.status, headers, PROBLEM_JSON)
