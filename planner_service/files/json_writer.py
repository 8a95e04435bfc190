"""JSON texts as ``json.dumps(value, indent=1)`` writes them, but faster: Python's own is slow with indents."""

from __future__ import annotations

import math
from json.encoder import encode_basestring_ascii
from typing import Any

__all__ = ["indented_json"]

NOT_FINITE = "NaN and infinity are not in JSON"


def indented_json(value: Any, depth: int = 0) -> str:
    """The text of a value of plain JSON types, in ASCII.

    Args:
        depth: How deep it stands in another one; its first line is not indented.

    Raises:
        ValueError: A number is not finite.
        TypeError: There is something that JSON does not have, or a key that is no text.
    """
    return _text(value, "\n" + " " * depth)


def _text(value: Any, end: str) -> str:
    kind = type(value)
    if kind is float:
        return _number(value)
    if kind is str:
        return str(encode_basestring_ascii(value))
    if kind is list or kind is tuple:
        if not value:
            return "[]"
        inner = end + " "
        try:
            entries = ("," + inner).join(map(float.__repr__, value))
            if "n" in entries:
                raise ValueError(NOT_FINITE)
        except TypeError:  # not numbers alone
            entries = ("," + inner).join([_text(entry, inner) for entry in value])
        return f"[{inner}{entries}{end}]"
    if kind is dict:
        if not value:
            return "{}"
        inner = end + " "
        pairs = [f"{encode_basestring_ascii(key)}: {_text(entry, inner)}" for key, entry in value.items()]
        return f"{{{inner}{(',' + inner).join(pairs)}{end}}}"
    if value is None:
        return "null"
    if value is True:
        return "true"
    if value is False:
        return "false"
    if kind is int:
        return int.__repr__(value)
    raise TypeError(f"{kind.__name__} is not in JSON")


def _number(value: float) -> str:
    if not math.isfinite(value):
        raise ValueError(NOT_FINITE)
    return float.__repr__(value)
