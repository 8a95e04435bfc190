"""Robots at places as one robot, for the independent checker: their descriptions as one URDF."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import planner_service as ps
from auditor.checker import robot_table
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import rpy_of

__all__ = ["table_of_arms"]

ROOT = "cell"


def table_of_arms(arms: Mapping[str, tuple[str, ps.Pose]], place: Path) -> dict[str, Any]:
    """What the independent checker needs of robots at places, under the names that a ``Cell`` gives their parts.

    Args:
        arms: By the names of the arms, the name of a robot and where its base stands.
        place: A folder for the URDF.
    """
    whole = ElementTree.Element("robot", name="cell")
    ElementTree.SubElement(whole, "link", name=ROOT)
    out: dict[str, Any] = {"package_dirs": [], "joints": [], "locked_joints": {}, "allowed_contacts": []}
    position: dict[str, list[float]] = {"lower": [], "upper": []}
    speeds, fingers, closed = list[float](), list[str](), list[float]()
    for name, (robot, base) in arms.items():
        table = robot_table(data_folder("robots") / robot)
        _add(whole, ElementTree.parse(table["urdf"]).getroot(), name, base)
        out["package_dirs"] += table["package_dirs"]
        out["joints"] += [f"{name}_{joint}" for joint in table["joints"]]
        out["locked_joints"] |= {f"{name}_{joint}": q for joint, q in table.get("locked_joints", {}).items()}
        out["allowed_contacts"] += [
            {"links": [f"{name}_{link}" for link in contact["links"]]} for contact in table.get("allowed_contacts", ())
        ]
        for end, values in position.items():
            values += table["limits"]["position"][end]
        speeds += table["limits"]["velocity"]["values"]
        gripper = table.get("gripper", {})
        fingers += [f"{name}_{joint}" for joint in gripper.get("joints", ())]
        closed += gripper.get("closed_at", [0.0] * len(gripper.get("joints", ())))
        out["gripper"] = {**gripper, "joints": fingers, "closed_at": closed}
        out.setdefault("tool_frame", f"{name}_{table['tool_frame']}")
    out["limits"] = {"position": position, "velocity": {"values": speeds}}
    out["urdf"] = place / "cell.urdf"
    ElementTree.ElementTree(whole).write(out["urdf"], encoding="unicode")
    return out


def _add(whole: ElementTree.Element, robot: ElementTree.Element, name: str, base: ps.Pose) -> None:
    """A robot's links and joints under their names in the cell, its root fixed at a place."""
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    root = next(link.get("name") for link in robot.findall("link") if link.get("name") not in children)
    for tag in ("link", "joint"):
        for item in robot.findall(tag):
            part = copy.deepcopy(item)
            part.set("name", f"{name}_{part.get('name')}")
            for ref, key in (("parent", "link"), ("child", "link"), ("mimic", "joint")):
                for other in part.findall(ref):
                    other.set(key, f"{name}_{other.get(key)}")
            for visual in part.findall("visual"):
                part.remove(visual)
            whole.append(part)
    fixed = ElementTree.SubElement(whole, "joint", name=f"{name}_base", type="fixed")
    ElementTree.SubElement(fixed, "parent", link=ROOT)
    ElementTree.SubElement(fixed, "child", link=f"{name}_{root}")
    xyz, rpy = (" ".join(map(repr, values)) for values in (base.position, rpy_of(base.rotation)))
    ElementTree.SubElement(fixed, "origin", xyz=xyz, rpy=rpy)
