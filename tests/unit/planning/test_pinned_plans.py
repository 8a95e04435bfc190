"""A plan of each kind costs what is pinned."""

from __future__ import annotations

import pytest

from benchmarks.harness import pinned_cases
from tests.support.pinned import require_pinned


@pytest.mark.slow
@pytest.mark.parametrize("name", pinned_cases.PLANS)
def test_a_plan_costs_what_is_pinned(name: str) -> None:
    require_pinned("cases", pinned_cases.made([name]))
