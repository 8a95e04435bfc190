"""A word of a robot file is read, has no effect for a stated reason, is refused by name, or gets a warning."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.shapes import Capsule
from planner_service.robot.elements.table import Rule, words_of
from planner_service.robot.model import Robot
from planner_service.robot.srdf import usable_srdf
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.check_robot import FindingKind, check_robot
from planner_service.robot_setup.loading import load_robot

ARM = """<robot name="arm">
  <link name="foot"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="boom">
    <visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>
    <collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
  <joint name="swing" type="revolute">
    <parent link="foot"/><child link="boom"/><origin xyz="0 0 0.3" rpy="0 0 0.5"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="1.5" velocity="1" effort="5"/>
  </joint>
</robot>"""
LIMIT, ORIGIN = '<limit lower="-2" upper="1.5" velocity="1" effort="5"/>', '<origin xyz="0 0 0.3" rpy="0 0 0.5"/>'
SPHERE, VISUAL = '<sphere radius="0.1"/>', "<visual><geometry>"


def changed(old: str, new: str) -> str:
    assert ARM.count(old) == 1, "the change must change the file"
    return ARM.replace(old, new)


def written(folder: Path, text: str, name: str = "arm.urdf") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def read(folder: Path, text: str) -> Urdf:
    return read_urdf(written(folder, text))


REFUSED = {
    "an attribute of a limit": (
        LIMIT,
        LIMIT.replace("/>", ' soft="1"/>'),
        "joint 'swing' <limit>: unknown attribute soft='1'",
    ),
    "a misspelt one": ("upper=", "uper=", "unknown attribute uper='1.5'; did you mean upper?"),
    "upper case": ("velocity=", "Velocity=", "unknown attribute Velocity='1'; did you mean velocity?"),
    "an element of a joint": (LIMIT, LIMIT + "<stop/>", "joint 'swing': unknown element <stop>; expected origin"),
    "upper case elements": ("<limit", "<Limit", "unknown element <Limit>; did you mean limit?"),
    "an element of a shape": (
        SPHERE,
        SPHERE.replace("/>", '><scale x="2"/></sphere>'),
        "<sphere>: unknown element <scale>",
    ),
    "an attribute of a shape": (SPHERE, SPHERE.replace("/>", ' scale="2"/>'), "<sphere>: unknown attribute scale='2'"),
    "an attribute of an origin": (ORIGIN, ORIGIN.replace("rpy", "quat"), "<origin>: unknown attribute quat='0 0 0.5'"),
    "degrees": (ORIGIN, ORIGIN.replace("/>", ' units="deg"/>'), "<origin>: unknown attribute units='deg'"),
    "text in an element": (ORIGIN, ORIGIN.replace("/>", ">0 0 9</origin>"), "<origin>: text '0 0 9' has no meaning"),
    "a misspelt joint": (
        "</robot>",
        '<jiont name="end"/></robot>',
        "unknown element <jiont> 'end'; did you mean joint?",
    ),
    "links within another element": ("</robot>", '<part><link name="x"/></part></robot>', "unknown element <part>"),
    "a word of ours with a prefix": (
        "</visual>",
        "</visual><my:collision/>",
        "unknown element <my:collision>; did you mean",
    ),
    "a prefixed attribute of ours": ("upper=", "my:upper=", "unknown attribute my:upper='1.5'"),
    "a closed loop": ("</robot>", '<loop_joint name="x"/></robot>', "<loop_joint>: a closed loop of links"),
    "a version to come": (
        'name="arm"',
        'name="arm" version="3.0"',
        "<robot> version = '3.0'; expected one of 1.0, 1.1",
    ),
    "a quaternion in URDF 1.0": (ORIGIN, '<origin quat_xyzw="0 0 0 1"/>', "origin quat_xyzw is a word of URDF 1.1"),
    "a limit missing in URDF 1.2": (LIMIT, '<limit upper="1" velocity="1"/>', None),
    "one soft limit": (
        LIMIT,
        LIMIT + '<safety_controller soft_upper_limit="1"/>',
        "expected both soft_lower_limit and",
    ),
    "two safety controllers": (
        LIMIT,
        LIMIT + "<safety_controller/><safety_controller/>",
        "<safety_controller> is given 2",
    ),
    "an acceleration of 0": (LIMIT, LIMIT.replace("/>", ' acceleration="0"/>'), "acceleration 0; expected a positive"),
    "a scale with one number": (SPHERE, '<mesh filename="a.stl" scale="0.001"/>', "scale = '0.001'; expected 3 finite"),
    "a second geometry": (
        f"<geometry>{SPHERE}",
        f"<geometry>{SPHERE}</geometry><geometry>{SPHERE}",
        "<geometry> is given 2",
    ),
    "a joint that no plan moves": ('type="revolute"', 'type="planar"', "joint 'swing': type 'planar'; write two"),
    "numbers with commas": ('lower="-2"', 'lower="-2,0"', "lower = '-2,0'; expected a finite number"),
    "numbers with units": ('radius="0.1"', 'radius="0.1 m"', "radius = '0.1 m'; expected a finite number"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_could_move_or_reshape_a_robot_is_refused_by_name_in_load_and_check_alike(
    tmp_path: Path, case: str
) -> None:
    old, new, message = REFUSED[case]
    text = changed(old, new)
    if message is None:
        text, message = text.replace('name="arm"', 'name="arm" version="1.2"'), "lower = None; expected a finite number"
    path = written(tmp_path, text)
    with pytest.raises(InvalidFile) as caught:
        load_robot(path)
    assert message in str(caught.value)
    assert [f.text for f in check_robot(path).findings if f.is_error] == list(caught.value.problems)


TOLD = {
    "an element of another program": (
        "</robot>",
        '<foo_control name="x"/></robot>',
        "<robot>: <foo_control> 'x' is not known, and has no effect",
    ),
    "a namespace": (LIMIT, LIMIT + '<drake:bushing k="1"/>', "joint 'swing': <drake:bushing> is not known, and has no"),
    "a prefixed attribute": ("upper=", 'drake:gear="9" upper=', "<limit>: drake:gear='9' belongs to another program"),
    "stray text": ("</robot>", "&gt; </robot>", "<robot>: text '>' has no meaning here"),
    "a link's own origin": (VISUAL, f'<origin xyz="1 0 0"/>{VISUAL}', "link 'boom': <origin> has no effect: no reader"),
    "a word in a visual": (VISUAL, f"<colour/>{VISUAL}", None),
    "a wish for a capsule": (VISUAL, f"<collision_checking/>{VISUAL}", "<collision_checking> has no effect: a wish"),
    "soft limits without room": (
        LIMIT,
        LIMIT + '<safety_controller soft_lower_limit="0" soft_upper_limit="0"/>',
        "0 .. 0 leave no room within -2 .. 1.5; these soft limits are not used",
    ),
}


@pytest.mark.parametrize("case", TOLD)
def test_what_belongs_to_other_programs_is_told_of_by_name_in_load_and_check_alike(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, case: str
) -> None:
    old, new, message = TOLD[case]
    if message is None:
        old, new, message = "<visual>", "<visual><colour/>", "link 'boom' <visual>: unknown element <colour>"
    path = written(tmp_path, changed(old, new))
    with caplog.at_level(logging.WARNING):
        load_robot(path)
    assert message in caplog.text
    assert any(message in f.text for f in check_robot(path).findings if f.kind is FindingKind.NOT_UNDERSTOOD)


def test_what_is_known_to_have_no_effect_is_not_told_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    more = '<transmission><x y="1">t</x></transmission><gazebo/><material name="a"/><ros2_control/><mujoco/>'
    text = changed("</robot>", f"{more}</robot>")
    text = text.replace(LIMIT, LIMIT + '<dynamics damping="1" D="2"/><calibration rising="0"/>')
    with caplog.at_level(logging.WARNING):
        load_robot(written(tmp_path, text.replace('name="arm"', 'name="arm" version="1.0" xmlns:x="http://x.org"')))
    assert caplog.text == ""


def test_a_word_in_many_places_is_one_line(tmp_path: Path) -> None:
    text = changed(SPHERE, SPHERE.replace("/>", ' foo="2"/>')).replace("<box size", '<box foo="2" size')
    text = text.replace(f"<geometry>{SPHERE.replace('/>', '')}", f"<geometry>{SPHERE.replace('/>', '')}")
    with pytest.raises(InvalidFile) as caught:
        read(tmp_path, text)
    assert [line for line in caught.value.problems if "foo" in line] == [
        "link 'foot' <collision> <geometry> <box>: unknown attribute foo='2'; expected size",
        "link 'boom' <collision> <geometry> <sphere>: unknown attribute foo='2'; expected radius",
    ]


@pytest.mark.parametrize("seed", range(5))
def test_a_quaternion_is_the_same_turn_as_its_angles(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(200):
        near = rng.integers(3)
        rpy = rng.uniform(-3.1, 3.1, 3)
        if near:
            rpy[1] = rng.choice([-1.0, 1.0]) * (np.pi / 2 - rng.choice([0.0, 10.0 ** rng.uniform(-16, -3)]))
        x, y, z, w = quaternion(*rpy)
        both = [
            read(tmp_path, changed(ORIGIN, f'<origin xyz="0 0 0.3" {turn}/>').replace("<robot", '<robot version="1.1"'))
            for turn in (f'quat_xyzw="{x} {y} {z} {w}"', f'rpy="{rpy[0]} {rpy[1]} {rpy[2]}"')
        ]
        one, other = (urdf.joints[0].rpy for urdf in both)
        assert np.abs(matrix(*one) - matrix(*other)).max() < 1e-14


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, ...]:
    from scipy.spatial.transform import Rotation

    return tuple(Rotation.from_euler("xyz", [roll, pitch, yaw]).as_quat().tolist())


def matrix(roll: float, pitch: float, yaw: float) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix())


@pytest.mark.parametrize(
    ("turn", "message"),
    [
        ('quat_xyzw="0 0 0 2"', "origin quat_xyzw has length 2; expected 1"),
        ('quat_xyzw="0 0 1"', "quat_xyzw = '0 0 1'; expected 4 finite numbers"),
        ('quat_xyzw="0 0 0 1" rpy="0 0 0.1"', "origin rpy and quat_xyzw are different rotations; expected one"),
    ],
)
def test_a_quaternion_that_is_none_or_contradicts_is_refused(tmp_path: Path, turn: str, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        read(tmp_path, changed(ORIGIN, f"<origin {turn}/>").replace('name="arm"', 'name="arm" version="1.1"'))


def test_limits_that_are_not_given_are_zero(tmp_path: Path) -> None:
    joint = read(tmp_path, changed('lower="-2" ', "")).joints[0]
    assert (joint.lower, joint.upper) == (0.0, 1.5)
    joint = read(tmp_path, changed('upper="1.5" ', "")).joints[0]
    assert (joint.lower, joint.upper) == (-2.0, 0.0)


def test_a_plan_keeps_within_soft_limits(tmp_path: Path) -> None:
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="9" k_velocity="10"/>'
    robot = load_robot(written(tmp_path, changed(LIMIT, LIMIT + soft)))
    assert (robot.limits.lower.tolist(), robot.limits.upper.tolist()) == ([-1.0], [1.5])


def test_a_safety_controller_without_soft_limits_limits_nothing(tmp_path: Path) -> None:
    joint = read(tmp_path, changed(LIMIT, LIMIT + '<safety_controller k_velocity="10"/>')).joints[0]
    assert (joint.lower, joint.upper, joint.hard) == (-2.0, 1.5, None)


def test_limits_of_a_joint_without_end_are_told_of_and_refused_in_urdf_1_2(tmp_path: Path) -> None:
    text = changed('type="revolute"', 'type="continuous"')
    (finding,) = (f for f in check_robot(written(tmp_path, text)).findings if f.kind is FindingKind.LIMITS)
    assert "joint 'swing': it is continuous, so lower='-2' and upper='1.5' have no effect" in finding.text
    with pytest.raises(InvalidFile, match="it is continuous"):
        read(tmp_path, text.replace('name="arm"', 'name="arm" version="1.2"'))


def test_accelerations_and_jerks_that_are_stated_are_the_limits(tmp_path: Path) -> None:
    stated = LIMIT.replace("/>", ' acceleration="4" deceleration="2" jerk="30"/>')
    limits = load_robot(written(tmp_path, changed(LIMIT, stated))).limits
    assert (limits.acceleration.tolist(), limits.jerk.tolist()) == ([2.0], [30.0])
    unlimited = LIMIT.replace("/>", ' acceleration="inf"/>')
    assert load_robot(written(tmp_path, changed(LIMIT, unlimited))).limits.acceleration.tolist() == [3.141596]


def test_a_capsule_has_its_caps_beyond_its_length(tmp_path: Path) -> None:
    urdf = read(tmp_path, changed(SPHERE, '<capsule radius="0.1" length="0.4"/>'))
    assert urdf.links[1].collisions[0].shape == Capsule(0.1, 0.4)


CHAIN = ARM.replace("</robot>", "") + "".join(
    f"""<link name="{name}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
    <joint name="{name}_joint" type="revolute"><parent link="{above}"/><child link="{name}"/><origin xyz="0 0 0.4"/>
    {LIMIT}</joint>"""
    for above, name in (("boom", "c"), ("c", "d"))
) + "</robot>"  # fmt: skip


def srdf(folder: Path, tags: str) -> Path:
    written(folder, f'<robot name="arm">{tags}</robot>', "arm.srdf")
    return written(folder, CHAIN)


def test_a_link_whose_collisions_are_disabled_by_default_is_checked_where_they_are_enabled(tmp_path: Path) -> None:
    path = srdf(tmp_path, '<disable_default_collisions link="foot"/>')
    assert Robot.from_urdf(path, srdf=path.with_suffix(".srdf")).link_pairs == (("boom", "d"),)
    enabled = '<disable_default_collisions link="foot"/><enable_collisions link1="d" link2="foot"/>'
    assert set(load_robot(srdf(tmp_path, enabled)).link_pairs) == {("foot", "d"), ("boom", "d")}
    both = f'{enabled}<disable_collisions link1="foot" link2="d" reason="meant"/>'
    robot = load_robot(srdf(tmp_path, both))
    assert robot.link_pairs == (("boom", "d"),)
    assert {contact.links: contact.reason for contact in robot.allowed_contacts}["foot", "d"] == "meant"


def test_a_passive_joint_stands_at_home_and_is_told_of(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    group = '<group name="all"><joint name="d_joint"/></group>'
    state = '<group_state name="home" group="all"><joint name="d_joint" value="0.25"/></group_state>'
    with caplog.at_level(logging.WARNING):
        robot = load_robot(srdf(tmp_path, f'<passive_joint name="d_joint"/>{group}{state}'))
    assert robot.joint_names == ("swing", "c_joint")
    assert robot.locked_joints == (("d_joint", 0.25),)
    assert "passive joints are not planned for, and stand as at home: d_joint" in caplog.text


def test_a_passive_joint_that_is_asked_for_moves(tmp_path: Path) -> None:
    path = srdf(tmp_path, '<passive_joint name="d_joint"/>')
    robot = Robot.from_urdf(path, srdf=path.with_suffix(".srdf"), joints=["d_joint"])
    assert robot.joint_names == ("d_joint",)


SRDF_PROBLEMS = {
    "a misspelt element": (
        '<disable_colisions link1="foot" link2="d"/>',
        "unknown element <disable_colisions>; did you mean disable_collisions?",
    ),
    "a misspelt attribute": (
        '<disable_collisions link1="foot" link_2="d"/>',
        "unknown attribute link_2='d'; did you mean link2?",
    ),
    "an element within another": (
        '<group name="g"><disable_collisions link1="foot" link2="d"/></group>',
        "group 'g': unknown element <disable_collisions>",
    ),
    "no such passive joint": ('<passive_joint name="x"/>', "passive_joint: 'x' is not a joint of the URDF"),
    "no such enabled link": ('<enable_collisions link1="x" link2="d"/>', "enable_collisions[0]: 'x' is not a link"),
    "no such default link": (
        '<disable_default_collisions link="x"/>',
        "disable_default_collisions[0]: 'x' is not a link",
    ),
    "no such hand": ('<end_effector name="e" group="x" parent_link="d"/>', "end_effector: 'x' is not a group"),
    "a group twice": ('<group name="g"/><group name="g"/>', "group 'g' is defined 2 times"),
}


@pytest.mark.parametrize("case", SRDF_PROBLEMS)
def test_what_an_srdf_gets_wrong_is_named_by_all_who_read_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, case: str
) -> None:
    tags, message = SRDF_PROBLEMS[case]
    path = srdf(tmp_path, tags)
    with pytest.raises(InvalidFile) as caught:
        Robot.from_urdf(path, srdf=path.with_suffix(".srdf"))
    assert message in str(caught.value)
    with caplog.at_level(logging.WARNING):
        load_robot(path)
    assert message in caplog.text
    assert any(message in f.text for f in check_robot(path).findings if f.kind is FindingKind.NOT_UNDERSTOOD)


SRDF_NOTES = {
    "an element of another program": ("<walking/>", "<robot>: <walking> is not known, and has no effect"),
    "a group of what is not there": (
        '<group name="g"><joint name="x"/></group>',
        "group 'g': 'x' is not a joint of the URDF",
    ),
    "a chain that leads nowhere": (
        '<group name="g"><chain base_link="d" tip_link="foot"/></group>',
        "group 'g': no chain of joints leads from link 'd' to 'foot'",
    ),
}


@pytest.mark.parametrize("case", SRDF_NOTES)
def test_what_is_not_used_of_an_srdf_is_told_of(tmp_path: Path, case: str) -> None:
    tags, message = SRDF_NOTES[case]
    path = srdf(tmp_path, tags)
    found, problems = usable_srdf(path.with_suffix(".srdf"), read_urdf(path))
    assert problems == []
    assert [note for note in found.notes if message in note] == list(found.notes)
    assert any(message in f.text for f in check_robot(path).findings if f.kind is FindingKind.NOT_UNDERSTOOD)


def test_an_srdf_of_another_robot_is_told_of(tmp_path: Path) -> None:
    path = srdf(tmp_path, "")
    other = written(tmp_path, '<robot name="leg"/>', "arm.srdf")
    assert usable_srdf(other, read_urdf(path))[0].notes == ("it is that of robot 'leg', and the URDF's is 'arm'",)


def test_a_group_may_hold_the_joint_that_fixes_the_robot_in_the_world(tmp_path: Path) -> None:
    world = '<virtual_joint name="world" type="fixed" parent_frame="map" child_link="foot"/>'
    robot = load_robot(srdf(tmp_path, f'{world}<group name="g"><joint name="world"/><joint name="swing"/></group>'))
    assert [(group.name, group.joints) for group in robot.groups] == [("g", ("swing",))]


TABLES = [("URDF", "robot"), ("SRDF", "robot"), ("MJCF", "mujoco"), ("SDF", "sdf")]
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "robot-words.md"


def markdown(tag: str, root: Rule) -> str:
    """A table for people: each element once, with all that it is inside of, and its attributes below it."""
    tags: dict[Rule, list[str]] = {}
    inside: dict[Rule, list[str]] = {}

    def visit(name: str, holder: str, rule: Rule) -> None:
        seen = rule in tags
        tags.setdefault(rule, []).append(name)
        inside.setdefault(rule, []).append(holder)
        if not seen:
            for child, below in rule.children.items():
                visit(child, name, below)

    def listed(words: list[str], around: str) -> str:
        return ", ".join(f"`{around[:1]}{word}{around[1:]}`" for word in dict.fromkeys(words) if word)

    visit(tag, "", root)
    lines = ["| element or attribute | inside | effect | why |", "| --- | --- | --- | --- |"]
    for rule, names in tags.items():
        rows = [(listed(names, "<>"), listed(inside[rule], "<>"), rule.effect, rule.why)]
        for effect, why in dict.fromkeys(rule.attributes.values()):
            words = [name for name, what in rule.attributes.items() if what == (effect, why)]
            rows.append((listed(words, ""), listed(names, "<>"), effect, why))
        lines += [f"| {a} | {b} | {effect.value} | {why.replace('<', '&lt;')} |" for a, b, effect, why in rows]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("name", "tag"), TABLES)
def test_the_documentation_has_the_tables_as_they_are(name: str, tag: str) -> None:
    text = PAGE.read_text("utf-8")
    before, _, rest = text.partition(f"<!-- begin {name} -->\n")
    listed, _, after = rest.partition(f"<!-- end {name} -->\n")
    wanted = markdown(tag, words_of(name.lower()))
    if os.environ.get("WRITE_OUTPUTS"):
        PAGE.write_text(f"{before}<!-- begin {name} -->\n{wanted}<!-- end {name} -->\n{after}", "utf-8")
        listed = wanted
    assert listed == wanted
