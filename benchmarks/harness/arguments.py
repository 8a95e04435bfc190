"""Numbers on the command line: refused with what would be right, before anything is measured."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress

__all__ = ["whole"]

MOST = 10**9


def whole(least: int, most: int = MOST) -> Callable[[str], int]:
    """An argument that is a whole number from ``least`` to ``most``."""

    def read(text: str) -> int:
        with suppress(ValueError):
            if least <= (value := int(text)) <= most:
                return value
        raise argparse.ArgumentTypeError(f"got {text!r}; expected a whole number from {least} to {most:,}")

    return read
