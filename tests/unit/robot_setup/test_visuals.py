"""What links look like is read as their files have it, and a picture that cannot be read never costs a robot."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from planner_service.geometry.mesh_paths import Surface
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.loading import load_robot
from planner_service.robot_setup.visuals import link_visuals, looks_of, visuals_of
from tests.support.small_robots import joint, link, solid, urdf
from tests.unit.robot_setup.test_gripper_detection import fingers

CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0))
PATCH = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 2 3\n"
"""One triangle: flat, which no collision shape may be."""


def seen(name: str, *visuals: str) -> str:
    return link(name, "".join(visuals)).replace("collision", "visual")


def mesh(file: str, scale: str = "1 1 1", rpy: str = "0 0 0") -> str:
    geometry = f'<geometry><mesh filename="{file}" scale="{scale}"/></geometry>'
    return f'<visual><origin xyz="1 2 3" rpy="{rpy}"/>{geometry}</visual>'


def arm(folder: Path, *parts: str) -> Path:
    (folder / "patch.obj").write_text(PATCH)
    content = [link("foot", solid("sphere", 'radius="0.1"')), *parts, link("tip", solid("sphere", 'radius="0.1"'))]
    joints = [joint("turn", "revolute foot tip -1 1", xyz="1 0 0")]
    joints += [joint(f"j{k}", f"fixed foot {part.split(chr(34))[1]} 0 0") for k, part in enumerate(parts)]
    (folder / "arm.urdf").write_text(urdf("arm", *content, *joints))
    return folder / "arm.urdf"


def test_a_mesh_is_its_triangles_where_the_link_has_them(tmp_path: Path) -> None:
    path = arm(tmp_path, seen("cover", mesh("patch.obj", "0.5 2 1", f"0 0 {math.pi / 2!r}"), mesh("patch.obj")))
    found = link_visuals(path)
    assert list(found) == ["cover"]
    first, second = found["cover"]
    assert isinstance(first.appearance, Surface)
    assert isinstance(second.appearance, Surface)
    corners = np.array(CORNERS, dtype=float)
    assert sorted(first.appearance.vertices.tolist()) == sorted((corners * (0.5, 2.0, 1.0)).tolist())
    assert second.appearance.vertices[second.appearance.triangles[0]].tolist() == corners.tolist()
    turned = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert np.allclose(first.pose.matrix, turned, rtol=0.0, atol=1e-15)


UNREADABLE = [
    (mesh("none.obj"), "link 'cover' visual[1]: mesh 'none.obj' does not exist"),
    (solid("box", "1 1"), "link 'cover' visual[1]: size = '1 1'; expected 3 finite numbers"),
    (solid("cone", 'radius="1"'), "unknown geometry <cone>"),
    ("<visual/>", "<geometry> has 0 shapes"),
]


@pytest.mark.parametrize(("element", "why"), UNREADABLE)
def test_a_visual_with_a_problem_is_left_out_and_said_so(tmp_path: Path, element: str, why: str) -> None:
    urdf = read_urdf(arm(tmp_path, seen("cover", mesh("patch.obj"), element)), visuals=True)
    assert len(visuals_of(urdf)["cover"]) == 1
    (told,) = urdf.unread_visuals
    assert why in told


def test_visuals_are_where_their_links_are_and_fingers_move_with_the_gripper(tmp_path: Path) -> None:
    """Each link looks like what is checked, so both must lie at the same places."""
    text = re.sub(r"<collision>(.*?)</collision>", r"<collision>\1</collision><visual>\1</visual>", fingers(apart=0.0))
    (tmp_path / "gripping.urdf").write_text(text, "utf-8")
    robot = load_robot(tmp_path / "gripping.urdf")
    looks = looks_of(robot)
    assert {"palm", "left", "right"} <= looks.visuals.keys()
    for shown in (robot, robot.with_gripper(0.03), robot.locked({"roll": 0.4})):
        q = np.linspace(0.3, -0.5, shown.n).tolist()
        bodies = [body_matrix(pose) for pose in shown.body_poses(q)]
        placed = looks.placements(shown, q)
        for item in shown.shapes:
            visual = looks.visuals[item.link][0]
            there = placed[item.link] @ visual.pose.matrix
            assert np.allclose(there, bodies[item.body] @ item.pose.matrix, rtol=0.0, atol=1e-12), item.link
