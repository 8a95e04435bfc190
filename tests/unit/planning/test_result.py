"""What a result says of a motion."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from planner_service import PlannerService, PlanRequest
from planner_service.path.trajectory import LimitPeaks, Peak
from planner_service.planning.result import MotionReport
from planner_service.timing.laws import peak_tool_speed

STILL = Peak(0.0, 0, 0.0)


def test_a_speed_of_the_tool_is_measured_once_when_it_is_looked_at_and_belongs_to_the_report() -> None:
    looks = iter([0.25, 0.5])
    report = MotionReport.measuring(lambda: next(looks), LimitPeaks(STILL, STILL, STILL), 2.0, 3.0, 0.1)
    assert "0.25 m/s" in str(report)
    assert report == MotionReport(LimitPeaks(STILL, STILL, STILL), 0.25, 2.0, 3.0, 0.1)
    assert list(looks) == [0.5]
    with pytest.raises(AttributeError, match="tool_acceleration"):
        report.tool_acceleration  # noqa: B018


def test_a_plan_says_its_tools_speed_in_another_process_and_copies_too() -> None:
    service = PlannerService("planar2", "empty")
    sent, looked_at, changed = (service.plan(PlanRequest((0.0, 0.0), (1.0, 0.5))) for _ in range(3))
    assert looked_at.motion is not None
    assert changed.motion is not None
    assert looked_at.trajectory is not None
    expected = peak_tool_speed(service.robot, looked_at.trajectory)
    assert looked_at.motion.tool_speed == expected > 0.0
    assert pickle.loads(pickle.dumps(sent)).motion == looked_at.motion
    assert replace(changed.motion, settle_time=1.0).tool_speed == expected


def test_a_limit_on_the_tools_speed_is_kept_and_said() -> None:
    service = PlannerService("planar2", "empty")
    found = service.plan(PlanRequest((0.0, 0.0), (1.0, 0.5), max_tool_speed=0.1))
    assert found.motion is not None
    assert found.trajectory is not None
    assert found.motion.tool_speed <= 0.1
    assert peak_tool_speed(service.robot, found.trajectory) == pytest.approx(found.motion.tool_speed, rel=1e-6)
