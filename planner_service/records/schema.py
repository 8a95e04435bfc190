"""Records: the parts of plan and task files, each defined once for writing and for reading.

A record is a pydantic model of plain JSON values. ``X.of(value)`` makes it from a value of this package, and
``record.value`` is that value again. A file's records are read by ``read_record``, which names every problem with the
path of its place; nothing in them is converted on the way: no text is taken for a number, and no unknown key ignored.
"""

from __future__ import annotations

import base64
import binascii
import re
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.shapes import FloatArray

__all__ = [
    "Count",
    "FirstOnly",
    "Joints",
    "NamePair",
    "Numbers",
    "Packed",
    "Reading",
    "Record",
    "Rows",
    "Text",
    "Vector2",
    "Vector3",
    "Vector4",
    "as_text",
    "at_most",
    "packed",
    "read_record",
    "recorded",
    "unpacked",
]

MAX_TEXT = 10_000
"""Characters of a name, a reason or a note."""

MAX_PROBLEMS = 1_000
"""After so many, reading stops: the file is something else."""

SHOWN_PROBLEMS = 100

MAX_WAYPOINTS = 100_000

R = TypeVar("R", bound="Record")
T = TypeVar("T")


@dataclass
class Reading:
    """What is known while a file is read.

    Attributes:
        joints: Joints of its robot, None before that is known.
        problems: Found so far, in records that are done.
        hulls: The texts of its meshes: one that is there twice is rebuilt once.
        work: Sum of the squared corner counts of these: to rebuild a hull takes time in proportion to that.
    """

    joints: int | None = None
    problems: int = 0
    hulls: set[str] = field(default_factory=set)
    work: int = 0


class _TooManyProblemsError(Exception):
    """Not a ValueError: it ends the reading at once."""


class Record(BaseModel):
    """A part of a file, an object of plain JSON values."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    @cached_property
    def value(self) -> Any:
        """What this package makes of it; InvalidRequest if it makes no sense."""
        return None

    @model_validator(mode="wrap")
    @classmethod
    def _valued(cls: type[R], data: Any, handler: ModelWrapValidatorHandler[R], info: ValidationInfo) -> R:
        """Of a record that is read, the value is made at once, so that its problems are found with all others."""
        reading = info.context
        if not isinstance(reading, Reading):
            return handler(data)
        try:
            record = handler(data)
            record.value  # noqa: B018 - a cached property
        except ValidationError as error:
            reading.problems += error.error_count()
            if reading.problems > MAX_PROBLEMS:
                raise _TooManyProblemsError(_problem(None, error.errors(include_url=False)[0])) from None
            raise
        return record


def read_record(model: type[R], document: Any, path: Path, reading: Reading) -> R:
    """The record that a document is.

    Raises:
        InvalidFile: it is not; with the place of each problem, what is there, and what would be right.
    """
    try:
        return model.model_validate(document, context=reading)
    except ValidationError as error:
        found = [_problem(document, entry) for entry in error.errors(include_url=False)]
    except _TooManyProblemsError as error:
        found = [f"more than {MAX_PROBLEMS:,} problems, such as {error}"]
    more = [f"and {len(found) - SHOWN_PROBLEMS} more"] if len(found) > SHOWN_PROBLEMS else []
    raise InvalidFile(path, [*found[:SHOWN_PROBLEMS], *more])


def recorded(field: str, make: Callable[[], T]) -> T:
    """What ``make`` writes; InvalidRequest, naming ``field``, where a value has no place in a file, as NaN has none."""
    try:
        return make()
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        where = _place(None, entry["loc"])
        expected = _expected(entry)
        raise InvalidRequest(f"{field}.{where}" if where else field, entry["input"], expected) from None


def _problem(document: Any, entry: Any) -> str:
    where = _place(document, entry["loc"])
    if entry["type"] == "missing":
        return f"{where}: missing"
    error = entry.get("ctx", {}).get("error")
    if isinstance(error, InvalidRequest):
        named = re.match(r"\w*", error.field)
        inner = isinstance(entry["input"], dict) and named is not None and named[0] in entry["input"]
        return f"{where}{'.' if inner else ': '}{error}" if where else str(error)
    text = f"got {reprlib.repr(entry['input'])}; expected {_expected(entry)}"
    return f"{where}: {text}" if where else text


def _place(document: Any, parts: Sequence[int | str]) -> str:
    """Such as ``result.path.waypoints[3][2]``; of names only those of keys, not those by which kinds are told apart."""
    here, where = document, ""
    for k, part in enumerate(parts):
        last = k == len(parts) - 1
        if isinstance(part, int):
            where += f"[{part}]"
            here = here[part] if isinstance(here, list) and part < len(here) else None
        elif isinstance(here, dict) and part in here:
            where, here = _joined(where, part), here[part]
        elif last or document is None:
            where = _joined(where, part)
    return where


def _joined(where: str, key: str) -> str:
    shown = key if key.isprintable() and len(key) <= 100 else reprlib.repr(key)
    return f"{where}.{shown}" if where else shown


_EXPECTED = {
    "float_type": "a finite number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing_size": "a whole number",
    "string_type": "a text",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "an object",
    "model_type": "an object",
    "model_attributes_type": "an object",
    "none_required": "null",
    "extra_forbidden": "no such key",
}


def _expected(entry: Any) -> str:
    kind, told = entry["type"], entry.get("ctx", {})
    if kind in _EXPECTED:
        return _EXPECTED[kind]
    if kind in ("too_short", "too_long"):
        return f"at least {told['min_length']} of them" if kind == "too_short" else f"at most {told['max_length']:,}"
    if kind == "string_too_long":
        return f"at most {told['max_length']:,} characters"
    if kind in ("greater_than_equal", "less_than_equal"):
        return f"at least {told['ge']}" if kind == "greater_than_equal" else f"at most {told['le']}"
    if kind == "literal_error":
        return str(told["expected"])
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return f"one of {told['expected_tags']}" if "expected_tags" in told else "an object that says its kind"
    if kind == "value_error":
        return str(told["error"])
    return str(entry["msg"])


# Kinds of values.


def _printable(value: str) -> str:
    if not value.isprintable():
        raise ValueError("printable characters only")
    return value


def as_text(value: str) -> str:
    """A text for people, as a file holds it: what cannot be printed by its escape, and cut if it is very long."""
    text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in value[:MAX_TEXT])
    return text[:MAX_TEXT]


def _one_per_joint(values: list[float], info: ValidationInfo) -> list[float]:
    joints = info.context.joints if isinstance(info.context, Reading) else None
    if joints is not None and len(values) != joints:
        raise ValueError(f"{joints} finite numbers, one for each joint")
    return values


def _of_size(size: int) -> Callable[[list[float]], list[float]]:
    def checked(values: list[float]) -> list[float]:
        if len(values) != size:
            raise ValueError(f"{size} finite numbers")
        return values

    return checked


def _two_names(values: list[str]) -> list[str]:
    if len(values) != 2:
        raise ValueError("two names")
    return values


class FirstOnly(FailFast):
    """Of a list, the first problem only: of a million wrong numbers one is told."""

    __hash__ = object.__hash__  # so that a list of these may be optional


def at_most(count: int) -> BeforeValidator:
    """Of a list or an object: asked before anything in it is looked at."""

    def checked(values: Any) -> Any:
        if isinstance(values, list | dict) and len(values) > count:
            raise ValueError(f"at most {count:,} entries; there are {len(values):,}")
        return values

    return BeforeValidator(checked)


Text = Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(_printable)]
"""Without control characters, escapes and half surrogates: a terminal may print it."""

Count = Annotated[int, Field(ge=0, le=2**63 - 1)]
Numbers = Annotated[list[float], FirstOnly()]
Vector2 = Annotated[Numbers, AfterValidator(_of_size(2))]
Vector3 = Annotated[Numbers, AfterValidator(_of_size(3))]
Vector4 = Annotated[Numbers, AfterValidator(_of_size(4))]
Joints = Annotated[Numbers, AfterValidator(_one_per_joint)]
"""One number for each joint of the robot in the file."""

Rows = Annotated[list[Joints], FirstOnly(), at_most(MAX_WAYPOINTS)]
NamePair = Annotated[list[Text], AfterValidator(_two_names)]
Packed = Annotated[str, Field(max_length=20_000_000)]
"""An array as base64 of its little-endian bytes."""


def packed(array: NDArray[Any], kind: str) -> str:
    """The text of an array; ``kind`` is "<f8" or "<i8"."""
    return base64.b64encode(np.ascontiguousarray(array).astype(kind).tobytes()).decode("ascii")


def unpacked(field: str, text: str, kind: str, columns: int) -> FloatArray:
    """An array (k, columns) from its text.

    Raises:
        InvalidRequest: it is no base64, or not of whole rows.
    """
    expected = f"base64 of rows of {columns} little-endian numbers of eight bytes"
    try:
        data = base64.b64decode(text.encode("ascii"), validate=True)
    except (binascii.Error, ValueError):
        raise InvalidRequest(field, reprlib.repr(text), expected) from None
    if len(data) % (8 * columns):
        raise InvalidRequest(field, f"{len(data)} bytes", expected)
    return np.frombuffer(data, dtype=kind).reshape(-1, columns)
