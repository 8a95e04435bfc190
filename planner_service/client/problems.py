"""Problem details (RFC 9457) as the errors that the library raises for the same mistakes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from planner_service.collision.budget import Cancelled
from planner_service.errors import InvalidRequest, NotProven, PlannerServiceError, UnknownName
from planner_service.files.schema import as_text

__all__ = ["ServerRefused", "ServerUnavailable", "StaleVersion", "error_of"]


class ServerUnavailable(PlannerServiceError, ConnectionError):
    """A server that cannot be reached, or has had no room for a request for as long as the client would wait.

    Attributes:
        url: The server's.
    """

    def __init__(self, url: str, detail: str) -> None:
        super().__init__(f"{url}: {detail}")
        self.url = url


class ServerRefused(PlannerServiceError):
    """A server that refused a request for a reason that the library does not have: no token, no such address.

    Attributes:
        url: The server's.
        kind: The last part of the problem's type, such as ``unauthorized``.
    """

    def __init__(self, url: str, kind: str, detail: str) -> None:
        super().__init__(f"{url}: {detail}")
        self.url, self.kind = url, kind


class StaleVersion(ServerRefused):
    """A scene on a server that is not as the caller takes it to be."""


def error_of(problem: Mapping[str, Any], url: str) -> PlannerServiceError:
    """The error that a problem document describes; always one of this package, whatever the server says."""
    kind = _text(problem.get("type")).rpartition(":")[2]
    detail = _text(problem.get("detail")) or _text(problem.get("title")) or "refused without a reason"
    if kind == "unknown-name":
        return UnknownName(_text(problem.get("kind")), _text(problem.get("name")), _texts(problem.get("available")))
    if kind == "not-proven":
        return NotProven(*(_texts(problem.get("problems")) or [detail]))
    if kind in ("invalid-request", "malformed"):
        field, expected = _text(problem.get("field")) or "request", _text(problem.get("expected"))
        return InvalidRequest(field, problem.get("value"), expected, message=detail)
    if kind in ("queue-full", "unavailable"):
        return ServerUnavailable(url, detail)
    if kind == "cancelled":
        return Cancelled(detail)
    return (StaleVersion if kind == "changed" else ServerRefused)(url, kind, detail)


def _text(value: Any) -> str:
    return as_text(value) if isinstance(value, str) else ""


def _texts(value: Any) -> list[str]:
    return [_text(entry) for entry in value] if isinstance(value, list) else []
