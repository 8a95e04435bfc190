"""How results, scenes, robots and counts print: as the command line prints them, in one line, and as HTML."""

from __future__ import annotations

import re

import pytest
from typer.testing import CliRunner

from planner_service import (
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Scene,
    Sphere,
)
from planner_service.cli.commands import app
from planner_service.records.plan_file import SavedPlan
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
