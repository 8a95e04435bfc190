"""What a peer is given to do: a job file with the robot and the problems in it.

Every peer gets the same: the robot's URDF with its collision meshes, the pairs that may touch and the limits according
to its robot.toml, and each problem's boxes, cylinders, capsules and spheres in world
poses. Links that stand still are not judged against the scene.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import planner_service as ps
from benchmarks.baselines.peers.catalogue import Peer
from benchmarks.harness.suite import Motion
from planner_service.files.package_data import data_folder
from planner_service.files.writing import write_whole
from planner_service.geometry.composite import Solid

__all__ = ["Task", "job_of", "placed_robot", "write_job"]

VERSION = 1


@dataclass(frozen=True, eq=False)
class Task:
    """A problem and a seed: what a row is about."""

    problem: Motion
    seed: int


def placed_robot(robot: ps.Robot) -> dict[str, Any]:
    """A job's ``robot``.

    Raises:
        InvalidRequest: the robot's URDF is not in its folder of ``robots/``, as those of other packages are.
    """
    urdf = data_folder("robots") / robot.name / f"{robot.name}.urdf"
    if not urdf.is_file():
        raise ps.InvalidRequest(
            "robot", robot.name, "a robot whose URDF and meshes are in its own folder, as panda_mbm's are"
        )
    limits = robot.limits
    return {
        "name": robot.name,
        "urdf": str(urdf),
        "joints": list(robot.joint_names),
        "tool_frame": robot.tool_frame,
        "base_links": list(robot.base_links),
        "disabled_pairs": sorted(sorted(contact.links) for contact in robot.allowed_contacts),
        **{key: getattr(limits, key).tolist() for key in ("lower", "upper", "velocity", "acceleration", "jerk")},
    }


def job_of(peer: Peer, planner: str, robot: dict[str, Any], tasks: Sequence[Task], time_limit: float) -> dict[str, Any]:
    """The content of a job file.

    Raises:
        InvalidRequest: the peer has no such planner, or an obstacle is of a kind that no job can hold.
    """
    if planner not in peer.planners:
        raise ps.InvalidRequest("planner", planner, f"one of {', '.join(peer.planners)} of {peer.name}")
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
    if isinstance(shape, ps.Box):
        return {"kind": "box", "size": list(shape.size)}
    if isinstance(shape, ps.Sphere):
        return {"kind": "sphere", "radius": shape.radius}
    if isinstance(shape, (ps.Cylinder, ps.Capsule)):
        kind = "cylinder" if isinstance(shape, ps.Cylinder) else "capsule"
        return {"kind": kind, "radius": shape.radius, "length": shape.length}
    raise ps.InvalidRequest(f"obstacle {name}", type(shape).__name__, "a box, cylinder, capsule or sphere")
