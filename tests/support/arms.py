"""An arm that is where it was told to be, a clock that only waits, and short plans for them to execute."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from planner_service import PlannerService, PlanRequest, PlanResult, Robot
from planner_service.execute import ArmLimits, ExecutionReport, ExecutionStopped, Streaming, execute
from planner_service.geometry.arrays import FloatArray

__all__ = ["QUICK", "STEP", "FakeArm", "FakeTime", "back", "raising", "robot", "service", "stopped", "there"]

QUICK = Streaming(settle=0.02, gripper_time=0.1)
STEP = np.array([0.04, -0.02, 0.03, 0.02, 0.01, -0.04])


@cache
def service() -> PlannerService:
    """The arm in an empty scene."""
    return PlannerService("wxai", "empty")


def robot() -> Robot:
    """The arm."""
    return service().robot


@cache
def there(steps: float = 1.0) -> PlanResult:
    """A quarter of a second from home, or farther."""
    return service().plan(PlanRequest(robot().home, robot().home + steps * STEP))


@cache
def back() -> PlanResult:
    """The way home."""
    return service().plan(PlanRequest(robot().home + STEP, robot().home))


def stopped(result: Any, arm: Any, how: Streaming = QUICK, *, allow_unproven: bool = False) -> ExecutionReport:
    """What is reported of an execution that does not come to its end."""
    try:
        execute(result, arm, robot(), how, allow_unproven=allow_unproven)
    except ExecutionStopped as stop:
        return stop.report
    raise AssertionError("it was not stopped")


@dataclass
class FakeArm:
    """Stands where its last command was, ``off`` from it; what it is told is written down.

    Attributes:
        trouble: Called before each command with its number; what it raises, the driver raises.
        seen: Called in place of telling where it is, once it is set.
        refusals: How often it refuses to hold.
        width: Of its gripper, which closes as far as a stone of width ``stone`` allows.
    """

    q: FloatArray
    simulated: bool = True
    lag: FloatArray = field(default_factory=lambda: np.zeros(6))
    off: FloatArray = field(default_factory=lambda: np.zeros(6))
    velocity: float = 10.0
    reach: float = 4.0
    trouble: Callable[[int], None] = lambda k: None
    seen: Callable[[], FloatArray] | None = None
    refusals: int = 0
    told: list[tuple[FloatArray, FloatArray, FloatArray]] = field(default_factory=list)
    held: list[FloatArray] = field(default_factory=list)
    widths: list[float] = field(default_factory=list)
    width: float = 0.08
    stone: float = 0.0
    closed: bool = False

    def limits(self) -> ArmLimits:
        each = np.ones(len(self.q))
        return ArmLimits(-self.reach * each, self.reach * each, self.velocity * each)

    def positions(self) -> FloatArray:
        return self.q + self.off if self.seen is None else self.seen()

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        self.trouble(len(self.told))
        self.q = np.array(q)
        self.told.append((self.q, np.array(qd), np.array(qdd)))

    def hold(self, q: ArrayLike) -> None:
        if self.refusals:
            self.refusals -= 1
            raise OSError("no route to the arm")
        self.held.append(np.array(q))

    def gripper_width(self) -> float:
        return self.width

    def move_gripper(self, width: float, seconds: float) -> None:
        self.widths.append(width)
        self.width = max(width, self.stone)

    def close(self) -> None:
        self.closed = True


def raising(at: int, error: BaseException | type[BaseException]) -> Callable[[int], None]:
    """Trouble at one command."""

    def trouble(step: int) -> None:
        if step == at:
            raise error

    return trouble


@dataclass
class FakeTime:
    """Stands in for the module ``time``: nothing takes time but sleeping, and that takes none of the test's."""

    now: float = 1000.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
