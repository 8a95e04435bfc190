"""From a checked URDF to moving bodies: Pinocchio builds the kinematics, yourdfpy reads the collision geometry.

Both see only the canonical text of ``Urdf.xml()``, and what they return is compared with what the strict reading
counted and measured: a shape that one of them dropped or changed is a bug here, never a silent "free".
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planner_service.concurrency.library_import import loaded
from planner_service.errors import BrokenInvariant, InvalidFile
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Cylinder, FloatArray, Pose, Shape, Sphere, rpy_matrix
from planner_service.robot.kinematic_tree import Body, LinkShape
from planner_service.robot.urdf_model import JOINT, LINK, Urdf, UrdfLink, mesh_name

__all__ = ["Assembly", "assemble", "compose", "locked_positions", "transform"]


@dataclass(frozen=True, eq=False)
class Assembly:
    """The bodies of a robot and what is fixed to them.

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


def compose(A: FloatArray, B: FloatArray) -> FloatArray:
    """A B for 4 x 4 matrices, without BLAS: the same bits on every machine."""
    out: FloatArray = A[:, :1] * B[:1] + A[:, 1:2] * B[1:2] + A[:, 2:3] * B[2:3] + A[:, 3:] * B[3:]
    return out


def locked_positions(urdf: Urdf, joints: Sequence[str], given: Mapping[str, float]) -> dict[str, float]:
    """Positions of every movable joint that is not in ``joints``: as given, or as the joint it mimics says.

    A joint that neither is given nor follows a locked one is left out.
    """
    positions = dict(given)
    waiting = [
        joint for joint in urdf.joints if joint.mimic and joint.name not in positions and joint.name not in joints
    ]
    for _ in range(len(waiting)):  # a mimic may follow a mimic
        for joint in waiting:
            if joint.mimic is not None and joint.mimic.joint in positions:
                positions[joint.name] = joint.mimic.multiplier * positions[joint.mimic.joint] + joint.mimic.offset
    return positions


def _pinocchio() -> Any:
    import pinocchio  # 0.2 s

    return pinocchio


def assemble(path: Path, urdf: Urdf, joints: Sequence[str], locked: Mapping[str, float]) -> Assembly:
    """Bodies moved by ``joints``, the other movable joints standing at ``locked``.

    Raises:
        InvalidFile: Pinocchio refuses the robot; ``path`` is the file it comes from.
    """
    pin = loaded(_pinocchio)
    try:
        full = pin.buildModelFromXML(urdf.xml())
    except (ValueError, RuntimeError, IndexError, ArithmeticError) as error:
        raise InvalidFile(path, [f"Pinocchio cannot build this robot: {error}"]) from error
    q = np.zeros(full.nq)
    for name, position in locked.items():
        q[full.joints[full.getJointId(JOINT + name)].idx_q] = position
    model = pin.buildReducedModel(full, [full.getJointId(JOINT + name) for name in locked], q)
    moving = [name.removeprefix(JOINT) for name in model.names.tolist()[1:]]
    if sorted(moving) != sorted(joints) or model.nq != len(joints):
        raise BrokenInvariant(f"Pinocchio moves {moving}, the robot says {list(joints)}")
    bodies = _bodies(pin, model, joints)
    frames = {}
    for link in urdf.links:
        frame = model.frames[model.getFrameId(LINK + link.name, pin.FrameType.BODY)]
        frames[link.name] = (int(frame.parentJoint), _exact(frame.placement.homogeneous))
    return Assembly(bodies, _shapes(urdf, frames), frames)


def _bodies(pin: Any, model: Any, joints: Sequence[str]) -> tuple[Body, ...]:
    names = [name.removeprefix(JOINT) for name in model.names.tolist()]
    data, neutral = model.createData(), pin.neutral(model)
    bodies = [Body("base", -1, np.eye(4), np.zeros(3), False, -1)]
    for index in range(1, model.njoints):
        # of a robot with one joint Pinocchio returns the only column as a vector
        jacobian = np.asarray(pin.computeJointJacobian(model, data, neutral, index)).reshape(6, -1)
        column = jacobian[:, model.joints[index].idx_v]
        prismatic = bool(np.abs(column[:3]).max() > 0.5)
        axis = column[:3] if prismatic else column[3:]
        placement = _exact(model.jointPlacements[index].homogeneous)
        bodies.append(
            Body(names[index], int(model.parents[index]), placement, axis, prismatic, joints.index(names[index]))
        )
    return tuple(bodies)


def _exact(T: FloatArray) -> FloatArray:
    """The matrix with entries that are 0 or +-1 up to rounding made so: URDF spells quarter turns in decimals of pi."""
    out = np.array(T, dtype=np.float64)
    R = out[:3, :3]
    near = np.round(R)
    R[:] = np.where(np.abs(R - near) < 1e-15, near, R) + 0.0
    return out


def _shapes(urdf: Urdf, frames: Mapping[str, tuple[int, FloatArray]]) -> tuple[LinkShape, ...]:
    import yourdfpy  # 0.6 s

    robot = yourdfpy.URDF.load(
        io.BytesIO(urdf.xml().encode()), build_scene_graph=False, build_collision_scene_graph=False, load_meshes=False
    ).robot
    read = {link.name.removeprefix(LINK): link.collisions for link in robot.links}
    shapes = []
    for link in urdf.links:
        body, T_body_link = frames[link.name]
        for shape, T_link_shape in _agreed(link, read.get(link.name, [])):
            shapes.append(LinkShape(link.name, body, shape, Pose.from_matrix(compose(T_body_link, T_link_shape))))
    if len(shapes) != urdf.shape_count:
        raise BrokenInvariant(f"{len(shapes)} shapes would be judged, the file has {urdf.shape_count}")
    return tuple(shapes)


def _agreed(link: UrdfLink, read: Sequence[Any]) -> list[tuple[Shape, FloatArray]]:
    """The shapes yourdfpy read for a link, with T_link_shape, if they are those of the strict reading."""
    if len(read) != len(link.collisions):
        raise BrokenInvariant(
            f"link {link.name}: yourdfpy reads {len(read)} shapes, the file has {len(link.collisions)}"
        )
    result = []
    for other, own in zip(read, link.collisions, strict=True):
        shape, T = _shape(other.geometry, own.shape), transform(own.xyz, own.rpy)
        origin = np.eye(4) if other.origin is None else other.origin
        if shape != own.shape or np.abs(origin - T).max() > 1e-9:
            raise BrokenInvariant(f"link {link.name}: yourdfpy reads {shape} at {origin}, the file has {own}")
        result.append((shape, T))
    return result


def _shape(geometry: Any, own: Shape) -> Shape | None:
    """What yourdfpy read; ``own`` if that is a mesh and it read its name, all there is of it in our text."""
    if geometry.mesh is not None:
        return own if isinstance(own, Mesh) and geometry.mesh.filename == mesh_name(own) else None
    if geometry.box is not None:
        return Box(tuple(geometry.box.size.tolist()))
    if geometry.cylinder is not None:
        return Cylinder(geometry.cylinder.radius, geometry.cylinder.length)
    if geometry.sphere is not None:
        return Sphere(geometry.sphere.radius)
    return None
