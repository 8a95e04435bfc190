"""Picks shared out between arms: nothing touches however late arms are, and no forged schedule is proven."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from planner_service import (
    Box,
    InvalidRequest,
    NotProven,
    Obstacle,
    PlanningFailed,
    Pose,
    Scene,
    UnknownName,
    load_robot,
)
from planner_service.cell import Arm, Cell
from planner_service.geometry.arrays import FloatArray
from planner_service.scheduling import PickJob, Schedule, prove_schedule, schedule_picks
from tests.reference.schedule import Sampler, lateness

WXAI = load_robot("wxai")
BLOCK = Box((0.03, 0.03, 0.04))
DELAY = 0.1


def cell_with(places: dict[str, tuple[float, float]]) -> Cell:
    table = Obstacle("table", Box((1.4, 1.4, 0.1)), Pose((0.3, 0.0, -0.051)))
    blocks = [Obstacle(name, BLOCK, Pose((x, y, 0.021))) for name, (x, y) in places.items()]
    scene = Scene((table, *blocks), name="blocks")
    return Cell({"left": Arm(WXAI, Pose((0.0, 0.25, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.25, 0.0)))}, scene)


def job(name: str, x: float, y: float, *arms: str) -> PickJob:
    return PickJob(name, Pose((x, y, 0.021)), "table", arms)


@cache
def crossing() -> Schedule:
    """Two arms that reach past each other: each block is on the other arm's side."""
    cell = cell_with({"a": (0.3, -0.04), "b": (0.3, 0.04), "c": (0.24, -0.2), "d": (0.24, 0.2)})
    jobs = [
        job("a", 0.2, 0.35, "left"),
        job("b", 0.2, -0.35, "right"),
        job("c", 0.3, -0.35),
        job("d", 0.3, 0.35),
    ]
    return schedule_picks(cell, jobs, delay=DELAY)


def found(schedule: Schedule, count: int, most: float, seed: int = 1) -> int:
    """Of so many executions with late arms, those in which something touches."""
    rng, sampler = np.random.default_rng(seed), Sampler(schedule)
    times: FloatArray = np.linspace(0.0, schedule.duration + most, 300, dtype=np.float64)
    return sum(any(sampler.contacts(times, lateness(schedule, times, rng, most))) for _ in range(count))


def shifted(schedule: Schedule, arm: str, seconds: float) -> Schedule:
    """The same where one arm does all of it at other times."""
    chains = [replace(c, start=max(0.0, c.start + seconds)) if c.arm == arm else c for c in schedule.chains]
    return replace(schedule, chains=tuple(chains))


def test_all_jobs_are_done_and_nothing_touches_however_late_arms_are() -> None:
    schedule = crossing()
    assert schedule.failure is None
    assert sorted(chain.job.object for chain in schedule.chains) == ["a", "b", "c", "d"]
    assert {chain.job.object: chain.arm for chain in schedule.chains}["a"] == "left"
    assert DELAY <= schedule.tolerates < 2.0
    assert any(chain.start > 0.0 for chain in schedule.chains if chain.job.object in "ab"), "one has to wait"
    assert schedule.duration < 0.9 * schedule.sequential
    assert found(schedule, 2, schedule.tolerates) == 0


def test_every_arm_goes_on_from_where_it_is_and_ends_where_it_started() -> None:
    schedule = crossing()
    for name, start in schedule.starts.items():
        times = np.linspace(0.0, schedule.duration, 2_000)
        q = schedule.joints(name, times)
        assert np.array_equal(q[0], start)
        assert np.allclose(q[-1], start, atol=1e-9)
        # no jump: as far as the fastest joint turns in a step
        assert np.all(np.abs(np.diff(q, axis=0)) <= WXAI.limits.velocity * np.diff(times)[0] * 1.01 + 1e-6)


def test_it_is_proven_again_for_the_delay_that_it_claims() -> None:
    proven = prove_schedule(crossing()).required()
    assert proven.certified
    assert len(proven.chains) == 4
    assert proven.rectangles > 0


def test_an_arm_that_starts_at_another_time_is_found_by_sampling_and_is_not_proven() -> None:
    schedule = crossing()
    first, then = sorted((c for c in schedule.chains if c.job.object in "ab"), key=lambda chain: chain.start)
    wrong = shifted(schedule, then.arm, first.start - then.start)
    assert found(wrong, 1, 0.0) == 1, "both at once would touch"
    proven = prove_schedule(wrong)
    assert not proven.certified
    with pytest.raises(NotProven):
        proven.required()


def test_what_is_not_so_is_not_proven() -> None:
    schedule = crossing()
    late = replace(schedule, tolerates=schedule.tolerates + 0.05)
    assert "not for" in prove_schedule(late).problems[0]
    wrong = replace(
        schedule, chains=tuple(replace(c, gone=("a",)) if c.job.object != "a" else c for c in schedule.chains)
    )
    assert any("expected one made in the scene" in each for each in prove_schedule(wrong).problems)
    short = replace(schedule, chains=schedule.chains[:-1])
    assert "expected one of each" in prove_schedule(short).problems[0]
    twice = replace(schedule, chains=(*schedule.chains, schedule.chains[0]))
    assert not prove_schedule(twice).certified
    elsewhere = replace(schedule.jobs[0], place=Pose((0.2, 0.3, 0.021)))
    moved = replace(
        schedule,
        jobs=(elsewhere, *schedule.jobs[1:]),
        chains=tuple(replace(c, job=elsewhere) if c.job.object == "a" else c for c in schedule.chains),
    )
    assert not prove_schedule(moved).certified
    swapped = {"left": "right", "right": "left"}
    other = replace(schedule, chains=tuple(replace(c, arm=swapped[c.arm]) for c in schedule.chains))
    assert not prove_schedule(other).certified
    quick = replace(schedule, chains=tuple(replace(c, gripper_seconds=0.0) for c in schedule.chains))
    assert not prove_schedule(quick).certified or found(quick, 2, quick.tolerates) == 0


def test_an_object_may_only_be_left_out_where_it_was_once_another_arm_has_it_in_hand() -> None:
    schedule = crossing()
    arm_of = {chain.job.object: chain.arm for chain in schedule.chains}
    relies = next((c, name) for c in schedule.chains for name in c.gone if arm_of[name] != c.arm)
    wrong = shifted(schedule, arm_of[relies[1]], 100.0)
    expected = f"{relies[0].arm}, {relies[0].job.object}: {relies[1]} may still be where it was"
    assert expected in prove_schedule(wrong).problems


def test_whatever_starts_are_proven_nothing_touches() -> None:
    schedule, rng = crossing(), np.random.default_rng(4)
    proven = 0
    for _ in range(8):
        shifts = {name: rng.uniform(-1.0, 3.0) for name in schedule.starts}
        wrong = schedule
        for name, seconds in shifts.items():
            wrong = shifted(wrong, name, seconds)
        wrong = replace(wrong, tolerates=0.0)
        if prove_schedule(wrong).certified:
            proven += 1
            assert found(wrong, 1, 0.0) == 0
    assert 0 < proven < 8, "it says something of both"


def test_a_pick_that_another_object_is_in_the_way_of_comes_once_that_is_gone() -> None:
    cell = cell_with({"b": (0.3, 0.15)})
    tall = Obstacle("a", Box((0.03, 0.03, 0.2)), Pose((0.3, -0.04, 0.101)))
    cell = Cell(cell.layout.arms, cell.scene.with_obstacle(tall))
    jobs = [job("b", 0.345, -0.04, "left"), PickJob("a", Pose((0.2, -0.35, 0.101)), "table", ("right",))]
    schedule = schedule_picks(cell, jobs)
    assert schedule.failure is None
    first, then = sorted(schedule.chains, key=lambda chain: chain.start)
    assert (first.job.object, then.job.object, then.gone) == ("a", "b", ("a",))
    assert prove_schedule(schedule).certified
    assert found(schedule, 1, schedule.tolerates) == 0


def test_a_pick_that_another_arm_is_in_the_way_of_comes_while_that_one_is_away() -> None:
    cell = cell_with({"x": (0.3, 0.02), "y": (0.24, 0.2), "z": (0.25, -0.2)})
    jobs = [job("x", 0.25, -0.15, "left"), job("y", 0.3, 0.35, "left"), job("z", 0.3, -0.35, "right")]
    schedule = schedule_picks(cell, jobs)
    assert schedule.failure is None, "left first with y, and right as soon as it can, leave no start for x"
    assert [chain.job.object for chain in schedule.chains] == ["z", "x", "y"]
    assert prove_schedule(schedule).certified
    assert found(schedule, 1, schedule.tolerates) == 0


def test_one_arm_alone_has_no_delay_to_keep() -> None:
    cell = cell_with({"a": (0.3, 0.1), "b": (0.24, 0.15)})
    alone = Cell({"left": cell.layout.arms["left"]}, cell.scene)
    schedule = schedule_picks(alone, [job("a", 0.2, 0.3), job("b", 0.3, 0.3)])
    assert schedule.tolerates == math.inf
    assert schedule.duration == pytest.approx(schedule.sequential)
    assert prove_schedule(schedule).certified
    assert "one arm moves" in str(schedule)


def test_the_same_is_scheduled_again() -> None:
    one, two = crossing(), crossing.__wrapped__()
    assert [(c.arm, c.job, c.start) for c in one.chains] == [(c.arm, c.job, c.start) for c in two.chains]
    assert (one.tolerates, one.rectangles, one.counts) == (two.tolerates, two.rectangles, two.counts)


def test_a_job_without_a_plan_is_named_and_the_others_are_kept() -> None:
    cell = cell_with({"a": (0.3, 0.1), "far": (0.3, 0.3)})
    schedule = schedule_picks(cell, [job("a", 0.2, 0.3), job("far", 2.0, 2.0, "left")])
    assert schedule.failure is not None
    assert "far" in schedule.failure.detail
    assert [chain.job.object for chain in schedule.chains] == ["a"]
    with pytest.raises(PlanningFailed):
        schedule.joints("left", 0.0)
    with pytest.raises(InvalidRequest):
        prove_schedule(schedule)


def test_what_cannot_be_asked_is_refused() -> None:
    cell = cell_with({"a": (0.3, 0.1), "b": (0.3, 0.2)})
    for jobs in (
        [],
        [job("a", 0.2, 0.3), job("a", 0.2, 0.4)],
        [replace(job("a", 0.2, 0.3), support="b"), job("b", 0.2, 0.4)],
    ):
        with pytest.raises(InvalidRequest):
            schedule_picks(cell, jobs)
    for given in (job("c", 0.2, 0.3), job("a", 0.2, 0.3, "middle")):
        with pytest.raises(UnknownName):
            schedule_picks(cell, [given])
    dual = load_robot("wxai_dual")
    sides = {side: [name for name in dual.joint_names if name.startswith(side)] for side in ("left", "right")}
    with pytest.raises(InvalidRequest, match="robots at places"):
        schedule_picks(Cell.of(dual, sides, cell.scene), [job("a", 0.2, 0.3)])
