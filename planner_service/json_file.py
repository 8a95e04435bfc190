"""JSON files read value by value, with all their problems told at once."""

from __future__ import annotations

import json
import reprlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.regular_file import read_bytes

__all__ = ["MAX_BYTES", "Node", "read_json"]

T = TypeVar("T")

MAX_BYTES = 50_000_000
"""A plan of 10,000 waypoints takes about 5 MB; a larger file is no plan."""

_ABSENT = object()


def read_json(path: Path) -> Any:
    """The value in the JSON file at ``path``.

    Raises:
        InvalidFile: not a regular file, unreadable, over ``MAX_BYTES``, not UTF-8, malformed (with the
            line), with NaN or an infinity, or with a key twice in one object.
    """
    data = read_bytes(path, MAX_BYTES)
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
    content = dict(pairs)
    if len(content) != len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key {reprlib.repr(twice)} is there twice in one object")
    return content


class Node:
    """A place in a document; what is wrong there goes to ``problems``, and a stand-in comes back in its place.

    Whoever built something from stand-ins throws it away: after the last value was read,
    ``problems`` says whether there were any.

    Args:
        where: The name of the place, such as ``request.goals[0]``; empty for the whole document.
        problems: The list that all places of a document share.
    """

    def __init__(self, where: str, value: Any, problems: list[str]) -> None:
        self.where = where
        self.value = value
        self.problems = problems

    def wrong(self, expected: str) -> None:
        """Note that the value is not what was expected; nothing if it is missing, which has been noted before."""
        if self.value is not _ABSENT:
            self.problem(f"got {_shown(self.value)}; expected {expected}")
            self.value = _ABSENT

    def problem(self, text: str) -> None:
        """Note a problem of this place."""
        self.problems.append(f"{self.where}: {text}" if self.where else text)

    @property
    def sound(self) -> bool:
        """Whether the value is there, and nothing wrong was found at this place or within it."""
        return self.value is not _ABSENT and not any(problem.startswith(self.where) for problem in self.problems)

    def has(self, key: str) -> bool:
        """Whether this is an object with that key."""
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> Node:
        """The value under a key."""
        where = f"{self.where}.{key}" if self.where else key
        if not isinstance(self.value, dict):
            self.wrong("an object")
            return Node(where, _ABSENT, self.problems)
        if key not in self.value:
            self.problems.append(f"{where}: missing")
        return Node(where, self.value.get(key, _ABSENT), self.problems)

    def items(self) -> Iterator[Node]:
        """The elements of a list."""
        if not isinstance(self.value, list):
            self.wrong("a list")
            return
        for k, item in enumerate(self.value):
            yield Node(f"{self.where}[{k}]", item, self.problems)

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
        """A text."""
        if isinstance(self.value, str):
            return self.value
        self.wrong("a text")
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
