"""Robots at places are one robot, and each arm alone is what it was, moved."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import Attached, Box, InvalidRequest, Pose, Scene, UnknownName, inverse_kinematics, load_robot
from planner_service.cell import Arm, Cell

WXAI, UR5 = load_robot("wxai"), load_robot("ur5")
TURNED = Pose((0.1, -0.4, 0.05), (0.6, 0.0, 0.0, 0.8))
EMPTY = Scene(())


@pytest.fixture(scope="module")
def cell() -> Cell:
    return Cell({"near": WXAI, "far": Arm(UR5, TURNED)}, EMPTY)


def test_joints_follow_each_other_under_the_arms_names(cell: Cell) -> None:
    assert cell.arms == ("near", "far")
    assert cell.robot.joint_names == (*(f"near_{j}" for j in WXAI.joint_names), *(f"far_{j}" for j in UR5.joint_names))
    assert cell.robot.group("far").joint_names == tuple(f"far_{joint}" for joint in UR5.joint_names)


def test_a_tool_is_where_its_robot_has_it_seen_from_its_base(cell: Cell) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(UR5.limits.lower, UR5.limits.upper)
        expected = TURNED.matrix @ UR5.tool_pose(q)
        assert cell.arm("far").robot.tool_pose(q) == pytest.approx(expected, abs=1e-12)
        assert cell.robot.group("far").tool_pose(q) == pytest.approx(expected, abs=1e-12)


def test_inverse_kinematics_of_an_arm_is_in_the_cells_frame(cell: Cell) -> None:
    turned = Cell({"a": Arm(WXAI, TURNED), "b": Arm(UR5, Pose((1.0, 0.0, 0.0)))}, EMPTY).arm("a").robot
    tool = Pose.from_matrix(turned.tool_pose(WXAI.home))
    assert min(np.abs(q - WXAI.home).max() for q in inverse_kinematics(turned, tool)) < 1e-6


def test_what_touches_in_the_whole_is_what_touches_alone_or_between_arms(cell: Cell) -> None:
    rng, whole = np.random.default_rng(2), cell.service.checker
    free = 0
    for _ in range(300):
        q = {name: rng.uniform(*(cell.arm(name).robot.bounds)) for name in cell.arms}
        alone = all(cell.arm(name).checker.state_is_free(q[name]) for name in cell.arms)
        beside = cell.arm("near", {"far": q["far"]}).checker.state_is_free(q["near"])
        assert whole.state_is_free(cell.joined(q)) == (alone and beside)
        free += alone and beside
    assert 10 < free < 290, "it says something of both kinds"


def test_an_arm_that_stands_is_where_it_stands(cell: Cell) -> None:
    standing = cell.arm("near", {"far": UR5.home}).robot
    moving = {item.link: item for item in cell.arm("far").robot.shapes}
    poses = cell.arm("far").robot.body_poses(UR5.home)
    item = next(item for item in standing.shapes if item.link == "far_forearm_link")
    assert item.body == 0
    expected = np.array(poses[moving[item.link].body][9:]) + np.reshape(poses[moving[item.link].body][:9], (3, 3)) @ (
        moving[item.link].pose.position
    )
    assert item.pose.position == pytest.approx(expected, abs=1e-12)


def test_arms_of_one_robot_have_their_joints_and_tools() -> None:
    dual = load_robot("wxai_dual")
    groups = {side: [name for name in dual.joint_names if name.startswith(side)] for side in ("left", "right")}
    cell = Cell.of(dual, groups, "table", tools={"right": "right_ee_gripper_link"})
    left, right = (cell.arm(name).robot for name in cell.arms)
    assert (left.tool_frame, right.tool_frame) == ("left_ee_gripper_link", "right_ee_gripper_link")
    assert (left.gripper is None, right.gripper is None) == (False, True)
    assert right.tool_pose(right.home)[:3, 3] == pytest.approx(left.tool_pose(left.home)[:3, 3] - [0.0, 0.5, 0.0])
    assert not {item.link for item in left.shapes if item.body > 0} & {item.link for item in right.shapes if item.body}


@pytest.mark.parametrize(
    ("arms", "named"),
    [
        ({}, "arms"),
        ({str(k): WXAI for k in range(5)}, "1 to 4"),
        ({"a": 3}, "arms\\['a'\\]"),
        ({"": WXAI}, "arms"),
        ([WXAI], "arms"),
    ],
)
def test_what_is_no_cell_is_refused(arms: object, named: str) -> None:
    with pytest.raises(InvalidRequest, match=named):
        Cell(arms, EMPTY)  # type: ignore[arg-type]


def test_names_that_would_be_one_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="'a_b_"):
        Cell({"a": Cell({"b": WXAI}, EMPTY).robot, "a_b": WXAI}, EMPTY)


@pytest.mark.parametrize(
    ("groups", "error"),
    [
        ({"a": ["left_joint_0"], "b": ["left_joint_0"]}, InvalidRequest),
        ({"a": ["left_joint_0"], "b": ["left_joint_1"]}, InvalidRequest),
        ({"a": ["no_joint"]}, UnknownName),
        ({"a": []}, InvalidRequest),
    ],
)
def test_what_are_no_arms_of_a_robot_is_refused(groups: dict[str, list[str]], error: type[Exception]) -> None:
    with pytest.raises(error):
        Cell.of("wxai_dual", groups, EMPTY)


def test_a_cell_begins_with_empty_hands() -> None:
    scene = Scene((), (Attached("box", Box((0.05, 0.05, 0.05)), Pose()),))
    with pytest.raises(InvalidRequest, match="box"):
        Cell({"a": WXAI}, scene)
