"""Numbers on the command line: refused with what would be right, before anything is measured."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

__all__ = ["up_to_seconds", "whole"]

MOST = 10**9
T = TypeVar("T")


def whole(least: int, most: int = MOST) -> Callable[[str], int]:
    """An argument that is a whole number from ``least`` to ``most``."""
    return _reader(int, lambda value: least <= value <= most, f"a whole number from {least} to {most:,}")


def up_to_seconds(most: float) -> Callable[[str], float]:
    """An argument that is a number of seconds above 0."""
    return _reader(float, lambda value: 0.0 < value <= most, f"seconds, above 0 and at most {most:g}")


def _reader(kind: Callable[[str], T], fits: Callable[[T], bool], expected: str) -> Callable[[str], T]:
    def read(text: str) -> T:
        with suppress(ValueError):
            if fits(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"got {text!r}; expected {expected}")

    return read
