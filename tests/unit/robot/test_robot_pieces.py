"""Meshes cut into convex pieces in robots and scenes; that the pieces hold the mesh is said in test_decomposition."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Robot, load_robot, load_scene
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile
from planner_service.geometry import mesh_paths as mesh_path
from planner_service.geometry.composite import Compound
from planner_service.geometry.mesh import Mesh
from planner_service.scene.loading import save_scene
from planner_service.scene.scene import Scene

ROBOT = """<robot name="arm">
  <link name="base"/>
  <link name="fork">
    <collision><geometry><mesh filename="fork.obj"/></geometry><origin xyz="0.3 0 0"/></collision>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="fork"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""

TOML = """name = "arm"
urdf = "arm.urdf"
joints = ["turn"]
tool_frame = "fork"
base_links = ["base"]
[poses]
home = [0.0]
[limits.position]
lower = [-1.0]
upper = [1.0]
source = "test"
[limits.velocity]
values = [1.0]
source = "test"
[limits.acceleration]
values = [1.0]
source = "test"
[limits.jerk]
values = [1.0]
source = "test"
"""

CUBE = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])
ASIDE = np.array([0.0, 0.1, 0.0])
PRONGS = (Mesh(CUBE + ASIDE), Mesh(CUBE - ASIDE))
FACES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "arm.urdf").write_text(ROBOT)
    (tmp_path / "robot.toml").write_text(TOML)
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE.tolist()]
    (tmp_path / "fork.obj").write_text("\n".join(lines) + "\n" + FACES)
    return tmp_path


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What is asked of the decomposition, whose answer is two prongs."""
    asked: list[Any] = []

    def pieces_of_file(path: Path, scale: Any, *, most: int) -> tuple[Mesh, ...]:
        asked.append((path.name, tuple(scale), most))
        return PRONGS

    monkeypatch.setattr(mesh_path, "pieces_of_file", pieces_of_file)
    return asked


def test_a_link_is_judged_by_its_pieces(folder: Path, cut: list[Any]) -> None:
    robot = Robot.from_urdf(folder / "arm.urdf", decompose={"fork": 4})
    assert cut == [("fork.obj", (1.0, 1.0, 1.0), 4)]
    assert [item.shape for item in robot.shapes] == list(PRONGS)
    whole = Robot.from_urdf(folder / "arm.urdf")
    assert [item.shape for item in whole.shapes] == [Mesh(CUBE)]
    assert robot.hash != whole.hash
    between = {"sphere": 0.03, "position": [0.3, 0.0, 0.0]}
    text = f'[[obstacle]]\nname = "pin"\nsphere = {between["sphere"]}\nposition = {between["position"]}\n'
    (folder / "s.toml").write_text(text)
    scene = load_scene(folder / "s.toml")
    assert CollisionChecker(robot, scene).state_is_free([0.0])
    assert not CollisionChecker(whole, scene).state_is_free([0.0])


def test_robot_toml_says_which_links_are_cut(folder: Path, cut: list[Any]) -> None:
    (folder / "robot.toml").write_text(TOML + "[decompose]\nfork = 3\n")
    assert [item.shape for item in load_robot(folder / "robot.toml").shapes] == list(PRONGS)
    assert cut[0][2] == 3


@pytest.mark.parametrize(
    ("link", "count", "message"),
    [
        ("frok", 2, "decompose: 'frok' is not a link with a collision shape"),
        ("fork", 0, r"link 'fork' collision\[0\]: most: got 0; expected a whole number from 1 to 64"),
        ("fork", "many", r"link 'fork' collision\[0\]: most: got 'many'"),
    ],
)
def test_a_link_that_cannot_be_cut_is_named(folder: Path, link: str, count: Any, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        Robot.from_urdf(folder / "arm.urdf", decompose={link: count})


def test_a_mesh_in_a_scene_is_cut_and_kept(folder: Path, cut: list[Any]) -> None:
    text = '[[obstacle]]\nname = "fork"\nmesh = { file = "fork.obj", scale = [2, 2, 2], pieces = 5 }\n'
    (folder / "s.toml").write_text(text + "position = [0, 0, 0]\n")
    scene = load_scene(folder / "s.toml")
    assert cut == [("fork.obj", (2.0, 2.0, 2.0), 5)]
    assert scene.obstacles[0].shape == Compound.of_pieces(PRONGS)
    save_scene(scene, folder / "again.toml")
    assert load_scene(folder / "again.toml") == scene != Scene()
