"""Goals of which every configuration is known and collides: the proof that no plan exists."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from planner_service.certify.certifier import Certifier
from planner_service.certify.overlap import proven_overlap
from planner_service.geometry.arrays import FloatArray, as_sent
from planner_service.geometry.validation import copied_in

__all__ = ["CollidingSolution", "all_in_words", "colliding_solutions"]


@dataclass(frozen=True, eq=False)
class CollidingSolution:
    """A configuration for a goal, in a box that holds exactly one for each pose within the goal's tolerances.

    Two things are proven to overlap at every configuration of the box.

    Attributes:
        q: Shape (n,).
        lower: Lowest joint values of the box, (n,).
        upper: Highest, (n,).
        a: A link of the robot, or an object it carries.
        b: What it overlaps.
    """

    q: FloatArray
    lower: FloatArray
    upper: FloatArray
    a: str
    b: str
    __setstate__ = as_sent

    def __post_init__(self) -> None:
        copied_in(self, "q", "lower", "upper")

    def __str__(self) -> str:
        return f"[{', '.join(f'{value:.4f}' for value in self.q.tolist())}]: {self.a} x {self.b}"


def colliding_solutions(
    certifier: Certifier, Q: FloatArray, lowest: FloatArray, highest: FloatArray
) -> tuple[CollidingSolution, ...] | None:
    """Solutions Q (k, n) with two things that overlap in all of their boxes; None if one has no such proof."""
    out = []
    for q, lower, upper in zip(Q, lowest, highest, strict=True):
        overlap = proven_overlap(certifier, lower, upper)
        if overlap is None:
            return None
        out.append(CollidingSolution(q, lower, upper, overlap.a, overlap.b))
    return tuple(out)


def all_in_words(solutions: Sequence[CollidingSolution]) -> str:
    """That all of them collide, and with what, most frequent first."""
    counted = Counter(f"{one.a} x {one.b}" for one in solutions)
    pairs = [f"{pair} ({times})" for pair, times in sorted(counted.items(), key=lambda c: (-c[1], c[0]))]
    if len(solutions) == 1:
        return (
            f"it is proven that no other configuration reaches it, and that {pairs[0][:-4]} overlap in all of its box"
        )
    return (
        f"it is proven that no configurations but {len(solutions)} reach it, and that two things overlap in all of the "
        f"box of each: {', '.join(pairs)}"
    )
