"""Random robots and scenes as plain values, what the package makes of them, and what the independent checker does."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from benchmarks.attack.domain import JOINTS, LENGTHS, OBSTACLES, ROBOTS
from planner_service.files.package_data import data_folder
from planner_service.geometry import Shape
from planner_service.geometry.arrays import FloatArray

__all__ = ["World", "draw_obstacle", "draw_robot", "draw_scene", "draw_world", "scene_of", "written"]

Plain = dict[str, Any]


def _size(rng: np.random.Generator) -> float:
    low, high = LENGTHS
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _shape(rng: np.random.Generator, kinds: Sequence[str]) -> Plain:
    kind = str(rng.choice(kinds))
    if kind == "box":
        return {"box": [_size(rng) for _ in range(3)]}
    if kind == "sphere":
        return {"sphere": _size(rng) / 2.0}
    if kind in ("cylinder", "capsule"):
        return {kind: [_size(rng) / 2.0, _size(rng)]}
    points = rng.normal(size=(int(rng.choice([4, 5, 8, 20, 60])), 3))
    points *= np.array([_size(rng) for _ in range(3)]) / 2.0 / np.linalg.norm(points, axis=1, keepdims=True)
    return {"mesh": points.tolist()}


def _direction(rng: np.random.Generator, count: int) -> list[float]:
    way = rng.normal(size=count)
    return [float(v) for v in way / np.linalg.norm(way)]


def draw_robot(rng: np.random.Generator) -> Plain:
    """A tree of links, or now and then a robot that comes with the package."""
    if rng.random() < 0.35:
        return {"name": str(rng.choice(ROBOTS))}
    kinds = ("box", "cylinder", "sphere", "mesh")
    links: list[Plain] = [{"name": "l0", "shapes": [_placed(rng, kinds, 0.05)]}]
    joints: list[Plain] = []
    moving, wanted = 0, int(rng.integers(JOINTS[0], JOINTS[1] + 1))
    while moving < wanted:
        number = len(links)
        parent = number - 1 if rng.random() > 0.2 else int(rng.integers(number))
        kind = str(rng.choice(("revolute", "revolute", "continuous", "prismatic", "fixed")))
        moving += kind != "fixed"
        low, high = sorted(rng.uniform(-3.0, 3.0, 2) if kind == "revolute" else rng.uniform(-0.4, 0.4, 2))
        axis = np.eye(3)[rng.integers(3)].tolist() if rng.random() < 0.5 else _direction(rng, 3)
        joint = {"name": f"j{number}", "kind": kind, "parent": f"l{parent}", "child": f"l{number}", "axis": axis}
        joint |= {"xyz": rng.uniform(-0.3, 0.3, 3).tolist(), "rpy": rng.uniform(-3.0, 3.0, 3).tolist()}
        joints.append(joint | {"range": [float(low), float(high) + 0.1]})
        shapes = [_placed(rng, kinds, 0.05) for _ in range(int(rng.integers(0, 3)))]
        links.append({"name": f"l{number}", "shapes": shapes})
    return {"links": links, "joints": joints}


def _placed(rng: np.random.Generator, kinds: Sequence[str], away: float) -> Plain:
    turned = rng.uniform(-3.0, 3.0, 3) if rng.random() < 0.7 else np.zeros(3)
    return _shape(rng, kinds) | {"xyz": rng.uniform(-away, away, 3).tolist(), "rpy": turned.tolist()}


def draw_obstacle(rng: np.random.Generator, reach: float, name: str) -> Plain:
    """A solid somewhere around a robot."""
    shape = _shape(rng, ("box", "cylinder", "sphere", "capsule", "mesh"))
    return shape | {"name": name, "xyz": rng.uniform(-reach, reach, 3).tolist(), "quaternion": _direction(rng, 4)}


def draw_scene(rng: np.random.Generator, reach: float, most: int = OBSTACLES) -> list[Plain]:
    """Obstacles around a robot."""
    return [draw_obstacle(rng, reach, f"o{k}") for k in range(int(rng.integers(0, most + 1)))]


def draw_world(rng: np.random.Generator, most: int = OBSTACLES) -> Plain:
    """A robot and a scene."""
    return {"robot": draw_robot(rng), "obstacles": draw_scene(rng, float(rng.uniform(0.3, 1.0)), most)}


def _words(values: Sequence[float]) -> str:
    return " ".join(repr(float(v)) for v in values)


def written(robot: Plain, folder: Path) -> Path:
    """The URDF of a drawn robot and its meshes, in a folder."""
    lines, meshes = ['<robot name="drawn">'], 0
    for link in robot["links"]:
        lines.append(f'<link name="{link["name"]}">')
        for shape in link["shapes"]:
            if "mesh" in shape:
                points, file = shape["mesh"], folder / f"m{meshes}.obj"
                faces = [f"f {a + 1} {a + 2} {a + 3}" for a in range(len(points) - 2)]
                file.write_text("\n".join([f"v {_words(p)}" for p in points] + faces) + "\n")
                inner, meshes = f'<mesh filename="{file.name}"/>', meshes + 1
            elif "box" in shape:
                inner = f'<box size="{_words(shape["box"])}"/>'
            elif "sphere" in shape:
                inner = f'<sphere radius="{shape["sphere"]!r}"/>'
            else:
                inner = f'<cylinder radius="{shape["cylinder"][0]!r}" length="{shape["cylinder"][1]!r}"/>'
            at = f'<origin xyz="{_words(shape["xyz"])}" rpy="{_words(shape["rpy"])}"/>'
            lines.append(f"<collision>{at}<geometry>{inner}</geometry></collision>")
        lines.append("</link>")
    for joint in robot["joints"]:
        low, high = joint["range"]
        limit = '<limit velocity="2" effort="1"/>'
        if joint["kind"] != "continuous":
            limit = f'<limit lower="{low!r}" upper="{high!r}" velocity="2" effort="1"/>'
        lines += [
            f'<joint name="{joint["name"]}" type="{joint["kind"]}"><parent link="{joint["parent"]}"/>',
            f'<child link="{joint["child"]}"/><origin xyz="{_words(joint["xyz"])}" rpy="{_words(joint["rpy"])}"/>',
            f'<axis xyz="{_words(joint["axis"])}"/>{"" if joint["kind"] == "fixed" else limit}</joint>',
        ]
    path = folder / "drawn.urdf"
    path.write_text("\n".join([*lines, "</robot>"]) + "\n")
    return path


def _solid(shape: Plain) -> Shape:
    if "box" in shape:
        return ps.Box(tuple(shape["box"]))
    if "sphere" in shape:
        return ps.Sphere(shape["sphere"])
    if "mesh" in shape:
        return ps.Mesh(np.array(shape["mesh"]))
    kind = ps.Cylinder if "cylinder" in shape else ps.Capsule
    return kind(*next(shape[key] for key in ("cylinder", "capsule") if key in shape))


class World:
    """A drawn robot and scene as the package takes them.

    Attributes:
        contacts: Pairs that the robot allows, beside those of its file.
    """

    def __init__(self, plain: Plain, folder: Path) -> None:
        drawn = plain["robot"]
        if "name" in drawn:
            self.robot: ps.Robot = ps.load_robot(drawn["name"])
            self._table: Any = data_folder("robots") / drawn["name"]
        else:
            urdf = written(drawn, folder)
            self.robot = ps.Robot.from_urdf(urdf)
            allowed = [{"links": list(contact.links)} for contact in self.robot.allowed_contacts]
            limits = {"lower": self.robot.limits.lower, "upper": self.robot.limits.upper}
            velocity = {"values": self.robot.limits.velocity}
            self._table = {"urdf": urdf, "package_dirs": [folder], "joints": list(self.robot.joint_names)}
            self._table |= {"tool_frame": self.robot.tool_frame, "allowed_contacts": allowed}
            self._table |= {"limits": {"position": limits, "velocity": velocity}}
        self.scene = scene_of(plain["obstacles"])

    def moved(self, name: str, position: FloatArray) -> World:
        """The same with one obstacle elsewhere."""
        out = copy.copy(self)
        pose = ps.Pose(tuple(position.tolist()), self.scene.obstacle(name).pose.quaternion)
        out.scene = self.scene.moved(name, pose)
        return out

    def independent(self, scene: ps.Scene | None = None) -> IndependentChecker:
        """The judge that shares no code with the package."""
        return IndependentChecker(self._table, tables_of(self.scene if scene is None else scene))


def scene_of(obstacles: Sequence[Plain]) -> ps.Scene:
    """Drawn obstacles as a scene."""
    return ps.Scene(
        tuple(ps.Obstacle(o["name"], _solid(o), ps.Pose(tuple(o["xyz"]), tuple(o["quaternion"]))) for o in obstacles)
    )
