"""Reading what callers give: a function returns the value in one form, or raises ``InvalidRequest`` with its field."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping, Set
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from planner_service.errors import InvalidFile, InvalidRequest, shown
from planner_service.files.xml_reader import Malformed
from planner_service.geometry.arrays import FloatArray, frozen, set_fields

__all__ = [
    "FLOAT64",
    "MAX_LENGTH",
    "checked_name",
    "cloud",
    "copied_in",
    "finite_numbers",
    "finite_tuple",
    "flag",
    "function_or_none",
    "in_file",
    "instance",
    "items",
    "margin_of",
    "number",
    "numbers",
    "points_of",
    "text",
    "unusable_text",
    "vectors",
    "whole",
]

T = TypeVar("T")

FLOAT64 = np.dtype(np.float64)

MAX_LENGTH = 1e3
"""Metres: no robot on a table is a kilometre long, so a longer length is a unit mistake."""

MAX_NAME = 64
"""Characters of a name."""

MAX_ITEMS = 1_000_000
"""Elements of a list that a caller gives; an endless iterator would fill the memory."""

MAX_COORDINATE, MAX_DIRECTION = 1e100, 1e308
"""Largest coordinate of a point, whose square is still a float, and of a direction, whose product with a length is."""

MAX_NUMBERS = 20_000_000
"""Numbers of an array that a caller gives: 160 MB."""


def number(field: str, value: object, expected: str, lowest: float, highest: float) -> float:
    """The real number in [``lowest``, ``highest``] that a caller gave.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: outside the range, NaN, or not a real number.
    """
    plain = value.item() if isinstance(value, np.generic) else value  # numpy's would round the bounds to their type
    if not isinstance(plain, (int, float)) or isinstance(plain, bool) or not lowest <= plain <= highest:
        raise InvalidRequest(field, value, expected)
    try:
        return float(plain)
    except OverflowError:  # an integer that no float holds, where any number would do
        raise InvalidRequest(field, value, expected) from None


def whole(field: str, value: object, lowest: int, highest: int) -> int:
    """The whole number in [``lowest``, ``highest``] that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: outside the range, a boolean, or not an integer.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not lowest <= value <= highest:
        raise InvalidRequest(field, value, f"a whole number from {lowest:,} to {highest:,}")
    return int(value)


def numbers(field: str, values: object, expected: str) -> FloatArray:
    """An immutable float64 copy of the real numbers that a caller gave, in their own shape.

    The caller checks the shape, and whether they are finite.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: texts, booleans, complex numbers, other objects,
            hidden (masked) entries, rows of unequal length, integers that no float holds, or 20 million numbers.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT64 and values.size <= MAX_NUMBERS:
        array = np.array(values)
    else:
        try:
            _count(values)
            given = np.asarray(values)
        except Exception:  # an object of another library may raise anything here
            raise InvalidRequest(field, values, expected) from None
        if given.dtype.kind not in "iuf":
            raise InvalidRequest(field, values, expected)
        with np.errstate(over="ignore"):  # a long double may become infinite; the caller checks for finite numbers
            array = np.array(given, dtype=np.float64)
    array.flags.writeable = False
    return array


def finite_numbers(field: str, values: object, n: int) -> FloatArray:
    """``n`` finite numbers as ``numbers`` reads them, shape (n,).

    Raises:
        InvalidRequest: as ``numbers``, or another count of them, or one that is not finite.
    """
    expected = f"{n} finite numbers, shape ({n},)"
    array = numbers(field, values, expected)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise InvalidRequest(field, values, expected)
    return array


def vectors(field: str, values: object, largest: float = MAX_DIRECTION) -> FloatArray:
    """Finite vectors that a caller gave, shape (..., 3); float64 arrays are not copied.

    Raises:
        InvalidRequest: as ``numbers``, or another shape, or a number that is not finite or beyond ``largest``.
    """
    expected = "finite vectors, shape (..., 3)"
    array = values if type(values) is np.ndarray and values.dtype == np.float64 else numbers(field, values, expected)
    if array.shape[-1:] != (3,) or not (np.isfinite(array) & (np.abs(array) <= largest)).all():
        raise InvalidRequest(field, values, expected)
    return array


def text(field: str, value: object, expected: str = "a text") -> str:
    """The text that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: not a text.
    """
    return instance(field, value, str, expected)


def checked_name(field: str, value: object, whose: str = "") -> str:
    """The name that a caller gave to something, or that refers to a link or a joint.

    Args:
        whose: What it names, for the message, such as ``the name of a link, ``.

    Raises:
        InvalidRequest: naming ``field``: not a text, empty or long, with control characters or space at its ends.
    """
    good = isinstance(value, str) and value.isprintable() and value == value.strip()
    if not good or not 0 < len(str(value)) <= MAX_NAME:
        raise unusable_text(field, value, f"{whose}1 to {MAX_NAME} printable characters, no space at the ends")
    return str(value)


def unusable_text(field: str, value: object, expected: str) -> InvalidRequest:
    """The error for a text that cannot be used; its message shows little of it, as a file can hold megabytes."""
    little = reprlib.repr(value) if isinstance(value, str) else shown(value)
    return InvalidRequest(field, value, expected, message=f"{field}: got {little}; expected {expected}")


def flag(field: str, value: object) -> bool:
    """The yes or no that a caller gave.

    Raises:
        InvalidRequest: naming ``field``: neither True nor False.
    """
    return bool(instance(field, value, (bool, np.bool_), "True or False"))


def function_or_none(field: str, value: object, expected: str) -> None:
    """Check that a caller gave None, or something that is called: a function, but no class.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``, beside None.
    """
    if value is not None and (isinstance(value, type) or not callable(value)):
        raise InvalidRequest(field, value, f"{expected}, or None")


def instance(field: str, value: object, kind: type[T] | tuple[type[T], ...], expected: str) -> T:
    """The value that a caller gave, if it is of that kind.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``.
    """
    if not isinstance(value, kind):
        raise InvalidRequest(field, value, expected)
    return value


def items(
    field: str, values: object, kind: type[T] | tuple[type[T], ...], expected: str, most: int = MAX_ITEMS
) -> tuple[T, ...]:
    """The elements of a list or another iterable, each of that kind.

    Raises:
        InvalidRequest: naming ``field`` and what was ``expected``: a text, a mapping, a set (which has no order),
            something that has no elements, an element of another kind, or more than ``most``.
    """
    if isinstance(values, (str, bytes, Mapping, Set)):
        raise InvalidRequest(field, values, expected)
    try:
        given = iter(values)  # type: ignore[call-overload]
    except TypeError:
        raise InvalidRequest(field, values, expected) from None
    checked: list[T] = []
    for value in islice(given, most):
        if not isinstance(value, kind):
            raise InvalidRequest(f"{field}[{len(checked)}]", value, expected)
        checked.append(value)
    for _ in given:
        raise InvalidRequest(field, values, f"{expected}, at most {most:,}")
    return tuple(checked)


def _count(values: object) -> int:
    """How many numbers numpy would find in ``values``.

    Raises:
        ValueError: too many, or it would take something for a number that is none: a boolean or a hidden entry.
    """
    if isinstance(values, np.ndarray):
        mask = getattr(values, "mask", False)
        if values.dtype.kind == "b" or (mask is not False and bool(np.any(mask))):
            raise ValueError
        count = values.size
    elif isinstance(values, (list, tuple)):
        count = 0
        for value in values:
            count += 1 if type(value) is float else _count(value)
            if count > MAX_NUMBERS:
                break
    elif isinstance(values, (bool, np.bool_)):
        raise ValueError
    else:
        count = len(values) if hasattr(values, "__len__") else 1
    if count > MAX_NUMBERS:
        raise ValueError
    return count


def _are_finite_floats(values: tuple[Any, ...]) -> bool:
    return {*map(type, values)} == {float} and all(map(math.isfinite, values))


def finite_tuple(field: str, values: Any, size: int) -> tuple[float, ...]:
    """``size`` finite numbers that a caller gave.

    Raises:
        InvalidRequest: as ``numbers``, or another count of them, or one that is not finite.
    """
    if type(values) is tuple and len(values) == size and _are_finite_floats(values):
        return values
    array = numbers(field, values, f"{size} finite numbers")
    if array.shape != (size,) or not np.isfinite(array).all():
        raise InvalidRequest(field, values, f"{size} finite numbers")
    return tuple(array.tolist())


def margin_of(margin: object) -> float:
    """The margin in metres for growing a shape."""
    return number("margin", margin, f"metres in [0, {MAX_LENGTH:g}]", 0.0, MAX_LENGTH)


def points_of(points: object) -> FloatArray:
    """Points that a caller gave, shape (..., 3)."""
    return vectors("points", points, MAX_COORDINATE)


def cloud(field: str, values: object, expected: str, least: int, most: int, largest: float) -> FloatArray:
    """``least`` to ``most`` points that a caller gave, shape (n, 3), none of their coordinates beyond ``largest``."""
    rows = numbers(field, values, expected)
    if rows.ndim != 2 or rows.shape[1:] != (3,) or not least <= len(rows) <= most:
        message = f"{field}: got an array of shape {rows.shape}; expected {expected}"
        raise InvalidRequest(field, rows, expected, message=message)
    bad = np.flatnonzero(~(np.abs(rows) <= largest).all(axis=-1))
    if len(bad):
        raise InvalidRequest(f"{field}[{bad[0]}]", rows[bad[0]].tolist(), expected)
    return rows


def copied_in(value: object, *names: str) -> None:
    """For ``__post_init__``: replace the fields ``names`` (arrays, lists, mappings) by private, read-only copies."""
    for name in names:
        held = getattr(value, name)
        if type(held) is tuple and len(held) <= MAX_ITEMS:
            continue
        if isinstance(held, np.ndarray):
            held = frozen(held.copy())
        elif isinstance(held, Mapping):
            held = dict(held)
        elif held is not None:
            held = items(name, held, object, "a sequence")
        set_fields(value, **{name: held})


def in_file(path: Path, make: Callable[[], T]) -> T:
    """What ``make`` returns, which is made of a file's content.

    Raises:
        InvalidFile: ``make`` refuses the content.
    """
    try:
        return make()
    except InvalidFile:
        raise
    except (InvalidRequest, Malformed) as error:
        raise InvalidFile(path, [str(error)]) from None
