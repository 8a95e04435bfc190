"""Loading the compiled proof, where it was built."""

from __future__ import annotations

import logging
from functools import lru_cache
from types import ModuleType

from planner_service.concurrency.library_import import loaded

__all__ = ["load_proof"]


@lru_cache(maxsize=1)
def load_proof() -> ModuleType | None:
    """The extension module; None, which is logged once, where it was not built."""

    def proof() -> ModuleType:
        from planner_service.certify.native import _proof

        return _proof

    try:
        return loaded(proof)
    except ImportError as error:
        logging.getLogger("planner_service").info("proofs without compiled code: %s", error)
        return None
