"""robot.toml: each kind of mistake is refused by name, all of them at once."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.package_data import data_folder
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot


def load_changed(folder: Path, *changes: tuple[str, str]) -> Robot:
    """The shipped wxai with its robot.toml changed."""
    shutil.copytree(data_folder("robots") / "wxai", folder / "wxai")
    path = folder / "wxai" / "robot.toml"
    text = path.read_text()
    for old, new in changes:
        assert text.count(old) >= 1, "the change must change the file"
        text = text.replace(old, new, 1)
    path.write_text(text)
    return load_robot(path)


HOME = "home = [0.0, 0.95, 1.15, -1.25, 0.0, 0.0]"
VELOCITY = "values = [3.375, 3.375, 3.375, 7.0, 7.0, 7.0]"
FIRST_PAIR = 'links = ["base_link", "link_1"]'

BAD = [
    ("name = ", "name : ", "malformed TOML"),
    ("settle_time", "settle_tmie", "unknown key 'settle_tmie'; did you mean 'settle_time'"),
    ("width = ", "width_mm = 80\nwidth = ", "gripper: unknown key 'width_mm'; did you mean 'width'"),
    (
        'reason = "adjacent: joint_0"',
        'reason = "x"\nwhy = 1',
        r"allowed_contacts\[0\]: unknown key 'why'; expected one of links, reason",
    ),
    ("approach = [1.0, 0.0, 0.0]", "", r"gripper.approach: missing; expected \[x, y, z\]"),
    (
        "approach = [1.0, 0.0, 0.0]",
        "approach = [2.0, 0.0, 0.0]",
        r"gripper.approach: got \[2.0, 0.0, 0.0\]; expected a unit vector in the tool frame; its length is 2",
    ),
    (
        "approach = [1.0, 0.0, 0.0]",
        "approach = [0.0, 0.8, 0.6]",
        "gripper: approach .* and closing .*; expected a right angle",
    ),
    (
        "closing = [0.0, 1.0, 0.0]",
        "closing = [0.0, 0.0, 1.0]",
        r"gripper.closing = \[0.0, 0.0, 1.0\]; finger_left moves along \[0, 1, 0\] of the tool frame",
    ),
    ('name = "wxai"', "", "name: missing; expected a text"),
    ('name = "wxai"', "name = 3", "name: got 3; expected a text"),
    ('"joint_1", "joint_2"', '"joint_1", "joint_1"', "joints: got .* expected one or more different names"),
    ('"joint_1", "joint_2"', '"joint_1", "joint_9"', "joints: 'joint_9' is not a movable joint of the URDF"),
    ('"joint_5"]', '"ee_gripper"]', "movable joint 'joint_5' is neither in joints, nor in the gripper"),
    (HOME, "home = [0.0, 0.0]", r"poses.home: got \[0.0, 0.0\]; expected 6 finite numbers"),
    (HOME, HOME.replace("0.95", "nan"), r"poses.home\[1\]: got nan; expected a finite number"),
    (HOME, HOME.replace("0.95", "true"), r"poses.home\[1\]: got True; expected a finite number"),
    (HOME, HOME.replace("0.95", "-0.95"), r"poses.home: joint_1 = -0.95 is outside \[0.0000, 3.1416\]"),
    (HOME, HOME.replace("home", "start"), "poses: got .*; expected a pose named 'home' among them"),
    ("[limits.jerk]", "[poses.jerk]", "limits.jerk: missing; expected a table"),
    ('source = "our convention', 'sauce = "our convention', "limits.jerk.source: missing; expected a text"),
    (VELOCITY, VELOCITY.replace("7.0", "0.0", 1), r"limits.velocity.values\[3\]: got 0.0; expected more than 0"),
    (VELOCITY, VELOCITY.replace("7.0", "9.4", 1), "limits.velocity: joint_3 exceeds the URDF's 7"),
    ("upper = [3.0543261909900767", "upper = [3.2", r"limits.position: joint_0 .* exceeds the URDF's"),
    ("lower = [-3.05", "lower = [5.05", "limits.position: joint_0 has lower 5.05433, upper 3.05433"),
    ('tool_frame = "ee', 'tool_frame = "e', "tool_frame: 'e_gripper_link' is no link of the URDF"),
    ('base_links = ["base_link"]', 'base_links = ["floor"]', "base_links: 'floor' is no link of the URDF"),
    ('base_links = ["base_link"]', 'base_links = ["link_1"]', "base_links: link_1 moves; expected a link fixed"),
    (FIRST_PAIR, 'links = ["base_link", "link_x"]', r"allowed_contacts\[0\].links: 'link_x' is no link"),
    (FIRST_PAIR, 'links = ["link_1", "link_1"]', r"allowed_contacts\[0\].links: got .* two different link"),
    (FIRST_PAIR, 'links = ["link_2", "link_1"]', "allowed_contacts: link_1 x link_2 is listed twice"),
    ('reason = "adjacent: joint_0"', 'reason = " "', r"allowed_contacts\[0\].reason: got ' '; expected a text"),
    ('kinematics = "wxai"', 'kinematics = "magic"', "inverse_kinematics: got 'magic'; expected 'numeric' or 'wxai'"),
    ("settle_time = 0.3", "settle_time = -1", "settle_time: got -1; expected a number from 0 to"),
    ('urdf = "wxai.urdf"', 'urdf = "../wxai.urdf"', "urdf: got '../wxai.urdf'; expected a path in the robot's folder"),
    ('urdf = "wxai.urdf"', 'urdf = "wxia.urdf"', "wxia.urdf: 1 problem.*\n.*no such file"),
    ("upper = 0.080", "upper = 0.090", r"gripper: \[0, 0.09\] needs left_carriage_joint beyond \[0, 0.04\]"),
    ("width = 0.080", "width = 0.090", "gripper: lower 0, width 0.09, upper 0.08; expected lower <= width"),
    ('joints = ["left_carriage_joint"', 'joints = ["joint_5"', "gripper.joints: joint_5 is revolute; expected"),
    ('pose = "sleep"', 'pose = "slumber"', r"retreat\[0\].pose: got 'slumber'; expected one of home, ready"),
    ("to = [0.0, 0.08", "to = [0.0, -0.08", r"retreat\[0\].to: joint_1 = -0.08 is outside"),
    (
        'pairs = [["link_2", "link_5"], ["link_2", "link_4"]]',
        "pairs = []",
        r"retreat\[0\].pairs: got \[\]; expected one or more pairs",
    ),
    ("[gripper]", "gripper = 1\n[spare]", "limits.jerk: unknown key 'gripper'"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_a_bad_robot_file_is_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        load_changed(tmp_path, (old, new))


def test_an_unchanged_copy_loads(tmp_path: Path) -> None:
    assert load_changed(tmp_path).hash == load_robot("wxai").hash


def test_all_problems_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="3 problem") as caught:
        load_changed(
            tmp_path,
            (HOME, HOME.replace("0.95", "nan")),
            ("settle_time", "settle_tmie"),
            ("width = 0.080", 'width = "wide"'),
        )
    assert len(caught.value.problems) == 3


def test_all_problems_between_keys_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="3 problem") as caught:
        load_changed(
            tmp_path,
            (HOME, HOME.replace("0.95", "9.0")),
            ("width = 0.080", "width = 0.090"),
            ('urdf = "wxai.urdf"', 'urdf = "../wxai.urdf"'),
        )
    assert len(caught.value.problems) == 3


def test_a_urdf_reached_through_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    load_changed(tmp_path)
    urdf = tmp_path / "wxai" / "wxai.urdf"
    urdf.rename(tmp_path / "elsewhere.urdf")
    urdf.symlink_to(tmp_path / "elsewhere.urdf")
    with pytest.raises(InvalidFile, match="expected a path in the robot's folder"):
        load_robot(tmp_path / "wxai" / "robot.toml")


def test_a_robot_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "robot.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidFile, match="not UTF-8: byte 0xff"):
        load_robot(tmp_path / "robot.toml")


def test_joints_may_come_in_any_order(tmp_path: Path) -> None:
    """q follows robot.toml: swapping two joints with their numbers swaps the columns, and nothing else."""
    swapped = load_changed(tmp_path, ('"joint_4", "joint_5"]', '"joint_5", "joint_4"]'), *SWAPPED_NUMBERS)
    plain = load_robot("wxai")
    assert (swapped.tool_pose([0.1, 0.5, 0.6, 0.2, 0.4, 0.3]) == plain.tool_pose([0.1, 0.5, 0.6, 0.2, 0.3, 0.4])).all()
    R, t = swapped.body_poses_batch([[0.1, 0.5, 0.6, 0.2, 0.4, 0.3]])
    expected, at = plain.body_poses_batch([[0.1, 0.5, 0.6, 0.2, 0.3, 0.4]])
    assert (expected == R).all()
    assert (at == t).all()
    assert swapped.reach().tolist() == plain.reach()[[0, 1, 2, 3, 5, 4]].tolist()


SWAPPED_NUMBERS = (
    ("-1.5707963267948966, -3.141592653589793]", "-3.141592653589793, -1.5707963267948966]"),
    (
        "1.5707963267948966, 1.5707963267948966, 3.141592653589793]",
        "1.5707963267948966, 3.141592653589793, 1.5707963267948966]",
    ),
)


@pytest.mark.parametrize("name", [None, 3])
def test_what_is_no_name_is_refused(name: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"robot: got .*; expected the name of a robot or the path of a file"):
        load_robot(name)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("settle_time = ", f"settle_time = {'9' * 5000} # ", "malformed TOML|settle_time: got an integer"),
        ("settle_time = ", f"settle_time = 0x{'f' * 5000} # ", "settle_time: got an integer of thousands of digits"),
        (HOME, f"home = [0x{'f' * 5000}]", "poses.home: got a list with an integer of thousands of digits; expected 6"),
        ('urdf = "wxai.urdf"', 'urdf = "wxai\\u0000.urdf"', "urdf: got .*null"),
    ],
    ids=["long integer", "long hexadecimal", "in a list", "NUL in a path"],
)
def test_values_that_cannot_be_printed_are_still_named(tmp_path: Path, old: str, new: str, problem: str) -> None:
    with pytest.raises(InvalidFile, match=problem):
        load_changed(tmp_path, (old, new))
