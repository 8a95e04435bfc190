"""Files of proofs that no path exists, judged by ``auditor/verify_no_path.py``: numpy alone, and no forgery passes."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from auditor.schema import Invalid
from auditor.verify_no_path import in_mesh, verify
from planner_service import (
    Box,
    Cylinder,
    HeightField,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Scene,
    load_robot,
)
from planner_service.cli.commands import app
from planner_service.geometry.mesh import Mesh
from planner_service.infeasibility import prove_no_path
from planner_service.planning.request import World
from planner_service.records.evidence import boxes_of
from planner_service.records.exports.no_path_file import no_path_document
from planner_service.records.scene import MeshRecord, SceneRecord
from tests.support.optional import present
from tests.support.small_robots import built, joint, link, solid, urdf

Document = dict[str, Any]

ARM = load_robot("planar2")
DISCS = Scene(tuple(Obstacle(name, Cylinder(0.1, 0.2), Pose((0.5, y, 0.0))) for name, y in (("l", 0.5), ("r", -0.5))))

SPINNER = urdf(
    "spinner",
    link("foot", solid("sphere", 'radius="0.05"')) + link("bar", solid("box", "0.6 0.04 0.04", "0.3 0 0")),
    joint("spin", "continuous foot bar", xyz="0 0 0.2"),
)


def array(text: str, kind: str, columns: int) -> Any:
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), kind).reshape(-1, columns).copy()


def packed(table: Any, kind: str) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(table).astype(kind).tobytes())).decode()


def document(scene: Scene, start: Any, goal: Any, robot: Any = ARM) -> Document:
    proof = present(prove_no_path(robot, scene, start, [goal]))
    found: Document = json.loads(json.dumps(no_path_document(proof, World(robot, scene), start, [goal])))
    return found


@pytest.fixture(scope="module")
def plain() -> Document:
    return document(DISCS, [0.0, 0.0], [3.0, 0.0])


WAY_ROUND = [0.0, -1.0], [0.0, 1.0]
"""Between them the arm is free to move where nothing stands."""


def empty(encloses: str, divisions: list[int], region: list[int], start: list[float]) -> Document:
    """A file without a wall, of a scene without an object."""
    copy = document(DISCS, [0.0, 0.0], [3.0, 0.0])
    copy["scene"] |= {"obstacles": []}
    copy |= {"joints": list(ARM.joint_names), "range": [ARM.limits.lower.tolist(), ARM.limits.upper.tolist()]}
    copy |= {"start": start, "goals": [WAY_ROUND[1]], "encloses": encloses, "divisions": divisions, "pairs": []}
    columns = {"region": [region], "walls": np.zeros((0, 5))}
    packs = {name: packed(table, "<i8") for name, table in columns.items()}
    return copy | packs | {"centres": packed(np.zeros((0, 6)), "<f8")}


def test_a_region_is_enclosed_along_every_joint() -> None:
    with pytest.raises(Invalid, match="a range or divisions of other joints"):
        list(verify(empty("start", [16], [0, 0, 16, 8], WAY_ROUND[0])))


def test_an_end_a_little_beyond_a_limit_is_one_at_the_limit_as_for_planners() -> None:
    start = [float(ARM.limits.upper[0]) + 0.005, 0.0]
    assert PlannerService(ARM, Scene()).plan(PlanRequest(start, WAY_ROUND[1])).ok
    with pytest.raises(Invalid, match="is not where the proof needs it"):
        list(verify(empty("goals", [16, 16], [0, 0, 16, 16], start)))


def test_an_end_that_is_not_finite_is_none(plain: Document) -> None:
    with pytest.raises(Invalid, match=r"start\[0\]: got nan"):
        list(verify(plain | {"start": [np.nan, 0.0]}))


def test_cells_do_not_fill_a_box_that_is_inside_out() -> None:
    """Its volume is below 0, which is less than what any cells fill."""
    y = (0.5, -0.5)
    boxes = [Obstacle(name, Box((0.2, 0.2, 0.3)), Pose((0.5, at, 0.0))) for name, at in zip("lr", y, strict=True)]
    far = PointCloud(np.array([[3.0, 3.0, 3.0]]), 0.02)
    forged = document(Scene(tuple(boxes)), [0.0, 0.0], [3.0, 0.0])
    scene = Scene(tuple(replace(box, shape=far) for box in boxes))
    forged["scene"] = json.loads(json.dumps(SceneRecord.of(scene).document()))
    for name, text in boxes_of(scene).items():
        inside_out = [0.1, -0.1, -0.15, -0.1, 0.1, 0.15]
        forged["boxes"][name] = packed([*array(text, "<f8", 6), inside_out], "<f8")
    with pytest.raises(Invalid, match="the boxes of the evidence are not made of its cells"):
        list(verify(forged))


@pytest.mark.parametrize(
    "shape",
    [
        Mesh(np.random.default_rng(3).uniform(-0.1, 0.1, (40, 3))),
        PointCloud(np.random.default_rng(0).uniform(-0.08, 0.08, (20_000, 3)), 0.02),
        HeightField(np.full((8, 8), 0.3), 0.02),
    ],
    ids=["mesh", "cloud", "heights"],
)
def test_walls_of_all_kinds_of_solids_are_shown_around_a_joint_without_end(tmp_path: Path, shape: Any) -> None:
    low = -0.08 if isinstance(shape, HeightField) else 0.0
    posts = [Obstacle(f"post_{y}", shape, Pose((low, y + low, 0.2 + 1.9 * low))) for y in (-0.4, 0.4)]
    found = document(Scene(tuple(posts)), [0.0], [3.0 + 2.0 * np.pi], built(tmp_path, SPINNER))
    assert list(verify(found))
    found["goals"] = [[0.2]]
    with pytest.raises(Invalid, match="not where the proof needs it"):
        list(verify(found))


def test_a_mesh_that_is_not_closed_holds_no_ball() -> None:
    mesh = Mesh(np.random.default_rng(4).normal(size=(30, 3)))
    record, centre = MeshRecord.of(mesh).document(), np.zeros((1, 3))
    deep = in_mesh(record, centre, packed(mesh.faces, "<i4"))
    assert deep == pytest.approx((mesh.offsets - mesh.normals @ centre[0]).min(), abs=1e-12)
    assert in_mesh(record, centre + 9.0, packed(mesh.faces, "<i4")) == -np.inf
    with pytest.raises(Invalid, match="do not close"):
        in_mesh(record, centre, packed(mesh.faces[1:], "<i4"))


def wall_moved(copy: Document) -> None:
    table = array(copy["walls"], "<i8", 3)
    table[0, :2] += 1
    copy["walls"] = packed(table, "<i8")


def wall_dropped(copy: Document) -> None:
    copy["walls"], copy["centres"] = packed(np.zeros((0, 3)), "<i8"), packed(np.zeros((0, 6)), "<f8")


def region_laid_twice(copy: Document) -> None:
    region = array(copy["region"], "<i8", 2)
    copy["region"] = packed(np.concatenate([region, region[:1]]), "<i8")


def obstacle_shrunk(copy: Document) -> None:
    for item in copy["scene"]["obstacles"]:
        item["shape"]["radius"] = 0.01


def point_moved(copy: Document) -> None:
    copy["centres"] = packed(array(copy["centres"], "<f8", 6) + 0.1, "<f8")


def start_moved(copy: Document) -> None:
    copy["start"] = [2.9, 0.0]


def goal_added(copy: Document) -> None:
    copy["goals"].append([0.1, 0.0])


def limits_widened(copy: Document) -> None:
    copy["robot"]["limits"]["upper"][0] += 1.0


def pair_allowed(copy: Document) -> None:
    copy["allowed"] = copy["pairs"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (wall_moved, "overlap|open at"),
        (wall_dropped, "open at"),
        (region_laid_twice, "overlap"),
        (obstacle_shrunk, "not shown to collide"),
        (point_moved, "not shown to collide"),
        (start_moved, "not where"),
        (goal_added, "not where"),
        (limits_widened, "ranges"),
        (pair_allowed, "need not be apart"),
    ],
)
def test_a_forgery_is_refused(plain: Document, change: Callable[[Document], None], why: str) -> None:
    copy = deepcopy(plain)
    change(copy)
    with pytest.raises(Invalid, match=why):
        list(verify(copy))


def test_explain_saves_the_proof_that_it_finds(tmp_path: Path) -> None:
    file = tmp_path / "proof.json"
    disc = '[[obstacle]]\nname = "{}"\ncylinder = {{ radius = 0.1, length = 0.2 }}\nposition = [0.5, {}, 0.0]\n'
    (tmp_path / "discs.toml").write_text(disc.format("left", 0.5) + disc.format("right", -0.5))
    asked = ["--robot", "planar2", "--scene", str(tmp_path / "discs.toml"), "--start", "0,0", "--goal", "3,0"]
    done = CliRunner().invoke(app, ["explain", *asked, "--plans", "1", "--max-checks", "2000", "--evidence", str(file)])
    assert f"the proof that no path exists is in {file}" in done.output.replace("\n", " ").replace("  ", " ")
    assert list(verify(json.loads(file.read_text())))
