"""Two arms as one robot: each is a WidowX AI, each sees the other, and one or both of them are planned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from planner_service import PlannerService, PlanRequest, PlanResult, load_scene
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidRequest
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box, Pose
from planner_service.grasping.grasps import top_grasps
from planner_service.kinematics.inverse import inverse_kinematics, straight_tool_line
from planner_service.planning.result import Reason
from planner_service.planning.task_result import Handling
from planner_service.robot.model import Robot
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle
from planner_service.tasks.primitives import pick
from tests.support.optional import present
from tests.support.refusals import refused_pair

ROOT = Path(__file__).parents[2]
BASES = {"left_": 0.25, "right_": -0.25}
"""y of each base, metres."""

OVER = [-0.785, 1.559, 1.982, -1.023, 0.0, 0.0]
UNDER = [-0.785, 1.479, 0.726, 0.153, 0.0, 0.0]
"""The left tool across the middle, 0.38 m and 0.10 m high; mirrored in joint_0 they are the right arm's."""

BETWEEN = [0.751, 1.169, 0.704, 0.265, 0.0, 0.0]
"""The right arm across the middle at 0.24 m, between these ends of the left arm's motion."""
ABOVE, BELOW = [-0.695, 1.19, 1.453, -0.463, 0.0, 0.0], [-0.695, 1.692, 0.25, 1.243, 0.0, 0.0]


def arms(names: Iterable[str]) -> set[str]:
    """Which arms links belong to; an obstacle is called by its own name."""
    return {name.split("_")[0] for name in names}


def mirrored(q: list[float]) -> list[float]:
    return [-q[0], *q[1:]]


@pytest.fixture(scope="module")
def dual() -> Robot:
    return load_robot("wxai_dual")


@pytest.fixture(scope="module")
def service(dual: Robot) -> PlannerService:
    return PlannerService(dual, "table")


@pytest.fixture(scope="module")
def second() -> IndependentChecker:
    return IndependentChecker(ROOT / "robots" / "wxai_dual", ROOT / "scenes" / "table.toml")


def right_arm_at(dual: Robot, values: list[float]) -> Robot:
    """The left arm alone, the right one standing."""
    return dual.locked(dict(zip(dual.joint_names[6:], values, strict=True)))


def test_two_arms_are_one_robot_of_twelve_joints(dual: Robot) -> None:
    assert dual.joint_names == tuple(f"{side}joint_{k}" for side in BASES for k in range(6))
    assert dual.tool_frame == "left_ee_gripper_link"
    assert dual.base_links == ("left_base_link", "right_base_link")
    assert len(dual.shapes) == 58
    assert set(present(dual.gripper).links) == {"left_finger_left", "left_finger_right"}


def test_each_arm_is_the_urdf_of_one(dual: Robot) -> None:
    one = read_urdf(data_folder("robots") / "wxai" / "wxai.urdf")
    two = read_urdf(data_folder("robots") / "wxai_dual" / "wxai_dual.urdf")
    links = {link.name: link for link in two.links}
    joints = {joint.name: joint for joint in two.joints}
    assert len(links) == 2 * len(one.links) + 1
    assert len(joints) == 2 * len(one.joints) + 2
    for side, y in BASES.items():
        assert joints[f"{side}mount"].xyz == (0.0, y, 0.0)
        for link in one.links:
            assert replace(links[side + link.name], name=link.name) == link
        for joint in one.joints:
            here = joints[side + joint.name]
            assert (here.parent, here.child) == (side + joint.parent, side + joint.child)
            assert (here.mimic and here.mimic.joint) == (joint.mimic and side + joint.mimic.joint)
            assert replace(here, name=joint.name, parent=joint.parent, child=joint.child, mimic=joint.mimic) == joint


def test_each_arm_has_the_limits_poses_and_contacts_of_one(dual: Robot, wxai: Robot) -> None:
    for half in (slice(0, 6), slice(6, 12)):
        for name in ("lower", "upper", "velocity", "acceleration", "jerk"):
            assert getattr(dual.limits, name)[half].tolist() == getattr(wxai.limits, name).tolist()
        assert {name: q[half].tolist() for name, q in dual.named_poses} == {
            name: q.tolist() for name, q in wxai.named_poses
        }
    allowed = {frozenset(contact.links) for contact in dual.allowed_contacts}
    assert allowed == {frozenset(side + link for link in c.links) for c in wxai.allowed_contacts for side in BASES}
    assert all(len(contact.reason) > 10 for contact in dual.allowed_contacts)


def test_every_link_of_one_arm_is_judged_against_every_link_of_the_other(dual: Robot, wxai: Robot) -> None:
    links = list(dict.fromkeys(item.link for item in wxai.shapes))
    expected = {frozenset((f"left_{a}", f"right_{b}")) for a in links for b in links}
    expected.remove(frozenset(dual.base_links))  # neither moves
    assert {frozenset(p) for p in dual.link_pairs if len(arms(p)) == 2} == expected


def test_each_arm_moves_as_one_on_its_base(dual: Robot, wxai: Robot) -> None:
    rng = np.random.default_rng(5)
    names = [body.name for body in dual.bodies]
    for q in rng.uniform(dual.limits.lower, dual.limits.upper, (50, 12)):
        poses = dual.body_poses(q)
        for half, (side, y) in zip((q[:6], q[6:]), BASES.items(), strict=True):
            for body, pose in zip(wxai.bodies[1:], wxai.body_poses(half)[1:], strict=True):
                shifted = np.add(pose, [0.0] * 10 + [y, 0.0])
                assert poses[names.index(side + body.name)] == pytest.approx(shifted, abs=1e-12)


def test_the_right_gripper_stands_open(dual: Robot, wxai: Robot) -> None:
    assert wxai.gripper_width == 0.08
    for robot in (dual, dual.with_gripper(0.0)):
        found = {(s.link, repr(s.shape)): s.pose for s in robot.shapes if s.link.startswith("right_finger")}
        for item in (s for s in wxai.shapes if s.link.startswith("finger")):
            pose = found[f"right_{item.link}", repr(item.shape)]
            assert pose.position == pytest.approx(item.pose.position, abs=1e-12)


def test_arms_that_meet_are_named(service: PlannerService) -> None:
    middle = (np.array(OVER) + np.array(UNDER)) / 2
    q = np.r_[middle, mirrored(middle.tolist())]
    assert not service.checker.state_is_free(q)
    pairs = {frozenset((c.a, c.b)) for c in service.checker.contacts(q)}
    assert frozenset(("left_link_6", "right_link_6")) in pairs
    assert all(arms(pair) == {"left", "right"} for pair in pairs)


def towards_each_other(dual: Robot, count: int) -> FloatArray:
    """Configurations in which the arms reach inwards, where they often meet."""
    low, high = dual.limits.lower.copy(), dual.limits.upper.copy()
    low[[0, 6]], high[[0, 6]] = (-1.6, -0.3), (0.3, 1.6)
    for joint, (a, b) in {1: (0.5, 2.0), 2: (0.3, 2.0), 3: (-1.0, 1.0), 4: (-1.0, 1.0)}.items():
        low[[joint, joint + 6]], high[[joint, joint + 6]] = a, b
    return np.random.default_rng(7).uniform(low, high, (count, 12))


def test_verdicts_and_names_are_the_independent_checkers(
    dual: Robot, service: PlannerService, second: IndependentChecker
) -> None:
    anywhere = np.random.default_rng(6).uniform(dual.limits.lower, dual.limits.upper, (1000, 12))
    between_arms = 0
    for k, q in enumerate([*towards_each_other(dual, 2000), *anywhere]):
        assert service.checker.state_is_free(q) == second.free(q)
        if k % 10 == 0:
            touching = {frozenset(pair) for pair in second.touching(q)}
            assert {frozenset((c.a, c.b)) for c in service.checker.contacts(q)} == touching
            between_arms += any(arms(pair) == {"left", "right"} for pair in touching)
    assert between_arms > 15


def free_for_the_independent_checker(result: PlanResult, second: IndependentChecker, right: FloatArray | None) -> bool:
    """Whether the curve is free, the right arm standing at ``right`` if it is not part of it."""
    path = result.unwrap()[0]

    def both(s: FloatArray) -> FloatArray:
        q = path(s)
        return q if right is None else np.concatenate([q, np.repeat(right[None], len(q), axis=0)], axis=1)

    return second.curve_touch(both, path.length) is None


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_both_arms_change_places_and_the_plan_is_proven(
    service: PlannerService, second: IndependentChecker, seed: int
) -> None:
    start, goal = [*OVER, *mirrored(UNDER)], [*UNDER, *mirrored(OVER)]
    request = PlanRequest(start, goal, seed=seed, time_limit=None)
    result = service.plan(request)
    assert result.ok, result.failure
    assert "right_link_6 x left_link_6" in result.stages[1].note, "a straight line would not do"
    assert present(result.certificate).certified
    assert free_for_the_independent_checker(result, second, None)
    again = PlannerService("wxai_dual", "table").plan(request)
    assert again.counts == result.counts
    assert again.unwrap()[0].waypoints.tobytes() == result.unwrap()[0].waypoints.tobytes()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_one_arm_goes_around_the_other_that_stands_still(dual: Robot, second: IndependentChecker, seed: int) -> None:
    service = PlannerService(right_arm_at(dual, BETWEEN), "table")
    request = PlanRequest(ABOVE, BELOW, seed=seed, time_limit=None)
    result = service.plan(request)
    assert result.ok, result.failure
    assert "right_finger" in result.stages[1].note, "a straight line would not do"
    path = result.unwrap()[0]
    assert path.waypoints.shape[1] == 6
    assert present(result.certificate).certified
    assert free_for_the_independent_checker(result, second, np.array(BETWEEN))
    assert service.plan(request).counts == result.counts


def test_the_arm_that_stands_still_is_judged_as_both_arms_would_be(dual: Robot) -> None:
    scene = load_scene("table")
    left, both = CollisionChecker(right_arm_at(dual, BETWEEN), scene), CollisionChecker(dual, scene)
    between_arms = 0
    for q in towards_each_other(dual, 150)[:, :6]:
        pairs = {frozenset((c.a, c.b)) for c in left.contacts(q)}
        assert pairs == {frozenset((c.a, c.b)) for c in both.contacts([*q, *BETWEEN])}
        between_arms += any(arms(pair) == {"left", "right"} for pair in pairs)
    assert between_arms > 15


def test_a_certificate_refuses_a_path_through_the_other_arm(dual: Robot) -> None:
    proof = PlannerService(right_arm_at(dual, BETWEEN), "table").certify([ABOVE, BELOW])
    refusal = refused_pair(proof)
    assert arms((refusal.a, refusal.b)) == {"left", "right"}
    proof = PlannerService(dual, "table").certify([[*OVER, *mirrored(UNDER)], [*UNDER, *mirrored(OVER)]])
    refusal = refused_pair(proof)
    assert arms((refusal.a, refusal.b)) == {"left", "right"}


def test_poses_of_the_tool_have_every_solution_of_one_arm_and_leave_the_other_alone(dual: Robot, wxai: Robot) -> None:
    rng = np.random.default_rng(8)
    found = 0
    for q in rng.uniform(dual.limits.lower, dual.limits.upper, (50, 12)):
        pose = Pose.from_matrix(dual.tool_pose(q))
        x, y, z = pose.position
        alone = inverse_kinematics(wxai, Pose((x, y - 0.25, z), pose.quaternion))
        both = inverse_kinematics(dual, pose, still=q)
        assert both[:, :6] == pytest.approx(alone, abs=1e-9)
        assert both[:, 6:].tolist() == [q[6:].tolist()] * len(alone)
        assert inverse_kinematics(dual, pose)[:, 6:].tolist() == [wxai.home.tolist()] * len(alone)
        found += len(alone)
    assert found > 50


def test_numeric_inverse_kinematics_leaves_the_other_arm_alone_too(dual: Robot) -> None:
    q = np.array([*ABOVE, *BETWEEN])
    pose = Pose.from_matrix(dual.tool_pose(q))
    found = inverse_kinematics(replace(dual, inverse="numeric"), pose, still=q)
    assert len(found) > 0
    assert found[:, 6:].tolist() == [BETWEEN] * len(found)
    assert all(np.abs(dual.tool_pose(other) - pose.matrix).max() < 1e-7 for other in found)


def test_an_impossible_place_for_the_other_arm_is_refused(dual: Robot) -> None:
    with pytest.raises(InvalidRequest, match=r"still: right_joint_1: got -0.1; expected within \[0.0000, 3.1416\]"):
        inverse_kinematics(dual, Pose(), still=[*ABOVE, 0.0, -0.1, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(InvalidRequest, match=r"still: got .* expected 12 finite numbers"):
        inverse_kinematics(dual, Pose(), still=ABOVE)


def test_a_pose_as_a_goal_has_the_other_arm_where_it_started(service: PlannerService) -> None:
    goal = Pose.from_rpy((0.3, 0.1, 0.1), (0.0, 1.2, -0.3))
    path = service.plan(PlanRequest([*ABOVE, *BETWEEN], goal, seed=1, time_limit=None)).unwrap()[0]
    assert path.waypoints[-1, 6:].tolist() == BETWEEN
    assert service.robot.tool_pose(path.waypoints[-1])[:3, 3] == pytest.approx(goal.position, abs=1e-7)


def test_a_straight_tool_line_moves_the_left_arm_alone(dual: Robot) -> None:
    q = np.array([*ABOVE, *BETWEEN])
    line = straight_tool_line(dual, q, [0.0, 0.05, 0.08])
    assert line.stopped is None
    assert np.ptp(line.waypoints[:, 6:], axis=0).max() == 0.0
    assert dual.tool_pose(line.waypoints[-1])[:3, 3] == pytest.approx(
        dual.tool_pose(q)[:3, 3] + [0.0, 0.05, 0.08], abs=1e-7
    )


def test_the_left_arm_picks_while_the_right_one_stands_in_its_way(dual: Robot) -> None:
    block = Obstacle("block", Box((0.03, 0.03, 0.05)), Pose((0.30, 0.1, 0.025)))
    service = PlannerService(dual, load_scene("table").with_obstacle(block))
    task = pick(service, [*ABOVE, *BETWEEN], "block", top_grasps(dual, block), Handling(support="table"))
    assert task.failure is None
    assert [segment.name for segment in task.segments] == ["to pregrasp", "descend", "lift"]
    assert task.segments[-1].result.unwrap()[0].waypoints[-1, 6:].tolist() == BETWEEN


def test_both_arms_leave_sleep_together_and_one_leaves_it_beside_a_locked_one(
    dual: Robot, service: PlannerService
) -> None:
    result = service.plan(PlanRequest(dual.pose("sleep"), dual.home, time_limit=None))
    assert result.ok, result.failure
    assert result.certificate is not None
    assert {frozenset(pair) for interval in result.certificate.exempt for pair in interval.pairs} == {
        frozenset((f"{side}link_2", f"{side}link_{k}")) for side in BASES for k in (4, 5)
    }
    asleep = [0.0] * 6
    stuck = service.plan(PlanRequest([*asleep, *BETWEEN], dual.home, time_limit=None))
    assert present(stuck.failure).reason is Reason.START_IN_COLLISION
    left = PlannerService(right_arm_at(dual, BETWEEN), "table")
    result = left.plan(PlanRequest(asleep, ABOVE, time_limit=None))
    assert result.ok, result.failure
    assert {name for interval in present(result.certificate).exempt for pair in interval.pairs for name in pair} == {
        "left_link_2",
        "left_link_4",
        "left_link_5",
    }
