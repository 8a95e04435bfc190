"""Closed-form motions along a line: trapezoids, seven-phase S-curves, and ramps between any two speeds."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

from planner_service.errors import PlannerServiceError

__all__ = ["Phase", "ScalarLimits", "Section", "TimingFailed", "TooFast", "s_curve", "speed_profile", "trapezoid"]

ROUNDING = 2e-15
"""Relative: about the rounding error of a speed computed in closed form."""

SPEED_TOLERANCE = 1e-9
"""Relative: an entry speed that exceeds the highest possible one by at most this is taken for it."""


CONVERGED = 1e-13
"""Relative: how closely the speeds of jerk-limited ramps are computed; nearly full precision."""


class TimingFailed(PlannerServiceError):
    """A timing law found no solution along a valid path."""


class TooFast(ArithmeticError):
    """The entry speed is too high to slow down in time."""


class Phase(NamedTuple):
    """An interval of time with constant jerk: its duration in seconds, and the motion where it starts."""

    duration: float
    position: float
    speed: float
    acceleration: float
    jerk: float


def trapezoid(distance: float, speed: float, acceleration: float) -> tuple[Phase, ...]:
    """The fastest rest-to-rest motion over ``distance`` with bounded speed and acceleration: up to three phases.

    It reaches the speed bound if ``distance`` is at least speed^2 / acceleration; a shorter move is a triangle
    (Biagiotti & Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008, par. 3.2). All arguments
    are positive.
    """
    reached = distance / speed >= speed / acceleration
    peak = speed if reached else math.sqrt(distance) * math.sqrt(acceleration)
    ramp = peak / acceleration
    cruise = distance / speed - ramp if reached else 0.0
    ramp_distance = peak * ramp / 2.0
    phases = (
        Phase(ramp, 0.0, 0.0, acceleration, 0.0),
        Phase(cruise, ramp_distance, peak, 0.0, 0.0),
        Phase(ramp, distance - ramp_distance, peak, -acceleration, 0.0),
    )
    return tuple(phase for phase in phases if phase.duration > 0.0)


def s_curve(distance: float, speed: float, acceleration: float, jerk: float) -> tuple[Phase, ...]:
    """The fastest rest-to-rest motion over ``distance`` with bounded speed, acceleration and jerk: up to seven phases.

    Biagiotti & Melchiorri 2008, par. 3.4; all arguments are positive. With t_j the duration of one phase of jerk and
    t_a the time to the peak speed, the peak acceleration is jerk t_j and the peak speed jerk t_j (t_a - t_j).
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
    """Seconds of one phase of jerk, of the whole ramp, and of the cruise."""
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


class ScalarLimits(NamedTuple):
    """Bounds of ds/dt and its derivatives along a curve; a jerk of ``math.inf`` is unbounded."""

    speed: float
    acceleration: float
    jerk: float


class Section(NamedTuple):
    """One straight line or one blend of a curve, where it starts in s; on a blend only the speed limit counts."""

    start: float
    length: float
    limits: ScalarLimits
    blended: bool


def speed_profile(sections: Sequence[Section], entry: float = 0.0) -> list[Phase]:
    """The motion along consecutive sections of a curve, to rest at its end, with one constant speed on each blend.

    Each straight section speeds up as far as its length and limits allow, cruises, and slows down; if jerk is bounded
    the acceleration is zero at its ends. The speed on each blend is the largest that its own limit, its neighbours'
    limits, and one pass forwards and one backwards over the reachable speeds leave. A single straight section is a
    trapezoid or an S-curve. Positions are values of s.

    Args:
        entry: ds/dt where the first section starts.

    Raises:
        ZeroDivisionError: a blend starts or ends at a stop, so that it has no constant speed.
        TooFast: the entry speed is too high to slow down in time.
    """
    if len(sections) == 1 and not sections[0].blended and entry == 0.0:
        start, length, limits, _ = sections[0]
        at_rest = trapezoid(length, *limits[:2]) if limits.jerk == math.inf else s_curve(length, *limits)
        return [phase._replace(position=start + phase.position) for phase in at_rest]
    speeds = [entry, *(min(one.limits.speed, two.limits.speed) for one, two in pairwise(sections)), 0.0]
    for k, section in enumerate(sections):
        speeds[k + 1] = min(speeds[k + 1], _reachable_speed(section, speeds[k]))
    for k, section in reversed(list(enumerate(sections))):
        speeds[k] = min(speeds[k], _reachable_speed(section, speeds[k + 1]))
    highest_entry = speeds[1] if sections[0].blended else speeds[0]
    if highest_entry < entry * (1.0 - SPEED_TOLERANCE):
        raise TooFast(f"{entry:.6g} is too fast to slow down in time")
    speeds[0] = entry
    phases: list[Phase] = []
    for section, (v0, v1) in zip(sections, pairwise(speeds), strict=True):
        if section.blended:
            phases.append(Phase(section.length / v0, section.start, v0, 0.0, 0.0))
        else:
            straight = _between(section.length, v0, v1, section.limits)
            phases.extend(phase._replace(position=section.start + phase.position) for phase in straight)
    return phases


def _reachable_speed(section: Section, speed: float) -> float:
    """The largest speed at one end of a section, in either direction, given the speed at the other."""
    if section.blended:
        return speed
    length, limits = section.length, section.limits
    if limits.jerk < math.inf:
        return _largest_smooth_speed(length, (speed,), limits)
    estimate = math.sqrt(speed * speed + 2.0 * limits.acceleration * length)
    return _largest_speed(length, speed, estimate, limits.speed, lambda v: _ramp_distance(speed, v, limits))


def _between(distance: float, v0: float, v1: float, limits: ScalarLimits) -> list[Phase]:
    """Speed up from v0, cruise if there is room, slow down to v1."""

    def ramps(peak: float) -> float:
        return _ramp_distance(v0, peak, limits) + _ramp_distance(peak, v1, limits)

    if limits.jerk < math.inf:
        peak = _largest_smooth_speed(distance, (v0, v1), limits)
    else:
        estimate = math.sqrt((v0 * v0 + v1 * v1) / 2.0 + limits.acceleration * distance)
        peak = _largest_speed(distance, max(v0, v1), estimate, limits.speed, ramps)
    up, down = _ramp_distance(v0, peak, limits), _ramp_distance(peak, v1, limits)
    cruise = distance - up - down
    if cruise < (0.0 if limits.jerk == math.inf else 4.0 * CONVERGED * distance):
        cruise = 0.0
    phases = [
        *_ramp(0.0, v0, peak, limits),
        Phase(cruise / peak, up, peak, 0.0, 0.0),
        *_ramp(distance - down, peak, v1, limits),
    ]
    return [phase for phase in phases if phase.duration > 0.0]


def _largest_speed(
    distance: float, low: float, estimate: float, high: float, ramp_distance: Callable[[float], float]
) -> float:
    """The largest speed from ``low`` to ``high`` whose ramps, longer at higher speeds, fit into ``distance``.

    Args:
        estimate: A guess at the result, right to within rounding.
    """
    high = max(low, high)
    if ramp_distance(high) <= distance:
        return high
    for guess in (estimate * (1.0 - ROUNDING), estimate * (1.0 + ROUNDING)):
        if low < guess < high:
            low, high = (guess, high) if ramp_distance(guess) <= distance else (low, guess)
    middle = low + (high - low) / 2.0
    while low < middle < high:  # until no number is left in between: about 5 times
        low, high = (middle, high) if ramp_distance(middle) <= distance else (low, middle)
        middle = low + (high - low) / 2.0
    return low


def _largest_smooth_speed(distance: float, ends: Sequence[float], limits: ScalarLimits) -> float:
    """The largest speed whose jerk-limited ramps to the speeds ``ends`` fit into ``distance``, to within ``CONVERGED``.

    Newton's method, kept in a bracket and led a little beyond the root, so that both ends of the bracket come near.
    """
    low = max(ends)
    high = max(low, limits.speed)

    def ramps(v: float) -> tuple[float, float]:
        """Their length, and how it changes with v."""
        length = slope = 0.0
        for end in ends:
            t_j, flat = _ramp_times(abs(v - end), limits)
            length += (v + end) / 2.0 * (2.0 * t_j + flat)
            growth = 1.0 / limits.acceleration if flat > 0.0 or t_j == 0.0 else 1.0 / (limits.jerk * t_j)
            slope += (2.0 * t_j + flat + (v + end) * growth) / 2.0
        return length, slope

    if ramps(high)[0] <= distance:
        return high
    v = low + (high - low) / 2.0
    while low < v < high and high - low > CONVERGED * high:
        length, slope = ramps(v)
        low, high = (v, high) if length <= distance else (low, v)
        guess = v + (distance - length) / slope + math.copysign(CONVERGED / 4.0 * v, distance - length)
        v = guess if low < guess < high else low + (high - low) / 2.0
    return low


def _ramp_distance(v0: float, v1: float, limits: ScalarLimits) -> float:
    """The length of a ramp between two speeds: its mean speed is the mean of both."""
    t_j, flat = _ramp_times(abs(v1 - v0), limits)
    return (v0 + v1) / 2.0 * (2.0 * t_j + flat)


def _ramp_times(change: float, limits: ScalarLimits) -> tuple[float, float]:
    """Seconds of each of the two phases of jerk, and of the constant acceleration between them.

    Biagiotti & Melchiorri, par. 3.4.
    """
    _, a, j = limits
    if change / a < a / j:  # the change is over before the acceleration is reached
        return math.sqrt(change / j), 0.0
    return a / j, change / a - a / j


def _ramp(start: float, v0: float, v1: float, limits: ScalarLimits) -> list[Phase]:
    """From speed v0 to v1; if jerk is bounded, without acceleration at both ends."""
    sign = math.copysign(1.0, v1 - v0)
    t_j, flat = _ramp_times(abs(v1 - v0), limits)
    if t_j == 0.0:
        return [Phase(flat, start, v0, sign * limits.acceleration, 0.0)]
    j = sign * limits.jerk
    a, change = j * t_j, j * t_j * t_j / 2.0
    x1 = (v0 + change / 3.0) * t_j
    x2 = x1 + (v0 + change + a * flat / 2.0) * flat
    return [
        Phase(t_j, start, v0, 0.0, j),
        Phase(flat, start + x1, v0 + change, a, 0.0),
        Phase(t_j, start + x2, v1 - change, a, -j),
    ]
