"""What a TOML file asks of a cell, or what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service import InvalidFile, Pose
from planner_service.records.cells import read_cell_request

GOOD = """
scene = "empty"
delay = 0.1

[[arm]]
name = "left"
robot = "planar2"
start = [0.0, 0.1]
goal = [1.5, 0.1]
velocity_scale = 0.2

[[arm]]
name = "right"
robot = "planar2"
position = [2.2, 0.0, 0.0]
quaternion_wxyz = [0.0, 0.0, 0.0, 1.0]
start = [0.6, 0.1]
goal = [-0.6, 0.1]
"""


def written(folder: Path, text: str) -> Path:
    (folder / "cell.toml").write_text(text)
    return folder / "cell.toml"


def test_a_cell_and_its_requests_are_read(tmp_path: Path) -> None:
    asked = read_cell_request(written(tmp_path, GOOD))
    assert asked.cell.arms == ("left", "right")
    assert asked.delay == 0.1
    assert asked.requests["left"].velocity_scale == 0.2
    assert asked.cell.layout.arms["right"].base == Pose((2.2, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    plan = asked.cell.plan(asked.requests, standing=asked.standing, delay=asked.delay)
    assert plan.ok
    assert plan.tolerates >= 0.1


def test_an_arm_stands_and_ends_at_a_pose_of_the_tool(tmp_path: Path) -> None:
    stands = GOOD.replace("start = [0.6, 0.1]\ngoal = [-0.6, 0.1]", 'stands = "folded"')
    pose = "goal = { position = [1.0, 1.0, 0.0], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }"
    asked = read_cell_request(written(tmp_path, stands.replace("goal = [1.5, 0.1]", pose)))
    assert asked.standing["right"].tolist() == [0.0, 3.0]
    assert asked.requests["left"].goal == Pose((1.0, 1.0, 0.0))


def test_a_scene_beside_the_file_is_found(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('[[obstacle]]\nname = "post"\nsphere = 0.05\nposition = [0.0, -1.0, 0.0]\n')
    asked = read_cell_request(written(tmp_path, GOOD.replace('"empty"', '"mine.toml"')))
    assert asked.cell.scene.names == ("post",)


WRONG = {
    "an unknown word": (("delay", "lateness"), "unknown key"),
    "an unknown robot": (('"planar2"', '"planar3"'), "unknown robot"),
    "an unknown scene": (('"empty"', '"emty"'), "unknown scene"),
    "one name twice": (('"right"', '"left"'), "each name once"),
    "a pose that is not there": (("[0.6, 0.1]", '"folde"'), "folde"),
    "other joints": (("[0.6, 0.1]", "[0.6]"), "right.start"),
    "no start": (("start = [0.6, 0.1]", ""), "right.start"),
    "no goal": (("goal = [-0.6, 0.1]", ""), "right.goal"),
    "a start and a stand": (("start = [0.6, 0.1]", "stands = [0.6, 0.1]"), "right.start"),
    "a scale": (("velocity_scale = 0.2", "velocity_scale = 2.0"), "velocity_scale"),
    "a place": (("[2.2, 0.0, 0.0]", "[2.2, 0.0]"), "position"),
    "no numbers": (("delay = 0.1", "delay = nan"), "delay"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named(what: str, tmp_path: Path) -> None:
    (old, new), said = WRONG[what]
    with pytest.raises(InvalidFile, match=said):
        read_cell_request(written(tmp_path, GOOD.replace(old, new)))
