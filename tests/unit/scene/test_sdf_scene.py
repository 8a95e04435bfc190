"""SDFormat worlds: where shapes stand, by closed form and as Drake 1.51 places them; what is refused, and how."""

from __future__ import annotations

import logging
import math
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from planner_service.errors import InvalidFile
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.scene.loading import load_scene
from planner_service.scene.scene import Scene
from tests.support.fuzz import changed

COLLISION = "<collision name='c'>{}<geometry>{}</geometry></collision>"
BALL = "<sphere><radius>0.1</radius></sphere>"
SPHERE = COLLISION.format("{}", BALL)


def world(path: Path, content: str, version: str = "1.10") -> Path:
    file = path / "cell.sdf"
    file.write_text(f"<sdf version='{version}'><world name='cell'>{content}</world></sdf>")
    return file


def only(scene: Scene) -> tuple[float, ...]:
    (obstacle,) = scene.obstacles
    return tuple(np.round(obstacle.pose.position, 12).tolist())


def test_shapes_of_a_world_are_obstacles_named_by_model_and_link(tmp_path: Path) -> None:
    top = COLLISION.format("", "<box><size>1 2 0.1</size></box>")
    leg = COLLISION.format(
        "<pose degrees='true'>0.3 0 0 0 90 0</pose>", "<cylinder><radius>0.02</radius><length>0.4</length></cylinder>"
    )
    foot = COLLISION.format("", "<capsule><radius>0.1</radius><length>0.5</length></capsule>")
    table = f"""<model name='table'><static>true</static><pose>1 0 0 0 0 1.5707963267948966</pose>
      <link name='top'><pose>0 0 0.7 0 0 0</pose>{top}{leg}</link>
      <link name='foot'>{foot}</link><link name='bare'/></model>"""
    cup = f"<model name='cup'><pose>0 0.5 1 0 0 0</pose><link name='body'>{SPHERE.format('')}</link></model>"
    scene = load_scene(world(tmp_path, table + cup))
    assert [(body.name, type(body.shape)) for body in scene.obstacles] == [
        ("table::top", Box),
        ("table::top#2", Cylinder),
        ("table::foot", Capsule),
        ("cup", Sphere),
    ]
    quarter = Pose.from_rpy((1.0, 0.0, 0.7), (0.0, 0.0, math.pi / 2))
    assert np.allclose(scene.obstacles[0].pose.matrix, quarter.matrix, atol=1e-15)
    lying = quarter @ Pose.from_rpy((0.3, 0.0, 0.0), (0.0, math.pi / 2, 0.0))
    assert np.allclose(scene.obstacles[1].pose.matrix, lying.matrix, atol=1e-15)


def test_poses_are_relative_to_what_they_name(tmp_path: Path) -> None:
    """Random worlds of nested models, frames and placement frames stand as Drake places them; here are the rules."""
    frame = "<frame name='up'><pose>0 0 1 0 0 0</pose></frame>"
    link = f"<link name='l'><pose relative_to='f'>1 0 0 0 0 0</pose>{SPHERE.format('')}</link>"
    turned = "<frame name='f' attached_to='g'><pose>0 1 0 0 0 0</pose></frame>"
    other = "<frame name='g'><pose degrees='true'>0 0 0 0 0 90</pose></frame>"
    model = f"<model name='m'><pose relative_to='up'>5 0 0 0 0 0</pose>{link}{turned}{other}</model>"
    assert only(load_scene(world(tmp_path, frame + model))) == (4.0, 1.0, 1.0)
    placed = model.replace("name='m'", "name='m' placement_frame='l'")
    assert only(load_scene(world(tmp_path, frame + placed))) == (5.0, 0.0, 1.0)
    nested = f"<model name='out'>{model.replace('up', 'k')}<link name='k'><pose>0 0 3 0 0 0</pose></link></model>"
    seen = f"<model name='eye'><link name='e'><pose>0 0 0 0 0 0</pose>{SPHERE.format('')}</link></model>"
    far = seen.replace("<link", "<pose relative_to='out::m::l'>0 0 0.5 0 0 0</pose><link")
    positions = {body.name: body.pose.position for body in load_scene(world(tmp_path, nested + far)).obstacles}
    assert np.allclose([positions["out::m"], positions["eye"]], [(4.0, 1.0, 3.0), (4.0, 1.0, 3.5)])
    inside = f"<model name='m'><frame name='f'><pose>1 2 3 0 0 0</pose></frame><link name='l'>{SPHERE}</link></model>"
    assert only(load_scene(world(tmp_path, inside.format("<pose relative_to='f'>0 0 1 0 0 0</pose>")))) == (1, 2, 4)
    joint = "<joint name='j' type='revolute'><pose>0 0 2 0 0 0</pose><parent>world</parent><child>a</child></joint>"
    arm = f"<model name='m'><link name='a'><pose>1 0 0 0 0 0</pose></link>{joint}<link name='b'><pose relative_to='j'/>"
    assert only(load_scene(world(tmp_path, f"{arm}{SPHERE.format('')}</link></model>"))) == (1.0, 0.0, 2.0)


def test_what_moves_or_is_not_read_is_named_in_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    joint = "<joint name='hinge' type='revolute'><parent>a</parent><child>b</child></joint>"
    odd = f"<model name='m'><flying>1</flying>{joint}<link name='a'>{SPHERE.format('')}</link><link name='b'/></model>"
    with caplog.at_level(logging.WARNING):
        load_scene(world(tmp_path, odd))
    assert [word in caplog.text for word in ("<flying>", "'m::hinge': it can move (revolute)")] == [True, True]


LINK = "<model name='m'><link name='a'>{}</link></model>"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("<include><uri>model://table</uri></include>", "<include>: another file"),
        ("<model name='m'><include><uri>model://t</uri></include></model>", "<include>: another file"),
        ("<model name='m'><link name='a'/><link name='a'/></model>", "link 'm::a': the name is taken"),
        (LINK.format("<pose relative_to='b'/>{}"), "no frame 'b'"),
        (
            LINK.format("<pose relative_to='f'/>{}").replace("</model>", "<frame name='f' attached_to='a'/></model>"),
            "depends on itself",
        ),
        (LINK.format("<pose>1 2 3</pose>{}"), "expected x y z roll pitch yaw"),
        (LINK.format("<pose frame='b'>0 0 0 0 0 0</pose>{}"), "<pose> frame"),
        (LINK.format("<colision/>"), "did you mean collision"),
        (LINK.format(COLLISION.format("", "<box/>")), "size"),
        (LINK.format(COLLISION.format("", "<heightmap/>")), "<heightmap>: expected box"),
        (LINK.format(COLLISION.format("", "<mesh><uri>../../etc/x.stl</uri></mesh>")), "may be read"),
        (
            "<model name='m'><pose>0 0 1 0 0 0</pose></model>"
            "<state><model name='m'><pose>0 0 0 0 0 0</pose></model></state>",
            "<state>",
        ),
    ],
)
def test_what_is_no_world_is_refused_by_name(tmp_path: Path, content: str, expected: str) -> None:
    with pytest.raises(InvalidFile, match=expected):
        load_scene(world(tmp_path, content.format(SPHERE.format(""))))
    with pytest.raises(InvalidFile, match=r"version '2.0'; expected 1.4 to"):
        load_scene(world(tmp_path, "", "2.0"))


def test_round_shapes_contain_what_they_stand_for(tmp_path: Path) -> None:
    shapes = (
        "<cone><radius>0.2</radius><length>0.6</length></cone>",
        "<ellipsoid><radii>0.1 0.2 0.3</radii></ellipsoid>",
        "<plane><normal>0 0 2</normal><size>1 1</size></plane>",
    )
    links = "".join(
        f"<link name='l{k}'><collision name='c'><geometry>{shape}</geometry></collision></link>"
        for k, shape in enumerate(shapes)
    )
    cone, ball, ground = load_scene(world(tmp_path, f"<model name='m'>{links}</model>", "1.11")).obstacles
    rng = np.random.default_rng(1)
    u = rng.normal(size=(2000, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    assert float(ball.shape.distance(u * (0.1, 0.2, 0.3)).max()) == 0.0
    height = rng.uniform(-0.3, 0.3, 2000)
    rim = 0.2 * (0.3 - height) / 0.6
    angle = rng.uniform(0.0, 2.0 * math.pi, 2000)
    points = np.stack([rim * np.cos(angle), rim * np.sin(angle), height], axis=1)
    assert float(cone.shape.distance(points).max()) <= 1e-12
    assert ground.pose.position == (0.0, 0.0, -5.0)


WHOLE = """<sdf version='1.9'><world name='w'><frame name='f'><pose>0 0 1 0 0 0</pose></frame>
<model name='m' placement_frame='l'><pose relative_to='f'>1 0 0 0 0 0</pose><link name='l'><collision name='c'>
<geometry><box><size>1 1 1</size></box></geometry></collision></link></model></world></sdf>"""


@settings(max_examples=150)
@given(content=changed(WHOLE.encode(), b"<include/>", b"relative_to='m::l'", b"1e999"))
def test_a_broken_world_is_read_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "broken.sdf"
    path.write_bytes(content)
    with suppress(InvalidFile):
        load_scene(path)


def test_fuzzing_begins_with_a_world_that_is_read(tmp_path: Path) -> None:
    path = tmp_path / "whole.world"
    path.write_text(WHOLE)
    assert only(load_scene(path)) == (1.0, 0.0, 1.0)
