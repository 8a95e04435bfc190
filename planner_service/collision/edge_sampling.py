"""How finely an edge is sampled, and in which order.

An edge is the straight line between two configurations. Its samples split it into equal parts;
the ends come first, then the interior in bisection order (the midpoint, the quarters, ...), which
finds a collision soonest when none is expected anywhere in particular (LaValle, Planning
Algorithms, 5.3.4). Sampling proves nothing between the samples.

The arithmetic is plain float64 sums in joint order, so that the number of samples is the same on
every CPU: no BLAS and no vector norm, whose last bit depends on the instruction set.
"""

from __future__ import annotations

import enum
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Protocol

import numpy as np

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.validation import number

__all__ = [
    "KNOWN_ENDS",
    "EdgeStep",
    "FinestStep",
    "JointStep",
    "Known",
    "MotionStep",
    "SampledEdge",
    "Samples",
    "bisection_order",
    "coarse_samples",
    "coarse_segments_of",
    "interior",
    "judged_ends",
]

MAX_SEGMENTS = 1_000_000
"""More samples than this on one edge is a mistake in the step, not a plan."""

_SLACK = 1e-9
"""Keeps a quotient that is an integer but for rounding from costing one sample more."""

MAX_COARSE_SEGMENTS = 8
"""Segments between two samples of a coarse check. In the tightest of the public seven-joint problems this left a
quarter of the states, and one search in eight had to grow again: an edge of its path was not free after all."""

MAX_COARSE_MOTION, MAX_COARSE_ANGLE = 0.08, 0.16
"""How far apart these samples may be, in metres of a ``MotionStep`` and in radians of a ``JointStep``: with a step of
0.05 rad and eight segments, most paths of edges that were only checked coarsely were not free."""


class Known(enum.Flag):
    """Which ends of an edge are known to be free already, so that they are not judged again."""

    NEITHER = 0
    START = 1
    END = 2
    BOTH = 3


KNOWN_ENDS = (Known.NEITHER, Known.START, Known.END, Known.BOTH)
"""By value, 1 for the start and 2 for the end: arithmetic of flags takes as long as the rest of a question."""


class Samples(enum.Enum):
    """Which samples of an edge are judged; ``Samples`` in kernel.cpp has the same numbers."""

    ALL = 0
    COARSE = 1
    """The ends, and interior samples that are far apart."""
    REST = 2
    """Those that a coarse check leaves out."""


class EdgeStep(Protocol):
    """A rule for the number of equal parts an edge is split into."""

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        """Parts of an edge with joint differences ``dq`` (rad or m) for joints of that ``reach`` (m)."""


def _positive(field: str, value: float, unit: str) -> float:
    return number(field, value, f"a positive number of {unit}", sys.float_info.min, sys.float_info.max)


def _count(extent: float, step: float) -> int:
    parts = extent / step - _SLACK
    if not parts <= MAX_SEGMENTS:
        raise InvalidRequest("edge_step", step, f"a step that splits an edge into at most {MAX_SEGMENTS} parts")
    return max(1, math.ceil(parts))


@dataclass(frozen=True)
class MotionStep:
    """No point of the robot moves farther than ``distance`` metres from one sample to the next.

    ``sum(reach_i * |dq_i|)`` bounds the motion of every point, where ``reach_i`` is the largest
    distance of any robot point from joint axis i (Schwarzer, Saha & Latombe, IEEE T-RO 21(3), 2005).
    """

    distance: float = 0.010

    def __post_init__(self) -> None:
        object.__setattr__(self, "distance", _positive("distance", self.distance, "metres"))

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        """See ``EdgeStep``."""
        motion = 0.0
        for difference, radius in zip(dq, reach, strict=True):
            motion += radius * abs(difference)
        return _count(motion, self.distance)


@dataclass(frozen=True)
class JointStep:
    """Samples at most ``angle`` apart in the L2 norm over all joints: the textbook rule, for comparisons."""

    angle: float = 0.02

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", _positive("angle", self.angle, "radians"))

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        """See ``EdgeStep``."""
        squares = 0.0
        for difference in dq:
            squares += difference * difference
        return _count(math.sqrt(squares), self.angle)


@dataclass(frozen=True)
class FinestStep:
    """As finely as the finest of several rules."""

    rules: tuple[EdgeStep, ...]

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        """See ``EdgeStep``."""
        return max(rule.segments(dq, reach) for rule in self.rules)


def coarse_segments_of(step: EdgeStep) -> int:
    """Segments between two samples of a coarse check of edges with that step."""
    if isinstance(step, FinestStep):
        return max(map(coarse_segments_of, step.rules))
    if isinstance(step, JointStep):
        return max(1, min(MAX_COARSE_SEGMENTS, int(MAX_COARSE_ANGLE / step.angle)))
    if isinstance(step, MotionStep):
        return max(1, min(MAX_COARSE_SEGMENTS, int(MAX_COARSE_MOTION / step.distance)))
    return MAX_COARSE_SEGMENTS


def coarse_samples(segments: int, coarse_segments: int) -> int:
    """How many interior samples a coarse check takes, with about ``coarse_segments`` between two of them.

    They are the first in bisection order, whole levels of it: one in the middle, three, seven, ...; at most all.
    """
    parts = 1
    while parts * coarse_segments < segments:
        parts *= 2
    return min(parts, segments) - 1


@lru_cache(maxsize=1024)
def bisection_order(segments: int) -> FloatArray:
    """Fractions k / segments of the interior samples in bisection order, shape (segments - 1, 1), read-only."""
    order = []
    spans = [(0, segments)]
    while spans:
        below = []
        for low, high in spans:
            middle = (low + high) // 2
            if middle > low:
                order.append(middle)
                below += [(low, middle), (middle, high)]
        spans = below
    fractions = np.array(order, dtype=np.float64).reshape(-1, 1) / segments
    fractions.flags.writeable = False
    return fractions


def interior(q1: Sequence[float], q2: Sequence[float], segments: int) -> FloatArray:
    """The interior samples of an edge in the order in which they are judged, shape (segments - 1, n).

    They are computed from the lexicographically smaller end, so that an edge and its reverse are
    the same samples to the last bit.
    """
    first, last = (q1, q2) if tuple(q1) <= tuple(q2) else (q2, q1)
    start = np.array(first, dtype=np.float64)
    return start + (np.array(last, dtype=np.float64) - start) * bisection_order(segments)


def judged_ends(q1: Sequence[float], q2: Sequence[float], known: Known) -> int:
    """Which ends are judged, as ``SampledEdge`` has it; of two that are equal the second is not."""
    return 3 & ~(known._value_ if q1 != q2 else known._value_ | Known.END._value_)


@dataclass(frozen=True)
class SampledEdge:
    """The edge from a to b as rows of configurations: the ends that are judged, then the interior in bisection order.

    Attributes:
        ends: Which ends are judged: 1 for a, 2 for b, 3 for both.
        segments: Equal parts it is split into.
    """

    a: Sequence[float]
    b: Sequence[float]
    ends: int
    segments: int

    @property
    def end_rows(self) -> int:
        """Rows that are ends; these come first."""
        return (self.ends + 1) // 2

    @property
    def rows(self) -> int:
        """All rows."""
        return self.end_rows + self.segments - 1

    @cached_property
    def samples(self) -> FloatArray:
        """All rows, shape (m, n)."""
        ends = [q for q, bit in ((self.a, 1), (self.b, 2)) if self.ends & bit]
        inside = interior(self.a, self.b, self.segments)
        return np.concatenate([np.array(ends), inside]) if ends else inside

    def fraction(self, row: int) -> float:
        """Where on the edge a row is: 0 at a, 1 at b."""
        if row < self.end_rows:
            return 0.0 if row == 0 and self.ends & 1 else 1.0
        along = float(bisection_order(self.segments)[row - self.end_rows, 0])
        return along if tuple(self.a) <= tuple(self.b) else 1.0 - along
