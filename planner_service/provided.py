"""Functions that stand further up than who calls them: ``result.show()`` opens a page, and results are only data.

``planner_service.conveniences`` is the list of them, and provides each when the package is imported.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

from planner_service.errors import BrokenInvariant

__all__ = ["Provided"]

P = ParamSpec("P")
T = TypeVar("T")


class Provided(Generic[P, T]):
    """A function that is called here and provided above."""

    def __init__(self) -> None:
        self._function: Callable[P, T] | None = None

    def by(self, function: Callable[P, T]) -> Callable[P, T]:
        """Provide it, as a decorator."""
        self._function = function
        return function

    @property
    def known(self) -> bool:
        """Whether it was provided."""
        return self._function is not None

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> T:
        if self._function is None:
            raise BrokenInvariant("planner_service.conveniences was not imported")
        return self._function(*args, **kwargs)
