"""Small robots as URDF texts: arms that slide, turn about oblique axes, branch and follow one another."""

from __future__ import annotations

from pathlib import Path

from planner_service.robot.model import Robot

__all__ = ["CRANE", "MIMIC", "MIXED", "SLIDER", "TWINS", "built", "joint", "link", "solid", "urdf"]


def solid(kind: str, sizes: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    """A collision shape, its sizes as attributes or, of a box, the three lengths."""
    given = f'size="{sizes}"' if kind == "box" else sizes
    return f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry><{kind} {given}/></geometry></collision>'


def link(name: str, *solids: str) -> str:
    """A link of these shapes."""
    return f'<link name="{name}">{"".join(solids)}</link>\n'


def joint(name: str, parts: str, *, axis: str = "0 0 1", xyz: str = "0 0 0", rpy: str = "0 0 0", more: str = "") -> str:
    """A joint of ``parts``: its kind, parent and child, and its lower and upper limit if it has any."""
    kind, parent, child, *limits = parts.split()
    limit = f'<limit lower="{limits[0]}" upper="{limits[1]}" velocity="1" effort="1"/>' if limits else ""
    where = f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{where}{limit}{more}</joint>\n'


def urdf(name: str, *parts: str) -> str:
    """A robot of links and joints."""
    return f'<robot name="{name}">\n{"".join(parts)}</robot>\n'


def built(folder: Path, text: str) -> Robot:
    """The robot of a URDF text."""
    path = folder / "robot.urdf"
    path.write_text(text, "utf-8")
    return Robot.from_urdf(path)


SLIDER = urdf(
    "slider",
    link("rail") + link("cart", solid("box", "0.1 0.2 0.2")) + link("boom", solid("box", "0.3 0.02 0.02", "0.2 0 0")),
    joint("slide", "prismatic rail cart -1 1", axis="1 0 0", xyz="0 0 0.5", rpy="0 0 0.3"),
    joint("swing", "revolute cart boom -2 2", axis="0 0.6 0.8", xyz="0 0 0.3"),
)
"""A cart that slides along a rail, with a boom that swings about an oblique axis above it."""

TWINS = urdf(
    "twins",
    link("base") + link("torso", solid("cylinder", 'radius="0.05" length="0.4"')),
    *(link(side, solid("box", "0.5 0.04 0.04", "0.25 0 0")) for side in ("left", "right")),
    joint("waist", "revolute base torso -3 3"),
    joint("left_shoulder", "revolute torso left -3 3", xyz="0 0.2 0.3"),
    joint("right_shoulder", "revolute torso right -3 3", xyz="0 -0.2 0.3"),
)
"""Two arms on one torso, in one plane: turned inwards alike they cross."""

CRANE = urdf(
    "crane",
    link("base") + link("turret") + link("trolley", solid("sphere", 'radius="0.05"')),
    joint("turn", "revolute base turret -3 3"),
    joint("run", "prismatic turret trolley 0 2", axis="1 0 0", xyz="0.1 0 0"),
)
"""A trolley that runs out along an arm that turns: how far it is from the axis is the sliding joint's to say."""

QUARTER = "1.5707963267948966"
MIMIC = '<mimic joint="branch" multiplier="-1" offset="0.1"/>'

MIXED = urdf(
    "mixed",
    link("world") + link("stand", solid("box", "0.2 0.2 0.1")) + link("a", solid("box", "0.1 0.05 0.4", "0.1 0 0.2")),
    link("b", solid("sphere", 'radius="0.1"')),
    link("b_cap", solid("cylinder", 'radius="0.05" length="0.2"', rpy="0.3 0.2 0.1")),
    link("c", solid("box", "0.1 0.1 0.1")) + link("tip") + link("side", solid("box", "0.3 0.1 0.1")),
    joint("fix", "fixed world stand", xyz="0 0 0.5"),
    joint("z_turn", "continuous stand a", axis="0 0 -1", xyz="0.1 0.2 0.3", rpy="0.4 -0.3 0.2"),
    joint("oblique", "revolute a b 0.5 2.5", axis="1 2 -3", xyz="0 0.1 0.4"),
    joint("cap", "fixed b b_cap", xyz="0 0.2 0.1", rpy=f"{QUARTER} 0 0"),
    joint("slide", "prismatic b_cap c -0.1 0.3", axis="1 1 0", xyz="0.1 0 0", rpy="0 0.7 0"),
    joint("x_turn", "revolute c tip -2 2", axis="1 0 0", xyz="0 0 0.1", rpy=f"0 {QUARTER} 0"),
    joint("branch", "revolute a side -1 1", axis="0 1 0", xyz="0 -0.2 0.3"),
    joint("spare", "revolute side spare_link -1 1", axis="0 1 0", more=MIMIC),
    link("spare_link", solid("sphere", 'radius="0.02"')),
)
"""Every kind of joint and placement: oblique axes, turned origins, sliding joints, a branch, a continuous joint."""
