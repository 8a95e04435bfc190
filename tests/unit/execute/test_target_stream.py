"""Targets that are replaced before they are due, on an arm that writes down what it is told."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.execute import TargetStream
from planner_service.geometry.arrays import FloatArray
from tests.support.arms import FakeArm

SECONDS = 10.0
"""To wait at most for what takes some milliseconds."""


class Clock:
    """Seconds that pass when they are told to."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def hands() -> Clock:
    return Clock()


@pytest.fixture
def told() -> FakeArm:
    return FakeArm(np.zeros(6), lag=np.array([0.05, 0.05, 0.05, 0.05, 0.1, 0.1]))


@pytest.fixture
def stream(told: FakeArm, hands: Clock) -> Iterator[TargetStream]:
    with TargetStream(told, clock=hands) as stream:
        yield stream


def newest(arm: FakeArm) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A command that was made after this was called."""
    before, arrived = len(arm.told), threading.Event()
    for _ in range(int(SECONDS / 0.001)):
        if len(arm.told) > before + 1:  # the first may have been made before
            return arm.told[-1]
        arrived.wait(0.001)
    raise AssertionError("nothing was commanded")


def test_the_setpoint_goes_straight_and_is_there_in_time(stream: TargetStream, hands: Clock) -> None:
    stream.go(np.ones(6), 0.1)
    hands.now = 0.025
    assert np.allclose(stream.setpoint(), 0.25)
    hands.now = 0.15
    assert np.array_equal(stream.setpoint(), np.ones(6))


def test_a_target_that_comes_before_the_last_is_reached_turns_the_setpoint_where_it_is(
    stream: TargetStream, hands: Clock
) -> None:
    stream.go(np.ones(6), 0.1)
    hands.now = 0.05
    stream.go(np.zeros(6), 0.1)
    assert np.allclose(stream.setpoint(), 0.5)
    hands.now = 0.1
    assert np.allclose(stream.setpoint(), 0.25)


def test_commands_are_ahead_by_what_the_arm_lags(stream: TargetStream, told: FakeArm, hands: Clock) -> None:
    stream.go(np.full(6, 0.2), 0.1)
    hands.now = 0.05
    q, speed, _ = newest(told)
    assert np.allclose(speed, 2.0)
    assert np.allclose(q, 0.1 + told.lag * 2.0)


def test_nothing_is_commanded_before_the_first_target_nor_after_the_end(told: FakeArm, hands: Clock) -> None:
    with TargetStream(told, clock=hands) as stream:
        assert told.told == []
        stream.go(np.ones(6), 0.1)
        newest(told)
    assert not any(thread.name == "targets" for thread in threading.enumerate())
    with pytest.raises(InvalidRequest, match="stream: got 'closed'"):
        stream.go(np.ones(6), 0.1)


def test_what_a_driver_raises_is_raised_at_the_next_target(stream: TargetStream, told: FakeArm) -> None:
    failed = threading.Event()

    def trouble(_: int) -> None:
        failed.set()
        raise OSError("unplugged")

    told.trouble = trouble
    stream.go(np.ones(6), 0.1)
    assert failed.wait(SECONDS)
    stream.close()
    with pytest.raises(OSError, match="unplugged"):
        stream.go(np.ones(6), 0.1)


@pytest.mark.parametrize(
    ("q", "seconds", "match"),
    [(np.ones(5), 0.1, "q: "), (np.full(6, np.nan), 0.1, "q: "), (np.ones(6), 0.0, "seconds")],
)
def test_a_target_that_is_none_is_refused(stream: TargetStream, q: object, seconds: float, match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        stream.go(q, seconds)  # type: ignore[arg-type]


def test_a_rate_out_of_range_is_refused(told: FakeArm) -> None:
    with pytest.raises(InvalidRequest, match="rate"):
        TargetStream(told, rate=0.0)
