"""One small file for each mistake that a URDF may have, and what is said about it; a good file gets no word."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box
from planner_service.robot.model import Robot
from planner_service.robot.package_files import example_urdf
from planner_service.robot_setup.check_robot import FindingKind, RobotCheck, check_robot
from planner_service.robot_setup.loading import load_robot
from planner_service.view.still.pictures import draw_robot_check
from tests.support.command import document, run

ROOT = Path(__file__).parents[3]
ARM = (ROOT / "examples" / "desk_arm.urdf").read_text("utf-8")
TURN, SHOULDER = 'lower="-3.0" upper="3.0" velocity="2.0" effort="5"', 'lower="-0.3" upper="2.6"'
FOREARM = '<geometry><box size="0.22 0.03 0.03"/></geometry>'
COLUMN = """<collision>
      <origin xyz="0 0 0.06"/>
      <geometry><cylinder radius="0.03" length="0.12"/></geometry>
    </collision>"""
TIP = '<link name="tip"/>'


def looks(geometry: str, xyz: str = "0 0 0", tag: str = "visual") -> str:
    return f'<{tag}><origin xyz="{xyz}"/><geometry>{geometry}</geometry></{tag}>'


CAMERA = f'<link name="tip">{looks("<box size=" + chr(34) + "0.1 0.02 0.02" + chr(34) + "/>")}</link>'
STUB = '<box size="0.02 0.01 0.01"/>'
TABLE = f"""<link name="side_table">{looks('<box size="1 1 0.05"/>', "0 0 -1", "collision")}</link>
  <joint name="stand" type="fixed"><parent link="foot"/><child link="side_table"/></joint>
  <link name="tip"/>"""
HEAD = '<link name="head">'

K = FindingKind
FAULTS = {
    "velocity 0": (
        'velocity="1.5"',
        'velocity="0"',
        K.VELOCITY,
        'no velocity of shoulder: a slow one is assumed; write <limit velocity="..."/>, in rad/s or m/s',
    ),
    "a negative velocity": (
        'velocity="1.5"',
        'velocity="-1.5"',
        K.REFUSED,
        "joint 'shoulder': velocity -1.5; expected at least 0",
    ),
    "limits swapped": (SHOULDER, 'lower="2.6" upper="-0.3"', K.REFUSED, "joint 'shoulder': lower 2.6 is above"),
    "no such mesh": (
        FOREARM,
        '<geometry><mesh filename="arm.stl"/></geometry>',
        K.REFUSED,
        "link 'forearm' collision[0]: mesh 'arm.stl' does not exist in the folders that may be read",
    ),
    "no such link": ('<child link="head"/>', '<child link="hand"/>', K.REFUSED, "joint 'wrist': child link 'hand'"),
    "degrees": (
        SHOULDER,
        'lower="-17.2" upper="149"',
        K.DEGREES,
        "joint 'shoulder': limits -17.2 .. 149 rad are 26.5 turns; if they are degrees, write -0.3002 .. 2.6005",
    ),
    "a box in millimetres": (
        "0.22 0.03 0.03",
        "220 30 30",
        K.UNITS,
        "link 'forearm': its collision box measures 220 x 30 x 30 m; if that is millimetres, write 0.22 x 0.03 x 0.03",
    ),
    "a mesh in millimetres": (
        FOREARM,
        '<geometry><mesh filename="large.obj"/></geometry>',
        K.UNITS,
        "link 'forearm': its collision mesh measures 220 x 30 x 30 m; if that is millimetres, write "
        'scale="0.001 0.001 0.001"',
    ),
    "a mesh scaled twice": (
        FOREARM,
        '<geometry><mesh filename="large.obj" scale="1e-6 1e-6 1e-6"/></geometry>',
        K.UNITS,
        "link 'forearm': its collision mesh measures 0.00022 x 3e-05 x 3e-05 m; if the file is in metres already, "
        "leave out its scale of 0.001",
    ),
    "an origin in millimetres": (
        "0.25 0 0",
        "250 0 0",
        K.UNITS,
        "joint 'elbow': its origin is 250 m from its parent; if that is millimetres, write 0.25 0 0",
    ),
    "never checked": (
        COLUMN,
        COLUMN.replace("collision", "visual"),
        K.VISUAL_ONLY,
        "link 'column': it has visual elements alone, so it is never checked; nothing that moves with it is; give it "
        "collision elements, or use visual_as_collision (--visual-as-collision)",
    ),
    "a tool that is never checked": (
        TIP,
        CAMERA,
        K.VISUAL_ONLY,
        "link 'tip': it has visual elements alone, so it is never checked; it extends 51.2 mm beyond what is; give it "
        "collision elements, or use visual_as_collision (--visual-as-collision)",
    ),
    "a model that falls short": (
        HEAD,
        HEAD + looks('<box size="0.06 0.08 0.06"/>', "0.03 0 0"),
        K.OVERHANG,
        "link 'head': what it looks like extends 28.3 mm beyond what is checked; enlarge its collision shapes, or plan "
        "with that much padding",
    ),
    "an axis of another length": (
        "0 0 1",
        "0 0 2",
        K.AXIS,
        "joint 'turn': axis 0 0 2 has length 2; write one of length 1",
    ),
    "a hull of too many corners": (
        FOREARM,
        '<geometry><mesh filename="ball.ply"/></geometry>',
        K.SIMPLIFIED,
        "link 'forearm': the hull of its mesh has more than 5,000 corners; a simpler one around it is checked; at most "
        "0.19 mm larger; use a simpler mesh if that is too much",
    ),
    "home in collision": (
        HEAD,
        HEAD + looks('<box size="0.6 0.02 0.02"/>', "-0.3 0 0", "collision"),
        K.HOME,
        "home collides with itself: head x upper_arm (at most 30.0 mm deep), head x column (at most 10.0 mm deep); "
        "load_robot takes the nearest free configuration found instead: turn=",
    ),
    "no effort": (
        ' effort="3"',
        "",
        K.EFFORT,
        'no effort of elbow: what the motors can do is unknown; write <limit effort="..."/>, in Nm or N',
    ),
    "furniture": (
        TIP,
        TABLE,
        K.FURNITURE,
        "link 'side_table': seems to be part of the scene; as part of the robot it may touch obstacles; make it an "
        "obstacle of the scene",
    ),
    "limits of a joint without end": (
        '"turn" type="revolute"',
        '"turn" type="continuous"',
        K.LIMITS,
        "joint 'turn': it is continuous, so lower='-3.0' and upper='3.0' have no effect; a revolute joint has limits",
    ),
    "a word of another program": (
        HEAD,
        HEAD + "<drake:proximity/>",
        K.NOT_UNDERSTOOD,
        "link 'head': <drake:proximity> is not known, and has no effect",
    ),
    "a visual mesh that is missing": (
        HEAD,
        HEAD + looks('<mesh filename="head.dae"/>'),
        K.UNREAD_VISUAL,
        "link 'head' visual[0]: mesh 'head.dae' does not exist",
    ),
}
"""What of the desk arm is replaced by what, and what is found."""


def sphere(count: int) -> FloatArray:
    points = np.random.default_rng(2).normal(size=(count, 3))
    return np.asarray(points / np.sqrt((points * points).sum(axis=1))[:, None])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Meshes that the files name: a bar in millimetres, and a ball of many corners."""
    folder = tmp_path_factory.mktemp("faults")
    corners = [f"v {x} {y} {z}" for x in (-110, 110) for y in (-15, 15) for z in (-15, 15)]
    (folder / "large.obj").write_text("\n".join([*corners, "f 1 2 3 4 5 6 7 8", ""]))
    rows = [" ".join(map(repr, row)) for row in (0.02 * sphere(6000)).tolist()]
    head = "ply\nformat ascii 1.0\nelement vertex 6000\nproperty double x\nproperty double y\nproperty double z\n"
    (folder / "ball.ply").write_text("\n".join([head + "end_header", *rows, ""]))
    return folder


def checked(folder: Path, old: str, new: str, *, visual_as_collision: bool = False) -> RobotCheck:
    assert ARM.count(old) == 1, "the change must change the file in one place"
    (folder / "arm.urdf").write_text(ARM.replace(old, new))
    return check_robot(folder / "arm.urdf", visual_as_collision=visual_as_collision)


def test_a_good_file_gets_no_word(folder: Path) -> None:
    found = checked(folder, 'desk_arm"', 'desk_arm"')
    assert (found.findings, found.ok) == ((), True)


@pytest.mark.parametrize("fault", FAULTS)
def test_each_mistake_is_found_alone_and_explained(folder: Path, fault: str) -> None:
    old, new, kind, text = FAULTS[fault]
    found = checked(folder, old, new)
    first, *more = found.findings
    assert first.kind is kind
    assert text in str(first)
    assert found.ok == (kind is not FindingKind.REFUSED)
    assert more == [] or fault in ("no such link", "never checked")
    assert {*first.links, *first.joints}, "what it is about"


def test_every_kind_of_finding_has_a_file() -> None:
    assert {kind for _, _, kind, _ in FAULTS.values()} == set(FindingKind)


def test_what_is_refused_is_what_loading_refuses(folder: Path) -> None:
    """Every problem at once, and warnings with them."""
    text = (
        ARM.replace('velocity="1.5"', 'velocity="-1"').replace("0.22 0.03 0.03", "0.22 0.03").replace(' effort="3"', "")
    )
    (folder / "arm.urdf").write_text(text)
    kinds = [finding.kind for finding in check_robot(folder / "arm.urdf").findings]
    assert kinds == [FindingKind.REFUSED, FindingKind.REFUSED, FindingKind.EFFORT]


WHATEVER = ["", "<robot", "<robot name='a'/>", "<html/>", ARM.replace("revolute", "ball"), ARM.replace(TIP, TIP + TIP),
            ARM.replace("elbow", "wrist"), ARM.replace('effort="1"/>', 'effort="1"/><mimic joint="none"/>'),
            ARM.replace('type="fixed"', 'type="fixed" type="fixed"'), ARM.replace("0.25 0 0", "1e300 0 0"),
            ARM.replace('upper="2.8"', 'upper="1e17"'), ARM.replace("0 0 1", "0 0 0")]  # fmt: skip


@pytest.mark.parametrize("text", WHATEVER)
def test_whatever_the_file_holds_there_is_an_answer(folder: Path, text: str) -> None:
    (folder / "arm.urdf").write_text(text)
    found = check_robot(folder / "arm.urdf")
    assert not found.ok
    assert all(finding.is_error for finding in found.findings)


def test_no_file_is_an_error_too(tmp_path: Path) -> None:
    (finding,) = check_robot(tmp_path / "none.urdf").findings
    assert "no such file" in str(finding)


def test_limits_in_radians_are_not_taken_for_degrees(folder: Path) -> None:
    """One turn, two turns, five half turns with all digits, and as good as none."""
    for lower, upper in [("-6.2832", "6.2832"), ("-12.5", "12.5"), ("-15.70796", "15.70796"), ("-1000", "1000")]:
        assert checked(folder, SHOULDER, f'lower="{lower}" upper="{upper}"').findings == ()


@pytest.mark.parametrize("axis", ["0.577 0.577 0.577", "0.7071 0.7071 0", "-1 0 0"])
def test_an_axis_with_three_digits_has_length_1(folder: Path, axis: str) -> None:
    assert FindingKind.AXIS not in [f.kind for f in checked(folder, "0 0 1", axis).findings]


def test_what_is_inside_the_shapes_of_a_link_it_is_fixed_to_is_checked_with_them(folder: Path) -> None:
    inside = f'<link name="tip">{looks(STUB, "-0.03 0 0")}</link>'
    assert checked(folder, TIP, inside).findings == ()


def test_shapes_that_move_do_not_cover_what_stands(folder: Path) -> None:
    """The column is within the upper arm only as long as the shoulder does not move."""
    found = checked(folder, HEAD, HEAD + looks(STUB, "-0.1 0 0"))
    assert found.overhangs == {"head": pytest.approx(math.hypot(0.14, math.hypot(0.005, 0.005)) - 0.03, abs=1e-9)}


def test_the_middle_of_a_large_triangle_counts(folder: Path) -> None:
    """Two balls cover the ends of a sheet, of which all corners are there, and nothing covers its middle."""
    (folder / "sheet.obj").write_text("v 0 0 0\nv 0.2 0.001 0\nv 0.2 -0.001 0\nf 1 2 3\n")
    ends = "".join(looks('<sphere radius="0.03"/>', f"{x} 0 0", "collision") for x in (0.03, 0.23))
    foreign = ARM.replace(HEAD, HEAD + ends + looks('<mesh filename="sheet.obj"/>', "0.03 0 0"))
    (folder / "arm.urdf").write_text(foreign)
    assert check_robot(folder / "arm.urdf").overhangs["head"] == pytest.approx(0.07, abs=0.01)


def test_visual_as_collision_checks_a_link_as_it_looks(folder: Path) -> None:
    found = checked(folder, TIP, CAMERA, visual_as_collision=True)
    assert found.findings == ()
    robot = Robot.from_urdf(folder / "arm.urdf", visual_as_collision=True)
    assert [item.shape for item in robot.shapes if item.link == "tip"] == [Box((0.1, 0.02, 0.02))]
    assert "tip" not in {item.link for item in Robot.from_urdf(folder / "arm.urdf").shapes}


def test_visual_meshes_as_collision_are_their_hulls_and_have_to_be_right(folder: Path) -> None:
    mesh = '<mesh filename="large.obj" scale="0.001 0.001 0.001"/>'
    (folder / "arm.urdf").write_text(ARM.replace(TIP, f'<link name="tip">{looks(mesh)}</link>'))
    robot = Robot.from_urdf(folder / "arm.urdf", visual_as_collision=True, decompose={})
    (shape,) = [item.shape for item in robot.shapes if item.link == "tip"]
    assert isinstance(shape, Mesh)
    assert len(shape.vertices) == 8
    (folder / "arm.urdf").write_text(
        ARM.replace(TIP, f'<link name="tip">{looks(mesh.replace("large", "none"))}</link>')
    )
    with pytest.raises(InvalidRequest, match=r"link 'tip' visual\[0\]: mesh 'none.obj' does not exist"):
        Robot.from_urdf(folder / "arm.urdf", visual_as_collision=True)


def test_home_is_the_one_that_is_asked_for_and_loading_takes_the_free_one(folder: Path) -> None:
    old, new, _, _ = FAULTS["home in collision"]
    (finding,) = checked(folder, old, new).findings
    loaded = load_robot(folder / "arm.urdf")
    values = dict(part.split("=") for part in finding.advice.rpartition(": ")[2].split(", "))
    assert [float(values[name]) for name in loaded.joint_names] == pytest.approx(loaded.home.tolist(), rel=5e-3)


# ---- the command


@pytest.mark.parametrize(("fault", "code"), [("a negative velocity", 1), ("no effort", 0)])
def test_the_command_says_so_and_exits_with_1_if_the_robot_cannot_be_loaded(
    folder: Path, fault: str, code: int
) -> None:
    old, new, kind, text = FAULTS[fault]
    checked(folder, old, new)
    done = run("robot", "check", folder / "arm.urdf")
    assert (text[:20] in done.stdout, done.exit_code) == (True, code)
    record = document("robot", "check", folder / "arm.urdf", code=code)
    assert [finding["kind"] for finding in record["findings"]] == [kind.value]
    assert record["ok"] == (code == 0)


@pytest.mark.parametrize("fault", ["a negative velocity", "a tool that is never checked", "home in collision"])
def test_the_picture_has_the_links_in_the_colours_of_its_legend(folder: Path, fault: str) -> None:
    old, new, _, _ = FAULTS[fault]
    draw_robot_check(checked(folder, 'desk_arm"', 'desk_arm"'), folder / "good.png")
    draw_robot_check(checked(folder, old, new), folder / "bad.png")
    good, bad = (
        np.asarray(Image.open(folder / name).convert("HSV"), dtype=np.int16) for name in ("good.png", "bad.png")
    )
    vivid = [np.count_nonzero(image[:700, :, 1] > 150) for image in (good, bad)]
    assert vivid[0] == 0
    assert vivid[1] > 1000


def test_there_is_no_picture_of_what_cannot_be_a_robot(folder: Path) -> None:
    old, new, _, _ = FAULTS["no such link"]
    found = checked(folder, old, new)
    with pytest.raises(InvalidRequest, match="a robot can be made of"):
        draw_robot_check(found, folder / "none.png")
    done = run("robot", "check", folder / "arm.urdf", "--png", folder / "none.png")
    assert ("no picture" in done.stderr, done.exit_code) == (True, 1)
    assert not (folder / "none.png").exists()


def test_fingers_that_look_like_something_are_compared_with_their_shapes() -> None:
    found = check_robot(example_urdf("panda"))
    assert found.robot is not None
    assert found.robot.gripper is not None
    for finger in ("panda_leftfinger", "panda_rightfinger"):
        assert found.overhangs[finger] < 1e-3
