"""Scenes as values, their files in and out, and the scenes that come with the package."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.constraints import JointRange, KeepUpright, ToolRegion
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.scene import toml_reader as scene_file
from planner_service.scene.loading import load_scene, save_scene
from planner_service.scene.scene import Attached, Obstacle, Scene, scene_names

POST = Obstacle("post", Cylinder(0.03, 0.4), Pose((0.3, 0.0, 0.2)))
BALL = Obstacle("ball", Sphere(0.05), Pose((0.2, 0.1, 0.3)))
HELD = Attached("block", Box((0.045, 0.045, 0.045)), Pose((0.01, 0.0, 0.0)), ("finger_left", "finger_right"))
SCENE = Scene((POST, BALL), (HELD,), "example", 'Two "things"\nand one held.')

NEEDED = 'name = "post"\nsphere = 0.1\nposition = [0.0, 0.0, 0.0]\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def problems_of(path: Path) -> tuple[str, ...]:
    with pytest.raises(InvalidFile) as caught:
        load_scene(path)
    assert caught.value.path == path
    return caught.value.problems


# Values


def test_a_name_is_there_once_among_obstacles_and_attached_objects() -> None:
    make: Any
    for make in [
        lambda: Scene((POST, BALL, POST)),
        lambda: SCENE.with_obstacle(Obstacle("ball", Sphere(0.2))),
        lambda: SCENE.with_obstacle(Obstacle("block", Sphere(0.2))),
        lambda: SCENE.with_attached(Attached("post", Sphere(0.2), Pose())),
        lambda: SCENE.with_attached(HELD),
    ]:
        with pytest.raises(InvalidRequest, match=r"name: got .*; expected each name once"):
            make()


def test_what_is_no_scene_is_refused() -> None:
    make: Any
    for make, message in [
        (lambda: Obstacle("a", "box"), "shape of 'a': got 'box'; expected one of Box"),  # type: ignore[arg-type]
        (lambda: Obstacle("a", Sphere(0.1), (0.0, 0.0, 0.0)), "pose of 'a'"),  # type: ignore[arg-type]
        (lambda: Obstacle("a", Sphere(0.1), Pose((0.0, 1001.0, 0.0))), "position of 'a': .* at most 1000"),
        (lambda: Obstacle("a", Sphere(0.1), colour="red"), "colour: got 'red'; expected red, green and blue in hexa"),
        (lambda: Obstacle("a", Sphere(0.1), colour="#12345\u0661"), "colour"),
        (lambda: Obstacle("a", Sphere(0.1), colour=0xC86432), "colour"),  # type: ignore[arg-type]
        (lambda: Attached("a", Sphere(0.1), Pose(), ("",)), "touch_links: got ''"),
        (lambda: Scene((HELD,)), "obstacles.*: got .*a sequence of Obstacle"),  # type: ignore[arg-type]
        (lambda: Scene(attached=(POST,)), "attached.*: got .*a sequence of Attached"),  # type: ignore[arg-type]
        (lambda: Scene(name="x" * 65), "name of the scene"),
        (lambda: Scene(tuple(Obstacle(f"o{k}", Sphere(0.1)) for k in range(10_001))), "got 10001; expected at most"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            make()


# The hash


def test_every_other_content_has_another_hash() -> None:
    for other in [
        Scene(),
        Scene((BALL, POST), (HELD,)),
        Scene((POST, BALL, Obstacle("block", HELD.shape, HELD.pose))),
        SCENE.moved("post", Pose((math.nextafter(0.3, 1.0), 0.0, 0.2))),
        SCENE.moved("post", Pose((0.3, 0.0, 0.2), (0.0, 1.0, 0.0, 0.0))),
        Scene((Obstacle("mast", POST.shape, POST.pose), BALL), (HELD,)),
        Scene((Obstacle("post", Capsule(0.03, 0.4), POST.pose), BALL), (HELD,)),
        Scene((POST, BALL), (Attached("block", HELD.shape, HELD.pose, ("finger_left",)),)),
    ]:
        assert other.hash != SCENE.hash


def test_a_colour_changes_neither_hash_nor_equality() -> None:
    red = replace(POST, colour="#c80000")
    assert red == POST
    assert Scene((red, BALL), (HELD,)).hash == SCENE.hash
    assert Scene((red, BALL)).obstacle_hashes == Scene((POST, BALL)).obstacle_hashes


def test_the_hash_is_the_same_in_every_process() -> None:
    assert SCENE.hash == "c205dce3caa8b3e733ba41625b2166abd65e24c3c3a7da72cacb16afac64ce8e"
    assert pickle.loads(pickle.dumps(SCENE)).hash == SCENE.hash


# The scenes that come with the package


@pytest.mark.parametrize("name", scene_names())
def test_a_shipped_scene_loads_under_its_own_name_and_round_trips(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.description
    save_scene(scene, tmp_path / "copy.toml")
    assert load_scene(tmp_path / "copy.toml") == scene


# Files out and in again


names = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=20)
numbers = st.floats(-1000.0, 1000.0)
lengths = st.floats(5e-324, 1000.0, exclude_min=False)
shapes = st.one_of(
    st.builds(lambda x, y, z: Box((x, y, z)), lengths, lengths, lengths),
    st.builds(Sphere, lengths),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, lengths),
)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    w, x, y, z = (draw(st.floats(-1.0, 1.0)) for _ in range(4))
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    quaternion = (w / norm, x / norm, y / norm, z / norm) if norm > 0.1 else (1.0, 0.0, 0.0, 0.0)
    return Pose((draw(numbers), draw(numbers), draw(numbers)), quaternion)


@st.composite
def scenes(draw: st.DrawFn) -> Scene:
    objects = draw(st.lists(st.tuples(names, shapes, poses()), max_size=6, unique_by=lambda o: o[0]))
    split = draw(st.integers(0, len(objects)))
    links = draw(st.lists(names, max_size=3, unique=True))
    attached = tuple(Attached(*o, tuple(links)) for o in objects[split:])
    return Scene(tuple(Obstacle(*o) for o in objects[:split]), attached, draw(st.just("") | names), draw(names))


@pytest.mark.slow
@settings(max_examples=50, deadline=None, derandomize=True)
@given(scenes())
def test_a_saved_scene_comes_back_equal_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, scene: Scene) -> None:
    path = tmp_path_factory.mktemp("saved") / "scene.toml"
    save_scene(scene, path)
    back = load_scene(path)
    assert back == scene
    assert back.hash == scene.hash


def test_a_colour_is_kept_in_a_scene_file(tmp_path: Path) -> None:
    scene = Scene((replace(POST, colour="#C86432"), BALL))
    save_scene(scene, tmp_path / "scene.toml")
    back = load_scene(tmp_path / "scene.toml")
    assert [obstacle.colour for obstacle in back.obstacles] == ["#C86432", None]
    assert [obstacle.colour for obstacle in back.moved("post", Pose()).obstacles] == ["#C86432", None]


# Files that cannot be used


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = write(tmp_path, "#" * (scene_file.MAX_BYTES + 1))
    assert problems_of(path) == ("too large: more than 5,000,000 bytes",)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("position", "postion"), ": unknown key 'postion'; did you mean 'position'?"),
        (("position = [0.0, 0.0, 0.0]", ""), ".position: missing; expected [x, y, z]"),
        (("0.0, 0.0, 0.0", "0.0, nan, 0.0"), ".position[1]: got nan; expected a finite number"),
        (("0.0, 0.0, 0.0", "300, 0, 2000"), ".position[2]: got 2000; expected a number from -1000 to 1000"),
        (("0.0, 0.0, 0.0", "0x" + "f" * 9000 + ", 0, 0"), ".position[0]: got an integer of thousands of digits"),
        (("name = ", "quaternion_wxyz = [1, 1, 0, 0]\nname = "), ".quaternion_wxyz: got [1, 1, 0, 0]; expected a unit"),
        (("sphere = 0.1", ""), ": shape is missing; expected exactly one of box, sphere, cylinder, capsule"),
        (("sphere = 0.1", "sphere = 0.1\nbox = [1, 1, 1]"), ": two or more shapes, box and sphere; expected exactly"),
        (("sphere = 0.1", "sphere = -0.1"), ".sphere: got -0.1; expected a positive length up to 1000 m"),
        (("sphere = 0.1", "box = [0.1, -0.1, 0.1]"), ".box[1]: got -0.1; expected a positive length"),
        (("sphere = 0.1", "box = 0.1"), ".box: got 0.1; expected [x, y, z]"),
        (("sphere = 0.1", "sphere = 0.1\ncolour = 'red'"), ".colour: got 'red'; expected red, green and blue in hexa"),
        (("sphere = 0.1", "sphere = 0.1\ncolour = 7"), ".colour: got 7"),
        (("sphere = 0.1", "capsule = { radius = inf, length = 1 }"), ".capsule.radius: got inf"),
    ],
)
def test_a_problem_of_an_obstacle_is_named_with_its_number_and_name(
    change: tuple[str, str], problem: str, tmp_path: Path
) -> None:
    text = "[[obstacle]]\n" + NEEDED.replace(*change)
    assert any(p.startswith(f"obstacle[0] 'post'{problem}") for p in problems_of(write(tmp_path, text)))


def test_all_problems_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    text = """
        titel = "a"
        [[obstacle]]
        name = "a"
        box = [nan, -1, 0.1]
        [[obstacle]]
        name = "a"
        cylinder = { radius = 0, lenght = 0.1 }
        position = [0, 0, 0]
        [[attached]]
        position = [0, 0, 0]
        touch_links = [3]
    """
    assert [problem.split(";")[0] for problem in problems_of(write(tmp_path, text))] == [
        "obstacle[0] 'a'.box[0]: got nan",
        "obstacle[0] 'a'.box[1]: got -1",
        "obstacle[0] 'a'.position: missing",
        "obstacle[1] 'a'.cylinder.radius: got 0",
        "obstacle[1] 'a'.cylinder.length: missing",
        "obstacle[1] 'a'.cylinder: unknown key 'lenght'",
        "attached[0].name: missing",
        "attached[0].touch_links[0]: got 3",
        "unknown key 'titel'",
    ]


def test_what_is_asked_of_a_carried_object_survives_a_file(tmp_path: Path) -> None:
    turned = Pose((0.1, 1 / 3, 0.0), (0.6, 0.8, 0.0, 0.0))
    asked = (
        KeepUpright((1.0, 2.0, 3.0), 1 / 3, link="link_6"),
        ToolRegion(turned, (-math.inf, 0.0, -0.1), (0.5, math.inf, 1 / 3), 0.2, 0.1, turned, "link_3", "link_1", "own"),
        ToolRegion(turned, (-math.inf, 0.0, -0.1), (0.5, math.inf, 1 / 3)),
        ToolRegion(turned, (-0.1, -0.1, -0.1), (0.1, 0.1, 0.1), math.pi),
        JointRange("joint_4", -1 / 3, 0.5),
    )
    scene = Scene(attached=(Attached("cup", Sphere(0.02), Pose(), constraints=asked),))
    save_scene(scene, tmp_path / "scene.toml")
    found = load_scene(tmp_path / "scene.toml")
    assert found.hash == scene.hash
    assert [vars(each) for each in found.constraints] == [vars(each) for each in asked]
