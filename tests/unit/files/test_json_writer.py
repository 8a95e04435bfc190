"""JSON texts with indents."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner_service.files.json_writer import indented_json

finite = st.floats(allow_nan=False, allow_infinity=False)
plain = st.recursive(
    st.none() | st.booleans() | st.integers() | finite | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.lists(finite),
    max_leaves=20,
)


@given(plain)
def test_a_text_is_what_the_standard_library_writes(value: object) -> None:
    assert indented_json(value) == json.dumps(value, indent=1)


@given(plain)
def test_a_text_within_another_one_is_indented_as_there(value: object) -> None:
    assert "{\n " + f'"key": {indented_json(value, 1)}' + "\n}" == json.dumps({"key": value}, indent=1)


def test_what_json_does_not_have_is_refused() -> None:
    for value in (math.nan, [1.0, math.inf], {"key": -math.inf}):
        with pytest.raises(ValueError, match="not in JSON"):
            indented_json(value)
    with pytest.raises(TypeError, match="complex is not in JSON"):
        indented_json({"key": [1j]})
