"""Reachability maps in npz files: whole, without pickles, and not believed when they are read."""

from __future__ import annotations

import io
import json
import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files import schema
from planner_service.files.json_reader import MAX_BYTES as MAX_HEAD
from planner_service.files.json_reader import parse_json
from planner_service.files.reading import as_path
from planner_service.files.schema import Record, Text, Vector3, Vector4
from planner_service.files.writing import write_whole
from planner_service.geometry.scans import arrays_of
from planner_service.geometry.validation import flag, in_file, instance
from planner_service.robot.model import Robot
from planner_service.scene.scene import Scene
from planner_service.workspace.grid import VoxelGrid
from planner_service.workspace.mapping import require_witnesses
from planner_service.workspace.orientation import ToolOrientation
from planner_service.workspace.reachability_map import ReachabilityMap, VoxelVerdict

__all__ = ["load_map", "save_map"]

FORMAT, VERSION = "planner-service/reachability", 1

SUFFIX = ".npz"

OURS = re.compile(rb"PK\x03\x04.{26}head\.npy", re.DOTALL)
"""How these files begin: an archive whose first member is the head."""

MAX_BYTES = 1_000_000_000
"""Twenty million voxels, all with witnesses of six joints."""

HEAD = "head"
"""The array that holds all but the arrays: the bytes of a JSON object."""

ARRAYS = (HEAD, "still", "verdicts", "done", "witnesses")
"""All arrays of a file."""


def save_map(found: ReachabilityMap, path: str | os.PathLike[str]) -> None:
    """Write a map to an npz file (of that suffix), whole or not at all.

    Raises:
        InvalidRequest: The path does not end in ``.npz``, or the file would be too large to be loaded again.
        InvalidFile: It cannot be written.
    """
    instance("found", found, ReachabilityMap, "a ReachabilityMap")
    target = as_path("path", path)
    if target.suffix.lower() != SUFFIX:
        raise InvalidRequest("path", os.fspath(path), f"a path that ends in {SUFFIX}")
    head = {
        "format": FORMAT,
        "version": VERSION,
        "robot": found.robot,
        "scene": found.scene,
        "lower": found.grid.lower,
        "upper": found.grid.upper,
        "counts": found.grid.counts,
        "orientations": [
            {"quaternion_wxyz": each.quaternion, "tolerance": each.tolerance, "free_axis": each.free_axis}
            for each in found.orientations
        ],
    }
    text = json.dumps(head, sort_keys=True, allow_nan=False).encode("ascii")
    arrays = {
        "still": found.still,
        "verdicts": found.verdicts,
        "done": found.done.astype(np.uint8),
        "witnesses": found.witnesses,
    }
    packed = io.BytesIO()
    np.savez(packed, **{HEAD: np.frombuffer(text, dtype=np.uint8)}, **arrays)  # type: ignore[arg-type]
    if packed.tell() > MAX_BYTES:
        raise InvalidRequest("found", f"{packed.tell():,} bytes", f"a map that fits in {MAX_BYTES:,} bytes")
    write_whole(target, packed.getvalue(), OURS)


def load_map(path: str | os.PathLike[str], robot: Robot, scene: Scene, *, trusted: bool = False) -> ReachabilityMap:
    """The map in a file, for the robot and scene that it is about.

    Each witness is looked at: that the tool is in its voxel, and the configuration within the limits and free. What the
    file calls proven was not proven here, hence ``VoxelVerdict.SAID_UNREACHABLE``; ``prove_again`` proves it.

    Args:
        trusted: You made the file yourself and nobody changed it: its proofs are taken over, as to resume a map.

    Raises:
        InvalidFile: No map of this version, one of another robot or scene, or a witness is none.
    """
    source = as_path("path", path)
    instance("robot", robot, Robot, "a Robot")
    instance("scene", scene, Scene, "a Scene")
    believed = flag("trusted", trusted)
    if source.suffix.lower() != SUFFIX:
        raise InvalidFile(source, [f"suffix {source.suffix!r}; expected {SUFFIX}"])
    array = arrays_of(source, MAX_BYTES, ARRAYS)
    head = schema.read_record(HeadRecord, _document(source, array(HEAD, "u")), source, schema.Reading())
    verdicts = array("verdicts", "u")
    if not believed:
        verdicts = verdicts.copy()
        verdicts[(verdicts == VoxelVerdict.OUT_OF_REACH) | (verdicts == VoxelVerdict.BLOCKED)] = (
            VoxelVerdict.SAID_UNREACHABLE
        )

    def made() -> ReachabilityMap:
        grid = VoxelGrid(tuple(head.lower), tuple(head.upper), tuple(head.counts))  # type: ignore[arg-type]
        sets = tuple(each.value for each in head.orientations)
        still, done = array("still", "f"), array("done", "u")
        if int(done.max(initial=0)) > 1:
            raise InvalidRequest("done", int(done.max()), "zeros and ones")
        found = ReachabilityMap(
            grid, sets, head.robot, head.scene, still, verdicts, array("witnesses", "f"), done.astype(np.bool_)
        )
        require_witnesses(found, robot, scene)
        return found

    return in_file(source, made)


def _document(path: Path, codes: NDArray[Any]) -> dict[str, Any]:
    """The JSON object in a file; InvalidFile if it is another file, or of another version."""
    if codes.ndim != 1 or codes.dtype != np.uint8 or len(codes) > MAX_HEAD:
        raise InvalidFile(path, [f"no reachability map: {HEAD}: expected at most {MAX_HEAD:,} bytes"])
    try:
        document = parse_json(path, codes.tobytes())
    except InvalidFile as error:
        raise InvalidFile(path, [f"no reachability map: {HEAD}: {each}" for each in error.problems]) from None
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise InvalidFile(path, [f"no reachability map: expected the format {FORMAT!r}"])
    version = document.get("version")
    if type(version) is not int or version != VERSION:
        shown = repr(version) if "version" in document else "is missing"
        raise InvalidFile(path, [f"version {shown}; this package reads version {VERSION}"])
    return document


class OrientationRecord(Record, makes=ToolOrientation):
    """``ToolOrientation``."""

    quaternion: Vector4 = Field(alias="quaternion_wxyz")
    tolerance: float
    free_axis: Vector3 | None


class HeadRecord(Record):
    """All of a map but its arrays."""

    format: Literal["planner-service/reachability"]
    version: Literal[1]
    robot: Text
    scene: Text
    lower: Vector3
    upper: Vector3
    counts: Annotated[list[schema.Count], schema.of_length(3, "three whole numbers")]
    orientations: Annotated[list[OrientationRecord], schema.FirstOnly()]
