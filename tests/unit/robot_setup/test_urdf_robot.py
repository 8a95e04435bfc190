"""A URDF alone is a robot to plan with: what it leaves open comes from the SRDF beside it or from its shapes."""

from __future__ import annotations

import logging
import math
import re
from pathlib import Path

import numpy as np
import pytest

from planner_service.certify import certify
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, UnknownName
from planner_service.planning.request import PlanRequest
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Scene
from planner_service.service import PlannerService
from tests.support.small_robots import joint, link, solid, urdf
from tests.unit.robot_setup.test_import_robot import MESHED
from tests.unit.robot_setup.test_import_robot import solid as stl

BALL = 'radius="0.05"'

# The trunk is a ball that holds all the rest: the stub, next to it, and the tip, four joints on. The wing is apart from
# the trunk, and touches the tip in places.
NESTED = urdf(
    "nested",
    link("trunk", solid("sphere", 'radius="1.0"')) + link("stub", solid("sphere", BALL)),
    link("one") + link("two") + link("tip", solid("sphere", BALL)) + link("wing", solid("sphere", BALL)),
    joint("a", "revolute trunk stub -2 2"),
    joint("b", "revolute stub one -2 2", axis="0 1 0", xyz="0.1 0 0"),
    joint("c", "revolute one two -2 2", axis="0 1 0", xyz="0.1 0 0"),
    joint("d", "revolute two tip -2 2", axis="0 1 0", xyz="0.1 0 0"),
    joint("e", "prismatic trunk wing 0.3 3", axis="1 0 0"),
)

# A post turns; a bar on it turns, too, at home through the foot, of which it is free when it has turned up.
BARRED = urdf(
    "barred",
    link("foot", solid("box", "1 1 0.2")) + link("post", solid("sphere", BALL, "0 0 0.3")),
    link("bar", solid("box", "0.02 0.02 0.4", "0 0 -0.2")),
    joint("turn", "revolute foot post -3 3"),
    joint("tilt", "revolute post bar -3 3", axis="0 1 0", xyz="0 0 0.3"),
)


def srdf(*parts: str, name: str = "nested") -> str:
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def disabled(a: str, b: str) -> str:
    return f'<disable_collisions link1="{a}" link2="{b}" reason="Never"/>'


def state(name: str, **values: float) -> str:
    joints = "".join(f'<joint name="{key}" value="{value}"/>' for key, value in values.items())
    return f'<group_state name="{name}" group="arm">{joints}</group_state>'


def written(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def reasons(robot: Robot) -> dict[tuple[str, str], str]:
    return {contact.links: contact.reason for contact in robot.allowed_contacts}


def test_links_that_always_overlap_may_touch_and_the_reason_says_how_that_was_seen(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path / "nested.urdf", NESTED))
    assert reasons(robot) == {
        ("trunk", "stub"): "adjacent",
        ("stub", "tip"): "adjacent",
        ("trunk", "wing"): "adjacent",
        (
            "trunk",
            "tip",
        ): "always: the shapes overlap in each of 1,000 configurations drawn at random, which is no proof",
    }


def test_links_that_no_sample_saw_touch_stay_checked(tmp_path: Path) -> None:
    far = NESTED.replace('lower="0.3"', 'lower="2"')
    robot = load_robot(written(tmp_path / "nested.urdf", far))
    assert set(robot.link_pairs) == {("stub", "wing"), ("tip", "wing")}


def test_links_that_overlap_at_home_but_come_apart_stay_checked_and_home_moves_to_where_the_robot_is_free(
    tmp_path: Path,
) -> None:
    robot = load_robot(written(tmp_path / "barred.urdf", BARRED))
    assert robot.link_pairs == (("foot", "bar"),)
    assert CollisionChecker(robot, Scene()).state_is_free(robot.home)
    assert np.abs(robot.home).max() < 2.0
    assert load_robot(tmp_path / "barred.urdf").hash == robot.hash


def test_a_sweep_decides_where_few_joints_lie_between(tmp_path: Path) -> None:
    """The bar leaves the foot only in the last half milliradian of its tilt, in one configuration of thousands."""
    rarely = BARRED.replace('lower="-3" upper="3"', 'lower="-1" upper="1.0729"').replace("1 1 0.2", "2 2 0.2")
    robot = load_robot(written(tmp_path / "barred.urdf", rarely))
    drawn = robot.limits.lower + (robot.limits.upper - robot.limits.lower) * np.random.default_rng(0).random((1000, 2))
    assert not CollisionChecker(robot, Scene()).states_are_free(drawn).any()
    assert robot.link_pairs == (("foot", "bar"),)


@pytest.mark.parametrize("place", ["nested.srdf", "other.srdf", "../srdf/nested.srdf", "../config/other.srdf"])
def test_the_srdf_beside_it_gives_pairs_home_and_tool(tmp_path: Path, place: str) -> None:
    chain = '<group name="arm"><chain base_link="trunk" tip_link="two"/></group>'
    path = written(tmp_path / "urdf" / "nested.urdf", NESTED)
    written(path.parent / place, srdf(chain, state("ready", a=0.5), disabled("stub", "wing")))
    robot = load_robot(path)
    assert robot.tool_frame == "two"
    assert robot.home[0] == 0.5
    assert reasons(robot)["stub", "wing"] == "Never"


def test_home_comes_before_ready(tmp_path: Path) -> None:
    written(tmp_path / "nested.srdf", srdf(state("ready", a=0.5), state("home", a=0.25)))
    assert load_robot(written(tmp_path / "nested.urdf", NESTED)).home[0] == 0.25


@pytest.mark.parametrize("names", [["x.srdf", "y.srdf"], ["x.srdf"]])
def test_an_srdf_of_another_robot_or_one_of_several_is_not_used(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        whose = "nested" if len(names) > 1 else "another"
        written(tmp_path / name, srdf(disabled("stub", "wing"), name=whose))
    assert ("stub", "wing") in load_robot(written(tmp_path / "nested.urdf", NESTED)).link_pairs


def test_of_an_srdf_what_has_problems_is_not_used_and_a_warning_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = srdf(disabled("stub", "wing"), disabled("stub", "nose"), state("home", a=3.0), state("ready", a=0.5))
    written(tmp_path / "nested.srdf", text)
    with caplog.at_level(logging.WARNING):
        robot = load_robot(written(tmp_path / "nested.urdf", NESTED))
    assert ("stub", "wing") not in robot.link_pairs
    assert robot.home[0] == 0.5
    assert "nested.srdf: not used of it: disable_collisions[1]: 'nose' is not a link of the URDF" in caplog.text
    assert "group_state 'home': a = '3.0'; expected a number in [-2, 2]" in caplog.text


def test_an_srdf_that_cannot_be_read_is_not_used_and_a_warning_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    written(tmp_path / "nested.srdf", "<robot")
    with caplog.at_level(logging.WARNING):
        robot = load_robot(written(tmp_path / "nested.urdf", NESTED))
    assert ("stub", "wing") in robot.link_pairs
    assert "nested.srdf is not used: " in caplog.text


def test_the_meshes_of_its_ros_package_are_found(tmp_path: Path) -> None:
    package = tmp_path / "arm"
    for name, size in (("a", 0.4), ("b", 0.05)):
        written(package / name / "part.stl", stl(size))
    relative = MESHED.replace("package://arm/", "../")
    assert load_robot(written(package / "urdf" / "meshed.urdf", relative)).n == 3
    package = package.rename(tmp_path / "other")
    path = written(package / "description" / "variants" / "meshed.urdf", MESHED)
    with pytest.raises(InvalidFile, match="does not exist in the folders that may be read"):
        load_robot(path)
    written(package / "package.xml", "<package/>")
    assert load_robot(path).n == 3
    (package / "package.xml").unlink()
    package = package.rename(tmp_path / "arm")
    with pytest.raises(InvalidFile, match="does not exist in the folders that may be read"):
        load_robot(package / "description" / "variants" / "meshed.urdf")


def test_a_package_that_is_named_as_a_folder_above_is_that_folder(tmp_path: Path) -> None:
    models = tmp_path / "arm" / "models" / "small"
    for name, size in (("a", 0.4), ("b", 0.05)):
        written(models / name / "part.stl", stl(size))
    text = MESHED.replace("package://arm/", "package://arm/models/small/")
    assert load_robot(written(models / "meshed.urdf", text)).n == 3


@pytest.mark.parametrize("limit", ['<limit lower="-1" upper="1"/>', '<limit lower="-1" upper="1" velocity="0"/>'])
def test_a_velocity_that_is_not_stated_is_a_slow_one_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, limit: str
) -> None:
    text, stated = BARRED, load_robot(written(tmp_path / "stated.urdf", BARRED))
    given = re.findall(r"<limit[^>]*>", text)
    path = written(tmp_path / "silent.urdf", text.replace(given[0], limit, 1))
    with caplog.at_level(logging.INFO):
        robot = load_robot(path)
    assert robot.limits.velocity.tolist()[0] == 1.0
    assert robot.limits.velocity.tolist()[1:] == stated.limits.velocity.tolist()[1:]
    assert f"no velocity is stated for {robot.joint_names[0]}" in caplog.text


@pytest.mark.parametrize("filename", ["package://{}/part.stl", "package:///{}/part.stl", "package://../part.stl"])
def test_meshes_elsewhere_are_refused(tmp_path: Path, filename: str) -> None:
    written(tmp_path / "part.stl", stl(0.1))
    named = filename.format(str(tmp_path).strip("/"))
    path = written(tmp_path / "arm" / "meshed.urdf", MESHED.replace("package://arm/a/part.stl", named))
    with pytest.raises(InvalidFile, match=r"link 'base' collision\[0\]: mesh .*folders that may be read"):
        load_robot(path)


def test_a_path_that_is_none_is_refused() -> None:
    with pytest.raises(InvalidFile, match="cannot be read"):
        load_robot("a\0b.urdf")


def test_a_service_takes_a_urdf_and_its_plans_are_proven(tmp_path: Path) -> None:
    path = written(tmp_path / "barred.urdf", BARRED)
    service = PlannerService(str(path), Scene())
    turn, tilt = service.robot.home.tolist()
    result = service.plan(PlanRequest([turn, tilt], [-2.0, math.copysign(2.5, tilt)]))
    assert result.certificate is not None
    assert result.certificate.clearance > 0.0


def test_robots_of_example_robot_data_have_names() -> None:
    robot = load_robot("example-robot-data:ur5_robot")
    service = PlannerService(robot, Scene())
    assert service.plan(PlanRequest(robot.home, robot.home + 0.2)).certificate is not None


def test_an_unknown_example_is_answered_by_a_similar_name_and_one_of_several_by_its_folder() -> None:
    with pytest.raises(UnknownName, match="unknown robot of example-robot-data 'ur5'; did you mean 'ur5_robot'"):
        load_robot("example-robot-data:ur5")
    with pytest.raises(UnknownName) as raised:
        load_robot("example-robot-data:anymal")
    assert {f"anymal_{kind}_simple_description/anymal" for kind in "bc"} <= set(raised.value.available)


def test_a_certificate_names_each_pair_that_the_robot_allows_to_touch(tmp_path: Path) -> None:
    """Each pair of links on different bodies is checked or named with a reason: there is no third kind."""
    robot = load_robot(written(tmp_path / "nested.urdf", NESTED))
    certificate = certify(robot, Scene(), [robot.home, robot.home])
    assert {contact.links: contact.reason for contact in certificate.contacts} == reasons(robot)
    exempt = {frozenset(contact.links) for contact in certificate.contacts}
    assert exempt.isdisjoint(frozenset(links) for links in robot.link_pairs)
    linked = {item.link: item.body for item in robot.shapes}
    pairs = {frozenset((a, b)) for a in linked for b in linked if linked[a] != linked[b]}
    assert exempt | {frozenset(links) for links in robot.link_pairs} == pairs
