"""Edge steps of a user's own."""

from __future__ import annotations

from collections.abc import Sequence

from planner_service import MotionStep

__all__ = ["InPython"]


class InPython:
    """Asked in Python, as any step of a user's own; the samples are those of the default."""

    def segments(self, dq: Sequence[float], reach: Sequence[float]) -> int:
        return MotionStep().segments(dq, reach)
