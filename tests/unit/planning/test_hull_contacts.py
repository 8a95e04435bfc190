"""What only hulls of meshes block is not called proven, and the failure says how to cut them; the step helps."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_service import Compound, Mesh, Obstacle, PlannerService, PlanRequest, Pose, Robot, Scene, load_robot
from planner_service.planning.result import Failure, Reason
from tests.unit.robot_setup.test_concave_links import arm

THROUGH = "0.14 0.1 -0.3"
"""Where a bar begins that slides upwards through the gap of the letter."""


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLANNER_SERVICE_CACHE", str(tmp_path / "cache"))


def upwards(folder: Path) -> Path:
    path = arm(folder, THROUGH)
    path.write_text(
        path.read_text().replace('<child link="bar"/><axis xyz="1 0 0"/>', '<child link="bar"/><axis xyz="0 0 1"/>')
    )
    return path


def failure(robot: Robot, start: list[float], goal: list[float], scene: Scene | None = None) -> Failure:
    found = PlannerService(robot, scene or Scene()).plan(PlanRequest(start, goal)).failure
    assert found is not None
    return found


def test_an_end_that_only_hulls_block_is_not_proven_to_be_blocked(tmp_path: Path) -> None:
    path = arm(tmp_path)
    found = failure(load_robot(path, cut_meshes=False), [0.0, 0.0], [0.5, 0.6])
    assert (found.reason, found.proven) == (Reason.START_IN_COLLISION, False)
    assert "only the hulls of bar and letter touch: cut links with decompose = {letter = 8}" in found.detail
    cut = Robot.from_urdf(path, decompose={"letter": 8})
    assert PlannerService(cut, Scene()).plan(PlanRequest([0.0, 0.0], [0.5, 0.6])).ok


def test_an_end_that_meshes_block_is_proven_to_be_blocked(tmp_path: Path) -> None:
    path = arm(tmp_path, "-0.05 0.1 0.05")  # in the letter's back
    found = failure(load_robot(path, cut_meshes=False), [0.0, 0.0], [0.5, 0.6])
    assert found.proven
    assert "hulls" not in found.detail


def test_a_wall_of_hulls_alone_is_no_proof_that_no_path_exists(tmp_path: Path) -> None:
    path = upwards(tmp_path)
    service = PlannerService(load_robot(path, cut_meshes=False), Scene())
    explained = service.explain(PlanRequest([0.0, 0.0], [0.0, 0.6]))
    assert explained.no_path is not None
    assert not explained.proven
    assert "this is so for the hulls of letter: cut links with decompose = {letter = 8}" in str(explained)
    found = service.plan(PlanRequest([0.0, 0.0], [0.0, 0.6])).failure
    assert found is not None
    assert (found.reason, found.proven) == (Reason.NO_PATH, False)
    assert "this is so for the hulls of letter" in found.detail
    assert PlannerService(load_robot(path), Scene()).plan(PlanRequest([0.0, 0.0], [0.0, 0.6])).ok


def test_of_an_object_it_says_how_a_scene_cuts_it(tmp_path: Path) -> None:
    robot = load_robot(arm(tmp_path, "0.14 0.1 0.5"))  # high above its own letter
    at = Pose((0.0, 0.0, 0.45))
    scale = (2.0, 2.0, 2.0)
    whole = Scene((Obstacle("c", Mesh.from_file(tmp_path / "letter.obj", scale), at),))
    found = failure(robot, [0.0, 0.0], [0.0, 0.6], whole)
    assert not found.proven
    assert "only the hulls of bar and c touch: cut objects with pieces = 8" in found.detail
    cut = Scene((Obstacle("c", Compound.of_mesh(tmp_path / "letter.obj", scale, most=8), at),))
    assert PlannerService(robot, cut).plan(PlanRequest([0.0, 0.0], [0.0, 0.6])).ok
