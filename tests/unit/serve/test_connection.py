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
from planner_service.serve.connection import Channel, Connection
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
        config = Config(Guard(app, None, Guard.loopback(80)), log_config=None, timeout_keep_alive=0, ws=Channel)
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


UPGRADE = b"Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
UPGRADE += b"AAAAAAAAAAAAAAAAAAAAAA==\r\n"


@pytest.mark.parametrize("protocol", [b"websocket", b"h2c"])
@pytest.mark.parametrize("method", [b"POST", b"GET"])
def test_what_asks_for_an_upgrade_with_a_body_is_refused_at_once(method: bytes, protocol: bytes) -> None:
    head = HEAD.replace(b"POST", method) + UPGRADE.replace(b"websocket", protocol)
    for body in (b"Content-Length: 2\r\n\r\n{}", b"Transfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"):
        received = answered(head + body)
        assert received.startswith(b"HTTP/1.1 400")
        assert b"Upgrade: expected websocket, by GET" in received


def test_a_protocol_that_is_not_spoken_changes_nothing() -> None:
    head = HEAD.replace(b"POST", b"GET") + UPGRADE.replace(b"websocket", b"h2c")
    assert answered(head + b"\r\n").endswith(b"0 bytes")
    assert answered(HEAD + UPGRADE + b"\r\n").startswith(b"HTTP/1.1 400")


def test_a_handshake_that_cannot_be_read_is_refused_at_once() -> None:
    received = answered(
        b"GET /channel HTTP/1.1\r\nHost: localhost:80\r\n" + UPGRADE + b"X: " + b"a" * 9000 + b"\r\n\r\n"
    )
    assert received.startswith(b"HTTP/1.1 400")
    assert b"handshake" in received


def test_what_follows_a_body_has_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "MAX_REQUEST", 100_000)
    assert answered(CHUNKED + b"T: ", *[b"a" * 10_000] * 20) == b""


@pytest.mark.parametrize("part", [b"", HEAD, HEAD + b"Content-Length: 2\r\n\r\n{"], ids=["none", "head", "body"])
def test_a_request_that_does_not_come_whole_ends_its_connection(part: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "MAX_SECONDS", 0.02)
    assert answered(part) == b""
