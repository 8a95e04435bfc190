"""An arm as MJCF out of its URDF: joints, masses and position control, for arms whose vendors give no model."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import planner_service as ps

__all__ = ["arm_text"]

SPEED = 60.0
"""Rad/s at which a joint follows its command, critically damped: such arms reach it."""

REFLECTED = 1.0
"""Of a motor, seen through its gear, in kg m^2."""

FINGER = {"kp": 2000.0, "kv": 80.0, "force": 60.0}
"""Of a finger that slides, N/m, N s/m and N."""


def arm_text(robot: ps.Robot) -> str:
    """The MJCF of an arm without shapes: ``planner_service.execute.mjcf`` adds those that are planned with.

    Each joint is a position servo with gravity compensation. Masses are the URDF's; where it has none, 1 kg a link.
    """
    root = Element("mujoco", model=robot.name)
    SubElement(root, "compiler", angle="radian", autolimits="true")
    SubElement(root, "option", timestep="0.001", integrator="implicitfast")
    world = SubElement(root, "worldbody")
    actuators = SubElement(root, "actuator")
    bodies = list[Element]()
    masses: dict[int, list[tuple[float, ps.Pose, tuple[float, ...]]]] = {}
    for link in () if robot.dynamics is None else robot.dynamics.links:
        masses.setdefault(link.body, []).append((link.mass, link.pose, link.tensor))
    for number, body in enumerate(robot.bodies):
        parent = world if body.parent < 0 else bodies[body.parent]
        at = ps.Pose.from_matrix(body.placement)
        element = SubElement(parent, "body", {"name": f"at {body.name}", "gravcomp": "1", **_placement(at)})
        bodies.append(element)
        if body.q_index >= 0:
            kind = "slide" if body.prismatic else "hinge"
            axis = _numbers(*body.axis.tolist())
            lower, upper = robot.limits.lower[body.q_index], robot.limits.upper[body.q_index]
            limits = _numbers(lower - 0.01, upper + 0.01)
            SubElement(element, "joint", name=body.name, type=kind, axis=axis, range=limits, armature=f"{REFLECTED}")
            servo = {"kp": f"{SPEED**2 * 2.0 * REFLECTED}", "dampratio": "1"}
            SubElement(actuators, "position", {"name": body.name, "joint": body.name, **servo})
        known = masses.get(number, []) if robot.dynamics is not None else []
        for mass, pose, tensor in known or [(1.0, ps.Pose(), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))]:
            if mass > 0.0:
                carried = SubElement(element, "body", gravcomp="1")
                ixx, ixy, ixz, iyy, iyz, izz = tensor
                full = _numbers(ixx, iyy, izz, ixy, ixz, iyz)
                turned = ps.Pose((0.0, 0.0, 0.0), pose.quaternion)
                carried.attrib |= _placement(ps.Pose(pose.position) @ turned)
                SubElement(carried, "inertial", pos="0 0 0", mass=repr(float(mass)), fullinertia=full)
    _add_fingers(robot, bodies, actuators)
    return ElementTree.tostring(root, encoding="unicode")


def _add_fingers(robot: ps.Robot, bodies: list[Element], actuators: Element) -> None:
    gripper = robot.gripper
    if gripper is None or gripper.kind != "parallel":
        return
    for joint, link in zip(gripper.joints, gripper.links, strict=True):
        number, item = next((k, item) for k, item in enumerate(gripper.closed) if item.link == link)
        element = SubElement(bodies[item.body], "body", name=f"at {joint}", gravcomp="1")
        limits = _numbers(-0.02, gripper.upper / 2.0 + 0.005)
        axis = _numbers(*gripper.directions[number])
        SubElement(element, "joint", name=joint, type="slide", axis=axis, range=limits, armature="0.1")
        SubElement(element, "inertial", pos="0 0 0", mass="0.1", diaginertia="1e-4 1e-4 1e-4")
        force = _numbers(-FINGER["force"], FINGER["force"])
        servo = {"kp": f"{FINGER['kp']}", "kv": f"{FINGER['kv']}", "forcerange": force}
        SubElement(actuators, "position", {"name": joint, "joint": joint, **servo})


def _placement(pose: ps.Pose) -> dict[str, str]:
    return {"pos": _numbers(*pose.position), "quat": _numbers(*pose.quaternion)}


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
