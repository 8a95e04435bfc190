"""Worlds and problems that others write: closed examples, every refusal, and files that were cut or changed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.errors import InvalidFile, UnknownName
from planner_service.geometry.shapes import Box, Cylinder, Pose, Sphere
from planner_service.records.problems import read_problems
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.moveit_scene import read_moveit_scene
from planner_service.scene.scene import Obstacle, Scene
from planner_service.scene.urdf_scene import read_urdf_scene
from tests.support.fuzz import changed

HALF = math.sqrt(0.5)

NEWER = f"""two things
* bench top
0.5 0 0.1
0 0 {HALF!r} {HALF!r}
2
box
0.4 0.6 0.02
0.1 0 0.05
0 0 0 1
0.2 0.2 0.2 1
cylinder
0.03 0.4
0 0 0
0 {HALF!r} 0 {HALF!r}
0 0 0 0
1
corner
0.2 0.3 0
0 0 0 1
* ball
0 0.25 0.5
0 0 0 1
1
sphere
0.05
0 0 0
0 0 0 1
0 0 0 0
0
.
"""

PYRAMID = "mesh\n5 2\n0 0 0\n0.1 0 0\n0 0.1 0\n0.1 0.1 0\n0 0.1 0.2\n0 1 4\n0 2 "
"""Up to its last number: that of one of five vertices."""

FLAT = "mesh\n4 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0"

OLDER = """(noname)++
* plate
1
box
0.4 0.6 0.02
0.5 0.1 0.15
0.6 0 0 0.8
0 0 0 0
.
"""

LIFTED = """<robot name="cell">
  <link name="world"/>
  <link name="table">
    <collision><origin xyz="0 0 -0.05"/><geometry><box size="1 2 0.1"/></geometry></collision>
    <collision><origin xyz="0.3 0 0.2" rpy="0 1.5707963267948966 0"/>
      <geometry><cylinder radius="0.02" length="0.4"/></geometry></collision>
  </link>
  <link name="lamp"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="stand" type="fixed"><parent link="world"/><child link="table"/>
    <origin xyz="0.5 0 0.1" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="hang" type="fixed"><parent link="table"/><child link="lamp"/><origin xyz="0.2 0 1"/></joint>
</robot>
"""

TINY: dict[str, Any] = {
    "source": "made up",
    "units": "m, rad",
    "joints": ["shoulder", "elbow"],
    "problems": [
        {"id": "post/1", "scene": "post", "index": 1, "start": [0, 0.5], "goals": [[1.0, -0.5], [0.25, 0.5]]},
        {"id": "post/2", "start": [0.0, 0.0], "goals": [[0.1, 0.1]], "obstacles": []},
    ],
}
TINY["problems"][0]["obstacles"] = [
    {"name": "post", "type": "cylinder", "radius": 0.03, "length": 0.4, "position": [0.3, 0, 5.2]}
    | {"quaternion_xyzw": [0.6, 0.0, 0.0, 0.8]},
    {"name": "shelf", "type": "box", "size": [0.4, 0.2, 0.02], "position": [0.3, 0.0, 5.5]},
    {"name": "ball", "type": "sphere", "radius": 0.05, "position": [0.0, 0.4, 5.2]},
]


def write(folder: Path, text: str | bytes, name: str) -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def problems_of(read: Callable[[Path], Any], path: Path) -> tuple[str, ...]:
    with pytest.raises(InvalidFile) as caught:
        read(path)
    assert caught.value.path == path
    return caught.value.problems


def near(pose: Pose, position: tuple[float, ...], quaternion: tuple[float, ...]) -> None:
    assert pose.position == pytest.approx(position, abs=1e-15)
    assert pose.quaternion == pytest.approx(quaternion, abs=1e-15)


# MoveIt


def test_a_newer_moveit_scene_is_read_with_shapes_in_the_frames_of_their_objects(tmp_path: Path) -> None:
    scene = read_moveit_scene(write(tmp_path, NEWER, "w.scene"))
    assert (scene.name, scene.names) == ("two things", ("bench top", "bench top#2", "ball"))
    box, post, ball = scene.obstacles
    assert (box.shape, post.shape, ball.shape) == (Box((0.4, 0.6, 0.02)), Cylinder(0.03, 0.4), Sphere(0.05))
    near(box.pose, (0.5, 0.1, 0.15), (HALF, 0.0, 0.0, HALF))  # a quarter turn takes the shape's x to y
    near(post.pose, (0.5, 0.0, 0.1), (0.5, -0.5, 0.5, 0.5))
    near(ball.pose, (0.0, 0.25, 0.5), (1.0, 0.0, 0.0, 0.0))


def moveit_text(scene: Scene, *, newer: bool) -> str:
    """A scene as MoveIt writes it."""
    words: dict[type, Callable[[Any], tuple[str, tuple[float, ...]]]] = {
        Box: lambda s: ("box", s.size),
        Sphere: lambda s: ("sphere", (s.radius,)),
        Cylinder: lambda s: ("cylinder", (s.radius, s.length)),
    }
    lines = ["(noname)"]
    for o in scene.obstacles:
        (w, x, y, z), (kind, sizes) = o.pose.quaternion, words[type(o.shape)](o.shape)
        here = [o.pose.position, (x, y, z, w)]
        still = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)]
        rows = [*(here if newer else []), (1,), (kind,), sizes, *(still if newer else here), (0, 0, 0, 0)]
        rows += [(0,)] if newer else []
        lines += [f"* {o.name}", *(" ".join(map(str, row)) for row in rows)]
    return "\n".join([*lines, ".", ""])


SOLIDS = f"""(noname)
* roof
0.5 0 0
0 0 {HALF!r} {HALF!r}
2
{PYRAMID}3
0.25 0 0 0 0 0 1
0 0 0 0
cone 0.3 0.4 0 0 0.7 0 0 0 1
0 0 0 0 0
* floor
0.3 -7 0.25
0 0 0 1
1
plane 0 0 2 0.5 0 0 0 0 0 0 1
0 0 0 0 0
.
"""


@settings(max_examples=100, deadline=None)
@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(-5.0, 5.0), st.floats(-8.0, 8.0), st.floats(0.0, 6.0))
def test_the_top_of_the_box_below_a_plane_lies_in_it(
    tmp_path_factory: pytest.TempPathFactory, normal: tuple[float, ...], d: float, power: float, turn: float
) -> None:
    a, b, c = normal
    length = math.hypot(a, b, c)
    if length < 1e-3:
        return
    scale = 10.0**power
    text = f"x\n* p\n1 2 3\n0 0 {math.sin(turn)!r} {math.cos(turn)!r}\n1\nplane\n"
    text += f"{a * scale!r} {b * scale!r} {c * scale!r} {d * length * scale!r}\n0 0 1\n0 0 0 1\n0 0 0 0\n0\n.\n"
    (box,) = read_moveit_scene(write(tmp_path_factory.getbasetemp(), text, "plane.scene")).obstacles
    stands = Pose((1.0, 2.0, 3.0), (math.cos(turn), 0.0, 0.0, math.sin(turn))) @ Pose((0.0, 0.0, 1.0))
    corners = np.array([[x, y, z] for x in (-100.0, 100.0) for y in (-100.0, 100.0) for z in (-5.0, 5.0)])
    world = corners @ box.pose.rotation.T + np.array(box.pose.position)
    local = (world - np.array(stands.position)) @ stands.rotation
    above = (local * np.array(normal)).sum(axis=1) / length + d
    assert np.abs(above[corners[:, 2] > 0.0]).max() < 1e-12
    assert np.abs(above[corners[:, 2] < 0.0] + 10.0).max() < 1e-12
    up = box.pose.rotation[:, 2]
    assert np.abs(np.cross(np.array(box.pose.position), up)).max() < 1e-12  # the base is right below or above


LENGTHS = st.floats(1e-3, 10.0)
PLACES = st.floats(-10.0, 10.0)
SHAPES = (
    st.builds(Box, st.tuples(LENGTHS, LENGTHS, LENGTHS))
    | st.builds(Sphere, LENGTHS)
    | st.builds(Cylinder, LENGTHS, LENGTHS)
)
TURNS = st.sampled_from([(1.0, 0.0, 0.0, 0.0), (0.5, -0.5, 0.5, 0.5), (0.8, 0.0, 0.6, 0.0), (HALF, 0.0, 0.0, -HALF)])
POSES = st.builds(Pose, st.tuples(PLACES, PLACES, PLACES), TURNS)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(SHAPES, POSES), max_size=5), st.booleans())
def test_what_moveit_writes_is_read_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, bodies: list[tuple[Any, Pose]], newer: bool
) -> None:
    scene = Scene(tuple(Obstacle(f"thing {k}", *body) for k, body in enumerate(bodies)))
    path = write(tmp_path_factory.getbasetemp(), moveit_text(scene, newer=newer), "round.scene")
    assert read_moveit_scene(path).hash == scene.hash


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("0.4 0.6 0.02", "0.4 0 0.02", "line 7, object 'bench top': size[1]: got 0.0; expected a positive length"),
        ("0 0.25 0.5", "0 2500 0.5", "line 25, object 'ball': position of 'ball': got"),
        ("* ball", "* bench top", "line 25, object 'bench top': the name 'bench top' is taken (line 7, object"),
        ("two things", "two\tthings", "line 1: name of the scene: got"),
        ("cylinder\n0.03 0.4", "cone\n1e-9 0.4", "line 12, object 'bench top': vertices: flat, 65 points within"),
        ("sphere\n0.05", "plane\n0 0 0 1", "line 25, object 'ball': plane: got (0.0, 0.0, 0.0, 1.0); expected a, b, c"),
        ("sphere\n0.05", FLAT, "line 24, object 'ball': vertices: flat, 4 points within [1.0, 1.0, 0.0] m"),
        ("sphere\n0.05", "mesh\n-1 0", "line 25, object 'ball': got '-1'; expected the number of vertices"),
        ("sphere\n0.05", "mesh\n999999999 1\n", "line 31, object 'ball': got '.'; expected vertex: 3 finite numbers"),
        ("0.4 0.6 0.02", "0.4 0.6 wide", "line 7, object 'bench top': got 'wide'; expected box: 3 finite numbers"),
        ("\n2\n", "\n-2\n", "line 5, object 'bench top': got '-2'; expected the number of shapes"),
        ("* ball", "*ball", "line 20: got '*ball'; expected * before an object, or . at the end"),
        (".\n", "", "line 30: the file ends; expected * before an object, or . at the end"),
        (".\n", ".\n* more\n", "line 31: words after the end; expected nothing"),
    ],
)
def test_what_is_wrong_in_a_moveit_scene_is_named_with_its_line(
    tmp_path: Path, old: str, new: str, problem: str
) -> None:
    start, end = NEWER.rsplit(old, 1) if old == ".\n" else NEWER.split(old, 1)
    (found,) = problems_of(read_moveit_scene, write(tmp_path, start + new + end, "w.scene"))
    assert found.startswith(problem)


@pytest.mark.slow
@pytest.mark.parametrize("text", [SOLIDS])
def test_a_moveit_scene_cut_anywhere_is_refused(tmp_path: Path, text: str) -> None:
    for length in range(0, len(text) - 2, 2):  # without its last line end it is still whole
        problems_of(read_moveit_scene, write(tmp_path, text[:length], "w.scene"))


def survives(read: Callable[[Path], Any], path: Path) -> None:
    """Whatever is in a file, it is read or refused; any other exception fails the test."""
    with suppress(InvalidFile):
        read(path)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(changed(NEWER.encode()) | changed(OLDER.encode()) | changed(SOLIDS.encode()))
def test_a_changed_moveit_scene_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    survives(read_moveit_scene, write(tmp_path_factory.getbasetemp(), content, "fuzz.scene"))


# URDF


def test_a_joint_that_can_move_stands_at_zero_with_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "cell.urdf"
    path.write_text(LIFTED)
    fixed = load_scene(path)
    limit = '<limit lower="0" upper="1" velocity="1" effort="1"/>'
    path.write_text(LIFTED.replace('"hang" type="fixed">', f'"hang" type="prismatic">{limit}'))
    assert load_scene(path) == fixed
    assert "joint 'hang': it can move (prismatic)" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('"hang" type="fixed">', '"hang" type="floating">', "joint 'hang': type 'floating'; write type fixed and plan"),
        ('link name="lamp"', 'link name="table#2"', "link 'table#2' collision[0]: the name 'table#2' is taken"),
        ('xyz="0.2 0 1"', 'xyz="2 -999.9 1"', "link 'lamp' collision[0]: position of 'lamp': got (1000.4, "),
        ('<sphere radius="0.1"/>', '<mesh filename="../../etc/passwd.stl"/>', "link 'lamp' collision[0]: mesh"),
        ('<robot name="cell">', '<!DOCTYPE robot><robot name="cell">', "<!DOCTYPE is not allowed"),
    ],
)
def test_what_is_no_world_in_a_urdf_is_named(tmp_path: Path, old: str, new: str, problem: str) -> None:
    text = LIFTED.replace(old, new).replace('link="lamp"', 'link="table#2"' if "table#2" in new else 'link="lamp"')
    first, *_ = problems_of(read_urdf_scene, write(tmp_path, text, "w.urdf"))
    assert first.startswith(problem)


# Problems


def tiny(folder: Path, change: Callable[[dict[str, Any]], Any] = lambda document: None) -> Path:
    document = json.loads(json.dumps(TINY))
    change(document)
    return write(folder, json.dumps(document), "problems.json")


def test_problems_are_read_with_starts_goals_and_worlds(tmp_path: Path) -> None:
    found = read_problems(tiny(tmp_path))
    assert (found.joint_names, found.robot, found.source) == (("shoulder", "elbow"), "", "made up")
    first, second = found.problems
    assert (first.id, first.start.tolist(), second.id) == ("post/1", [0.0, 0.5], "post/2")
    assert [goal.tolist() for goal in first.goals] == [[1.0, -0.5], [0.25, 0.5]]
    assert first.scene == Scene(
        (
            Obstacle("post", Cylinder(0.03, 0.4), Pose((0.3, 0.0, 5.2), (0.8, 0.6, 0.0, 0.0))),
            Obstacle("shelf", Box((0.4, 0.2, 0.02)), Pose((0.3, 0.0, 5.5))),
            Obstacle("ball", Sphere(0.05), Pose((0.0, 0.4, 5.2))),
        ),
        name="post/1",
    )
    assert found.problem("post/2") is second
    with pytest.raises(UnknownName, match="unknown problem 'post/3'; did you mean"):
        found.problem("post/3")


def first(document: dict[str, Any]) -> dict[str, Any]:
    problem: dict[str, Any] = document["problems"][0]
    return problem


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d.pop("joints"), "joints: missing"),
        (lambda d: d.update(joints=["a", "a"]), "joints: got ['a', 'a']; expected 1 to 100 names, each once"),
        (lambda d: first(d).pop("goals"), "problems[0].goals: missing"),
        (lambda d: first(d).update(start=[0.0]), "problems[0].start: got [0.0]; expected 2 finite numbers"),
        (lambda d: first(d).update(id="post/2"), "problems[1].id: got 'post/2'; expected an id that no problem"),
        (lambda d: first(d)["obstacles"][0].update(scale=2), "problems[0].obstacles[0] 'post': unknown key 'scale'"),
        (lambda d: first(d)["obstacles"][2].update(radius=-1), "problems[0].obstacles[2] 'ball'.radius: got -1.0; exp"),
        (lambda d: first(d)["obstacles"].append(3), "problems[0].obstacles[3]: got 3; expected an object"),
    ],
)
def test_what_is_wrong_in_a_problem_set_is_named_with_its_place(
    tmp_path: Path, change: Callable[[dict[str, Any]], Any], problem: str
) -> None:
    found, *_ = problems_of(read_problems, tiny(tmp_path, change))
    assert found.startswith(problem)


@pytest.mark.slow
@settings(max_examples=75, deadline=None)
@given(
    changed(json.dumps(TINY).encode())
    | st.integers(0, len(json.dumps(TINY)) - 1).map(lambda k: json.dumps(TINY)[:k].encode())
)
def test_a_changed_or_cut_problem_set_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    survives(read_problems, write(tmp_path_factory.getbasetemp(), content, "fuzz.json"))


# By name or file


def test_a_world_is_read_by_the_suffix_of_its_file(tmp_path: Path) -> None:
    assert load_scene(write(tmp_path, OLDER, "w.SCENE")).names == ("plate",)
    assert load_scene(str(write(tmp_path, LIFTED, "w.urdf"))).names == ("table", "table#2", "lamp")
    assert load_scene("table") == load_scene("table")
    save_scene(load_scene("table"), tmp_path / "w.toml")
    assert load_scene(tmp_path / "w.toml") == load_scene("table")


def test_a_world_that_does_not_exist_is_refused_as_a_name_or_as_a_file(tmp_path: Path) -> None:
    with pytest.raises(UnknownName, match="unknown scene 'tabel'; did you mean 'table'"):
        load_scene("tabel")
    assert problems_of(load_scene, tmp_path / "none.scene") == ("no such file",)
