"""The robots whose files other packages bring along: they load by name, and are what Coal takes them for."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from auditor import checker as independent
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
from planner_service.robot.urdf_reader import read_urdf
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Obstacle, Scene
from planner_service.service import PlannerService
from tests.support.optional import present

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

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


def robot_table(name: str) -> dict[str, Any]:
    """The robot.toml with the whole path of its URDF, as the independent checker takes it."""
    return independent.robot_table(data_folder("robots") / name)


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


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_loads_by_name_and_its_home_is_free(robots: dict[str, Robot], name: str) -> None:
    robot = robots[name]
    assert (robot.name, robot.n) == (name, {"panda": 7, "ur5": 6, "xarm7": 7, "kinova": 6}[name.partition("_")[0]])
    checker = CollisionChecker(robot, Scene(obstacles=(TABLE,)))
    assert all(checker.state_is_free(q) for q in robot.poses.values())
    assert checker.clearance(robot.home) > 0.01


@pytest.mark.parametrize("name", NAMES)
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


@pytest.mark.parametrize("name", NAMES)
def test_what_is_proven_never_to_touch_does_not(robots: dict[str, Robot], name: str) -> None:
    table = robot_table(name)
    proven = [set(c["links"]) for c in table["allowed_contacts"] if c["reason"].startswith("never: proven")]
    table["allowed_contacts"] = [c for c in table["allowed_contacts"] if set(c["links"]) not in proven]
    checker = IndependentChecker(table, {})
    gaps = [checker.gaps(q) for q in samples(robots[name], 60)]
    judged = [key for key in gaps[0] if set(key) in proven]  # without what only a finger moves
    assert len(judged) > 2
    for pair in judged:
        assert min(gap[pair] for gap in gaps) > 0.0


def test_the_pandas_fingers_stand_at_half_its_width(robots: dict[str, Robot]) -> None:
    panda = robots["panda"]
    assert set(present(panda.gripper).links) == {"panda_leftfinger", "panda_rightfinger"}

    def inner(width: float) -> list[float]:
        found = []
        for item in panda.with_gripper(width).shapes:
            if item.link in ("panda_leftfinger", "panda_rightfinger") and isinstance(item.shape, Box):
                T = np.linalg.inv(panda.tool_placement) @ item.pose.matrix
                found.append(abs(T[1, 3]) - float(np.abs(T[1, :3]) @ np.array(item.shape.size)) / 2)
        return found

    assert min(inner(0.08)) == pytest.approx(0.04, abs=2e-4)  # the pads' inner faces lie 20 um beyond the middle
    assert min(inner(0.0)) == pytest.approx(0.0, abs=2e-4)


def test_the_pandas_limits_are_those_of_its_urdf(robots: dict[str, Robot]) -> None:
    limits = robots["panda"].limits
    urdf = read_urdf(Path(robot_table("panda")["urdf"]), [package_folder("example-robot-data")])
    joints = {joint.name: joint for joint in urdf.joints}
    for k, name in enumerate(robots["panda"].joint_names):
        joint = joints[name]
        assert (limits.lower[k], limits.upper[k], limits.velocity[k]) == (joint.lower, joint.upper, joint.velocity)


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
    (NAMED, "package://example-robot-data/robots/none.urdf", "no such file"),
    ("", "package://example-robot-data/robots/x.urdf", "expected a package that is listed in packages"),
    ('packages = ["numpy"]', "package://numpy/x.urdf", "packages: unknown package 'numpy'"),
    ("packages = []", "x.urdf", "packages: got .*; expected one or more different names"),
]


@pytest.mark.parametrize(("packages", "urdf", "reason"), REFUSED)
def test_only_files_of_packages_that_are_named_and_known_are_read(
    tmp_path: Path, packages: str, urdf: str, reason: str
) -> None:
    with pytest.raises(InvalidFile, match=reason):
        load_robot(toml(tmp_path, packages, urdf))


def test_a_link_out_of_a_package_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = installed(tmp_path, "example-robot-data", monkeypatch) / "cmeel.prefix" / "share" / "example-robot-data"
    share.mkdir(parents=True)
    (tmp_path / "secret.urdf").write_text("<robot/>")
    (share / "sly.urdf").symlink_to(tmp_path / "secret.urdf")
    with pytest.raises(InvalidFile, match="expected a path in the folder of package 'example-robot-data'"):
        load_robot(toml(tmp_path, NAMED, "package://example-robot-data/sly.urdf"))


def installed(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A site-packages folder where an empty distribution of that name is installed, before all others."""
    site = folder / "site"
    info = site / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    monkeypatch.syspath_prepend(str(site))
    return site


def nothing_installed(name: str) -> importlib.metadata.Distribution:
    raise importlib.metadata.PackageNotFoundError(name)


def test_a_package_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "distribution", nothing_installed)
    with pytest.raises(InvalidFile, match="package 'example-robot-data' is not installed; pip install"):
        load_robot("panda")
    with pytest.raises(MissingDependency, match=r"trossen-arm-sim is not installed; .*planner-service\[wxai-meshes\]"):
        load_robot("wxai_mesh")


def test_a_package_without_its_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, "example-robot-data", monkeypatch)
    with pytest.raises(InvalidFile, match=r"is installed, but .* is not a folder"):
        load_robot("panda")


# ---- the WidowX AI with its meshes


def collisions(name: str) -> ElementTree.Element:
    return ElementTree.parse(data_folder("robots") / name / f"{name}.urdf").getroot()


def test_the_wxai_with_meshes_moves_as_the_wxai_does() -> None:
    one, other = collisions("wxai"), collisions("wxai_mesh")
    for root in (one, other):
        for link in root.findall("link"):
            for element in link.findall("collision"):
                link.remove(element)
        root.set("name", "")
    plain = [[(e.tag, sorted(e.attrib.items()), (e.text or "").strip()) for e in root.iter()] for root in (one, other)]
    assert plain[0] == plain[1]
    tables = [tomllib.loads((data_folder("robots") / n / "robot.toml").read_text()) for n in ("wxai", "wxai_mesh")]
    for key in ("joints", "tool_frame", "base_links", "poses", "limits", "gripper", "inverse_kinematics"):
        assert tables[0][key] == tables[1][key]


def test_the_wxai_with_meshes_loads_from_a_folder_that_pip_could_have_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assets = installed(tmp_path, "trossen-arm-sim", monkeypatch) / "trossen_arm_sim" / "assets"
    assets.mkdir(parents=True)
    names = [element.get("filename", "") for element in collisions("wxai_mesh").iter("mesh")]
    for name in names:
        corners = ["0 0 0", "0.01 0 0", "0 0.01 0", "0 0 0.01"]
        facets = "".join(f"vertex {corners[k]} " for k in (0, 1, 2, 0, 1, 3, 0, 2, 3, 1, 2, 3))
        (assets / name.rpartition("/")[2]).write_text(f"solid {facets} endsolid")
    robot = load_robot("wxai_mesh")
    assert (robot.n, robot.inverse, len(robot.shapes)) == (6, "wxai", len(names) + 1)


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
