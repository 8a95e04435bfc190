"""Values that are computed once, however many threads wait for them."""

from __future__ import annotations

import threading

import pytest

from planner_service.concurrency.polling import Prepared, asking


class Over(Exception):
    """The call's time is over."""


@pytest.mark.parametrize("quick", [False, True])
def test_a_value_is_computed_once_when_it_is_first_asked_for(quick: bool) -> None:
    made: list[int] = []
    value = Prepared(lambda: made.append(1) or len(made), quick=quick)  # type: ignore[func-returns-value]
    assert not made
    assert [value.get(), value.get()] == [1, 1]


@pytest.mark.parametrize("quick", [False, True])
def test_what_computing_it_raises_comes_out(quick: bool) -> None:
    value = Prepared(lambda: 1 / 0, quick=quick)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            value.get()


def test_a_call_that_is_over_leaves_a_long_computation_to_the_next() -> None:
    going, made = threading.Event(), list[int]()

    def make() -> int:
        going.wait(20.0)
        made.append(1)
        return len(made)

    def over() -> None:
        raise Over

    value = Prepared(make)
    asking.ask = over
    try:
        with pytest.raises(Over):
            value.get()
    finally:
        asking.ask = None
    going.set()
    assert value.get() == 1
