"""Plan files with evidence: the trail of each proof, for a verifier that shares no code with this package.

The section ``evidence`` of a file says for each motion, and for each opening and closing of the gripper, on which
stretches of its curve which pieces are apart, and along which directions one sees it. ``auditor/verify.py`` checks that
with arithmetic of its own and searches for nothing; ``docs/guides/proofs-for-others.md`` describes the format.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner_service.certify import Certificate, Trail
from planner_service.certify.motion_bounds import Motion
from planner_service.errors import InvalidRequest
from planner_service.geometry.arrays import FloatArray
from planner_service.geometry.composite import HeightField, PointCloud
from planner_service.geometry.shapes import Box
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import TaskResult
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.records.recertify import ProvenMotion, recertify
from planner_service.records.result import certificate_record
from planner_service.records.robot import RobotRecord
from planner_service.records.scene import SceneRecord
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene

__all__ = ["EVIDENCE", "UNIT", "boxes_of", "digest_of", "packed", "save_plan", "trail_record", "with_evidence"]

EVIDENCE = "evidence"
"""The section's name."""

VERSION = 5

FASTEST = 1
"""Of zlib's levels: the best makes a trail a tenth smaller and takes longer than the proof."""

UNIT = 2**30
"""Directions are written in whole parts of this: a bound changes by some nanometres."""


def with_evidence(plan: SavedPlan | SavedTask) -> SavedPlan | SavedTask:
    """The same plan or task, proven anew, with these proofs as its certificates and their trails as evidence.

    Raises:
        NotProven: it cannot be proven; pairs that it was made with as ``allowed`` are allowed.
        InvalidRequest: it is no plan but a failure.
    """
    proven = recertify(plan, allowed=plan.allowed, padding=_padding(plan), tracing=True).required()
    certificates = [motion.certificate for motion in proven.motions]
    if isinstance(plan, SavedPlan):
        plan = replace(plan, result=replace(plan.result, certificate=certificates[0]))
    else:
        results = [replace(s.result, certificate=c) for s, c in zip(plan.segments, certificates, strict=True)]
        segments = [
            replace(segment, result=result, gripper=motion.gripper)
            for segment, result, motion in zip(plan.segments, results, proven.motions, strict=True)
        ]
        plan = replace(plan, segments=tuple(segments))
    scenes = [motion.motion.scene for motion in proven.motions]
    section = {
        "version": VERSION,
        "robot": _robot_digest(plan.robot),
        "scene": digest_of(SceneRecord.of(plan.scene).document()),
        "boxes": boxes_of(*scenes),
        "proofs": [proof for k, motion in enumerate(proven.motions) for proof in _proofs(k, motion)],
    }
    return replace(plan, sections={**plan.sections, EVIDENCE: section})


def save_plan(plan: PlanResult | TaskResult | SavedPlan | SavedTask, path: str | os.PathLike[str]) -> None:
    """Write a plan or a task, or the failure that is in their place; the file is there whole or not at all.

    If its request says so and it has no evidence yet, it gets some.

    Raises:
        InvalidRequest: a result from a file or another process, which does not know its world, or a value that
            cannot be written.
        NotProven: it should get evidence and cannot be proven.
        InvalidFile: it cannot be written.
    """
    if isinstance(plan, PlanResult):
        plan = SavedPlan.of(plan)
    elif isinstance(plan, TaskResult):
        plan = SavedTask.of(plan)
    elif not isinstance(plan, SavedPlan | SavedTask):
        raise InvalidRequest("plan", plan, "a PlanResult, a TaskResult, a SavedPlan or a SavedTask")
    if plan.request is not None and plan.request.evidence and EVIDENCE not in plan.sections and plan.failure is None:
        plan = with_evidence(plan)
    plan.save(path)


def _padding(plan: SavedPlan | SavedTask) -> float:
    """The padding with which all of it was proven."""
    proofs = [segment.result.certificate for segment in plan.segments]
    return min((proof.padding for proof in proofs if proof is not None), default=0.0)


@lru_cache(maxsize=16)
def _robot_digest(robot: Robot) -> str:
    return digest_of(RobotRecord.of(robot).document())


def digest_of(record: dict[str, Any]) -> str:
    """SHA-256 of a record, in hex."""
    return hashlib.sha256(json.dumps(record, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _proofs(number: int, proven: ProvenMotion) -> Iterator[dict[str, Any]]:
    """The trails of the gripper's motion before a motion, if there is one, and of the motion."""
    motion, trails = proven.motion, proven.trails
    if proven.gripper is not None:
        gripper = proven.gripper
        fingers = _fingers(motion.robot, gripper.start, gripper.end)
        yield {"motion": number, **fingers, **trail_record(trails[1], gripper.certificate)}
    width = motion.robot.gripper_width
    yield {"motion": number, **_fingers(motion.robot, width, width), **trail_record(trails[0], proven.certificate)}


def _fingers(robot: Robot, before: float, after: float) -> dict[str, Any]:
    """Widths of the gripper, and how far its fingers are moved at these, so that a verifier need not search for it."""
    moved = [0.0 if robot.gripper is None else robot.gripper.position(width) for width in (before, after)]
    return {"gripper": [before, after], "moved": moved}


def trail_record(trail: Trail, certificate: Certificate) -> dict[str, Any]:
    """What a proof rests on: its claim, and the table of stretches.

    A row is a pair, the numbers of the places where its stretch begins and ends, and the directions there.
    """
    if trail.motion is None or trail.path is None:
        raise AssertionError("a proof fills in its trail")
    motion, leaves = trail.motion, trail.leaves
    s, ends = np.unique(leaves[:, 1:3], return_inverse=True)
    ends = ends.reshape(-1, 2)
    if len(s) == 1:  # a path on which nothing moves: one stretch of length 0
        s, ends = np.repeat(s, 2), ends + np.arange(2)
    used, pair = np.unique(leaves[:, 0].astype(np.int64), return_inverse=True)
    rotations = motion.poses(trail.path(s))[:, :3].transpose(2, 3, 0, 1)
    second = motion.listed.of(leaves[:, 0].astype(np.int64))[:, 1]
    directions = [_in_base(leaves[:, 3 * k + 3 : 3 * k + 6], motion, rotations, second, ends[:, k]) for k in (0, 1)]
    rows = np.column_stack([pair, ends, *(np.rint(n * UNIT).astype(np.int64) for n in directions)])
    claim, crowd = certificate_record(certificate), motion.listed.numbers[list(motion.listed.crowd)]
    return {
        **{name: claim[name] for name in ("clearance", "padding", "exempt", "part")},
        "s": packed(s, "<f8"),
        "pairs": packed(motion.listed.runs(used), "<i4"),
        "rows": packed(rows, "<i4"),
        **({"crowd": packed(crowd, "<i4")} if len(crowd) else {}),
    }


def _in_base(
    n: FloatArray, motion: Motion, rotations: FloatArray, piece: NDArray[np.intp], node: NDArray[np.intp]
) -> FloatArray:
    """Directions (k, 3) in the axes of pieces at nodes, in those of the base.

    Args:
        rotations: Which way the pieces that ride stand at nodes, (m, riding, 3, 3).
    """
    rides = piece < motion.riding
    turns = np.empty((len(piece), 3, 3))
    turns[rides] = rotations[node[rides], piece[rides]]
    turns[~rides] = motion.listed.axes_of(piece[~rides])
    return np.asarray(np.einsum("kij,kj->ki", turns, n))


def boxes_of(*scenes: Scene) -> dict[str, str]:
    """The boxes that make up each cloud and height field, lower corners and upper ones in its own axes, packed."""
    solids = {
        item.name: item.shape for scene in scenes for items in (scene.obstacles, scene.attached) for item in items
    }
    out = dict[str, str]()
    for name, solid in solids.items():
        if isinstance(solid, PointCloud | HeightField):
            parts = solid.pieces
            half = np.array([box.half for box in parts.kinds if isinstance(box, Box)])[parts.numbers]
            out[name] = packed(np.column_stack([parts.positions - half, parts.positions + half]), "<f8")
    return out


def packed(array: NDArray[Any], kind: str) -> str:
    """The bytes of an array, compressed, as base64."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(array).astype(kind).tobytes(), FASTEST)).decode("ascii")
