"""What the docstring of a class says of it, and of each of its fields."""

from __future__ import annotations

import re
from inspect import cleandoc

__all__ = ["fields_documented", "in_json", "summary", "without_sections"]

SECTION = re.compile(r"\n\n(?=(?:Args|Attributes|Raises|Returns|Yields):\n)")
ENTRY = re.compile(r"(?m)^(\w+(?:, \w+)*): ((?:.|\n )*)")


def summary(cls: type) -> str:
    """What a class is: its docstring without what it says of single fields; empty if it has none of its own."""
    return without_sections(cls.__dict__.get("__doc__") or "")


def without_sections(text: str) -> str:
    """A docstring without its sections."""
    return SECTION.split(cleandoc(text))[0]


def fields_documented(cls: type) -> dict[str, str]:
    """What the sections ``Attributes`` and ``Args`` of a class and those that it is derived from say, by field."""
    found: dict[str, str] = {}
    for each in reversed(cls.__mro__):
        for section in SECTION.split(cleandoc(each.__dict__.get("__doc__") or ""))[1:]:
            title, _, text = section.partition(":\n")
            if title in ("Args", "Attributes"):
                for names, said in ENTRY.findall(cleandoc("\n" + text)):
                    found |= dict.fromkeys(names.split(", "), " ".join(said.split()))
    return found


def in_json(said: str) -> str:
    """The same of JSON values, as Markdown."""
    return re.sub(r"\bNone\b", "null", re.sub(r"\b(True|False)\b", lambda found: found[0].lower(), said)).replace(
        "``", "`"
    )
