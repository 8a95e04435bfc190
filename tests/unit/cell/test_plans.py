"""Motions of several arms do not touch, however late each is within what the plan tolerates."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from planner_service import InvalidRequest, PlanningFailed, PlanRequest, Pose, Reason, UnknownName, load_robot
from planner_service.cell import Arm, Cell, CellPlan
from planner_service.geometry.arrays import FloatArray

WXAI = load_robot("wxai")
DELAY = 0.1
LEFT_IN, LEFT_OUT = ([turn, 1.4, 1.2, -0.8, 0.0, 0.0] for turn in (-0.6, 0.5))
RIGHT_IN, RIGHT_OUT = ([turn, 1.4, 1.2, -0.8, 0.0, 0.0] for turn in (0.6, -0.5))


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell({"left": Arm(WXAI, Pose((0.0, 0.2, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.2, 0.0)))}, "table")


def free(cell: Cell, rng: np.random.Generator) -> FloatArray:
    while True:
        q = rng.uniform(*cell.robot.bounds)
        if cell.service.checker.state_is_free(q):
            return np.asarray(q)


def requests(cell: Cell, start: FloatArray, goal: FloatArray) -> dict[str, PlanRequest]:
    return {name: PlanRequest(cell.of_arm(name, start), cell.of_arm(name, goal)) for name in cell.arms}


def executions(cell: Cell, plan: CellPlan, rng: np.random.Generator, count: int = 8) -> Iterator[FloatArray]:
    """What arms do that are late, each by another amount all along or at every moment."""
    times, most = np.linspace(0.0, plan.duration, 120), min(plan.tolerates, 1.0)
    for k in range(count):
        size = 1 if k % 2 else len(times)
        yield plan(times, {name: np.broadcast_to(rng.uniform(0.0, most, size), times.shape) for name in cell.arms})


def swapping(cell: Cell) -> dict[str, PlanRequest]:
    """One arm leaves the place between them, slowly, and the other comes in."""
    return {
        "left": PlanRequest(LEFT_IN, LEFT_OUT, velocity_scale=0.05),
        "right": PlanRequest(RIGHT_OUT, RIGHT_IN),
    }


def test_late_arms_do_not_touch(cell: Cell) -> None:
    rng, planned, waited = np.random.default_rng(5), 0, 0
    for _ in range(12):
        start, goal = free(cell, rng), free(cell, rng)
        plan = cell.plan(requests(cell, start, goal), delay=DELAY)
        if not plan.ok:
            continue
        planned += 1
        waited += len(plan.clocks) == 1 or any(clock.start > 0.0 for clock in plan.clocks)
        assert plan.tolerates >= DELAY
        assert plan(0.0) == pytest.approx(start, abs=1e-9)
        assert plan(plan.duration) == pytest.approx(goal, abs=1e-9)
        for Q in executions(cell, plan, rng):
            assert all(cell.service.checker.state_is_free(q) for q in Q)
    assert planned >= 10
    assert waited >= 1, "it says something of arms in each other's way"


def test_an_arm_waits_for_another_that_leaves(cell: Cell) -> None:
    plan = cell.plan(swapping(cell), delay=DELAY)
    assert plan.failure is None
    assert len(plan.clocks) == 2
    first, second = plan.clocks
    assert first.start == 0.0 < second.start
    at_once = CellPlan(tuple(type(c)(c.arms, c.plan, 0.0, c.columns) for c in plan.clocks), 0.0, None, plan.still)
    Q = at_once(np.linspace(0.0, at_once.duration, 400))
    assert not all(cell.service.checker.state_is_free(q) for q in Q), "both at once would touch"


def test_arms_that_share_a_clock_are_late_each_for_itself(cell: Cell) -> None:
    rng = np.random.default_rng(1)
    near = Cell({"left": Arm(WXAI, Pose((0.0, 0.2, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.2, 0.0)))}, "empty")
    plan = next(
        plan
        for _ in range(20)
        for plan in [near.plan(requests(near, free(near, rng), free(near, rng)), delay=0.05)]
        if len(plan.clocks) == 1
    )
    t = 0.5 * plan.duration
    on_time, behind = plan(t), plan(t, {"right": 0.05})
    assert np.array_equal(behind[:6], on_time[:6])
    assert np.array_equal(behind[6:], plan(t - 0.05)[6:])
    assert not np.array_equal(behind[6:], on_time[6:])
    for Q in executions(near, plan, rng):
        assert all(near.service.checker.state_is_free(q) for q in Q)


def test_more_delay_takes_no_less_time(cell: Cell) -> None:
    plans = [cell.plan(swapping(cell), delay=delay) for delay in (0.0, 0.05, 0.2)]
    assert all(plan.ok for plan in plans)
    assert [plan.duration for plan in plans] == sorted(plan.duration for plan in plans)


def test_the_same_is_planned_again_and_in_any_order(cell: Cell) -> None:
    asked = swapping(cell)
    one, two = cell.plan(asked, delay=DELAY), cell.plan(dict(reversed(asked.items())), delay=DELAY)
    other = Cell({"left": Arm(WXAI, Pose((0.0, 0.2, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.2, 0.0)))}, "table")
    three = other.plan(asked, delay=DELAY)
    times = np.linspace(0.0, one.duration, 50)
    assert one.duration == two.duration == three.duration
    assert one.tolerates == two.tolerates == three.tolerates
    assert np.array_equal(one(times), two(times))
    assert np.array_equal(one(times), three(times))
    assert (one.rectangles, one.counts) == (three.rectangles, three.counts)


def test_an_arm_that_stands_is_gone_round(cell: Cell) -> None:
    plan = cell.plan({"left": swapping(cell)["left"]}, standing={"right": RIGHT_OUT})
    assert plan.ok
    assert plan.tolerates == math.inf
    Q = plan(np.linspace(0.0, plan.duration, 200))
    assert Q[:, 6:] == pytest.approx(np.broadcast_to(RIGHT_OUT, (200, 6)))
    assert all(cell.service.checker.state_is_free(q) for q in Q)


def test_arms_that_touch_at_the_start_have_no_plan(cell: Cell) -> None:
    rng = np.random.default_rng(3)
    while True:
        q = rng.uniform(*cell.robot.bounds)
        alone = all(cell.arm(name).checker.state_is_free(cell.of_arm(name, q)) for name in cell.arms)
        if alone and not cell.service.checker.state_is_free(q):
            break
    plan = cell.plan(requests(cell, q, free(cell, rng)))
    assert plan.failure is not None
    assert plan.failure.reason is Reason.START_IN_COLLISION
    assert "left_" in plan.failure.detail
    assert "right_" in plan.failure.detail
    with pytest.raises(PlanningFailed):
        plan(0.0)


def test_a_goal_of_one_arm_that_is_taken_is_named(cell: Cell) -> None:
    asked = swapping(cell) | {"left": PlanRequest(LEFT_IN, [0.0, 3.0, 0.0, -1.5, 0.0, 0.0])}
    plan = cell.plan(asked)
    assert plan.failure is not None
    assert plan.failure.detail.startswith("left: ")


def test_three_arms(cell: Cell) -> None:
    three = Cell({name: Arm(WXAI, Pose((0.0, y, 0.0))) for name, y in (("a", 0.35), ("b", 0.0), ("c", -0.35))}, "table")
    rng = np.random.default_rng(8)
    for _ in range(3):
        plan = three.plan(requests(three, free(three, rng), free(three, rng)), delay=0.05)
        assert plan.ok
        for Q in executions(three, plan, rng, 4):
            assert all(three.service.checker.state_is_free(q) for q in Q)


def test_what_is_no_request_is_refused(cell: Cell) -> None:
    asked = swapping(cell)
    with pytest.raises(InvalidRequest, match="requests"):
        cell.plan({})
    with pytest.raises(UnknownName, match="middle"):
        cell.plan({"middle": asked["left"]})
    with pytest.raises(InvalidRequest, match="requests\\['left'\\]"):
        cell.plan({"left": "home"})  # type: ignore[dict-item]
    with pytest.raises(InvalidRequest, match="delay"):
        cell.plan(asked, delay=-0.1)
    with pytest.raises(InvalidRequest, match="standing"):
        cell.plan(asked, standing={"left": LEFT_IN})
    with pytest.raises(InvalidRequest, match="standing\\['right'\\]"):
        cell.arm("left", {"right": [0.0]})
    with pytest.raises(InvalidRequest, match="standing"):
        cell.arm("left", {"left": LEFT_IN})
    with pytest.raises(InvalidRequest, match="t"):
        cell.plan(asked)(100.0)
