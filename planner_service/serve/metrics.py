"""What Prometheus reads: requests, the queue, the times of stages, checks, and failures by reason."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest

from planner_service.serve.work import Answer

__all__ = ["Metrics"]

SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0)


MAX_UNCOUNTED = 20
"""Requests that have ended since the figures were last brought up to date."""


class Metrics:
    """The figures of one server.

    Args:
        waiting, running: How many requests wait, and how many workers are at one.
    """

    def __init__(self, waiting: Callable[[], int], running: Callable[[], int]) -> None:
        self.registry = CollectorRegistry()
        name = "planner_service"
        gauges = (("queue_length", "Requests that wait", waiting), ("running", "Requests under way", running))
        for suffix, text, value in gauges:
            Gauge(f"{name}_{suffix}", text, registry=self.registry).set_function(value)
        self.accepted = Counter(f"{name}_accepted", "Accepted requests", ["kind"], registry=self.registry)
        self.refused = Counter(f"{name}_refused", "Requests refused as the queue was full", registry=self.registry)
        self.retried = Counter(f"{name}_retried", "Requests tried again by another worker", registry=self.registry)
        self._uncounted: deque[tuple[str, float, Answer]] = deque()
        self._ended = Counter(f"{name}_ended", "Ended requests", ["kind", "reason"], registry=self.registry)
        self._checks = Counter(f"{name}_checks", "Collision checks", ["what"], registry=self.registry)
        self._seconds = Histogram(
            f"{name}_request_seconds",
            "From acceptance to the answer",
            ["kind"],
            buckets=SECONDS,
            registry=self.registry,
        )
        self._stages = Histogram(
            f"{name}_stage_seconds", "Of each stage", ["stage"], buckets=SECONDS, registry=self.registry
        )

    def ended(self, kind: str, seconds: float, answer: Answer) -> None:
        """Count a request that has its answer; when the figures are asked for, as its client waits now."""
        self._uncounted.append((kind, seconds, replace(answer, content=b"", roadmap=None)))
        if len(self._uncounted) > MAX_UNCOUNTED:
            self._count()

    def _count(self) -> None:
        with suppress(IndexError):
            while True:
                self._count_one(*self._uncounted.popleft())

    def _count_one(self, kind: str, seconds: float, answer: Answer) -> None:
        self._ended.labels(kind, answer.reason or "OK").inc()
        self._seconds.labels(kind).observe(seconds)
        for what in ("states", "edges", "distances"):
            self._checks.labels(what).inc(getattr(answer.counts, what))
        for stage in answer.stages:
            self._stages.labels(stage["stage"]).observe(stage["seconds"])

    def exposition(self) -> tuple[bytes, str]:
        """The figures now, and their content type."""
        self._count()
        return generate_latest(self.registry), CONTENT_TYPE_LATEST
