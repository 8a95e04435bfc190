"""An imported robot's folder has all it needs: robot.toml, the URDF, and copies of the meshes, nothing else."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
from planner_service.robot.model import Robot
from planner_service.robot_setup.import_robot import Source, import_robot
from planner_service.robot_setup.loading import load_robot

# A ring-like mesh around a block that turns in it, and a ball far off.
MESHED = """<robot name="meshed">
  <link name="base"><visual><geometry><mesh filename="package://arm/none.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm/a/part.stl" scale="1 1 1"/></geometry></collision></link>
  <link name="mid"/>
  <link name="block"><collision><geometry><mesh filename="package://arm/b/part.stl"/></geometry></collision></link>
  <link name="ball"><collision><origin xyz="3 0 0"/><geometry><mesh filename="package://arm/b/part.stl" scale="2 2 2"/>
  </geometry></collision></link>
  <joint name="turn" type="continuous"><parent link="base"/><child link="mid"/><axis xyz="0 0 1"/></joint>
  <joint name="swing" type="revolute"><parent link="mid"/><child link="block"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="base"/><child link="ball"/>
    <limit lower="0" upper="0.5" velocity="1"/></joint>
</robot>"""


def solid(size: float) -> str:
    corners = [f"{x} {y} {z}" for x in (-size, size) for y in (-size, size) for z in (-size, size)]
    return f"solid {' '.join(f'vertex {c}' for c in (*corners, corners[0]))} endsolid"


def meshed(folder: Path) -> Source:
    for name, size in (("a", 0.4), ("b", 0.05)):
        (folder / "packages" / "arm" / name).mkdir(parents=True)
        (folder / "packages" / "arm" / name / "part.stl").write_text(solid(size))
    (folder / "meshed.urdf").write_text(MESHED)
    return Source(folder / "meshed.urdf", package_dirs=(folder / "packages",), tool_frame="block")


def test_meshes_are_copied_and_the_folder_can_go_anywhere(tmp_path: Path) -> None:
    source = meshed(tmp_path)
    before = Robot.from_urdf(source.urdf, "block", package_dirs=source.package_dirs)
    found = import_robot(source, tmp_path / "out")
    assert sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")) == [
        "meshed.urdf",
        "meshes/1_part.stl",
        "meshes/part.stl",
        "robot.toml",
    ]
    assert found.meshes == (tmp_path / "out" / "meshes" / "part.stl", tmp_path / "out" / "meshes" / "1_part.stl")
    shutil.rmtree(tmp_path / "packages")
    shutil.move(tmp_path / "out", tmp_path / "elsewhere")
    loaded = load_robot(tmp_path / "elsewhere" / "robot.toml")
    assert replace(loaded, allowed_contacts=before.allowed_contacts).hash == before.hash


def test_a_part_of_a_robot_is_imported_with_the_rest_locked_and_its_states(tmp_path: Path) -> None:
    source = replace(meshed(tmp_path), joints=("swing",), locked_joints={"slide": 0.25}, srdf=tmp_path / "m.srdf")
    (tmp_path / "m.srdf").write_text(
        '<robot name="m"><group_state name="a b" group="g"><joint name="swing" value="0.5"/></group_state></robot>'
    )
    found = import_robot(source, tmp_path / "out")
    text = found.path.read_text()
    assert '"turn" = 0.0\n"slide" = 0.25' in text
    assert '"a b" = [0.5]   # from the SRDF' in text
    assert found.robot.joint_names == ("swing",)
    assert found.robot.pose("a b").tolist() == [0.5]


MJCF = """<mujoco model="crane"><worldbody>
  <geom name="floor" type="plane" size="1 1 1"/>
  <body name="post"><geom type="capsule" size="0.05 0.1"/>
    <body name="boom" pos="0 0 0.4"><joint name="turn" axis="0 0.6 0.8" range="-90 60" actuatorfrcrange="-9 9"/>
      <geom type="box" size="0.2 0.02 0.02" pos="0.3 0 0" euler="0 0 10"/>
      <body name="hook" pos="0.6 0 0"><joint name="spin"/><geom type="ellipsoid" size="0.03 0.02 0.02"/>
        <site name="tcp" pos="0 0 -0.1" euler="0 90 0"/></body></body></body></worldbody>
  <contact><exclude body1="post" body2="hook"/></contact>
  <keyframe><key name="home" qpos="0.5 1"/></keyframe></mujoco>"""


def test_an_mjcf_file_becomes_a_folder_that_needs_no_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    path = tmp_path / "crane.xml"
    path.write_text(MJCF)
    found = import_robot(Source(path, tool_frame="tcp"), tmp_path / "out")
    before, after = load_robot(path), load_robot(found.path)
    assert found.urdf.name == "crane.urdf"
    assert "geom 'floor': a plane is no part of a robot; put it into the scene" in found.notes
    assert after.continuous == before.continuous == (False, True)
    assert np.array_equal(after.home, before.home)
    for q in np.random.default_rng(0).uniform(after.limits.lower, after.limits.upper, (20, 2)).tolist():
        assert np.abs(after.tool_pose(q) - before.tool_pose(q)).max() < 1e-14
    assert [type(item.shape) for item in after.shapes] == [type(item.shape) for item in before.shapes]
    assert {c.links: c.reason for c in after.allowed_contacts}["post", "hook"] == "excluded in the MJCF"
    with pytest.raises(InvalidRequest, match="MJCF says itself"):
        import_robot(Source(path, srdf=tmp_path / "a.srdf"), tmp_path / "more")


WORDS = """<robot name="words" version="1.2">
  <link name="foot"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="boom"><collision><origin xyz="0.3 0 0" quat_xyzw="0 0.7071067811865476 0 0.7071067811865476"/>
    <geometry><capsule radius="0.02" length="0.2"/></geometry></collision></link>
  <link name="end"/>
  <joint name="swing" type="revolute"><parent link="foot"/><child link="boom"/>
    <origin xyz="0 0 0.3" quat_xyzw="0.5 0.5 0.5 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="1" acceleration="3" jerk="20"/>
    <safety_controller soft_lower_limit="-1" soft_upper_limit="1.5"/></joint>
  <joint name="loose" type="revolute"><parent link="boom"/><child link="end"/><origin xyz="0.5 0 0"/>
    <limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
  <walking/>
</robot>"""


def test_the_words_of_new_urdf_and_srdf_come_through_and_what_is_unknown_is_told_of(tmp_path: Path) -> None:
    (tmp_path / "words.urdf").write_text(WORDS)
    (tmp_path / "words.srdf").write_text('<robot name="words"><passive_joint name="loose"/></robot>')
    found = import_robot(Source(tmp_path / "words.urdf", srdf=tmp_path / "words.srdf"), tmp_path / "out")
    assert found.robot.joint_names == ("swing",)
    assert found.robot.locked_joints == (("loose", 0.0),)
    limits = found.robot.limits
    assert (limits.lower.tolist(), limits.upper.tolist()) == ([-1.0], [1.5])
    assert (limits.acceleration.tolist(), limits.jerk.tolist()) == ([3.0], [20.0])
    text = found.path.read_text()
    assert "soft limits of <safety_controller> for swing" in text
    assert text.count('source = "URDF <limit>"') == 3
    assert found.notes == (
        "<robot>: <walking> is not known, and has no effect",
        "passive joints are not planned for, and stand as at home: loose",
    )
