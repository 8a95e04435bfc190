"""Loading the compiled core, where it was built."""

from __future__ import annotations

import logging
from functools import lru_cache
from types import ModuleType

from planner_service.concurrency.library_import import loaded

__all__ = ["load_core"]


@lru_cache(maxsize=1)
def load_core() -> ModuleType | None:
    """The extension module; None, which is logged once, where it was not built."""

    def core() -> ModuleType:
        from planner_service.native import _core

        return _core

    try:
        return loaded(core)
    except ImportError as error:
        logging.getLogger("planner_service").info("collision checks without the compiled core: %s", error)
        return None
