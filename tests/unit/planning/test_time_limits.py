"""A time limit and a token reach every stage: what takes long, planted, is left to itself when the call is over."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from planner_service import PRM, CancelToken, PlannerService, PlanRequest, Reason, ToppRa, service
from planner_service.certify import Certifier
from planner_service.collision import Cancelled, checker
from planner_service.planning import Pace
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


@pytest.mark.parametrize("looks", [0, 50])
def test_a_roadmap_is_not_grown_on_when_its_token_is_cancelled(looks: int) -> None:
    whole = PlannerService("planar2", "discs").build_roadmap(PRM(milestones=100))
    here = PlannerService("planar2", "discs")
    with pytest.raises(Cancelled):
        here.build_roadmap(PRM(milestones=100), cancel=After(looks))
    assert here.checker.counts.states < present(whole.built).counts.states / 2
    again = here.build_roadmap(PRM(milestones=100))
    assert again.edges.tolist() == whole.edges.tolist()
    assert again.built == present(whole.built)


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
