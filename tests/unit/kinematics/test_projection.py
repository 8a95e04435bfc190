"""Projecting onto constraints: the compiled form against its reference, and both against Pinocchio's kinematics."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import InvalidRequest, Pose, Robot, UnknownName, load_robot
from planner_service.constraints import JointRange, KeepUpright, OnPlane, RelativePose, ToolRegion
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.constraint_set import ConstraintSet, projector_of
from tests.reference.projector import ReferenceProjector
from tests.support.constraints import CASES, case
from tests.support.small_robots import SLIDER, built


def link_pose(robot: Robot, link: str | None, q: FloatArray) -> FloatArray:
    body, T = robot.link_frame(robot.tool_frame if link is None else link)
    R, p = robot.body_poses_batch(q[None])
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = R[0, body], p[0, body]
    return np.asarray(world @ T)


def measured(robot: Robot, region: ToolRegion, q: FloatArray) -> tuple[FloatArray, float, float]:
    """Coordinates, tilt and turn by matrices and logarithms, unlike the package's own formulas."""
    base = np.eye(4) if region.relative_to is None else link_pose(robot, region.relative_to, q)
    apart = np.linalg.inv(base @ region.frame.matrix) @ link_pose(robot, region.link, q) @ region.tool.matrix
    z = apart[:3, 2]
    tilt = math.acos(max(-1.0, min(1.0, z[2])))
    swing = np.eye(3)
    if tilt > 1e-9:
        axis = np.cross([0.0, 0.0, 1.0], z) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], z))
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        swing = np.eye(3) + math.sin(tilt) * K + (1 - math.cos(tilt)) * K @ K
    twist = swing.T @ apart[:3, :3]
    return apart[:3, 3], tilt, abs(math.atan2(twist[1, 0], twist[0, 0]))


def violated(robot: Robot, constraints: ConstraintSet, q: FloatArray, slack: float = 1e-9) -> bool:
    for region in (c for c in constraints.constraints if isinstance(c, ToolRegion)):
        at, tilt, turn = measured(robot, region, q)
        if np.any(at < np.array(region.lower) - slack) or np.any(at > np.array(region.upper) + slack):
            return True
        if (region.tilt or math.pi) + slack < tilt or (region.turn or math.pi) + slack < turn:
            return True
    return False


@pytest.mark.parametrize("name", CASES)
def test_compiled_and_in_python_there_are_the_same_bits_and_what_is_projected_keeps_the_constraints(name: str) -> None:
    robot, constraints, compiled = case(name)
    reference, rng = ReferenceProjector(constraints), np.random.default_rng(len(name))
    found = edges = 0
    for _ in range(40):
        q = tuple(rng.uniform(constraints.lower, constraints.upper).tolist())
        near = compiled.project(q)
        assert near == reference.project(q)
        assert compiled.share(q) == reference.share(q)
        if near is None:
            continue
        found += 1
        assert not violated(robot, constraints, np.array(near))
        assert (constraints.lower <= near).all()
        assert (near <= constraints.upper).all()
        for size in (0.02, 0.2):
            end = tuple(np.clip(near + size * rng.normal(size=robot.n), constraints.lower, constraints.upper).tolist())
            assert compiled.keeps(near, end) == reference.keeps(near, end)
            args = (near, end, end, math.dist(near, end), math.dist(near, end), False)
            step = compiled.step(*args)
            assert step == reference.step(*args)
            if step is not None:
                edges += 1
                samples = np.linspace(near, step, 25)
                assert not any(violated(robot, constraints, sample) for sample in samples)
    assert found > 5
    assert edges > 5
    assert compiled.take() == reference.take() > 40


@pytest.mark.parametrize("name", CASES)
def test_a_walk_has_the_same_bits_whatever_was_asked_before_each_step(name: str) -> None:
    """The compiled form remembers where its last step ended."""
    robot, constraints, compiled = case(name)
    reference, rng = ReferenceProjector(constraints), np.random.default_rng(3)
    drawn = (tuple(rng.uniform(constraints.lower, constraints.upper).tolist()) for _ in range(40))
    near = next(q for q in map(compiled.project, drawn) if q is not None)
    kept = refused = 0
    for k in range(300):
        away = 10.0 ** rng.uniform(-4, 0) * rng.normal(size=robot.n)
        end = tuple((near + away).tolist())
        if k % 5 == 0:
            assert compiled.keeps(end, near) == reference.keeps(end, near)
        if k % 7 == 0:
            assert compiled.project(end) == reference.project(end)
        args = (near, end, end, math.dist(near, end), math.dist(near, end), k % 3 > 0)  # to a bound, and a little back
        step = compiled.step(*args)
        assert step == reference.step(*args)
        kept, refused = kept + (step is not None), refused + (step is None)
        near = near if step is None else step
    assert kept > 5
    assert refused > 5


@pytest.mark.parametrize("name", CASES)
def test_shares_are_one_at_the_bounds_and_quantities_are_what_matrices_say(name: str) -> None:
    robot, constraints, projector = case(name)
    rng = np.random.default_rng(3)
    for _ in range(100):
        q = rng.uniform(constraints.lower, constraints.upper)
        share = projector.share(tuple(q.tolist()))
        assert (share > 1.0) == violated(robot, constraints, q, 0.0)
        quantities = constraints.quantities(q)
        assert max(item.share for item in quantities) == pytest.approx(share, rel=1e-6)
        region = next(c for c in constraints.constraints if isinstance(c, ToolRegion))
        at, tilt, turn = measured(robot, region, q)
        true = dict(zip("xyz", at, strict=True)) | {"tilt": tilt, "turn": turn}
        for item in quantities:
            if item.name == region.name:
                assert item.value == pytest.approx(true[item.what], abs=1e-7)


def test_sliding_and_oblique_joints_are_projected_along(tmp_path: Path) -> None:
    robot = built(tmp_path, SLIDER)
    tool = link_pose(robot, None, np.asarray(robot.limits.lower + 0.4 * (robot.limits.upper - robot.limits.lower)))
    constraints = ConstraintSet(
        robot, [OnPlane(Pose((0.0, 0.0, tool[2, 3])), 0.002), ToolRegion(upper=tuple(tool[:3, 3] + 0.1))]
    )
    projector, reference, rng = projector_of(constraints), ReferenceProjector(constraints), np.random.default_rng(1)
    drawn = [tuple(rng.uniform(constraints.lower, constraints.upper).tolist()) for _ in range(60)]
    found = [projector.project(q) for q in drawn]
    assert found == [reference.project(q) for q in drawn]
    kept = [np.array(q) for q in found if q is not None]
    assert len(kept) > 10
    assert not any(violated(robot, constraints, q) for q in kept)


def test_frames_and_joints_that_the_robot_lacks_are_refused() -> None:
    constraints: Any
    for constraints, error in [
        ([KeepUpright((0.0, 0.0, 1.0), 0.1, link="flange")], "flange"),
        ([RelativePose("link_3", "nowhere", Pose(), 0.01, 0.1)], "nowhere"),
        ([RelativePose("camera", "link_6", Pose(), 0.01, 0.1)], "move against each other"),
        ([JointRange("joint_0", 0.0, 1.0), JointRange("joint_0", 2.0, 3.0)], "joint_0 has no room left"),
    ]:
        with pytest.raises((InvalidRequest, UnknownName), match=error):
            ConstraintSet(load_robot("wxai"), constraints)


def test_ranges_of_joints_narrow_the_limits_and_are_named_when_they_are_left() -> None:
    robot = load_robot("wxai")
    constraints = ConstraintSet(robot, [JointRange("joint_1", 0.5, 1.5), KeepUpright((0.0, 0.0, 1.0), 3.0)])
    assert (constraints.lower[1], constraints.upper[1]) == (0.5, 1.5)
    assert constraints.violation([0.0, 1.0, 1.0, 0.0, 0.0, 0.0]) is None
    assert (
        str(constraints.violation([0.0, 1.75, 1.0, 0.0, 0.0, 0.0]))
        == "joint range: joint_1 is 1.75 rad, from 0.5 to 1.5"
    )
