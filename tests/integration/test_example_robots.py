"""The robots whose files other packages bring along: they load by name, and are what Coal takes them for."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, MissingDependency
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh_formats import read_vertices
from planner_service.geometry.shapes import Box, Cylinder, Pose
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import Stage
from planner_service.robot.model import Robot
from planner_service.robot.package_files import package_folder
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService

if sys.version_info >= (3, 11):
    pass
else:
    pass

NAMES = ("panda", "ur5", "xarm7", "kinova", "ur5_vacuum", "xarm7_vacuum", "kinova_gripper")
TABLE = Obstacle("table", Box((2.4, 2.4, 0.1)), Pose((0.0, 0.0, -0.051)))
CELL = Scene(obstacles=(TABLE, Obstacle("box", Box((0.15, 0.3, 0.3)), Pose((0.5, 0.15, 0.15)))))
CONTACT = 1e-6
"""Metres from contact within which two judges may differ."""
COVER = 1e-4
"""Metres by which a mesh may stick out of the shapes that cover it; their sizes have this resolution."""


@pytest.fixture(scope="module")
def robots() -> dict[str, Robot]:
    return {name: load_robot(name) for name in NAMES}


@pytest.fixture(scope="module")
def second() -> dict[str, IndependentChecker]:
    return {name: IndependentChecker(data_folder("robots") / name, tables_of(CELL)) for name in NAMES}


def samples(robot: Robot, count: int) -> FloatArray:
    low, high = robot.limits.lower, robot.limits.upper
    return low + (high - low) * np.random.default_rng(3).random((count, robot.n))


def near_contact(checker: CollisionChecker, Q: FloatArray) -> list[FloatArray]:
    """What 30 bisections between free and colliding configurations look at: centimetres to nanometres of contact."""
    free = [checker.state_is_free(q) for q in Q]
    found = []
    for inside, outside in zip(Q[np.flatnonzero(free)], Q[np.flatnonzero(~np.array(free))], strict=False):
        a, b = inside, outside
        for _ in range(30):
            middle = 0.5 * (a + b)
            a, b = (middle, b) if checker.state_is_free(middle) else (a, middle)
            found.append(middle)
    return found


@pytest.mark.parametrize("name", ["panda", "kinova_gripper"])
def test_plans_from_home_are_certified_and_free_for_the_independent_checker(
    robots: dict[str, Robot], second: dict[str, IndependentChecker], name: str
) -> None:
    robot = robots[name]
    service = PlannerService(robot, CELL)
    goals = [q for q in samples(robot, 40) if service.checker.state_is_free(q)][:2]
    for seed, goal in enumerate(goals):
        result = service.plan(PlanRequest(robot.home, goal, seed=seed, time_limit=None))
        assert Stage.CERTIFY in [report.stage for report in result.stages]
        path, _ = result.unwrap()
        points = path(np.linspace(0.0, path.length, 200))
        assert all(map(second[name].free, points))


@pytest.mark.parametrize("name", NAMES)
def test_verdicts_are_those_of_coal_but_within_a_micrometre_of_contact(
    robots: dict[str, Robot], second: dict[str, IndependentChecker], name: str
) -> None:
    checker = CollisionChecker(robots[name], CELL)
    Q = samples(robots[name], 200)
    for q in [*Q, *near_contact(checker, Q[:40])]:
        if checker.state_is_free(q) != second[name].free(q):
            assert abs(min(second[name].gaps(q).values())) < CONTACT


# ---- packages


def toml(folder: Path, packages: str, urdf: str) -> Path:
    text = (data_folder("robots") / "panda" / "robot.toml").read_text("utf-8")
    text = text.replace('packages = ["example-robot-data"]', packages)
    old = next(line for line in text.splitlines() if line.startswith("urdf = "))
    (folder / "robot.toml").write_text(text.replace(old, f'urdf = "{urdf}"'), "utf-8")
    return folder / "robot.toml"


NAMED = 'packages = ["example-robot-data"]'
REFUSED = [
    (NAMED, "package://example-robot-data/../README.md", "expected a path in the folder of package"),
    ("", "package://example-robot-data/robots/x.urdf", "expected a package that is listed in packages"),
    ("packages = []", "x.urdf", "packages: got .*; expected one or more different names"),
]


@pytest.mark.parametrize(("packages", "urdf", "reason"), REFUSED)
def test_only_files_of_packages_that_are_named_and_known_are_read(
    tmp_path: Path, packages: str, urdf: str, reason: str
) -> None:
    with pytest.raises(InvalidFile, match=reason):
        load_robot(toml(tmp_path, packages, urdf))


def nothing_installed(name: str) -> importlib.metadata.Distribution:
    raise importlib.metadata.PackageNotFoundError(name)


def test_a_package_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", nothing_installed)
    with pytest.raises(InvalidFile, match="package 'example-robot-data' is not installed; pip install"):
        load_robot("panda")
    with pytest.raises(MissingDependency, match=r"trossen-arm-sim is not installed; .*planner-service\[wxai-meshes\]"):
        load_robot("wxai_mesh")


# ---- the WidowX AI with its meshes


def test_the_wxais_boxes_and_cylinders_cover_its_meshes_where_these_are_installed() -> None:
    wxai = load_robot("wxai")
    try:
        folder = package_folder("trossen-arm-sim") / "assets"
    except MissingDependency:
        return  # as it is refused is for another test to say
    meshed = load_robot("wxai_mesh")
    assert CollisionChecker(meshed, Scene()).state_is_free(meshed.home)
    at: dict[str, tuple[str, ...]] = {"camera_mount_d405": ("camera",)}
    for side in ("left", "right"):  # the racks stay inside the palm
        at |= {f"gripper_{side}": (f"finger_{side}",), f"carriage_{side}": (f"finger_{side}", "link_6")}
    for name in ("base_link", *(f"link_{k}" for k in range(1, 7)), *at):
        points = read_vertices(folder / f"{name}.stl")
        links = at.get(name, (name,))
        frame = next(item for item in meshed.with_gripper(0.0).shapes if item.link == links[0]).pose.matrix
        world = points @ frame[:3, :3].T + frame[:3, 3]
        covers = [item for item in wxai.with_gripper(0.0).shapes if item.link in links]
        assert np.min([_outside(item.shape, item.pose, world) for item in covers], axis=0).max() < COVER


def _outside(shape: Any, pose: Pose, points: FloatArray) -> FloatArray:
    """How far points (n, 3) stick out of a box or cylinder, along its axes; (n,)."""
    x, y, z = ((points - pose.matrix[:3, 3]) @ pose.matrix[:3, :3]).T
    if isinstance(shape, Cylinder):
        return np.asarray(np.maximum(np.sqrt(x * x + y * y) - shape.radius, np.abs(z) - shape.length / 2))
    assert isinstance(shape, Box)
    return np.asarray(np.max([np.abs(v) - size / 2 for v, size in zip((x, y, z), shape.size, strict=True)], axis=0))
