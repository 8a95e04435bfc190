"""Compiled timing against its references: the same bits as the Python versions, and toppra's durations."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.kinematics.tool_speed import peak_tool_speed, reference_tool_speed
from planner_service.native.loading import load_core
from planner_service.path.joint_path import JointPath
from planner_service.robot.model import Robot, load_robot
from planner_service.timing.laws import SCurve, Timing, ToppRa, Trapezoidal
from planner_service.timing.limit_check import peaks, reference_peaks
from planner_service.timing.segments import path_segments
from planner_service.timing.time_optimal import GridLimits, grid_limits, reference_passes, two_passes

pytestmark = pytest.mark.skipif(load_core() is None, reason="nothing is compiled here")

ROBOTS = ("wxai", "panda_mbm", "planar2")
LAWS: tuple[Timing, ...] = (ToppRa(), Trapezoidal(), SCurve(), ToppRa(12))


def random_path(robot: Robot, rng: np.random.Generator) -> JointPath:
    """Through two to eight random configurations; most corners are blended, some over almost nothing."""
    path = JointPath(rng.uniform(robot.limits.lower, robot.limits.upper, (int(rng.integers(2, 9)), robot.n)))
    lengths, widths = np.diff(path.knots), np.zeros(len(path.waypoints))
    for k in range(1, len(widths) - 1):
        if rng.random() < 0.8 and not path.turns_back(k):
            widths[k] = rng.choice([0.499, 0.2, 0.01, 1e-4]) * min(lengths[k - 1], lengths[k])
    return path.with_blends(widths)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("seed", range(8))
def test_passes_peaks_and_tool_speeds_have_the_bits_of_their_references(name: str, seed: int) -> None:
    robot, rng = load_robot(name), np.random.default_rng(seed)
    path, law = random_path(robot, rng), LAWS[seed % len(LAWS)]
    for segment in path_segments(path, robot.limits, None):
        grid = grid_limits(segment, np.arange(30) / 29.0, float(rng.uniform(0.5, 3.0)), 0.0)
        compiled, reference = two_passes(grid, 0.0), reference_passes(grid, 0.0)
        assert compiled is not None
        assert reference is not None
        assert compiled.tobytes() == reference.tobytes()
    trajectory = law.time_path(path, robot.limits)
    assert peaks(trajectory, robot.limits) == reference_peaks(trajectory, robot.limits)
    assert peak_tool_speed(robot, trajectory) == reference_tool_speed(robot, trajectory)


@pytest.mark.parametrize("seed", range(10))
def test_durations_are_those_of_toppra(seed: int) -> None:
    robot = load_robot(ROBOTS[seed % 3])
    path = random_path(robot, np.random.default_rng(100 + seed))
    ours, theirs = (ToppRa(backend=backend).time_path(path, robot.limits) for backend in ("own", "toppra"))
    assert ours.duration == pytest.approx(theirs.duration, rel=1e-9)


def test_a_start_too_fast_to_stop_has_no_solution_in_either() -> None:
    points, ones = np.arange(11) / 10.0, np.ones((11, 1))
    grid = GridLimits(points, ones, np.zeros((11, 1)), np.array([1.0]), np.full(11, 100.0))
    assert two_passes(grid, 1.5) is None  # 1.5^2 / 2 > 1
    assert reference_passes(grid, 1.5) is None
    assert two_passes(grid, 1.4) is not None


def test_another_backend_is_refused_with_those_there_are() -> None:
    with pytest.raises(InvalidRequest, match="backend: got 'scipy'; expected 'own' or 'toppra'"):
        ToppRa(backend="scipy")  # type: ignore[arg-type]
