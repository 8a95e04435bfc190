"""An arm whose links are meshes, and meshes for it to meet: none symmetric, few of them where their frame is."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auditor.checker import IndependentChecker, tables_of
from planner_service.collision import CollisionChecker
from planner_service.collision.edge_sampling import EdgeStep
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.robot.model import Robot
from planner_service.scene.scene import Attached, Obstacle, Scene
from tests.support.small_robots import joint, link, solid, urdf

__all__ = ["DRUM", "HELD", "NEEDLE", "OBSTACLES", "RAMP", "ROCK", "SPOON", "HullSetup", "binary_stl", "write_arm"]


def _mesh(file: str, scale: str = "1 1 1", **place: str) -> str:
    return solid("mesh", f'filename="{file}" scale="{scale}"', **place)


URDF = urdf(
    "hull arm",
    link("base", _mesh("package://arm/base.stl")) + link("column", _mesh("meshes/column.stl")),
    link("upper", _mesh("package://arm/upper.stl", "0.001 0.001 0.001", xyz="-5 0 0")),
    link("fore", _mesh("meshes/fore.stl", "-0.001 0.002 0.001", xyz="0 0.01 0", rpy="0.3 0.1 -0.2")),
    link("hand", _mesh("meshes/hand.stl"), solid("box", "0.06 0.02 0.01", "0.09 0 0.03")) + link("tool"),
    joint("one", "revolute base column -2.8 2.8", xyz="0 0 0.1"),
    joint("two", "revolute column upper -2.4 1.6", axis="0 1 0", xyz="0.02 0 0.2"),
    joint("three", "revolute upper fore -2.6 2.6", axis="0 1 0", xyz="0.3 0 0"),
    joint("four", "revolute fore hand -3 3", axis="1 0 0", xyz="0.25 0 0"),
    joint("grip", "fixed hand tool", xyz="0.1 0 0"),
)

JOINTS = ["one", "two", "three", "four"]
ADJACENT = (("base", "column"), ("column", "upper"), ("upper", "fore"), ("fore", "hand"))


def binary_stl(points: FloatArray) -> bytes:
    """Every point as a corner of some triangle; which triangles there are is nobody's business here."""
    rows = np.asarray(points, dtype="<f4")
    facets = np.zeros(len(rows), np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("rest", "<u2")]))
    for k in range(3):
        facets["v"][:, k] = np.roll(rows, k, axis=0)
    return bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes()


def text_stl(points: FloatArray) -> bytes:
    """The same as a text, of numbers that 32 bits hold."""
    rows = np.asarray(points, dtype=np.float32).astype(np.float64)
    lines = ["solid part"]
    for corners in zip(
        rows.tolist(), np.roll(rows, 1, axis=0).tolist(), np.roll(rows, 2, axis=0).tolist(), strict=True
    ):
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part", ""]).encode()


def ring(count: int, radius: float, x: float, y: float = 0.0, z: float = 0.0) -> FloatArray:
    """Corners of a polygon about the x axis."""
    angles = [2.0 * math.pi * k / count for k in range(count)]
    return np.array([[x, y + radius * math.cos(a), z + radius * math.sin(a)] for a in angles])


def lump(seed: int, count: int, size: tuple[float, float, float], centre: tuple[float, float, float]) -> FloatArray:
    """Points whose hull has no symmetry."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    points /= np.sqrt((points * points).sum(axis=1))[:, None]
    points[:, 0] += 0.4 * points[:, 1] ** 2
    return np.asarray(points * size + centre)


def _meshes() -> dict[str, FloatArray]:
    column = np.concatenate([ring(40, 0.06, 0.0)[:, [1, 2, 0]], ring(40, 0.045, 0.21, 0.01)[:, [1, 2, 0]]])
    upper = np.concatenate([ring(32, 50.0, 5000.0, 0.0, 10.0), ring(24, 35.0, 5310.0, 20.0), [[5340.0, 0.0, 0.0]]])
    grid = np.array([[x, y, z] for x in (-30.0, 60.0, 150.0) for y in (-15.0, 0.0, 15.0) for z in (-30.0, 20.0)])
    fore = np.concatenate([grid * [-1.0, 1.0, 1.0], [[-230.0, 5.0, 10.0], [-100.0, 0.0, 55.0]]])
    hand = np.concatenate([[[0.0, y, z] for y in (-0.04, 0.04) for z in (-0.03, 0.03)], ring(20, 0.02, 0.07)])
    base = np.array([[x, y, z] for x in (-0.1, 0.08) for y in (-0.1, 0.1) for z in (0.0, 0.08)])
    return {"base": base, "column": column, "upper": upper, "fore": fore, "hand": np.asarray(hand)}


def write_arm(folder: Path) -> Path:
    """The arm's URDF, its meshes in ``folder/robot/meshes`` and, as a package, in ``folder/packages/arm``."""
    for name in ("robot/meshes", "packages/arm"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for k, (name, points) in enumerate(_meshes().items()):
        own = f"meshes/{name}.stl" in URDF
        path = folder / ("robot/meshes" if own else "packages/arm") / f"{name}.stl"
        path.write_bytes((text_stl if k % 2 else binary_stl)(points))
    path = folder / "robot" / "arm.urdf"
    path.write_text(URDF)
    return path


ROCK = Mesh(lump(1, 70, (0.12, 0.08, 0.1), (0.03, 0.0, 0.02)))
RAMP = Mesh(np.array([[3.0, -2.0, 1.0], [3.3, -2.0, 1.0], [3.0, -1.7, 1.0], [3.3, -1.7, 1.0], [3.3, -2.0, 1.2]]))
DRUM = Mesh(np.concatenate([ring(48, 0.07, -0.1), ring(48, 0.05, 0.15, 0.02)]))
SPOON = Mesh(np.concatenate([ring(36, 0.03, 0.12, 0.02), ring(8, 0.006, -0.02)]))

OBSTACLES = (
    Obstacle("rock", ROCK, Pose.from_rpy((0.35, 0.2, 0.15), (0.4, 0.2, 1.0))),
    Obstacle("ramp", RAMP, Pose((-3.4, 1.7, -0.9))),
    Obstacle("drum", DRUM, Pose.from_rpy((0.1, -0.4, 0.4), (0.2, 1.0, 0.3))),
    Obstacle("shelf", Box((0.4, 0.3, 0.02)), Pose((-0.3, -0.2, 0.6))),
    Obstacle("pole", Cylinder(0.02, 0.8), Pose((0.3, -0.3, 0.4))),
    Obstacle("ball", Sphere(0.06), Pose((0.2, 0.1, 0.75))),
    Obstacle("bar", Capsule(0.02, 0.4), Pose.from_rpy((-0.2, 0.3, 0.6), (1.2, 0.3, 0.0))),
)
HELD = Attached("spoon", SPOON, Pose.from_rpy((0.02, 0.0, 0.01), (0.0, 0.4, 0.2)), ("hand",))
NEEDLE = Attached(
    "needle",
    Mesh(np.array([[x, y, z] for x in (0.0, 0.3) for y in (-0.001, 0.002) for z in (-0.002, 0.001)])),
    Pose((0.0, 0.0, 0.02)),
    ("hand",),
)
"""Thin, and it begins at its frame."""


@dataclass(frozen=True, eq=False)
class HullSetup:
    """The arm in a scene, and how it is to be judged; ``folder`` has its files."""

    name: str
    folder: Path
    obstacles: tuple[Obstacle, ...] = OBSTACLES
    attached: tuple[Attached, ...] = ()

    def robot(self) -> Robot:
        return Robot.from_urdf(self.folder / "robot" / "arm.urdf", "tool", package_dirs=[self.folder / "packages"])

    def whole_scene(self) -> Scene:
        return Scene(self.obstacles, self.attached)

    def checker(self, step: EdgeStep | None = None) -> CollisionChecker:
        return CollisionChecker(self.robot(), self.whole_scene(), edge_step=step)

    def independent(self) -> IndependentChecker:
        robot: dict[str, Any] = {
            "urdf": str(self.folder / "robot" / "arm.urdf"),
            "package_dirs": [self.folder / "packages", self.folder / "robot"],
            "tool_frame": "tool",
            "joints": JOINTS,
            "allowed_contacts": [{"links": list(pair)} for pair in ADJACENT],
        }
        return IndependentChecker(robot, tables_of(self.whole_scene()))
