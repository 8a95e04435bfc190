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
    ("approach = [1.0, 0.0, 0.0]", "approach = [2.0, 0.0, 0.0]", "gripper.approach: got .* a unit vector"),
    ("closing = [0.0, 1.0, 0.0]", "closing = [0.0, 0.0, 1.0]", "gripper.closing = .*; finger_left moves along"),
    ('name = "wxai"', "", "name: missing; expected a text"),
    ('"joint_1", "joint_2"', '"joint_1", "joint_9"', "joints: 'joint_9' is not a movable joint of the URDF"),
    (HOME, "home = [0.0, 0.0]", r"poses.home: got \[0.0, 0.0\]; expected 6 finite numbers"),
    ("[limits.jerk]", "[poses.jerk]", "limits.jerk: missing; expected a table"),
    (VELOCITY, VELOCITY.replace("7.0", "9.4", 1), "limits.velocity: joint_3 exceeds the URDF's 7"),
    ("lower = [-3.05", "lower = [5.05", "limits.position: joint_0 has lower 5.05433, upper 3.05433"),
    ('base_links = ["base_link"]', 'base_links = ["link_1"]', "base_links: link_1 moves; expected a link fixed"),
    (FIRST_PAIR, 'links = ["link_1", "link_1"]', r"allowed_contacts\[0\].links: got .* two different link"),
    ('reason = "adjacent: joint_0"', 'reason = " "', r"allowed_contacts\[0\].reason: got ' '; expected a text"),
    ('urdf = "wxai.urdf"', 'urdf = "wxia.urdf"', "wxia.urdf: 1 problem.*\n.*no such file"),
    ("width = 0.080", "width = 0.090", "gripper: lower 0, width 0.09, upper 0.08; expected lower <= width"),
    ('pose = "sleep"', 'pose = "slumber"', r"retreat\[0\].pose: got 'slumber'; expected one of home, ready"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_a_bad_robot_file_is_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        load_changed(tmp_path, (old, new))


def test_all_problems_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="3 problem") as caught:
        load_changed(
            tmp_path,
            (HOME, HOME.replace("0.95", "nan")),
            ("settle_time", "settle_tmie"),
            ("width = 0.080", 'width = "wide"'),
        )
    assert len(caught.value.problems) == 3


def test_a_urdf_reached_through_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    load_changed(tmp_path)
    urdf = tmp_path / "wxai" / "wxai.urdf"
    urdf.rename(tmp_path / "elsewhere.urdf")
    urdf.symlink_to(tmp_path / "elsewhere.urdf")
    with pytest.raises(InvalidFile, match="expected a path in the robot's folder"):
        load_robot(tmp_path / "wxai" / "robot.toml")


@pytest.mark.parametrize("name", [None, 3])
def test_what_is_no_name_is_refused(name: Any) -> None:
    with pytest.raises(InvalidRequest, match=r"robot: got .*; expected the name of a robot or the path of a file"):
        load_robot(name)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        (HOME, f"home = [0x{'f' * 5000}]", "poses.home: got a list with an integer of thousands of digits; expected 6"),
        ('urdf = "wxai.urdf"', 'urdf = "wxai\\u0000.urdf"', "urdf: got .*null"),
    ],
)
def test_values_that_cannot_be_printed_are_still_named(tmp_path: Path, old: str, new: str, problem: str) -> None:
    with pytest.raises(InvalidFile, match=problem):
        load_changed(tmp_path, (old, new))
