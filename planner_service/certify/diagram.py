"""Two motions on clocks of their own, as ``Certifier.diagram`` takes them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from planner_service.geometry.arrays import FloatArray, IntArray

__all__ = ["HALVINGS", "Moving"]

HALVINGS = 9
"""How often a motion is halved at most; ``LAST`` of diagram.hpp."""


@runtime_checkable
class Moving(Protocol):
    """A motion of some joints of a robot.

    Attributes:
        columns: Those joints.
        duration: Seconds.
        q: Their values at ``2**HALVINGS + 1`` times, evenly from start to end.
        travel: How far each has travelled by then.
    """

    @property
    def columns(self) -> IntArray: ...
    @property
    def duration(self) -> float: ...
    @property
    def q(self) -> FloatArray: ...
    @property
    def travel(self) -> FloatArray: ...
