"""The interface of an arm: its position can be read and commanded, and it can be told to hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import numbers

__all__ = ["ArmLimits", "Driver", "DriverGroup"]


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What an arm's controller allows, each of shape (n,), in rad and rad/s (m for a prismatic joint).

    Raises:
        InvalidRequest: not three lists of equally many finite numbers, an upper limit below its lower one, or a
            velocity that is not positive.
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray

    def __post_init__(self) -> None:
        for item in fields(self):
            array = numbers(item.name, getattr(self, item.name), "finite numbers of shape (n,)")
            if array.ndim != 1 or not np.all(np.isfinite(array)) or array.shape != np.shape(self.lower):
                raise InvalidRequest(item.name, array, "finite numbers of shape (n,), as many as the other limits")
            object.__setattr__(self, item.name, array)
        if not np.all(self.lower <= self.upper):
            raise InvalidRequest("upper", self.upper, f"positions from {self.lower} up")
        if not np.all(self.velocity > 0.0):
            raise InvalidRequest("velocity", self.velocity, "positive numbers")


class Driver(Protocol):
    """An arm that takes a command many times a second.

    Every call returns soon or raises; a driver that waits for an answer needs a timeout of its own. While a plan is
    executed calls come from one thread, which is not the caller's, one after the other. The exception is ``hold``: if
    another call has not returned for two seconds it is called from yet another thread.

    Attributes:
        simulated: Whether nothing real moves: then the default is full speed, else a fifth of it.
        lag: Seconds, shape (n,), by which each joint of a moving arm lags its command, at most 1; every command is
            that much ahead of the plan. Zero for a controller that follows velocities, too.
    """

    @property
    def simulated(self) -> bool: ...

    @property
    def lag(self) -> FloatArray: ...

    def limits(self) -> ArmLimits:
        """What the controller allows; beyond its velocities it may fault."""
        ...

    def positions(self) -> FloatArray:
        """Where the joints are, shape (n,); they are copied."""
        ...

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        """Be at q now, moving with qd and qdd, each of shape (n,); does not wait."""
        ...

    def hold(self, q: ArrayLike) -> None:
        """Stand still at q, shape (n,), from now on; does not wait."""
        ...

    def gripper_width(self) -> float:
        """Metres between the finger pads."""
        ...

    def move_gripper(self, width: float, seconds: float) -> None:
        """Have the finger pads ``width`` metres apart within so many seconds; does not wait."""
        ...

    def close(self) -> None:
        """Let go of the connection; the arm stays where it is."""
        ...


class DriverGroup:
    """Arms that move as one: joints in the order of their drivers, and of the grippers the first one's.

    Args:
        drivers: At least one; all simulated, or none.

    Attributes:
        go: ``go(q, seconds)`` of each, for its part of q; None if one of them has none.

    Raises:
        InvalidRequest: none, or some of them simulated.
    """

    def __init__(self, drivers: Sequence[Driver]) -> None:
        self.drivers = tuple(drivers)
        if len({driver.simulated for driver in self.drivers}) != 1:
            raise InvalidRequest("drivers", self.drivers, "at least one, and all of them simulated or none")
        self.lag: FloatArray = np.concatenate([driver.lag for driver in self.drivers])
        self._ends = np.cumsum([len(driver.lag) for driver in self.drivers])[:-1]
        each = [getattr(driver, "go", None) for driver in self.drivers]
        self.go: Callable[[ArrayLike, float], None] | None = self._go if all(each) else None

    @property
    def simulated(self) -> bool:
        """Whether nothing real moves."""
        return self.drivers[0].simulated

    def limits(self) -> ArmLimits:
        """See ``Driver``."""
        limits = [driver.limits() for driver in self.drivers]
        return ArmLimits(*(np.concatenate([getattr(one, item.name) for one in limits]) for item in fields(ArmLimits)))

    def positions(self) -> FloatArray:
        """See ``Driver``."""
        return np.concatenate([driver.positions() for driver in self.drivers])

    def command(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> None:
        """See ``Driver``."""
        for driver, *each in zip(self.drivers, *(self.split(values) for values in (q, qd, qdd)), strict=True):
            driver.command(*each)

    def hold(self, q: ArrayLike) -> None:
        """See ``Driver``; each arm is told, whatever happens to another."""
        with ExitStack() as stack:
            for driver, part in zip(self.drivers, self.split(q), strict=True):
                stack.callback(driver.hold, part)

    def gripper_width(self) -> float:
        """See ``Driver``."""
        return self.drivers[0].gripper_width()

    def move_gripper(self, width: float, seconds: float) -> None:
        """See ``Driver``."""
        self.drivers[0].move_gripper(width, seconds)

    def close(self) -> None:
        """See ``Driver``; each is closed, whatever happens to another."""
        with ExitStack() as stack:
            for driver in self.drivers:
                stack.callback(driver.close)

    def _go(self, q: ArrayLike, seconds: float) -> None:
        for driver, part in zip(self.drivers, self.split(q), strict=True):
            driver.go(part, seconds)  # type: ignore[attr-defined]

    def split(self, values: ArrayLike) -> list[FloatArray]:
        """Values of all joints, for each arm its own."""
        return np.split(np.asarray(values, dtype=np.float64), self._ends)
