"""A text of many numbers is read as each of its words would be."""

from __future__ import annotations

from collections.abc import Callable

from planner_service.files.numerals import MAX_CHARACTERS, plain_float, plain_floats, plain_int, plain_ints

INTEGERS = ("0", "-7", "+12", "999999999", "0000000001", "1000000000", "1_0", "٣", "1.0", "0x5", "1e3")
LONG = "0." + "1" * (MAX_CHARACTERS - 2)
FLOATS = ("0", "-7.5", "1e400", "nan", "-inf", LONG, LONG + "1", "1_0.5", "٣.5", "0x5", "1,5", "1e")


def told(read: Callable[[str], object], text: str) -> str:
    """What is read, or what is wrong with it."""
    try:
        return repr(read(text))
    except ValueError as error:
        return str(error)


def test_numbers_among_others_are_read_as_each_is_alone() -> None:
    for word in INTEGERS:
        alone = told(plain_int, word)
        assert told(plain_ints, f" 4\n{word}\t-5 ") in (alone, f"[4, {alone}, -5]")
    for word in FLOATS:
        alone = told(plain_float, word)
        assert told(plain_floats, f" 4\n{word}\t-5 ") in (alone, f"[4.0, {alone}, -5.0]")
