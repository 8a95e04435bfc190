"""The page's server: viser's, which answers only who knows the token, and passes on only what the page can send."""

from __future__ import annotations

import asyncio
import hmac
import http
import ipaddress
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import viser
import viser.infra._infra as viser_infra
import websockets.asyncio.server
from websockets.datastructures import MultipleValuesError

from planner_service.errors import BrokenInvariant
from planner_service.view.serving.client_messages import MAX_BYTES, PageMessages

__all__ = ["MAX_CONNECTIONS", "MAX_WINDOWS", "PageServer"]

MAX_WINDOWS = 16
"""Windows at a time."""

MAX_CONNECTIONS = 64
"""Connections at a time, of windows and of whoever has not asked for anything yet."""

RATE = 200.0
"""Messages per second taken from one window; a browser that drags sends about 70. The rest waits in its socket."""

BURST = 400
"""Messages taken at once."""

STALLED = 60.0
"""Seconds after which a window that reads nothing is cut off: what it has not read is kept for it."""

NO_TOKEN = "Open the address that planner-service printed: it ends with the token of this page.\n"
OTHER_HOST = "This page is not served under that host name.\n"
OTHER_ORIGIN = "Pages of other origins may not use this page.\n"
TOO_MANY = f"{MAX_WINDOWS} windows are open.\n"

_STARTING = threading.Lock()


class PageServer:
    """viser's server with a token in its address.

    Requests are answered if their path begins with the token, if they name a host that no other site can have (an IP
    address, ``localhost``, this machine, the address served at), and if they come from no other origin.

    Args:
        host: The address to serve at.
        port: The first port to try; 0 for any.

    Attributes:
        viser: The ``viser.ViserServer``.
        url: The address with its token, which is new with each server.
        loading_since: When a window last asked for the page; None once one shows it.

    Raises:
        BrokenInvariant: viser does not start as it did; nothing is served.
    """

    def __init__(self, host: str, port: int) -> None:
        self._host, self._token = host, secrets.token_hex(16)
        self._hosts = {"localhost", host.lower(), socket.gethostname().lower()}
        self._messages: PageMessages | None = None
        self._executor: Any = None
        self.loading_since: float | None = None
        self._connections = 0
        self._guards = False
        with _STARTING, self._guarding():
            self.viser = viser.ViserServer(host, port, label="planner-service", verbose=False)
        self.viser.on_client_connect(self._on_connect)
        if not self._guards:
            self.viser.stop()
            raise BrokenInvariant("viser served the page without its token")
        self._executor = self.viser._thread_executor
        self._messages = PageMessages(self.viser.gui)
        place = f"[{host}]" if ":" in host else host
        self.url = f"http://{place}:{self.viser.get_port()}/{self._token}"

    def _on_connect(self, _: Any) -> None:
        self.loading_since = None

    @contextmanager
    def _guarding(self) -> Iterator[None]:
        """While viser starts, let it find our ``serve`` in place of that of websockets."""
        real = viser_infra.websockets
        served = SimpleNamespace(**{**vars(real.asyncio.server), "serve": self._serve})
        viser_infra.websockets = SimpleNamespace(**{**vars(real), "asyncio": SimpleNamespace(server=served)})
        try:
            yield
        finally:
            viser_infra.websockets = real

    def _serve(self, handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        self._guards = True
        limits = {
            "max_size": MAX_BYTES,
            "create_connection": partial(_Connection, page=self),
            "process_request": partial(self._answer, process_request),
            "logger": _silent(),
        }
        return websockets.asyncio.server.serve(handler, host, port, **{**options, **limits})

    def _answer(self, page: Callable[[Any, Any], Any], connection: Any, request: Any) -> Any:
        """The response to a request; None for a window that is let in."""
        refusal = self._refusal(request)
        if refusal is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, refusal)
        if request.headers.get("Upgrade", "").lower() == "websocket":
            if len(connection.server.connections) >= MAX_WINDOWS or self._messages is None:
                return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, TOO_MANY)
            return None
        request.path = "/" + _segments(request.path)[1]
        if request.path == "/":
            self.loading_since = time.monotonic()
        response = page(connection, request)
        response.headers.update({"Referrer-Policy": "no-referrer", "Cache-Control": "no-store"})
        return response

    def _refusal(self, request: Any) -> str | None:
        try:
            host, origin = request.headers["Host"], request.headers.get("Origin")
            name = urlsplit(f"//{host}").hostname or ""
        except (KeyError, MultipleValuesError, ValueError):
            return OTHER_HOST
        if name not in self._hosts and not _is_address(name):
            return OTHER_HOST
        if origin is not None and origin.lower() != f"http://{host}".lower():
            return OTHER_ORIGIN
        token = _segments(request.path)[0].encode("utf-8", "replace")
        return None if hmac.compare_digest(token, self._token.encode("ascii")) else NO_TOKEN

    def connected(self, change: int) -> bool:
        """Count a connection that came (1) or went (-1), and tell whether there are too many."""
        self._connections += change
        return self._connections > MAX_CONNECTIONS

    def allowed(self, raw: str | bytes) -> bool:
        """Whether a message goes on to viser."""
        return self._messages is not None and self._messages.allowed(raw)

    async def worked_off(self) -> None:
        """Return once everything that windows asked for before has begun."""
        await asyncio.sleep(0)  # in which viser hands the last message to its threads
        try:
            await asyncio.get_running_loop().run_in_executor(self._executor, int)
        except RuntimeError:  # the page is being closed
            await asyncio.sleep(0.1)


class _Connection(websockets.asyncio.server.ServerConnection):
    """A connection whose messages wait until the page has worked off those before, and of which only some go on."""

    def __init__(self, *args: Any, page: PageServer, **options: Any) -> None:
        super().__init__(*args, **options)
        self._page = page
        self._left, self._since = float(BURST), time.monotonic()

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if self._page.connected(1):
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._page.connected(-1)
        super().connection_lost(exc)

    async def recv(self, decode: bool | None = None) -> Any:
        await self._page.worked_off()
        while True:
            raw = await super().recv(decode)
            await self._pace()
            if self._page.allowed(raw):
                return raw

    async def _pace(self) -> None:
        now = time.monotonic()
        self._left = min(self._left + (now - self._since) * RATE, BURST) - 1.0
        self._since = now
        if self._left < 0.0:
            await asyncio.sleep(-self._left / RATE)

    async def drain(self) -> None:
        try:
            await asyncio.wait_for(super().drain(), STALLED)
        except asyncio.TimeoutError:
            self.transport.abort()


def _segments(path: str) -> tuple[str, str]:
    """The first part of a path, and the rest without the query."""
    first, _, rest = path.partition("?")[0].lstrip("/").partition("/")
    return first, rest


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _silent() -> logging.Logger:
    """A logger for what clients do wrong, which is not the user's concern."""
    logger = logging.Logger("planner_service.view")
    logger.addHandler(logging.NullHandler())
    return logger
