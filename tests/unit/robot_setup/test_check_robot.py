"""One small file for each mistake that a URDF may have, and what is said about it; a good file gets no word."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidRequest
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


L_SHAPE = """
v 0.00 -0.02 0
v 0.02 -0.02 0
v 0.02 -0.02 0.05
v 0.07 -0.02 0.05
v 0.07 -0.02 0.06
v 0.00 -0.02 0.06
v 0.00 0.02 0
v 0.02 0.02 0
v 0.02 0.02 0.05
v 0.07 0.02 0.05
v 0.07 0.02 0.06
v 0.00 0.02 0.06
f 1 2 3 6
f 3 4 5 6
f 7 12 9 8
f 9 12 11 10
f 1 7 8 2
f 2 8 9 3
f 3 9 10 4
f 4 10 11 5
f 5 11 12 6
f 6 12 7 1
"""
"""A hook: a bar of 0.06 m along z, and from its end one along x."""
HOOKED = f"""<link name="hook">{looks('<mesh filename="hook.obj"/>', "0 0 0", "collision")}</link>
  <link name="peg">{looks('<box size="0.01 0.01 0.02"/>', "0 0 0.01", "collision")}</link>
  <joint name="finger_1" type="revolute"><parent link="tip"/><child link="hook"/><origin xyz="0.03 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-0.01" upper="0.01" velocity="1" effort="1"/></joint>
  <joint name="finger_2" type="prismatic"><parent link="tip"/><child link="peg"/><origin xyz="0.06 0 AT"/>
  <axis xyz="0 0 1"/><limit lower="0" upper="0.002" velocity="1" effort="1"/></joint>"""


@pytest.mark.parametrize(("at", "crosses"), [("0.018", False), ("0.045", True)])
def test_fingers_pass_through_each_other_by_their_meshes_and_not_by_hulls_alone(
    folder: Path, at: str, crosses: bool
) -> None:
    (folder / "hook.obj").write_text(L_SHAPE)
    found = checked(folder, TIP, TIP + HOOKED.replace("AT", at))
    assert any("pass through" in finding.text for finding in found.findings) is crosses


def test_an_srdf_of_a_larger_robot_is_one_finding(folder: Path) -> None:
    pairs = "".join(f'<disable_collisions link1="foot" link2="other_{k}" reason="Never"/>' for k in range(20))
    (folder / "larger.srdf").write_text(f'<robot name="desk_arm">{pairs}</robot>')
    try:
        (finding,) = checked(folder, 'desk_arm"', 'desk_arm"').findings
    finally:
        (folder / "larger.srdf").unlink()
    assert finding.text.startswith("larger.srdf: not used of it: disable_collisions[0]: 'other_0' is not a link")
    assert finding.text.endswith(" and 16 more")


def test_of_several_srdfs_the_message_says_how_to_choose(folder: Path) -> None:
    files = [folder / f"{name}.srdf" for name in ("one", "two", "arm")]
    for file in files[:2]:
        file.write_text('<robot name="desk_arm"/>')
    try:
        (finding,) = checked(folder, 'desk_arm"', 'desk_arm"').findings
        assert finding.text.endswith("(one.srdf, two.srdf); call the right one arm.srdf")
        files[0].rename(files[2])
        assert check_robot(folder / "arm.urdf").findings == ()
    finally:
        for file in files:
            file.unlink(missing_ok=True)


# ---- MJCF

MJCF = """<mujoco model="m"><compiler angle="radian"/>{assets}<worldbody>
<body name="base"><geom type="box" size=".05 .05 .05"/>
<body name="upper" pos="0 0 .1"><joint name="shoulder" axis="0 1 0" range="-2 2" actuatorfrcrange="-9 9"/>
<geom type="capsule" size=".02" fromto="0 0 .03 0 0 .2"/>{upper}
<body name="hand" pos="0 0 .25"><joint name="wrist" axis="0 1 0" range="-2 2" actuatorfrcrange="-9 9"/>
<geom type="box" size=".03 .02 .02"/>{hand}<site name="tcp" pos="0 0 .05"/></body></body></body></worldbody>{tail}
</mujoco>"""
SEEN_ONLY = '<geom type="sphere" size=".03" pos="0 0 .1" contype="0" conaffinity="0" {}/>'
SEEN_BODY = '<body name="lamp" pos="0 0 .1"><geom type="sphere" size=".01" contype="0" conaffinity="0"/></body>'
PALMS = "".join(
    f'<body name="{name}" pos="0 {at} .05"><joint name="{name}" type="slide" axis="0 {way} 0" range="-.04 .04" '
    'actuatorfrcrange="-9 9"/><geom type="box" size=".01 .01 .02"/></body>'
    for name, at, way in (("left_finger", 0.01, 1), ("right_finger", -0.01, -1))
)
TENDONS = """<tendon><fixed name="t1"><joint joint="shoulder" coef="1"/></fixed><fixed name="t2"><joint joint="wrist"
 coef="1"/></fixed></tendon><equality><tendon name="couple" tendon1="t1" tendon2="t2"/></equality>"""
OF_MJCF: dict[str, tuple[dict[str, str], dict[FindingKind, str]]] = {
    "a good one": ({}, {}),
    "geoms that collide with nothing": (
        {"upper": SEEN_ONLY.format("")},
        {K.OVERHANG: "link 'upper': what it looks like extends 10.0 mm beyond"},
    ),
    "hidden geoms": ({"upper": SEEN_ONLY.format('group="3"'), "hand": SEEN_ONLY.format('rgba="1 1 1 0"')}, {}),
    "a body that is never checked": ({"hand": SEEN_BODY}, {K.VISUAL_ONLY: "link 'lamp': it has visual elements alone"}),
    "fingers that cross": (
        {"hand": PALMS},
        {K.FINGERS: "fingers pass through each other: right_finger x left_finger"},
    ),
    "home in collision": (
        {"hand": '<geom type="box" size=".03 .02 .02" pos="0 0 -.32"/>'},
        {K.HOME: "home collides with itself: hand x base (at most"},
    ),
    "couplings by tendons": ({"tail": TENDONS}, {K.REFUSED: "tendon 'couple': tendons couple joints; write <joint"}),
}


@pytest.mark.parametrize("name", OF_MJCF)
def test_mjcf_is_checked_as_a_urdf_is(tmp_path: Path, name: str) -> None:
    parts, expected = OF_MJCF[name]
    blank = dict.fromkeys(("assets", "upper", "hand", "tail"), "")
    (tmp_path / "m.xml").write_text(MJCF.format(**blank | parts))
    told = {f.kind: str(f) for f in check_robot(tmp_path / "m.xml").findings}
    advice = told.pop(K.VELOCITY)
    assert advice.endswith("MJCF has none; import-robot writes a robot.toml, in which they can be set")
    told = {kind: text for kind, text in told.items() if kind is not K.NOT_UNDERSTOOD}
    assert told.keys() == expected.keys(), told
    assert all(text in told[kind] for kind, text in expected.items()), told
    done = run("robot", "check", tmp_path / "m.xml", "--png", tmp_path / "m.png")
    assert (done.exit_code, (tmp_path / "m.png").exists()) == (int(K.REFUSED in expected), True)


# ---- robots that have a name or a robot.toml


def test_a_robot_is_checked_by_every_name_that_loads_it() -> None:
    for name in ("planar2", str(ROOT / "robots" / "planar2" / "robot.toml"), "example-robot-data:bolt"):
        found = check_robot(name)
        assert (found.ok, found.robot is not None) == (True, True), name
    assert check_robot("panda").findings == ()
    with pytest.raises(InvalidRequest, match="unknown robot 'pand'; did you mean 'panda'"):
        check_robot("pand")


def test_of_a_robot_toml_its_own_mistakes_are_found(tmp_path: Path) -> None:
    folder = ROOT / "robots" / "planar2"
    text = (folder / "robot.toml").read_text("utf-8")
    (tmp_path / "planar2.urdf").write_text((folder / "planar2.urdf").read_text("utf-8"))
    (tmp_path / "robot.toml").write_text(text.replace('tool_frame = "', 'tool_frame = "no_'))
    (finding,) = check_robot(tmp_path / "robot.toml").findings
    assert (finding.kind, "tool_frame: 'no_tip' is no link of the URDF" in finding.text) == (K.REFUSED, True)
    with pytest.raises(InvalidRequest, match=r"tool_frame: .* a robot.toml says it itself"):
        check_robot("planar2", tool_frame="tip")


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
