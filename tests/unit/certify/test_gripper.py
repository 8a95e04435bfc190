"""The gripper's own opening and closing: proven between widths, too, or refused with the pair and the width."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    CollisionChecker,
    Handling,
    InvalidRequest,
    Obstacle,
    PlannerService,
    Pose,
    Scene,
    UnknownName,
    load_robot,
    load_scene,
    pick,
    top_grasps,
)
from planner_service.certify import certify_gripper
from planner_service.geometry.arrays import FloatArray
from tests.support.optional import present

CUBE = Obstacle("block", Box((0.045, 0.045, 0.045)), Pose((0.28, 0.10, 0.0215)))
ROBOTS = {"wxai": 40, "panda": 40, "kinova_gripper": 60}
"""Robots, and at how many widths they are looked at: these are 1 to 3 mm apart."""


def in_tool(name: str, q: FloatArray, at: tuple[float, float, float]) -> Pose:
    return Pose.from_matrix(load_robot(name).tool_pose(q)) @ Pose(at)


def plate(y: float) -> Obstacle:
    """A thin plate across the way of the left finger, ``y`` metres beside the middle of the hand at home."""
    return Obstacle("plate", Box((0.02, 0.001, 0.02)), in_tool("wxai", load_robot("wxai").home, (-0.02, y, 0.0)))


def test_a_thin_plate_between_the_widths_is_found_although_both_ends_are_free() -> None:
    robot, scene = load_robot("wxai"), load_scene("bin").with_obstacle(plate(0.027))
    ends = [CollisionChecker(robot.with_gripper(width), scene).state_is_free(robot.home) for width in (0.0, 0.08)]
    found = certify_gripper(robot, scene, robot.home, (0.0, 0.08))
    assert ends == [True, True]
    assert not found.certificate.certified
    assert (
        "the gripper cannot open from 0.0 to 80.0 mm: finger_left x plate are not proven apart at a width of"
        in found.refused
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_certified_is_free_at_every_width_and_the_clearance_is_a_lower_bound(name: str) -> None:
    robot, draw = load_robot(name), np.random.default_rng(7)
    assert robot.gripper is not None
    widths = np.linspace(robot.gripper.lower, robot.gripper.upper, ROBOTS[name])
    hands = [robot.with_gripper(float(width)) for width in widths]
    alone, verdicts = CollisionChecker(robot, Scene()).clearance(robot.home), []
    for _ in range(5):
        at = np.array(robot.gripper.closing) * draw.uniform(-0.09, 0.09) + draw.uniform(-0.03, 0.03, 3)
        block = Obstacle("block", Box((0.012, 0.012, 0.012)), in_tool(name, robot.home, tuple(at.tolist())))
        scene = Scene(obstacles=(block,))
        found = certify_gripper(robot, scene, robot.home, (widths[0], widths[-1]))
        others = dict.fromkeys(shape.link for shape in robot.shapes if shape.link not in robot.gripper.links)
        allowed = [(link, "block") for link in others]
        gaps = (CollisionChecker(hand, scene, allowed=allowed).clearance(robot.home) for hand in hands)
        verdicts.append(found.certificate.certified)
        if found.certificate.certified:
            least = min(gaps)
            assert least > 0.0
            assert min(found.certificate.clearance, alone) <= least + 1e-9
        else:
            assert any(gap < 0.0015 for gap in gaps)  # the fingers of 40 widths are 1 mm apart
    assert {True, False} == set(verdicts)


def test_fingers_may_touch_what_they_close_on_and_nothing_else() -> None:
    service = PlannerService("wxai", load_scene("table").with_obstacle(CUBE))
    task = pick(service, service.robot.home, "block", top_grasps(service.robot, CUBE), Handling(support="table"))
    grip = present(task.segments[2].gripper)
    assert grip.certificate.certified
    assert {pair for e in grip.certificate.exempt for pair in e.pairs} == {
        ("finger_left", "block"),
        ("finger_right", "block"),
    }
    q = task.segments[1].result.unwrap()[0].waypoints[-1]
    again = service.certify_gripper(q, grip.start, grip.end)
    assert "x block are not proven apart" in again.refused


def test_what_is_held_counts_unless_the_fingers_may_touch_it() -> None:
    robot, q = load_robot("wxai"), load_robot("wxai").home
    held = Attached("bar", Box((0.02, 0.03, 0.02)), Pose(), touch_links=("finger_left", "finger_right"))
    assert certify_gripper(robot, Scene(attached=(held,)), q, (0.03, 0.08)).certificate.certified
    loose = replace(held, touch_links=("finger_left",))
    assert "finger_right x bar" in certify_gripper(robot, Scene(attached=(loose,)), q, (0.03, 0.08)).refused


def test_bad_input_names_what_is_wrong() -> None:
    q: Any
    widths: Any
    pairs: Any
    error: Any
    for robot, q, widths, pairs, error, message in [
        ("ur5", [0.0] * 6, (0.0, 0.1), (), InvalidRequest, "robot: got 'ur5'; expected a robot with a gripper"),
        ("wxai", None, (0.0, 0.1), (), InvalidRequest, r"width: got 0.1; expected a gap .* in \[0, 0.08\]"),
        ("wxai", None, (math.nan, 0.08), (), InvalidRequest, "width: got nan"),
        ("wxai", [9.0] * 6, (0.0, 0.08), (), InvalidRequest, "q: .* expected 6 joint values within the limits of wxai"),
        ("wxai", [0.0], (0.0, 0.08), (), InvalidRequest, "q: .* expected 6 joint values"),
        ("wxai", None, (0.0, 0.08), (("finger_left", "blue"),), UnknownName, "unknown .* 'blue'"),
    ]:
        service = PlannerService(robot, "bin")
        with pytest.raises(error, match=message):
            service.certify_gripper(service.robot.home if q is None else q, *widths, touching=pairs)
