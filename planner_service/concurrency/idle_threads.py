"""Imports numpy so that its idle threads sleep.

As it is loaded, OpenBLAS starts a thread for each core, and lets it look for work for 2**28 cycles before it sleeps:
0.1 s of CPU, a third of what importing this package takes. Where the user chose a timeout, or imported numpy before,
all is as it was.
"""

from __future__ import annotations

import os

__all__ = ["TIMEOUT"]

TIMEOUT = "OPENBLAS_THREAD_TIMEOUT"
"""Read once, as the library is loaded: the base-2 logarithm of those cycles, at least 4."""


def _load() -> None:
    chosen = TIMEOUT in os.environ
    os.environ.setdefault(TIMEOUT, "4")
    try:
        import numpy  # noqa: F401  reads it
    finally:
        if not chosen:
            del os.environ[TIMEOUT]  # what this process starts decides for itself


_load()
