"""Rest-to-rest motions along a line in closed form: trapezoid or triangle, and the S-curve of seven phases."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["Phase", "s_curve", "trapezoid"]


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
