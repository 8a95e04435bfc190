"""Robots as their makers publish them are read rightly, or refused by a message whose step helps; steps are taken here.

Judges are xacro itself, Pinocchio and MuJoCo.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio
import pytest
import xacro
from xacro import substitution_args

from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.kinematic_tree import body_matrix
from planner_service.robot.model import Robot
from planner_service.robot_setup.check_robot import check_robot
from planner_service.robot_setup.loading import load_robot
from tests.support.small_robots import joint, link, solid, urdf

NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
BAR = solid("box", "0.04 0.04 0.2", "0 0 0.1")
FINGER = solid("box", "0.01 0.02 0.06", "0 0 0.03")
PAD = solid("box", "0.04 0.06 0.02")


def macros(*parts: str) -> str:
    return f'<robot name="r" {NAMESPACE}>{"".join(parts)}</robot>'


def package(name: str) -> str:
    return f'<?xml version="1.0"?><package format="3"><name>{name}</name></package>'


def arm(prefix: str = "", base: str = "base", joints: int = 3, xyz: str = "0 0 0.1", end: str = "wrist") -> str:
    """Joints that turn by turns about y and z, each with a bar of 0.2 m, from ``base``; the last bar is ``end``."""
    names = [base, *(f"{prefix}part{k}" for k in range(1, joints)), f"{prefix}{end}"]
    text = ""
    for k in range(joints):
        at, axis = (xyz if k == 0 else "0 0 0.22"), "0 0 1" if k % 2 else "0 1 0"
        text += link(names[k + 1], BAR)
        text += joint(f"{prefix}joint{k + 1}", f"revolute {names[k]} {names[k + 1]} -2 2", axis=axis, xyz=at)
    return text


def fixed(child: str, parent: str, xyz: str = "0 0 0.2") -> str:
    return link(child) + joint(f"{parent}_to_{child}", f"fixed {parent} {child}", xyz=xyz)


def fingers(
    prefix: str = "", palm: str = "wrist", *, axes: tuple[str, str] = ("1 0 0", "-1 0 0"), high: str = "0.04"
) -> str:
    """Two that slide ahead of a palm, and touch at zero."""
    return "".join(
        link(f"{prefix}{side}", FINGER)
        + joint(f"{prefix}{side}_joint", f"prismatic {palm} {prefix}{side} 0 {high}", axis=axis, xyz=f"{x} 0 0.22")
        for side, axis, x in (("left_finger", axes[0], 0.005), ("right_finger", axes[1], -0.005))
    )


BASE = link("base", solid("box", "0.1 0.1 0.1"))
PLAIN = urdf("r", BASE, arm())
XACRO_ARM = f"{BASE}{arm()}"
MACRO = macros(
    '<xacro:macro name="bar" params="name length:=0.2 *place">'
    '<link name="${name}"><collision><xacro:insert_block name="place"/>'
    '<geometry><box size="0.04 0.04 ${length}"/></geometry></collision></link></xacro:macro>'
)
JOINT = joint("j", "revolute base tip -1 1", axis="0 1 0", xyz="0 0 ${reach}")


@dataclass(frozen=True)
class Case:
    """Files, of which the first is loaded; how, and what it gives, or is refused or warned about with the step."""

    files: Mapping[str, str]
    given: Mapping[str, Any] = field(default_factory=dict)
    says: str = ""
    step: Mapping[str, Any] = field(default_factory=dict)
    joints: int = 3
    tool: str = ""
    gripper: tuple[str, ...] | None = None
    locked: Mapping[str, float] = field(default_factory=dict)
    packages: Mapping[str, str] = field(default_factory=dict)


def used(include: str, *more: str, start: str = "") -> str:
    """A xacro file that uses the macro of another one: a base, and a bar that a joint moves."""
    bars = "".join(
        f'<xacro:bar name="{name}" {size}><origin xyz="0 0 0.1"/></xacro:bar>'
        for name, size in (("base", ""), ("tip", 'length="${reach}"'))
    )
    return macros(start, f'<xacro:include filename="{include}"/>', bars, JOINT, *more)


REACH = '<xacro:property name="reach" value="0.3"/>'
KINDS = '<xacro:arg name="kind" default="small"/>'


def set_to(name: str, value: str) -> str:
    return f'<xacro:property name="{name}" value="{value}"/>'


BY_KIND = set_to("kind", "$(arg kind)") + set_to("reach", "${0.5 if kind == 'big' else 0.3}")
ASKS = set_to("k", "$(arg kind)") + set_to("reach", "${dict(big=0.5, small=0.3)[k]}")
ASKS += "<xacro:if value=\"${k not in ['big', 'small']}\"><link/></xacro:if>"
FROM_FILE = set_to("reach", "${xacro.load_yaml('$(find a)/config/$(arg size).yaml')['reach']}")
WEDGE = "v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nv 0 0 0.2\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
MESHED = PLAIN.replace(BAR, '<collision><geometry><mesh filename="package://AT"/></geometry></collision>')
OURS, THEIRS = "repo/a/urdf/arm.xacro", "repo/libs/b/urdf/bar.xacro"
BESIDE = {"repo/a/package.xml": package("a"), "repo/libs/b/package.xml": package("bars"), THEIRS: MACRO}
FOUND = {"a": "repo/a", "bars": "repo/libs/b"}
OUT = {
    "repo/a/package.xml": package("a"),
    "repo/.git/HEAD": "",
    "other/b/package.xml": package("bars"),
    "other/b/urdf/bar.xacro": MACRO,
}

XACRO = {
    "a sibling package in the repository": Case(
        {OURS: used("$(find bars)/urdf/bar.xacro", start=REACH), "repo/.git/HEAD": "", **BESIDE},
        joints=1,
        packages=FOUND,
    ),
    "a sibling package without a repository": Case(
        {
            "ws/a/arm.xacro": used("$(find bars)/bar.xacro", start=REACH),
            "ws/a/package.xml": package("a"),
            "ws/b/package.xml": package("bars"),
            "ws/b/bar.xacro": MACRO,
        },
        joints=1,
        packages={"bars": "ws/b"},
    ),
    "a package above the repository": Case(
        {OURS: used("$(find bars)/urdf/bar.xacro", start=REACH), **OUT},
        joints=1,
        packages={"bars": "other/b"},
        says=r"arm\.xacro, line 1: \$\(find bars\): no such package .* --package-dir \(package_dirs\)",
        step={"package_dirs": ["other"]},
    ),
    "an argument without a value": Case(
        {OURS: used("$(find bars)/urdf/bar.xacro", start="\n" + ASKS), "repo/.git/HEAD": "", **BESIDE},
        joints=1,
        packages=FOUND,
        says=r"arm\.xacro, line 2: the argument 'kind' has no value; .*--xacro-arg kind:=VALUE.* lists big, small",
        step={"xacro_args": {"kind": "big"}},
    ),
    "an argument that is declared without a default": Case(
        {
            "arm.xacro": used("bar.xacro", start=f'<!-- big or small -->\n<xacro:arg name="kind"/>{BY_KIND}'),
            "bar.xacro": MACRO,
        },
        joints=1,
        says=r"line 2: the argument 'kind' has no value; .*lists big; its comment says 'big or small'",
        step={"xacro_args": {"kind": "big"}},
    ),
    "an argument with another value than its default": Case(
        {"arm.xacro": used("bar.xacro", start=KINDS + BY_KIND), "bar.xacro": MACRO},
        joints=1,
        given={"xacro_args": {"kind": "big"}},
    ),
    "an argument that nothing has": Case(
        {"arm.xacro": used("bar.xacro", start=KINDS + BY_KIND), "bar.xacro": MACRO},
        joints=1,
        given={"xacro_args": {"kid": "big"}},
        says=r"it has no argument 'kid' \(xacro_args, --xacro-arg\); it has kind",
        step={"xacro_args": {"kind": "small"}},
    ),
    "values that are files": Case(
        {
            OURS: used(
                "$(find bars)/urdf/bar.xacro",
                start=FROM_FILE,
            ),
            "repo/a/config/r5.yaml": "reach: 0.25\n",
            "repo/a/config/r10.yaml": "reach: 0.35\n",
            "repo/.git/HEAD": "",
            **BESIDE,
        },
        joints=1,
        packages=FOUND,
        says="the argument 'size' has no value; .*the file lists r10, r5",
        step={"xacro_args": {"size": "r5"}},
    ),
    "an evaluation": Case(
        {
            "arm.xacro": used(
                "bar.xacro",
                start='<xacro:arg name="n" default="3"/><xacro:property name="reach" value="$(eval n * 0.1)"/>',
            ),
            "bar.xacro": MACRO,
        },
        joints=1,
    ),
    "an include that an argument names": Case(
        {
            "arm.xacro": used("$(arg file).xacro", start=REACH + '<xacro:arg name="file" default="bar"/>'),
            "bar.xacro": MACRO,
        },
        joints=1,
    ),
    "a package that only a plugin asks for": Case(
        {
            "arm.xacro": used(
                "bar.xacro",
                "<gazebo><plugin><parameters>$(find none)/c.yaml</parameters></plugin></gazebo>",
                start=REACH,
            ),
            "bar.xacro": MACRO,
        },
        joints=1,
        packages={"none": "."},
    ),
    "a folder beside, in no package": Case(
        {"cell/arms/arm.xacro": used("../parts/bar.xacro", start=REACH), "cell/parts/bar.xacro": MACRO},
        joints=1,
        says=r"parts/bar\.xacro lies outside the folders that may be read, to which --package-dir .* adds",
        step={"package_dirs": ["cell/parts"]},
    ),
    "an environment variable": Case(
        {"arm.xacro": used("bar.xacro", start=set_to("reach", "$(env REACH)")), "bar.xacro": MACRO},
        joints=1,
        says=r"line 1: environment variable 'REACH' is not set.* no environment variable is seen here; expand the file",
        step={"files": {"arm.xacro": used("bar.xacro", start=set_to("reach", "0.3"))}},
    ),
    "an environment variable with a default": Case(
        {"arm.xacro": used("bar.xacro", start=set_to("reach", "$(optenv REACH 0.3)")), "bar.xacro": MACRO}, joints=1
    ),
    "macros in a name space": Case(
        {
            "arm.xacro": macros(
                '<xacro:include filename="bar.xacro" ns="parts"/>',
                '<xacro:parts.bar name="base"><origin xyz="0 0 0.1"/></xacro:parts.bar>',
                '<xacro:parts.bar name="tip" length="0.2"><origin xyz="0 0 0.1"/></xacro:parts.bar>',
                REACH,
                JOINT,
            ),
            "bar.xacro": MACRO,
        },
        joints=1,
    ),
    "a mesh of a package whose name is misspelt": Case(
        {
            "repo/a/urdf/arm.urdf": MESHED.replace("AT", "barrs/meshes/bar.obj"),
            "repo/.git/HEAD": "",
            **BESIDE,
            "repo/libs/b/meshes/Bar.obj": WEDGE,
        },
        says="barrs/meshes/bar.obj' does not exist in .*; write package://bars/meshes/Bar.obj",
        step={"files": {"repo/a/urdf/arm.urdf": MESHED.replace("AT", "bars/meshes/Bar.obj")}},
    ),
    "a mesh of a sibling package": Case(
        {
            "repo/a/urdf/arm.urdf": MESHED.replace("AT", "bars/meshes/bar.obj"),
            "repo/.git/HEAD": "",
            **BESIDE,
            "repo/libs/b/meshes/bar.obj": WEDGE,
        }
    ),
}


MJCF_ARM = """<mujoco model="m"><compiler angle="radian"/>{head}<worldbody>
<body name="base"><geom type="box" size=".05 .05 .05"/>
<body name="upper" pos="0 0 .1"><joint name="shoulder" axis="0 1 0" range="-2 2"/>
<geom type="capsule" size=".02" fromto="0 0 .03 0 0 .2"/>
<body name="hand" pos="0 0 .25"><joint name="wrist" axis="0 1 0" range="-2 2"/><geom type="box" size=".05 .02 .02"/>
{hand}</body></body></body></worldbody>{tail}</mujoco>"""
PAD_GEOM = '<geom type="box" size=".005 .01 .03" pos="0 0 .03"/>'


def mjcf(hand: str = "", head: str = "", tail: str = "") -> str:
    return MJCF_ARM.format(hand=hand, head=head, tail=tail)


def slides(right: str = "-1 0 0", name: str = "range") -> str:
    return "".join(
        f'<body name="{side}" pos="0 0 .05"><joint name="{side}_finger" type="slide" axis="{axis}" {name}="0 .04"/>'
        f'<geom type="box" size=".005 .01 .03" pos="{x} 0 .03"/></body>'
        for side, axis, x in (("left", "1 0 0", 0.005), ("right", right, -0.005))
    )


HAND = f"""<mujoco model="hand"><worldbody><body name="palm"><geom type="box" size=".04 .03 .01"/>{slides()}
<site name="grasp" pos="0 0 .1"/></body></worldbody></mujoco>"""
ATTACHED = '<frame pos="0 0 .05" euler="0 0 1"><attach model="hand" body="palm" prefix="g_"/></frame>'
DRIVEN = "".join(
    f'<body name="{side}" pos="{x} 0 .02"><joint name="{side}_driver" axis="0 {turn} 0" range="0 .8"/>{PAD_GEOM}'
    f'<body name="{side}_pad" pos="0 0 .06"><joint name="{side}_coupler" axis="0 {turn} 0" range="-1 1"/>{PAD_GEOM}'
    "</body></body>"
    for side, x, turn in (("left", 0.04, 1), ("right", -0.04, -1))
)
CONNECT = '<equality><connect body1="left_pad" body2="right_pad" anchor="0 0 .04"/></equality>'
EQUAL = '<equality><joint joint1="left_finger" joint2="right_finger"/></equality>'
MJCF = {
    "a gripper whose fingers an equality couples": Case(
        {"m.xml": mjcf(slides(), tail=EQUAL)}, joints=2, gripper=("left_finger", "right_finger")
    ),
    "a site for the tool": Case(
        {"m.xml": mjcf('<site name="attachment_site" pos="0 0 .03"/><site name="tcp" pos="0 0 .1"/>')},
        joints=2,
        tool="tcp",
    ),
    "one jaw": Case(
        {
            "m.xml": mjcf(
                '<body name="jaw" pos=".04 0 .03"><joint name="jaw" axis="0 1 0" range="0 1"/>' + PAD_GEOM + "</body>"
                '<body name="pad" pos="-.04 0 .05"><geom type="box" size=".005 .01 .03" pos="0 0 .03"/></body>'
            )
        },
        joints=2,
        locked={"jaw": 0.0},
        says=r"fingers that are no gripper stand still \(jaw=0\): .*--gripper",
        step={"gripper": ["jaw"]},
        gripper=("jaw",),
    ),
    "a hand that is attached from another file": Case(
        {
            "m.xml": mjcf(ATTACHED, head='<asset><model name="hand" file="hand.xml"/></asset>'),
            "hand.xml": HAND,
        },
        joints=2,
        tool="g_grasp",
        gripper=("g_left_finger", "g_right_finger"),
    ),
    "degrees, Euler angles, a reference and defaults": Case(
        {
            "m.xml": mjcf('<site name="ee" pos="0 0 .1" euler="10 20 30"/>', head='<compiler eulerseq="zyx"/>')
            .replace('angle="radian"', 'angle="degree"')
            .replace('range="-2 2"', 'range="-90 90" ref="10" pos=".01 0 .02"')
        },
        joints=2,
        tool="ee",
    ),
    "fingers that a loop closes": Case(
        {"m.xml": mjcf(DRIVEN, tail=CONNECT)},
        joints=2,
        says="connect 'equality_0': a closed loop of bodies; expected a tree: take it out of <equality>",
        step={"files": {"m.xml": mjcf(DRIVEN)}},
    ),
    "a free base": Case(
        {"m.xml": mjcf().replace('<body name="base">', '<body name="base"><freejoint name="float"/>')},
        joints=2,
        says="joint 'float': type free; take it out",
        step={"files": {"m.xml": mjcf()}},
    ),
    "fingers that go the same way": Case(
        {"m.xml": mjcf(slides(right="1 0 0"))},
        joints=4,
        locked={"left_finger": 0.0, "right_finger": 0.0},
        says=r"stand still \(left_finger=0, right_finger=0\): .*--gripper none",
        step={"gripper": ()},
    ),
    "joints that an include brings": Case(
        {"m.xml": mjcf('<include file="hand.xml"/>'), "hand.xml": f"<mujocoinclude>{slides()}</mujocoinclude>"},
        joints=2,
        gripper=("left_finger", "right_finger"),
    ),
}

PROP = link("gripper_prop", solid("box", "0.01 0.01 0.01", "0 0 0.11")) + joint(
    "gripper", "continuous wrist gripper_prop", axis="0 0 1"
)
VIPER = (
    PROP
    + link("bar", PAD)
    + joint("bar_joint", "fixed wrist bar", xyz="0 0 0.21")
    + link("left_finger", FINGER)
    + joint("left_finger", "prismatic bar left_finger 0.021 0.057", axis="0 1 0", xyz="0 0 0.01")
    + link("right_finger", FINGER)
    + joint(
        "right_finger",
        "prismatic bar right_finger -0.057 -0.021",
        axis="0 1 0",
        xyz="0 0 0.01",
        more='<mimic joint="left_finger" multiplier="-1"/>',
    )
    + link("ee_gripper_link")
    + joint("ee", "fixed bar ee_gripper_link", xyz="0 0 0.05")
)
PIPER = (
    "".join(
        link(f"link{k}", FINGER)
        + joint(f"joint{k}", f"prismatic wrist link{k} {span}", axis=axis, xyz="0 0 0.22", rpy=f"1.5708 0 {turn}")
        for k, span, turn, axis in ((7, "0 0.035", "0", "0 0 1"), (8, "-0.035 0", "-3.1416", "0 0 -1"))
    )
    .replace('size="0.01 0.02 0.06"', 'size="0.02 0.06 0.01"')
    .replace('xyz="0 0 0.03" rpy', 'xyz="0 0.03 0.005" rpy')
)
LEG = arm("left_hip_", end="ankle", joints=5, xyz="0 0.3 0.1") + arm(
    "right_hip_", end="ankle", joints=5, xyz="0 -0.3 0.1"
)
ARMS = arm("left_", end="hand", xyz="0 0.4 0.1") + arm("right_", end="hand", xyz="0 -0.4 0.1")
THREE = "".join(
    link(f"finger_{k}", FINGER) + joint(f"finger_{k}", f"revolute wrist finger_{k} 0 1", axis=axis, xyz=f"{at} 0.21")
    for k, axis, at in ((1, "0 1 0", "0.03 0"), (2, "0 1 0", "-0.03 0"), (3, "1 0 0", "0 0.03"))
)


PADS = link("pad_l", FINGER) + link("pad_r", FINGER)
COUPLED = (
    PADS
    + joint("grip_l", "prismatic wrist pad_l 0 0.03", axis="1 0 0", xyz="0.005 0 0.22")
    + joint(
        "grip_r",
        "prismatic wrist pad_r 0 0.03",
        axis="1 0 0",
        xyz="-0.005 0 0.22",
        rpy="0 0 3.14159265359",
        more='<mimic joint="grip_l"/>',
    )
)
DRIVE = (
    link("motor")
    + joint("gripper_motor", "revolute wrist motor 0 3", xyz="0 0 0.21")
    + PADS
    + "".join(
        joint(
            f"grip_{side}",
            f"prismatic wrist pad_{side} 0 0.03",
            axis=f"{way} 0 0",
            xyz=f"{0.005 * way} 0 0.22",
            more='<mimic joint="gripper_motor" multiplier="0.01"/>',
        )
        for side, way in (("l", 1), ("r", -1))
    )
)


def jaw(wrist: str, kind: str = "revolute j_base fixed_jaw -3 3") -> str:
    """A hand that is called a jaw, turned by a joint, and the one jaw that moves on it."""
    moving = joint("j_jaw", "revolute fixed_jaw moving_jaw 0 1", axis="0 1 0", xyz="0.03 0 0")
    return (
        link("j_base")
        + joint("mount", "fixed wrist j_base", xyz="0 0 0.2")
        + (link("fixed_jaw", FINGER) + joint(wrist, kind) + link("moving_jaw", FINGER) + moving)
    )


CLAW = link("claw_base", PAD) + joint("j6", "revolute wrist claw_base -3 3", xyz="0 0 0.22")
CLAW += "".join(
    link(f"claw_{side}", FINGER)
    + joint(f"j{k}", f"revolute claw_base claw_{side} -0.2 0.6", axis=f"0 {turn} 0", xyz=f"{x} 0 0.02")
    for k, side, turn, x in ((7, "a", "1", "0.03"), (8, "b", "-1", "-0.03"))
)


def on_world(kind: str) -> str:
    ends = '<parent link="world"/><child link="base"/>'
    return f'<link name="world"/><joint name="free" type="{kind}">{ends}</joint></robot>'


URDF = {
    "an ankle is no tool": Case({"r.urdf": urdf("r", BASE, LEG, arm("arm_", end="hand"))}, joints=13, tool="arm_hand"),
    "two arms": Case(
        {"r.urdf": urdf("r", BASE, ARMS)},
        joints=6,
        tool="left_hand",
        says=r"2 arms, each with its tool \(left: left_hand, right: right_hand\); left_hand is .*; --tool-frame",
        step={"tool_frame": "right_hand"},
    ),
    "two arms with grippers": Case(
        {"r.urdf": urdf("r", BASE, ARMS, fingers("left_", "left_hand"), fingers("right_", "right_hand"))},
        joints=6,
        locked=dict.fromkeys(("left_left_finger_joint", "left_right_finger_joint"), 0.0),
        says=r"there are 2 grippers .*--gripper right_left_finger_joint,right_right_finger_joint",
        step={"gripper": ["right_left_finger_joint", "right_right_finger_joint"]},
        gripper=("right_left_finger_joint", "right_right_finger_joint"),
    ),
    "fingers beside the horn of a motor": Case(
        {"r.urdf": urdf("r", BASE, arm(), VIPER)}, tool="ee_gripper_link", gripper=("left_finger", "right_finger")
    ),
    "fingers of which one mimics the other in a turned frame": Case(
        {"r.urdf": urdf("r", BASE, arm(), COUPLED)}, gripper=("grip_l", "grip_r")
    ),
    "fingers that a motor drives": Case(
        {"r.urdf": urdf("r", BASE, arm(), DRIVE)},
        locked={"gripper_motor": 0.0},
        says=r"stand still \(gripper_motor=0\): some of its joints slide, and some turn; --gripper none",
    ),
    "a hand in an SRDF leaves the wrist to the arm": Case(
        {
            "r.urdf": urdf(
                "r", BASE, arm(), link("hand", PAD), joint("j4", "revolute wrist hand -2 2", xyz="0 0 0.22")
            ).replace("</robot>", f"{fingers(palm='hand').replace('0 0.22', '0 0.01')}</robot>"),
            "r.srdf": '<robot name="r"><group name="hand"><joint name="left_finger_joint"/>'
            '<joint name="right_finger_joint"/></group>'
            '<end_effector name="hand" group="hand" parent_link="hand"/></robot>',
        },
        joints=4,
        gripper=("left_finger_joint", "right_finger_joint"),
    ),
    "fingers whose frames are turned": Case({"r.urdf": urdf("r", BASE, arm(), PIPER)}, gripper=("joint7", "joint8")),
    "a name beats a longer chain": Case(
        {
            "r.urdf": urdf(
                "r",
                BASE,
                arm(),
                fixed("flange", "wrist"),
                fixed("tool0", "flange"),
                fixed("mount", "tool0"),
                fixed("camera_tool", "mount"),
            )
        },
        tool="tool0",
    ),
    "three fingers": Case(
        {"r.urdf": urdf("r", BASE, arm(), THREE)},
        joints=6,
        tool="wrist",
        locked={"finger_1": 0.0},
        says=r"stand still \(finger_1=0, finger_2=0, finger_3=0\): .*--gripper none",
        step={"gripper": ()},
    ),
    "a wrist that turns what is called a jaw": Case(
        {"r.urdf": urdf("r", BASE, arm(), jaw("wrist_roll"))},
        joints=4,
        tool="fixed_jaw",
        locked={"j_jaw": 0.0},
        says=r"stand still \(j_jaw=0\): .*--gripper j_jaw",
        step={"gripper": ["j_jaw"]},
        gripper=("j_jaw",),
    ),
    "a joint without a word that turns what is called a jaw": Case(
        {"r.urdf": urdf("r", BASE, arm(), jaw("j6"))},
        joints=4,
        tool="fixed_jaw",
        locked={"j_jaw": 0.0},
    ),
    "a joint that turns what is called a claw": Case(
        {"r.urdf": urdf("r", BASE, arm(), CLAW)}, joints=4, gripper=("j7", "j8")
    ),
    "a joint of range zero": Case(
        {
            "r.urdf": urdf(
                "r", BASE, arm(), link("tip", PAD), joint("stuck", "revolute wrist tip 0.3 0.3", xyz="0 0 0.22")
            )
        },
        locked={"stuck": 0.3},
    ),
    "a joint that the user locks": Case(
        {"r.urdf": PLAIN}, given={"locked_joints": {"joint2": 0.5}}, joints=2, locked={"joint2": 0.5}
    ),
    "a lock that the limits do not allow": Case(
        {"r.urdf": PLAIN},
        given={"locked_joints": {"joint2": 5}},
        joints=2,
        says=r"joint2.*5; expected a position in \[-2, 2\]",
        step={"locked_joints": {"joint2": 1}},
    ),
    "a floating base": Case(
        {
            "r.urdf": PLAIN.replace(
                "</robot>",
                on_world("floating"),
            )
        },
        says="joint 'free': type 'floating'; write type fixed",
        step={
            "files": {
                "r.urdf": PLAIN.replace(
                    "</robot>",
                    on_world("fixed"),
                )
            }
        },
    ),
    "a gripper that is none": Case(
        {"r.urdf": urdf("r", BASE, arm(), fingers())},
        given={"gripper": ["joint1", "joint2"]},
        joints=5,
        says=r"gripper: joint1, joint2 are no gripper: .*--gripper none",
        step={"gripper": ()},
    ),
}
CASES = XACRO | MJCF | URDF


def written(folder: Path, files: Mapping[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, "utf-8")
    return folder / next(iter(files))


def frames(robot: Robot, q: FloatArray) -> dict[str, FloatArray]:
    bodies = [body_matrix(pose) for pose in robot.body_poses(q)]
    return {frame.link: bodies[frame.body] @ frame.pose.matrix for frame in robot.link_frames}


def own_words(path: Path, arguments: Mapping[str, str], packages: Mapping[str, Path], patch: pytest.MonkeyPatch) -> str:
    """What xacro itself makes of a file."""
    patch.setattr(substitution_args, "_eval_find", lambda name: str(packages[name]))
    declared = path.read_text("utf-8").replace('<xacro:arg name="kind"/>', "")
    path.write_text(declared, "utf-8")
    return str(xacro.process_file(str(path), mappings=dict(arguments)).toxml())


def judged_by_pinocchio(robot: Robot, text: str, q: FloatArray) -> None:
    model = pinocchio.buildModelFromXML(text)
    values, data = pinocchio.neutral(model), model.createData()
    known = dict(zip(robot.joint_names, q.tolist(), strict=True)) | dict(robot.locked_joints)
    for name, value in known.items():
        of = model.joints[model.getJointId(name)]
        values[of.idx_q : of.idx_q + of.nq] = [value] if of.nq == 1 else [np.cos(value), np.sin(value)]
    pinocchio.framesForwardKinematics(model, data, values)
    for name, T in frames(robot, q).items():
        frame = data.oMf[model.getFrameId(name, pinocchio.FrameType.BODY)]
        assert np.allclose(frame.homogeneous, T, atol=1e-9), name


def judged_by_mujoco(robot: Robot, path: Path, q: FloatArray) -> None:
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    known = dict(zip(robot.joint_names, q.tolist(), strict=True)) | dict(robot.locked_joints)
    for name, value in known.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    for name, T in frames(robot, q).items():
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0:
            assert np.allclose(data.body(name).xpos, T[:3, 3], atol=1e-9), name
            assert np.allclose(data.body(name).xmat.reshape(3, 3), T[:3, :3], atol=1e-9), name


@pytest.mark.parametrize("name", CASES)
def test_a_published_file_is_read_rightly_or_the_step_that_its_message_names_helps(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = CASES[name]
    monkeypatch.chdir(tmp_path)
    path, given, robot = written(tmp_path, case.files), dict(case.given), None
    with caplog.at_level(logging.WARNING):
        try:
            robot = load_robot(path, **given)
        except InvalidRequest as error:
            said = str(error)
        else:
            said = " ".join(record.getMessage() for record in caplog.records)
    assert (not case.says) or re.search(case.says, said, re.DOTALL), said
    if robot is not None:
        assert case.locked.items() <= dict(robot.locked_joints).items()
        assert case.tool in ("", robot.tool_frame)
    if case.step:
        if "files" in case.step:
            written(tmp_path, case.step["files"])
        given |= {key: value for key, value in case.step.items() if key != "files"}
        robot = load_robot(path, **given)
    assert robot is not None, said
    assert robot.n == case.joints
    assert case.gripper in (None, robot.gripper and robot.gripper.joints)
    assert given.get("tool_frame", robot.tool_frame) == robot.tool_frame
    low, high = robot.bounds
    q = np.random.default_rng(1).uniform(np.maximum(low, -3.0), np.minimum(high, 3.0))
    if path.suffix == ".xml":
        judged_by_mujoco(robot, path, q)
    else:
        known = {key: tmp_path / place for key, place in case.packages.items()}
        text = own_words(path, given.get("xacro_args", {}), known, monkeypatch) if name in XACRO else path.read_text()
        judged_by_pinocchio(robot, text, q)
    assert check_robot(path, **given).ok


def test_there_are_thirty() -> None:
    assert len(CASES) >= 30
