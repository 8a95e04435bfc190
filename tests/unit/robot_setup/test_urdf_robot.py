"""A URDF alone is a robot to plan with: what it leaves open comes from the SRDF beside it or from its shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.certify import certify
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Scene
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


def test_links_that_overlap_at_home_but_come_apart_stay_checked_and_home_moves_to_where_the_robot_is_free(
    tmp_path: Path,
) -> None:
    robot = load_robot(written(tmp_path / "barred.urdf", BARRED))
    assert robot.link_pairs == (("foot", "bar"),)
    assert CollisionChecker(robot, Scene()).state_is_free(robot.home)
    assert np.abs(robot.home).max() < 2.0
    assert load_robot(tmp_path / "barred.urdf").hash == robot.hash


@pytest.mark.parametrize("place", ["other.srdf", "../config/other.srdf"])
def test_the_srdf_beside_it_gives_pairs_home_and_tool(tmp_path: Path, place: str) -> None:
    chain = '<group name="arm"><chain base_link="trunk" tip_link="two"/></group>'
    path = written(tmp_path / "urdf" / "nested.urdf", NESTED)
    written(path.parent / place, srdf(chain, state("ready", a=0.5), disabled("stub", "wing")))
    robot = load_robot(path)
    assert robot.tool_frame == "two"
    assert robot.home[0] == 0.5
    assert reasons(robot)["stub", "wing"] == "Never"


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


@pytest.mark.parametrize("filename", ["package://{}/part.stl", "package://../part.stl"])
def test_meshes_elsewhere_are_refused(tmp_path: Path, filename: str) -> None:
    written(tmp_path / "part.stl", stl(0.1))
    named = filename.format(str(tmp_path).strip("/"))
    path = written(tmp_path / "arm" / "meshed.urdf", MESHED.replace("package://arm/a/part.stl", named))
    with pytest.raises(InvalidFile, match=r"link 'base' collision\[0\]: mesh .*folders that may be read"):
        load_robot(path)


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
