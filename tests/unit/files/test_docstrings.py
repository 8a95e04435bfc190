"""What docstrings say of fields."""

from __future__ import annotations

from planner_service.files.docstrings import fields_documented, in_json, summary


class Base:
    """A base.

    Args:
        first: The first,
            and more of it: here.
        second, third: Both.
    """


class Derived(Base):
    """A derived one.

    More of it.

    Attributes:
        second: Its own; None for none.

    Raises:
        KeyError: never.
    """


def test_sections_of_a_class_and_its_bases_say_what_fields_are() -> None:
    expected = {"first": "The first, and more of it: here.", "second": "Its own; None for none.", "third": "Both."}
    assert fields_documented(Derived) == expected


def test_the_rest_says_what_the_class_is() -> None:
    assert summary(Derived) == "A derived one.\n\nMore of it."
    assert summary(type("Bare", (Base,), {})) == ""


def test_json_has_its_own_words() -> None:
    assert in_json("``x`` is None, True or NoneType") == "`x` is null, true or NoneType"
