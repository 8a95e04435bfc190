"""Two motions on clocks of their own, and what is proven of them, as ``Certifier.diagram`` takes and gives them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from planner_service.geometry.arrays import BoolArray, FloatArray, IntArray

__all__ = ["HALVINGS", "Diagram", "Moving"]

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


class Diagram(Protocol):
    """What is proven of two motions.

    Attributes:
        asked: Bounds that this took so far.
        rectangles: Of stretches of both motions, those that were looked at.
    """

    @property
    def asked(self) -> float: ...
    @property
    def rectangles(self) -> float: ...

    def blocked(self, lead: float, delay: float, finest: int, /) -> bytes:
        """Leads that are not proven within a delay of one: pairs of float64, from where to where."""

    def proven(self, level: int, out: BoolArray, /) -> None:
        """Of each of 2^level x 2^level rectangles whether it is proven, the first motion's stretches first."""
