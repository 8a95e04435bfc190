"""A time limit and a token reach every stage: what takes long, planted, is left to itself when the call is over."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy import spatial
from scipy.spatial import cKDTree

from planner_service import (
    PRM,
    CancelToken,
    LazyPRM,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Reason,
    Sphere,
    ToppRa,
    service,
)
from planner_service.certify import Certifier
from planner_service.collision import Cancelled, checker
from planner_service.collision.backends import make_backend
from planner_service.planning import Pace
from planner_service.replanning import Outcome
from tests.support.optional import present

START, GOAL = (-2.5, 2.0), (2.2, -2.2)

WAIT = 20.0
"""Seconds that a planted part takes at most, which a call that waits for it needs, too."""


class After(CancelToken):
    """A token that is cancelled when it has been looked at so many times."""

    def __init__(self, looks: int) -> None:
        super().__init__()
        self.left = looks

    @property
    def cancelled(self) -> bool:
        self.left -= 1
        return self.left < 0


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """What planted parts wait for; open when the test is over."""
    event = threading.Event()
    yield event
    event.set()


def held_up(gate: threading.Event, make: Callable[..., Any], made: list[object]) -> Callable[..., Any]:
    """``make``, which waits for the gate first; how often is in ``made``."""

    def slow(*given: Any, **named: Any) -> Any:
        made.append(None)
        gate.wait(WAIT)
        return make(*given, **named)

    return slow


def request(**settings: Any) -> PlanRequest:
    return PlanRequest(START, GOAL, **settings)


@pytest.mark.parametrize("looks", [0, 1, 50])
def test_a_roadmap_is_not_grown_on_when_its_token_is_cancelled(looks: int) -> None:
    whole = PlannerService("planar2", "discs").build_roadmap(PRM(milestones=100))
    here = PlannerService("planar2", "discs")
    with pytest.raises(Cancelled):
        here.build_roadmap(PRM(milestones=100), cancel=After(looks))
    assert here.checker.counts.states < present(whole.built).counts.states / 2
    again = here.build_roadmap(PRM(milestones=100))
    assert again.edges.tolist() == whole.edges.tolist()
    assert again.built == present(whole.built)


@pytest.mark.parametrize("looks", [0, 1, 5])
def test_a_roadmap_is_not_updated_on_when_its_token_is_cancelled(looks: int) -> None:
    here = PlannerService("planar2", "discs")
    roadmap = here.build_roadmap(PRM(milestones=100))
    other = here.with_scene(here.scene.with_obstacle(Obstacle("new", Sphere(0.3), Pose((0.9, 0.0, 0.0)))))
    whole = other.update_roadmap(roadmap)
    before = other.checker.counts
    with pytest.raises(Cancelled):
        other.update_roadmap(roadmap, cancel=After(looks))
    assert (other.checker.counts - before).states < whole.counts.states
    again = other.update_roadmap(roadmap)
    assert (again.counts, str(again)) == (whole.counts, str(whole))


def test_a_lazy_roadmap_with_many_neighbours_is_left_within_a_block(monkeypatch: pytest.MonkeyPatch) -> None:
    token, queries = CancelToken(), list[int]()

    class Tree(cKDTree):  # type: ignore[misc]
        def query(self, rows: Any, **settings: Any) -> Any:
            queries.append(len(rows))
            token.cancel()
            return super().query(rows, **settings)

    monkeypatch.setattr(spatial, "cKDTree", Tree)
    planner = LazyPRM(milestones=20_000, neighbours=20)
    result = PlannerService("planar2", "discs").plan(request(planner=planner), cancel=token)
    assert present(result.failure).reason is Reason.PREEMPTED
    assert len(queries) == 1
    assert queries[0] <= 1_000


@pytest.mark.slow
def test_the_proof_is_prepared_once_and_within_the_time_limit(
    gate: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = list[object]()
    monkeypatch.setattr(checker, "FEW_PAIRS", 0)  # those of many take long enough to be left
    monkeypatch.setattr(service, "Certifier", held_up(gate, Certifier, made))
    here = PlannerService("planar2", "discs")
    for _ in range(2):
        assert "time limit" in str(here.plan(request(time_limit=0.3)).failure)
    gate.set()
    assert here.plan(request(time_limit=WAIT)).ok
    assert len(made) == 1


@pytest.mark.slow
def test_the_clock_of_a_replan_runs_while_the_proof_is_prepared(monkeypatch: pytest.MonkeyPatch) -> None:
    here = PlannerService("planar2", "discs")
    before = here.plan(request())
    never = threading.Event()

    def slow(*given: Any, **named: Any) -> Certifier:
        never.wait(0.5)
        return Certifier(*given, **named)

    monkeypatch.setattr(service, "Certifier", slow)
    changed = here.scene.with_obstacle(Obstacle("far", Sphere(0.01), Pose((5.0, 5.0, 5.0))))
    found = here.replan(before, at_time=0.5, latency=0.1, scene=changed, request=request(time_limit=0.2))
    assert found.outcome is Outcome.STOP, "which is proven when the proof is there"
    assert "time limit" in str(found.failure)


@pytest.mark.slow
def test_a_checker_that_a_call_did_not_wait_for_serves_the_next(
    gate: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = PlannerService("planar2", "discs")
    made = list[object]()
    monkeypatch.setattr(checker, "FEW_PAIRS", 0)
    monkeypatch.setattr(checker, "make_backend", held_up(gate, make_backend, made))
    for _ in range(3):
        assert "time limit" in str(here.plan(request(time_limit=0.2)).failure)
    assert len(made) == 1
    gate.set()
    assert here.plan(request(time_limit=WAIT)).ok


def test_following_is_left_while_a_law_times_a_long_path(gate: threading.Event) -> None:
    token = CancelToken()

    class Slow(ToppRa):
        def phases(self, *given: Any, **named: Any) -> Any:
            token.cancel()
            gate.wait(WAIT)
            return super().phases(*given, **named)

    here = PlannerService("planar2", "discs")
    waypoints = np.array(START) + np.stack([np.linspace(0.0, 0.1, 300), 0.001 * np.sin(np.arange(300))], axis=1)
    result = here.follow(waypoints, pace=Pace(Slow()), cancel=token)
    assert present(result.failure).reason is Reason.PREEMPTED
    assert here.plan(request()).ok, "while the law still waits"
    assert not gate.is_set()
