"""Targets that are replaced before they are due, sent to an arm whose controller takes positions and speeds.

It is what the vendor's driver of a WidowX AI does with targets that are due within 0.2 seconds, for arms whose own
driver does not, and for the simulated one, whose controller needs to be told its lag ahead.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.execute.driver import Driver
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import finite_numbers, number

__all__ = ["TargetStream"]


class TargetStream(AbstractContextManager["TargetStream"]):
    """Moves an arm straight to each target, from where its setpoint is when the target comes.

    From the first target until it is closed, the arm gets ``rate`` commands a second, from a thread of its own: where
    the setpoint is by then and how fast it goes, the driver's ``lag`` ahead. A context manager, which closes it.

    Args:
        driver: Not commanded by anyone else while this is open.
        rate: Commands a second.
        clock: Seconds, never less than before.

    Raises:
        InvalidRequest: a rate outside [10, 1000].
    """

    def __init__(self, driver: Driver, *, rate: float = 250.0, clock: Callable[[], float] = time.perf_counter) -> None:
        self.driver = driver
        self.period = 1.0 / number("rate", rate, "commands a second, in [10, 1000]", 10.0, 1000.0)
        self._clock, self._lag = clock, np.asarray(driver.lag)
        self._changed, self._ended = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self._error: Exception | None = None
        start = np.array(driver.positions())
        self._start, self._target, self._began, self._seconds = start, start, clock(), 1.0

    def go(self, q: ArrayLike, seconds: float) -> None:
        """Go straight to q, shape (n,), to be there after so many seconds, unless another target comes before.

        Raises:
            InvalidRequest: not n finite numbers, seconds outside [0.001, 10], or it is closed.
            Exception: what the driver raised meanwhile; nothing is sent any more.
        """
        target = finite_numbers("q", q, len(self._start))
        seconds = number("seconds", seconds, "seconds in [0.001, 10]", 0.001, 10.0)
        if self._error is not None:
            raise self._error
        if self._ended.is_set():
            raise InvalidRequest("stream", "closed", "one that is open")
        with self._changed:
            now = self._clock()
            self._start, _ = self._at(now)
            self._target, self._began, self._seconds = target, now, seconds
        if self._thread is None:
            self._thread = threading.Thread(target=self._send, name="targets", daemon=True)
            self._thread.start()

    def setpoint(self) -> FloatArray:
        """Where the setpoint is, shape (n,)."""
        with self._changed:
            return self._at(self._clock())[0]

    def close(self) -> None:
        """Send nothing any more; the arm stays where it was commanded last."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _at(self, now: float) -> tuple[FloatArray, FloatArray]:
        """Where the setpoint is, and its velocity."""
        share = (now - self._began) / self._seconds
        if share >= 1.0:
            return self._target, np.zeros_like(self._target)
        way = self._target - self._start
        return self._start + share * way, way / self._seconds

    def _send(self) -> None:
        rest = np.zeros_like(self._target)
        try:
            while not self._ended.wait(self.period):
                with self._changed:
                    q, speed = self._at(self._clock())
                self.driver.command(q + self._lag * speed, speed, rest)
        except Exception as error:  # the next target's caller is told
            self._error = error
