"""A robot and a scene as an MJCF file: the simulated WidowX AI with our covering shapes in place of its own.

The vendor's model brings the joints, inertias, actuators and gains. Its collision shapes leave up to 27 mm of the arm
uncovered, so that a simulation without contacts would prove little. They are left out, and every shape that the
planner checks takes their place. The arm can touch the scene but not itself; fixed obstacles never touch each other.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from planner_service.errors import InvalidRequest
from planner_service.files.xml_reader import read_xml
from planner_service.geometry.composite import Compound, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Pose, Sphere
from planner_service.robot.gripper import Gripper
from planner_service.robot.model import LinkShape, Robot
from planner_service.scene.names import Names
from planner_service.scene.scene import Scene

__all__ = ["MARK", "link_of", "mjcf_text"]

MARK = "#"
"""Between the label of a link or an object and the number of its shape."""

DENSITY = "500"
"""Of what lies loose, in kg/m3: that of wood."""

ARM, FIXED, LOOSE = ("1", "0"), ("0", "3"), ("2", "3")
"""contype and conaffinity: two shapes touch if one's type is in the other's affinity; arm and arm, fixed and fixed
do not."""

FRICTION = "1.0"
"""Of rubber on wood."""


def mjcf_text(arm_file: Path, robot: Robot, scene: Scene, *, loose: Collection[str] = ()) -> str:
    """The MJCF of a robot, its gripper movable, among the obstacles of a scene.

    Shape k of a link, an obstacle or an attached object is the geom ``label#k`` (see ``Names``), at the pose that
    the planner judges it at. What is attached weighs nothing.

    Args:
        arm_file: The vendor's MJCF of the arm, which has the robot's joints by name.
        loose: Obstacles that lie there as bodies of their own, to be taken; the others stand still. Body, joint and a
            weld to the robot's last body, not active, are called ``name#``: the arm's may be called as an obstacle is.

    Raises:
        InvalidRequest: the robot's joints are not those of the arm, its bodies are elsewhere, or a shape is none that
            MJCF has.
        InvalidFile: the file cannot be read.
        UnknownName: there is no such loose obstacle.
    """
    root = read_xml(arm_file, "mujoco")
    for name in ("default", "asset"):
        for element in root.findall(name):
            root.remove(element)
    world = root.find("worldbody")
    if world is None:
        raise InvalidRequest("arm_file", str(arm_file), "a model with a worldbody")
    for body in world.iter("body"):
        for geom in body.findall("geom"):
            body.remove(geom)
    bodies = _bodies(world, robot)
    names = Names(robot, scene)
    _add_robot(root, bodies, robot, names)
    for name in loose:
        scene.obstacle(name)
    hand = bodies[robot.bodies[robot.tool_body].name]
    tool = Pose.from_matrix(robot.tool_placement)
    for held in scene.attached:
        _add(root, hand, names.object(held.name), held.shape, tool @ held.pose, ARM)
    for obstacle in scene.obstacles:
        if obstacle.name in loose:
            own = obstacle.name + MARK
            body = SubElement(world, "body", {"name": own, **_placement(obstacle.pose)})
            SubElement(body, "freejoint", name=own)
            _add(root, body, names.object(obstacle.name), obstacle.shape, Pose(), LOOSE)
            weld = {"name": own, "body1": hand.attrib["name"], "body2": own, "active": "false"}
            SubElement(SubElement(root, "equality"), "weld", weld)
        else:
            _add(root, world, names.object(obstacle.name), obstacle.shape, obstacle.pose, FIXED)
    return ElementTree.tostring(root, encoding="unicode")


def link_of(geom: str) -> str:
    """The label of the link or object that a geom is a shape of."""
    return geom.rpartition(MARK)[0] or geom


def _bodies(world: Element, robot: Robot) -> dict[str, Element]:
    """The elements of the arm's bodies by the joints that move them, "base" for the fixed one."""
    base = world.find("body")
    bodies = {} if base is None else {"base": base}
    for element in world.iter("body"):
        bodies |= {joint.attrib["name"]: element for joint in element.findall("joint")}
    fingers = () if robot.gripper is None else robot.gripper.joints
    for name in (*robot.joint_names, *fingers):
        if name not in bodies:
            raise InvalidRequest("robot", robot.name, f"an arm with the simulated arm's joints; {name} is none of them")
    for body in robot.bodies:
        off = _pose_of(bodies[body.name]).inverse() @ Pose.from_matrix(body.placement)
        if max(map(abs, (*off.position, *off.quaternion[1:]))) > 1e-6:
            raise InvalidRequest("robot", robot.name, f"the simulated arm; {body.name} is elsewhere on it")
    return bodies


def _add_robot(root: Element, bodies: dict[str, Element], robot: Robot, names: Names) -> None:
    gripper = robot.gripper
    fingers = () if gripper is None or gripper.kind == "vacuum" else gripper.links  # a cup does not move
    fixed = [item for item in robot.shapes if item.link not in fingers]
    placed = [(robot.bodies[item.body].name, item) for item in fixed]
    placed += list(_fingers(bodies, gripper)) if gripper is not None and fingers else []
    count: dict[str, int] = {}
    for joint, item in placed:
        k = count[item.link] = count.get(item.link, -1) + 1
        _geom(root, bodies[joint], f"{names.link(item.link)}{MARK}{k}", item.shape, item.pose, ARM)


def _fingers(bodies: dict[str, Element], gripper: Gripper) -> Iterator[tuple[str, LinkShape]]:
    """The closed fingers' shapes with their joints, in the frames of these: the simulation moves them apart."""
    of_link = dict(zip(gripper.links, gripper.joints, strict=True))
    for item in gripper.closed:
        pose = _pose_of(bodies[of_link[item.link]]).inverse() @ item.pose
        yield of_link[item.link], LinkShape(item.link, item.body, item.shape, pose)


def _add(root: Element, parent: Element, name: str, shape: Solid, pose: Pose, kind: tuple[str, str]) -> None:
    parts = [(part, pose @ at) for part, at in shape.parts] if isinstance(shape, Compound) else [(shape, pose)]
    for k, (part, at) in enumerate(parts):
        _geom(root, parent, f"{name}{MARK}{k}", part, at, kind)


def _geom(root: Element, parent: Element, name: str, shape: object, pose: Pose, kind: tuple[str, str]) -> None:
    if isinstance(shape, Mesh):
        assets = root.find("asset")
        assets = SubElement(root, "asset") if assets is None else assets
        points = " ".join(repr(x) for x in shape.vertices.reshape(-1).tolist())
        SubElement(assets, "mesh", name=name, vertex=points)
    contype, conaffinity = kind
    matter = {"density": DENSITY} if kind == LOOSE else {"mass": "0"}
    words = {"name": name, "contype": contype, "conaffinity": conaffinity, "friction": FRICTION}
    SubElement(parent, "geom", {**words, **matter, **_solid(name, shape), **_placement(pose)})


def _solid(name: str, shape: object) -> dict[str, str]:
    """MJCF's lengths are half ones."""
    if isinstance(shape, Box):
        return {"type": "box", "size": _numbers(*(x / 2.0 for x in shape.size))}
    if isinstance(shape, Sphere):
        return {"type": "sphere", "size": _numbers(shape.radius)}
    if isinstance(shape, Cylinder | Capsule):
        kind = "cylinder" if isinstance(shape, Cylinder) else "capsule"
        return {"type": kind, "size": _numbers(shape.radius, shape.length / 2.0)}
    if isinstance(shape, Mesh):
        return {"type": "mesh", "mesh": name}
    expected = "boxes, spheres, cylinders, capsules, meshes and compounds of these: the simulator has no others"
    raise InvalidRequest(f"shape of {link_of(name)!r}", type(shape).__name__, expected)


def _placement(pose: Pose) -> dict[str, str]:
    return {"pos": _numbers(*pose.position), "quat": _numbers(*pose.quaternion)}


def _pose_of(body: Element) -> Pose:
    x, y, z = map(float, body.get("pos", "0 0 0").split())
    w, i, j, k = map(float, body.get("quat", "1 0 0 0").split())
    return Pose((x, y, z), (w, i, j, k))


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
