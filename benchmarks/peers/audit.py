"""The independent checker's verdict on a path or a motion that somebody else made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from planner_service.geometry import FloatArray

if TYPE_CHECKING:
    from tests.independent import IndependentChecker

__all__ = ["STEPS", "Finding", "audited", "densified"]

STEPS = (0.01, 0.005)
"""Radians that a joint turns between two samples at most, the coarser first."""


@dataclass(frozen=True)
class Finding:
    """What an audit found.

    Attributes:
        step: The step at which it was found; the finest where nothing was.
        verdict: ``free``, ``colliding`` or ``outside_limits``.
        depth: Metres that the pair overlaps at most along what was audited, None if free.
        pair: Who touches whom; a joint and "limit".
        clearance: Metres of the smallest gap at any sample; None where it was not asked for.
    """

    step: float
    verdict: str
    depth: float | None = None
    pair: tuple[str, str] | None = None
    clearance: float | None = None

    def row(self) -> dict[str, Any]:
        """As a row has it."""
        pair = None if self.pair is None else list(self.pair)
        return {"step": self.step, "verdict": self.verdict, "depth": self.depth, "pair": pair}


def densified(rows: FloatArray, step: float) -> FloatArray:
    """A polyline (N, n) sampled (m, n) so that no joint moves more than a step between two samples; its corners stay."""
    parts = [rows[:1]]
    for a, b in zip(rows[:-1], rows[1:], strict=True):
        count = max(1, math.ceil(float(np.abs(b - a).max()) / step))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def audited(
    checker: IndependentChecker, rows: FloatArray, steps: Sequence[float] = STEPS, *, clearance: bool = False
) -> Finding:
    """What the checker says of a polyline (N, n), at the first of the steps at which anything is wrong."""
    gap = _clearance(checker, densified(rows, steps[0])) if clearance else None
    for step in steps:
        touching = [q for q in densified(rows, step) if not checker.free(q)]
        if touching:
            verdict, depth, pair = _deepest(checker, touching)
            return Finding(step, verdict, depth, pair, gap)
    return Finding(steps[-1], "free", clearance=gap)


def _deepest(checker: IndependentChecker, samples: Sequence[FloatArray]) -> tuple[str, float | None, tuple[str, str]]:
    """The pair that overlaps most; the joint that leaves its range where nothing touches."""
    found = [(gap, pair) for q in samples for pair, gap in checker.gaps(q).items() if gap <= 0.0]
    if found:
        gap, pair = min(found)
        return "colliding", -gap, pair
    touch = checker.touch(samples[0])
    assert touch is not None
    return "outside_limits", None, (touch.a, touch.b)


def _clearance(checker: IndependentChecker, samples: FloatArray) -> float | None:
    """The smallest gap of the pairs that are with the scene or between links, None without pairs."""
    least = min((min(checker.gaps(q).values(), default=math.inf) for q in samples), default=math.inf)
    return least if math.isfinite(least) else None
