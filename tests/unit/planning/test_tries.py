"""Giving up: how a search shares its states among tries, and what ends it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import pytest

from benchmarks.studies.problems import ROBOT, public_problems
from planner_service import (
    BalancedRRTConnect,
    PlannerService,
    PlanRequest,
    Reason,
    Roadmap,
    RRTConnect,
    Stage,
)
from planner_service.planners import RRT, Planner
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
def test_what_50_000_checks_do_not_solve_the_default_budget_does(problem: str, seed: int) -> None:
    (found,) = (p for p in public_problems().problems if p.id == problem)
    service = PlannerService(ROBOT, found.scene)
    asked = partial(
        found.request, service.robot, seed=seed, planner=RRTConnect()
    )  # the default solves both in its first try
    few = service.plan(asked(max_checks=50_000))
    assert present(few.failure).reason is Reason.CHECK_BUDGET_EXHAUSTED
    result, again = (service.plan(asked(**clock)) for clock in ({}, NO_CLOCK))
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

    for kind in (BalancedRRTConnect, RRTConnect, RRT):
        recorded(kind)
    return found


BY_TURNS = ["balancedrrtconnect", "rrtconnect"] * 2


@pytest.mark.parametrize(
    ("settings", "names"),
    [
        ({}, BY_TURNS),
        ({"planner": BalancedRRTConnect(range=0.5)}, BY_TURNS),
        ({"retries": 2}, BY_TURNS[:3]),
        ({"retries": 0}, BY_TURNS[:1]),
        ({"planner": RRTConnect()}, ["rrtconnect"] * 4),
        ({"planner": RRTConnect(), "retries": 1}, ["rrtconnect"] * 2),
        ({"planner": RRT()}, ["rrt"] * 4),
        ({"planner": Roadmap.of(np.zeros((0, 2)))}, BY_TURNS),
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


def test_what_another_algorithm_finds_is_the_plan_and_its_note_says_who_found_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(BalancedRRTConnect, "search", lambda *_: SearchResult(None))
    service = PlannerService("planar2", "discs")
    request = PlanRequest((-2.5, 2.0), (2.2, -2.2), seed=7, time_limit=None)
    result = service.plan(request)
    assert (result.ok, result.attempts) == (True, 2)
    assert result.stage(Stage.SEARCH).note == "rrtconnect, try 2"
    assert not service.plan(replace(request, retries=0)).ok


def test_a_clock_that_had_no_say_changes_nothing() -> None:
    service = PlannerService("wxai", "bin")
    home, above = service.robot.home, np.array([0.8, 1.3, 1.0, -0.8, 0.0, 0.0])
    results = [service.plan(PlanRequest(home, above, seed=4, time_limit=limit)) for limit in (None, 5.0, 60.0)]
    assert len({result.unwrap()[0].waypoints.tobytes() for result in results}) == 1
    assert len({result.counts for result in results}) == 1
