"""Giving up: how a search shares its states among tries, and what ends it."""

from __future__ import annotations

import math
from itertools import islice
from typing import Any

import numpy as np
import pytest

from planner_service import BalancedRRTConnect, PlanRequest, Reason, Roadmap, RRTConnect, Stage
from planner_service.planners import Planner
from planner_service.planning.search_stage import fresh_tries
from planner_service.search.problem import SearchProblem, SearchResult
from tests.integration.test_service import walled_in
from tests.support.optional import present


def test_each_try_is_twice_as_long_as_the_last_but_one_and_every_second_a_third_of_the_one_before() -> None:
    told = islice(fresh_tries(8_000_000, None, patience=0), 6)
    assert list(told) == [30_000, 10_000, 60_000, 20_000, 120_000, 40_000]
    assert list(islice(fresh_tries(2000, None, patience=0), 2)) == [1500, 500]
    assert list(islice(fresh_tries(1, None, patience=0), 2)) == [1, 1]
    told = islice(fresh_tries(8_000_000, None, patience=20_000), 3)
    assert list(told) == [30_000, 20_000, 60_000], "no less than the planner wants"
    assert list(fresh_tries(40_000, 3, patience=0)) == [10_000] * 4, "retries that were asked for have equal parts"
    assert list(fresh_tries(40_000, 0, patience=0)) == [40_000]


class Quitter:
    """A planner that never finds anything, and asks nothing."""

    name = "quitter"
    patience = 0
    asked = 0

    def search(self, problem: SearchProblem) -> SearchResult:
        self.asked += 1
        return SearchResult(None)


def test_a_planner_that_ends_by_itself_is_not_asked_for_ever() -> None:
    planner = Quitter()
    result = walled_in().plan(PlanRequest((0.0, 0.0), (math.pi, 0.0), planner=planner, time_limit=None))
    assert present(result.failure).reason is Reason.PLANNING_FAILED
    assert planner.asked == 2


# -- who is asked ----------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """The planner and the seed of each try from now on."""
    found: list[tuple[str, int]] = []

    def recorded(kind: Any) -> None:
        honest = kind.search

        def search(self: Planner, problem: SearchProblem) -> SearchResult:
            found.append((self.name, problem.seed))
            result: SearchResult = honest(self, problem)
            return result

        monkeypatch.setattr(kind, "search", search)

    for kind in (BalancedRRTConnect, RRTConnect):
        recorded(kind)
    return found


BY_TURNS = ["balancedrrtconnect", "rrtconnect"] * 2


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({}, BY_TURNS[:2]),
        ({"retries": 2}, BY_TURNS[:3]),
        ({"retries": 0}, BY_TURNS[:1]),
        ({"planner": RRTConnect()}, ["rrtconnect"] * 2),
        ({"planner": Roadmap.of(np.zeros((0, 2)))}, BY_TURNS[:2]),
    ],
)
def test_every_second_try_of_the_default_is_another_algorithm_and_every_other_planner_stays_alone(
    settings: dict[str, Any], names: list[str], asked: list[tuple[str, int]]
) -> None:
    request = PlanRequest((0.0, 0.0), (math.pi, 0.0), max_checks=3000, time_limit=None, padding=0.0, **settings)
    result = walled_in().plan(request)
    assert not result.ok
    assert [name for name, _ in asked] == names
    assert len({seed for _, seed in asked}) == len(names)
    assert result.stage(Stage.SEARCH).note.endswith(names[-1] + (f", try {len(names)}" if len(names) > 1 else ""))
