"""An arm that goes straight to its targets as a clock passes, as the vendor's driver has it; nothing waits."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from planner_service.execute import ArmLimits
from planner_service.geometry.arrays import FloatArray

__all__ = ["ASLEEP", "Arm", "Clock"]

ASLEEP = np.zeros(6)


@dataclass
class Clock:
    """Stands in for the module ``time``."""

    now: float = 1000.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@dataclass
class Arm:
    """A WidowX AI, as ``TrossenDriver`` knows it: where it has been is written down.

    Attributes:
        off: By which it is elsewhere than it was told.
        finger: Where its finger is, in m.
    """

    address: str
    clock: Clock
    q: FloatArray
    simulated: bool = True
    off: FloatArray = field(default_factory=lambda: np.zeros(6))
    lag: FloatArray = field(default_factory=lambda: np.zeros(6))
    finger: float = 0.02
    been: list[FloatArray] = field(default_factory=list)
    closed: bool = False
    target: FloatArray | None = None
    began: float = 0.0
    due: float = 1.0

    def limits(self) -> ArmLimits:
        return ArmLimits(np.full(6, -4.0), np.full(6, 4.0), np.full(6, 10.0))

    def positions(self) -> FloatArray:
        share = min((self.clock.now - self.began) / self.due, 1.0)
        return (self.q if self.target is None else self.q + share * (self.target - self.q)) + self.off

    def readings(self) -> dict[str, FloatArray]:
        q = np.append(self.positions(), self.finger)
        return {"positions": q, "velocities": q + 1.0, "efforts": q + 2.0, "external_efforts": q + 3.0}

    def go(self, q: ArrayLike, seconds: float) -> None:
        self.q = self.positions() - self.off
        self.target, self.began, self.due = np.array(q), self.clock.now, seconds
        self.been += [self.q, self.target]

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self.q, self.target = np.array(q), None
        self.been.append(self.q)

    def hold(self, q: ArrayLike) -> None:
        self.command(q, q, q)

    def gripper_width(self) -> float:
        return 2.0 * self.finger

    def move_gripper(self, width: float, seconds: float) -> None:
        self.finger = width / 2.0

    def close(self) -> None:
        self.closed = True
