"""Compiled timing against its references: the same bits as the Python versions, and toppra's durations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.robot.model import JointLimits, Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.timing.laws import (
    SCurve,
    Timing,
    TimingFailed,
    ToppRa,
    Trapezoidal,
    reference_stop_duration,
    reference_time_with_peaks,
    stop_duration,
    time_with_peaks,
)

ROBOTS = ("wxai", "panda_mbm", "planar2")
LAWS: tuple[Timing, ...] = (ToppRa(), Trapezoidal(), SCurve(), ToppRa(12))


def random_path(robot: Robot, rng: np.random.Generator) -> JointPath:
    """Through two to eight random configurations, some of them close; most corners are blended, some hardly."""
    points = rng.uniform(robot.limits.lower, robot.limits.upper, (int(rng.integers(2, 9)), robot.n))
    if rng.random() < 0.4:
        scales = rng.choice([1e-4, 1e-2, 1.0], (len(points) - 1, 1))
        points[1:] = points[0] + np.cumsum(scales * np.diff(points, axis=0), axis=0)
    path = JointPath(points)
    lengths, widths = np.diff(path.knots), np.zeros(len(path.waypoints))
    shares = [0.5, 0.499, 0.2, 0.01, 1e-4] if len(points) > 3 else [1.0, 1.0 - 1e-7, 0.95, 0.5]
    for k in range(1, len(widths) - 1):
        if rng.random() < 0.8 and not path.turns_back(k):
            widths[k] = rng.choice(shares) * min(lengths[k - 1], lengths[k])
    return path.with_blends(widths)


def outcome(act: Callable[[], Any]) -> Any:
    """What a call returns, trajectories as their bytes, or the failure of a law in words."""
    try:
        given = act()
    except TimingFailed as failed:
        return str(failed)
    if isinstance(given, tuple) and isinstance(given[0], Trajectory):
        return [np.asarray(part).tobytes() for part in given[0].tables], given[0].dilation, given[0].part, given[1]
    return given


def random_limits(robot: Robot, rng: np.random.Generator) -> JointLimits:
    """The robot's, or some a thousand times lower or higher, joint by joint."""
    if rng.random() < 0.5:
        return robot.limits
    factors = 10.0 ** rng.uniform(-3.0, 3.0, (2, robot.n))
    velocity, acceleration = robot.limits.velocity * factors[0], robot.limits.acceleration * factors[1]
    return replace(robot.limits, velocity=velocity, acceleration=acceleration)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("law", [ToppRa(), Trapezoidal()])
def test_whole_motions_have_the_bits_of_the_reference(name: str, law: ToppRa | Trapezoidal) -> None:
    for seed in range(12):
        robot, rng = load_robot(name), np.random.default_rng([seed, 1])
        path, limits = random_path(robot, rng), random_limits(robot, rng)
        compiled, reference = (
            outcome(partial(timed, law, path, limits, None)) for timed in (time_with_peaks, reference_time_with_peaks)
        )
        assert compiled == reference
        assert stop_duration(path, law, limits) == reference_stop_duration(path, law, limits)


@pytest.mark.parametrize("name", ROBOTS)
def test_motions_that_go_on_from_a_speed_have_the_bits_of_the_reference(name: str) -> None:
    for seed in range(15):
        robot, rng = load_robot(name), np.random.default_rng([seed, 2])
        path, limits, law = random_path(robot, rng), random_limits(robot, rng), ToppRa()
        s, speed, share = rng.uniform(0.0, path.length), rng.choice([0.0, 0.01, 0.3, 1.0]), [1.0, 0.99][seed % 2]
        compiled = outcome(partial(law.continue_to_rest, path, limits, s, speed, blend_share=share))
        reference = outcome(partial(law.reference_continuation, path, limits, s, speed, blend_share=share))
        assert compiled == reference


class OtherPath(JointPath):
    """A path of a class of one's own, about which compiled code says nothing."""


@pytest.mark.parametrize("name", ROBOTS)
def test_a_motion_made_of_its_arrays_has_the_bits_of_the_reference(name: str) -> None:
    for seed in range(12):
        robot, rng = load_robot(name), np.random.default_rng([seed, 4])
        path = random_path(robot, rng)
        law = (SCurve(20.0) if seed % 2 else ToppRa()).time_path(path, robot.limits)
        first = int(rng.integers(0, len(law.durations)))
        part = (float(law.coefficients[first, 0]), path.length)
        rows = law.durations[first:], law.coefficients[first:], 1.0, part
        compiled, reference = (Trajectory(made(path.waypoints, path.blends), *rows) for made in (JointPath, OtherPath))
        assert [table.tobytes() for table in compiled.tables] == [table.tobytes() for table in reference.tables]


@pytest.mark.parametrize("factor", [1e-300, 1e300])
def test_what_is_too_extreme_is_left_to_the_reference(factor: float) -> None:
    robot = load_robot("planar2")
    path = random_path(robot, np.random.default_rng(4))
    for name in ("velocity", "acceleration"):
        limits = replace(robot.limits, **{name: np.full(robot.n, factor)})
        for law in LAWS:
            compiled, reference = (
                outcome(partial(timed, law, path, limits, None))
                for timed in (time_with_peaks, reference_time_with_peaks)
            )
            assert compiled == reference


def test_durations_are_those_of_toppra() -> None:
    for seed in range(10):
        robot = load_robot(ROBOTS[seed % 3])
        path = random_path(robot, np.random.default_rng(100 + seed))
        ours, theirs = (ToppRa(backend=backend).time_path(path, robot.limits) for backend in ("own", "toppra"))
        assert ours.duration == pytest.approx(theirs.duration, rel=1e-9)
