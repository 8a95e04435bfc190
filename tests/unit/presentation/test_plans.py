"""How results, scenes, robots and counts print: as the command line prints them, in one line, and as HTML."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from planner_service import (
    Box,
    CheckCounts,
    Compound,
    HeightField,
    Mesh,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    PointCloud,
    Pose,
    Scene,
    Sphere,
    save_scene,
)
from planner_service.cli.commands import app
from planner_service.records.plan_file import SavedPlan, load_plan
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present


@pytest.fixture(scope="module")
def result(discs: PlannerService) -> PlanResult:
    poses = discs.robot.poses
    return discs.plan(PlanRequest(poses["lesson_start"], poses["lesson_goal"], time_limit=None))


def printed(*arguments: str) -> list[str]:
    run = CliRunner(env={"COLUMNS": "100", "TERM": "dumb"}).invoke(app, list(arguments), catch_exceptions=False)
    return without_times(run.stdout)


def without_times(text: str) -> list[str]:
    return [re.sub(r" *[\d,]+\.\d$", "", line) for line in text.splitlines()]


def test_a_result_prints_what_the_command_prints(result: PlanResult) -> None:
    arguments = ("--robot", "planar2", "--scene", "discs", "--start", "lesson_start", "--goal", "lesson_goal")
    head, *rows = without_times(str(result))
    command_head, *command_rows = printed("plan", *arguments, "--time-limit", "inf")
    assert head.startswith("planned: planar2 in discs ")
    assert command_head.startswith("planned: planar2 in discs, lesson_start -> lesson_goal ")
    assert rows == command_rows


@pytest.mark.slow
def test_a_task_prints_what_the_command_prints() -> None:
    service = PlannerService("wxai", "bin")
    task = plan_pick_place(service, "blue_block", "tray", PlanRequest(service.robot.home, service.robot.home))
    assert without_times(str(task)) == printed("pick-place")
    assert repr(task) == f"<TaskResult: 7 motions, {task.duration:.2f} s of motion, {task.counts}>"


def test_no_plan_prints_its_reason(discs: PlannerService) -> None:
    failed = discs.plan(PlanRequest((0.0, 0.0), (9.0, 0.0)))
    assert repr(failed) == "<PlanResult: no plan, GOAL_OUTSIDE_LIMITS>"
    text = str(failed)
    assert text.startswith("no plan: planar2 in discs ")
    assert f"no plan: {failed.failure}" in " ".join(text.split())


def test_a_plan_from_a_file_prints_with_its_robot_and_scene(result: PlanResult, tmp_path: Path) -> None:
    result.save(tmp_path / "plan.json")
    saved = load_plan(tmp_path / "plan.json")
    assert str(saved) == str(result)
    assert repr(saved) == f"<SavedPlan: planar2 in discs, {result!r}>"
    alone = without_times(str(saved.result))[0]
    assert alone.startswith("planned  ")


@pytest.mark.parametrize("kind", ["result", "saved", "scene", "robot", "counts"])
def test_every_object_is_one_short_line_and_a_table_in_a_notebook(
    kind: str, result: PlanResult, discs: PlannerService
) -> None:
    objects = {
        "result": result,
        "saved": SavedPlan.of(result),
        "scene": discs.scene,
        "robot": discs.robot,
        "counts": result.counts,
    }
    shown = objects[kind]
    assert len(repr(shown)) < 150
    assert "\n" not in repr(shown)
    html = shown._repr_html_()  # type: ignore[attr-defined]
    assert html.count("<table>") == html.count("</table>") > 0
    assert html.count("<tr>") == html.count("</tr>") > 1


def test_a_hostile_scene_is_harmless_in_a_notebook() -> None:
    scene = Scene((Obstacle("<img src=x onerror=alert(1)>", Sphere(0.1), Pose((1.0, 0.0, 0.0))),), name="<b>")
    assert "<img" not in scene._repr_html_()
    assert "<b>" not in scene._repr_html_()


def test_every_shape_is_described_in_text_and_json(tmp_path: Path) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    shapes: dict[str, Any] = {
        "box": Box((0.1, 0.2, 0.3)),
        "mesh": Mesh(corners),
        "point cloud": PointCloud(np.zeros((1, 3)), 0.1),
        "height field": HeightField(np.ones((2, 3)), 0.1),
        "compound": Compound(((Box((1.0, 1.0, 1.0)), Pose((0.0, 0.0, 0.0))),)),
        "sphere": Sphere(0.1),
    }
    scene = Scene(tuple(Obstacle(f"a {name}", shape, Pose((0.0, 0.0, 0.0))) for name, shape in shapes.items()))
    for name in shapes:
        assert re.search(f"^a {name} +{name} +[0-9r]", str(scene), re.M)
    file = tmp_path / "all.toml"
    save_scene(scene, file)
    assert CliRunner().invoke(app, ["scenes", str(file)]).exit_code == 0
    assert CliRunner().invoke(app, ["scenes", str(file), "--json"]).exit_code == 0


def test_counts_read_as_words() -> None:
    assert str(CheckCounts(1234, 5)) == "1,234 states, 5 edges"
    assert str(CheckCounts(1, 2, 3456)) == "1 state, 2 edges, 3,456 distances"


def test_a_certificate_says_what_is_proven_or_refused(discs: PlannerService, result: PlanResult) -> None:
    proof = present(result.certificate)
    assert (
        str(proof)
        == f"proven: {proof.clearance * 1000 - 0.005:.2f} mm clear, between samples too ({proof.distances:,} bounds)"
    )
    poses = discs.robot.poses
    refused = discs.certify([poses["lesson_start"], poses["lesson_goal"]])
    assert str(refused).startswith("refused: ")
    assert "is not proven apart" in str(refused)
