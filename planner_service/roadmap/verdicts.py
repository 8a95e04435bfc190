"""What is known of milestones and edges: a verdict on each, and what stood in the way of those that are blocked."""

from __future__ import annotations

import enum
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner_service.search.problem import SELF

__all__ = ["NOBODY", "SELF", "Knowledge", "Lesson", "Verdict"]

Verdicts = NDArray[np.int8]
Blockers = NDArray[np.int32]

NOBODY = -1
"""Not known what stood in the way."""

Lesson = tuple["Verdict", str | None]
"""A verdict, and the obstacle in the way if it is BLOCKED, ``SELF``, or None if that is not known."""


class Verdict(enum.IntEnum):
    """What is known of a milestone or an edge."""

    UNKNOWN = 0
    """Not judged."""
    FREE = 1
    """Free at its samples."""
    BLOCKED = 2
    """Not free."""
    FREE_BEFORE = 3
    """Free of all but some obstacles that came or moved since."""
    BLOCKED_BEFORE = 4
    """Blocked by an obstacle that went or moved since."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Verdicts on a number of things.

    Attributes:
        verdicts: A ``Verdict`` each, (k,), read-only.
        blockers: What stood in the way of each that is BLOCKED, an index in ``names`` or -1, (k,), read-only.
        names: Obstacles, and ``SELF``.
    """

    verdicts: Verdicts
    blockers: Blockers
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.verdicts, self.blockers):
            array.flags.writeable = False

    @classmethod
    def none(cls, count: int) -> Knowledge:
        """Nothing known of ``count`` things."""
        return cls(np.zeros(count, dtype=np.int8), np.full(count, NOBODY, dtype=np.int32))

    def with_lessons(self, lessons: Mapping[int, Lesson]) -> Knowledge:
        """This and what was learned of some, by their numbers; those beyond the last one are new."""
        if not lessons:
            return self
        count = max(len(self.verdicts), max(lessons) + 1)
        verdicts = np.concatenate([self.verdicts, np.zeros(count - len(self.verdicts), dtype=np.int8)])
        blockers = np.concatenate([self.blockers, np.full(count - len(self.blockers), NOBODY, dtype=np.int32)])
        names = {name: k for k, name in enumerate(self.names)}
        for at, (verdict, blocker) in lessons.items():
            verdicts[at] = verdict
            known = verdict is Verdict.BLOCKED and blocker is not None
            blockers[at] = names.setdefault(str(blocker), len(names)) if known else NOBODY
        return Knowledge(verdicts, blockers, tuple(names))

    def elsewhere(self) -> Knowledge:
        """What is left of it where nothing that was judged holds."""
        return self.none(len(self.verdicts))

    def nearer(self) -> Knowledge:
        """What is left of it where less padding is kept: what was free is."""
        verdicts = self.verdicts.copy()
        verdicts[(verdicts == Verdict.BLOCKED) | (verdicts == Verdict.BLOCKED_BEFORE)] = Verdict.UNKNOWN
        return replace(self, verdicts=verdicts)._tidy()

    def after(self, come: Collection[str], gone: Collection[str], pending: Collection[str]) -> Knowledge:
        """What is left of it once some obstacles have ``come`` and some have ``gone``; one that moved did both.

        Args:
            pending: All that came since something that is FREE_BEFORE was judged, and are still there.
        """
        verdicts = self.verdicts.copy()
        if come:
            verdicts[verdicts == Verdict.FREE] = Verdict.FREE_BEFORE
        if not pending:
            verdicts[verdicts == Verdict.FREE_BEFORE] = Verdict.FREE
        if gone:
            doubtful = np.array([name in gone for name in self.names] + [True], dtype=bool)  # -1: may have been any
            verdicts[(verdicts == Verdict.BLOCKED) & doubtful[self.blockers]] = Verdict.BLOCKED_BEFORE
        return replace(self, verdicts=verdicts)._tidy()

    def _tidy(self) -> Knowledge:
        """The same without the names of what blocks nothing: obstacles come and go."""
        blockers = np.where(self.verdicts == Verdict.BLOCKED, self.blockers, NOBODY)
        used = np.unique(blockers[blockers >= 0]).tolist()
        number = np.full(len(self.names) + 1, NOBODY, dtype=np.int32)  # the last is that of nobody
        number[used] = np.arange(len(used))
        return replace(self, blockers=number[blockers], names=tuple(self.names[k] for k in used))

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Which are free, or were before."""
        return np.asarray((self.verdicts == Verdict.FREE) | (self.verdicts == Verdict.FREE_BEFORE))

    def count(self, verdict: Verdict) -> int:
        """How many have this verdict."""
        return int(np.count_nonzero(self.verdicts == verdict))
