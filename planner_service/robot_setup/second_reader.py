"""A second opinion on a URDF: does yourdfpy, which shares no code with our reader, see the same robot?

A joint placed wrongly by a reader moves every link beyond it, in the plans and in their proofs alike, so no later check
would notice. It is looked for where a URDF becomes a robot of ours.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from planner_service.errors import InvalidFile
from planner_service.robot.model import Robot

__all__ = ["Agreement", "compare_with_yourdfpy"]

CONFIGURATIONS = 16
TOLERANCE = 1e-6

NO_GEOMETRY = {"dynamics", "safety_controller", "calibration", "visual", "inertial"}
"""Elements that do not decide where links and shapes are."""


@dataclass(frozen=True)
class Agreement:
    """How closely two readers agree on a robot.

    Attributes:
        frames: The frames compared: the tool's and that of each collision shape.
        configurations: Random configurations, the same ones for every robot with these limits.
        difference: The largest between two entries of the 4 x 4 world poses, in metres for the positions.
    """

    frames: int
    configurations: int
    difference: float


def compare_with_yourdfpy(
    robot: Robot, path: Path, root: ElementTree.Element, locked: Mapping[str, float]
) -> Agreement:
    """Compare where tool and collision shapes stand.

    Args:
        path: The URDF, for messages.
        root: Its ``<robot>``. Visuals and other elements that do not decide where links stand are left out.
        locked: Positions of the joints that do not move, in rad or m.

    Raises:
        InvalidFile: yourdfpy cannot read the file, or puts a frame elsewhere by more than 1e-6.
    """
    import yourdfpy  # 0.4 s, with trimesh and scipy

    try:
        other = yourdfpy.URDF.load(_geometry_of(root), load_meshes=False, build_collision_scene_graph=False)
    except Exception as error:  # of any kind: it does not check what it reads
        problem = f"cannot be read by yourdfpy, the second reader: {type(error).__name__}: {error}"
        raise InvalidFile(path, [problem]) from None
    still = {name: at for name, at in locked.items() if name in other.actuated_joint_names}
    origins = {link.name: [item.origin for item in link.collisions] for link in other.robot.links}
    rng = np.random.default_rng(0)
    worst = 0.0
    Q = rng.uniform(robot.limits.lower, robot.limits.upper, (CONFIGURATIONS, robot.n))
    bodies = np.zeros((CONFIGURATIONS, len(robot.bodies), 4, 4))
    bodies[..., :3, :3], bodies[..., :3, 3] = robot.body_poses_batch(Q)
    bodies[..., 3, 3] = 1.0
    for q, placed in zip(Q.tolist(), bodies, strict=True):
        other.update_cfg({**still, **dict(zip(robot.joint_names, q, strict=True))})
        pairs = [(robot.tool_frame, placed[robot.tool_body] @ robot.tool_placement, np.eye(4))]
        left = {link: iter(items) for link, items in origins.items()}
        for item in robot.shapes:
            origin = next(left[item.link])
            pairs.append((item.link, placed[item.body] @ item.pose.matrix, np.eye(4) if origin is None else origin))
        for link, pose, origin in pairs:
            difference = float(np.abs(pose - other.get_transform(link) @ origin).max())
            worst = max(worst, difference)
            if not difference <= TOLERANCE:
                raise InvalidFile(path, [f"yourdfpy, the second reader, puts {link!r} elsewhere, by {difference:.3g}"])
    return Agreement(1 + len(robot.shapes), CONFIGURATIONS, worst)


def _geometry_of(root: ElementTree.Element) -> io.BytesIO:
    """A URDF 1.0 of the links with their collision shapes, and of the joints."""
    from scipy.spatial.transform import Rotation  # as slow to import as the reader

    robot = ElementTree.Element("robot", root.attrib)
    for element in root:
        if element.tag in ("link", "joint"):
            copy = ElementTree.SubElement(robot, element.tag, element.attrib)
            copy.extend(deepcopy(child) for child in element if child.tag not in NO_GEOMETRY)
    for capsule in robot.iter("capsule"):  # of URDF 1.2; where the shape is, not what, is compared
        capsule.tag = "cylinder"
    for origin in robot.iter("origin"):
        if "quat_xyzw" in origin.attrib:  # of URDF 1.1, which yourdfpy does not read
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about angles that are not unique, which is no matter
                turn = Rotation.from_quat([*map(float, origin.attrib.pop("quat_xyzw").split())])
                origin.set("rpy", " ".join(map(repr, turn.as_euler("xyz").tolist())))
    return io.BytesIO(ElementTree.tostring(robot))
