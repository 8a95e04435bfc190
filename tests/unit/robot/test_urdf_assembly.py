"""What is read in a URDF and built from it, against two other readers: Pinocchio's (urdfdom) and yourdfpy's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.robot.toml_reader import read_robot_file
from planner_service.robot.urdf_assembly import assemble, transform
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import read_urdf

SHIPPED = sorted(path.parent.name for path in data_folder("robots").glob("*/robot.toml"))
RANDOM = [f"random {seed}" for seed in range(10)]


@dataclass(frozen=True)
class Reading:
    """A URDF file and what ``read_urdf`` reads in it."""

    path: Path
    urdf: Urdf

    @property
    def movable(self) -> list[str]:
        return [joint.name for joint in self.urdf.joints if joint.kind != "fixed"]


@pytest.fixture(scope="module", params=[*SHIPPED, *RANDOM])
def reading(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Reading:
    kind, _, seed = request.param.partition(" ")
    if kind == "random":
        path = tmp_path_factory.mktemp("random") / "robot.urdf"
        path.write_text(random_urdf(np.random.default_rng(int(seed))))
        return Reading(path, read_urdf(path))
    return shipped(request.param)


@cache
def shipped(name: str) -> Reading:
    file = read_robot_file(data_folder("robots") / name / "robot.toml")
    return Reading(file.urdf, read_urdf(file.urdf, file.package_dirs))


def random_urdf(rng: np.random.Generator) -> str:
    """A random tree: joints in another order than links, turns in decimals, axes nearly along x, y or z."""

    def number(low: float, high: float) -> str:
        return repr(float(rng.uniform(low, high)))

    def vector(low: float, high: float) -> str:
        return f"{number(low, high)} {number(low, high)} {number(low, high)}"

    def one_of(*choices: str) -> str:
        return choices[rng.integers(len(choices))]

    def origin() -> str:
        turns = [one_of("0", "1.5708", "-1.57079632679", "3.14159265", number(-3.0, 3.0)) for _ in range(3)]
        return f'<origin xyz="{vector(-1.0, 1.0)}" rpy="{" ".join(turns)}"/>'

    def link(name: str) -> str:
        moments = f'ixx="{number(1.0, 1.5)}" iyy="{number(1.0, 1.5)}" izz="{number(1.0, 1.5)}"'
        inertia = f'<mass value="{number(0.0, 3.0)}"/><inertia {moments} ixy="0.1" ixz="-0.05" iyz="0.02"/>'
        shapes = [
            f'<box size="{vector(0.1, 1.0)}"/>',
            f'<cylinder radius="{number(0.01, 0.1)}" length="0.3"/>',
            f'<sphere radius="{number(0.01, 0.1)}"/>',
        ][: rng.integers(4)]
        collisions = "".join(f"<collision>{origin()}<geometry>{shape}</geometry></collision>" for shape in shapes)
        return f'<link name="{name}">{one_of("", f"<inertial>{origin()}{inertia}</inertial>")}{collisions}</link>'

    def joint(parent: str, child: str) -> str:
        kind = one_of("revolute", "prismatic", "continuous", "fixed")
        axis = one_of("1 0 0", "0 1 0", "0 0 1", "0 0 -1", "0 3 0", "1e-14 0 1", "1e-9 1 0", *(vector(-1.0, 1.0),) * 7)
        limit = f'lower="{number(-2.0, 0.0)}" upper="{number(0.0, 2.0)}" velocity="{number(0.5, 3.0)}" effort="9.5"'
        inside = f'<parent link="{parent}"/><child link="{child}"/>{origin()}<axis xyz="{axis}"/><limit {limit}/>'
        return f'<joint name="{one_of("z", "a", "X", "é")}_{child}" type="{kind}">{inside}</joint>'

    names = [f"link_{k}" for k in range(rng.integers(2, 12))]
    joints = [joint(names[rng.integers(max(0, k - 3), k)], names[k]) for k in range(1, len(names))]
    return "".join(["<robot name='random'>", *map(link, names), *rng.permutation(joints), "</robot>"])


def pinocchios(reading: Reading) -> Any:
    """Pinocchio's model of the file, read by urdfdom."""
    return pin.buildModelFromUrdf(str(reading.path))


def tidied(T: FloatArray) -> FloatArray:
    """A pose as bodies have it: entries of the rotation that are 0 or +-1 up to rounding made so."""
    out = np.array(T)
    near = np.round(out[:3, :3])
    out[:3, :3] = np.where(np.abs(out[:3, :3] - near) < 1e-15, near, out[:3, :3])
    return out


def axis_in(model: Any, index: int) -> FloatArray:
    motion = np.asarray(model.joints[index].createData().S)
    return motion[:3] if model.joints[index].shortname().startswith("JointModelP") else motion[3:]


@pytest.mark.slow
def test_joints_and_links_are_numbered_and_placed_as_pinocchio_does_to_the_last_bit(reading: Reading) -> None:
    model = pinocchios(reading)
    assembly = assemble(reading.urdf, reading.movable, {})
    assert [body.name for body in assembly.bodies[1:]] == list(model.names)[1:]
    assert [body.parent for body in assembly.bodies[1:]] == list(model.parents)[1:]
    kinds = {joint.name: joint.kind for joint in reading.urdf.joints}
    for index, body in enumerate(assembly.bodies[1:], 1):
        assert np.array_equal(body.placement, tidied(model.jointPlacements[index].homogeneous))
        assert body.axis == pytest.approx(axis_in(model, index), abs=3e-16), "an axis is made a unit vector twice"
        assert body.prismatic == (kinds[body.name] == "prismatic")
        assert body.q_index == reading.movable.index(body.name)
    assert set(assembly.frames) == {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for name, (body_index, T) in assembly.frames.items():
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        assert body_index == frame.parentJoint
        assert np.array_equal(T, tidied(frame.placement.homogeneous))
    shapes = [(link, item) for link in reading.urdf.links for item in link.collisions]
    for placed, (link, item) in zip(assembly.shapes, shapes, strict=True):
        frame = model.frames[model.getFrameId(link.name, pin.FrameType.BODY)]
        T = (frame.placement * pin.SE3(transform(item.xyz, item.rpy))).homogeneous
        assert (placed.link, placed.body, placed.shape) == (link.name, frame.parentJoint, item.shape)
        assert placed.pose.matrix == pytest.approx(T, abs=1e-14)
