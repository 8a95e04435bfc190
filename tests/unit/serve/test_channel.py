"""A channel gives the answers and the problems that requests over HTTP get, and asks for the same rights."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import msgpack
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from planner_service.serve.channel import MAX_OPEN
from tests.unit.serve.test_server import LONG, PLAN, Server, serving, timeless

TOKEN = "t" * 32


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("channel")
    token = folder / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    with serving(folder, "--queue", str(MAX_OPEN + 2), "--token-file", str(token)) as server:
        server.client.headers["Authorization"] = f"Bearer {TOKEN}"
        yield server


@contextmanager
def channel(server: Server, **headers: str) -> Iterator[Connection]:
    given = {"Authorization": f"Bearer {TOKEN}"} | headers
    url = f"{server.client.base_url}".rstrip("/").replace("http", "ws", 1) + "/channel"
    with connect(url, additional_headers=given, compression=None, max_size=None) as link:
        yield link


def answer(link: Connection) -> dict[str, Any]:
    reply: dict[str, Any] = msgpack.unpackb(link.recv(60.0))
    return reply


def asked(link: Connection, frame: dict[str, Any]) -> dict[str, Any]:
    link.send(msgpack.packb(frame))
    return answer(link)


def begun(link: Connection, server: Server, name: str) -> str:
    """The job of a request that takes minutes, once a worker is at it."""
    link.send(msgpack.packb({"id": name, "verb": "roadmaps", "body": LONG}))
    while True:
        for job in server.client.get("/plans?limit=1").json()["plans"]:
            if job["kind"] == "roadmaps" and job["state"] == "running":
                return str(job["id"])
        time.sleep(0.01)


def test_an_answer_is_that_of_http_to_the_last_bit(server: Server) -> None:
    with channel(server) as link:
        reply = asked(link, {"id": 7, "verb": "plans", "body": PLAN})
        named = asked(link, {"id": "a", "verb": "plans", "body": PLAN, "robot": "hash"})
    stored = server.client.get(f"/plans/{reply['job']}").json()
    assert (reply["id"], reply["status"], reply["answer"]) == (7, 200, stored)
    assert timeless(stored) == timeless(server.post("plans", PLAN).json())
    assert timeless(named["answer"]) == timeless({**stored, "robot": {"hash": stored["robot"]["hash"]}})


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("plans", {**PLAN, "more": 1}),
        ("plans", {**PLAN, "scene": "none"}),
        ("plans", [PLAN]),
        ("check", {"scene": "bin", "states": [[0.0]]}),
        ("replan", {"plan": "0" * 32, "at_time": 0.0}),
    ],
)
def test_a_problem_is_that_of_http(server: Server, kind: str, body: Any) -> None:
    with channel(server) as link:
        reply = asked(link, {"id": 1, "verb": kind, "body": body})
    over_http = server.post(kind, body)
    assert (reply["status"], reply["answer"]) == (over_http.status_code, over_http.json())


@pytest.mark.parametrize(
    ("frame", "detail"),
    [
        (b"\xc1", "msgpack"),
        (b"", "msgpack"),
        (msgpack.packb([1]), "a map with id"),
        (msgpack.packb({"verb": "plans", "body": PLAN}), "a map with id"),
        (b"\x82\xa2id\x01\xa2id\x02", "twice"),
        (b"\xdd\xff\xff\xff\xff" * 900, "msgpack"),  # lists of four thousand million entries within each other
        (b"\x91" * 10_000, "msgpack"),
        (msgpack.packb({"id": 1, "verb": "plan", "body": PLAN}), "verb: got 'plan'; expected one of plans"),
        (msgpack.packb({"id": 1, "verb": "plans", "body": PLAN, "wait": 1}), "unknown member 'wait'"),
        (msgpack.packb({"id": 1, "verb": "plans", "body": {"scene": b"bin"}}), "body"),
        (msgpack.packb({"id": 1, "verb": "plans", "body": {"deadline": math.nan}}), "body"),
        (msgpack.packb({"id": 1, "verb": "plans", "body": PLAN, "key": "with blanks"}), "Idempotency-Key"),
        (msgpack.packb({"id": 1, "verb": "plans", "body": PLAN, "robot": None}), "robot: got None; expected hash"),
    ],
)
def test_a_frame_that_asks_nothing_says_so_and_the_channel_goes_on(server: Server, frame: bytes, detail: str) -> None:
    with channel(server) as link:
        link.send(frame)
        reply = answer(link)
        assert (reply["status"], reply["answer"]["type"].rpartition(":")[2]) == (400, "malformed")
        assert detail in reply["answer"]["detail"]
        assert asked(link, {"id": 2, "verb": "check", "body": {"scene": "bin"}})["status"] == 200


def test_answers_come_as_they_are_there_and_what_is_cancelled_says_so(server: Server) -> None:
    with channel(server) as link:
        begun(link, server, "long")
        assert asked(link, {"id": 2, "verb": "plans", "body": {}})["id"] == 2
        again = asked(link, {"id": "long", "verb": "check", "body": {}})
        assert again["answer"]["detail"].startswith("id: got 'long'")
        reply = asked(link, {"id": "long", "verb": "cancel"})
    assert (reply["id"], reply["status"]) == ("long", 410)


def test_a_request_is_cancelled_even_before_it_is_accepted(server: Server) -> None:
    with channel(server) as link:
        begun(link, server, "long")
        frames = [{"id": 1, "verb": "roadmaps", "body": LONG}, {"id": 1, "verb": "cancel"}]
        with link.protocol_mutex:
            for frame in frames:
                link.protocol.send_binary(msgpack.packb(frame))
            link.socket.sendall(b"".join(link.protocol.data_to_send()))
        reply = answer(link)
        assert (reply["id"], reply["status"], reply["answer"]["type"].rpartition(":")[2]) == (1, 410, "cancelled")


def test_the_same_key_gets_the_same_answer_on_any_channel(server: Server) -> None:
    with channel(server) as link:
        first = asked(link, {"id": 1, "verb": "plans", "body": PLAN, "key": "mine"})
    with channel(server) as link:
        assert asked(link, {"id": 1, "verb": "plans", "body": PLAN, "key": "mine"}) == first
        assert asked(link, {"id": 1, "verb": "check", "body": PLAN, "key": "mine"})["answer"]["type"].endswith(
            ":key-reused"
        )


def queued(server: Server) -> list[str]:
    """Jobs that wait, the first first."""
    jobs = server.client.get("/plans").json()["plans"]
    return [job["id"] for job in reversed(jobs) if job["state"] == "queued"]


def test_a_channel_has_so_many_open_requests_and_a_closed_one_cancels_what_has_no_key(server: Server) -> None:
    with channel(server) as link:
        first = begun(link, server, "first")
        for k in range(MAX_OPEN):
            key = {"key": "kept"} if k == 0 else {}
            link.send(msgpack.packb({"id": k, "verb": "plans", "body": PLAN, **key}))
        reply = answer(link)
        assert (reply["id"], reply["status"], reply["retry_after"]) == (MAX_OPEN - 1, 429, 1)
        kept, *others = queued(server)
        assert len(others) == MAX_OPEN - 2
    assert server.answer(first).status_code == 410
    assert server.answer(kept).json()["result"]["ok"]
    assert {server.answer(job).json()["result"]["failure"]["reason"] for job in others} == {"PREEMPTED"}


def test_beyond_the_queue_requests_are_refused(server: Server) -> None:
    with channel(server) as link, channel(server) as other:
        begun(link, server, "first")
        for k in range(MAX_OPEN - 1):
            link.send(msgpack.packb({"id": k, "verb": "plans", "body": PLAN}))
        while len(queued(server)) < MAX_OPEN - 1:
            time.sleep(0.01)
        for k in range(4):
            other.send(msgpack.packb({"id": k, "verb": "plans", "body": PLAN}))
        reply = answer(other)
        assert (reply["id"], reply["answer"]["type"].rpartition(":")[2]) == (3, "queue-full")
        assert reply["retry_after"] >= 1


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Authorization": "Bearer " + "x" * 32}, 401),
        ({"Origin": "http://elsewhere.example"}, 403),
        ({"Sec-Fetch-Site": "cross-site"}, 403),
    ],
)
def test_who_may_not_ask_gets_no_channel(server: Server, headers: dict[str, str], status: int) -> None:
    with pytest.raises(InvalidStatus) as caught, channel(server, **headers):
        pass
    response = caught.value.response
    assert (response.status_code, json.loads(response.body)["status"]) == (status, status)


def test_a_text_that_is_no_unicode_ends_a_channel_in_the_same_words(server: Server) -> None:
    with channel(server) as link:
        link.send(b"\xff", text=True)
        with pytest.raises(ConnectionClosed) as caught:
            link.recv(20.0)
    assert caught.value.rcvd is not None
    assert (caught.value.rcvd.code, caught.value.rcvd.reason) == (1003, "frames are msgpack")


@pytest.mark.parametrize("sent", ["{}", b"\x00" * 20_000_001])
def test_text_and_what_is_too_large_end_a_channel(server: Server, sent: str | bytes) -> None:
    with channel(server) as link:
        with suppress(ConnectionClosed):
            link.send(sent)
        with pytest.raises(ConnectionClosed):
            link.recv(20.0)
    assert server.client.get("/health").status_code == 200
