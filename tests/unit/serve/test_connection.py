"""What a client sends is read only so far and so long: the rest costs no memory and no connection."""

from __future__ import annotations

import asyncio
from contextlib import suppress

import pytest
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from uvicorn import Config
from uvicorn.server import ServerState

from planner_service.serve import connection
from planner_service.serve.connection import Connection
from planner_service.serve.guard import MAX_HEAD, Guard

HEAD = b"POST /plans HTTP/1.1\r\nHost: localhost:80\r\n"
CHUNKED = HEAD + b"Transfer-Encoding: chunked\r\n\r\n1\r\n{\r\n0\r\n"
WHOLE = HEAD + b"Content-Length: 2\r\n\r\n{}"


async def app(scope: Scope, receive: Receive, send: Send) -> None:
    body = await Request(scope, receive).body()
    await Response(b"%d bytes" % len(body))(scope, receive, send)


def answered(*parts: bytes) -> bytes:
    """All that a client gets which sends these, until the server closes the connection."""

    async def ask() -> bytes:
        config = Config(Guard(app, None, Guard.loopback(80)), log_config=None, timeout_keep_alive=0)
        state = ServerState()
        server = await asyncio.get_running_loop().create_server(lambda: Connection(config, state, {}), "127.0.0.1", 0)
        async with server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            received = b""
            with suppress(ConnectionError):
                for part in parts:
                    writer.write(part)
                    await writer.drain()
                received = await asyncio.wait_for(reader.read(), 10.0)
            writer.close()
            with suppress(ConnectionError):
                await writer.wait_closed()
            while state.connections or state.tasks:
                await asyncio.sleep(0.001)
            return received

    return asyncio.run(ask())


def test_a_request_of_usual_size_is_answered() -> None:
    assert answered(WHOLE).endswith(b"2 bytes")


def test_headers_that_do_not_end_or_are_too_long_are_refused() -> None:
    for parts in ((HEAD + b"X: ", b"a" * MAX_HEAD), (HEAD + b"X: " + b"a" * MAX_HEAD + b"\r\n\r\n",)):
        received = answered(*parts)
        assert received.startswith(b"HTTP/1.1 431")
        assert b"header-too-large" in received


def test_what_follows_a_body_has_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "MAX_REQUEST", 100_000)
    assert answered(CHUNKED + b"T: ", *[b"a" * 10_000] * 20) == b""


@pytest.mark.parametrize("part", [b"", HEAD, HEAD + b"Content-Length: 2\r\n\r\n{"], ids=["none", "head", "body"])
def test_a_request_that_does_not_come_whole_ends_its_connection(part: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "MAX_SECONDS", 0.02)
    assert answered(part) == b""
