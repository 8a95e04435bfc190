"""A roadmap of each kind grows, answers, learns and is updated at the cost that is pinned."""

from __future__ import annotations

import pytest

from benchmarks.harness import pinned_roadmaps
from tests.support.pinned import require_pinned


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["post", "window"])
def test_a_small_roadmap_costs_what_is_pinned(scene: str) -> None:
    require_pinned("roadmaps", pinned_roadmaps.made([scene]))
