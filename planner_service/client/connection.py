"""Requests to a server: sent again where a connection is lost, withdrawn where the caller cancels."""

from __future__ import annotations

import json
import math
import time
import uuid
import weakref
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from planner_service.client.problems import ServerRefused, ServerUnavailable, error_of
from planner_service.collision import CancelToken
from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency, PlannerServiceError
from planner_service.files.json_reader import MAX_BYTES, parse_json
from planner_service.files.schema import Record
from planner_service.geometry.validation import number
from planner_service.records.http.replies import VERBS
from planner_service.records.http.sections import read_reply

if TYPE_CHECKING:
    import httpx

__all__ = ["Answer", "Connection"]

R = TypeVar("R", bound=Record)

WAIT = 20
"""Seconds that one request waits for an answer; then it is asked for again."""

SILENCE = 15.0
"""Seconds beyond that after which a connection is taken for lost."""

CONNECT = 5.0

PAUSES = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Seconds before it is tried again, then as long as the last."""

MAX_PAUSE = 60.0

LOOK = 0.005
"""Seconds between looks at a token."""

MAX_ROADMAP = 200_000_000


@dataclass(frozen=True)
class Answer:
    """What a server answered.

    Attributes:
        url: Where it came from, for messages.
        job: The id of the work that it is the answer of; empty for other requests.
    """

    url: str
    status: int
    headers: Mapping[str, str]
    data: bytes
    job: str = ""

    def document(self) -> dict[str, Any]:
        """The JSON object that it is.

        Raises:
            InvalidFile: it is none.
        """
        document = parse_json(Path(self.url), self.data)
        if not isinstance(document, dict):
            raise InvalidFile(self.url, ["expected an object"])
        return document

    def read(self, model: type[R]) -> R:
        """The answer that it is.

        Raises:
            InvalidFile: it is something else.
        """
        return read_reply(model, self.document(), self.url)


class Connection:
    """One server. Several threads may use it at the same time.

    Args:
        url: Such as ``http://127.0.0.1:8080``.
        token: What the server wants to see; None if it wants nothing.
        patience: Seconds for which a request is sent again while the server cannot be reached or has no room.

    Raises:
        InvalidRequest: the address is none of a server, or a value is out of range.
        MissingDependency: the extra ``client`` is not installed.
    """

    def __init__(self, url: str, token: str | None, patience: float) -> None:
        try:
            import httpx
        except ImportError:
            raise MissingDependency("httpx", "client") from None
        self._lost: type[Exception] = httpx.TransportError
        self.url, self._patience = _address(url), number("patience", patience, "seconds, at least 0", 0.0, math.inf)
        headers = {"Accept-Encoding": "identity"}  # what is read is as large as what was sent
        if token is not None:
            if not isinstance(token, str) or not token.isascii() or not token.isprintable() or " " in token:
                raise InvalidRequest("token", "a text that is no token", "printable ASCII without spaces, or None")
            headers["Authorization"] = f"Bearer {token}"
        self._client: httpx.Client = httpx.Client(
            base_url=self.url,
            headers=headers,
            timeout=httpx.Timeout(WAIT + SILENCE, connect=CONNECT),
            limits=httpx.Limits(max_connections=None),
            trust_env=False,  # no proxy sees the token
        )
        self._finish = weakref.finalize(self, self._client.close)

    def close(self) -> None:
        """Close its connections."""
        self._finish()

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
        query = "?robot=hash" if VERBS[kind].is_file else ""  # the client has the robot already
        path, content, key = f"/{kind}{query}", _text(body), {"Idempotency-Key": uuid.uuid4().hex}
        wait = {"Prefer": f"wait={WAIT}"} if cancel is None else {}
        job = ""
        try:
            answer = self._persistent("POST", path, content, key | wait)
            job = _job(answer)
            while answer.status == 202:
                answer = self._waited(f"/plans/{job}{query}", job, cancel)
        except KeyboardInterrupt:
            with suppress(Exception):
                self._withdraw(job or _job(self._once("POST", path, content, key)))
            raise
        return Answer(answer.url, answer.status, answer.headers, answer.data, job)

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
        """The answer to a request that is sent until there is one, or patience ends."""
        end, tries = time.monotonic() + self._patience, 0
        while True:
            pause = PAUSES[min(tries, len(PAUSES) - 1)]
            try:
                answer = self._once(method, path, content, headers)
            except self._lost as error:
                trouble = f"{type(error).__name__}: {error}"
            else:
                if answer.status < 400:
                    return answer
                refusal = self._error(answer)
                if not isinstance(refusal, ServerUnavailable):
                    raise refusal
                trouble, pause = str(refusal), max(pause, _seconds(answer.headers.get("retry-after", "")))
            if time.monotonic() + pause > end:
                raise ServerUnavailable(self.url, trouble.removeprefix(f"{self.url}: "))
            time.sleep(pause)
            tries += 1

    def _once(self, method: str, path: str, content: bytes | None, headers: Mapping[str, str]) -> Answer:
        typed = {"Content-Type": "application/json"} if content is not None else {}
        most = MAX_ROADMAP if path.startswith("/roadmaps/") else MAX_BYTES
        with self._client.stream(method, path, content=content, headers={**headers, **typed}) as response:
            data = bytearray()
            for part in response.iter_raw():
                data += part
                if len(data) > most:
                    raise InvalidFile(f"{self.url}{path}", [f"too large: more than {most:,} bytes"])
            return Answer(f"{self.url}{path}", response.status_code, response.headers, bytes(data))

    def _error(self, answer: Answer) -> PlannerServiceError:
        if answer.headers.get("content-type", "").startswith("application/problem+json"):
            with suppress(InvalidFile):
                return error_of(answer.document(), self.url)
        detail = f"answered {answer.status}, and not as a planning service does"
        gone = answer.status in (500, 502, 503, 504)  # as servers say that end, and proxies of servers that are gone
        return ServerUnavailable(self.url, detail) if gone else ServerRefused(self.url, "", detail)


def _address(url: Any) -> str:
    import httpx

    expected = "the address of a server, such as http://127.0.0.1:8080"
    try:
        address = httpx.URL(url)
    except (TypeError, httpx.InvalidURL):
        raise InvalidRequest("url", url, expected) from None
    plain = address.path in ("", "/") and not address.query and not address.fragment and not address.userinfo
    if address.scheme not in ("http", "https") or not address.host or not plain:
        raise InvalidRequest("url", url, expected)
    return str(address).rstrip("/")


def _text(body: Any) -> bytes:
    try:
        return json.dumps(body, allow_nan=False, default=_of_numpy).encode("ascii")
    except ValueError:
        raise InvalidRequest("request", "a number that is not finite", "finite numbers") from None


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise InvalidRequest("request", value, "numbers, texts, and lists of them")


def _job(answer: Answer) -> str:
    place = answer.headers.get("location" if answer.status == 202 else "content-location", "")
    return place.rpartition("/")[2]


def _seconds(text: str) -> float:
    """Of a header Retry-After."""
    return min(float(text), MAX_PAUSE) if text.isascii() and text.isdigit() else 0.0
