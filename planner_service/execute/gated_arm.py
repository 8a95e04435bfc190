"""An arm that moves only where that is proven: by plans, and by targets that pass a gate."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.execute.driver import Driver
from planner_service.execute.report import ExecutionReport
from planner_service.execute.settings import Streaming
from planner_service.execute.stream import execute
from planner_service.execute.target_stream import TargetStream
from planner_service.gate.target_filter import FilteredTarget, TargetFilter
from planner_service.gate.verdict import Kind
from planner_service.geometry.arrays import FloatArray
from planner_service.planning.request import PlanRequest
from planner_service.service import PlannerService

__all__ = ["GatedArm"]

PADDINGS = (0.03, 0.01, 0.005)
"""Metres that plans keep from everything: the most that there is room for. An arm leaves its path by 1 to 3 mm."""

SETTLED = 0.3
"""Seconds that an arm is given to come to rest after its last target."""


class GatedArm:
    """An arm between plans, which take it from wherever it stands, and targets, which come one after the other.

    Args:
        driver: The arm's. Targets are sent by its ``go(q, seconds)`` if it has one and its lag is zero, else by a
            ``TargetStream``.
        targets: The filter, and the service that plans.
        streaming: How plans are executed.
        clock: Seconds, never less than before.
        wait: Waits so many seconds.

    Attributes:
        lost: Why nothing may be sent any more: the arm was not where its driver should have it; empty if it was.
    """

    def __init__(
        self,
        driver: Driver,
        targets: TargetFilter,
        streaming: Streaming | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self.driver, self.targets, self.streaming = driver, targets, streaming
        self.lost = ""
        self._clock, self._wait = clock, wait
        self._direct: Callable[[FloatArray, float], None] | None = None
        if not np.any(driver.lag):
            self._direct = getattr(driver, "go", None)
        self._stream: TargetStream | None = None
        self._sent: FilteredTarget | None = None
        self._sent_at = 0.0

    @property
    def service(self) -> PlannerService:
        """What plans."""
        return self.targets.gate.service

    def send(self, wanted: ArrayLike) -> FilteredTarget:
        """Send what passes of a target that is wanted now, (n,), and say what it was.

        What was decided too late is not sent, and the arm goes on to the last target that was: its verdict is refused
        as ``Kind.LATE``. Once tracking is lost the arm stays where it is, and ``lost`` says why.

        Raises:
            InvalidRequest: not n numbers.
            Exception: what the driver raises.
        """
        measured, now = self.driver.positions(), self._clock()
        elapsed = None if self._sent is None else now - self._sent_at
        sent = self.targets.next(measured, wanted, elapsed=elapsed)
        if self._clock() - now > sent.verdict.due:
            return self.targets.late()
        self._go(sent.q)
        self._sent, self._sent_at = sent, now
        refused = sent.verdict.refused
        if refused is not None and refused.kind is Kind.TRACKING:
            self.lost = refused.detail
        return sent

    def halt(self) -> None:
        """Bring the arm to rest: along its proven stop, or where its last target was if that is a while ago."""
        if self._sent is None:
            return
        gate = self.targets.gate
        on_time = self._clock() - self._sent_at <= 1.0 / gate.rate + gate.tracking.jitter
        for row in self._sent.stop if on_time else ():
            self._wait(max(0.0, 1.0 / gate.rate - (self._clock() - self._sent_at)))
            self._sent_at = self._clock()
            self._go(row)
        self._wait(gate.tracking.goal_time + gate.tracking.lag + SETTLED)
        self._end_stream()
        self._sent = None

    def move_to(self, goal: ArrayLike) -> ExecutionReport:
        """Plan from where the arm stands to joint values (n,), and execute that; halts before.

        Raises:
            InvalidRequest: there is no plan, or what ``execute`` refuses; nothing has moved.
            ExecutionStopped: see ``execute``.
        """
        self.halt()
        if self.lost:
            raise InvalidRequest("arm", self.lost, "an arm that follows; see to it and connect again")
        start = self.driver.positions()
        for padding in PADDINGS:
            result = self.service.plan(PlanRequest(start, goal, padding=padding))
            if result.ok:
                break
        else:
            raise InvalidRequest("goal", np.round(np.asarray(goal), 4).tolist(), f"one with a plan: {result.failure}")
        report = execute(result, self.driver, None, self.streaming, service=self.service)
        self.targets.reset(goal)
        return report

    def close(self) -> None:
        """Send nothing any more; the driver is left open."""
        self._end_stream()

    def _go(self, q: FloatArray) -> None:
        seconds = self.targets.gate.tracking.goal_time
        if self._direct is not None:
            self._direct(q, seconds)
            return
        if self._stream is None:
            self._stream = TargetStream(self.driver, clock=self._clock)
        self._stream.go(q, seconds)

    def _end_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()
