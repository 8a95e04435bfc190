"""What touches, in words for the user."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Contact", "EdgeHit", "deepest", "rounded_down"]

NANO = 1e9
"""Bounds are given in whole nanometres, rounded to the safe side: their last bits depend on the CPU."""


@dataclass(frozen=True)
class Contact:
    """Two things that touch.

    Attributes:
        a: A link of the robot, or an object it carries.
        b: What it touches: a link, a carried object or an obstacle.
        depth: Overlap in metres of their deepest pieces along a separating direction: an upper
            bound of how far they penetrate.
    """

    a: str
    b: str
    depth: float

    def __str__(self) -> str:
        return f"{self.a} x {self.b} (at most {self.depth * 1000:.1f} mm deep)"


@dataclass(frozen=True)
class EdgeHit:
    """The first sample of an edge, in the order of judging, that collides.

    Attributes:
        fraction: Where it is on the edge: 0 at q1, 1 at q2.
        a: A link of the robot, or an object it carries.
        b: What it touches.
    """

    fraction: float
    a: str
    b: str


def deepest(overlaps: Iterable[tuple[tuple[str, str], float]]) -> tuple[Contact, ...]:
    """Contacts, deepest first, from the names and overlaps (m) of pieces: of each two owners the greatest."""
    depth: dict[tuple[str, str], float] = {}
    for names, overlap in overlaps:  # of a pair that only touches the bound may be below 0
        depth[names] = max(depth.get(names, 0.0), math.ceil(overlap * NANO) / NANO)
    return tuple(sorted((Contact(a, b, value) for (a, b), value in depth.items()), key=lambda c: (-c.depth, c.a, c.b)))


def rounded_down(gap: float) -> float:
    """A gap (m) in whole nanometres; infinite if it is."""
    return math.floor(gap * NANO) / NANO if math.isfinite(gap) else gap
