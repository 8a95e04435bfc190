"""Models of files: what each field of a file is, declared once for reading and for writing.

A model is a pydantic class. ``X.of(value)`` makes it from a value of this package, and ``model.value`` is that value
again: where a field has the name of the attribute, nothing more need be said. ``read_record`` reads a document
strictly: a text is never taken for a number, NaN and infinity are refused, and so is a key that the model does not
have. Every problem is reported, each with its place as the file has it, the value found there and what would be right.
"""

from __future__ import annotations

import enum
import re
import reprlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    SerializerFunctionWrapHandler,
    ValidationError,
    ValidationInfo,
    model_serializer,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.docstrings import fields_documented, in_json, summary
from planner_service.files.json_writer import indented_json

__all__ = [
    "ONE_PER_JOINT",
    "Count",
    "Described",
    "FirstOnly",
    "GrownRecord",
    "Joints",
    "NamePair",
    "Numbers",
    "Prose",
    "Reading",
    "Record",
    "Rows",
    "Text",
    "Vector2",
    "Vector3",
    "Vector4",
    "as_text",
    "at_most",
    "of_length",
    "plain",
    "read_record",
    "recorded",
]

MAX_TEXT = 10_000
"""Characters of a name, a reason or a note."""

MAX_PROBLEMS = 1_000
"""After this many problems the rest is not read: the file is probably of another kind."""

UNREAD = "unread"
"""Type of pydantic's error for what is not read."""

MAX_WAYPOINTS = 100_000

MAX_ENTRIES = 1_000
"""Of a list whose record does not say how many it may have."""

MAX_LABEL = 64
"""Characters of a name by which an entry of a list is shown."""

MAX_HINTS = 100
"""Unknown keys of a file for which the nearest key is looked up, which takes far longer than naming the problem."""

PLAIN = frozenset({float, str, int, bool, type(None)})
"""What JSON has, too."""

_MISSING = object()

NAMED = re.compile(r"(?:An? )?``\w+``\.|")
"""A docstring of a record that only names what the record is of."""

R = TypeVar("R", bound="Record")
T = TypeVar("T")


@dataclass
class Reading:
    """What is known while a file is read.

    Attributes:
        joints: Joints of its robot; None if that is not known.
        problems: Problems found so far, in models that are done.
        hints: Unknown keys found so far.
        where: What places begin with, such as ``line 3``; empty for a document that is a whole file.
        models: For each object of the document in which there are problems, by its ``id``, the model it should fit.
    """

    joints: int | None = None
    problems: int = 0
    hints: int = 0
    where: str = ""
    models: dict[int, type[Record]] = field(default_factory=dict)


class Described(BaseModel):
    """A model whose JSON schema says in the words of docstrings what it and each of its fields is.

    Attributes:
        about: The class whose docstring says what those fields are of which the model's own says nothing.
    """

    about: ClassVar[type | None] = None

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Its JSON schema, in which docstrings say what it and each of its fields is."""
        schema = handler(core)
        own = handler.resolve_ref_schema(schema)
        about = cls.about
        said = ({} if about is None else fields_documented(about)) | fields_documented(cls)
        own["description"] = in_json(summary(cls if about is None or not NAMED.fullmatch(summary(cls)) else about))
        for name, info in cls.model_fields.items():
            entry = own["properties"][info.alias or name]
            entry.pop("title", None)
            if name in said:
                entry["description"] = in_json(said[name])
        return schema


class Record(Described):
    """A part of a file: an object with the keys that the class declares, and no others.

    Args:
        makes: The class of ``value``, called with ``arguments``. The record has all its fields that are compared, in
            their order, each as its type says unless the record declares it; those that only the record has come first.
    """

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    makes: ClassVar[Callable[..., Any] | None] = None
    models: ClassVar[dict[Any, type[Record]]] = {}

    def __init_subclass__(cls, makes: type[Any] | None = None, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        if makes is not None:
            cls.makes = cls.about = makes
            if cls.models.setdefault(makes, cls) is not cls:
                raise TypeError(f"two records of {makes.__name__}: a field of that type could be either")

    @classmethod
    def __pydantic_init_subclass__(cls, makes: type[Any] | None = None, **settings: Any) -> None:
        if makes is None:
            return
        own, hints = cls.__pydantic_fields__, get_type_hints(makes)
        names = getattr(makes, "_fields", None) or [each.name for each in fields(makes) if each.compare]
        made = {name: own.get(name) or FieldInfo.from_annotation(cls._annotation(hints[name])) for name in names}
        cls.__pydantic_fields__ = {name: info for name, info in own.items() if name not in made} | made
        cls.model_rebuild(force=True)

    @classmethod
    def _annotation(cls, hint: Any) -> Any:
        """What a field of a record is, by the type of what it makes."""
        parts = get_args(hint)
        if type(None) in parts:
            (given,) = (part for part in parts if part is not type(None))
            return cls._annotation(given) | None
        if parts and parts[-1] is Ellipsis:
            entry: Any = cls._annotation(parts[0])
            listed = list[entry] if parts[0] in cls.models else Annotated[list[entry], FirstOnly()]
            return Annotated[listed, at_most(MAX_ENTRIES)]
        return cls.models[hint] if hint in cls.models else ANNOTATIONS[hint]

    @classmethod
    def of(cls: type[R], value: Any) -> R:
        """The record of a value."""
        return cls.model_validate(value)

    @classmethod
    def fields_of(cls, value: Any) -> dict[str, Any]:
        """The fields of a value's record: its attributes of these names, or the entries of a sequence in order."""
        names = _names(cls)
        if isinstance(value, list):
            return dict(zip((key for _, key in names), value, strict=True))
        found = ((key, getattr(value, name, _MISSING)) for name, key in names)
        return {key: each if type(each) in PLAIN else plain(each) for key, each in found if each is not _MISSING}

    @property
    def arguments(self) -> dict[str, Any]:
        """The fields by name, records as their values and lists as tuples."""
        return {name: _as_value(getattr(self, name)) for name in type(self).model_fields}

    @cached_property
    def value(self) -> Any:
        """What this package makes of it; InvalidRequest if it makes no sense."""
        makes = type(self).makes
        return None if makes is None else makes(**self.arguments)

    def document(self) -> dict[str, Any]:
        """The JSON object."""
        return self.model_dump(by_alias=True)

    @cached_property
    def section(self) -> str:
        """Its text as a part of a file that is written with indents."""
        return indented_json(self.document(), 1)

    @cached_property
    def line(self) -> bytes:
        """Its text as a part of a document without blanks, in UTF-8."""
        return self.model_dump_json(by_alias=True).encode()

    @model_validator(mode="wrap")
    @classmethod
    def _with_value(cls: type[R], data: Any, handler: ModelWrapValidatorHandler[R], info: ValidationInfo) -> R:
        """While a file is read, make the value at once, so that its problems are found with all others."""
        reading = info.context
        if not isinstance(reading, Reading):
            return handler(data if type(data) is dict or isinstance(data, Record) else cls.fields_of(data))
        if reading.problems > MAX_PROBLEMS:
            raise PydanticCustomError(UNREAD, "not read")
        before = reading.problems
        try:
            record = handler(data)
            record.value  # noqa: B018 - a cached property
        except ValidationError as error:
            reading.models[id(data)] = cls
            reading.problems = before + error.error_count()
            raise
        return record


@cache
def _names(model: type[Record]) -> tuple[tuple[str, str], ...]:
    """Each field's name, and its key in a file."""
    return tuple((name, field.alias or name) for name, field in model.model_fields.items())


class GrownRecord(Record):
    """A record with keys that older files do not have: those with a default, which is not written."""

    @model_serializer(mode="wrap")
    def _without_defaults(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        document: dict[str, Any] = handler(self)
        for name, usual in _defaults(type(self)):
            if getattr(self, name) == usual:
                del document[name]
        return document


@cache
def _defaults(model: type[GrownRecord]) -> tuple[tuple[str, Any], ...]:
    """The fields but ``kind`` that have a default, with it: pydantic takes its time to find out."""
    fields = [(name, f) for name, f in model.model_fields.items() if not f.is_required() and name != "kind"]
    return tuple((name, field.get_default(call_default_factory=True)) for name, field in fields)


def plain(value: Any) -> Any:
    """What JSON has in place of an array, a tuple, a mapping or an enum; a record is made of anything else."""
    if type(value) in PLAIN:  # most are
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return dict(value)
    return value.value if isinstance(value, enum.Enum) else value


def _as_value(field: Any) -> Any:
    if isinstance(field, list):
        return tuple(_as_value(entry) for entry in field)
    return field.value if isinstance(field, Record) else field


def read_record(model: type[R], document: Any, path: Path, reading: Reading) -> R:
    """The model that a document fits.

    Args:
        path: The file that the document was read from.

    Raises:
        InvalidFile: it does not fit; with the place of each problem, the value there, and what would be right.
    """
    try:
        return model.model_validate(document, context=reading)
    except ValidationError as error:
        entries = [entry for entry in error.errors(include_url=False) if entry["type"] != UNREAD]
    raise InvalidFile(path, [_problem(document, entry, reading) for entry in entries])


def recorded(field: str, make: Callable[[], T]) -> T:
    """What ``make`` writes; InvalidRequest, naming ``field``, where a value cannot be written, such as NaN."""
    try:
        return make()
    except ValidationError as error:
        entry = error.errors(include_url=False)[0]
        cause = entry.get("ctx", {}).get("error")
        if isinstance(cause, InvalidRequest):
            raise cause from None
        where = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in entry["loc"])
        raise InvalidRequest(f"{field}{where}".lstrip("."), entry["input"], _expected(entry)) from None


def _problem(document: Any, entry: Any, reading: Reading) -> str:
    """One line for an error of pydantic's."""
    kind, loc, context = entry["type"], entry["loc"], entry.get("ctx", {})
    if kind == "extra_forbidden":
        return _located(
            _place(document, loc[:-1], reading.where), _unknown_key(loc[-1], _at(document, loc[:-1]), reading)
        )
    if kind in ("union_tag_invalid", "union_tag_not_found") and context["discriminator"].startswith("'"):
        loc = (*loc, context["discriminator"].strip("'"))
        if kind == "union_tag_not_found" and isinstance(entry["input"], dict):
            return f"{_joined(_place(document, loc[:-1], reading.where), loc[-1])}: missing"
    description = _description(document, loc, reading)
    if kind == "missing":
        where = _joined(_place(document, loc[:-1], reading.where), loc[-1])
        return f"{where}: missing; expected {description}" if description else f"{where}: missing"
    where = _place(document, loc, reading.where)
    error = context.get("error")
    if isinstance(error, InvalidRequest):
        field = re.match(r"\w*", error.field)
        if isinstance(entry["input"], dict) and field is not None and field[0] in entry["input"]:
            return f"{where}.{error}" if where else str(error)
        return _located(where, str(error).removeprefix(f"{loc[-1]}: " if loc else ""))
    value = context["tag"] if kind == "union_tag_invalid" else entry["input"]
    expected = _expected(entry) if description is None or kind in _SPEAKING else description
    return _located(where, f"got {_shown(value)}; expected {expected}")


def _located(where: str, problem: str) -> str:
    return f"{where}: {problem}" if where else problem


def _unknown_key(key: Any, parent: Any, reading: Reading) -> str:
    model = reading.models.get(id(parent))
    known = [] if model is None else [field.alias or name for name, field in model.model_fields.items()]
    reading.hints += 1
    near = get_close_matches(str(key), known, n=1) if reading.hints <= MAX_HINTS and len(str(key)) <= MAX_LABEL else []
    hint = f"did you mean {near[0]!r}?" if near else f"expected one of {', '.join(known)}"
    return f"unknown key {_shown(key)}" + (f"; {hint}" if known else "")


def _description(document: Any, loc: Sequence[int | str], reading: Reading) -> str | None:
    """What the field at a place is, in the words of its model."""
    model = reading.models.get(id(_at(document, loc[:-1]))) if loc else None
    field = None if model is None else model.model_fields.get(str(loc[-1]))
    return None if field is None else field.description


def _at(document: Any, parts: Sequence[int | str]) -> Any:
    """The object at a place: the innermost that the document has on the way there."""
    for part in parts:
        with suppress(LookupError, TypeError):
            document = document[part]
    return document


def _place(document: Any, parts: Sequence[int | str], where: str) -> str:
    """Such as ``result.path.waypoints[3][2]``, or ``obstacle[1] 'post'.box`` where entries of a list have names.

    Only keys of the document are named, not the names that pydantic gives the kinds of a union.
    """
    value = document
    for part in parts:
        if isinstance(part, int):
            value = value[part] if isinstance(value, list) and part < len(value) else None
            where += f"[{part}]{_label(value)}"
        elif isinstance(value, dict) and part in value:
            where, value = _joined(where, part), value[part]
    return where


def _label(entry: Any) -> str:
    name = entry.get("name") if isinstance(entry, dict) else None
    return f" {name!r}" if isinstance(name, str) and 0 < len(name) <= MAX_LABEL else ""


def _joined(where: str, key: str) -> str:
    shown = key if key.isprintable() and len(key) <= 100 else reprlib.repr(key)
    return f"{where}.{shown}" if where else shown


def _shown(value: Any) -> str:
    try:
        return reprlib.repr(value)
    except ValueError:  # Python refuses to print integers of thousands of digits
        digits = "an integer of thousands of digits"
        return digits if isinstance(value, int) else f"a {type(value).__name__} with {digits}"


_SPEAKING = ("value_error", "literal_error", "too_long", "string_too_long")
"""Errors that say more than the description of the field."""

_EXPECTED = {
    "float_type": "a finite number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing_size": "a whole number",
    "string_type": "a text",
    "string_unicode": "a text of printable characters",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "an object",
    "model_type": "an object",
    "model_attributes_type": "an object",
    "none_required": "null",
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length:,}",
    "string_too_short": "a text that is not empty",
    "string_too_long": "at most {max_length:,} characters",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than_equal": "at most {le}",
    "literal_error": "{expected}",
    "value_error": "{error}",
}
"""What would be right, by the type of pydantic's error; filled in with its context."""


def _expected(entry: Any) -> str:
    """What would be right, for an error of pydantic's."""
    kind, context = entry["type"], entry.get("ctx", {})
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return f"one of {context['expected_tags']}" if "expected_tags" in context else "an object"
    return _EXPECTED[kind].format(**context) if kind in _EXPECTED else str(entry["msg"])


# Kinds of values.


def _printable(value: str) -> str:
    if not value.isprintable():
        raise ValueError("a text of printable characters")
    return value


def as_text(value: str) -> str:
    """A text for people, as a file holds it: what cannot be printed by its escape, and cut if it is very long."""
    text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in value[:MAX_TEXT])
    return text[:MAX_TEXT]


def _escaped(value: Any, info: ValidationInfo) -> Any:
    return as_text(value) if isinstance(value, str) and not isinstance(info.context, Reading) else value


def _one_per_joint(values: Any, info: ValidationInfo) -> Any:
    joints = info.context.joints if isinstance(info.context, Reading) else None
    if joints is not None and isinstance(values, list) and len(values) != joints:
        raise ValueError(f"{joints} finite numbers, one for each joint")
    return values


@dataclass(frozen=True)
class _Entries(BeforeValidator):
    """A check of how many entries a list has, which its JSON schema says, too."""

    least: int = 0
    most: int = 0

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = handler(core)
        if schema.get("type") == "array":
            schema |= ({"minItems": self.least} if self.least else {}) | {"maxItems": self.most}
        return schema

    __hash__ = object.__hash__  # so that a list of these may be optional


def of_length(count: int, expected: str) -> BeforeValidator:
    """For a list: it has ``count`` entries, which is checked before any of them is looked at.

    Args:
        expected: What would be right, for a message.
    """

    def checked(values: Any) -> Any:
        if isinstance(values, list) and len(values) != count:
            raise ValueError(expected)
        return values

    return _Entries(checked, least=count, most=count)


class FirstOnly(FailFast):
    """For a list: only its first problem is reported, not each of a million wrong numbers."""

    __hash__ = object.__hash__  # so that a list of these may be optional


def at_most(count: int) -> BeforeValidator:
    """For a list or an object: it has at most ``count`` entries, which is checked before any of them is looked at."""

    def checked(values: Any) -> Any:
        if isinstance(values, list | dict) and len(values) > count:
            raise ValueError(f"at most {count:,} entries; there are {len(values):,}")
        return values

    return _Entries(checked, most=count)


Text = Annotated[str, Field(max_length=MAX_TEXT), AfterValidator(_printable)]
"""Without control characters, escapes and half surrogates: a terminal may print it."""

Prose = Annotated[Text, BeforeValidator(_escaped)]
"""A text for people, which is written as ``as_text`` has it."""

Count = Annotated[int, Field(ge=0, le=2**63 - 1)]
Numbers = Annotated[list[float], FirstOnly()]
Vector2 = Annotated[Numbers, of_length(2, "2 finite numbers")]
Vector3 = Annotated[Numbers, of_length(3, "3 finite numbers")]
Vector4 = Annotated[Numbers, of_length(4, "4 finite numbers")]
ONE_PER_JOINT = BeforeValidator(_one_per_joint)
Joints = Annotated[Numbers, ONE_PER_JOINT]
"""One number for each joint of the robot in the file."""

Rows = Annotated[list[Joints], FirstOnly(), at_most(MAX_WAYPOINTS)]
NamePair = Annotated[list[Text], of_length(2, "two names")]

ANNOTATIONS: Mapping[Any, Any] = MappingProxyType(
    {
        float: float,
        int: Count,
        str: Text,
        bool: bool,
        NDArray[np.float64]: Joints,
        tuple[str, str]: NamePair,
        tuple[float, float]: Vector2,
        tuple[float, float, float]: Vector3,
    }
)
"""What fields of a record are, by their types in the class that it makes."""
