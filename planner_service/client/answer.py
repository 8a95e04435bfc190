"""What a server answers, over whichever connection, and what becomes of a request that has no answer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.json_reader import parse_json
from planner_service.files.schema import Record
from planner_service.records.http.replies import VERBS
from planner_service.records.http.sections import read_reply

__all__ = ["CONNECT", "LOOK", "SILENCE", "WAIT", "Answer", "Lost", "Work", "of_numpy", "pause"]

R = TypeVar("R", bound=Record)

WAIT = 20
"""Seconds that one request waits for an answer; then it is asked for again."""

SILENCE = 15.0
"""Seconds beyond that after which a connection is taken for lost."""

CONNECT = 5.0

LOOK = 0.005
"""Seconds between looks at a token."""

MAX_PAUSE = 60
"""Seconds that a server may ask for before it is asked again."""


class Lost(Exception):
    """A connection was lost, or there is none: the request is sent again."""


@dataclass(frozen=True)
class Work:
    """A request for work.

    Attributes:
        key: Sent again with the same one, it is not done again.
    """

    kind: str
    body: Any
    key: str

    @property
    def by_hash(self) -> bool:
        """Whether its answer has its robot's hash in place of the robot, which the client has already."""
        return VERBS[self.kind].is_file


@dataclass(frozen=True)
class Answer:
    """What a server answered.

    Attributes:
        url: Where it came from, for messages.
        content: The bytes of a response, or the value that a frame has.
        is_problem: Whether it says what is wrong with the request.
        retry_after: Seconds after which to ask again, as the server says.
        job: The id of the work that it is the answer of; empty for other requests.
    """

    url: str
    status: int
    content: Any
    is_problem: bool = False
    retry_after: float = 0.0
    job: str = ""

    @property
    def data(self) -> bytes:
        """The bytes of a response."""
        data: bytes = self.content
        return data

    def document(self) -> dict[str, Any]:
        """The JSON object that it is.

        Raises:
            InvalidFile: it is none.
        """
        document = parse_json(Path(self.url), self.content) if isinstance(self.content, bytes) else self.content
        if not isinstance(document, dict):
            raise InvalidFile(self.url, ["expected an object"])
        return document

    def read(self, model: type[R]) -> R:
        """The answer that it is.

        Raises:
            InvalidFile: it is something else.
        """
        return read_reply(model, self.document(), self.url)


def of_numpy(value: Any) -> Any:
    """What stands for a value of NumPy in a request.

    Raises:
        InvalidRequest: It is none of NumPy.
    """
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise InvalidRequest("request", value, "numbers, texts, and lists of them")


def pause(seconds: int) -> float:
    """How long to wait where a server says how long."""
    return float(min(max(seconds, 0), MAX_PAUSE))
