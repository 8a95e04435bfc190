"""How a curve is improved: what both families of methods are asked, and what they answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from planner_service.geometry.shapes import FloatArray

if TYPE_CHECKING:
    from planner_service.optimize.problem import Task

__all__ = ["Found", "Method"]


@dataclass(frozen=True, eq=False)
class Found:
    """Corners (c, n) of a curve at which a method stopped, and the iterations it took. They need not be free."""

    corners: FloatArray
    iterations: int


class Method(Protocol):
    """Improves a curve; a small frozen dataclass of settings. Equal tasks have equal answers."""

    @property
    def name(self) -> str:
        """Lower case, as on the command line."""

    def minimise(self, task: Task, corners: FloatArray, held: tuple[int, int]) -> Found:
        """A curve of less cost, with fewer pairs too near, or the same; the first and last ``held`` corners stay."""
