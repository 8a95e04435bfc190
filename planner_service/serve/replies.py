"""What the server's own replies look like; plans and tasks are files of ``records/``."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel

from planner_service.records.scene import AttachedRecord, ObstacleRecord

__all__ = [
    "AcceptedReply",
    "JobReply",
    "JobsReply",
    "ProblemReply",
    "RunsReply",
    "SceneReply",
    "ScenesReply",
    "StoredReply",
]


class AcceptedReply(BaseModel):
    """A request that has no answer yet; ``position`` counts those before it in the queue."""

    id: str
    kind: str
    state: Literal["queued", "running"]
    position: int | None
    links: dict[str, str]


class JobReply(BaseModel):
    """A request in a list."""

    id: str
    kind: str
    state: Literal["queued", "running", "done", "cancelled", "lost"]
    created: float
    ok: bool | None
    reason: str | None


class JobsReply(BaseModel):
    """Requests, newest first; ``next`` is what to ask for as ``after`` to get more."""

    plans: list[JobReply]
    next: str | None


class StoredReply(BaseModel):
    """A scene as it is stored."""

    name: str
    version: int
    hash: str


class ScenesReply(BaseModel):
    """All scenes."""

    scenes: list[StoredReply]


class SceneReply(BaseModel):
    """A scene with all that is in it."""

    name: str
    version: int
    hash: str
    description: str
    obstacles: list[ObstacleRecord]
    attached: list[AttachedRecord]


class RunsReply(BaseModel):
    """That the server runs, or is ready."""

    ok: Literal[True]


class ProblemReply(BaseModel):
    """What is wrong with a request (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    value: Any = None
    expected: str | None = None
    problems: list[str] | None = None
    reason: str | None = None
