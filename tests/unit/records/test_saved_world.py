"""A plan or task file holds the world it was made in: robot, scene, terms, and what each motion of a task carries."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from planner_service import (
    Attached,
    Box,
    Capsule,
    Compound,
    Cylinder,
    HeightField,
    InvalidFile,
    InvalidRequest,
    Mesh,
    MotionStep,
    Obstacle,
    PlannerService,
    PlanRequest,
    PointCloud,
    Pose,
    Scene,
    Sphere,
    load_robot,
)
from planner_service.certify import ExemptInterval
from planner_service.cli.commands import app
from planner_service.geometry.composite import Solid
from planner_service.planning.request import World
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan, load_plan_or_task, load_task
from planner_service.records.scene import CloudRecord
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present

Document = dict[str, Any]

TURNED = Pose((0.9, -0.7, 0.3), (0.8, 0.0, 0.36, 0.48))


def same(a: Any, b: Any, where: str = "") -> None:
    """Fail unless two values of this package are equal in every field that a file keeps, to the last bit."""
    assert type(a) is type(b), where
    if isinstance(a, np.ndarray):
        assert (a.shape, a.tobytes()) == (b.shape, b.tobytes()), where
    elif is_dataclass(a) and not isinstance(a, Mesh | PointCloud | HeightField):
        for item in fields(a):
            if item.name == "description":  # where a robot's URDF lies on this machine: not for a file
                continue
            same(getattr(a, item.name), getattr(b, item.name), f"{where}.{item.name}")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), where
        for k, (one, other) in enumerate(zip(a, b, strict=True)):
            same(one, other, f"{where}[{k}]")
    else:
        assert a == b, where


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar2", "ur5", "wxai_dual", "kinova_gripper"])
def test_a_robot_comes_back_from_a_file_and_plans_the_same_again(name: str, tmp_path: Path) -> None:
    robot = load_robot(name)
    service = PlannerService(robot, Scene((Obstacle("ball", Sphere(0.05), TURNED),)))
    near = np.where(robot.home + 0.05 < robot.limits.upper, robot.home + 0.05, robot.home - 0.05)
    result = service.plan(PlanRequest(robot.home, near, time_limit=None))
    result.save(tmp_path / "plan.json")
    read = load_plan(tmp_path / "plan.json")
    same(read.robot, robot, name)
    assert read.robot.hash == robot.hash
    again = read.service().plan(present(read.request))
    assert again.counts == result.counts
    assert again.unwrap()[0].waypoints.tobytes() == result.unwrap()[0].waypoints.tobytes()
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "plan.json").read_bytes()


SOLIDS: tuple[Solid, ...] = (
    Box((0.1, 0.2, 1 / 3)),
    Sphere(1 / 7),
    Cylinder(0.1, 0.3),
    Capsule(0.1, 0.3),
    Mesh(np.random.default_rng(3).normal(size=(50, 3)) / 7),
    Compound(((Box((0.1, 0.2, 0.3)), TURNED), (Mesh(np.random.default_rng(4).normal(size=(9, 3))), Pose()))),
    PointCloud(np.random.default_rng(5).normal(size=(200, 3)), 0.03),
    HeightField(np.random.default_rng(6).uniform(0.1, 0.3, size=(5, 7)), 0.05, -0.1),
)
"""One of each kind."""

EVERYTHING = Scene(
    tuple(Obstacle(f"thing {k}", solid, Pose((3.0 + k, 0.1, -0.0))) for k, solid in enumerate(SOLIDS)),
    (Attached("tool", SOLIDS[4], Pose((0.1, 0.0, 0.0)), ("link_2",)),),
    "everything",
    "two\nlines",
)


def test_a_scene_of_every_kind_of_solid_comes_back_from_a_file(tmp_path: Path) -> None:
    robot = load_robot("planar2")
    result = PlannerService(robot, "empty").plan(PlanRequest(robot.home, robot.home))
    save_plan(SavedPlan(World(robot, EVERYTHING), None, result), tmp_path / "plan.json")
    read = load_plan(tmp_path / "plan.json").scene
    same(read, EVERYTHING)
    assert read.hash == EVERYTHING.hash


CLOUD = PointCloud(np.random.default_rng(5).normal(size=(20_000, 3)), 0.03)
ROWS = base64.b64encode(CLOUD.cells.astype("<i8").tobytes()).decode()
STEPS: str = CloudRecord.of(CLOUD).document()["packed"]


def cloud_of(**texts: str) -> PointCloud:
    return CloudRecord.model_validate({"kind": "cloud", "resolution": 0.03, **texts}).value


def test_a_cloud_takes_a_sixth_of_what_it_took_and_is_read_as_it_was_written_before() -> None:
    assert 6 * len(STEPS) < len(ROWS)
    assert cloud_of(packed=STEPS) == cloud_of(cells=ROWS) == CLOUD
    assert np.array_equal(cloud_of(packed=STEPS).cells, CLOUD.cells)


@pytest.mark.parametrize(
    "texts",
    [
        {},
        {"packed": STEPS, "cells": ROWS},
        {"packed": ROWS},
        {"packed": base64.b64encode(base64.b64decode(STEPS)[:-3]).decode()},
        {"packed": base64.b64encode(base64.b64decode(STEPS) + b"more").decode()},
        {"packed": base64.b64encode(zlib.compress(bytes(12 * 2_000_000))).decode()},
        {"packed": base64.b64encode(zlib.compress(bytes(16))).decode()},
        {"packed": "no base64"},
    ],
    ids=["neither", "both", "rows", "cut off", "followed", "too many", "a part of a cell", "no base64"],
)
def test_a_cloud_that_is_packed_otherwise_is_refused(texts: dict[str, str]) -> None:
    with pytest.raises(InvalidRequest, match=r"^packed: "):
        cloud_of(**texts)


@pytest.fixture(scope="module")
def task() -> SavedTask:
    service = PlannerService("wxai", "bin")
    home = service.robot.home
    return SavedTask.of(plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home, time_limit=None)))


def test_each_motion_of_a_task_knows_its_gripper_and_what_it_carries(task: SavedTask, tmp_path: Path) -> None:
    task.save(tmp_path / "task.json")
    read = load_task(tmp_path / "task.json")
    here = read.begin
    for before, after in zip(task.segments, read.segments, strict=True):
        here = after.world_after(here)
        assert here.scene == present(before.result.origin).world.scene
        assert here.robot.hash == present(before.result.origin).world.robot.hash
    carrying = [segment.name for segment in read.segments if segment.scene is not None and segment.scene.attached]
    assert carrying == ["lift", "transfer", "lower"]
    read.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "task.json").read_bytes()


def test_a_result_that_knows_no_service_is_not_saved_by_itself(tmp_path: Path) -> None:
    service = PlannerService("planar2", "discs")
    result = service.plan(PlanRequest(service.robot.home, service.robot.home))
    with pytest.raises(InvalidRequest, match=r"expected SavedPlan\(service.world, request, result\)"):
        save_plan(replace(result, origin=None), tmp_path / "plan.json")
    with pytest.raises(InvalidRequest, match=r"plan: got 7; expected a PlanResult"):
        save_plan(7, tmp_path / "plan.json")  # type: ignore[arg-type]


def test_pairs_that_the_caller_allowed_stand_in_certificate_result_and_file(tmp_path: Path) -> None:
    pair = ("forearm", "lesson_disc")
    service = PlannerService("planar2", "discs", allowed=[pair])
    result = service.plan(PlanRequest(service.robot.home, service.robot.home))
    assert present(result.certificate).allowed == result.allowed == service.allowed == (("forearm", "lesson_disc"),)
    result.save(tmp_path / "plan.json")
    read = load_plan(tmp_path / "plan.json")
    assert (read.allowed, read.result.allowed) == (service.allowed, service.allowed)
    assert read.service().allowed == service.allowed
    assert load_plan(tmp_path / "plan.json").result.certificate == present(result.certificate)


@dataclass(frozen=True)
class OwnStep:
    """A rule that no file can hold."""

    def segments(self, dq: Any, reach: Any) -> int:
        return MotionStep(0.02).segments(dq, reach)


def test_an_edge_step_of_ones_own_is_known_to_be_unknown(tmp_path: Path) -> None:
    service = PlannerService("planar2", "discs", edge_step=OwnStep())
    service.plan(PlanRequest(service.robot.home, service.robot.home)).save(tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").begin.edge_step is None
    told = CliRunner().invoke(app, ["certify", str(tmp_path / "plan.json")])
    assert "planned with a custom edge step" in " ".join(told.stdout.split())


# Files that say something else.


def document_of(result_of: Callable[[PlannerService], Any] | None = None) -> Document:
    service = PlannerService("wxai", "bin")
    near = service.robot.home + 0.05
    result = service.plan(PlanRequest(service.robot.home, near, time_limit=None))
    if result_of is not None:
        result = result_of(service)
    document: Document = SavedPlan(service.world, PlanRequest(service.robot.home, near), result).document()
    return document


def refused(document: Document, file: Path, load: Callable[[Any], Any] = load_plan) -> str:
    file.write_text(json.dumps(document))
    with pytest.raises(InvalidFile) as caught:
        load(file)
    return "\n".join(caught.value.problems)


def test_sections_of_later_versions_are_kept(tmp_path: Path) -> None:
    document = document_of()
    document["sections"] = {"evidence": {"cells": [1, 2.5, None, "text"]}, "payload": {}}
    (tmp_path / "plan.json").write_text(json.dumps(document))
    load_plan(tmp_path / "plan.json").save(tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text())["sections"] == document["sections"]


def _put(*path: Any) -> Callable[[Document, Any], None]:
    def put(document: Document, value: Any) -> None:
        here: Any = document
        for key in path[:-1]:
            here = here[key]
        here[path[-1]] = value

    return put


@pytest.mark.parametrize(
    ("path", "value", "problem"),
    [
        (("robot", "settle_time"), 1.0, "robot.hash: got"),
        (("scene", "obstacles", 0, "pose", "position", 0), 0.5, "scene.hash: got"),
        (("robot", "bodies", 2, "parent"), 2, "robot.bodies: got [-1, 0, 2"),
        (("robot", "bodies", 1, "axis"), [0.0, 0.0, 0.5], "robot.bodies[1] 'joint_0'.axis: got [0.0, 0.0, 0.5]"),
        (("robot", "tool_body"), 99, "robot.tool_body: got 99"),
        (("robot", "shapes", 0, "body"), 99, "robot.shapes[0].body: got 99"),
        (("robot", "link_frames", 4, "body"), 1, "robot.link_frames[4].body: got 1"),
        (("robot", "shapes", 0, "shape"), {"kind": "cone"}, "robot.shapes[0].shape.kind: got 'cone'; expected one of"),
        (("robot", "named_poses"), [], 'robot.named_poses: got []; expected each pose once, "home" among them'),
        (("robot", "gripper_width"), 5.0, "robot.gripper_width: got 5.0"),
        (("robot", "joint_names", 0), "joint_1", "robot.joint_names: got"),
        (("robot", "limits", "velocity", 0), -1.0, "robot.limits.velocity: got"),
        (("result", "counts", "states"), 10**6, "result.counts: got"),
        (("result", "trajectory", "duration"), 99.0, "result.trajectory: duration: got 99.0"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(path: Any, value: Any, problem: str, tmp_path: Path) -> None:
    document = document_of()
    _put(*path)(document, value)
    assert problem in refused(document, tmp_path / "plan.json")


UNPRINTABLE = ("\x1b[2J", "half\ud800", "a\nb", "\u202e", "bell\x07")
PLACES: tuple[tuple[Any, ...], ...] = (
    ("scene", "name"),
    ("robot", "name"),
    ("robot", "joint_names", 0),
    ("robot", "shapes", 0, "link"),
    ("robot", "allowed_contacts", 0, "reason"),
    ("made_with", "numpy"),
    ("result", "notes"),
    ("result", "stages", 0, "note"),
    ("result", "certificate", "exempt", 0, "reason"),
    ("request", "planner", "name"),
)


@cache
def with_an_exempt_stretch() -> str:
    """A plan file whose certificate leaves a stretch out."""

    def planned(service: PlannerService) -> Any:
        result = service.plan(PlanRequest(service.robot.home, service.robot.home + 0.05, time_limit=None))
        stretch = ExemptInterval(0.0, 0.01, (("link_2", "post"),), "meant")
        return replace(result, certificate=replace(present(result.certificate), exempt=(stretch,)))

    return json.dumps(document_of(planned))


@pytest.mark.parametrize("place", PLACES, ids=lambda place: ".".join(map(str, place)))
def test_text_that_a_terminal_would_obey_is_refused_and_no_command_prints_it(
    place: tuple[Any, ...], tmp_path: Path
) -> None:
    document, file = json.loads(with_an_exempt_stretch()), tmp_path / "plan.json"
    for text in UNPRINTABLE:
        _put(*place)(document, [text] if place[-1] == "notes" else text)
        assert "got " in refused(document, file)
    done = CliRunner().invoke(app, ["certify", str(file)])
    assert done.exit_code == 2
    assert (done.stdout + done.stderr).replace("\n", "").isprintable()


def test_a_key_or_a_note_that_a_terminal_would_obey_is_shown_by_its_escapes(tmp_path: Path) -> None:
    document = document_of()
    document["robot"]["\x1b[2J"] = 1
    assert r"robot: unknown key '\x1b[2J'" in refused(document, tmp_path / "plan.json")
    service = PlannerService("planar2", "discs")
    result = service.plan(PlanRequest(service.robot.home, service.robot.home))
    replace(result, notes=("\x1b[2Jred\ud800",)).save(tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").result.notes == (r"\x1b[2Jred\ud800",)


# Files made to cost time. Each took time in proportion to the square of its size, or would.


def test_of_many_problems_a_hundred_are_listed_and_the_others_counted(tmp_path: Path) -> None:
    document = document_of()
    document["result"]["certificate"]["exempt"] = [{}] * 100_000
    assert "expected at most 1,000 entries; there are 100,000" in refused(document, tmp_path / "plan.json")
    document["result"]["certificate"]["exempt"] = [{}] * 900
    assert refused(document, tmp_path / "plan.json").endswith("\nand 904 more")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{" + f'"{"k" * 501}": 0' + "}", "longer than 500 characters"),
        ("{" + ",".join(f'"{i}":0' for i in range(100_001)) + "}", "more than 100,000 keys"),
        ("[" + ",".join(["{}"] * 2_000_001) + "]", "more than 2,000,000 lists and objects"),
    ],
    ids=["key", "keys", "parts"],
)
def test_what_is_too_much_is_refused_before_it_is_looked_at(text: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(InvalidFile, match=problem):
        load_plan(tmp_path / "plan.json")


def test_hulls_that_take_too_long_to_rebuild_are_refused_before_they_are(tmp_path: Path) -> None:
    document = document_of()
    entry = document["scene"]["obstacles"][0]
    zeros = "AAAA" * 8 * 4_999
    meshes = [f"{k:04d}".replace("0", "A") + zeros[4:] for k in range(1111, 1140)]
    document["scene"]["obstacles"] = [
        {**entry, "name": f"thing {k}", "shape": {"kind": "mesh", "vertices": mesh}} for k, mesh in enumerate(meshes)
    ]
    assert "hulls that take no longer to rebuild" in refused(document, tmp_path / "plan.json")


# Files of before


def test_a_plan_file_of_before_says_how_to_plan_again(tmp_path: Path) -> None:
    old = {
        "format": "planner-service/plan",
        "version": 2,
        "robot": {"name": "wxai", "hash": "ab" * 32, "joint_names": ["joint_0"]},
        "scene": {"name": "my cell", "hash": "ab" * 32},
        "request": {
            "start": [0.1, 0.2],
            "goals": [{"joints": [1.0, 0.5]}, {"pose": {"position": [1, 2, 3], "quaternion_wxyz": [1, 0, 0, 0]}}],
            "planner": {"name": "rrtconnect", "settings": {}},
            "timing": {"name": "toppra", "settings": {}},
            "seed": 7,
        },
    }
    told = refused(old, tmp_path / "plan.json")
    assert told == (
        "version: got 2; expected 3: this file does not hold its robot and scene; plan again: planner-service plan "
        "--robot=wxai --scene='my cell' --start=0.1,0.2 --goal=1.0,0.5 --goal=pose:1.0,2.0,3.0,1.0,0.0,0.0,0.0 "
        "--planner=rrtconnect --timing=toppra --seed=7 --out=FILE"
    )


def test_a_task_file_of_before_says_how_to_plan_again(tmp_path: Path) -> None:
    old = {"format": "planner-service/task", "version": 1, "task": "pick cup from bin, place on tray"}
    told = refused(old | {"robot": {"name": "wxai"}, "scene": {"name": "bin"}}, tmp_path / "t.json", load_plan_or_task)
    assert "planner-service pick-place --robot=wxai --scene=bin --object=cup --onto=tray --out=FILE" in told
    damaged: Any
    for damaged in (None, 3, {"start": [1e300]}, {"goals": {}}, {"seed": "\x1b[2J"}, {"start": "x"}):
        told = refused({"format": "planner-service/plan", "version": 1, "request": damaged}, tmp_path / "plan.json")
        assert "plan again: planner-service plan" in told
        assert told.isprintable()
