"""Loading the compiled proof."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

from planner_service.concurrency.library_import import loaded
from planner_service.native.loading import NOT_BUILT

__all__ = ["load_proof"]


@lru_cache(maxsize=1)
def load_proof() -> ModuleType:
    """The extension module.

    Raises:
        ImportError: it was not built.
    """

    def proof() -> ModuleType:
        from planner_service.certify.native import _proof

        return _proof

    try:
        return loaded(proof)
    except ImportError as error:
        raise ImportError(f"{NOT_BUILT} ({error})") from error
