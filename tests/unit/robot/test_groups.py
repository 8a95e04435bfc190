"""Planning groups: what an SRDF's groups are, and the robot that each leaves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from tests.support.small_robots import joint, link, solid, urdf

TREE = urdf(
    "tree",
    *(link(name, solid("sphere", 'radius="0.02"')) for name in ("base", "l1", "l2", "r1", "r2", "hand")),
    joint("left_1", "revolute base l1 -2 2", xyz="0 0.3 0"),
    joint("left_2", "revolute l1 l2 -2 2", xyz="0.3 0 0"),
    joint("right_1", "revolute base r1 -2 2", xyz="0 -0.3 0"),
    joint("right_2", "revolute r1 r2 -2 2", xyz="0.3 0 0"),
    joint("grip", "fixed r2 hand", xyz="0.1 0 0"),
)

GROUPS = {
    "left": '<chain base_link="base" tip_link="l2"/>',
    "right": '<chain base_link="base" tip_link="hand"/>',
    "both": '<group name="left"/><group name="right"/>',
    "elbows": '<joint name="left_2"/><joint name="right_2"/>',
    "by_link": '<link name="l1"/><link name="base"/>',
    "stiff": '<joint name="grip"/>',
    "unknown": '<joint name="none"/>',
    "backwards": '<chain base_link="l2" tip_link="base"/>',
}


def tree(folder: Path, groups: dict[str, str]) -> Robot:
    (folder / "tree.urdf").write_text(TREE)
    inside = "".join(f'<group name="{name}">{members}</group>' for name, members in groups.items())
    (folder / "tree.srdf").write_text(f'<robot name="tree">{inside}</robot>')
    return Robot.from_urdf(folder / "tree.urdf", srdf=folder / "tree.srdf")


MEMBERS = {
    "left": (["left_1", "left_2"], "l2"),
    "right": (["right_1", "right_2"], "hand"),
    "both": (["left_1", "left_2", "right_1", "right_2"], None),
    "elbows": (["left_2", "right_2"], None),
    "by_link": (["left_1"], None),
}


@pytest.mark.parametrize("name", MEMBERS)
def test_a_group_moves_its_joints_alone_and_its_tool_is_the_end_of_its_chain(tmp_path: Path, name: str) -> None:
    robot = tree(tmp_path, GROUPS)
    part, (joints, tip) = robot.group(name), MEMBERS[name]
    assert sorted(part.joint_names) == joints
    assert part.tool_frame == (tip or robot.tool_frame)
    q = robot.home.copy()
    rng = np.random.default_rng(3)
    for k, own in enumerate(robot.joint_names):
        if own in joints:
            q[k] = rng.uniform(-1.0, 1.0)
    inside = [q[robot.joint_names.index(own)] for own in part.joint_names]
    for frame in part.link_frames:
        whole, T = robot.link_frame(frame.link)
        there = body_matrix(robot.body_poses(q)[whole]) @ T
        here = body_matrix(part.body_poses(inside)[frame.body]) @ frame.pose.matrix
        np.testing.assert_allclose(here, there, atol=1e-12)


def test_a_group_that_is_none_is_answered_by_those_that_there_are(tmp_path: Path) -> None:
    robot = tree(tmp_path, GROUPS)
    assert [group.name for group in robot.groups] == [*MEMBERS, "stiff"]
    with pytest.raises(UnknownName, match=r"unknown planning group 'lefft'.*left"):
        robot.group("lefft")
    with pytest.raises(InvalidRequest, match="group: got 'stiff'; expected one with joints that move; grip do not"):
        robot.group("stiff")


def test_groups_that_hold_each_other_are_refused(tmp_path: Path) -> None:
    circle = {"a": '<group name="b"/>', "b": '<group name="a"/>'}
    with pytest.raises(InvalidFile, match="group 'a' holds itself: a -> b -> a"):
        tree(tmp_path, circle)
