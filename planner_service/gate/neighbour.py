"""Where an arm beside this one can be, and which of its gate's verdicts that is of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from planner_service.scene.scene import Obstacle

__all__ = ["Occupied"]


@dataclass(frozen=True, eq=False)
class Occupied:
    """Where an arm can be until it rests, by what its gate has let pass.

    Attributes:
        obstacle: That, as boxes around each piece of the arm, in the base frame of another arm.
        number: Of the decision after which it is so.
        decided: How many decisions that gate has made by now.
    """

    obstacle: Obstacle
    number: int
    decided: Callable[[], int]

    @property
    def stale(self) -> bool:
        """Whether the gate has decided anything since: then its arm may be elsewhere."""
        return self.decided() != self.number
