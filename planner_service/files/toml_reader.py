"""TOML files as plain values, refused before they take more time and memory than their size deserves."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from planner_service.errors import InvalidFile
from planner_service.files.reading import read_bytes

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["read_tables", "toml_value"]

MAX_KEY_PARTS = 4
"""Of a dotted key or header; ours have two."""

_QUOTED = re.compile(r"""(["'])(?:(?<=")[^"\\\n]*(?:\\.[^"\\\n]*)*|(?<=')[^'\n]*)(?:\1|(?=\n)|$|\\)""")
_DOTTED = re.compile(rf"(?<![\w-])(?:[\w-]+[ \t]*\.[ \t]*){{{MAX_KEY_PARTS}}}[\w-]")


def read_tables(path: Path, most: int) -> dict[str, Any]:
    """The content of the TOML file at ``path``, at most ``most`` bytes of it.

    Raises:
        InvalidFile: not a regular file, unreadable, larger, not UTF-8, or malformed (with the line).
    """
    data = read_bytes(path, most)
    try:
        text = data.decode("utf-8")
        _require_few_dots(text)
        return tomllib.loads(text)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} on line {line}"]) from None
    except RecursionError:
        raise InvalidFile(path, ["malformed TOML: nested too deeply"]) from None
    except ValueError as error:  # TOMLDecodeError says where; an integer of thousands of digits is a plain ValueError
        raise InvalidFile(path, [f"malformed TOML: {error}"]) from None


def _require_few_dots(text: str) -> None:
    """Refuse long dotted keys before they are read, which takes the square of their parts in time and memory."""
    found = _DOTTED.search(_QUOTED.sub("q", text))  # a quoted part is as good as a bare one
    if found is not None:
        raise ValueError(f"a key of more than {MAX_KEY_PARTS} parts: {found.group()[:40]!r}")


def toml_value(value: Any) -> str:
    """A text, number, sequence or dictionary as TOML on one line; a number reads back as the same bits."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml_value(entry)}' for key, entry in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if not isinstance(value, str):
        return repr(value)
    text = json.dumps(value, ensure_ascii=False)  # its escapes are TOML's; TOML asks for a few more
    return "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in text)
