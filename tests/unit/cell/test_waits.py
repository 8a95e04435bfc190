"""An arm that stops on its way and waits for another, whose start and end are both in that one's way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner_service import JointPath, PlannerService, PlanRequest, PlanResult, load_robot
from planner_service.cell.clocks import Between, Clock, Turned, best_start, between_arms
from planner_service.cell.waits import Passing, can_pass, waiting
from planner_service.geometry.arrays import BoolArray
from planner_service.timing.limit_check import peaks

DUAL = load_robot("wxai_dual")
COLUMNS = {"left": list(range(6)), "right": list(range(6, 12))}
IN, OUT = {"left": -0.6, "right": 0.6}, {"left": 0.5, "right": -0.5}
DELAY = 0.05


class Meeting:
    """Both arms begin and end at some turns; each goes there and back, at some part of its speed."""

    def __init__(self, left: tuple[float, ...], right: tuple[float, ...], slow: float) -> None:
        self.requests, self.plans, self.arms = (
            dict[str, PlanRequest](),
            dict[str, PlanResult](),
            dict[str, PlannerService](),
        )
        for name, turns, scale in (("left", left, slow), ("right", right, 1.0)):
            still = {joint: 0.0 for joint in DUAL.joint_names if not joint.startswith(name)}
            still = {joint: float(DUAL.home[list(DUAL.joint_names).index(joint)]) for joint in still}
            self.arms[name] = arm = PlannerService(DUAL.locked(still), "empty")
            rows = [[turn, 1.4, 1.2, -0.8, 0.0, 0.0] for turn in turns]
            request = self.requests[name] = PlanRequest(rows[0], rows[1], velocity_scale=scale)
            plan = arm.plan(request)
            path = JointPath(np.array(rows))
            limits = request.pace.limits(arm.robot)
            self.plans[name] = replace(plan, path=path, trajectory=request.timing.time_path(path, limits))
        one, two = (frozenset(s.link for s in DUAL.shapes if s.link.startswith(side)) for side in ("left", "right"))
        self.certifier = between_arms(DUAL, one, two, still=())
        self.between = self.proven(self.plans)

    def proven(self, plans: dict[str, PlanResult]) -> Between:
        first, second = (Clock.of(plans[name].unwrap()[1], COLUMNS[name]) for name in ("left", "right"))
        return Between(self.certifier, first, second, DUAL.home)

    def waits(self, delay: float = DELAY) -> tuple[PlanResult, float] | None:
        """The right arm's motion where the left one goes first."""
        trajectory = self.plans["left"].unwrap()[1]
        passing = Passing(self.between, trajectory, trajectory, 0.0)
        latest = trajectory.duration + self.plans["right"].unwrap()[1].duration + 1.0
        return waiting(
            self.plans["right"], self.arms["right"].robot, self.requests["right"].pace, [passing], delay, latest
        )


@pytest.fixture(scope="module")
def there_and_back() -> Meeting:
    """The left arm comes in slowly and leaves; the right one, which is in, leaves for it, and comes in again."""
    return Meeting((OUT["left"], IN["left"], OUT["left"]), (IN["right"], OUT["right"], IN["right"]), 0.015)


def test_no_start_does_where_start_and_end_are_in_the_way(there_and_back: Meeting) -> None:
    assert best_start([(there_and_back.between, 0.0)], DELAY, 60.0) is None
    assert can_pass(there_and_back.between)


def test_an_arm_waits_on_its_way(there_and_back: Meeting) -> None:
    found = there_and_back.waits()
    assert found is not None
    plan, start = found
    before, after = there_and_back.plans["right"].unwrap()[1], plan.unwrap()[1]
    assert start > 0.0
    assert after.path is before.path
    assert after.duration > before.duration + 0.5
    assert "on its way" in plan.notes[-1]
    assert plan.motion is not None
    assert plan.motion.duration == after.duration
    limits = there_and_back.requests["right"].pace.limits(there_and_back.arms["right"].robot)
    assert peaks(after, limits).highest <= 1.0 + 1e-9
    Q = after(np.linspace(0.0, after.duration, 500))
    assert Q[0] == pytest.approx(before(0.0))
    assert Q[-1] == pytest.approx(before(before.duration))
    assert (np.abs(np.diff(Q, axis=0)).max(axis=1) < 1e-12).sum() > 20, "it stands for a while"


def test_the_motion_that_waits_is_proven_over_both_clocks_and_free_at_samples(there_and_back: Meeting) -> None:
    found = there_and_back.waits()
    assert found is not None
    plan, start = found
    anew = there_and_back.proven({**there_and_back.plans, "right": plan})
    assert not len(anew.in_the_way(start, DELAY))
    checker = PlannerService(DUAL, "empty").checker
    left, right = there_and_back.plans["left"].unwrap()[1], plan.unwrap()[1]
    rng, times = np.random.default_rng(2), np.linspace(0.0, left.duration + 1.0, 300)
    for _ in range(6):
        late = [rng.uniform(0.0, DELAY, len(times)) for _ in range(2)]
        rows = [
            each(np.clip(times - begin - behind, 0.0, each.duration))
            for each, begin, behind in zip((left, right), (0.0, start), late, strict=True)
        ]
        assert all(checker.state_is_free(q) for q in np.concatenate(rows, axis=1))


def test_it_waits_no_longer_than_it_has_to(there_and_back: Meeting) -> None:
    found = there_and_back.waits()
    assert found is not None
    before, after = there_and_back.plans["right"].unwrap()[1], found[0].unwrap()[1]
    proven = there_and_back.between.proven(7)
    last = float(np.flatnonzero(~proven[:, -1]).max() + 1) / 128 * there_and_back.plans["left"].unwrap()[1].duration
    assert last < found[1] + after.duration < last + DELAY + before.duration


def test_arms_that_cannot_pass_have_no_wait() -> None:
    meeting = Meeting((OUT["left"], IN["left"]), (IN["right"] + 0.1, IN["right"]), 0.2)
    assert not can_pass(meeting.between)
    assert meeting.waits() is None


def test_what_can_pass_is_what_a_search_of_the_rectangles_says(there_and_back: Meeting) -> None:
    class Drawn(Between):
        def __init__(self, free: BoolArray) -> None:
            self.free = free

        def proven(self, level: int) -> BoolArray:
            return self.free

    rng, outcomes = np.random.default_rng(3), list[bool]()
    for _ in range(200):
        free = rng.uniform(size=(12, 12)) > rng.uniform(0.1, 0.4)
        reached = np.zeros((13, 13), dtype=bool)
        reached[0, 1] = True
        for i in range(12):
            for j in range(12):
                before = reached[i, j + 1] or reached[i + 1, j] or reached[i, j]
                reached[i + 1, j + 1] = free[i, j] and before
            reached[0, 1] = False
        outcomes.append(bool(reached[-1, -1]))
        assert can_pass(Drawn(free)) == outcomes[-1]
    assert 20 < sum(outcomes) < 180


def test_seen_from_the_other_arm_rectangles_are_turned(there_and_back: Meeting) -> None:
    assert np.array_equal(Turned(there_and_back.between).proven(5), there_and_back.between.proven(5).T)
