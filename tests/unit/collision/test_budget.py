"""Counts and their limits: no check beyond a limit is made, none is forgotten."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import pytest

from planner_service.collision import CancelToken, CheckCounts, CollisionChecker, JointStep, Known
from planner_service.collision.backends import FclBackend
from planner_service.collision.budget import Cancelled, CheckBudgetSpent, Ledger, TimeBoxSpent
from planner_service.geometry.shapes import Cylinder, Pose
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene

PLANAR = load_robot("planar2")
START, GOAL = (0.0, 0.0), (3.0, 0.0)
SAMPLES = 801
"""Samples of the edge from START to GOAL, both ends included."""


def checker_with(*obstacles: Obstacle) -> CollisionChecker:
    return CollisionChecker(PLANAR, Scene(obstacles), edge_step=JointStep(3.0 / (SAMPLES - 1)))


def open_checker() -> CollisionChecker:
    return checker_with(Obstacle("far", Cylinder(0.1, 0.2), Pose((-1.3, -0.5, 0.0))))


class CountingDown(CancelToken):
    """A token that another thread would cancel after the ledger has looked at it some times."""

    def __init__(self, looks: int) -> None:
        super().__init__()
        self._looks = looks

    @property
    def cancelled(self) -> bool:
        self._looks -= 1
        return self._looks < 0


def test_each_question_counts_what_it_says() -> None:
    checker = open_checker()
    checker.state_is_free(START)
    assert checker.counts == CheckCounts(states=1)
    checker.contacts(START)
    assert checker.counts == CheckCounts(states=2)
    checker.clearance(START)
    assert checker.counts == CheckCounts(states=2, distances=checker.pair_count)
    checker.edge_is_free(START, GOAL)
    assert checker.counts == CheckCounts(states=2 + SAMPLES, edges=1, distances=checker.pair_count)
    checker.segments(START, GOAL)
    assert checker.counts == CheckCounts(states=2 + SAMPLES, edges=1, distances=checker.pair_count)


def test_a_budget_below_the_cost_of_an_edge_is_spent_exactly() -> None:
    for budget in [*range(20), 63, 64, 65, 70, 71, 72, 73, 74, 75, 135, 136, 137, 199, 200]:
        checker = open_checker()
        with checker.limited(states=budget), pytest.raises(CheckBudgetSpent):
            checker.edge_is_free(START, GOAL)
        assert checker.counts == CheckCounts(states=budget, edges=1)


def test_a_budget_counts_from_where_it_is_set_and_over_variants() -> None:
    checker = open_checker()
    checker.state_is_free(START)
    with checker.limited(states=2):
        checker.state_is_free(START)
        checker.variant(padding=0.01).state_is_free(START)
        with pytest.raises(CheckBudgetSpent, match="budget"):
            checker.state_is_free(START)
        with pytest.raises(CheckBudgetSpent):
            checker.contacts(START)
        with pytest.raises(CheckBudgetSpent):
            checker.variant(padding=0.01).edge_is_free(START, GOAL, known=Known.BOTH)
    assert checker.counts == CheckCounts(states=3, edges=1)
    assert checker.state_is_free(START)


def test_limits_end_with_their_block_even_when_it_raises() -> None:
    ledger = Ledger()
    with ledger.limited(states=5, deadline=None, token=None):
        assert ledger.room() == 5
        with ledger.limited(states=1):
            ledger.record_states(1)
            with pytest.raises(CheckBudgetSpent):
                ledger.require_room()
        with pytest.raises(TimeBoxSpent), ledger.limited(deadline=0.0):
            ledger.require_room()
        assert ledger.room() == 4
        ledger.poll()
    assert ledger.room() is None
    ledger.require_room()
    ledger.record_states(100)
    assert ledger.counts == CheckCounts(states=101)


def test_a_time_box_ends_an_edge_midway(monkeypatch: pytest.MonkeyPatch) -> None:
    checker = open_checker()
    ticks = iter(range(1000))
    with checker.limited(deadline=2.5):
        monkeypatch.setattr(time, "monotonic", lambda: float(next(ticks)))
        with pytest.raises(TimeBoxSpent):
            checker.edge_is_free(START, GOAL)
    assert 0 < checker.counts.states < SAMPLES


def test_a_cancelled_token_stops_the_next_check_and_only_in_its_block() -> None:
    checker, token = open_checker(), CancelToken()
    assert not token.cancelled
    with checker.limited(token=token):
        assert checker.state_is_free(START)
        thread = threading.Thread(target=token.cancel)
        thread.start()
        thread.join()
        assert token.cancelled
        with pytest.raises(Cancelled):
            checker.state_is_free(START)
    assert checker.state_is_free(START)
    assert checker.counts == CheckCounts(states=2)


def test_a_token_ends_an_edge_midway() -> None:
    checker = open_checker()
    with checker.limited(token=CountingDown(looks=2)), pytest.raises(Cancelled):
        checker.edge_is_free(START, GOAL)
    assert 0 < checker.counts.states < SAMPLES


def test_work_apart_does_not_use_up_the_limits_around_it() -> None:
    ledger = Ledger()
    with ledger.limited(states=10):
        ledger.record_states(4)
        with ledger.apart():
            assert ledger.room() is None
            ledger.record_states(50)
        assert ledger.room() == 6
    assert ledger.counts == CheckCounts(states=54)


def test_a_limit_is_of_the_thread_whose_block_it_is() -> None:
    checker, barrier = open_checker(), threading.Barrier(2)
    found: dict[int, int] = {}

    def judge(states: int) -> None:
        with checker.limited(states=states):
            barrier.wait()
            found[states] = 0
            with suppress(CheckBudgetSpent):
                while True:
                    checker.state_is_free(START)
                    found[states] += 1
            barrier.wait()

    threads = [threading.Thread(target=judge, args=(states,)) for states in (5, 100)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {5: 5, 100: 100}
    assert checker.ledger.room() is None
    assert checker.state_is_free(START)


@pytest.mark.parametrize("room", range(0, 12, 3))
def test_at_a_spent_budget_just_what_was_judged_is_counted(room: int, monkeypatch: pytest.MonkeyPatch) -> None:
    judged = 0
    touching = FclBackend._touching

    def spied(backend: FclBackend, q: Sequence[float]) -> Any:
        nonlocal judged
        judged += 1
        return touching(backend, q)

    monkeypatch.setattr(FclBackend, "_touching", spied)
    checker = CollisionChecker(PLANAR, open_checker().scene, edge_step=JointStep(3.0 / (SAMPLES - 1)), backend="fcl")
    with checker.limited(states=room), suppress(CheckBudgetSpent):
        checker.state_is_free(START)
        checker.states_are_free([START, START, START])
        checker.contacts(START)
        checker.edge_is_free(START, GOAL)
    assert checker.counts.states == judged == room


def test_hits_of_several_pieces_of_two_owners_add_up() -> None:
    ledger = Ledger()
    ledger.record(5, 1, {0: 2, 1: 3, 2: 4}, {0: ("arm", "post"), 1: ("arm", "post"), 2: ("arm", "wall")})
    assert (ledger.counts, ledger.hits) == (CheckCounts(5, 1), {("arm", "post"): 5, ("arm", "wall"): 4})
