"""Runs: stretches of a path, corners blended, along which a jerk-limited law speeds up and slows down as on a line.

A path with many blends has next to no straight pieces left on which to change speed. On a run of sections the joints'
limits become limits of s(t) that hold on all of them, by the largest rates of the curve there:

    abs(q_i') v                               <= velocity limit
    abs(q_i') a + abs(q_i'') v^2              <= acceleration limit
    abs(q_i') j + 3 abs(q_i'') v a + abs(q_i''') v^3  <= jerk limit

On a blend q'' changes as 1 - y^4 and q''' as y^3, for y from -1 to 1 (``path.corner_blend``): not large at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planner_service.geometry.arrays import FloatArray
from planner_service.timing.profiles import Phase, ScalarLimits, Section
from planner_service.timing.segments import PathSegment, Rates, smallest_ratio

__all__ = ["runs_of", "split_at"]

BEND_SPEED = 0.9
"""Share of the constant speed at which a bend alone would use up a limit; the rest is for changing speed. On drawn
paths of two arms 0.8 to 0.95 differ by 2 %."""

JERK_OF_BENDS = 0.75
"""Share of the jerk limits that changing speed may cost by bends alone: with what the speed costs, at most 0.83."""

SLIVER = 1e-11
"""Radians of path that no phase is split off for: by rounding a run ends a little beside the end of its last piece."""

MOST_RUNS = 16
"""More are a few per cent faster, and take longer to compute."""


def runs_of(segment: PathSegment, sections: Sequence[Section]) -> Iterator[list[Section]]:
    """The sections of a segment, jerk limited, joined to 1, 2, 4, ... runs; none if no section is a blend.

    A run is cut in two where that gains the most time at constant speeds.
    """
    if not any(section.blended for section in sections):
        return
    rates, limits = segment.rates, segment.limits
    bends = np.sqrt(smallest_ratio(limits.acceleration, rates.bend))
    twists = [math.pow(cube, 1.0 / 3.0) for cube in smallest_ratio(limits.jerk, rates.twist).tolist()]
    most = BEND_SPEED * np.minimum(bends, twists)
    speeds = np.minimum(most, [section.limits.speed for section in sections])
    lengths = np.array([section.length for section in sections])

    def cut(first: int, end: int) -> tuple[float, int]:
        """The seconds that cutting a run in two gains at constant speeds, and where."""
        if end - first < 2:
            return 0.0, first
        speed, passed = speeds[first:end], np.cumsum(lengths[first:end])
        before, after = np.minimum.accumulate(speed), np.minimum.accumulate(speed[::-1])[::-1]
        gains = passed[-1] / before[-1] - passed[:-1] / before[:-1] - (passed[-1] - passed[:-1]) / after[1:]
        best = int(gains.argmax())
        return float(gains[best]), first + best + 1

    cuts = {(0, len(sections)): cut(0, len(sections))}
    count = 1
    while True:
        if len(cuts) == count:
            yield [
                _run(segment, sections[a:b], Rates(*(rate[a:b] for rate in rates)), speeds[a:b])
                for a, b in sorted(cuts)
            ]
            count *= 2
        (first, end), (gain, middle) = max(cuts.items(), key=lambda item: item[1][0])
        if not gain > 0.0 or len(cuts) == MOST_RUNS:
            return
        del cuts[first, end]
        cuts[first, middle], cuts[middle, end] = cut(first, middle), cut(middle, end)


def _run(segment: PathSegment, sections: Sequence[Section], rates: Rates, speeds: FloatArray) -> Section:
    """Sections as one straight section."""
    limits, (tangent, bend, twist), speed = segment.limits, rates, float(speeds.min())
    left = limits.acceleration - bend * speed * speed
    acceleration = float(smallest_ratio(left, tangent).min())
    bending = 3.0 * speed * bend
    acceleration = min(acceleration, float(smallest_ratio(JERK_OF_BENDS * limits.jerk, bending).min()))
    turning, twisting = bending * acceleration, twist * speed * speed * speed
    # the largest of turning (1 - y^4) + twisting y^3 is at y = 3/4 twisting / turning, or at the end of the blend
    y = np.divide(0.75 * twisting, turning, out=np.ones_like(turning), where=0.75 * twisting < turning)
    spent = np.where(y < 1.0, turning + 0.25 * twisting * (y * y * y), twisting)
    jerk = float(smallest_ratio(limits.jerk - spent, tangent).min())
    length = math.fsum(section.length for section in sections)
    return Section(sections[0].start, length, ScalarLimits(speed, acceleration, jerk), False)


def split_at(phases: Sequence[Phase], places: Sequence[float]) -> list[Phase]:
    """The same motion with phases that end, to within ``SLIVER``, where it passes places, values of s in order."""
    out: list[Phase] = []
    for phase, end in zip(phases, [*(phase.position for phase in phases[1:]), math.inf], strict=True):
        inside = [place for place in places if phase.position + SLIVER < place < end - SLIVER]
        times = [0.0, *(_seconds_to(phase, place - phase.position) for place in inside), phase.duration]
        for (begin, finish), place in zip(pairwise(times), [phase.position, *inside], strict=True):
            if finish > begin:
                speed = phase.speed + begin * (phase.acceleration + begin * phase.jerk / 2.0)
                out.append(Phase(finish - begin, place, speed, phase.acceleration + begin * phase.jerk, phase.jerk))
    return out


def _seconds_to(phase: Phase, distance: float) -> float:
    """When a phase has gone a distance, at the latest when it ends: Newton's method, kept in a bracket."""
    _, _, v, a, j = phase
    low, high = 0.0, phase.duration
    t = high / 2.0
    while low < t < high:
        gone = t * (v + t * (a / 2.0 + t * j / 6.0))
        low, high = (t, high) if gone < distance else (low, t)
        speed = v + t * (a + t * j / 2.0)
        guess = t + (distance - gone) / speed if speed > 0.0 else math.nan
        if guess == t:
            break
        t = guess if low < guess < high else low + (high - low) / 2.0
    return t
