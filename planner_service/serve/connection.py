"""One connection of a client: what it sends is read only so far and so long."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from planner_service.serve.guard import MAX_BODY, MAX_HEAD
from planner_service.serve.problems import PROBLEM_JSON, Problem

__all__ = ["Channel", "Connection"]

MAX_REQUEST = MAX_HEAD + 2 * MAX_BODY
"""Bytes of a whole request, with what a chunked body has between its chunks and after them."""

MAX_SECONDS = 60.0
"""For a whole request to arrive; also for its first byte after a client has connected."""


MAX_PARTS = 1_000
"""Frames that one message of a channel may come in."""


class Connection(HttpToolsProtocol):
    """Ends when a request is too large or too slow, which uvicorn does not limit while it reads one."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._in_head, self._refused, self._bytes = True, False, 0
        self._late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """The client has connected."""
        super().connection_made(transport)
        self._expect()

    def data_received(self, data: bytes) -> None:
        """Some bytes have come, of one request or of several."""
        self._bytes += len(data)
        super().data_received(data)
        if self._in_head and self._bytes > MAX_HEAD:
            problem = Problem("header-too-large", f"a request has at most {MAX_HEAD:,} bytes before its body")
            _refuse(self.transport, problem)
        elif self._refused:
            _refuse(self.transport, Problem("malformed", "Upgrade: expected websocket, by GET and without a body"))
        elif self._bytes > MAX_REQUEST:
            self.transport.close()

    def on_message_begin(self) -> None:
        """The first byte of a request has come."""
        super().on_message_begin()
        self._expect()

    def on_headers_complete(self) -> None:
        """What comes before the body has come."""
        self._in_head, self._refused = False, self._is_no_handshake
        if not self._refused:
            super().on_headers_complete()

    def on_message_complete(self) -> None:
        """The whole request has come."""
        self._in_head, self._bytes = True, 0
        self._expect_nothing()
        if not self._refused:
            super().on_message_complete()

    def _should_upgrade(self) -> bool:
        return not self._refused and super()._should_upgrade()

    @property
    def _is_no_handshake(self) -> bool:
        """Whether it asks for an upgrade with a body, which the parser does not read then, or not by GET."""
        bodies = [text for name, text in self.headers if name in (b"content-length", b"transfer-encoding")]
        asks = bodies not in ([], [b"0"]) or (super()._should_upgrade() and self.parser.get_method() != b"GET")
        return self.parser.should_upgrade() and asks

    def handle_websocket_upgrade(self) -> None:
        """The connection goes on as a channel."""
        self._expect_nothing()
        super().handle_websocket_upgrade()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._expect_nothing()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._expect_nothing()
        self._late = self.loop.call_later(MAX_SECONDS, self.transport.close)

    def _expect_nothing(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


class Channel(WebSocketsSansIOProtocol):
    """Ends when a message comes in too many parts or too slowly, which uvicorn does not limit while it reads one."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._late: asyncio.TimerHandle | None = None

    def data_received(self, data: bytes) -> None:
        """Some bytes have come, of a message or of several."""
        super().data_received(data)
        if self.conn.handshake_exc is not None and not self.handshake_initiated:
            _refuse(self.transport, Problem("malformed", "the handshake of a channel cannot be read"))
        elif len(self.frames) > MAX_PARTS:
            self.transport.close()
        if not self.frames and not self.conn.reader.buffer:
            self._expect_nothing()
        elif self._late is None:
            self._late = self.loop.call_later(MAX_SECONDS, self.transport.close)

    def send_receive_event_to_app(self) -> None:
        """A whole message has come; a text is not read, as channels take bytes alone."""
        if self.curr_msg_data_type == "text":
            self.frames = [b""]
        super().send_receive_event_to_app()

    async def send(self, message: Any) -> None:
        """Send what the application answers; a refusal of the handshake ends it, of which uvicorn complains else."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body", False):
            self.handshake_complete = True

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection has ended."""
        self._expect_nothing()
        super().connection_lost(exc)

    def _expect_nothing(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None


def _refuse(transport: asyncio.Transport, problem: Problem) -> None:
    """Answer a request that is not read to its end, and close the connection."""
    head = f"content-type: {PROBLEM_JSON}\r\ncontent-length: {len(problem.content)}\r\nconnection: close"
    transport.write(f"HTTP/1.1 {problem.status} \r\n{head}\r\n\r\n".encode("ascii") + problem.content)
    transport.close()
