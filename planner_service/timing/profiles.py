"""Motions along a line in closed form: trapezoids, S-curves of seven phases, and both between any two speeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

__all__ = ["Bounds", "Part", "Phase", "TooFast", "chained", "s_curve", "trapezoid"]

CLOSE = 2e-15
"""Relative: about what rounding makes of a speed computed in closed form."""

ALIKE = 1e-9
"""Relative: a speed that much above the highest is taken for it."""


class TooFast(ArithmeticError):
    """A speed from which there is no way to slow down in time."""


class Phase(NamedTuple):
    """A stretch of time with constant jerk: what holds at its start, and how long it lasts (seconds)."""

    duration: float
    position: float
    speed: float
    acceleration: float
    jerk: float


def trapezoid(distance: float, speed: float, acceleration: float) -> tuple[Phase, ...]:
    """The fastest motion over ``distance`` with bounded speed and acceleration: up to three phases.

    The speed bound is reached when ``distance`` is at least speed^2 / acceleration; shorter moves are triangles
    (Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, par. 3.2). All arguments
    are positive.
    """
    reached = distance / speed >= speed / acceleration
    peak = speed if reached else math.sqrt(distance) * math.sqrt(acceleration)
    ramp = peak / acceleration
    cruise = distance / speed - ramp if reached else 0.0
    way = peak * ramp / 2.0
    phases = (
        Phase(ramp, 0.0, 0.0, acceleration, 0.0),
        Phase(cruise, way, peak, 0.0, 0.0),
        Phase(ramp, distance - way, peak, -acceleration, 0.0),
    )
    return tuple(phase for phase in phases if phase.duration > 0.0)


def s_curve(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[Phase, ...]:
    """The fastest motion over ``distance`` with bounded speed, acceleration and jerk: up to seven phases.

    Biagiotti & Melchiorri 2008, par. 3.4; all arguments are positive. With t_j the time a jerk lasts and t_a the time
    to the peak speed, the peaks are jerk t_j of acceleration and jerk t_j (t_a - t_j) of speed.
    """
    t_j, t_a, cruise = _s_curve_times(distance, speed, acceleration, jerk)
    flat = t_a - 2.0 * t_j
    a, v1 = jerk * t_j, jerk * t_j * t_j / 2.0
    v2, v3 = v1 + a * flat, a * (t_a - t_j)
    x1 = v1 * t_j / 3.0
    x2 = x1 + flat * (v1 + v2) / 2.0
    x3 = v3 * t_a / 2.0
    phases = (
        Phase(t_j, 0.0, 0.0, 0.0, jerk),
        Phase(flat, x1, v1, a, 0.0),
        Phase(t_j, x2, v2, a, -jerk),
        Phase(cruise, x3, v3, 0.0, 0.0),
        Phase(t_j, distance - x3, v3, 0.0, -jerk),
        Phase(flat, distance - x2, v2, -a, 0.0),
        Phase(t_j, distance - x1, v1, -a, jerk),
    )
    return tuple(phase for phase in phases if phase.duration > 0.0)


def _s_curve_times(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[float, float, float]:
    """Seconds of one jerk, of the whole speeding up, and of the cruise."""
    if speed / acceleration < acceleration / jerk:  # the speed is reached before the acceleration is
        t_j = math.sqrt(speed / jerk)
        t_a = 2.0 * t_j
    else:
        t_j = acceleration / jerk
        t_a = t_j + speed / acceleration
    cruise = distance / speed - t_a
    if cruise >= 0.0:
        return t_j, max(t_a, 2.0 * t_j), cruise
    t_j = acceleration / jerk
    t_a = (t_j + math.hypot(t_j, 2.0 * math.sqrt(distance / acceleration))) / 2.0
    if t_a >= 2.0 * t_j:
        return t_j, t_a, 0.0
    t_j = math.pow(distance / (2.0 * jerk), 1.0 / 3.0)
    return t_j, 2.0 * t_j, 0.0


class Bounds(NamedTuple):
    """Largest speed, acceleration and jerk along a line; a jerk of ``math.inf`` is none."""

    speed: float
    acceleration: float
    jerk: float


class Part(NamedTuple):
    """Part of a curve between two stops: straight, or a blend, of which the speed bound alone counts."""

    start: float
    length: float
    bounds: Bounds
    blended: bool


def chained(parts: Sequence[Part], entry: float = 0.0) -> list[Phase]:
    """The motion to rest along parts of a curve, each blend at one speed; positions are the curve's own.

    Straight parts speed up as far as their length and bounds allow, cruise, and slow down, with no acceleration where
    they end if jerk is bounded. The speed on each blend is the largest that its own bound, its neighbours' and a
    pass forwards and one backwards over what straight parts can reach leave. A single straight part is a trapezoid or
    an S-curve.

    Args:
        entry: Speed where the first part begins.

    Raises:
        ZeroDivisionError: a blend begins or ends at a stop, where no constant speed will do.
        TooFast: the speed at the start is too high to slow down in time.
    """
    if len(parts) == 1 and not parts[0].blended and entry == 0.0:
        start, length, (speed, acceleration, jerk), _ = parts[0]
        rest = trapezoid(length, speed, acceleration) if jerk == math.inf else s_curve(length, *parts[0].bounds)
        return [phase._replace(position=start + phase.position) for phase in rest]
    speeds = [entry, *_meeting(parts), 0.0]
    for k, part in enumerate(parts):
        speeds[k + 1] = min(speeds[k + 1], _leaving(part, speeds[k]))
    for k, part in reversed(list(enumerate(parts))):
        speeds[k] = min(speeds[k], _leaving(part, speeds[k + 1]))
    fast = speeds[1] if parts[0].blended else speeds[0]
    if fast < entry * (1.0 - ALIKE):
        raise TooFast(f"{entry:.6g} is too fast to slow down in time")
    speeds[0] = entry
    phases: list[Phase] = []
    for part, (entry, leave) in zip(parts, pairwise(speeds), strict=True):
        if part.blended:
            phases.append(Phase(part.length / entry, part.start, entry, 0.0, 0.0))
        else:
            moves = _between(part.length, entry, leave, part.bounds)
            phases.extend(phase._replace(position=part.start + phase.position) for phase in moves)
    return phases


def _meeting(parts: Sequence[Part]) -> list[float]:
    """The largest speed at which each part may meet the next, as their own bounds have it."""
    return [min(before.bounds.speed, after.bounds.speed) for before, after in pairwise(parts)]


def _leaving(part: Part, speed: float) -> float:
    """The largest speed at the other end of a part, whichever way it is passed, with ``speed`` at one."""
    if part.blended:
        return speed
    length, bounds = part.length, part.bounds
    near = math.sqrt(speed * speed + 2.0 * bounds.acceleration * length)
    return _fastest(length, (speed, near, bounds.speed), lambda v: _way(speed, v, bounds))


def _between(distance: float, v0: float, v1: float, bounds: Bounds) -> list[Phase]:
    """Speed up from v0, cruise if there is room, slow down to v1."""
    near = math.sqrt((v0 * v0 + v1 * v1) / 2.0 + bounds.acceleration * distance)
    peak = _fastest(distance, (max(v0, v1), near, bounds.speed), lambda v: _way(v0, v, bounds) + _way(v, v1, bounds))
    up, down = _way(v0, peak, bounds), _way(peak, v1, bounds)
    cruise = max(0.0, distance - up - down)
    phases = [
        *_ramp(0.0, v0, peak, bounds),
        Phase(cruise / peak, up, peak, 0.0, 0.0),
        *_ramp(distance - down, peak, v1, bounds),
    ]
    return [phase for phase in phases if phase.duration > 0.0]


def _fastest(distance: float, speeds: tuple[float, float, float], way: Callable[[float], float]) -> float:
    """The largest speed between two bounds whose ``way``, growing with it, is no longer than ``distance``.

    Args:
        speeds: The lowest, about the one looked for, which it is where jerk is not bounded, and the highest.
    """
    low, near, high = speeds
    high = max(low, high)
    if way(high) <= distance:
        return high
    for guess in (near * (1.0 - CLOSE), near * (1.0 + CLOSE)):
        if low < guess < high:
            low, high = (guess, high) if way(guess) <= distance else (low, guess)
    middle = low + (high - low) / 2.0
    while low < middle < high:  # until no number is left in between: some 5 times if the guess was good, else 55
        low, high = (middle, high) if way(middle) <= distance else (low, middle)
        middle = low + (high - low) / 2.0
    return low


def _way(v0: float, v1: float, bounds: Bounds) -> float:
    """Distance of a ramp between two speeds: its mean speed is the mean of both."""
    jerking, flat = _ramp_times(abs(v1 - v0), bounds)
    return (v0 + v1) / 2.0 * (2.0 * jerking + flat)


def _ramp_times(change: float, bounds: Bounds) -> tuple[float, float]:
    """Seconds for which jerk lasts, twice, and constant acceleration in between (Biagiotti & Melchiorri, par. 3.4)."""
    _, a, j = bounds
    if change / a < a / j:  # the change is over before the acceleration is reached
        return math.sqrt(change / j), 0.0
    return a / j, change / a - a / j


def _ramp(start: float, v0: float, v1: float, bounds: Bounds) -> list[Phase]:
    """From speed v0 to v1, without acceleration at both ends if jerk is bounded."""
    sign = math.copysign(1.0, v1 - v0)
    t_j, flat = _ramp_times(abs(v1 - v0), bounds)
    if t_j == 0.0:
        return [Phase(flat, start, v0, sign * bounds.acceleration, 0.0)]
    j = sign * bounds.jerk
    a, change = j * t_j, j * t_j * t_j / 2.0
    x1 = (v0 + change / 3.0) * t_j
    x2 = x1 + (v0 + change + a * flat / 2.0) * flat
    return [
        Phase(t_j, start, v0, 0.0, j),
        Phase(flat, start + x1, v0 + change, a, 0.0),
        Phase(t_j, start + x2, v1 - change, a, -j),
    ]
