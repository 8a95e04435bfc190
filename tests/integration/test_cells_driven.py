"""Two WidowX AI, each simulated behind its own driver, driven together; Coal judges where both were recorded to be."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import PlanRequest, Scene, load_robot
from planner_service.cell import Cell, CellPlan
from planner_service.execute import SimulatedArm, Streaming
from planner_service.execute.cells import CellReport, CellStopped, execute_cell
from planner_service.geometry.arrays import FloatArray

pytestmark = pytest.mark.sim

ROOT = Path(__file__).parents[2]
HOW = Streaming(speed=0.4, rate=100.0, latest=0.5, settle=1.0)


class Lossy:
    """A driver whose network is lost once, for so many seconds: no call returns until it is back."""

    def __init__(self, driver: Any, at: int = -1, seconds: float = 0.0) -> None:
        self._driver, self._at, self._seconds, self._told = driver, at, seconds, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._driver, name)

    def command(self, *given: Any) -> None:
        self._told += 1
        if self._told == self._at:
            time.sleep(self._seconds)
        self._driver.command(*given)


@pytest.fixture(scope="module")
def cell() -> Cell:
    robot = load_robot("wxai_dual")
    sides = {side: [name for name in robot.joint_names if name.startswith(side)] for side in ("left", "right")}
    return Cell.of(robot, sides, "table", tools={"right": "right_ee_gripper_link"})


@pytest.fixture(scope="module")
def plan(cell: Cell) -> CellPlan:
    """The left arm leaves the middle, and the right one comes in."""
    leaves = PlanRequest([-0.785, 1.4, 1.2, -0.8, 0.0, 0.0], [0.4, 1.4, 1.2, -0.8, 0.0, 0.0])
    comes = PlanRequest([-0.4, 1.4, 1.2, -0.8, 0.0, 0.0], [0.785, 1.4, 1.2, -0.8, 0.0, 0.0])
    return cell.plan({"left": leaves, "right": comes}, delay=0.4)


@pytest.fixture
def drivers(cell: Cell, plan: CellPlan) -> Iterator[dict[str, Any]]:
    robot, begin = load_robot("wxai"), plan(0.0)
    with ExitStack() as stack:
        made = {}
        for name in cell.arms:
            arm = stack.enter_context(SimulatedArm(robot, Scene(()), cell.of_arm(name, begin)))
            made[name] = arm.connect()
            stack.callback(made[name].close)
        yield made


def require_free(cell: Cell, report: CellReport) -> None:
    """Coal finds nothing that touches where both arms were at the same time."""
    second = IndependentChecker(ROOT / "robots" / "wxai_dual", ROOT / "scenes" / "table.toml")
    end = max(course.recording.t[-1] for course in report.arms.values())
    times = np.arange(0.0, end, 0.005)
    Q: FloatArray = np.repeat(cell.robot.home[None], len(times), axis=0)
    for name, course in report.arms.items():
        own = [cell.robot.joint_names.index(joint) for joint in cell.arm(name).robot.joint_names]
        for k, joint in enumerate(own):
            Q[:, joint] = np.interp(times, course.recording.t, course.recording.measured[:, k])
    assert all(second.free(q) for q in Q)


def test_both_arms_are_driven_to_their_goals(cell: Cell, plan: CellPlan, drivers: dict[str, Any]) -> None:
    assert any(clock.start > 0.0 for clock in plan.clocks)
    report = execute_cell(cell, plan, drivers, HOW)
    end = plan(plan.duration)
    for name, course in report.arms.items():
        assert np.abs(course.recording.measured[-1] - cell.of_arm(name, end)).max() < 0.01
    assert 0.0 < report.behind < report.tolerated
    require_free(cell, report)


@pytest.mark.parametrize("lost", ["left", "right"])
def test_if_the_network_of_one_is_lost_for_a_second_both_rest_and_nothing_touches(
    lost: str, cell: Cell, plan: CellPlan, drivers: dict[str, Any]
) -> None:
    """Seconds of the plan, of which 0.4 are driven in one: at 0.4 the plan tolerates one second."""
    drivers[lost] = Lossy(drivers[lost], at=60, seconds=1.6)
    with pytest.raises(CellStopped) as caught:
        execute_cell(cell, plan, drivers, HOW)
    report = caught.value.report
    assert f"{lost} " in str(report.stopped)
    before = {name: driver.positions() for name, driver in drivers.items()}
    time.sleep(0.2)
    for name, driver in drivers.items():
        assert np.abs(driver.positions() - before[name]).max() < 2e-3
    require_free(cell, report)
