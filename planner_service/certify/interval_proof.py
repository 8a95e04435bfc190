"""The bisection behind a certificate: which pairs are proven apart on which stretches of a curve.

Clearance bounds at both ends of a stretch and a bound of the motion in between prove a pair apart on all of it: on the
way the gap shrinks by no more than the two move (Schwarzer, Saha & Latombe, IEEE T-RO 21(3), 2005). So do bounds along
one direction at both ends, less what the two leave straight lines on the way, which shrinks with the square of the
stretch: the better of both counts. What is not proven is cut in half. All pairs share one tree over the whole curve, so
that a configuration is placed once, and each pair goes only as deep as it has to. A pair with a bundle of pieces gives
way to those with what is in it once the bundle is larger than the motion.

Of one straight edge only a verdict is wanted: proven free, proven to collide, or neither. A stretch is closed as soon
as its bound suffices. The middle of the edge is looked at first, for a bound there counts in both directions and most
pairs are far; then the ends, then the middle of what is left open. Two pieces overlap, and by more than rounding can
do, where a tetrahedron of points of their difference has the origin inside, farther from its faces than any of its
corners can be wrong; or where a point of the difference is nearer to the origin than the balls are large (Gilbert,
Johnson & Keerthi, IEEE J. Robotics and Automation 4(2), 1988).

Both are compiled (native/tree.cpp, native/edge.cpp); this has their numbers and their words.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = [
    "CERTAIN",
    "MAX_BOUNDS",
    "MAX_EDGE_BOUNDS",
    "NO_LEAVES",
    "OVERLAP_STEPS",
    "EdgeProof",
    "EdgeVerdict",
    "Judged",
    "Obstruction",
    "Roots",
    "Span",
    "no_end",
    "too_close",
]


FRACTION = 0.75
"""A stretch stays open while it proves less than this share of the smallest gap at any node so far: 0.5 asks 2 % fewer
bounds on paths among obstacles, and proves a clearance that is a third smaller."""

MAX_BOUNDS = 300_000
"""A curve that needs more, and ten for each pair, is as good as touching; ordinary ones take about two thousand."""

FAR = 0.1
"""Metres: pairs that one bound proves farther apart on a whole curve are not looked at again."""

BATCH = 4096
"""Rows judged between two calls of ``charge``, so that a caller can stop a long proof within some milliseconds."""

NEAR = 0.05
"""Metres: at the ends of a curve, nearer pairs get a tight bound."""

CLOSE = 2.0
"""In between, those do that are nearer than this many times the smallest gap so far. Tight bounds for all open pairs
save one bound in a hundred and take a fifth more time."""

ROUNDS, LAST_ROUNDS = 4, 200
"""Steps of the search for the best direction: usually, and before a pair is refused."""

Span = tuple[float, float]

NO_LEAVES: FloatArray = np.zeros((0, 9))


class Obstruction(NamedTuple):
    """Where a proof ended: the pair, the stretch of s, where on it, and why; ``spent`` if there was no end to it."""

    pair: int
    span: Span
    s: float
    detail: str
    spent: bool = False


class Roots(NamedTuple):
    """What is to be proven: spans of s, and rows (k, 2), each the number of a pair and that of its span."""

    spans: list[Span]
    rows: IntArray


def too_close(s: float, gap: float, enough: float) -> str:
    """The words for a pair of which no more than ``gap`` metres is proven at s."""
    mm = gap * 1e3
    proven = f"a gap of {mm:.4f} mm is proven" if mm > 0.0 else f"they overlap by at most {-mm:.4f} mm"
    if enough <= 0.0:
        return f"at s = {s:.6g} {proven}; less than {-enough * 1e3:.4f} mm is allowed"
    return f"at s = {s:.6g} {proven}; more than {enough * 1e3:.4f} mm is needed"


def no_end(most: int | None) -> str:
    """The words for a proof that did not end within so many bounds, or at a point if None."""
    return "no shorter stretch has numbers of its own" if most is None else f"{most:,} bounds did not suffice"


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
