"""Two opposed fingers at the end of an arm are a gripper; anything less certain is none."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service.errors import InvalidRequest
from planner_service.robot.model import Robot
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import joint, link, solid, urdf

BAR = solid("box", "0.02 0.02 0.2", "0 0 0.1")
ARM = (
    link("base", solid("box", "0.1 0.1 0.1")),
    link("arm", BAR),
    link("palm", solid("box", "0.2 0.04 0.04")),
    joint("turn", "revolute base arm -2 2", xyz="0 0 0.1", axis="0 1 0"),
    joint("roll", "revolute arm palm -2 2", xyz="0 0 0.25"),
)
FINGER = solid("box", "0.01 0.02 0.08", "0 0 0.04")


def fingers(*more: str, left: str = "0 0.04", right: str = "0 0.04", axis: str = "-1 0 0", apart: float = 0.01) -> str:
    """Two that slide along x, their inner faces ``apart`` at 0, ahead of the palm along z."""
    away = 0.005 + apart / 2.0
    return urdf(
        "gripping",
        *ARM,
        link("left", FINGER) + link("right", FINGER) + link("grasp"),
        joint("slide_left", f"prismatic palm left {left}", axis="1 0 0", xyz=f"{away} 0 0.03"),
        joint("slide_right", f"prismatic palm right {right}", axis=axis, xyz=f"{-away} 0 0.03"),
        joint("between", "fixed palm grasp", xyz="0 0 0.09", rpy="0 0 1.5707963267948966"),
        *more,
    )


def turning(*more: str, multiplier: str = "-1") -> str:
    """Two that turn about y, the second as the first."""
    mimic = f'<mimic joint="knuckle_left" multiplier="{multiplier}"/>'
    return urdf(
        "turning",
        *ARM,
        link("left", FINGER) + link("right", FINGER),
        joint("knuckle_left", "revolute palm left 0 0.8", axis="0 1 0", xyz="0.02 0 0.03"),
        joint("knuckle_right", "revolute palm right -0.8 0", axis="0 1 0", xyz="-0.02 0 0.03", more=mimic),
        *more,
    )


def loaded(folder: Path, text: str, srdf: str = "") -> Robot:
    (folder / "gripping.urdf").write_text(text, "utf-8")
    if srdf:
        (folder / "gripping.srdf").write_text(srdf, "utf-8")
    return load_robot(folder / "gripping.urdf")


def test_sliding_fingers_are_a_gripper_with_axes_in_the_frame_between_their_tips(tmp_path: Path) -> None:
    robot = loaded(tmp_path, fingers(apart=0.0))
    gripper = robot.gripper
    assert gripper is not None
    assert robot.joint_names == ("turn", "roll")
    assert (gripper.kind, gripper.joints, robot.tool_frame) == ("parallel", ("slide_left", "slide_right"), "grasp")
    assert (gripper.lower, gripper.upper) == (0.0, 0.08)
    assert gripper.approach == (0.0, 0.0, 1.0)
    assert gripper.closing in ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0))  # x of the palm


def test_a_gap_at_zero_is_part_of_the_width(tmp_path: Path) -> None:
    gripper = loaded(tmp_path, fingers(left="-0.005 0.04", right="-0.005 0.04")).gripper
    assert gripper is not None
    assert (gripper.lower, gripper.upper) == pytest.approx((0.0, 0.09))
    kept = loaded(tmp_path, fingers()).gripper  # these cannot meet
    assert kept is not None
    assert (kept.lower, kept.upper) == pytest.approx((0.01, 0.09))


def test_turning_fingers_are_a_gripper_whose_width_is_between_their_tips(tmp_path: Path) -> None:
    gripper = loaded(tmp_path, turning()).gripper
    assert gripper is not None
    assert (gripper.kind, gripper.joints, set(gripper.tips)) == ("revolute", ("knuckle_left",), {"left", "right"})
    assert gripper.approach == (0.0, 0.0, 1.0)
    assert gripper.upper > gripper.lower


@pytest.mark.parametrize(
    "text",
    [
        fingers(axis="0 1 0"),  # across each other
        fingers(joint("wrist", "revolute left tip -1 1", axis="1 0 0"), link("tip", FINGER)),
        urdf("jaw", *ARM, link("left", FINGER), joint("jaw", "revolute palm left 0 1", axis="0 1 0")),
    ],
    ids=["across", "a joint on a finger", "one jaw"],
)
def test_what_is_not_certain_is_no_gripper(tmp_path: Path, text: str) -> None:
    assert loaded(tmp_path, text).gripper is None


def test_import_writes_it_and_knows_pairs_with_fingers_at_every_opening(tmp_path: Path) -> None:
    text = fingers(left="-0.005 0.04", right="-0.005 0.04")
    (tmp_path / "gripping.urdf").write_text(text, "utf-8")
    found = import_robot(Source(tmp_path / "gripping.urdf"), tmp_path / "out", prove=True)
    gripper = found.robot.gripper
    assert gripper is not None
    assert "closed_at = [-0.005, -0.005]" in found.path.read_text()
    plain = load_robot(tmp_path / "gripping.urdf").gripper
    assert plain is not None
    assert (gripper.lower, gripper.upper, gripper.closing) == (plain.lower, plain.upper, plain.closing)
    judged = {frozenset(finding.links) for finding in found.table.findings}
    assert frozenset(("left", "right")) in judged  # joints where the table was worked out
    kept = import_robot(Source(tmp_path / "gripping.urdf", locked_joints={"slide_left": 0.0}), tmp_path / "locked")
    assert kept.robot.gripper is None


def test_a_jaw_around_its_own_axis_is_no_gripper_however_it_is_named(tmp_path: Path) -> None:
    (tmp_path / "jaw.urdf").write_text(
        urdf("jaw", *ARM, link("left", solid("box", "0.01 0.02 0.02")), joint("jaw", "revolute palm left 0 1"))
    )
    with pytest.raises(InvalidRequest, match="are at one place"):
        load_robot(tmp_path / "jaw.urdf", gripper=["jaw"])
