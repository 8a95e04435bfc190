"""What a peer is given to do: a folder with the robot's files, and a job file with the problems in it.

Every peer gets the same: the robot's URDF with its collision meshes, an SRDF made from the pairs that may touch
according to its robot.toml, the limits of that file, and each problem's boxes, cylinders, capsules and spheres in world
poses. Links that stand still are not judged against the scene.
"""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from benchmarks.baselines.peers.catalogue import Peer
from benchmarks.harness.sources import Motion
from planner_service.errors import InvalidRequest
from planner_service.files.package_data import data_folder
from planner_service.files.writing import write_whole
from planner_service.geometry.composite import Solid
from planner_service.geometry.shapes import Box, Capsule, Cylinder, Sphere
from planner_service.robot.model import Robot

__all__ = ["Task", "job_of", "placed_robot", "write_job"]

VERSION = 1


@dataclass(frozen=True, eq=False)
class Task:
    """A problem and a seed: what a row is about."""

    problem: Motion
    seed: int


def placed_robot(robot: Robot, folder: Path) -> dict[str, Any]:
    """A job's ``robot``, with its files put into a folder.

    Raises:
        InvalidRequest: the robot's URDF is not in its folder of ``robots/``, as those of other packages are, or it has
            joints that the robot does not plan with.
    """
    source = data_folder("robots") / robot.name
    urdf = source / f"{robot.name}.urdf"
    if not urdf.is_file():
        raise InvalidRequest(
            "robot", robot.name, "a robot whose URDF and meshes are in its own folder, as panda_mbm's are"
        )
    shutil.copytree(source, folder, dirs_exist_ok=True)
    _limit(folder / urdf.name, robot)
    pairs = sorted(sorted(contact.links) for contact in robot.allowed_contacts)
    base = list(robot.base_links)
    srdf = folder / f"{robot.name}.srdf"
    write_whole(srdf, _srdf(robot, base[0], pairs))
    limits = robot.limits
    return {
        "name": robot.name,
        "urdf": str(folder / urdf.name),
        "srdf": str(srdf),
        "joints": list(robot.joint_names),
        "tool_frame": robot.tool_frame,
        "base_links": base,
        "disabled_pairs": pairs,
        **{key: getattr(limits, key).tolist() for key in ("lower", "upper", "velocity", "acceleration", "jerk")},
    }


def _limit(urdf: Path, robot: Robot) -> None:
    """Write the limits of robot.toml into a copy of its URDF: some peers look for them nowhere else."""
    tree = ElementTree.parse(urdf)
    limits = robot.limits
    moving = {joint.get("name") for joint in tree.iterfind("./joint") if joint.get("type") != "fixed"}
    if moving != set(robot.joint_names):
        others = ", ".join(sorted(str(name) for name in moving - set(robot.joint_names)))
        raise InvalidRequest("robot", robot.name, f"a robot all of whose joints are planned with; others are {others}")
    for k, name in enumerate(robot.joint_names):
        limit = tree.find(f"./joint[@name='{name}']/limit")
        assert limit is not None
        for key, values in (("lower", limits.lower), ("upper", limits.upper), ("velocity", limits.velocity)):
            limit.set(key, repr(float(values[k])))
    tree.write(urdf, encoding="utf-8")


def job_of(peer: Peer, planner: str, robot: dict[str, Any], tasks: Sequence[Task], time_limit: float) -> dict[str, Any]:
    """The content of a job file.

    Raises:
        InvalidRequest: the peer has no such planner, or an obstacle is of a kind that no job can hold.
    """
    if planner not in peer.planners:
        raise InvalidRequest("planner", planner, f"one of {', '.join(peer.planners)} of {peer.name}")
    return {
        "version": VERSION,
        "robot": robot,
        "settings": dict(peer.planners[planner]),
        "time_limit": time_limit,
        "problems": [_problem(task) for task in tasks],
    }


def write_job(job: dict[str, Any], path: Path) -> None:
    """The job as a file."""
    write_whole(path, json.dumps(job, allow_nan=False))


def _problem(task: Task) -> dict[str, Any]:
    return {
        "problem": task.problem.id,
        "seed": task.seed,
        "start": list(map(float, task.problem.start)),
        "goals": [list(map(float, goal)) for goal in task.problem.goals],
        "obstacles": [
            {
                "name": body.name,
                **_shape(body.name, body.shape),
                "position": list(body.pose.position),
                "quaternion_wxyz": list(body.pose.quaternion),
            }
            for body in task.problem.scene.obstacles
        ],
    }


def _shape(name: str, shape: Solid) -> dict[str, Any]:
    if isinstance(shape, Box):
        return {"kind": "box", "size": list(shape.size)}
    if isinstance(shape, Sphere):
        return {"kind": "sphere", "radius": shape.radius}
    if isinstance(shape, (Cylinder, Capsule)):
        kind = "cylinder" if isinstance(shape, Cylinder) else "capsule"
        return {"kind": kind, "radius": shape.radius, "length": shape.length}
    raise InvalidRequest(f"obstacle {name}", type(shape).__name__, "a box, cylinder, capsule or sphere")


def _srdf(robot: Robot, base: str, pairs: Sequence[Sequence[str]]) -> str:
    disabled = "".join(
        f"  <disable_collisions link1={quoteattr(a)} link2={quoteattr(b)} reason={quoteattr('Allowed')}/>\n"
        for a, b in pairs
    )
    chain = f"<chain base_link={quoteattr(base)} tip_link={quoteattr(robot.tool_frame)}/>"
    return (
        f'<?xml version="1.0"?>\n<robot name={quoteattr(_name(robot))}>\n  <group name="arm">{chain}</group>\n'
        f"{disabled}</robot>\n"
    )


def _name(robot: Robot) -> str:
    """What the URDF calls the robot."""
    return (
        ElementTree.parse(data_folder("robots") / robot.name / f"{robot.name}.urdf").getroot().get("name", robot.name)
    )
