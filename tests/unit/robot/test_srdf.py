"""SRDF files give pairs that may touch, and named poses; and a part of a larger robot is a robot."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.robot.model import Robot
from tests.support.small_robots import joint, link, solid, urdf

# Two arms of two joints on a post; a finger, and another that mimics it, on the left one; a fixed camera.
BALL = solid("sphere", 'radius="0.1"', "0.2 0 0")
FINGER = '<mimic joint="finger_joint" multiplier="-1" offset="0.06"/>'
ARMS = "".join(
    link(f"{side}_1", BALL)
    + link(f"{side}_2", BALL)
    + joint(f"{side}_turn", f"continuous post {side}_1", xyz=f"0 {y} 0")
    + joint(f"{side}_lift", f"revolute {side}_1 {side}_2 0.5 1.5707963", axis="0 1 0", xyz="0.4 0 0")
    for side, y in (("left", 1), ("right", -1))
)
TWO = urdf(
    "two",
    link("post", solid("box", "0.1 0.1 0.1")) + ARMS + link("finger") + link("other_finger") + link("camera"),
    joint("finger_joint", "prismatic left_2 finger 0.01 0.05", axis="1 0 0"),
    joint("other_joint", "prismatic left_2 other_finger 0.01 0.05", axis="1 0 0", more=FINGER),
    joint("camera_joint", "fixed post camera"),
)
LEFT = ("left_turn", "left_lift")
ALL = (*LEFT, "right_turn", "right_lift")


def two(folder: Path) -> Path:
    path = folder / "two.urdf"
    path.write_text(TWO)
    return path


def state(name: str, group: str, **values: object) -> str:
    joints = "".join(f'<joint name="{joint}" value="{value}"/>' for joint, value in values.items())
    return f'<group_state name="{name}" group="{group}">{joints}</group_state>'


def poses(folder: Path, *states: str, joints: tuple[str, ...] = ALL) -> dict[str, list[float]]:
    (folder / "two.srdf").write_text(f'<robot name="two">{"".join(states)}</robot>')
    robot = Robot.from_urdf(two(folder), srdf=folder / "two.srdf", joints=joints)
    return {name: q.tolist() for name, q in robot.named_poses}


MIDDLE = (0.5 + 1.5707963) / 2


def test_a_state_called_home_is_home_for_the_others_too(tmp_path: Path) -> None:
    found = poses(tmp_path, state("up", "left", left_turn=0.3), state("home", "right", right_lift=0.6))
    assert found == {"home": [0.0, MIDDLE, 0.0, 0.6], "up": [0.3, MIDDLE, 0.0, 0.6]}


def test_groups_that_disagree_on_a_state_have_one_each(tmp_path: Path) -> None:
    found = poses(tmp_path, state("up", "left", left_turn=0.3), state("up", "both", left_turn=0.2, right_turn=0.4))
    assert found["left/up"] == [0.3, MIDDLE, 0.0, MIDDLE]
    assert found["both/up"] == [0.2, MIDDLE, 0.4, MIDDLE]
    assert "up" not in found


BAD = [
    (state("up", "left", left_trun=0), "group_state 'up': 'left_trun' is not a joint of the URDF"),
    (state("up", "left", left_lift=1.6), r"group_state 'up': left_lift = '1.6'; .* \[0.5, 1.5708\]"),
    (state("up", "left", left_lift="high"), "group_state 'up': left_lift = 'high'; expected a number"),
    (2 * state("up", "left", left_lift=1), "group_state 'up' of group 'left' is given twice"),
    ('<disable_collisions link1="post" link2="post"/>', "'post' twice; expected two links"),
    (501 * state("up", "left", left_lift=1), "501 group states; at most 500"),
]


@pytest.mark.parametrize(("states", "reason"), BAD)
def test_a_bad_state_is_refused_by_name(tmp_path: Path, states: str, reason: str) -> None:
    with pytest.raises(InvalidFile, match=reason):
        poses(tmp_path, states)


def test_a_part_of_a_robot_has_its_joints_in_the_order_given(tmp_path: Path) -> None:
    robot = Robot.from_urdf(two(tmp_path), tool_frame="right_2", joints=["right_lift", "right_turn"])
    assert robot.joint_names == ("right_lift", "right_turn")
    assert robot.limits.lower.tolist() == [0.5, pytest.approx(-6.2831853)]
    all_of_it = Robot.from_urdf(two(tmp_path), tool_frame="right_2", joints=ALL)
    q = [0.1, 0.7, 0.3, 1.2]
    assert robot.tool_pose([q[3], q[2]]).tolist() == all_of_it.tool_pose(q).tolist()
    assert "left_1" in robot.base_links


def test_joints_that_are_not_chosen_stand_at_zero_or_in_the_middle_or_where_they_are_locked(tmp_path: Path) -> None:
    def place(link: str, **locked: float) -> list[float]:
        arms = Robot.from_urdf(two(tmp_path), tool_frame=link, joints=("right_turn",), locked_joints=locked)
        return [round(x, 6) for x in arms.tool_pose([0.0])[:3, 3].tolist()]

    full = Robot.from_urdf(two(tmp_path), tool_frame="left_2", joints=LEFT)
    assert place("left_2") == [round(x, 6) for x in full.tool_pose([0.0, MIDDLE])[:3, 3].tolist()]
    assert place("left_2", left_turn=0.3) == [round(x, 6) for x in full.tool_pose([0.3, MIDDLE])[:3, 3].tolist()]
    finger, other = place("finger"), place("other_finger", finger_joint=0.02)
    assert finger != place("finger", finger_joint=0.02)
    assert other == place("finger", finger_joint=0.04), "a joint that mimics a locked one follows it"


def test_a_choice_of_joints_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    path = two(tmp_path)
    with pytest.raises(UnknownName, match="unknown joint 'left_trun'; did you mean 'left_turn'"):
        Robot.from_urdf(path, joints=("left_trun",))
    with pytest.raises(InvalidRequest, match=r"joints: got .*; expected at least one joint, and no joint twice"):
        Robot.from_urdf(path, joints=("left_turn", "left_turn"))
    with pytest.raises(
        InvalidRequest, match=r"locked_joints\['left_turn'\]: got 0.0; expected a joint that is not in joints"
    ):
        Robot.from_urdf(path, joints=LEFT, locked_joints={"left_turn": 0.0})
