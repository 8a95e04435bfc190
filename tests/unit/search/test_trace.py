"""How a search went is told when asked for, and changes nothing; where a result comes from is known."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from planner_service import PlannerService, PlanRequest, PlanResult
from planner_service.planners import PLANNERS
from planner_service.search.trace import Trace
from tests.support.optional import present


def asked(service: PlannerService, **settings: object) -> PlanRequest:
    poses = service.robot.poses
    given = {"start": poses["lesson_start"], "goal": poses["lesson_goal"], "time_limit": None, **settings}
    return PlanRequest(**given)  # type: ignore[arg-type]


def trace_of(result: PlanResult) -> Trace:
    return present(result.trace)


def bits(result: PlanResult) -> Iterator[bytes]:
    path, trajectory = result.unwrap()
    for array in (path.waypoints, path.blends, trajectory.durations, trajectory.coefficients):
        yield array.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["balancedrrtconnect", "rrtconnect", "bitstar", "prm"])
def test_a_traced_plan_has_the_same_counts_and_bits(discs: PlannerService, planner: str) -> None:
    request = asked(discs, planner=PLANNERS[planner]())
    plain, traced = discs.plan(request), discs.plan(request, trace=True)
    assert plain.trace is None
    assert [report.counts for report in traced.stages] == [report.counts for report in plain.stages]
    assert list(bits(traced)) == list(bits(plain))


@pytest.mark.parametrize("planner", ["balancedrrtconnect", "rrtconnect", "rrtstar", "kpiece1", "fmt"])
def test_what_a_search_grew_joins_its_ends(discs: PlannerService, planner: str) -> None:
    trace = trace_of(discs.plan(asked(discs, planner=PLANNERS[planner]()), trace=True))
    graph, found = present(trace.graph), present(trace.searched).tolist()
    assert graph.edges.min() >= 0
    assert graph.edges.max() < len(graph.milestones)
    places = {tuple(q) for q in graph.milestones.tolist()}
    assert {tuple(found[0]), tuple(found[-1])} <= places


def test_the_path_found_runs_along_the_tree(discs: PlannerService) -> None:
    trace = trace_of(discs.plan(asked(discs), trace=True))
    numbers = {tuple(q): k for k, q in enumerate(present(trace.graph).milestones.tolist())}
    edges = {frozenset(edge) for edge in present(trace.graph).edges.tolist()}
    pieces = [frozenset(numbers[tuple(q)] for q in piece) for piece in pairwise(present(trace.searched).tolist())]
    assert len([piece for piece in pieces if piece not in edges]) <= 1  # where the two trees met


def test_a_result_knows_who_planned_it_and_what_was_asked(discs: PlannerService) -> None:
    request = asked(discs)
    result = discs.plan(request)
    assert (present(result.origin).world, present(result.origin).request) == (discs.world, request)
    line = discs.follow(np.array([request.start, np.array(request.start) + 0.01]))
    assert (present(line.origin).world, present(line.origin).request) == (discs.world, None)


def test_a_result_sent_to_another_process_goes_without_its_service(discs: PlannerService) -> None:
    result = discs.plan(asked(discs))
    again = pickle.loads(pickle.dumps(result))
    assert again.origin is None
    assert list(bits(again)) == list(bits(result))
