"""The verdict on one straight edge: proven free, proven to collide, or neither.

The same bounds as a certificate's, but only a verdict is wanted: a stretch is closed as soon as its bound suffices. The
middle of the edge is looked at first, for a bound there counts in both directions and most pairs are far; then the
ends, then the middle of what is left open.

Two pieces overlap, and by more than rounding can do, where a tetrahedron of points of their difference has the origin
inside, farther from its faces than any of its corners can be wrong; or where a point of the difference is nearer to the
origin than the balls are large (Gilbert, Johnson & Keerthi, IEEE J. Robotics and Automation 4(2), 1988).

The proof is compiled (native/edge.cpp); this has its numbers and its answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

__all__ = ["CERTAIN", "MAX_EDGE_BOUNDS", "OVERLAP_STEPS", "EdgeProof", "EdgeVerdict", "Judged"]

MAX_EDGE_BOUNDS = 4096
"""Bounds after which an edge is undecided; ordinary ones take about forty."""

OVERLAP_STEPS = 60
"""Of one walk towards an overlap; a box against a box needs about six."""

CERTAIN = 1e-9
"""Metres: far above what rounding does to a point of the difference (1e-15) or to its distance from a face (1e-10)."""


class EdgeVerdict(Enum):
    """What is proven of an edge."""

    FREE = 0
    """Every judged pair stays apart all along it."""
    COLLIDING = 1
    """Somewhere on it a judged pair is too near."""
    UNDECIDED = 2
    """Neither is proven: it comes as near as the margin."""


@dataclass(frozen=True)
class EdgeProof:
    """What is proven of a straight edge.

    Attributes:
        verdict: FREE: every judged pair is farther apart than the padding all along. COLLIDING: a pair is nearer than
            the padding, overlapping if that is 0, at some place. UNDECIDED: neither is proven.
        s: Where, in path length from the first end: a place of that collision, or one that could not be decided.
        a: One of the pair, by name; empty if free.
        b: The other; empty if free.
    """

    verdict: EdgeVerdict
    s: float = 0.0
    a: str = ""
    b: str = ""

    @property
    def free(self) -> bool:
        """Whether the whole edge is proven free."""
        return self.verdict is EdgeVerdict.FREE

    @property
    def colliding(self) -> bool:
        """Whether a collision is proven."""
        return self.verdict is EdgeVerdict.COLLIDING


class Judged(NamedTuple):
    """A verdict, None if the ends are no configurations; the number of a pair (-1 if there is none), and where."""

    verdict: EdgeVerdict | None
    pair: int = -1
    s: float = 0.0
