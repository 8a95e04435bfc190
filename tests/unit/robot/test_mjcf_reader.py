"""An MJCF file gives the robot that mujoco makes of it: the same poses, shapes, limits and contacts."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.robot.elements.table import unlisted_words, words_of
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from planner_service.robot_setup.check_robot import FindingKind, check_robot
from planner_service.robot_setup.loading import load_robot

mujoco = pytest.importorskip("mujoco")

ARM = """<mujoco model="arm">
  <compiler angle="radian" meshdir="meshes"/>
  <asset><mesh name="tetra" file="tetra.obj" scale="0.1 0.1 0.1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="foot" pos="0 0 0.1" euler="0.1 0.2 0.3">
      <geom type="cylinder" size="0.1 0.05" pos="0.01 0 0"/>
      <geom type="box" size="9 9 9" contype="0" conaffinity="0"/>
      <body name="column" pos="0 0.02 0.2" euler="0.4 -0.1 0.2">
        <joint name="turn" axis="0 0.6 0.8" pos="0.03 0.01 0.02" range="-2 1.5" ref="0.25" actuatorfrcrange="-40 40"/>
        <geom type="capsule" size="0.03 0.1"/>
        <body name="boom" pos="0.3 0 0.1">
          <joint name="slide" type="slide" axis="1 0 0" range="0 0.2"/>
          <joint name="swing" axis="0 1 0" pos="0 0 -0.1"/>
          <geom type="ellipsoid" size="0.1 0.03 0.02" euler="0.3 0 0"/>
          <body name="tip" pos="0.4 0 0" quat="0.7071067811865476 0 0.7071067811865476 0">
            <joint name="wrist" axis="1 0 0" range="-1 1"/>
            <geom type="mesh" mesh="tetra"/><geom type="sphere" size="0.01" pos="0.05 0 0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="foot" body2="boom"/></contact>
  <keyframe><key name="home" qpos="0.5 0.1 -1 0.2"/><key name="far" qpos="1 0 2 0"/></keyframe>
</mujoco>"""
LOOP = '<connect body1="foot" body2="tip" anchor="0 0 0"/>'
TETRA = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


def written(folder: Path, text: str = ARM) -> Path:
    (folder / "meshes").mkdir(exist_ok=True)
    (folder / "meshes" / "tetra.obj").write_text(TETRA)
    path = folder / "arm.xml"
    path.write_text(text)
    return path


def world_poses(robot: Robot, q: list[float]) -> dict[str, FloatArray]:
    bodies = [body_matrix(pose) for pose in robot.body_poses(q)]
    return {frame.link: bodies[frame.body] @ frame.pose.matrix for frame in robot.link_frames}


def test_links_stand_where_mujoco_has_the_bodies(tmp_path: Path) -> None:
    path = written(tmp_path)
    robot, model = load_robot(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    assert robot.joint_names == ("turn", "slide", "swing", "wrist")
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.limits.lower, robot.limits.upper, (20, 4)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        poses = world_poses(robot, q.tolist())
        for k in range(1, model.nbody):
            T = poses[model.body(k).name]
            assert np.abs(T[:3, :3] - data.xmat[k].reshape(3, 3)).max() < 1e-12
            assert np.abs(T[:3, 3] - data.xpos[k]).max() < 1e-12


def test_shapes_limits_poses_and_excluded_contacts_are_the_files(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path))
    assert [(item.link, type(item.shape).__name__) for item in robot.shapes] == [
        ("foot", "Cylinder"),
        ("column", "Capsule"),
        ("boom", "Mesh"),
        ("tip", "Mesh"),
        ("tip", "Sphere"),
    ]
    assert robot.limits.lower.tolist() == [-2.0, 0.0, -2.0 * np.pi, -1.0]
    assert robot.limits.velocity.tolist() == [1.0, 0.1, 1.0, 1.0]
    assert robot.home.tolist() == [0.5, 0.1, -1.0, 0.2]
    assert "far" in robot.poses
    assert {c.links: c.reason for c in robot.allowed_contacts}["foot", "boom"] == "excluded in the MJCF"


def test_a_polytope_around_an_ellipsoid_contains_it_and_says_how_much_larger_it_is(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        robot = load_robot(written(tmp_path))
    (around,) = (item.shape for item in robot.shapes if item.link == "boom")
    assert isinstance(around, Mesh)
    n = np.random.default_rng(1).normal(size=(2000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    grown = (n @ around.vertices.T).max(axis=1) - np.linalg.norm(n * (0.1, 0.03, 0.02), axis=1)
    assert grown.min() > 0.0
    assert grown.max() < 0.00095
    assert "an ellipsoid is checked as a polytope around it, up to 0.94 mm larger" in caplog.text
    assert "geom 'floor': a plane is no part of a robot; put it into the scene" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('<joint name="wrist" axis="1 0 0" range="-1 1"/>', '<joint name="w" type="ball"/>', "'w': type ball; write"),
        ('axis="1 0 0" range="0 0.2"', 'axis="1 0 0"', "'slide': slides without a range"),
        ("<keyframe>.*", f"<equality>{LOOP}</equality></mujoco>", "closed loop"),
        ('file="tetra.obj"', 'file="../../out.stl"', r"file '\.\./\.\./out.stl' lies outside"),
        ("<contact>", '<include file="/etc/passwd"/><contact>', "file '/etc/passwd' lies outside"),
        ("<mujoco model", "<robot model", "the root element is <robot>; expected <mujoco>|not well-formed"),
    ],
    ids=lambda value: value[:25],
)
def test_what_cannot_be_shown_is_refused_with_what_to_do(tmp_path: Path, old: str, new: str, problem: str) -> None:
    text = re.sub(re.escape(old) if old != "<keyframe>.*" else old, lambda _: new, ARM, flags=re.DOTALL)
    if "freejoint" in new or "ball" in new:
        text = re.sub("<keyframe>.*</keyframe>", "", text)
    path = written(tmp_path, text)
    with pytest.raises(InvalidFile, match=problem):
        load_robot(path)


def test_sites_are_frames_and_the_tool_frame_may_be_one(tmp_path: Path) -> None:
    site = '<site name="tcp" pos="0 0 0.1" euler="0.3 0 0"/><site name="tip" pos="1 0 0"/><site pos="2 0 0"/>'
    path = written(tmp_path, ARM.replace('range="-1 1"/>', f'range="-1 1"/>{site}'))
    robot = load_robot(path)
    assert robot.tool_frame == "tcp"
    assert [frame.link for frame in robot.link_frames if "t" in frame.link][-2:] == ["tcp", "site/tip"]
    model = mujoco.MjModel.from_xml_path(str(path))
    data, q = mujoco.MjData(model), [0.4, 0.1, -0.6, 0.3]
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    for name in ("tcp", "site/tip"):
        T = Robot.from_urdf(path, tool_frame=name).tool_pose(q)
        k = model.site(name.removeprefix("site/")).id
        assert np.abs(T[:3, :3] - data.site_xmat[k].reshape(3, 3)).max() < 1e-12
        assert np.abs(T[:3, 3] - data.site_xpos[k]).max() < 1e-12


TENDON = '<tendon><fixed name="both" range="0 1"><joint joint="turn" coef="1"/><joint joint="wrist" coef="1"/></fixed>'


def test_what_of_a_model_is_not_planned_for_is_told_of_by_load_and_check(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    part = '<mujoco><tendon><fixed name="more" range="0 1"><joint joint="turn" coef="1"/></fixed></tendon></mujoco>'
    (tmp_path / "part.xml").write_text(part)
    path = written(tmp_path, ARM.replace("<contact>", f'{TENDON}</tendon><include file="part.xml"/><contact>'))
    with caplog.at_level(logging.WARNING):
        load_robot(path)
    found = [f.text for f in check_robot(path).findings if f.kind is FindingKind.NOT_UNDERSTOOD]
    text = "range='0 1' has no effect: joints whose sum a tendon limits are planned for as if each were free"
    assert found[0] == f"fixed 'both': {text} (and in 1 more places)"
    assert found[1] == "geom 'floor': a plane is no part of a robot; put it into the scene"
    assert all(each in caplog.text for each in found)


def test_each_word_that_mujoco_knows_is_in_the_table() -> None:
    words = re.sub(r"\n {20,}", " ", mujoco.mj_printSchema(False, False)).splitlines()
    open_elements = [ElementTree.Element("mujoco", {"model": ""})]
    for line in filter(str.strip, words[1:]):
        depth = (len(line) - len(line.lstrip())) // 3
        tag, _, names = re.split(r"(\([?*!R]\))", line.strip(), maxsplit=1)
        tag = tag.strip().replace("(world)body", "worldbody")
        child = ElementTree.SubElement(open_elements[depth - 1], tag, dict.fromkeys(names.split(), ""))
        del open_elements[depth:]
        open_elements.append(child)
    told = unlisted_words(open_elements[0], words_of("mjcf")).told
    assert [text for text in told if "unknown" in text or "not known" in text] == []
