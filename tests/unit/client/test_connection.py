"""Requests to a server that is lost, full, gone or lying: sent again, withdrawn, or refused, and never done twice."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest

from planner_service import CancelToken, InvalidFile, InvalidRequest, Obstacle, Scene, Sphere
from planner_service.client import ServerRefused, ServerUnavailable, StaleVersion
from planner_service.client.connection import Connection
from planner_service.client.scenes import ScenesOnServer
from planner_service.records.scene import SceneRecord

ACCEPTED = 202, {"Location": "/plans/7"}, b"{}"
ANSWER = 200, {"Content-Location": "/plans/7"}, b'{"answer": 42}'
LOST: tuple[int, dict[str, str], bytes] = (0, {}, b"")
"""The connection is closed without an answer."""


class Script(ThreadingHTTPServer):
    """Answers with what stands next in ``answers``, the last again and again; ``asked`` has what came."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers: list[tuple[int, dict[str, str], bytes]] = [ANSWER]
        self.asked: list[tuple[str, str, dict[str, str]]] = []
        self.deleted = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Script

    def _answer(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        script = self.server
        script.asked.append((self.command, self.path, {name.lower(): text for name, text in self.headers.items()}))
        if self.command == "DELETE":
            script.deleted.set()
            return self._send(202, {}, b"{}")
        if self.command == "GET" and "wait" in self.headers.get("Prefer", "") and script.answers == [ACCEPTED]:
            script.deleted.wait(10.0)
            return self._send(*ANSWER)
        return self._send(*(script.answers.pop(0) if len(script.answers) > 1 else script.answers[0]))

    do_GET = do_POST = do_DELETE = do_PUT = _answer  # noqa: N815

    def _send(self, status: int, headers: dict[str, str], data: bytes) -> None:
        if not status:
            self.close_connection = True
            return
        self.send_response(status)
        for name, text in {**headers, "Content-Length": str(len(data))}.items():
            self.send_header(name, text)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: Any) -> None:
        """Print nothing."""


@pytest.fixture
def script() -> Iterator[Script]:
    with Script() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def connection(script: Script, patience: float = 10.0, token: str | None = None) -> Connection:
    return Connection(script.url, token, patience)


def problem(kind: str, **more: Any) -> bytes:
    return json.dumps({"type": f"urn:problem-type:planner-service:{kind}", "detail": "so it is", **more}).encode()


PROBLEM = {"Content-Type": "application/problem+json"}


def test_work_is_sent_with_a_key_and_its_answer_has_its_id(script: Script) -> None:
    answer = connection(script).work("plans", {"a": 1})
    assert (answer.document(), answer.job) == ({"answer": 42}, "7")
    method, path, headers = script.asked[0]
    assert (method, path, headers["content-type"]) == ("POST", "/plans?robot=hash", "application/json")
    assert headers["prefer"].startswith("wait=")
    assert len(headers["idempotency-key"]) == 32


def test_after_a_lost_connection_the_same_key_is_sent_again(script: Script) -> None:
    script.answers = [LOST, LOST, ANSWER]
    assert connection(script).work("plans", {}).job == "7"
    assert len({headers["idempotency-key"] for _, _, headers in script.asked}) == 1
    assert len(script.asked) == 3
    connection(script).work("plans", {})  # another request has another key
    assert len({headers["idempotency-key"] for _, _, headers in script.asked}) == 2


def test_an_answer_that_takes_longer_is_waited_for(script: Script) -> None:
    script.answers = [ACCEPTED, ACCEPTED, LOST, ANSWER]
    assert connection(script).work("plans", {}).document() == {"answer": 42}
    asked = [(method, path) for method, path, _ in script.asked]
    assert asked == [("POST", "/plans?robot=hash"), *[("GET", "/plans/7?robot=hash")] * 3]


def test_a_scene_that_was_stored_though_the_answer_was_lost_is_stored(script: Script) -> None:
    stored = {**SceneRecord.of(Scene(name="cell")).document(), "version": 4}
    changed = 412, PROBLEM, problem("changed")
    for before, version in ((3, 4), (0, 4)):
        script.answers = [LOST, changed, (200, {}, json.dumps(stored).encode())]
        assert ScenesOnServer(connection(script)).put("cell", Scene(), before=before) == version
    for before, scene in (
        (2, Scene()),
        (3, Scene((Obstacle("ball", Sphere(0.1)),))),
        (3, Scene(description="a new one")),
    ):
        script.answers = [LOST, changed, (200, {}, json.dumps(stored).encode())]
        with pytest.raises(StaleVersion):
            ScenesOnServer(connection(script)).put("cell", scene, before=before)


def test_a_server_without_room_or_gone_behind_a_proxy_is_asked_again(script: Script) -> None:
    for refusal in (
        (429, PROBLEM, problem("queue-full")),
        (503, PROBLEM, problem("unavailable")),
        *((status, {"Content-Type": "text/plain"}, b"Internal Server Error") for status in (500, 502, 504)),
    ):
        script.answers = [refusal, ANSWER]
        assert connection(script).work("plans", {}).job == "7"
    script.asked.clear()
    script.answers = [(429, {**PROBLEM, "Retry-After": "30"}, problem("queue-full"))]
    with pytest.raises(ServerUnavailable, match="so it is"):  # patience ends
        connection(script, patience=0.1).work("plans", {})
    assert len(script.asked) == 1  # it is told to come back later than that


def test_a_refusal_is_final(script: Script) -> None:
    script.answers = [(503, PROBLEM, problem("worker-lost")), ANSWER]
    with pytest.raises(ServerRefused, match="so it is") as refused:
        connection(script).work("certify", {})
    assert refused.value.kind == "worker-lost"
    assert len(script.asked) == 1


def test_whatever_an_answer_or_a_refusal_looks_like_its_error_is_one_of_this_package(script: Script) -> None:
    for data in (b"", b"[]", b"<html>", b'{"detail": 1, "type": []}'):
        script.answers = [(418, PROBLEM, data)]
        with pytest.raises(ServerRefused):
            connection(script).fetch("GET", "/robot")
    for data in (b"", b"[]", b"{", b'{"a": NaN}', b'{"a": 1, "a": 2}', b"\xff"):
        script.answers = [(200, {}, data)]
        answer = connection(script).fetch("GET", "/robot")
        with pytest.raises(InvalidFile, match="/robot"):
            answer.document()


def test_an_endless_answer_is_not_read(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner_service.client.connection.MAX_BYTES", 1000)
    script.answers = [(200, {}, b" " * 2000)]
    with pytest.raises(InvalidFile, match="too large: more than 1,000 bytes"):
        connection(script).fetch("GET", "/robot")


def test_a_token_is_sent_and_not_shown(script: Script) -> None:
    one = connection(script, token="secret" * 6)
    one.fetch("GET", "/robot")
    assert script.asked[0][2]["authorization"] == f"Bearer {'secret' * 6}"
    with pytest.raises(InvalidRequest, match="token") as refused:
        connection(script, token="secret\n")
    assert "secret" not in str(refused.value)


def test_cancelling_withdraws_the_request_and_its_answer_says_so(script: Script) -> None:
    script.answers, cancel = [ACCEPTED], CancelToken()
    threading.Timer(0.1, cancel.cancel).start()
    assert connection(script).work("plans", {}, cancel).document() == {"answer": 42}
    assert [path for method, path, _ in script.asked if method == "DELETE"] == ["/plans/7?finished=keep"]
    assert "prefer" not in script.asked[0][2]  # the id is known at once


def test_an_interrupted_request_is_withdrawn(script: Script, monkeypatch: pytest.MonkeyPatch) -> None:
    script.answers, one = [ACCEPTED], connection(script)
    monkeypatch.setattr(one, "_waited", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        one.work("plans", {})
    assert script.asked[-1][:2] == ("DELETE", "/plans/7?finished=keep")


def test_an_address_of_no_server_is_refused() -> None:
    wrong: tuple[Any, ...] = ("", "127.0.0.1:8080", "ftp://a", "http://", "http://a/b", "http://u:p@a", "http://a?b", 7)
    for url in wrong:
        with pytest.raises(InvalidRequest, match="url"):
            Connection(url, None, 0.0)
    with pytest.raises(ServerUnavailable, match="refused"):
        Connection("http://127.0.0.1:1", None, 0.0).fetch("GET", "/robot")


def test_numbers_of_numpy_are_numbers_and_what_json_has_not_is_refused_here(script: Script) -> None:
    connection(script).work("plans", {"a": np.float32(0.5), "b": np.array([1, 2]), "c": np.bool_(True)})
    with pytest.raises(InvalidRequest, match="request"):
        connection(script).work("plans", {"a": object()})
    with pytest.raises(InvalidRequest, match="not finite"):
        connection(script).work("plans", {"a": float("nan")})
    assert len(script.asked) == 1
