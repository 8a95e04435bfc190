"""What is read in a URDF and built from it, against two other readers: Pinocchio's (urdfdom) and yourdfpy's."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy

from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, Shape, Sphere
from planner_service.robot.toml_reader import read_robot_file
from planner_service.robot.urdf_assembly import assemble, transform
from planner_service.robot.urdf_model import Urdf
from planner_service.robot.urdf_reader import read_urdf

SHIPPED = sorted(path.parent.name for path in data_folder("robots").glob("*/robot.toml"))
RANDOM = [f"random {seed}" for seed in range(30)]


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


def test_a_locked_joint_stands_where_pinocchio_has_it(reading: Reading) -> None:
    locked = {
        joint.name: 0.3 * joint.lower + 0.7 * joint.upper
        for joint in reading.urdf.joints
        if joint.name in reading.movable[::2]
    }
    assembly = assemble(reading.urdf, [name for name in reading.movable if name not in locked], locked)
    model = pinocchios(reading)
    q = pin.neutral(model)
    for name, value in locked.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
    model = pin.buildReducedModel(model, [model.getJointId(name) for name in locked], q)
    assert [body.name for body in assembly.bodies[1:]] == list(model.names)[1:]
    assert [body.parent for body in assembly.bodies[1:]] == list(model.parents)[1:]
    for index, body in enumerate(assembly.bodies[1:], 1):
        assert body.placement == pytest.approx(model.jointPlacements[index].homogeneous, abs=1e-14)
    for name, (body_index, T) in assembly.frames.items():
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        assert body_index == frame.parentJoint
        assert pytest.approx(frame.placement.homogeneous, abs=1e-14) == T


def test_limits_and_inertias_are_those_pinocchio_reads(reading: Reading) -> None:
    model = pinocchios(reading)
    for joint in reading.urdf.joints:
        if joint.kind != "fixed":
            k, v = (getattr(model.joints[model.getJointId(joint.name)], at) for at in ("idx_q", "idx_v"))
            assert joint.velocity == model.upperVelocityLimit[v]
            assert joint.effort == model.upperEffortLimit[v]
            if model.joints[model.getJointId(joint.name)].nq == 1:  # a continuous one has a cosine and a sine
                limits = joint.hard or (joint.lower, joint.upper)  # Pinocchio does not read soft limits
                assert limits == (model.lowerPositionLimit[k], model.upperPositionLimit[k])
    inertias = [pin.Inertia.Zero() for _ in range(model.njoints)]
    for link in reading.urdf.links:
        if link.inertial is not None:
            frame = model.frames[model.getFrameId(link.name, pin.FrameType.BODY)]
            xx, xy, xz, yy, yz, zz = link.inertial.tensor
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            own = pin.SE3(transform(link.inertial.xyz, link.inertial.rpy))
            inertias[frame.parentJoint] += (frame.placement * own).act(
                pin.Inertia(link.inertial.mass, np.zeros(3), tensor)
            )
    for ours, theirs in zip(inertias[1:], model.inertias.tolist()[1:], strict=True):
        assert ours.matrix() == pytest.approx(theirs.matrix(), rel=1e-12, abs=1e-12)


def test_links_joints_and_shapes_are_those_yourdfpy_reads(reading: Reading) -> None:
    other = yourdfpy.URDF.load(str(reading.path), build_scene_graph=False, load_meshes=False).robot
    assert (reading.urdf.name, len(reading.urdf.joints)) == (other.name, len(other.joints))
    for joint, theirs in zip(reading.urdf.joints, other.joints, strict=True):
        assert (joint.name, joint.parent, joint.child) == (theirs.name, theirs.parent, theirs.child)
        assert joint.kind == ("revolute" if theirs.type == "continuous" else theirs.type)
        T = np.eye(4) if theirs.origin is None else theirs.origin
        assert transform(joint.xyz, joint.rpy) == pytest.approx(T, abs=1e-15)
        if joint.kind != "fixed":
            assert joint.axis == pytest.approx(theirs.axis / np.linalg.norm(theirs.axis), abs=3e-16)
        if theirs.mimic is not None:
            assert joint.mimic is not None
            assert (joint.mimic.joint, joint.mimic.multiplier) == (theirs.mimic.joint, theirs.mimic.multiplier)
    for link, theirs in zip(reading.urdf.links, other.links, strict=True):
        assert link.name == theirs.name
        for shape, their_shape in zip(link.collisions, theirs.collisions, strict=True):
            T = np.eye(4) if their_shape.origin is None else their_shape.origin
            assert transform(shape.xyz, shape.rpy) == pytest.approx(T, abs=1e-15)
            require_same(shape.shape, their_shape.geometry)


def require_same(shape: Shape, geometry: Any) -> None:
    if isinstance(shape, Box):
        assert shape.size == tuple(geometry.box.size.tolist())
    elif isinstance(shape, Cylinder):
        assert (shape.radius, shape.length) == (geometry.cylinder.radius, geometry.cylinder.length)
    elif isinstance(shape, Sphere):
        assert shape.radius == geometry.sphere.radius
    else:
        assert isinstance(shape, Mesh)
        assert geometry.mesh is not None


@pytest.mark.slow
def test_a_chain_as_long_as_a_file_may_have_takes_no_gigabytes(tmp_path: Path) -> None:
    """Pinocchio would fill arrays of n x n x n numbers, 1 GB each for 500 joints, if it were asked to compute."""
    ends = '<parent link="l{}"/><child link="l{}"/><limit lower="-1" upper="1" velocity="1"/>'
    joints = [f'<joint name="j{k}" type="revolute">{ends.format(k, k + 1)}</joint>' for k in range(499)]
    links = [f'<link name="l{k}"/>' for k in range(500)]
    path = tmp_path / "chain.urdf"
    path.write_text("".join(["<robot name='chain'>", *links, *joints, "</robot>"]))
    code = (
        "import sys, resource, pathlib; resource.setrlimit(resource.RLIMIT_AS, (3 * 10**9, 3 * 10**9));"
        "from planner_service.robot.urdf_reader import read_urdf;"
        "from planner_service.robot.urdf_assembly import assemble;"
        "urdf = read_urdf(pathlib.Path(sys.argv[1])); joints = [joint.name for joint in urdf.joints];"
        "print(len(assemble(urdf, joints, {}).bodies))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True)
    assert done.stdout == "500\n", done.stderr
