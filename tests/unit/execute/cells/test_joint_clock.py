"""No arm's clock goes on to where it could not stop in time for where another was last seen."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from planner_service.execute.cells.joint_clock import Course, JointClock
from planner_service.path.trajectory import Trajectory
from tests.support.arms import robot, there

TICK = 0.004


@cache
def way() -> Trajectory:
    """Some two seconds from home, bang-bang."""
    return there(20.0).unwrap()[1]


def course(rate: float = 1.0, start: float = 0.0) -> Course:
    return Course(way(), None, start, robot().limits.acceleration, rate, TICK)


def test_a_course_is_the_trajectory_and_stands_before_and_after() -> None:
    own, trajectory = course(start=0.5), way()
    u = np.random.default_rng(1).uniform(0.0, trajectory.duration, 2000)
    q, v, a = own.at(u + 0.5)
    assert np.abs(q - trajectory(u)).max() < 1e-6
    assert np.abs(v - trajectory(u, 1)).max() < 0.01
    assert np.median(np.abs(a - trajectory(u, 2))) < 1e-6
    for u_there, at in ((0.2, 0.0), (trajectory.duration + 0.6, trajectory.duration)):
        q, v, a = own.at(u_there)
        assert np.array_equal(q, trajectory(at)) or np.abs(q - trajectory(at)).max() < 1e-12
        assert not v.any()
        assert not a.any()


@pytest.mark.parametrize("rate", [0.2, 0.5, 1.0])
def test_an_arm_stops_within_its_limits_and_no_farther_than_its_course_says(rate: float) -> None:
    own = course(rate)
    for begin in np.linspace(0.0, way().duration, 60):
        clock = JointClock({"one": own}, math.inf, rate, {"one": 0.0})
        clock.advance("one", begin / rate)
        clock.stop("asked")
        t, speeds = begin / rate, [rate * own.at(float(begin))[1]]
        while True:
            t += TICK
            step = clock.advance("one", t)
            speeds.append(step.rate * own.at(step.u)[1])
            if step.rate == 0.0:
                break
        assert step.u <= begin + own.way(float(begin)) + 1e-12
        braked = np.abs(np.diff(speeds, axis=0)) / TICK
        assert np.all(braked <= 1.25 * robot().limits.acceleration)  # a tick may have a jump of the plan in it


def test_an_arm_goes_on_as_far_as_it_can_stop_for_another_that_stalls_and_no_farther() -> None:
    clock = JointClock({"one": course(), "two": course()}, 0.7, 1.0, {"one": 0.0, "two": 0.05})
    for k in range(1, 2000):
        t = k * TICK
        step = clock.advance("one", t)
        clock.seen("one", clock.courses["one"].at(step.u)[0])
        if t < 0.2:
            clock.seen("two", clock.courses["two"].at(clock.advance("two", t).u)[0])
        if step.stopping and step.rate == 0.0:
            break
    assert clock.stopped.startswith("two was last seen")
    assert 0.2 + 0.3 < step.u <= 0.2 + 0.7


def test_clocks_are_never_farther_apart_than_the_delay_whatever_happens() -> None:
    rng = np.random.default_rng(5)
    stops = 0
    for _ in range(12):
        rate, delay = rng.uniform(0.2, 1.0), rng.uniform(0.1, 0.9)
        starts = rng.uniform(0.0, 0.5, 2)
        courses = {"one": course(rate, starts[0]), "two": course(rate, starts[1])}
        lags = dict(zip(courses, rng.uniform(0.0, 0.05, 2), strict=True))
        clock = JointClock(courses, delay, rate, lags)
        t, at = 0.0, dict.fromkeys(courses, 0.0)
        stall = {name: rng.uniform(0.0, 2.0) / rate for name in courses}
        ask = rng.uniform(0.0, 4.0) / rate
        for _ in range(int(5.0 / rate / TICK)):
            t += TICK * rng.uniform(0.5, 1.5)
            for name in courses:
                if stall[name] < t < stall[name] + 1.0 or rng.uniform() < 0.1:
                    continue
                step = clock.advance(name, t)
                assert step.u >= at[name] - 1e-12  # an arm is behind its clock, and never goes back
                at[name] = max(at[name], step.u - rng.uniform(0.0, 2.0) * rate * lags[name])
                seen = clock.seen(name, courses[name].at(at[name])[0])
                assert abs(at["one"] - at["two"]) <= delay
                assert seen <= step.u
            if t > ask:
                clock.stop("asked")
        stops += bool(clock.stopped)
    assert stops > 4


def test_where_an_arm_is_seen_is_not_ahead_of_where_it_is() -> None:
    own, rng = course(), np.random.default_rng(2)
    for u in rng.uniform(0.2, way().duration - 0.2, 200):
        measured = own.at(float(u))[0] + rng.uniform(-1e-4, 1e-4, 6)
        seen = own.seen_at(measured, u - 0.2, u + 0.1)
        assert u - 0.05 < seen < u + 0.02
