"""Functions that methods of values call, and packages above provide."""

from __future__ import annotations

import sys

import planner_service
from planner_service.provided import Provided


def test_importing_the_package_provides_all_functions() -> None:
    modules = [module for name, module in sys.modules.items() if name.startswith(planner_service.__name__)]
    functions = {id(held): held for module in modules for held in vars(module).values() if isinstance(held, Provided)}
    assert len(functions) >= 7
    assert all(function.known for function in functions.values())
