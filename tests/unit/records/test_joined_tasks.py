"""Tasks that follow each other, as one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from planner_service import (
    Box,
    Handling,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    load_scene,
    pick,
    place,
    top_grasps,
)
from planner_service.cli.commands import app
from planner_service.records import SavedTask, load_task, save_plan
from planner_service.records.recertify import recertify
from tests.support.optional import present

HALF = 0.0225


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A pick, and the place that was planned after it."""
    folder = tmp_path_factory.mktemp("tasks")
    block = Obstacle("block", Box((0.045, 0.045, 0.045)), Pose((0.28, 0.10, HALF - 0.001)))
    service = PlannerService("wxai", load_scene("table").with_obstacle(block))
    home = service.robot.home
    handling = Handling(support="table", request=PlanRequest(home, home, padding=0.002))
    taken = pick(service, home, "block", top_grasps(service.robot, block), handling)
    put = place(PlannerService.of(taken.world), taken.q, "block", [Pose((0.28, -0.10, HALF - 0.001))], handling)
    taken.save(folder / "pick.json")
    put.save(folder / "place.json")
    return folder / "pick.json", folder / "place.json"


@pytest.fixture
def tasks(files: tuple[Path, Path]) -> tuple[SavedTask, SavedTask]:
    return load_task(files[0]), load_task(files[1])


def test_a_pick_and_its_place_become_one_task_that_is_proven(
    tasks: tuple[SavedTask, SavedTask], tmp_path: Path
) -> None:
    first, second = tasks
    whole = first.followed_by(second)
    save_plan(whole, tmp_path / "task.json")
    back = load_task(tmp_path / "task.json")
    names = ["to pregrasp", "descend", "lift", "transfer", "lower", "retreat"]
    assert [segment.name for segment in back.segments] == names
    assert back.counts == first.counts + second.counts
    assert back.task == "pick block; place block"
    assert back.notes[0].startswith("pick block: way 1 of ")
    assert present(back.request).padding == 0.002
    assert len(recertify(back).required().motions) == 6


def test_a_task_that_begins_elsewhere_cannot_follow(tasks: tuple[SavedTask, SavedTask]) -> None:
    first, second = tasks
    with pytest.raises(InvalidRequest, match=r"to pregrasp, which begins at .*; expected one that begins at .*"):
        second.followed_by(first)
    moved = Obstacle("new", Box((0.1, 0.1, 0.1)), Pose((-0.5, 0.0, 0.5)))
    with pytest.raises(InvalidRequest, match="begins in another scene'; expected the scene that pick block leaves"):
        first.followed_by(second.within(replace(second.begin, scene=second.scene.with_obstacle(moved))))
    opened = replace(second.begin, robot=second.robot.with_gripper(0.08))
    with pytest.raises(InvalidRequest, match=r"a gripper 0\.08 m open'; expected one that begins with 0\.045 m"):
        first.followed_by(replace(second, begin=opened))
    with pytest.raises(InvalidRequest, match="allows other pairs to touch"):
        first.followed_by(replace(second, begin=replace(second.begin, allowed=(("block", "table"),))))


def test_the_command_joins_files(files: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "task.json"
    done = CliRunner().invoke(app, ["join", *map(str, files), "--out", str(out)])
    assert done.exit_code == 0
    assert "planned: pick block; place block" in done.stdout
    assert len(load_task(out).segments) == 6
    wrong = CliRunner().invoke(app, ["join", *map(str, reversed(files)), "--out", str(tmp_path / "no.json")])
    assert wrong.exit_code == 2
    assert not (tmp_path / "no.json").exists()
