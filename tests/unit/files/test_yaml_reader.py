"""YAML as plain values: what other readers take in silence is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service.errors import InvalidFile
from planner_service.files.yaml_reader import parse_yaml

FILE = Path("f.yaml")


def test_numbers_are_numbers_however_they_are_written() -> None:
    assert parse_yaml(FILE, b"[1e-05, -2E3, +.5, 3., 7, 1.5e-3]") == [1e-05, -2000.0, 0.5, 3.0, 7, 1.5e-3]
    assert parse_yaml(FILE, b"a: {b: [x, true, null]}") == {"a": {"b": ["x", True, None]}}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"a: 1\nb: 2\na: 3", "key 'a' twice, line 3"),
        (b"a: &x [1]\nb: *x", r"an alias, \*x, in line 2"),
        (b"a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        (b"[" * 200 + b"]" * 200, "nested more than 100 deep"),
        (b"a: [1, 2", "malformed YAML"),
        (b"a: \xff", "not UTF-8: byte 0xff at 3"),
    ],
)
def test_what_may_mean_something_else_is_refused(text: bytes, problem: str) -> None:
    with pytest.raises(InvalidFile, match=problem):
        parse_yaml(FILE, text)
