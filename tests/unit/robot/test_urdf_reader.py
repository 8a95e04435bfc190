"""The URDF reader: a good file is read as written, and each kind of bad one is refused by name."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from planner_service.errors import InvalidFile
from planner_service.geometry.shapes import Box, Cylinder, Sphere
from planner_service.robot.urdf_model import Mimic, Urdf
from planner_service.robot.urdf_reader import read_urdf
from tests.support.optional import present

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial><mass value="1.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial>
    <visual><geometry><mesh filename="/etc/passwd"/></geometry></visual>
    <collision><origin xyz="0 0 0.1" rpy="0 0.5 0"/><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
    <collision><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>
  </link>
  <link name="hand"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="pad"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 3 0"/><limit lower="-1" upper="2" velocity="3"/>
  </joint>
  <joint name="wrist" type="continuous"><parent link="upper"/><child link="hand"/><origin xyz="0 0 1"/></joint>
  <joint name="slide" type="prismatic">
    <parent link="hand"/><child link="pad"/><limit lower="0" upper="0.1" velocity="1"/>
    <mimic joint="wrist" multiplier="0.5"/>
  </joint>
  <transmission name="ignored"/>
</robot>
"""


def read(tmp_path: Path, text: str, encoding: str = "utf-8") -> Urdf:
    path = tmp_path / "robot" / "arm.urdf"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.encode(encoding))
    return read_urdf(path)


def changed(old: str, new: str) -> str:
    assert ARM.count(old) == 1, "the change must change the file"
    return ARM.replace(old, new)


def test_a_good_file_is_read_as_written(tmp_path: Path) -> None:
    urdf = read(tmp_path, ARM)
    upper = urdf.links[1]
    assert (urdf.name, urdf.root) == ("arm", "base")
    assert sum(len(link.collisions) for link in urdf.links) == 3
    assert [item.shape for link in urdf.links for item in link.collisions] == [
        Box((0.1, 0.2, 0.3)),
        Cylinder(0.1, 0.4),
        Sphere(0.05),
    ]
    assert upper.collisions[0].xyz == (0.0, 0.0, 0.1)
    assert upper.collisions[0].rpy == (0.0, 0.5, 0.0)
    assert present(upper.inertial).tensor == (1.0, 0.0, 0.0, 2.0, 0.0, 3.0)
    shoulder, wrist, slide = urdf.joints
    assert shoulder.axis == (0.0, 1.0, 0.0), "axes are made unit vectors"
    assert (shoulder.lower, shoulder.upper, shoulder.velocity) == (-1.0, 2.0, 3.0)
    assert (wrist.kind, wrist.lower, wrist.upper) == ("revolute", -2 * math.pi, 2 * math.pi)
    assert wrist.axis == (1.0, 0.0, 0.0)
    assert slide.mimic == Mimic("wrist", 0.5, 0.0)


SHOULDER_LIMIT = '<limit lower="-1" upper="2" velocity="3"/>'
SHOULDER_AXIS = '<axis xyz="0 3 0"/>'
BOX = '<box size="0.1 0.2 0.3"/>'

BAD = [
    ("<robot name", '<!DOCTYPE robot [<!ENTITY a "b">]><robot name', "<!DOCTYPE is not allowed"),
    ("</robot>", "", "not well-formed XML"),
    ("<transmission", "<a>" * 100 + "</a>" * 100 + "<transmission", "nested deeper than 64"),
    ('<link name="base"/>', '<link name="x"/>' * 501, "504 links; at most 500"),
    (BOX, '<box size="nan 0.2 0.3"/>', r"link 'upper' collision\[0\]: size = 'nan 0.2 0.3'; expected 3 finite"),
    (BOX, '<box size="0.1 -0.2 0.3"/>', r"collision\[0\]: box size\[1\]: got -0.2; expected a positive"),
    ('radius="0.05"', 'radius="0"', r"sphere radius: got 0.0; expected a positive"),
    (BOX, '<cone radius="1"/>', "unknown geometry <cone>; expected box, cylinder, sphere, capsule or mesh"),
    (f"<geometry>{BOX}</geometry>", "", "<geometry> has 0 shapes; expected exactly one"),
    ('<origin xyz="0 0 1"/>', '<origin xyz="0 0 1"/><origin/>', "'wrist': <origin> is given 2 times"),
    ('<origin xyz="0 0 1"/>', '<origin xyz="0 0 1e30"/>', "joint 'wrist': origin .* expected at most 1000"),
    ('<mass value="1.5"/>', '<mass value="-1"/>', "'upper' inertial: mass -1; expected at least 0"),
    ('<mass value="1.5"/>', "", "'upper' inertial: expected <mass> and <inertia>"),
    (SHOULDER_LIMIT, "", "'shoulder': a revolute joint needs <limit lower upper velocity>"),
    (SHOULDER_LIMIT, '<limit lower="-1" upper="2" velocity="x"/>', "limit: velocity = 'x'; expected a finite"),
    (SHOULDER_LIMIT, '<limit lower="-1" upper="2" velocity="-1"/>', "velocity -1; expected at least 0"),
    ('type="continuous"', 'type="ball"', "'wrist': type 'ball'; expected one of revolute"),
    ('type="continuous"', 'type="floating"', "'wrist': type 'floating'; write type fixed"),
    ('<parent link="hand"/>', "", "joint 'slide': expected <parent link="),
    ('<parent link="base"/>', '<parent link="hand"/>', "links in a cycle, cut off from 'base': hand, pad, upper"),
    ('<link name="base"/>', "", "parent link 'base' does not exist"),
    ('<child link="hand"/>', '<child link="pad"/>', "link 'pad' has 2 parent joints; expected one"),
    ('mimic joint="wrist"', 'mimic joint="writs"', "'slide': mimics 'writs', which is not another joint"),
    ('multiplier="0.5"', 'multiplier="1e-7"', "mimic: multiplier 1e-07; expected 0, or a size from 1e-06 to 1000"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD)
def test_a_bad_file_is_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = changed(old, new)
    with pytest.raises(InvalidFile, match=message):
        read(tmp_path, text)


MESHES = [
    ("package://../outside/o.stl", "lies outside the folders that may be read"),
    ("/etc/hosts.stl", "lies outside the folders that may be read"),
    ("sly/o.stl", "lies outside the folders that may be read"),
    ("inside.step", r"is not a .stl, .obj, .ply"),
    ("missing.stl", "mesh 'missing.stl' does not exist"),
    ("package://arm/inside.stl", "cannot be used: no STL: 0 bytes are not those of 0 triangles"),
]


@pytest.mark.parametrize(("filename", "message"), MESHES)
def test_a_mesh_is_refused_and_its_link_named(tmp_path: Path, filename: str, message: str) -> None:
    robot, outside = tmp_path / "robot", tmp_path / "outside"
    robot.mkdir()
    outside.mkdir()
    (outside / "o.stl").touch()
    (robot / "inside.stl").touch()
    (robot / "sly").symlink_to(outside)
    text = changed(BOX, f'<mesh filename="{filename}"/>')
    with pytest.raises(InvalidFile, match=rf"link 'upper' collision\[0\]: .*{message}"):
        read(tmp_path, text)


def test_a_mesh_in_a_package_folder_the_caller_named_is_inside(tmp_path: Path) -> None:
    path = tmp_path / "robot" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(changed(BOX, '<mesh filename="package://other/o.stl"/>'))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "o.stl").touch()
    with pytest.raises(InvalidFile, match=r"o\.stl' cannot be used: no STL"):
        read_urdf(path, [tmp_path])


def test_all_problems_are_named_at_once(tmp_path: Path) -> None:
    text = changed(BOX, "<cone/>").replace(SHOULDER_AXIS, '<axis xyz="0 0 0"/>').replace('radius="0.05"', 'radius="-1"')
    with pytest.raises(InvalidFile, match="3 problem") as caught:
        read(tmp_path, text)
    assert len(caught.value.problems) == 3
