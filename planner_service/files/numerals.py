"""Numbers in text files, read the same way by every reader: ASCII digits, no underscores, and not megabytes of them."""

from __future__ import annotations

import re

__all__ = ["plain_float", "plain_int"]

MAX_CHARACTERS = 64
"""Of a number with a point; Python would read megabytes of digits."""


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
    if not re.fullmatch(r"[+-]?[0-9]{1,9}", word):
        raise ValueError(repr(word[:20]))
    return int(word)
