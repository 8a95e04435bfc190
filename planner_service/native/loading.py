"""Loading the compiled core."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

from planner_service.concurrency.library_import import loaded

__all__ = ["NOT_BUILT", "load_core"]

NOT_BUILT = "the compiled part of planner_service is missing: install it anew, from a wheel or with a C++17 compiler"


@lru_cache(maxsize=1)
def load_core() -> ModuleType:
    """The extension module.

    Raises:
        ImportError: it was not built.
    """

    def core() -> ModuleType:
        from planner_service.native import _core

        return _core

    try:
        return loaded(core)
    except ImportError as error:
        raise ImportError(f"{NOT_BUILT} ({error})") from error
