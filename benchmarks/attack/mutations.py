"""Files made wrong: bytes, words, lines, and the structure of JSON; each as a file's next reader might get it."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["changed"]

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]+")

_NUMBERS = (
    *(b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"1e999", b"9" * 400, b"2147483648"),
    *(b"18446744073709551616", b"0x10", b"1_0", b"", b"-0.0", b"true", b'"1"', b"[]", b"1e3", b"0.001", b"1" * 5000),
)
_WORDS = (
    *(b"", b"true", b"null", b"link_1", b"\xff\xfe", b"\\u0000", b"\\ud800", b"../../etc/passwd", b"/dev/zero"),
    *(b"a" * 10_000, b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&b;", b"\x1b[2J", b"universe", b"\0"),
)
_VALUES: tuple[Any, ...] = (
    *(None, True, 0, -1, 1e308, 10**400, 0.5, "", "text", "link_1", "\ud800", "a\0b", [], {}, [[]], {"a": 1}),
    *([1, 2, 3], *[None] * 7, float("nan"), float("inf"), "x" * 5000, 2**63, -0.0, "1", [0.1] * 6),
)

Mutation = Callable[[bytes, np.random.Generator], bytes]


def _at(rng: np.random.Generator, data: bytes) -> int:
    return int(rng.integers(len(data) + 1))


def _pick(rng: np.random.Generator, some: Any) -> Any:
    return some[int(rng.integers(len(some)))]


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if out:
            out[int(rng.integers(len(out)))] = int(rng.integers(256))
    return bytes(out)


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _at(rng, data)]


def _without(data: bytes, rng: np.random.Generator) -> bytes:
    at = _at(rng, data)
    return data[:at] + data[at + int(2 ** rng.uniform(0, 12)) :]


def _grown(data: bytes, rng: np.random.Generator) -> bytes:
    at = _at(rng, data)
    piece = data[at : at + int(2 ** rng.uniform(0, 8))]
    return data[:at] + piece * int(2 ** rng.uniform(0, 7)) + data[at:]


def _encoded(data: bytes, rng: np.random.Generator) -> bytes:
    how = int(rng.integers(5))
    if how == 0:
        return b"\xef\xbb\xbf" + data
    if how == 1:
        return data.decode("latin-1").encode("utf-16")
    if how == 2:
        return data.replace(b"\n", b"\r")
    if how == 3:
        return data.replace(b" ", b"\xc2\xa0", 3)
    return data + b"\0" * int(rng.integers(1, 5000))


def _replaced(data: bytes, rng: np.random.Generator, what: re.Pattern[bytes], others: tuple[bytes, ...]) -> bytes:
    head = data if len(data) < 60_000 else data[(start := _at(rng, data)) : start + 60_000]
    found = list(what.finditer(head))
    if not found:
        return _flipped(data, rng)
    shift = data.find(head)
    spot = _pick(rng, found)
    value: bytes = _pick(rng, others) if rng.random() < 0.8 else _pick(rng, found).group()
    return data[: shift + spot.start()] + value + data[shift + spot.end() :]


def _number(data: bytes, rng: np.random.Generator) -> bytes:
    return _replaced(data, rng, _NUMBER, _NUMBERS)


def _word(data: bytes, rng: np.random.Generator) -> bytes:
    return _replaced(data, rng, _WORD, _WORDS)


def _lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    k, m = (int(rng.integers(len(lines))) for _ in range(2))
    how = int(rng.integers(4))
    if how == 0:
        lines[k], lines[m] = lines[m], lines[k]
    elif how == 1:
        del lines[k]
    elif how == 2:
        lines.insert(m, lines[k])
    else:
        lines[k:k] = [lines[k]] * int(2 ** rng.uniform(0, 9))
    return bytes(b"\n".join(lines))


def _deep(data: bytes, rng: np.random.Generator) -> bytes:
    """Brackets, dotted keys and elements nested deeply, somewhere."""
    depth, at = int(2 ** rng.uniform(3, 13)), _at(rng, data)
    opened: bytes
    closed: bytes
    opened, closed = _pick(rng, ((b"[", b"]"), (b'{"a":', b"}"), (b"<a>", b"</a>"), (b"a.", b"b = 1\n"), (b"(", b")")))
    if opened == b"a.":
        line = data.rfind(b"\n", 0, at) + 1
        return data[:line] + opened * depth + closed + data[line:]
    return data[:at] + opened * depth + closed * (depth if rng.random() < 0.5 else 0) + data[at:]


BYTES: tuple[Mutation, ...] = (_flipped, _cut, _without, _grown, _encoded)
TEXT: tuple[Mutation, ...] = (*BYTES[:3], _number, _number, _number, _word, _word, _lines, _lines, _deep, *BYTES[3:])


def _paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    out = [path]
    items = value.items() if isinstance(value, dict) else enumerate(value[:12]) if isinstance(value, list) else ()
    for key, inner in items:
        out += _paths(inner, (*path, key))
    return out


def _structured(tree: Any, rng: np.random.Generator) -> bytes:
    """A JSON document one of whose parts is gone, another, twice there, or of another kind."""
    tree, paths = copy.deepcopy(tree), _paths(tree)[1:]
    for _ in range(int(rng.choice((1, 1, 2)))):
        path = _pick(rng, paths)
        place = tree
        try:
            for key in path[:-1]:
                place = place[key]
            how = int(rng.integers(5))
            if how == 0:
                del place[path[-1]]
            elif how == 1 and isinstance(place, list):
                place.insert(path[-1], place[path[-1]])
            elif how == 2 and isinstance(place, dict):
                place[str(_pick(rng, ("a", "", "x" * 300, "\ud800", *place)))] = place[path[-1]]
            elif how == 3 and isinstance(place[path[-1]], float):
                place[path[-1]] *= float(rng.choice((-1.0, 1.0 + 1e-9, 1e3, 1e-3, 1e300)))
            else:
                place[path[-1]] = copy.deepcopy(_pick(rng, _VALUES))
        except (KeyError, IndexError, TypeError):
            continue
    text = json.dumps(tree)
    if rng.random() < 0.05:  # a key that is there twice
        key = _pick(rng, re.findall(r'"\w+": ', text) or ["a"])
        text = text.replace(key, f"{key}null, {key}", 1)
    return text.encode("utf-8", "surrogatepass")


def changed(data: bytes, rng: np.random.Generator, tree: Any = None, *, text: bool = True) -> bytes:
    """A file's content made wrong once or twice; ``tree`` is what a JSON file holds."""
    if tree is not None and rng.random() < 0.6:
        return _structured(tree, rng)
    for _ in range(int(rng.choice((1, 1, 2)))):
        data = _pick(rng, TEXT if text else BYTES)(data, rng)
    return data
