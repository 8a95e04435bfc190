"""Work asked for over a channel: the same key again where it is lost, withdrawn or refused as over HTTP."""

from __future__ import annotations

import math
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from http import HTTPStatus
from typing import Any

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from planner_service import CancelToken, InvalidFile, InvalidRequest, PlannerServiceError
from planner_service.client import ServerRefused, ServerUnavailable
from planner_service.client.connection import Connection
from planner_service.collision.budget import Cancelled

Reply = Callable[[dict[str, Any]], Any]


def good(asked: dict[str, Any]) -> dict[str, Any]:
    return {"id": asked["id"], "status": 200, "job": "7", "answer": {"answer": 42}}


def problem(kind: str, status: int, **more: Any) -> Reply:
    answer = {"type": f"urn:problem-type:planner-service:{kind}", "detail": "so it is"}
    return lambda asked: {"id": asked["id"], "status": status, "job": "", "answer": answer, **more}


def lost(_: dict[str, Any]) -> None:
    """The connection is closed without an answer."""


class Script:
    """Answers each frame with what stands next in ``replies``, the last again and again; ``asked`` has what came."""

    def __init__(self) -> None:
        self.replies: list[Reply] = [good]
        self.asked: list[dict[str, Any]] = []
        self.links: list[ServerConnection] = []
        self.opened: list[dict[str, str]] = []
        self.refusal: tuple[int, str, bytes] | None = None
        self.silent = False
        self.over = threading.Event()

    def serve(self, link: ServerConnection) -> None:
        self.links.append(link)
        with suppress(ConnectionClosed):
            for message in link:
                assert isinstance(message, bytes)
                frame = msgpack.unpackb(message)
                self.asked.append(frame)
                if self.silent and frame["verb"] != "cancel":
                    continue
                reply = (self.replies.pop(0) if len(self.replies) > 1 else self.replies[0])(frame)
                if reply is None:
                    link.socket.shutdown(socket.SHUT_RDWR)
                    return
                link.send(reply if isinstance(reply, bytes | str) else msgpack.packb(reply))

    def admit(self, link: ServerConnection, request: Request) -> Response | None:
        self.opened.append({name.lower(): text for name, text in request.headers.raw_items()})
        if self.refusal is None:
            return None
        status, kind, content = self.refusal
        response = link.respond(HTTPStatus(status), content.decode())
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = kind
        return response


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def url(script: Script) -> Iterator[str]:
    with serve(script.serve, "127.0.0.1", 0, process_request=script.admit, compression=None) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{port(server)}"
        server.shutdown()
        thread.join()


def port(server: Server) -> int:
    return int(server.socket.getsockname()[1])


@pytest.fixture
def one(url: str) -> Iterator[Connection]:
    connection = Connection(url, "secret" * 6, 10.0, channel=True)
    yield connection
    connection.close()


def test_work_is_sent_with_a_key_and_a_token_and_its_answer_has_its_id(one: Connection, script: Script) -> None:
    answer = one.work("plans", {"a": np.float32(0.5), "b": np.array([1, 2])})
    assert (answer.document(), answer.job) == ({"answer": 42}, "7")
    frame = script.asked[0]
    assert (frame["verb"], frame["body"], frame["robot"]) == ("plans", {"a": 0.5, "b": [1, 2]}, "hash")
    assert len(frame["key"]) == 32
    assert script.opened[0]["authorization"] == f"Bearer {'secret' * 6}"
    one.work("check", {})
    assert "robot" not in script.asked[1]
    assert script.asked[1]["key"] != frame["key"]
    assert len(script.opened) == 1  # it is kept open


def test_after_a_lost_channel_the_same_key_is_sent_again(one: Connection, script: Script) -> None:
    script.replies = [lost, lost, good]
    assert one.work("plans", {}).job == "7"
    assert len(script.asked) == 3
    assert len({frame["key"] for frame in script.asked}) == 1


def test_a_channel_that_was_closed_meanwhile_is_not_asked(url: str, script: Script) -> None:
    impatient = Connection(url, None, 0.0, channel=True)
    impatient.work("plans", {})
    script.links[0].close()
    assert impatient.work("plans", {}).job == "7"
    assert len(script.opened) == 2
    script.replies = [lost]
    with pytest.raises(ServerUnavailable, match="closed"):
        impatient.work("plans", {})


def test_a_server_without_room_is_asked_again_and_a_refusal_is_final(one: Connection, script: Script) -> None:
    script.replies = [problem("queue-full", 429, retry_after=0), problem("unavailable", 503), good]
    assert one.work("plans", {}).job == "7"
    script.replies = [problem("queue-full", 429, retry_after=30)]
    with pytest.raises(ServerUnavailable, match="so it is"):
        Connection(one.url, None, 0.1, channel=True).work("plans", {})
    for kind, status, error in (
        ("worker-lost", 503, ServerRefused),
        ("invalid-request", 422, InvalidRequest),
        ("cancelled", 410, Cancelled),
    ):
        script.replies = [problem(kind, status)]
        asked = len(script.asked)
        with pytest.raises(error, match="so it is"):
            one.work("plans", {})
        assert len(script.asked) == asked + 1


REFUSALS: dict[str, Reply] = {
    "no msgpack": lambda _: b"\xc1",
    "a key twice": lambda _: b"\x82\xa2id\x01\xa2id\x02",
    "a vast list": lambda _: b"\xdd\xff\xff\xff\xff",
    "nested": lambda _: b"\x91" * 5000,
    "text": lambda _: "{}",
    "no map": lambda _: msgpack.packb([1]),
    "no status": lambda asked: {"id": asked["id"], "job": "", "answer": {}},
    "status": lambda asked: good(asked) | {"status": "200"},
    "job": lambda asked: good(asked) | {"job": 7},
    "retry_after": lambda asked: good(asked) | {"retry_after": math.nan},
    "bytes": lambda asked: good(asked) | {"answer": b"{}"},
    "another id": lambda asked: good(asked) | {"id": 99},
}


@pytest.mark.parametrize("name", REFUSALS)
def test_what_is_no_reply_is_refused_and_the_next_request_has_a_new_channel(
    one: Connection, script: Script, name: str
) -> None:
    script.replies = [REFUSALS[name], good]
    with pytest.raises(InvalidFile, match=r"/(plans|channel)"):
        one.work("plans", {})
    assert one.work("plans", {}).job == "7"
    assert len(script.opened) == 2


@pytest.mark.parametrize("answer", [7, None, [1], "text"])
def test_an_answer_that_is_no_object_is_refused(one: Connection, script: Script, answer: Any) -> None:
    script.replies = [lambda asked: good(asked) | {"answer": answer}]
    with pytest.raises(InvalidFile, match="expected an object"):
        one.work("plans", {}).document()
    script.replies = [lambda asked: good(asked) | {"status": 418, "answer": answer}]
    with pytest.raises(ServerRefused, match="418"):
        one.work("plans", {})


def test_cancelling_is_told_once_and_the_answer_says_so(one: Connection, script: Script) -> None:
    script.silent, cancel = True, CancelToken()
    threading.Timer(0.1, cancel.cancel).start()
    assert one.work("plans", {}, cancel).document() == {"answer": 42}
    assert [frame["verb"] for frame in script.asked] == ["plans", "cancel"]
    assert script.asked[1] == {"id": script.asked[0]["id"], "verb": "cancel"}


def test_an_interrupted_request_is_withdrawn_under_its_key(one: Connection, script: Script) -> None:
    def interrupted(asked: dict[str, Any]) -> None:
        script.silent = True  # what comes next is answered once it is withdrawn
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
        script.over.wait(10.0)

    script.replies = [interrupted, good]
    with pytest.raises(KeyboardInterrupt):
        one.work("plans", {})
    script.over.set()
    assert [frame["verb"] for frame in script.asked[:3]] == ["plans", "plans", "cancel"]
    assert script.asked[0]["key"] == script.asked[1]["key"]


@pytest.mark.parametrize(
    ("status", "media", "content", "error"),
    [
        (401, "application/problem+json", b'{"type": "a:unauthorized", "detail": "no token"}', ServerRefused),
        (404, "text/plain", b"Not Found", ServerRefused),
        (503, "text/plain", b"Service Unavailable", ServerUnavailable),
        (403, "application/problem+json", b"[]", ServerRefused),
    ],
)
def test_a_server_that_opens_no_channel_says_why(
    url: str, script: Script, status: int, media: str, content: bytes, error: type[PlannerServiceError]
) -> None:
    script.refusal = status, media, content
    with pytest.raises(error, match="no token" if status == 401 else str(status)):
        Connection(url, None, 0.0, channel=True).work("plans", {})


def test_an_answer_that_is_too_large_is_not_read(url: str, script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner_service.client.channel.MAX_BYTES", 1000)
    script.replies = [lambda _: b"\xc0" * 2000]
    with pytest.raises(ServerUnavailable, match="closed"):
        Connection(url, None, 0.0, channel=True).work("plans", {})


def test_there_is_no_server() -> None:
    with pytest.raises(ServerUnavailable, match="refused"):
        Connection("http://127.0.0.1:1", None, 0.0, channel=True).work("plans", {})


def test_what_msgpack_has_not_is_refused_here(one: Connection, script: Script) -> None:
    for value in (object(), 2**70):
        with pytest.raises(InvalidRequest, match="request"):
            one.work("plans", {"a": value})
    assert not script.asked


def test_many_threads_ask_at_once(one: Connection, script: Script) -> None:
    jobs = list[str]()
    threads = [threading.Thread(target=lambda: jobs.append(one.work("plans", {}).job)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert jobs == ["7"] * 8
    assert len(script.opened) <= 8
