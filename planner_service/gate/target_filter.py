"""One target in, one target out: what a leader arm or a policy wants, and what is sent to the arm instead.

Close targets pass the gate or are braked before. A target that is far from an arm at rest, such as the first one of a
leader that stands elsewhere, is reached on a plan, whose targets pass the gate like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.gate.action_gate import ActionGate
from planner_service.gate.verdict import Verdict
from planner_service.gate.way_round import ways_round
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import instance, number, numbers

__all__ = ["FilteredTarget", "TargetFilter"]

STILL = 1e-3
"""Radians (or metres) that the target sent changes by at most while the arm comes to rest."""


@dataclass(frozen=True, eq=False)
class FilteredTarget:
    """What to send.

    Attributes:
        q: The target, (n,).
        verdict: Of the gate.
        planned: Whether it is one of a plan to what is wanted, and not what is wanted itself.
    """

    q: FloatArray
    verdict: Verdict
    planned: bool

    @property
    def stop(self) -> FloatArray:
        """What brings the arm to rest after it, (m, n), to be sent if nothing else is wanted."""
        return self.verdict.rows[1:]


class TargetFilter:
    """Turns each wanted target into the one to send.

    Args:
        gate: Called by nobody else. With ``slow``, targets that are too fast are followed as fast as allowed.
        jump: Radians (or metres), in [0.01, 10]: a target farther from an arm at rest is reached on a plan.
        speed: Part of the robot's velocity and acceleration limits that plans use, in (0, 1].
    """

    def __init__(self, gate: ActionGate, *, jump: float = 0.2, speed: float = 0.5) -> None:
        self.gate = instance("gate", gate, ActionGate, "an ActionGate")
        self.jump = number("jump", jump, "radians (or metres) in [0.01, 10]", 0.01, 10.0)
        self.speed = number("speed", speed, "a part of the limits in (0, 1]", 1e-3, 1.0)
        self._still = math.ceil(gate.tracking.goal_time * gate.rate) + 1
        self.reset()

    def reset(self, target: ArrayLike | None = None) -> None:
        """Begin anew with an arm at rest, after others have moved it; ``target`` as in ``ActionGate.reset``."""
        self.gate.reset(target)
        self._way: list[FloatArray] = []  # what is left of a plan
        self._last = None if target is None else np.array(target)  # the target that was sent last
        self._rested = self._still  # targets in a row that were the same
        self._no_way: FloatArray | None = None  # what was wanted when there was no plan
        self._former = self._way, self._last, self._rested  # before the last target
        self._measured: FloatArray | None = None

    @property
    def at_rest(self) -> bool:
        """Whether the arm has come to rest where it was sent last."""
        return self._rested >= self._still

    def next(self, q: ArrayLike, wanted: ArrayLike, *, elapsed: float | None = None) -> FilteredTarget:
        """The target to send now.

        Args:
            q: Measured, (n,).
            wanted: Shape (n,). What is beyond a limit is wanted at the limit.
            elapsed: Seconds since the last one was sent; a period if None.

        Raises:
            InvalidRequest: not n numbers each.
        """
        n, expected = self.gate.robot.n, f"{self.gate.robot.n} joint values"
        measured, target = numbers("q", q, expected), numbers("wanted", wanted, expected)
        for name, values in (("q", measured), ("wanted", target)):
            if values.shape != (n,):
                raise InvalidRequest(name, values.shape, expected)
        target = np.clip(target, *self.gate.robot.bounds)
        if not self._way and self.at_rest:
            self._way = self._planned(measured, target)
        planned, way = bool(self._way), self._way
        verdict = self.gate.check(measured, way[0] if planned else target, elapsed=elapsed)
        self._former, self._measured = (way, self._last, self._rested), measured
        self._way = way[1:] if verdict.accepted else []
        row = verdict.rows[0]
        still = self._last is not None and float(np.abs(row - self._last).max()) <= STILL
        self._rested = self._rested + 1 if still else 0
        self._last = row
        return FilteredTarget(row, verdict, planned)

    def late(self) -> FilteredTarget:
        """Take the last target back, which was not sent in time: the arm goes on to the one before, and rests there.

        So it is after a plan, which takes longer than that: what it begins with is sent next time.

        Returns:
            The target before, where the arm comes to rest, or where it was measured if nothing was sent yet.

        Raises:
            InvalidRequest: as of ``ActionGate.late``.
        """
        verdict = self.gate.late()
        self._way, self._last, self._rested = self._former
        held = self._measured if self._last is None else self._last
        assert held is not None  # by the first target
        return FilteredTarget(held, verdict, False)

    def _planned(self, q: FloatArray, wanted: FloatArray) -> list[FloatArray]:
        """The targets of a plan to what is wanted; none if it is near, or there is no plan."""
        start = q if self._last is None else self._last
        near = [start] if self._no_way is None else [start, self._no_way]
        if not np.isfinite([start, wanted]).all() or min(np.abs(wanted - each).max() for each in near) <= self.jump:
            return []
        gate = self.gate
        ways = ways_round(gate.service, start, wanted, gate.rate, speed=self.speed, acceleration=self.speed)
        way = next(ways, None)
        self._no_way = wanted if way is None else None
        return [] if way is None else list(way)
