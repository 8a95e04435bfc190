"""From a URDF to moving bodies: Pinocchio's model, built joint by joint from what ``read_urdf`` returns.

The file is read only once. A test compares the result with the models that Pinocchio and yourdfpy read from the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.errors import BrokenInvariant
from planner_service.geometry.arrays import FloatArray, product, rpy_matrix, vector
from planner_service.geometry.shapes import Pose
from planner_service.robot.kinematic_tree import Body, LinkShape, joint_motion
from planner_service.robot.urdf_model import Mimic, Urdf, UrdfJoint

__all__ = ["Assembly", "assemble", "locked_positions", "mimicked", "transform"]

LINK, JOINT = "link:", "joint:"
"""Prefixes of names in Pinocchio's model, where links and joints share one list that begins with "universe"."""

ALIGNED = 1e-12
"""Distance from x, y or z at which Pinocchio's own URDF reader takes an axis to be that axis."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """The bodies of a robot, with their shapes and link frames.

    Attributes:
        bodies: Parents before children; the first is the fixed base.
        shapes: Collision shapes in the order of the URDF.
        frames: For each link its body and T_body_link (4 x 4).
    """

    bodies: tuple[Body, ...]
    shapes: tuple[LinkShape, ...]
    frames: Mapping[str, tuple[int, FloatArray]]


def transform(xyz: Sequence[float], rpy: Sequence[float]) -> FloatArray:
    """4 x 4 matrix of URDF's ``<origin>``."""
    T = np.eye(4)
    T[:3, :3] = rpy_matrix(*rpy)
    T[:3, 3] = xyz
    return T


def locked_positions(urdf: Urdf, joints: Sequence[str], given: Mapping[str, float]) -> dict[str, float]:
    """Positions of the movable joints that are not in ``joints``: as given, or mimicking a joint that stands.

    A joint that is not given and mimics none that stands is left out. A mimic with the multiplier 0 stands anyway.
    """
    fixed = {joint.name: 0.0 for joint in urdf.joints if joint.kind == "fixed"}
    positions = fixed | dict(given)
    waiting = [
        (joint.name, joint.mimic)
        for joint in urdf.joints
        if joint.mimic is not None and joint.name not in positions and joint.name not in joints
    ]
    for _ in range(len(waiting)):  # a mimic may follow a mimic
        for name, mimic in waiting:
            if mimic.multiplier == 0.0:
                positions[name] = mimic.offset
            elif mimic.joint in positions:
                positions[name] = mimic.multiplier * positions[mimic.joint] + mimic.offset
    return {name: position for name, position in positions.items() if name not in fixed}


def mimicked(urdf: Urdf, joints: Sequence[str], locked: Mapping[str, float]) -> dict[str, Mimic]:
    """How the joints that are neither in ``joints`` nor ``locked`` follow one of ``joints``, also through others."""
    by_name = {joint.name: joint for joint in urdf.joints}
    out = {}
    for joint in urdf.joints:
        if joint.kind == "fixed" or joint.mimic is None or joint.name in joints or joint.name in locked:
            continue
        way = joint.mimic
        while way.joint not in joints and (above := by_name[way.joint].mimic) is not None:
            way = Mimic(above.joint, way.multiplier * above.multiplier, way.multiplier * above.offset + way.offset)
        out[joint.name] = way
    return out


def _pinocchio() -> Any:
    import pinocchio  # 0.2 s

    return pinocchio


def assemble(urdf: Urdf, joints: Sequence[str], locked: Mapping[str, float]) -> Assembly:
    """The bodies that ``joints`` and their mimics move, with every other joint at its position in ``locked``."""
    pin = loaded(_pinocchio)
    full = _model(pin, urdf)
    q = np.zeros(full.nq)
    for name, position in locked.items():
        q[full.joints[full.getJointId(JOINT + name)].idx_q] = position
    model = pin.buildReducedModel(full, [full.getJointId(JOINT + name) for name in locked], q)
    names = [name.removeprefix(JOINT) for name in model.names.tolist()[1:]]
    mimics = mimicked(urdf, joints, locked)
    if sorted(names) != sorted([*joints, *mimics]):
        raise BrokenInvariant(f"Pinocchio moves {names}, the robot says {list(joints)}")
    bodies = [Body("base", -1, np.eye(4), np.zeros(3), False, -1)]
    for index, name in enumerate(names, 1):
        motion = np.asarray(model.joints[index].createData().S) + 0.0  # + 0.0 drops the sign of -0.0
        prismatic = bool(np.abs(motion[:3]).max() > 0.5)
        placement = _exact(model.jointPlacements[index].homogeneous)
        axis = motion[:3] if prismatic else motion[3:]
        mimic = mimics.get(name, Mimic(name, 1.0, 0.0))
        if mimic.offset != 0.0:
            placement = product(placement, joint_motion(vector(axis.tolist()), mimic.offset, slides=prismatic))
        column = joints.index(mimic.joint)
        bodies.append(Body(name, int(model.parents[index]), placement, axis, prismatic, column, mimic.multiplier))
    frames = {}
    for link in urdf.links:
        frame = model.frames[model.getFrameId(LINK + link.name, pin.FrameType.BODY)]
        frames[link.name] = (int(frame.parentJoint), _exact(frame.placement.homogeneous))
    return Assembly(tuple(bodies), _shapes(urdf, frames), frames)


def _model(pin: Any, urdf: Urdf) -> Any:
    """Pinocchio's model of all joints, numbered and placed to the last bit as its own URDF reader does it."""
    joints_below: dict[str, list[UrdfJoint]] = {}
    for joint in sorted(urdf.joints, key=lambda joint: joint.name.encode(), reverse=True):
        joints_below.setdefault(joint.parent, []).append(joint)
    model = pin.Model()
    frames = {urdf.root: model.addBodyFrame(LINK + urdf.root, 0, pin.SE3.Identity(), 0)}
    waiting = list(joints_below.get(urdf.root, ()))
    while waiting:  # depth first
        joint = waiting.pop()
        frame = frames[joint.parent]
        above = model.frames[frame]
        body, placement = above.parentJoint, above.placement * _placement(pin, joint)
        if joint.kind != "fixed":
            body = model.addJoint(body, _joint_model(pin, joint), placement, JOINT + joint.name)
            frame, placement = model.addJointFrame(body, frame), pin.SE3.Identity()
        frames[joint.child] = model.addBodyFrame(LINK + joint.child, body, placement, frame)
        waiting += joints_below.get(joint.child, ())
    return model


def _placement(pin: Any, joint: UrdfJoint) -> Any:
    """T_parent_joint by way of a unit quaternion, as in urdfdom: the same bits."""
    (cr, cp, cy), (sr, sp, sy) = ([turn(angle / 2.0) for angle in joint.rpy] for turn in (math.cos, math.sin))
    x = sr * cp * cy - cr * sp * sy
    y = cr * sp * cy + sr * cp * sy
    z = cr * cp * sy - sr * sp * cy
    w = cr * cp * cy + sr * sp * sy
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    return pin.SE3(pin.Quaternion(w / norm, x / norm, y / norm, z / norm).toRotationMatrix(), np.array(joint.xyz))


def _joint_model(pin: Any, joint: UrdfJoint) -> Any:
    kind = "Prismatic" if joint.kind == "prismatic" else "Revolute"
    for axis, unit in zip("XYZ", np.eye(3).tolist(), strict=True):
        if math.dist(joint.axis, unit) <= ALIGNED:
            return getattr(pin, f"JointModel{kind[0]}{axis}")()
    return getattr(pin, f"JointModel{kind}Unaligned")(*joint.axis)


def _exact(T: FloatArray) -> FloatArray:
    """The matrix with entries within rounding of 0 or +-1 made exact: URDF writes quarter turns as decimals of pi."""
    out = np.array(T, dtype=np.float64)
    R = out[:3, :3]
    near = np.round(R)
    R[:] = np.where(np.abs(R - near) < 1e-15, near, R) + 0.0
    return out


def _shapes(urdf: Urdf, frames: Mapping[str, tuple[int, FloatArray]]) -> tuple[LinkShape, ...]:
    shapes = []
    for link in urdf.links:
        body, T_body_link = frames[link.name]
        for item in link.collisions:
            T_body_shape = product(T_body_link, transform(item.xyz, item.rpy))
            shapes.append(LinkShape(link.name, body, item.shape, Pose.from_matrix(T_body_shape)))
    return tuple(shapes)
