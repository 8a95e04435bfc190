"""Arms of any number of joints in a plane."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

__all__ = ["MOST_JOINTS", "planar_robot"]

MOST_JOINTS = 30

REACH = 1.5
"""Metres of a planar arm from its base to its tip, however many links it has: that of the textbooks' two-link arm."""


@cache
def _folder() -> TemporaryDirectory[str]:
    """Where planar arms are written; gone when the process ends."""
    return TemporaryDirectory(prefix="planar-arms-")


@cache
def planar_robot(joints: int) -> str:
    """The path of the robot.toml of an arm in the plane z = 0: links of equal length that may pass over one another."""
    folder = Path(_folder().name) / str(joints)
    folder.mkdir()
    length, names = REACH / joints, [f"joint_{k}" for k in range(joints)]
    links = ['<link name="base"/>', '<link name="tip"/>', _joint("tip_joint", "fixed", (joints - 1, length), "tip")]
    for k in range(joints):
        links.append(_link(k, length))
        links.append(_joint(names[k], "revolute", (k - 1, length if k else 0.0), f"link_{k}"))
    (folder / "planar.urdf").write_text(f'<robot name="planar{joints}">{"".join(links)}</robot>\n', "utf-8")
    pairs = [(f"link_{i}", f"link_{k}") for k in range(joints) for i in range(k)]
    contacts = "".join(f'[[allowed_contacts]]\nlinks = ["{a}", "{b}"]\nreason = "in a plane"\n' for a, b in pairs)
    file = folder / "robot.toml"
    file.write_text(
        f'name = "planar{joints}"\nurdf = "planar.urdf"\njoints = {names!r}\ntool_frame = "tip"\n'
        f'base_links = ["base"]\n[poses]\nhome = {[0.0] * joints}\n{_limits(joints)}{contacts}',
        "utf-8",
    )
    return str(file)


def _link(k: int, length: float) -> str:
    shape = f'<geometry><cylinder radius="0.01" length="{length!r}"/></geometry>'
    origin = f'<origin xyz="{length / 2!r} 0 0" rpy="0 {math.pi / 2!r} 0"/>'
    return f'<link name="link_{k}"><collision>{origin}{shape}</collision></link>'


def _joint(name: str, kind: str, after: tuple[int, float], child: str) -> str:
    parent = "base" if after[0] < 0 else f"link_{after[0]}"
    limits = f'<axis xyz="0 0 1"/><limit lower="{-math.pi!r}" upper="{math.pi!r}" velocity="1" effort="1"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{after[1]!r} 0 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{limits if kind == "revolute" else ""}</joint>'


def _limits(joints: int) -> str:
    kinds = {"velocity": 1.0, "acceleration": 2.0, "jerk": 50.0}
    tables = [f"[limits.position]\nlower = {[-math.pi] * joints}\nupper = {[math.pi] * joints}\nsource = 'as planar2'"]
    tables += [f"[limits.{kind}]\nvalues = {[value] * joints}\nsource = 'as planar2'" for kind, value in kinds.items()]
    return "\n".join(tables) + "\n"
