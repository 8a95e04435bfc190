"""Numbers in text files, read the same way by every reader: ASCII digits, no underscores, and not megabytes of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

__all__ = ["plain_float", "plain_floats", "plain_int", "plain_ints"]

Number = TypeVar("Number", int, float)

MAX_CHARACTERS = 64
"""Of a number with a point; Python would read megabytes of digits."""

MAX_DIGITS = 9
"""Of an integer."""


def plain_float(word: str) -> float:
    """The number that ``word`` spells, perhaps infinite or not a number.

    Raises:
        ValueError: it spells none; says the first 20 characters of it.
    """
    try:
        return float(word if len(word) <= MAX_CHARACTERS and word.isascii() and "_" not in word else "")
    except ValueError:
        raise ValueError(repr(word[:20])) from None


def plain_int(word: str) -> int:
    """The integer of at most nine digits that ``word`` spells.

    Raises:
        ValueError: it spells none; says the first 20 characters of it.
    """
    if not re.fullmatch(rf"[+-]?[0-9]{{1,{MAX_DIGITS}}}", word):
        raise ValueError(repr(word[:20]))
    return int(word)


def plain_floats(text: str) -> list[float]:
    """The numbers in ``text``, with space between them, as ``plain_float`` reads each.

    Raises:
        ValueError: one is none; says the first 20 characters of it.
    """
    return _numbers(text, MAX_CHARACTERS, float, plain_float)


def plain_ints(text: str) -> list[int]:
    """The integers in ``text``, with space between them, as ``plain_int`` reads each.

    Raises:
        ValueError: one is none; says the first 20 characters of it.
    """
    return _numbers(text, MAX_DIGITS, int, plain_int)


def _numbers(text: str, longest: int, quick: Callable[[str], Number], plain: Callable[[str], Number]) -> list[Number]:
    """Meshes have millions of numbers: Python reads those that it cannot read otherwise than ``plain``."""
    words = text.split()
    if text.isascii() and "_" not in text and max(map(len, words), default=0) <= longest:
        with suppress(ValueError):  # which is worded below
            return list(map(quick, words))
    return list(map(plain, words))
