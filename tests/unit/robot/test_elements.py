"""A word of a robot file is read, has no effect for a stated reason, is refused by name, or gets a warning."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import numpy as np
import pytest

from planner_service.errors import InvalidFile
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.elements.table import Rule, words_of
from planner_service.robot.model import Robot
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
    "a misspelt one": ("upper=", "uper=", "unknown attribute uper='1.5'; did you mean upper?"),
    "an element of a joint": (LIMIT, LIMIT + "<stop/>", "joint 'swing': unknown element <stop>; expected origin"),
    "an attribute of a shape": (SPHERE, SPHERE.replace("/>", ' scale="2"/>'), "<sphere>: unknown attribute scale='2'"),
    "text in an element": (ORIGIN, ORIGIN.replace("/>", ">0 0 9</origin>"), "<origin>: text '0 0 9' has no meaning"),
    "a word of ours with a prefix": ("</visual>", "</visual><my:collision/>", "unknown element <my:collision>; did"),
    "a version to come": ('name="arm"', 'name="arm" version="3.0"', "<robot> version = '3.0'; expected one of 1.0"),
    "a quaternion in URDF 1.0": (ORIGIN, '<origin quat_xyzw="0 0 0 1"/>', "origin quat_xyzw is a word of URDF 1.1"),
    "two safety controllers": (LIMIT, f"{LIMIT}{2 * '<safety_controller/>'}", "<safety_controller> is given 2"),
    "a joint that no plan moves": ('type="revolute"', 'type="planar"', "joint 'swing': type 'planar'; write two"),
    "numbers with units": ('radius="0.1"', 'radius="0.1 m"', "radius = '0.1 m'; expected a finite number"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_could_move_or_reshape_a_robot_is_refused_by_name_in_load_and_check_alike(
    tmp_path: Path, case: str
) -> None:
    old, new, message = REFUSED[case]
    text = changed(old, new)
    path = written(tmp_path, text)
    with pytest.raises(InvalidFile) as caught:
        load_robot(path)
    assert message in str(caught.value)
    assert [f.text for f in check_robot(path).findings if f.is_error] == list(caught.value.problems)


TOLD = {
    "an element of another program": ("</robot>", "<control/></robot>", "<robot>: <control> is not known, and has no"),
    "a prefixed attribute": ("upper=", 'drake:gear="9" upper=', "<limit>: drake:gear='9' belongs to another program"),
    "a link's own origin": (VISUAL, f'<origin xyz="1 0 0"/>{VISUAL}', "link 'boom': <origin> has no effect: no reader"),
}


@pytest.mark.parametrize("case", TOLD)
def test_what_belongs_to_other_programs_is_told_of_by_name_in_load_and_check_alike(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, case: str
) -> None:
    old, new, message = TOLD[case]
    path = written(tmp_path, changed(old, new))
    with caplog.at_level(logging.WARNING):
        load_robot(path)
    assert message in caplog.text
    assert any(message in f.text for f in check_robot(path).findings if f.kind is FindingKind.NOT_UNDERSTOOD)


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


def test_a_plan_keeps_within_soft_limits(tmp_path: Path) -> None:
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="9" k_velocity="10"/>'
    robot = load_robot(written(tmp_path, changed(LIMIT, LIMIT + soft)))
    assert (robot.limits.lower.tolist(), robot.limits.upper.tolist()) == ([-1.0], [1.5])


def test_accelerations_and_jerks_that_are_stated_are_the_limits(tmp_path: Path) -> None:
    stated = LIMIT.replace("/>", ' acceleration="4" deceleration="2" jerk="30"/>')
    limits = load_robot(written(tmp_path, changed(LIMIT, stated))).limits
    assert (limits.acceleration.tolist(), limits.jerk.tolist()) == ([2.0], [30.0])
    drake = LIMIT.replace("/>", ' acceleration="4" drake:acceleration="2.5"/>')
    assert load_robot(written(tmp_path, changed(LIMIT, drake))).limits.acceleration.tolist() == [2.5]
    unlimited = LIMIT.replace("/>", ' acceleration="inf"/>')
    assert load_robot(written(tmp_path, changed(LIMIT, unlimited))).limits.acceleration.tolist() == [3.141596]


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


SRDF_PROBLEMS = {
    "a misspelt element": ('<disable_colisions link1="foot"/>', "unknown element <disable_colisions>; did you mean"),
    "no such passive joint": ('<passive_joint name="x"/>', "passive_joint: 'x' is not a joint of the URDF"),
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
