"""Explanations as JSON: what is read is what was written, and what makes no sense is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Cylinder, InvalidFile, Obstacle, Pose, Scene, load_robot
from planner_service.files.schema import read_record
from planner_service.infeasibility import NoPath, prove_no_path
from planner_service.planning.request import World
from planner_service.records.exports.explanation import NoPathRecord
from planner_service.records.exports.no_path_file import no_path_document
from planner_service.records.scene import PlanReading, packed
from tests.support.optional import present

ARM = load_robot("planar2")
DISCS = Scene(tuple(Obstacle(name, Cylinder(0.1, 0.2), Pose((0.5, y, 0.0))) for name, y in (("l", 0.5), ("r", -0.5))))
PROOF = present(prove_no_path(ARM, DISCS, [0.0, 0.0], [[3.0, 0.0]]))


def read(document: Any) -> NoPath:
    proof: NoPath = read_record(NoPathRecord, document, Path("answer"), PlanReading(joints=2)).value
    return proof


def written() -> dict[str, Any]:
    document: dict[str, Any] = json.loads(json.dumps(NoPathRecord.of(PROOF).document()))
    return document


def test_a_proof_is_what_it_was() -> None:
    files = [no_path_document(proof, World(ARM, DISCS), [0.0, 0.0], [[3.0, 0.0]]) for proof in (PROOF, read(written()))]
    assert files[0] == files[1]
    assert read(written()).witness.depths.tolist() == PROOF.witness.depths.tolist()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("divisions", [4, 4], "one number for each of the 1 joints"),
        ("joints", [], "at least one"),
        ("encloses", "nothing", "encloses"),
        ("region", "%", "base64 of rows of 2"),
        ("walls", packed(np.array([[0, 1, 7]]), "<i8"), "numbers of the"),
        ("witness", packed(np.full((len(PROOF.wall_pairs), 8), math.nan), "<f8"), "finite numbers for each of"),
    ],
)
def test_what_makes_no_sense_is_refused(key: str, value: Any, message: str) -> None:
    with pytest.raises(InvalidFile, match=message):
        read(written() | {key: value})
