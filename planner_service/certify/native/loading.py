"""Loading the compiled proof."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

from planner_service.concurrency.library_import import loaded

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
        expected = "install planner_service anew, from a wheel or with a C++17 compiler"
        raise ImportError(f"the compiled proof is missing: {expected} ({error})") from error
