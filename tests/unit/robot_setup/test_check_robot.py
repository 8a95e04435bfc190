"""One small file for each mistake that a URDF may have, and what is said about it; a good file gets no word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Box
from planner_service.robot.model import Robot
from planner_service.robot_setup.check_robot import FindingKind, RobotCheck, check_robot
from planner_service.robot_setup.loading import load_robot
from tests.support.command import document, run

ROOT = Path(__file__).parents[3]
ARM = (ROOT / "examples" / "desk_arm.urdf").read_text("utf-8")
SHOULDER = 'lower="-0.3" upper="2.6"'
FOREARM = '<geometry><box size="0.22 0.03 0.03"/></geometry>'
COLUMN = """<collision>
      <origin xyz="0 0 0.06"/>
      <geometry><cylinder radius="0.03" length="0.12"/></geometry>
    </collision>"""
TIP = '<link name="tip"/>'


def looks(geometry: str, xyz: str = "0 0 0", tag: str = "visual") -> str:
    return f'<{tag}><origin xyz="{xyz}"/><geometry>{geometry}</geometry></{tag}>'


CAMERA = f'<link name="tip">{looks("<box size=" + chr(34) + "0.1 0.02 0.02" + chr(34) + "/>")}</link>'
TABLE = f"""<link name="side_table">{looks('<box size="1 1 0.05"/>', "0 0 -1", "collision")}</link>
  <joint name="stand" type="fixed"><parent link="foot"/><child link="side_table"/></joint>
  <link name="tip"/>"""
HEAD = '<link name="head">'

TINY = '<geometry><mesh filename="large.obj" scale="1e-6 1e-6 1e-6"/></geometry>'
BALL, LOST = '<geometry><mesh filename="ball.ply"/></geometry>', '<mesh filename="head.dae"/>'
SEEN, SKULL = COLUMN.replace("collision", "visual"), '<box size="0.06 0.08 0.06"/>'
ROD = looks('<box size="0.6 0.02 0.02"/>', "-0.3 0 0", "collision")
TURNS, ENDLESS = '"turn" type="revolute"', '"turn" type="continuous"'

LENS = CAMERA.replace("visual", "collision")

K = FindingKind
BOLTED = '<parent link="head"/> <child link="tip"/>\n    <origin xyz="0.06 0 0"/>'


def crossing() -> str:
    """Fingers that slide past each other, ahead of the head."""
    pad = '<collision><origin xyz="0.05 0 0"/><geometry><box size="0.04 0.02 0.02"/></geometry></collision>'
    limit = '<limit lower="-0.04" upper="0.04" velocity="0.1" effort="5"/>'
    return "".join(
        f'<link name="{name}">{pad}</link><joint name="{name}_finger" type="prismatic"><parent link="head"/>'
        f'<child link="{name}"/><origin xyz="0.06 {0.01 * side} 0"/><axis xyz="0 {side} 0"/>{limit}</joint>'
        for name, side in (("left", 1), ("right", -1))
    )


FAULTS = {
    "velocity 0": ('velocity="1.5"', 'velocity="0"', K.VELOCITY, "no velocity of shoulder: a slow one is assumed"),
    "a negative velocity": ('velocity="1.5"', 'velocity="-1.5"', K.REFUSED, "joint 'shoulder': velocity -1.5; exp"),
    "no such link": ('<child link="head"/>', '<child link="hand"/>', K.REFUSED, "joint 'wrist': child link 'hand'"),
    "almost nothing is free": (
        TIP,
        LENS,
        K.BLOCKED,
        "only 0.0% of 1,000 random configurations are free",
    ),
    "a tool far away": (
        BOLTED,
        BOLTED.replace("0.06", "0.6"),
        K.TOOL,
        "tip is 0.54 m away from the shapes",
    ),
    "crossing fingers": (TIP, TIP + crossing(), K.FINGERS, "fingers pass through each other: right x left (at most"),
    "degrees": (SHOULDER, 'lower="-17.2" upper="149"', K.DEGREES, "if they are degrees, write -0.3002 .. 2.6005"),
    "a box in millimetres": ("0.22 0.03 0.03", "220 30 30", K.UNITS, "is millimetres, write 0.22 x 0.03 x 0.03"),
    "a mesh scaled twice": (FOREARM, TINY, K.UNITS, "the file is in metres already, leave out its scale of 0.001"),
    "never checked": (COLUMN, SEEN, K.VISUAL_ONLY, "it has visual elements alone, so it is never checked"),
    "a tool that is never checked": (TIP, CAMERA, K.VISUAL_ONLY, "it extends 51.2 mm beyond what is"),
    "a model that falls short": (HEAD, HEAD + looks(SKULL, "0.03 0 0"), K.OVERHANG, "extends 28.3 mm beyond what is"),
    "an axis of another length": ("0 0 1", "0 0 2", K.AXIS, "axis 0 0 2 has length 2; write one of length 1"),
    "a hull of too many corners": (FOREARM, BALL, K.SIMPLIFIED, "a simpler one around it is checked; at most 0.19 mm"),
    "home in collision": (HEAD, HEAD + ROD, K.HOME, "home collides with itself: head x upper_arm (at most 30.0 mm"),
    "no effort": (' effort="3"', "", K.EFFORT, "no effort of elbow: what the motors can do is unknown"),
    "furniture": (TIP, TABLE, K.FURNITURE, "link 'side_table': seems to be part of the scene"),
    "limits of a joint without end": (TURNS, ENDLESS, K.LIMITS, "so lower='-3.0' and upper='3.0' have no effect"),
    "a word of another program": (HEAD, f"{HEAD}<drake:proximity/>", K.NOT_UNDERSTOOD, "<drake:proximity> is not"),
    "a visual mesh that is missing": (HEAD, HEAD + looks(LOST), K.UNREAD_VISUAL, "mesh 'head.dae' does not exist"),
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
    """One has a mesh, too: ``test_concave_links``."""
    assert {kind for _, _, kind, _ in FAULTS.values()} == {*FindingKind} - {FindingKind.HULLS}


WHATEVER = [
    *("", "<robot name='a'/>", ARM.replace("revolute", "ball"), ARM.replace("0 0 1", "0 0 0")),
    ARM.replace('effort="1"/>', 'effort="1"/><mimic joint="none"/>'),
]


@pytest.mark.parametrize("text", WHATEVER)
def test_whatever_the_file_holds_there_is_an_answer(folder: Path, text: str) -> None:
    (folder / "arm.urdf").write_text(text)
    found = check_robot(folder / "arm.urdf")
    assert not found.ok
    assert all(finding.is_error for finding in found.findings)


def test_limits_in_radians_are_not_taken_for_degrees(folder: Path) -> None:
    """One turn, two turns, five half turns with all digits, and as good as none."""
    for lower, upper in [("-6.2832", "6.2832"), ("-12.5", "12.5"), ("-15.70796", "15.70796"), ("-1000", "1000")]:
        assert checked(folder, SHOULDER, f'lower="{lower}" upper="{upper}"').findings == ()


def test_visual_as_collision_checks_a_link_as_it_looks(folder: Path) -> None:
    found = checked(folder, TIP, CAMERA, visual_as_collision=True)
    assert FindingKind.VISUAL_ONLY not in [finding.kind for finding in found.findings]
    robot = Robot.from_urdf(folder / "arm.urdf", visual_as_collision=True)
    assert [item.shape for item in robot.shapes if item.link == "tip"] == [Box((0.1, 0.02, 0.02))]
    assert "tip" not in {item.link for item in Robot.from_urdf(folder / "arm.urdf").shapes}


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


PAD = looks('<box size="0.02 0.01 0.01"/>', "0.06 0 0")
PADS = "".join(
    f'<link name="{side}_pad">{PAD}</link><joint name="{side}_glue" type="fixed">'
    f'<parent link="{side}"/><child link="{side}_pad"/></joint>'
    for side in ("left", "right")
)


def test_fingers_with_links_that_only_look_like_something_are_drawn_and_measured(folder: Path) -> None:
    """Such a link moves with a finger whose shape it may extend beyond."""
    (folder / "arm.urdf").write_text(ARM.replace(TIP, TIP + crossing() + PADS))
    found = check_robot(folder / "arm.urdf")
    assert found.robot is not None
    assert found.robot.gripper is not None
    assert found.overhangs["left_pad"] == pytest.approx(0.0, abs=1e-9)
    (folder / "arm.urdf").write_text(ARM.replace(TIP, TIP + crossing() + PADS.replace("0.06 0 0", "0.09 0 0")))
    done = run("robot", "check", folder / "arm.urdf", "--png", folder / "pads.png")
    assert done.exit_code == 0
    assert "it extends 30.0 mm beyond what is" in " ".join(done.stdout.split())
    assert (folder / "pads.png").exists()
