"""Pages of other origins, other names of this machine, and whoever has no token get nothing."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

import httpx
import pytest
from starlette.middleware.errors import ServerErrorMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.serve import guard
from planner_service.serve.guard import Guard, checked_origins
from planner_service.serve.run import read_token
from tests.support.command import refused

TOKEN = "s" * 32
URL = "http://127.0.0.1:8080"


async def app(scope: Scope, receive: Receive, send: Send) -> None:
    body = await Request(scope, receive).body()
    await Response(b"%d" % len(body))(scope, receive, send)


def asked(
    token: str | None, headers: Mapping[str, str], path: str = "/plans", content: AsyncIterator[bytes] | None = None
) -> httpx.Response:
    """What an application behind the guard answers."""

    async def ask() -> httpx.Response:
        guarded = Guard(ServerErrorMiddleware(app), token, Guard.loopback(8080))
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app=guarded), base_url=URL) as client:
            return await client.request("POST" if content else "GET", path, headers=headers, content=content)

    return asyncio.run(ask())


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "rebound.example:8080"}, 421),
        ({"Host": "127.0.0.1:8081"}, 421),
        ({"Origin": "http://elsewhere.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
        ({"Content-Length": "20000001"}, 413),
        ({"Content-Length": "-1"}, 413),
    ],
)
def test_what_comes_from_elsewhere_or_is_too_large_is_refused(headers: dict[str, str], status: int) -> None:
    response = asked(None, headers)
    assert (response.status_code, response.headers["content-type"]) == (status, "application/problem+json")


def test_what_comes_from_here_is_served() -> None:
    for headers in ({}, {"Origin": URL}, {"Host": "localhost:8080"}, {"Sec-Fetch-Site": "same-origin"}):
        assert asked(None, headers).status_code == 200


def test_a_page_of_an_allowed_origin_may_use_the_server_and_no_other() -> None:
    page = "http://localhost:5173"

    async def ask(method: str, headers: Mapping[str, str]) -> httpx.Response:
        guarded = Guard(app, TOKEN, Guard.loopback(8080), checked_origins([page]))
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app=guarded), base_url=URL) as client:
            return await client.request(method, "/plans", headers=headers)

    asks = {"Origin": page, "Access-Control-Request-Method": "POST", "Sec-Fetch-Site": "cross-site"}
    before = asyncio.run(ask("OPTIONS", asks))
    assert (before.status_code, before.headers["access-control-allow-origin"]) == (204, page)
    assert "authorization" in before.headers["access-control-allow-headers"]
    sent = {"Origin": page, "Sec-Fetch-Site": "cross-site", "Authorization": f"Bearer {TOKEN}"}
    answer = asyncio.run(ask("GET", sent))
    assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (200, page)
    assert asyncio.run(ask("GET", {**sent, "Authorization": "Bearer x"})).status_code == 401
    for other in ("http://localhost:5174", "null", "https://localhost:5173"):
        refusal = asyncio.run(ask("OPTIONS", {**asks, "Origin": other}))
        assert refusal.status_code == 403
        assert "access-control-allow-origin" not in refusal.headers


@pytest.mark.parametrize("origin", ["*", "localhost:5173", "http://localhost:5173/", "ftp://localhost", "http://a b"])
def test_what_is_no_origin_is_not_allowed(origin: str) -> None:
    with pytest.raises(InvalidRequest, match="an origin, such as"):
        checked_origins([origin])


def test_a_body_that_grows_too_large_is_refused_though_it_did_not_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    async def pieces() -> AsyncIterator[bytes]:
        for _ in range(3):
            yield b"x" * 50

    monkeypatch.setattr(guard, "MAX_BODY", 150)
    assert asked(None, {}, content=pieces()).text == "150"
    monkeypatch.setattr(guard, "MAX_BODY", 149)
    assert asked(None, {}, content=pieces()).status_code == 413


def test_without_the_token_nothing_is_told_but_that_the_server_runs_and_what_it_takes() -> None:
    for sent in ("Bearer ", f"Bearer {TOKEN[1:]}", f"bearer {TOKEN}", TOKEN, f"Basic {TOKEN}", None):
        headers = {} if sent is None else {"Authorization": sent}
        for path in ("/plans", "/metrics", "/docs/", "/docs/page", "/nothing", "/health/"):
            response = asked(TOKEN, headers, path)
            assert (response.status_code, response.headers["www-authenticate"]) == (401, "Bearer")
        for path in ("/health", "/docs", "/docs/page.js", "/openapi.json"):
            assert asked(TOKEN, headers, path).status_code == 200
    assert asked(TOKEN, {"Authorization": f"Bearer {TOKEN}"}).status_code == 200


@pytest.mark.parametrize(
    ("content", "mode", "message"),
    [
        ("s" * 31, 0o600, "expected 32 to 1,000 printable ASCII characters without spaces"),
        (TOKEN, 0o604, "others may read it; chmod 600"),
    ],
)
def test_a_token_that_is_short_or_that_others_can_read_is_refused(
    tmp_path: Path, content: str, mode: int, message: str
) -> None:
    file = tmp_path / "token"
    file.write_text(content)
    file.chmod(mode)
    with pytest.raises(InvalidFile, match=message):
        read_token(file)


def test_without_a_token_a_server_listens_on_this_machine_alone() -> None:
    told = " ".join(refused("serve", "--scene", "bin", "--port", "0", "--host", "0.0.0.0").split())
    assert "127.0.0.1, or a --token-file: others could use this server" in told
