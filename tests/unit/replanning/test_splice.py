"""What is left of a motion, and the stop along it, by compiled code: the same bits as in Python."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service.path.trajectory import Trajectory
from planner_service.replanning.splice import HOLD, LATER, MARGINS, Underway
from planner_service.robot_setup.loading import load_robot
from planner_service.timing.laws import SCurve, ToppRa
from tests.reference import splice as reference
from tests.unit.timing.test_compiled_timing import ROBOTS, random_path


def under_way(name: str, seed: int) -> tuple[Underway, np.random.Generator]:
    """A motion along a random path, left somewhere."""
    robot, rng = load_robot(name), np.random.default_rng([seed, 3])
    law = SCurve(2.0) if seed % 3 == 1 else ToppRa()
    motion = law.time_path(random_path(robot, rng), robot.limits)
    now = rng.uniform(0.0, 0.9) * motion.duration
    splice = motion.knots[-2] if seed % 5 == 0 else now + rng.uniform(0.0, 0.1) * motion.duration
    return Underway(motion, now, min(float(splice), 0.98 * motion.duration)), rng


def bits(motion: Trajectory) -> list[bytes]:
    return [np.asarray(part).tobytes() for part in motion.tables]


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_left_of_a_motion_has_the_bits_of_the_reference(name: str) -> None:
    for seed in range(15):
        motion, rng = under_way(name, seed)
        law = motion.trajectory
        for t in [motion.splice, law.duration, *rng.uniform(motion.now, law.duration, 5).tolist()]:
            assert motion.s(t) == reference.moved(motion, float(law.s(t)))
        assert bits(motion.rest()) == bits(reference.rest(motion))


@pytest.mark.parametrize("name", ROBOTS)
def test_stops_have_the_bits_of_the_reference(name: str) -> None:
    limits, stops = load_robot(name).limits, 0
    for seed in range(15):
        motion, _ = under_way(name, seed)
        since = motion.splice + HOLD
        if since + LATER[-1] >= motion.trajectory.duration:
            continue
        switch = next(motion.switch_points())
        earliest = reference.braked(motion, since, limits, 0.0)
        if earliest is not None and switch.time == since:
            assert motion.stop_from(switch, limits) == earliest[1]
        tried = [reference.braked(motion, since + later, limits, margin) for later in LATER for margin in MARGINS]
        stop = motion.braked(limits)
        made = np.column_stack([stop.durations, stop.coefficients]).tolist()
        ends = [found for found in tried if found is not None and made[-len(found[0]) :] == list(map(list, found[0]))]
        assert ends or bits(stop)[7:9] == bits(reference.rest(motion))[7:9]
        stops += bool(ends)
    assert stops >= 5
