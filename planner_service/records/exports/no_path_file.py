"""Proofs that no path exists, in files, for a verifier that shares no code with this package.

``auditor/verify_no_path.py`` checks one: that the boxes it names as walls collide, and that they enclose the start or
all goals; ``docs/guides/proofs-for-others.md`` describes the format.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from planner_service.files.reading import as_path
from planner_service.files.writing import write_whole
from planner_service.geometry.composite import Compound, Solid
from planner_service.geometry.mesh import Mesh
from planner_service.infeasibility import NoPath
from planner_service.planning.request import World
from planner_service.records.evidence import boxes_of, packed
from planner_service.records.plan_file import OURS
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import MeshRecord, SceneRecord
from planner_service.robot.model import joint_vector
from planner_service.scene.names import Kind, Owner, owner_of

__all__ = ["NO_PATH_FORMAT", "no_path_document", "save_no_path"]

NO_PATH_FORMAT = "planner-service/no-path"
VERSION = 1


def save_no_path(
    proof: NoPath,
    world: World,
    start: object,
    goals: Sequence[object],
    path: str | os.PathLike[str],
) -> None:
    """Write a proof to a file, whole or not at all.

    Args:
        world: What it was proven in.
        start: Configuration (n,) in radians (metres for joints that slide), the one of the proof.
        goals: Configurations (n,), those of the proof.

    Raises:
        InvalidRequest: start or goals are no configurations.
        InvalidFile: it cannot be written.
    """
    document = no_path_document(proof, world, start, goals)
    write_whole(as_path("path", path), json.dumps(document, allow_nan=False) + "\n", OURS)


def no_path_document(proof: NoPath, world: World, start: object, goals: Sequence[object]) -> dict[str, Any]:
    """What a file of a proof holds; see ``save_no_path``."""
    robot, scene = world.robot, world.scene
    named = {owner_of(label, robot) for pair in proof.pairs for label in pair}
    links = [item.shape for item in robot.shapes if Owner(Kind.LINK, item.link) in named]
    there = [item for items in (scene.obstacles, scene.attached) for item in items]
    objects = [item.shape for item in there if Owner(Kind.OBJECT, item.name) in named]
    meshes = dict(_faces([*links, *objects]))
    row = 2 * len(proof.joints)
    walls = np.column_stack([proof.wall_cells.reshape(-1, row), proof.wall_pairs])
    return {
        "format": NO_PATH_FORMAT,
        "version": VERSION,
        "robot": RobotRecord.of(robot).document(),
        "scene": SceneRecord.of(scene).document(),
        "allowed": sorted(sorted(pair) for pair in world.allowed),
        "start": list(joint_vector("start", start, robot)),
        "goals": [list(joint_vector(f"goals[{k}]", goal, robot)) for k, goal in enumerate(goals)],
        "moved": 0.0 if robot.gripper is None else robot.gripper.position(robot.gripper_width),
        "boxes": boxes_of(scene),
        "faces": meshes,
        "joints": list(proof.joints),
        "range": [proof.range_lower.tolist(), proof.range_upper.tolist()],
        "divisions": proof.divisions.tolist(),
        "encloses": proof.encloses,
        "region": packed(proof.region_cells.reshape(-1, row), "<i8"),
        "pairs": [list(pair) for pair in proof.pairs],
        "walls": packed(walls, "<i8"),
        "centres": packed(proof.witness.centres.reshape(-1, 6), "<f8"),
    }


def _faces(solids: Iterable[Solid]) -> Iterator[tuple[str, str]]:
    """The triangles that bound each mesh, by the SHA-256 of the text of its corners."""
    for solid in solids:
        if isinstance(solid, Compound):
            yield from _faces(shape for shape, _ in solid.parts)
        elif isinstance(solid, Mesh):
            corners = MeshRecord.of(solid).document()["vertices"]
            yield hashlib.sha256(corners.encode()).hexdigest(), packed(solid.faces, "<i4")
