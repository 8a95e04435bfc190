"""The bisection behind a certificate: which pairs are proven apart on which stretches of a curve.

Clearance bounds at both ends of a stretch and a bound of the motion in between prove a pair apart on all of it: on the
way the gap shrinks by no more than the two move (Schwarzer, Saha & Latombe, IEEE T-RO 21(3), 2005). What is not proven
is cut in half. All pairs share one tree over the whole curve, so that a configuration is placed once, and each pair
goes only as deep as it has to. A pair with a bundle of pieces gives way to those with what is in it once the bundle is
larger than the motion.

The bisection is compiled (native/tree.cpp); this has its numbers and its words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["MAX_BOUNDS", "NO_LEAVES", "Obstruction", "Roots", "Span", "no_end", "too_close"]

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
