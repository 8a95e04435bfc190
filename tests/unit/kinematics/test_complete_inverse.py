"""Complete inverse kinematics: nothing is missing, each box holds exactly one solution, and none is a proof."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import (
    InvalidRequest,
    PlannerService,
    PlanRequest,
    Pose,
    PoseGoal,
    Reason,
    inverse_kinematics,
    load_robot,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics import InverseSolutions
from planner_service.kinematics.complete_inverse import SEAM, complete_solutions
from planner_service.kinematics.inverse import ToolChain, tool_error
from planner_service.kinematics.tool_arm import descended
from planner_service.robot.model import Robot
from tests.reference.inverse import complaints
from tests.support.optional import present
from tests.support.random_robots import random_robot
from tests.support.small_robots import built

TURN = 2.0 * math.pi
ARMS = ("wxai", "ur5", "panda", "xarm7", "kinova")


def arm(name: str) -> Robot:
    """An arm of at most six joints: of seven, the third is locked."""
    whole = load_robot(name)
    robot = ToolChain.of(whole, whole.home).robot
    return robot.locked({robot.joint_names[2]: 0.4}) if robot.n == 7 else robot


def drawn(robot: Robot, rng: np.random.Generator) -> FloatArray:
    return robot.unwound(rng.uniform(robot.limits.lower, robot.limits.upper))


def tool(robot: Robot, q: FloatArray) -> Pose:
    return Pose.from_matrix(robot.tool_pose(q))


def boxes_with(found: InverseSolutions, q: FloatArray) -> int:
    return int(np.all((found.lower <= q) & (q <= found.upper), axis=1).sum())


def in_doubt(found: InverseSolutions, q: FloatArray) -> bool:
    """Whether an unresolved box has q, up to whole turns."""
    off = np.minimum(np.abs(q - found.unresolved[:, 0]), np.abs(q - found.unresolved[:, 1]))
    turned = np.abs(np.remainder(q - found.unresolved.mean(axis=1) + math.pi, TURN) - math.pi)
    inside = (found.unresolved[:, 0] <= q) & (q <= found.unresolved[:, 1])
    half = (found.unresolved[:, 1] - found.unresolved[:, 0]) / 2
    return bool(np.any(np.all(inside | (turned <= half) | (off < 1e-12), axis=1)))


@pytest.mark.parametrize("name", ARMS)
def test_a_configuration_is_in_exactly_one_box_for_the_pose_of_its_tool(name: str) -> None:
    robot, rng = arm(name), np.random.default_rng(0)
    for _ in range(12):
        q = drawn(robot, rng)
        found = inverse_kinematics(robot, tool(robot, q), complete=True)
        assert boxes_with(found, q) == 1 or (not found.complete and in_doubt(found, q))


@pytest.mark.parametrize("seed", [20, 24, 28, 33, 38, 39, 42, 51, 53, 56])
def test_arms_that_slide_mimic_and_turn_about_oblique_axes_are_solved_completely(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    robot = built(tmp_path, random_robot(rng, joints=int(rng.integers(4, 9)), mimics=int(rng.integers(0, 4))))
    chain = ToolChain.of(robot, robot.home).robot
    assert chain.n <= 6
    for _ in range(3):
        q = drawn(chain, rng)
        found = inverse_kinematics(chain, tool(chain, q), complete=True)
        assert found.complete
        assert boxes_with(found, q) == 1


@pytest.mark.parametrize("name", ARMS)
def test_each_box_holds_exactly_one_solution_to_interval_arithmetic_of_its_own(name: str) -> None:
    robot, rng = arm(name), np.random.default_rng(1)
    for _ in range(2):
        pose = tool(robot, drawn(robot, rng))
        found = inverse_kinematics(robot, pose, complete=True)
        few = slice(0, 12)
        assert not complaints(robot, pose, found.q[few], found.lower[few], found.upper[few])


def test_forged_answers_are_noticed(wxai: Robot) -> None:
    rng = np.random.default_rng(2)
    pose = tool(wxai, drawn(wxai, rng))
    found = inverse_kinematics(wxai, pose, complete=True)
    q, lower, upper = found.q, found.lower, found.upper
    assert len(q)
    for _ in range(25):
        off = rng.normal(size=6) * 10.0 ** rng.uniform(-7.0, 0.0)
        assert complaints(wxai, pose, q + off, lower + off, upper + off)  # another place
        assert complaints(wxai, pose, q, upper - 0.1 * (upper - q), upper)  # without q
        assert complaints(wxai, pose, q, lower - abs(off[0]) - 1.0, upper + abs(off[0]) + 1.0)  # nobody knows how many
    twice = [np.concatenate([each, each]) for each in (q, lower, upper)]
    assert complaints(wxai, pose, *twice)


@pytest.mark.parametrize("name", ARMS)
def test_a_thousand_starts_find_nothing_more(name: str) -> None:
    robot, rng = arm(name), np.random.default_rng(3)
    for k in range(6):
        pose = tool(robot, drawn(robot, rng))
        if k % 2:
            turn = rng.normal(size=4)
            pose = Pose(pose.position, tuple((turn / np.linalg.norm(turn)).tolist()))
        found = inverse_kinematics(robot, pose, complete=True)
        end = descended(robot, pose, rng.uniform(robot.limits.lower, robot.limits.upper, (1000, robot.n)))
        for q in map(robot.unwound, end.q[end.arrived]):
            apart = np.abs(found.q - q).max(axis=1, initial=0.0)
            assert np.any(apart < 1e-4) or in_doubt(found, q)
        assert len(found) or not end.arrived.any() or not found.complete


def test_the_closed_form_finds_the_same(wxai: Robot) -> None:
    rng = np.random.default_rng(4)
    for _ in range(60):
        q = drawn(wxai, rng)
        pose = tool(wxai, q)
        found, known = inverse_kinematics(wxai, pose, complete=True), inverse_kinematics(wxai, pose)
        assert found.complete
        assert np.abs(found.q - known[np.lexsort(known.T[::-1])]).max() < 1e-7


def test_the_two_solutions_of_a_planar_arm_and_none_beyond_its_reach() -> None:
    robot = load_robot("planar2")
    q = np.array([0.4, 0.9])
    found = inverse_kinematics(robot, tool(robot, q), complete=True)
    assert found.complete
    assert boxes_with(found, q) == len(found) == 1  # the other elbow turns the tool differently
    x, y, z = tool(robot, q).position
    place = PoseGoal(Pose((x, y, z)), orientation_tolerance=math.pi)
    both = inverse_kinematics(robot, place, complete=True)
    mirrored = np.array(
        [0.4 + 2.0 * math.atan2(math.sin(0.9) * _ratio(robot), 1 + math.cos(0.9) * _ratio(robot)), -0.9]
    )
    assert len(both) == 2
    assert boxes_with(both, q) == boxes_with(both, mirrored) == 1
    beyond = inverse_kinematics(robot, PoseGoal(Pose((5.0, 0.0, z)), orientation_tolerance=math.pi), complete=True)
    assert beyond.complete
    assert not len(beyond)


def _ratio(robot: Robot) -> float:
    """The length of the second link as a share of the first."""
    elbow = np.array(robot.body_poses([0.0, 0.0])[2][9:])
    first = np.linalg.norm(elbow - np.array(robot.body_poses([0.0, 0.0])[1][9:]))
    return float(np.linalg.norm(robot.tool_pose([0.0, 0.0])[:3, 3] - elbow) / first)


def test_the_tool_may_turn_about_a_free_axis_of_an_arm_with_five_joints(wxai: Robot) -> None:
    robot, rng = wxai.locked({"joint_5": 0.3}), np.random.default_rng(5)
    for _ in range(10):
        q = drawn(robot, rng)
        turned = tool(robot, q) @ Pose.from_rpy((0.0, 0.0, 0.0), (float(rng.uniform(-3, 3)), 0.0, 0.0))
        found = inverse_kinematics(robot, PoseGoal(turned, free_axis=(1.0, 0.0, 0.0)), complete=True)
        assert boxes_with(found, q) == 1 or in_doubt(found, q)
        for each in found.q:
            assert robot.tool_pose(each)[:3, 0] @ turned.rotation[:, 0] > 1.0 - 1e-12


def test_poses_within_the_tolerances_have_their_solutions_in_the_same_boxes(wxai: Robot) -> None:
    rng = np.random.default_rng(6)
    for _ in range(10):
        q = drawn(wxai, rng)
        goal = PoseGoal(tool(wxai, q), position_tolerance=1e-4, orientation_tolerance=1e-4, candidates=8)
        found = inverse_kinematics(wxai, goal, complete=True)
        for pose in goal.poses():
            for near in inverse_kinematics(wxai, pose):
                assert boxes_with(found, near) == 1 or in_doubt(found, near)


def test_solutions_come_with_all_whole_turns_within_the_limits() -> None:
    robot = arm("xarm7")
    found = inverse_kinematics(robot, tool(robot, np.full(robot.n, 0.5)), complete=True)
    assert found.complete
    for q in found.q:
        for j in range(robot.n):
            for turn in (-TURN, TURN):
                other = q + turn * np.eye(robot.n)[j]
                inside = np.all((robot.limits.lower <= other) & (other <= robot.limits.upper))
                assert boxes_with(found, other) == inside


def test_where_a_circle_is_cut_open_solutions_are_found_once() -> None:
    robot = arm("xarm7")
    q = np.where(robot.limits.upper - robot.limits.lower >= TURN, robot.limits.lower + SEAM, 0.4)
    found = inverse_kinematics(robot, tool(robot, q), complete=True)
    assert found.complete
    assert boxes_with(found, q) == 1


def test_a_limit_is_exact(wxai: Robot) -> None:
    q = np.array([0.3, 1.2, 1.0, 0.2, 0.4, -0.5])
    pose = tool(wxai, q)

    def limited(upper: float) -> InverseSolutions:
        limits = replace(wxai.limits, upper=np.array([upper, *wxai.limits.upper[1:]]))
        return inverse_kinematics(replace(wxai, limits=limits, inverse="numeric"), pose, complete=True)

    assert boxes_with(limited(0.3 + 1e-6), q) == 1
    assert not boxes_with(limited(0.3 - 1e-6), q)
    assert limited(0.3 - 1e-6).complete
    at_the_limit = limited(0.3)
    assert at_the_limit.complete
    assert boxes_with(at_the_limit, q) == 1
    assert np.all(at_the_limit.q[:, 0] <= 0.3)


@pytest.mark.parametrize("name", ARMS)
def test_configurations_at_limits_are_solutions_within_them(name: str) -> None:
    rng, robot = np.random.default_rng(11), arm(name)
    lower, upper = robot.limits.lower, robot.limits.upper
    ends = np.flatnonzero(~np.array(robot.continuous or [False] * robot.n))
    proven = 0
    for _ in range(12):
        q = drawn(robot, rng)
        for joint in rng.choice(ends, 2):
            q[joint] = lower[joint] if rng.random() < 0.5 else upper[joint]
        found = inverse_kinematics(robot, tool(robot, q), complete=True)
        assert found.reachable is not False
        assert boxes_with(found, q) == 1 or in_doubt(found, q)
        proven += found.complete
        assert np.all(((lower <= found.q) & (found.q <= upper))[:, ends])
        assert np.all((found.lower <= found.q) & (found.q <= found.upper))
        beyond = np.maximum(lower - found.lower, found.upper - upper)[:, ends]
        for solution in found.q[np.any(beyond > 1e-9, axis=1)]:
            assert max(tool_error(robot, solution.tolist(), tool(robot, q))) <= 1.001e-11
    assert proven >= 5  # where a limit is a singularity, such as a straight elbow, some are in doubt


def test_a_limit_that_cuts_the_box_of_a_goal_with_tolerances_leaves_a_solution_within_it(wxai: Robot) -> None:
    q = np.array([0.3, 1.2, 1.0, 0.2, 0.4, -0.5])
    limits = replace(wxai.limits, upper=np.array([0.3, *wxai.limits.upper[1:]]))
    robot = replace(wxai, limits=limits, inverse="numeric")
    goal = PoseGoal(tool(wxai, q), position_tolerance=1e-5, orientation_tolerance=1e-5)
    found = inverse_kinematics(robot, goal, complete=True)
    assert found.complete
    assert boxes_with(found, q) == 1
    assert 1e-9 < found.upper[:, 0].max() - 0.3 < found.resolution
    for solution in found.q:
        assert solution[0] <= 0.3
        assert max(tool_error(robot, solution.tolist(), goal.pose)) <= 1.001e-5
    beyond = PoseGoal(tool(wxai, q + 1e-4 * np.eye(6)[0]), 1e-5, 1e-5)
    assert inverse_kinematics(robot, beyond, complete=True).reachable is not True


@pytest.mark.parametrize(
    ("name", "joint", "at", "fewest"), [("wxai", 4, math.pi / 2, 4), ("ur5", 4, 0.0, 6), ("ur5", 2, 0.0, 6)]
)
def test_at_a_singularity_what_is_not_proven_is_bounded_and_has_a_witness(
    name: str, joint: int, at: float, fewest: int
) -> None:
    rng, robot = np.random.default_rng(5), arm(name)
    seen = 0
    for _ in range(8):
        q = drawn(robot, rng)
        q[joint] = at
        pose = tool(robot, q)
        found = inverse_kinematics(robot, pose, complete=True)
        assert not found.complete
        assert in_doubt(found, q)
        assert found.reachable in (True, None)
        seen += len(found.witnesses) > 0
        known = np.concatenate([found.q, found.witnesses]).reshape(-1, robot.n)
        off = np.abs(q - known - 2 * math.pi * np.round((q - known) / (2 * math.pi)))
        assert off.max(axis=1).min(initial=math.inf) <= found.resolution
        for witness in found.witnesses:
            off, turned = tool_error(robot, witness.tolist(), pose)
            assert off <= 1.001e-11
            assert turned <= 1.001e-11
            assert in_doubt(found, witness) or boxes_with(found, witness)
            assert np.all((robot.limits.lower <= witness) & (witness <= robot.limits.upper))
    assert seen >= fewest


def test_it_is_not_known_whether_a_goal_can_be_reached_where_the_search_gave_up() -> None:
    robot = arm("ur5")
    goal = PoseGoal(tool(robot, np.array([0.3, -1.2, 1.0, 0.2, 0.4, -0.5])))
    found = complete_solutions(robot, goal, most_boxes=1)
    assert len(found.unresolved)
    assert not len(found)
    assert found.reachable is (True if len(found.witnesses) else None)
    assert complete_solutions(robot, goal).reachable is True
    assert inverse_kinematics(robot, Pose((0.0, 0.0, 5.0)), complete=True).reachable is False


def test_joints_that_do_not_move_the_tool_stay_where_they_are() -> None:
    robot = load_robot("wxai_dual")
    q = np.array(robot.home)
    found = inverse_kinematics(robot, tool(robot, q), still=q, complete=True)
    fixed = [j for j in range(robot.n) if j not in ToolChain.of(robot, q).columns]
    assert fixed
    for each in (found.q, found.lower, found.upper):
        assert np.array_equal(each[:, fixed], np.repeat(q[None, fixed], len(found), axis=0))


@pytest.mark.parametrize(
    ("name", "proven"),
    [("ur5", True), ("wxai", True), ("panda", True)],
    ids=["six joints", "closed form", "seven joints"],
)
def test_a_plan_says_that_a_goal_is_proven_to_be_out_of_reach(name: str, proven: bool) -> None:
    service = PlannerService(name, "empty")
    inside = Pose((0.0, 0.0, 5.0)) if name == "panda" else Pose((0.02, 0.0, 0.1), (0.0, 0.0, 1.0, 0.0))
    for goal in (inside, PoseGoal(inside, position_tolerance=0.005, orientation_tolerance=0.01)):
        failure = present(service.plan(PlanRequest(service.robot.home, goal)).failure)
        assert failure.reason is Reason.NO_IK_SOLUTION
        assert failure.proven == proven


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"pose": "up"}, "a Pose or a PoseGoal"),
        ({"complete": "yes"}, "True or False"),
        ({"seed": 3}, "none with complete"),
        ({"seeds": [np.zeros(6)]}, "none with complete"),
        ({"seed": np.arange(3)}, "seed: "),
        ({"seeds": np.zeros((2, 6))}, "none with complete"),
        (
            {"robot": load_robot("panda")},
            r"at most 6 joints for this goal: 'panda' has 7.*lock 1 .*or ask inverse_arcs",
        ),
        ({"pose": PoseGoal(Pose(), free_axis=(0.0, 0.0, 1.0))}, "at most 5 joints .* lock 1"),
    ],
)
def test_what_cannot_be_answered_completely_is_refused(changes: dict[str, Any], match: str, wxai: Robot) -> None:
    given: dict[str, Any] = {"robot": wxai, "pose": Pose(), "complete": True} | changes
    with pytest.raises(InvalidRequest, match=match):
        inverse_kinematics(**given)
