"""Shorter paths by further searches: what a request's ``improve`` promises."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.harness.suite import PUBLIC
from planner_service import InvalidRequest, Optimise, PlannerService, PlanRequest, Pose, Roadmap, RRTConnect, Stage
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import search_stage
from planner_service.planning.polishing import nearer
from planner_service.planning.result import ImproveReport
from planner_service.records import read_problems
from tests.support.discs import DiscWorld, across
from tests.support.optional import present


def cage(number: str) -> tuple[PlannerService, PlanRequest]:
    problem = read_problems(PUBLIC).problem(f"cage/{number}")
    service = PlannerService("panda_mbm", problem.scene)
    return service, problem.request(service.robot, time_limit=None)


def test_a_long_path_gets_shorter_and_the_result_says_by_how_much() -> None:
    service, request = cage("0097")
    before, after = (present(service.plan(replace(request, improve=rounds)).path) for rounds in (0, 4))
    result = service.plan(replace(request, improve=4))
    report = present(result.improvement)
    assert after.length < 0.95 * before.length
    assert report.rounds == 4
    assert report.bound == pytest.approx(math.dist(before.waypoints[0], before.waypoints[-1]))
    assert [report.before, report.after] == pytest.approx([before.length, after.length])
    assert report.bound < report.after
    assert present(result.certificate).certified
    assert result.stage(Stage.IMPROVE).counts.states > 0
    assert result.stage(Stage.SEARCH).counts == service.plan(request).stage(Stage.SEARCH).counts


def test_a_long_path_is_searched_again_by_default_and_the_stage_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    service, request = cage("0077")
    result = service.plan(request)
    others = service.plan(replace(request, planner=RRTConnect()))
    monkeypatch.setattr(search_stage, "LONG", math.inf)
    alone = service.plan(request)
    assert "searched again" in result.stage(Stage.SHORTCUT).note
    assert "searched again" not in others.stage(Stage.SHORTCUT).note
    assert present(result.path).length < 0.9 * present(alone.path).length
    assert result.stage(Stage.SEARCH).counts == alone.stage(Stage.SEARCH).counts
    assert result.stage(Stage.SHORTCUT).counts.states > alone.stage(Stage.SHORTCUT).counts.states


def test_the_same_request_gives_the_same_path_and_more_rounds_no_longer_one() -> None:
    service, request = cage("0097")
    one, again, more = (service.plan(replace(request, improve=rounds)) for rounds in (2, 2, 3))
    assert present(one.path).waypoints.tolist() == present(again.path).waypoints.tolist()
    assert one.counts == again.counts
    assert one.deterministic
    assert present(more.improvement).after <= present(one.improvement).after


def test_no_round_begins_where_nothing_can_be_gained() -> None:
    service, request = cage("0097")
    line = replace(request, goal=np.array(request.start) + 0.01, improve=9)
    assert service.plan(line).improvement is None
    assert ImproveReport(3, 5.0, 4.0, 4.0).gain == 0.0
    assert ImproveReport(3, 5.0, 4.0, 3.0).gain == 0.25
    assert ImproveReport(0, 0.0, 0.0, 0.0).gain == 0.0


def test_a_limit_of_checks_ends_the_rounds_and_not_the_plan() -> None:
    service, request = cage("0097")
    spent = service.plan(request).counts.states
    result = service.plan(replace(request, improve=50, max_checks=2 * spent))
    assert result.ok
    assert "not improved further" in result.stage(Stage.IMPROVE).note
    assert result.counts.states <= 2 * spent


def test_the_rounds_of_a_roadmap_search_without_it() -> None:
    service, request = cage("0097")
    roadmap = Roadmap.of(np.zeros((0, service.robot.n)))
    result = service.plan(replace(request, planner=roadmap, improve=2))
    assert result.ok
    assert present(result.improvement).rounds == 2


def test_an_optimisation_of_lines_searches_nothing_that_could_be_improved() -> None:
    with pytest.raises(InvalidRequest, match=r"improve.*0: the planner optimises"):
        PlanRequest((0.0,), (1.0,), planner=Optimise(), improve=1)
    with pytest.raises(InvalidRequest, match="improve"):
        PlanRequest((0.0,), (1.0,), improve=-1)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6), longer=st.floats(1.001, 2.0))
def test_what_a_shorter_path_can_pass_is_in_the_box_that_is_searched(seed: int, longer: float) -> None:
    problem = across(DiscWorld(), n=3, goals=((2.0, 0.1),))
    start, goal = problem.start, problem.goals[0]
    length = longer * math.dist(start, goal)
    box = nearer(problem, length)
    between = on_ellipsoid(np.random.default_rng(seed), start, goal, length)
    inside = (problem.lower <= between) & (between <= problem.upper)
    assert ((box.lower - 1e-9 <= between) & (between <= box.upper + 1e-9))[inside].all()
    assert (box.lower >= problem.lower).all()
    assert (box.upper <= problem.upper).all()


def on_ellipsoid(rng: np.random.Generator, start: FloatArray, goal: FloatArray, length: float) -> FloatArray:
    """A point whose distances to two others add up to ``length``: from the start, in a random direction."""
    way = rng.normal(size=len(start))
    way /= math.dist(way, np.zeros(len(way)))
    apart = goal - start  # |r way| + |apart - r way| = length
    r = (length * length - float(apart @ apart)) / (2.0 * (length - float(apart @ way)))
    point: FloatArray = start + r * way
    return point


@pytest.mark.parametrize("more", [200, 300])
def test_a_limit_that_is_met_while_a_path_is_shortened_leaves_the_path(more: int) -> None:
    service = PlannerService("wxai", "bin")
    goal = Pose((0.20, 0.28, 0.15), (0.5**0.5, 0.0, 0.5**0.5, 0.0))
    request = PlanRequest(service.robot.home, goal, seed=7, time_limit=None)
    whole, first = service.plan(request), (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH)
    before = sum(report.counts.states for report in whole.stages if report.stage in first)
    result = service.plan(replace(request, max_checks=before + more))
    assert result.ok
    assert "not shortened" in result.stage(Stage.SHORTCUT).note
