"""Functions that methods of values call, and packages above provide."""

from __future__ import annotations

import sys

import pytest

import planner_service
from planner_service.errors import BrokenInvariant
from planner_service.provided import Provided


def test_a_function_is_the_one_that_was_provided() -> None:
    doubled: Provided[[int], int] = Provided()

    @doubled.by
    def twice(number: int) -> int:
        return 2 * number

    assert (doubled(4), twice(4)) == (8, 8)


def test_a_function_that_nobody_provides_is_our_bug() -> None:
    missing: Provided[[], None] = Provided()
    with pytest.raises(BrokenInvariant, match="conveniences"):
        missing()


def test_importing_the_package_provides_all_functions() -> None:
    modules = [module for name, module in sys.modules.items() if name.startswith(planner_service.__name__)]
    functions = {id(held): held for module in modules for held in vars(module).values() if isinstance(held, Provided)}
    assert len(functions) >= 7
    assert all(function.known for function in functions.values())
