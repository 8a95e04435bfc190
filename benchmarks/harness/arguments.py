"""Numbers on the command line: refused with what would be right, before anything is measured."""

from __future__ import annotations

import argparse
from collections.abc import Callable

__all__ = ["up_to_seconds", "whole"]

MOST = 10**9


def whole(least: int, most: int = MOST) -> Callable[[str], int]:
    """An argument that is a whole number from ``least`` to ``most``."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"got {text!r}; expected a whole number from {least} to {most:,}")
        return value

    return read


def up_to_seconds(most: float) -> Callable[[str], float]:
    """An argument that is a number of seconds above 0."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0.0 < value <= most:
            raise argparse.ArgumentTypeError(f"got {text!r}; expected seconds, above 0 and at most {most:g}")
        return value

    return read
