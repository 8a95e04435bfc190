"""The page of a task shows how each of its steps fared, also of one in a file, whatever it is called."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planner_service import PlannerService
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.planning.task_result import StepReport, TaskResult
from planner_service.records.plan_file import load_task
from planner_service.tasks import Task, pick_steps
from planner_service.view.controls.timeline import steps_html
from planner_service.view.markdown import result_markdown
from planner_service.view.state import ViewState

REPORTS = (
    StepReport("1 Connect to it"),
    StepReport("2 Approach <img src=x>", 4, 3, (("a | b\n<script>", 3),)),
    StepReport("3 Grasp block", 2, 2, (("out of reach", 2),)),
    StepReport("4 Retreat lift", 1, 0),
)


@pytest.fixture(scope="module")
def failed() -> tuple[PlannerService, TaskResult]:
    service = PlannerService("wxai", "bin")
    return service, service.solve(Task(pick_steps("tray", GraspKinds([GraspKind.TOP]))), service.robot.home)


def test_the_step_that_failed_is_said_with_its_reasons(
    failed: tuple[PlannerService, TaskResult], tmp_path: Path
) -> None:
    service, task = failed
    task.save(tmp_path / "task.json")
    for shown in (task, load_task(tmp_path / "task.json")):
        state = ViewState.of(service, shown)
        assert [str(step) for step in state.steps] == [str(step) for step in task.steps]
        assert "| 3 Grasp tray | 1 of 1 | no top grasp\\: expected an object at most" in result_markdown(state)


def test_a_plan_has_no_steps(failed: tuple[PlannerService, TaskResult]) -> None:
    service, _ = failed
    assert ViewState.of(service).steps == ()


def test_each_step_is_drawn_in_the_colour_of_how_it_fared_and_told_in_full() -> None:
    drawn = steps_html(REPORTS)
    colours = [part.split('"')[0] for part in drawn.split("background:")[1:]]
    assert len(colours) == len(set(colours)) == 4
    assert "2 Approach &lt;img src=x&gt; 1/4" in drawn
    assert "3 Grasp block 0/2" in drawn
    assert "<img" not in drawn
    assert "<script>" not in drawn


def test_of_many_steps_those_that_failed_are_drawn() -> None:
    many = (*(replace(REPORTS[3], step=f"{k} Retreat") for k in range(500)), REPORTS[2])
    drawn = steps_html(many)
    assert "3 Grasp block" in drawn
    assert "and 500 more" in drawn
    assert len(drawn) < 2_000


def test_reasons_with_marks_of_a_table_stay_in_their_cell(failed: tuple[PlannerService, TaskResult]) -> None:
    service, task = failed
    text = result_markdown(ViewState.of(service, replace(task, steps=REPORTS)))
    rows = [line for line in text.splitlines() if line.startswith("| 2 Approach")]
    assert len(rows) == 1
    assert "<script>" not in text
    assert rows[0].count("|") - rows[0].count("\\|") == 4
