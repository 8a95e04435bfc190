"""Many plans: the same as one by one, whoever makes them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from benchmarks.worlds import queries
from planner_service import (
    PRM,
    InvalidRequest,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Roadmap,
    SCurve,
)
from planner_service.parallel import Answers, Engine, Limit, Lost, Processes, Sequential
from planner_service.planning import Interrupted
from planner_service.records.result import result_record
from tests.support.optional import present


@pytest.fixture(scope="module")
def service() -> PlannerService:
    return PlannerService("wxai", "post")


@pytest.fixture(scope="module")
def roadmap(service: PlannerService) -> Roadmap:
    return service.build_roadmap(PRM(milestones=60), progress=False)


def asked(number: int, **given: Any) -> PlanRequest:
    found = queries.load("post")[number]
    return PlanRequest(found.start, found.goal, **({"time_limit": None} | given))


def mixture(roadmap: Roadmap) -> list[PlanRequest]:
    """Plans and failures of many kinds."""
    ends = [queries.load("post")[k].goal for k in (1, 2)]
    return [
        *(asked(number, seed=number) for number in range(5)),
        asked(0, planner=roadmap),
        asked(1, planner=replace(roadmap, remember=True)),
        asked(2, planner=roadmap),
        asked(3, polish=Optimise(waypoints=30)),
        asked(4, timing=SCurve(), max_tool_speed=0.2),
        replace(asked(0), goal=Pose((0.3, 0.2, 0.2), (0.7071067811865476, 0.0, 0.7071067811865475, 0.0))),
        replace(asked(0), goal=ends),
        replace(asked(0), goal=np.zeros(6)),
        replace(asked(0), start=(0.0, 1.5, 0.1, 0.0, 0.0, 0.0)),
        replace(asked(0), goal=(9.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        asked(0, max_checks=50),
    ]


def told(result: PlanResult) -> str:
    """All of a result, floats to the last bit, but the wall time."""
    record = result_record(result)
    for stage in record["stages"]:
        del stage["seconds"]
    return json.dumps(record)


@dataclass
class Rehearsed:
    """An engine that remembers what it was given, and answers what it was told to."""

    answers: list[PlanResult | Lost | KeyboardInterrupt] = field(default_factory=list)
    finished: dict[int, PlanResult | Lost] = field(default_factory=dict)
    work: Any = None
    items: list[Any] = field(default_factory=list)
    limits: list[float | None] = field(default_factory=list)

    def run(self, work: Any, items: Iterable[Any], *, limit: Limit[Any] | None = None) -> Answers[Any]:
        assert limit is not None
        self.work, self.items = work, list(items)
        self.limits = [limit(item) for item in self.items]
        return _Said(self.answers, self.finished)


class _Said:
    def __init__(self, answers: Iterable[Any], finished: Mapping[int, Any]) -> None:
        self.finished, self._answers = finished, enumerate(answers)

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        return self

    def __next__(self) -> tuple[int, Any]:
        index, answer = next(self._answers)
        if isinstance(answer, KeyboardInterrupt):
            raise answer
        return index, answer

    def close(self) -> None:
        self._answers = enumerate(())


def equal(service: PlannerService, roadmap: Roadmap, engine: Engine | None) -> bool:
    requests = mixture(roadmap)
    alone = [service.plan(request) for request in requests]
    assert {result.ok for result in alone} == {True, False}
    assert any(result.failure is not None and result.failure.nearest_free is not None for result in alone)
    many = service.plan_many(requests, engine=engine, progress=False)
    assert all(result.path is None or not result.path.waypoints.flags.writeable for result in many)
    assert [present(result.origin).request for result in many] == requests
    return [told(result) for result in many] == [told(result) for result in alone]


@pytest.mark.slow
def test_plans_are_those_of_one_by_one(service: PlannerService, roadmap: Roadmap) -> None:
    assert equal(service, roadmap, Processes(2))


@pytest.mark.parametrize(
    ("bad", "named"),
    [
        ("a plan", r"^requests\[1\]: got 'a plan'; expected a PlanRequest"),
        (asked(0, planner=Roadmap.of(np.zeros((1, 3)))), r"^requests\[1\]\.planner: got 'a roadmap of 3 joints'"),
        (PlanRequest((0.0,), (1.0,)), r"^requests\[1\]\.start: got 'shape \(1,\)'"),
    ],
)
def test_a_bad_request_is_named_before_anything_starts(service: PlannerService, bad: Any, named: str) -> None:
    rehearsed = Rehearsed()
    with pytest.raises(InvalidRequest, match=named):
        service.plan_many([asked(0), bad], engine=rehearsed)
    assert rehearsed.work is None


def test_what_is_no_sequence_of_requests_or_no_engine_is_refused(service: PlannerService) -> None:
    with pytest.raises(InvalidRequest, match=r"^requests: "):
        service.plan_many(asked(0))  # type: ignore[arg-type]
    with pytest.raises(InvalidRequest, match=r"^engine: got .*; expected an engine such as Processes\(\), or None"):
        service.plan_many([asked(0)], engine=Processes)  # type: ignore[arg-type]


def test_a_roadmap_is_sent_once_and_none_comes_back(service: PlannerService, roadmap: Roadmap) -> None:
    rehearsed = Rehearsed()
    other = replace(roadmap, remember=True)
    service.plan_many([asked(k, planner=roadmap if k else other) for k in range(4)], engine=rehearsed, progress=False)
    assert rehearsed.work.roadmaps == (other, roadmap)
    assert [place for _, place in rehearsed.items] == [0, 1, 1, 1]
    assert not any(isinstance(request.planner, Roadmap) for request, _ in rehearsed.items)
    [result] = service.plan_many([asked(0, planner=other)], engine=Sequential(), progress=False)
    assert result.roadmap is None
    assert result.ok


def test_a_lost_worker_is_a_failure(service: PlannerService) -> None:
    lost = Rehearsed([Lost("it was ended by SIGSEGV"), Lost("its worker was ended", over_limit=True)])
    first, second = service.plan_many([asked(0), asked(1)], engine=lost, progress=False)
    assert (present(first.failure).reason, present(second.failure).reason) == (Reason.WORKER_LOST, Reason.TIMED_OUT)
    assert present(first.failure).detail == "it was ended by SIGSEGV"
    assert present(second.failure).detail == (
        "its worker was ended, 10 s after its time limit; whether a path exists is unknown"
    )
    assert not first.deterministic


def test_what_is_finished_is_kept_when_interrupted(service: PlannerService) -> None:
    done = service.plan(asked(0))
    engine = Rehearsed([done, KeyboardInterrupt()], {0: done, 3: done})
    with pytest.raises(Interrupted, match="2 results were finished") as raised:
        service.plan_many([asked(k) for k in range(5)], engine=engine, progress=False)
    assert {index: result.path for index, result in raised.value.results.items()} == {0: done.path, 3: done.path}


def test_what_was_interrupted_goes_on_with_what_is_left(service: PlannerService) -> None:
    requests = [asked(k) for k in range(5)]
    first = service.plan(requests[0])
    interrupting = Rehearsed([first, KeyboardInterrupt()], {3: service.plan(requests[3])})
    with pytest.raises(Interrupted) as raised:
        service.plan_many(requests, engine=interrupting, progress=False)
    again = Rehearsed([service.plan(requests[1]), KeyboardInterrupt()], {})
    with pytest.raises(Interrupted, match="3 results") as raised_again:
        service.plan_many(requests, engine=again, progress=False, finished=raised.value.results)
    assert [request for request, _ in again.items] == [requests[k] for k in (1, 2, 4)]
    results = service.plan_many(requests, engine=Sequential(), progress=False, finished=raised_again.value.results)
    whole = service.plan_many(requests, engine=Sequential(), progress=False)
    assert [present(result.path).waypoints.tolist() for result in results] == [
        present(result.path).waypoints.tolist() for result in whole
    ]
    assert [result.counts for result in results] == [result.counts for result in whole]


@pytest.mark.parametrize(
    ("finished", "message"),
    [
        ({2: None}, r"^finished\[2\]: got None; expected results by the index of their request, 0 to 1"),
        ({-1: None}, r"^finished\[-1\]"),
        ({"0": None}, r"^finished\['0'\]"),
        ([1], r"^finished: got \[1\]"),
    ],
)
def test_finished_results_are_results_by_the_index_of_a_request(
    service: PlannerService, finished: Any, message: str
) -> None:
    with pytest.raises(InvalidRequest, match=message):
        service.plan_many([asked(0), asked(1)], engine=Sequential(), progress=False, finished=finished)


def test_a_request_that_is_refused_keeps_its_index(service: PlannerService) -> None:
    done = service.plan(asked(0))
    wrong = replace(asked(0), start=(0.0,))
    with pytest.raises(InvalidRequest, match=r"^requests\[1\]\.start"):
        service.plan_many([asked(0), wrong], engine=Sequential(), progress=False, finished={0: done})
