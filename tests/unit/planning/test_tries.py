"""Giving up: how a search shares its states among tries, and what ends it."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest

from benchmarks.studies.problems import ROBOT, public_problems
from planner_service import PlannerService, PlanRequest, Reason
from planner_service.planning.search_stage import fresh_tries
from planner_service.search.problem import SearchProblem, SearchResult
from tests.integration.test_service import walled_in
from tests.support.optional import present


def test_the_first_tries_are_short_and_the_later_ones_twice_as_long_each() -> None:
    told = islice(fresh_tries(8_000_000, None, patience=0), 7)
    assert list(told) == [10_000, 10_000, 10_000, 10_000, 20_000, 40_000, 80_000]


def test_of_few_states_the_first_tries_have_a_fourth_each() -> None:
    assert list(islice(fresh_tries(2000, None, patience=0), 4)) == [500, 500, 500, 500]
    assert next(fresh_tries(1, None, patience=0)) == 1


def test_no_try_is_shorter_than_the_planner_wants() -> None:
    assert next(fresh_tries(8_000_000, None, patience=20_000)) == 20_000


def test_retries_that_were_asked_for_have_equal_parts() -> None:
    assert list(fresh_tries(40_000, 3, patience=0)) == [10_000] * 4
    assert list(fresh_tries(40_000, 0, patience=0)) == [40_000]


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "seed"), [("bookshelf_small/0067", 102), ("cage/0087", 100)])
def test_what_50_000_checks_do_not_solve_the_default_does(problem: str, seed: int) -> None:
    (found,) = (p for p in public_problems().problems if p.id == problem)
    service = PlannerService(ROBOT, found.scene)
    few = service.plan(found.request(service.robot, seed=seed, max_checks=50_000))
    assert present(few.failure).reason is Reason.CHECK_BUDGET_EXHAUSTED
    result, again = (service.plan(found.request(service.robot, seed=seed, **clock)) for clock in ({}, NO_CLOCK))
    assert result.unwrap()[0].waypoints.tobytes() == again.unwrap()[0].waypoints.tobytes()
    assert result.counts == again.counts
    assert result.attempts > 4
    assert result.deterministic


NO_CLOCK = {"time_limit": None}


def test_a_failure_names_the_budget_that_was_asked_for() -> None:
    result = walled_in().plan(PlanRequest((0.0, 0.0), (math.pi, 0.0), max_checks=3000, time_limit=None))
    assert "3,000 checks that may be made, 2,400 of them by a search" in present(result.failure).detail


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
    assert planner.asked == 4


def test_a_clock_that_had_no_say_changes_nothing() -> None:
    service = PlannerService("wxai", "bin")
    home, above = service.robot.home, np.array([0.8, 1.3, 1.0, -0.8, 0.0, 0.0])
    results = [service.plan(PlanRequest(home, above, seed=4, time_limit=limit)) for limit in (None, 5.0, 60.0)]
    assert len({result.unwrap()[0].waypoints.tobytes() for result in results}) == 1
    assert len({result.counts for result in results}) == 1
