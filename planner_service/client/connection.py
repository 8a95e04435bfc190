"""Requests to a server: sent again where a connection is lost, withdrawn where the caller cancels."""

from __future__ import annotations

import json
import math
import time
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import suppress
from dataclasses import replace
from typing import Any

from planner_service.client.answer import LOOK, WAIT, Answer, Lost, Work, of_numpy
from planner_service.client.channels import Channels
from planner_service.client.http_connections import HttpConnections, ServerAddress
from planner_service.client.problems import ServerRefused, ServerUnavailable, error_of
from planner_service.collision import CancelToken
from planner_service.errors import InvalidFile, InvalidRequest, PlannerServiceError
from planner_service.files.json_reader import MAX_BYTES
from planner_service.geometry.validation import number

__all__ = ["Connection"]

PAUSES = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Seconds before it is tried again, then as long as the last."""

MAX_ROADMAP = 200_000_000


class Connection:
    """One server. Several threads may use it at the same time.

    Args:
        url: Such as ``http://127.0.0.1:8080``.
        token: What the server wants to see; None if it wants nothing.
        patience: Seconds for which a request is sent again while the server cannot be reached or has no room.
        channel: Whether work is asked for over its channel instead of HTTP.

    Raises:
        InvalidRequest: the address is none of a server, or a value is out of range.
        MissingDependency: the extra ``client`` is not installed, which a channel needs.
    """

    def __init__(self, url: str, token: str | None, patience: float, *, channel: bool = False) -> None:
        self._patience = number("patience", patience, "seconds, at least 0", 0.0, math.inf)
        headers = {}
        if token is not None:
            if not isinstance(token, str) or not token.isascii() or not token.isprintable() or " " in token:
                raise InvalidRequest("token", "a text that is no token", "printable ASCII without spaces, or None")
            headers["Authorization"] = f"Bearer {token}"
        address = ServerAddress(url, headers)
        self.url, self._http = address.url, HttpConnections(address)
        self._channels = Channels(address) if channel else None

    def close(self) -> None:
        """Close its connections."""
        self._http.close()
        if self._channels is not None:
            self._channels.close()

    def fetch(self, method: str, path: str, body: Any = None, **headers: str) -> Answer:
        """The answer to one request; ``headers`` by their names with underscores.

        Raises:
            ServerUnavailable: the server cannot be reached, or has no room, for as long as patience lasts.
            PlannerServiceError: the server refused it.
        """
        content = None if body is None else _text(body)
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        return self._persistent(method, path, content, named)

    def work(self, kind: str, body: Mapping[str, Any], cancel: CancelToken | None = None) -> Answer:
        """The answer to a request for work, once it is there; a plan or a task has its robot's hash in its place.

        It has a key: sent again after a connection was lost, it is not done again. Ctrl-C withdraws it.

        Args:
            cancel: Withdraws it when cancelled from another thread; what is answered then says so, unless it has just
                ended.

        Raises:
            ServerUnavailable: as ``fetch``.
            PlannerServiceError: the server refused it.
        """
        work, channels = Work(kind, body, uuid.uuid4().hex), self._channels
        if channels is None:
            return self._over_http(work, cancel)
        try:
            return self._until_answered(lambda: channels.ask(work, cancel))
        except KeyboardInterrupt:
            with suppress(Exception):
                channels.withdraw(work)
            raise

    def _over_http(self, work: Work, cancel: CancelToken | None) -> Answer:
        query = "?robot=hash" if work.by_hash else ""
        path, content, key = f"/{work.kind}{query}", _text(work.body), {"Idempotency-Key": work.key}
        wait = {"Prefer": f"wait={WAIT}"} if cancel is None else {}
        job = ""
        try:
            answer = self._persistent("POST", path, content, key | wait)
            job = answer.job
            while answer.status == 202:
                answer = self._waited(f"/plans/{job}{query}", job, cancel)
        except KeyboardInterrupt:
            with suppress(Exception):
                self._withdraw(job or self._http.ask("POST", path, content, key, MAX_BYTES).job)
            raise
        return replace(answer, job=job)

    def _waited(self, path: str, job: str, cancel: CancelToken | None) -> Answer:
        """The answer of some work, or that it is not there yet."""
        wait = {"Prefer": f"wait={WAIT}"}
        if cancel is None:
            return self._persistent("GET", path, None, wait)
        with ThreadPoolExecutor(1) as thread:
            answer = thread.submit(self._persistent, "GET", path, None, wait)
            try:
                while not cancel.cancelled:
                    with suppress(NotYet):
                        return answer.result(LOOK)
            finally:
                if not answer.done():  # cancelled, or interrupted
                    self._withdraw(job)
            return answer.result()

    def _withdraw(self, job: str) -> None:
        """Cancel some work; what has ended stays, as long as the server keeps it."""
        with suppress(ServerRefused):
            self._persistent("DELETE", f"/plans/{job}?finished=keep", None, {})

    def _persistent(self, method: str, path: str, content: bytes | None, headers: Mapping[str, str]) -> Answer:
        most = MAX_ROADMAP if path.startswith("/roadmaps/") else MAX_BYTES
        return self._until_answered(lambda: self._http.ask(method, path, content, headers, most))

    def _until_answered(self, ask: Callable[[], Answer]) -> Answer:
        """The answer to a request that is sent until there is one, or patience ends."""
        end, tries = time.monotonic() + self._patience, 0
        while True:
            pause = PAUSES[min(tries, len(PAUSES) - 1)]
            try:
                answer = ask()
            except Lost as error:
                trouble = str(error)
            else:
                if answer.status < 400:
                    return answer
                refusal = self._error(answer)
                if not isinstance(refusal, ServerUnavailable):
                    raise refusal
                trouble, pause = str(refusal), max(pause, answer.retry_after)
            if time.monotonic() + pause > end:
                raise ServerUnavailable(self.url, trouble.removeprefix(f"{self.url}: "))
            time.sleep(pause)
            tries += 1

    def _error(self, answer: Answer) -> PlannerServiceError:
        if answer.is_problem:
            with suppress(InvalidFile):
                return error_of(answer.document(), self.url)
        detail = f"answered {answer.status}, and not as a planning service does"
        gone = answer.status in (500, 502, 503, 504)  # as servers say that end, and proxies of servers that are gone
        return ServerUnavailable(self.url, detail) if gone else ServerRefused(self.url, "", detail)


def _text(body: Any) -> bytes:
    try:
        return json.dumps(body, allow_nan=False, default=of_numpy).encode("ascii")
    except ValueError:
        raise InvalidRequest("request", "a number that is not finite", "finite numbers") from None
