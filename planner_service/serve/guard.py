"""What is looked at before a request is: where it comes from, whether it has the token, and how large it is."""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from dataclasses import dataclass

from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from planner_service.serve.problems import PROBLEM_JSON, Problem

__all__ = ["MAX_BODY", "MAX_HEAD", "Guard"]

MAX_BODY = 20_000_000
"""Bytes of a body."""

MAX_HEAD = 32_000
"""Bytes of an address and the headers."""

OPEN = frozenset({"/health", "/ready"})
"""Addresses that need no token."""

LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


class _TooLarge(Exception):
    """A body is larger than it may be."""


@dataclass(frozen=True)
class Guard:
    """An application behind the checks.

    Attributes:
        token: The bearer token that clients must send; None if no token is needed.
        hosts: The accepted values of the ``Host`` header, ports included, so that a foreign host name that resolves to
            this machine is refused (DNS rebinding). None accepts any: the token then protects the server.
    """

    app: ASGIApp
    token: str | None
    hosts: frozenset[str] | None

    @staticmethod
    def loopback(port: int) -> frozenset[str]:
        """The names of this machine for itself."""
        return frozenset(f"{name}:{port}" for name in LOOPBACK) | (frozenset(LOOPBACK) if port == 80 else frozenset())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        problem = self._problem(scope)
        if problem is not None:
            await _refuse(problem, send)
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
                await _refuse(Problem("too-large", f"a body has at most {MAX_BODY:,} bytes"), send)
        except ClientDisconnect:  # within its body
            return

    def _problem(self, scope: Scope) -> Problem | None:
        size = sum(len(name) + len(value) for name, value in scope["headers"]) + len(scope["query_string"])
        if size + len(scope["path"]) > MAX_HEAD:
            return Problem("header-too-large", f"a request has at most {MAX_HEAD:,} bytes before its body")
        headers = _headers(scope["headers"])
        hosts = headers.get("host", [])
        if self.hosts is not None and (len(hosts) != 1 or hosts[0].lower() not in self.hosts):
            return Problem("wrong-host", "Host: expected this machine's address and port")
        origins = headers.get("origin", [])
        if any(origin.lower() != f"http://{host.lower()}" for origin in origins for host in hosts or [""]):
            return Problem("cross-origin", "Origin: pages of other origins are not served")
        if headers.get("sec-fetch-site", ["none"])[0] not in ("none", "same-origin"):
            return Problem("cross-origin", "Sec-Fetch-Site: pages of other origins are not served")
        if self.token is not None and scope["path"] not in OPEN:
            sent = headers.get("authorization", [])
            if len(sent) != 1 or not hmac.compare_digest(sent[0].encode(), f"Bearer {self.token}".encode()):
                return Problem("unauthorized", "Authorization: expected Bearer and the token")
        lengths = headers.get("content-length", [])
        if any(not length.isdecimal() or int(length) > MAX_BODY for length in lengths):
            return Problem("too-large", f"a body has at most {MAX_BODY:,} bytes")
        return None


def _headers(pairs: Iterable[tuple[bytes, bytes]]) -> dict[str, list[str]]:
    headers: dict[str, list[str]] = {}
    for name, value in pairs:
        headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return headers


async def _refuse(problem: Problem, send: Send) -> None:
    headers = [(b"content-type", PROBLEM_JSON.encode()), (b"connection", b"close")]
    if problem.status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    content = problem.content
    headers.append((b"content-length", str(len(content)).encode()))
    await send({"type": "http.response.start", "status": problem.status, "headers": headers})
    await send({"type": "http.response.body", "body": content})
