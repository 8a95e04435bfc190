"""The interface of an optimisation method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from planner_service.geometry.arrays import FloatArray

if TYPE_CHECKING:
    from planner_service.optimize.problem import CurveProblem

__all__ = ["Method", "MethodResult"]


@dataclass(frozen=True, eq=False)
class MethodResult:
    """The corners (c, n) of the curve at which a method stopped, which need not be free, and its iterations."""

    corners: FloatArray
    iterations: int


class Method(Protocol):
    """Improves a curve; its fields are its settings. Equal problems have equal results."""

    @property
    def name(self) -> str:
        """The name on the command line, in lower case."""

    def minimise(self, problem: CurveProblem, corners: FloatArray, held: tuple[int, int]) -> MethodResult:
        """A curve of lower cost or with fewer pairs too near, or the same; the first and last ``held`` corners stay."""
