"""What is wrong with a request, as RFC 9457 has it: a type to tell kinds apart, a sentence, and what would be right."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from planner_service.errors import InvalidFile, InvalidRequest, MissingDependency, NotProven, UnknownName, shown
from planner_service.serve.state.store import StateUnusable

__all__ = ["PROBLEM_JSON", "Problem", "Refused", "problem_of"]

PROBLEM_JSON = "application/problem+json"

SHOWN = 300
"""Characters of a text that was given."""

MAX_NUMBER = 2.0**63

TYPE = "urn:problem-type:planner-service:"

TITLES: Mapping[str, tuple[int, str]] = {
    "malformed": (400, "The body or a header cannot be read"),
    "unauthorized": (401, "The token is missing or wrong"),
    "cross-origin": (403, "Pages of other origins may not use this server"),
    "not-found": (404, "There is no such thing"),
    "method-not-allowed": (405, "The method is not one of this address"),
    "not-acceptable": (406, "There is no such representation"),
    "deadline-passed": (408, "The deadline passed"),
    "in-use": (409, "It is in use, or not finished"),
    "cancelled": (410, "The request was cancelled"),
    "changed": (412, "The scene has changed"),
    "too-large": (413, "The body is too large"),
    "unsupported-media-type": (415, "The body is not JSON"),
    "wrong-host": (421, "This server does not answer for that host"),
    "invalid-request": (422, "The request cannot be carried out"),
    "unknown-name": (422, "A name is unknown"),
    "not-proven": (422, "The plan does not hold"),
    "key-reused": (422, "The idempotency key belongs to another request"),
    "queue-full": (429, "The queue is full"),
    "header-too-large": (431, "The headers are too large"),
    "internal": (500, "The server is at fault"),
    "worker-lost": (503, "The worker was lost"),
    "unavailable": (503, "The server is not ready"),
    "not-kept": (507, "The answer could not be kept"),
}
"""Status and title of each kind of problem."""


@dataclass(frozen=True)
class Problem:
    """One problem.

    Attributes:
        kind: One of ``TITLES``; the last part of its type.
        detail: What is wrong, in a sentence.
        more: Further members: field, value, expected, problems, reason.
    """

    kind: str
    detail: str
    more: Mapping[str, Any] = field(default_factory=dict)

    @property
    def status(self) -> int:
        """The HTTP status."""
        return TITLES[self.kind][0]

    @property
    def content(self) -> bytes:
        """The body of the response."""
        head = {"type": TYPE + self.kind, "title": TITLES[self.kind][1], "status": self.status, "detail": self.detail}
        return json.dumps({**head, **self.more}, allow_nan=False, separators=(",", ":")).encode("ascii")


class Refused(Exception):
    """Ends a request with a problem."""

    def __init__(self, kind: str, detail: str, *, headers: Mapping[str, str] | None = None, **more: Any) -> None:
        super().__init__(detail)
        self.problem = Problem(kind, detail, more)
        self.headers = dict(headers or {})


def problem_of(error: InvalidRequest | MissingDependency) -> Problem:
    """The problem that an error of the library is; its detail is the error's message."""
    if isinstance(error, MissingDependency):
        return Problem("invalid-request", str(error), {"package": error.package, "extra": error.extra})
    if isinstance(error, StateUnusable):
        return Problem("unavailable", "; ".join(error.problems))
    if isinstance(error, InvalidFile):
        lines = list(error.problems)
        kind = "malformed" if any(line.startswith(("malformed", "not UTF-8", "too large")) for line in lines) else ""
        return Problem(kind or "invalid-request", "; ".join(lines[:3]), {"problems": lines})
    if isinstance(error, NotProven):
        return Problem("not-proven", str(error), {"problems": list(error.problems)})
    named = {"field": error.field, "value": _plain(error.value), "expected": error.expected}
    if isinstance(error, UnknownName):
        return Problem(
            "unknown-name",
            str(error),
            {**named, "kind": error.kind, "name": _plain(error.name), "available": list(error.available)},
        )
    return Problem("invalid-request", str(error), named)


def _plain(value: Any) -> Any:
    """A value as JSON has it if it is a short one, else as messages show it."""
    if value is None or isinstance(value, bool) or (isinstance(value, str) and len(value) <= SHOWN):
        return value
    if isinstance(value, int | float) and abs(value) < MAX_NUMBER:  # not NaN either
        return value
    return shown(value)
