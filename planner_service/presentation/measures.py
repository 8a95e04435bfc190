"""Rounded numbers and ranges as text."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["numbers_text", "outside_text", "range_text"]

DIGITS = range(4, 26)
"""After the decimal point, tried in turn: a message says no more of them than it needs to be true."""


def numbers_text(values: Iterable[float], separator: str = ", ") -> str:
    """Numbers rounded to a tenth of a milliradian or millimetre."""
    return separator.join(f"{round(value, 4):g}" for value in values)


def outside_text(value: float, low: float, high: float) -> str:
    """Says that a value is outside a range, with digits enough for that to be seen."""
    digits = _digits(value, low, high)
    written = repr(float(f"{value:.{digits}f}")).removesuffix(".0")
    return f"{written} is outside {_range_text(low, high, digits)}"


def range_text(low: float, high: float, value: float) -> str:
    """A range in brackets, with digits enough for a value that is outside of it to be so as written."""
    return _range_text(low, high, _digits(value, low, high))


def _range_text(low: float, high: float, digits: int) -> str:
    return f"[{low:.{digits}f}, {high:.{digits}f}]"


def _digits(value: float, low: float, high: float) -> int:
    """The fewest digits with which a value outside a range is outside as written."""
    for digits in DIGITS:
        written, least, most = (float(f"{x:.{digits}f}") for x in (value, low, high))
        if not least <= written <= most:
            return digits
    return DIGITS[-1]
