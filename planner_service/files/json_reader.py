"""JSON files read value by value, with all their problems told at once."""

from __future__ import annotations

import json
import reprlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.reading import read_bytes

__all__ = ["MAX_BYTES", "Node", "parse_json", "read_json"]

T = TypeVar("T")

MAX_BYTES = 50_000_000
"""A plan of 10,000 waypoints takes about 5 MB; a larger file is no plan."""

MAX_KEY, MAX_KEYS = 500, 100_000
"""Characters of a key, and keys of an object."""

MAX_PARTS = 2_000_000
"""Lists and objects in a file: an empty one takes 60 bytes of memory and 2 of the file."""

_ABSENT = object()


def read_json(path: Path) -> Any:
    """The value in the JSON file at ``path``.

    Raises:
        InvalidFile: not a regular file, unreadable, over ``MAX_BYTES``, not UTF-8, malformed (with the
            line), with NaN or an infinity, with a key twice in one object, a key of more than 500 characters, or more
            than 100,000 keys in one object or 2,000,000 lists and objects.
    """
    return parse_json(path, read_bytes(path, MAX_BYTES))


def parse_json(path: Path, data: bytes) -> Any:
    """The value of a JSON text that a file at ``path`` holds.

    Raises:
        InvalidFile: as ``read_json``, but for the size.
    """
    if data.count(b"[") + data.count(b"{") > MAX_PARTS:
        raise InvalidFile(path, [f"too large: more than {MAX_PARTS:,} lists and objects"])
    try:
        return json.loads(data.decode("utf-8"), parse_constant=_refuse_constant, object_pairs_hook=_each_once)
    except RecursionError:
        raise InvalidFile(path, ["malformed JSON: nested too deeply"]) from None
    except UnicodeDecodeError as error:
        raise InvalidFile(path, [f"not UTF-8: byte {data[error.start]:#04x} at {error.start}"]) from None
    except ValueError as error:  # JSONDecodeError says where; an integer of thousands of digits is a plain ValueError
        raise InvalidFile(path, [f"malformed JSON: {error}"]) from None


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content: dict[str, Any] = {}
    for name, value in pairs:
        if name in content:
            raise ValueError(f"key {reprlib.repr(name)} occurs twice in one object")
        if len(name) > MAX_KEY:
            raise ValueError(f"key {reprlib.repr(name)} is longer than {MAX_KEY} characters")
        content[name] = value
    if len(content) > MAX_KEYS:
        raise ValueError(f"an object has more than {MAX_KEYS:,} keys")
    return content


class Node:
    """A place in a document; what is wrong there goes to ``problems``, and a stand-in comes back in its place.

    Whoever built something from stand-ins throws it away: after the last value was read,
    ``problems`` says whether there were any.

    Args:
        where: The name of the place, such as ``request.goals[0]``; empty for the whole document.
        problems: The list that all places of a document share.
    """

    def __init__(self, where: str, value: Any, problems: list[str], within: Node | None = None) -> None:
        self.where = where
        self.value = value
        self.problems = problems
        self._within = within
        self._faulty = False

    def wrong(self, expected: str) -> None:
        """Note that the value is not what was expected; nothing if it is missing, which has been noted before."""
        if self.value is not _ABSENT:
            self.problem(f"got {_shown(self.value)}; expected {expected}")
            self.value = _ABSENT

    def problem(self, text: str) -> None:
        """Note a problem of this place."""
        self.problems.append(f"{self.where}: {text}" if self.where else text)
        node: Node | None = self
        while node is not None and not node._faulty:
            node._faulty = True
            node = node._within

    @property
    def sound(self) -> bool:
        """Whether the value is there, and nothing wrong was found at this place or within it."""
        return self.value is not _ABSENT and not self._faulty

    def has(self, key: str) -> bool:
        """Whether this is an object with that key."""
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> Node:
        """The value under a key."""
        where = f"{self.where}.{key}" if self.where else key
        if not isinstance(self.value, dict):
            self.wrong("an object")
            return Node(where, _ABSENT, self.problems, self)
        found = Node(where, self.value.get(key, _ABSENT), self.problems, self)
        if key not in self.value:
            found.problem("missing")
        return found

    def items(self) -> Iterator[Node]:
        """The elements of a list."""
        if not isinstance(self.value, list):
            self.wrong("a list")
            return
        for k, item in enumerate(self.value):
            yield Node(f"{self.where}[{k}]", item, self.problems, self)

    def optional(self, read: Callable[[Node], T]) -> T | None:
        """What ``read`` makes of the value, or None for null."""
        return None if self.value is None else read(self)

    def attempt(self, make: Callable[[], T]) -> T | None:
        """What ``make`` returns; None if it refuses, which is one more problem, or if it would get stand-ins."""
        try:
            return make() if self.sound else None
        except InvalidRequest as error:
            self.problem(str(error))
            return None

    def number(self) -> float:
        """A finite number."""
        if self._is_number(self.value):
            return float(self.value)
        self.wrong("a finite number")
        return 0.0

    def whole(self) -> int:
        """A whole number of at least 0."""
        if isinstance(self.value, int) and not isinstance(self.value, bool) and 0 <= self.value < 2**63:
            return self.value
        self.wrong("a whole number of at least 0")
        return 0

    def text(self) -> str:
        """A text that a terminal may print: of printable characters and line ends."""
        if isinstance(self.value, str) and self.value.replace("\n", "").isprintable():
            return self.value
        self.wrong("a text of printable characters")
        return ""

    def flag(self) -> bool:
        """True or false."""
        if isinstance(self.value, bool):
            return self.value
        self.wrong("true or false")
        return False

    def numbers(self, size: int) -> tuple[float, ...]:
        """A list of so many finite numbers."""
        if isinstance(self.value, list) and len(self.value) == size and all(map(self._is_number, self.value)):
            return tuple(float(value) for value in self.value)
        self.wrong(f"{size} finite numbers")
        return (0.0,) * size

    def rows(self, size: int) -> list[tuple[float, ...]]:
        """A list of lists of so many finite numbers each."""
        return [item.numbers(size) for item in self.items()]

    @staticmethod
    def _is_number(value: Any) -> bool:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        return -sys.float_info.max <= value <= sys.float_info.max


def _shown(value: Any) -> str:
    try:
        return reprlib.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        return "an integer of thousands of digits"
