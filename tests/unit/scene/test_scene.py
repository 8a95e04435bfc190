"""Scenes as values, their files in and out, and the scenes that come with the package."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.constraints import JointRange, KeepUpright, ToolRegion
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
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


def test_an_obstacle_stands_at_the_origin_unless_told_otherwise() -> None:
    assert Obstacle("ball", Sphere(0.1)).pose == Pose()


def test_changes_make_new_scenes_and_keep_the_order() -> None:
    more = SCENE.with_obstacle(Obstacle("last", Sphere(0.1)))
    assert more.names == ("post", "ball", "last", "block")
    assert more.without("ball").names == ("post", "last", "block")
    assert SCENE.names == ("post", "ball", "block")


def test_a_moved_obstacle_keeps_its_place_and_shape() -> None:
    there = Pose((0.0, 0.4, 0.2))
    moved = SCENE.moved("post", there)
    assert moved.obstacles == (Obstacle("post", POST.shape, there), BALL)
    assert SCENE.obstacle("post") == POST


def test_an_object_is_attached_and_let_go() -> None:
    assert Scene().with_attached(HELD).attached == (HELD,)
    assert Scene().with_attached(HELD).without_attached("block") == Scene()


def test_sequences_become_tuples() -> None:
    scene = Scene([POST], [HELD])  # type: ignore[arg-type]
    assert scene == Scene((POST,), (HELD,))
    assert hash(scene) == hash(Scene((POST,), (HELD,)))


def test_an_unknown_obstacle_is_answered_with_the_nearest_name() -> None:
    ask: Any
    for ask in [
        lambda: SCENE.obstacle("psot"),
        lambda: SCENE.without("psot"),
        lambda: SCENE.moved("psot", Pose()),
    ]:
        with pytest.raises(UnknownName, match="unknown obstacle 'psot'; did you mean 'post'"):
            ask()


def test_an_attached_object_is_no_obstacle() -> None:
    with pytest.raises(UnknownName, match="unknown obstacle 'block'"):
        SCENE.without("block")
    with pytest.raises(UnknownName, match="unknown attached object 'post'; available: block"):
        SCENE.without_attached("post")


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


def test_unusable_names_are_refused() -> None:
    name: Any
    for name in ["", " ", "post ", "a\nb", "a\x00", "x" * 65, 7, None]:
        with pytest.raises(InvalidRequest, match=r"name: got .*; expected 1 to 64 printable characters"):
            Obstacle(name, Sphere(0.1))


def test_a_name_of_64_characters_is_fine() -> None:
    assert Obstacle("ä" * 64, Sphere(0.1)).name == "ä" * 64


def test_what_is_no_scene_is_refused() -> None:
    make: Any
    for make, message in [
        (lambda: Obstacle("a", "box"), "shape of 'a': got 'box'; expected one of Box"),  # type: ignore[arg-type]
        (lambda: Obstacle("a", Sphere), "shape of 'a'"),  # type: ignore[arg-type]
        (lambda: Obstacle("a", Sphere(0.1), (0.0, 0.0, 0.0)), "pose of 'a'"),  # type: ignore[arg-type]
        (lambda: Obstacle("a", Sphere(0.1), Pose((0.0, 1001.0, 0.0))), "position of 'a': .* at most 1000"),
        (lambda: Attached("a", Sphere(0.1), Pose(), "finger"), "touch_links: got 'finger'"),  # type: ignore[arg-type]
        (lambda: Attached("a", Sphere(0.1), Pose(), ("",)), "touch_links: got ''"),
        (lambda: Attached("a", Sphere(0.1), Pose(), ("f", "f")), "expected each link once"),
        (lambda: Scene((HELD,)), "obstacles.*: got .*a sequence of Obstacle"),  # type: ignore[arg-type]
        (lambda: Scene(POST), "obstacles.*: got .*a sequence of Obstacle"),  # type: ignore[arg-type]
        (lambda: Scene(attached=(POST,)), "attached.*: got .*a sequence of Attached"),  # type: ignore[arg-type]
        (lambda: Scene(name="x" * 65), "name of the scene"),
        (lambda: Scene(description="x" * 1001), "description: .* at most 1000"),
        (lambda: Scene(description="\x1b[2J"), "description: .* printable"),
        (lambda: Scene(tuple(Obstacle(f"o{k}", Sphere(0.1)) for k in range(10_001))), "got 10001; expected at most"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            make()


# The hash


def test_equal_scenes_have_equal_hashes() -> None:
    again = Scene((Obstacle("post", Cylinder(0.03, 0.4), Pose((0.3, -0.0, 0.2))), BALL), (HELD,))
    assert again.hash == Scene((POST, BALL), (HELD,)).hash


def test_the_hash_leaves_out_what_changes_no_verdict() -> None:
    assert Scene((POST,), name="a", description="b").hash == Scene((POST,)).hash


def test_every_other_content_has_another_hash() -> None:
    for other in [
        Scene(),
        Scene((BALL, POST), (HELD,)),
        Scene((POST, BALL)),
        Scene((POST, BALL, Obstacle("block", HELD.shape, HELD.pose))),
        SCENE.moved("post", Pose((math.nextafter(0.3, 1.0), 0.0, 0.2))),
        SCENE.moved("post", Pose((0.3, 0.0, 0.2), (0.0, 1.0, 0.0, 0.0))),
        Scene((Obstacle("mast", POST.shape, POST.pose), BALL), (HELD,)),
        Scene((Obstacle("post", Capsule(0.03, 0.4), POST.pose), BALL), (HELD,)),
        Scene((Obstacle("post", Cylinder(0.4, 0.03), POST.pose), BALL), (HELD,)),
        Scene((POST, BALL), (Attached("block", HELD.shape, HELD.pose, ("finger_left",)),)),
    ]:
        assert other.hash != SCENE.hash


def test_a_scene_that_was_asked_for_its_hashes_is_copied_and_sent() -> None:
    scene = load_scene("bin")
    told = scene.hash, dict(scene.obstacle_hashes)
    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert (again.hash, dict(again.obstacle_hashes)) == told


def test_the_hash_is_the_same_in_every_process() -> None:
    assert SCENE.hash == "c205dce3caa8b3e733ba41625b2166abd65e24c3c3a7da72cacb16afac64ce8e"
    assert pickle.loads(pickle.dumps(SCENE)).hash == SCENE.hash


# The scenes that come with the package


def test_the_promised_scenes_are_there() -> None:
    promised = {"empty", "table", "bin", "shelf", "post", "clutter", "narrow", "window", "discs"}
    assert promised <= set(scene_names())
    assert list(scene_names()) == sorted(scene_names())


@pytest.mark.parametrize("name", scene_names())
def test_a_shipped_scene_loads_under_its_own_name_and_round_trips(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    assert scene.name == name
    assert scene.description
    save_scene(scene, tmp_path / "copy.toml")
    assert load_scene(tmp_path / "copy.toml") == scene


def test_the_table_is_a_thick_box_a_millimetre_below_everything_on_it() -> None:
    for name in [name for name in scene_names() if name not in ("empty", "discs")]:
        scene = load_scene(name)
        table = scene.obstacle("table")
        assert isinstance(table.shape, Box)
        assert min(table.shape.size) >= 0.1
        assert table.pose.position[2] + table.shape.half[2] == pytest.approx(-0.001, abs=1e-12)
        for obstacle in scene.without("table").obstacles:
            assert lowest(obstacle) >= -1e-12, obstacle.name


def lowest(obstacle: Obstacle) -> float:
    assert obstacle.pose.quaternion == (1.0, 0.0, 0.0, 0.0)
    if isinstance(obstacle.shape, Box):
        return obstacle.pose.position[2] - obstacle.shape.half[2]
    assert isinstance(obstacle.shape, Cylinder)
    return obstacle.pose.position[2] - obstacle.shape.length / 2


def test_the_block_clears_the_floor_of_the_bin_by_a_millimetre() -> None:
    scene = load_scene("bin")
    floor = scene.obstacle("bin_floor")
    assert isinstance(floor.shape, Box)
    floor_top = floor.pose.position[2] + floor.shape.half[2]
    assert lowest(scene.obstacle("blue_block")) - floor_top == pytest.approx(0.001, abs=1e-12)


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


def test_quotes_line_ends_and_attached_objects_come_back(tmp_path: Path) -> None:
    save_scene(SCENE, tmp_path / "scene.toml")
    assert load_scene(tmp_path / "scene.toml") == SCENE


def test_saving_replaces_the_file_and_leaves_no_other(tmp_path: Path) -> None:
    path = write(tmp_path, "# old\n")
    save_scene(SCENE, path)
    assert load_scene(path) == SCENE
    assert list(tmp_path.iterdir()) == [path]


def test_saving_through_a_link_keeps_the_link(tmp_path: Path) -> None:
    target = write(tmp_path, "# old\n")
    link = tmp_path / "link.toml"
    link.symlink_to(target)
    save_scene(SCENE, link)
    assert link.is_symlink()
    assert load_scene(target) == SCENE


def test_a_scene_too_large_to_be_loaded_again_is_not_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planner_service.scene.toml_reader.MAX_BYTES", 100)
    with pytest.raises(InvalidRequest, match="expected a scene that fits in 100 bytes"):
        save_scene(SCENE, tmp_path / "scene.toml")
    assert not list(tmp_path.iterdir())


# Finding files


def test_a_name_nobody_has_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownName, match="unknown scene 'tabel'; did you mean 'table'"):
        load_scene("tabel")


def test_a_text_that_is_no_file_is_a_name() -> None:
    for name in ["", "..", "empty\x00"]:
        with pytest.raises(UnknownName, match="unknown scene"):
            load_scene(name)


def test_a_scene_is_found_by_text_and_by_path(tmp_path: Path) -> None:
    path = tmp_path / "plain"
    save_scene(SCENE, path)
    assert load_scene(str(path)) == load_scene(path) == SCENE


def test_a_text_that_ends_in_toml_is_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_scene(SCENE, tmp_path / "table.toml")
    monkeypatch.chdir(tmp_path)
    assert load_scene("table.toml") == SCENE
    assert load_scene("table") != SCENE


def test_what_is_neither_name_nor_path_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="scene: got 7; expected the name of a scene or the path"):
        load_scene(7)  # type: ignore[arg-type]


# Files that cannot be used


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = write(tmp_path, "#" * (scene_file.MAX_BYTES + 1))
    assert problems_of(path) == ("too large: more than 5,000,000 bytes",)


def test_a_file_that_is_not_utf8_is_refused_with_the_line(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(b'name = "a"\ndescription = "caf\xe9"\n')
    assert problems_of(path) == ("not UTF-8: byte 0xe9 on line 2",)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('name = "a"\n[[obstacle]\n', "malformed TOML: .*line 2"),
        ('name = "a"\nname = "b"\n', "malformed TOML: .*line 2"),
        ("a = " + "[" * 100_000, "malformed TOML"),
        ("a = " + "9" * 5000, "malformed TOML"),
        ("\x00", "malformed TOML: .*line 1"),
    ],
)
def test_malformed_toml_is_refused(text: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match=problem):
        load_scene(write(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("nmae = 'a'", "unknown key 'nmae'; did you mean 'name'?"),
        ("zzz = 1", "unknown key 'zzz'; expected one of name, description, obstacle, attached"),
        ("name = 3", "name: got 3; expected a text"),
        (f"name = '{'x' * 65}'", "name: got 'xxxxxxxxxxxx...xxxxxxxxxxxxx'; expected 1 to 64 printable"),
        (f"description = '{'x' * 1001}'", "description: got 'xxxxxxxxxxxx...xxxxxxxxxxxxx'; expected at most 1000"),
        ("obstacle = 3", "obstacle: got 3; expected tables, each headed [[obstacle]]"),
        ("[obstacle]\nname = 'a'", "obstacle: got {'name': 'a'}; expected tables"),
    ],
)
def test_a_problem_at_the_top_is_named(text: str, problem: str, tmp_path: Path) -> None:
    (found,) = problems_of(write(tmp_path, text))
    assert found.startswith(problem)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("position", "postion"), ": unknown key 'postion'; did you mean 'position'?"),
        (("position = [0.0, 0.0, 0.0]", ""), ".position: missing; expected [x, y, z]"),
        (("0.0, 0.0, 0.0", "0.0, 0.0"), ".position: got [0.0, 0.0]; expected [x, y, z]"),
        (("0.0, 0.0, 0.0", "0.0, nan, 0.0"), ".position[1]: got nan; expected a finite number"),
        (("0.0, 0.0, 0.0", "0.0, 0.0, -inf"), ".position[2]: got -inf"),
        (("0.0, 0.0, 0.0", "300, 0, 2000"), ".position[2]: got 2000; expected a number from -1000 to 1000"),
        (("0.0, 0.0, 0.0", "true, 0, 0"), ".position[0]: got True; expected a finite number"),
        (("0.0, 0.0, 0.0", "'0', 0, 0"), ".position[0]: got '0'; expected a finite number"),
        (("0.0, 0.0, 0.0", "0x" + "f" * 9000 + ", 0, 0"), ".position[0]: got an integer of thousands of digits"),
        (("name = ", "quaternion_wxyz = [1, 1, 0, 0]\nname = "), ".quaternion_wxyz: got [1, 1, 0, 0]; expected a unit"),
        (("name = ", "quaternion_wxyz = [0, 0, 1]\nname = "), ".quaternion_wxyz: got [0, 0, 1]; expected [w, x, y, z]"),
        (("name = ", "quaternion_wxyz = [1, 0, 0, nan]\nname = "), ".quaternion_wxyz[3]: got nan"),
        (("sphere = 0.1", ""), ": shape is missing; expected exactly one of box, sphere, cylinder, capsule"),
        (("sphere = 0.1", "sphere = 0.1\nbox = [1, 1, 1]"), ": two or more shapes, box and sphere; expected exactly"),
        (("sphere = 0.1", "sphere = -0.1"), ".sphere: got -0.1; expected a positive length up to 1000 m"),
        (("sphere = 0.1", "sphere = nan"), ".sphere: got nan"),
        (("sphere = 0.1", "sphere = 0"), ".sphere: got 0; "),
        (("sphere = 0.1", "sphere = [0.1]"), ".sphere: got [0.1]"),
        (("sphere = 0.1", "box = [0.1, -0.1, 0.1]"), ".box[1]: got -0.1; expected a positive length"),
        (("sphere = 0.1", "box = 0.1"), ".box: got 0.1; expected [x, y, z]"),
        (("sphere = 0.1", "cylinder = [0.1, 0.2]"), ".cylinder: got [0.1, 0.2]; expected { radius = ..., length ="),
        (("sphere = 0.1", "capsule = { radius = inf, length = 1 }"), ".capsule.radius: got inf"),
        (("sphere = 0.1", "capsule = { radius = 0.1 }"), ".capsule.length: missing; expected a length in metres"),
        (
            ("sphere = 0.1", "cylinder = { radius = 1, length = 1, hieght = 2 }"),
            ".cylinder: unknown key 'hieght'; expected one of radius, length",
        ),
    ],
)
def test_a_problem_of_an_obstacle_is_named_with_its_number_and_name(
    change: tuple[str, str], problem: str, tmp_path: Path
) -> None:
    text = "[[obstacle]]\n" + NEEDED.replace(*change)
    assert any(p.startswith(f"obstacle[0] 'post'{problem}") for p in problems_of(write(tmp_path, text)))


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("", "obstacle[0].name: missing; expected a text"),
        ("name = 7", "obstacle[0].name: got 7; expected a text"),
        ("name = ''", "obstacle[0].name: got ''; expected 1 to 64 printable characters"),
        ('name = "a\\u0000"', "obstacle[0] 'a\\x00'.name: got 'a\\x00'; expected"),
        (f"name = '{'n' * 10_000}'", "obstacle[0].name: got 'nnnnnnnnnnnn...nnnnnnnnnnnnn'; expected"),
    ],
)
def test_an_unusable_name_in_a_file_is_refused(name: str, problem: str, tmp_path: Path) -> None:
    text = "[[obstacle]]\n" + NEEDED.replace('name = "post"', name)
    (found,) = problems_of(write(tmp_path, text))
    assert found.startswith(problem)


@pytest.mark.parametrize(
    ("links", "problem"),
    [
        ("'finger'", "touch_links: got 'finger'; expected a list of texts"),
        ("['f', 'f']", "touch_links: got ('f', 'f'); expected each link once"),
        ("['']", "touch_links: got ''; expected 1 to 64 printable characters"),
    ],
)
def test_unusable_touch_links_are_refused(links: str, problem: str, tmp_path: Path) -> None:
    (found,) = problems_of(write(tmp_path, f"[[attached]]\n{NEEDED}touch_links = {links}\n"))
    assert found.startswith(f"attached[0] 'post'.{problem}")


def test_an_obstacle_has_no_touch_links(tmp_path: Path) -> None:
    (found,) = problems_of(write(tmp_path, f"[[obstacle]]\n{NEEDED}touch_links = []\n"))
    assert found.startswith("obstacle[0] 'post': unknown key 'touch_links'")


def test_a_name_used_twice_in_a_file_is_named_once(tmp_path: Path) -> None:
    text = f"[[obstacle]]\n{NEEDED}\n[[obstacle]]\n{NEEDED}\n[[attached]]\n{NEEDED}"
    expected = "name: got 'post'; expected each name once among obstacles and attached objects"
    assert problems_of(write(tmp_path, text)) == (expected,)


def test_all_problems_of_a_file_are_told_at_once(tmp_path: Path) -> None:
    text = """
        titel = "a"
        [[obstacle]]
        name = "a"
        box = [nan, -1, 0.1]
        [[obstacle]]
        name = "a"
        sphere = 0.1
        cylinder = { radius = 0, lenght = 0.1 }
        position = [0, 0]
        quaternion_wxyz = [2, 0, 0, 0]
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
        "obstacle[1] 'a'.position: got [0, 0]",
        "obstacle[1] 'a'.quaternion_wxyz: got [2, 0, 0, 0]",
        "attached[0].name: missing",
        "attached[0].touch_links[0]: got 3",
        "unknown key 'titel'",
    ]


def test_more_objects_than_a_scene_may_have_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "[[obstacle]]\n" * 9_999 + "[[attached]]\n" * 2)
    assert problems_of(path) == ("10,001 obstacles and attached objects; expected at most 10,000",)


def test_almost_unit_quaternions_are_normalised_as_everywhere(tmp_path: Path) -> None:
    path = write(tmp_path, f"[[obstacle]]\n{NEEDED}quaternion_wxyz = [0.7071, 0.7071, 0, 0]\n")
    assert load_scene(path).obstacle("post").pose == Pose(quaternion=(0.7071, 0.7071, 0.0, 0.0))


@pytest.mark.parametrize(("given", "meant"), [("blue", "blue_block"), ("BLOCK", "blue_block"), ("tary", "tray")])
def test_a_part_of_a_name_is_enough_to_say_what_was_meant(given: str, meant: str) -> None:
    with pytest.raises(UnknownName, match=f"did you mean '{meant}'"):
        load_scene("bin").obstacle(given)


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


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ('{ kind = "cone" }', r"attached\[0\] 'cup'\.constraints\[0\]\.kind: got 'cone'; expected one of"),
        ('{ kind = "tool region", tilt = 9.0 }', r"constraints\[0\]\.tilt: got 9\.0; expected radians in"),
        ('{ kind = "tool region" }', r"constraints\[0\].*nothing is bounded"),
        ('{ kind = "joint range", joint = "joint_4", lower = 1.0 }', r"constraints\[0\].*upper"),
        ("3", r"constraints: got \[3\]; expected \[\{ kind"),
    ],
)
def test_a_scene_file_with_a_constraint_that_is_none_is_refused(table: str, problem: str, tmp_path: Path) -> None:
    body = f'[[attached]]\nname = "cup"\nsphere = 0.02\nposition = [0.0, 0.0, 0.0]\nconstraints = [{table}]\n'
    (tmp_path / "scene.toml").write_text(body)
    with pytest.raises(InvalidFile, match=problem):
        load_scene(tmp_path / "scene.toml")
