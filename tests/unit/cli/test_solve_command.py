"""``planner-service solve``: a task in a file is solved, or its step without a plan is named."""

from __future__ import annotations

import json
import re
from pathlib import Path

from planner_service.grasping import GraspKind, GraspKinds
from planner_service.memory import Memory
from planner_service.records.plan_file import load_task
from planner_service.tasks import MoveTo, Task, pick_steps
from tests.support.command import run


def test_a_task_of_steps_in_a_file_is_solved_saved_and_proven(tmp_path: Path) -> None:
    steps, solved, picture = tmp_path / "steps.json", tmp_path / "solved.json", tmp_path / "solved.png"
    Task((*pick_steps("blue_block"), MoveTo("home")), "lift the block").save(steps)
    done = run("solve", str(steps), "--scene", "bin", "--out", str(solved), "--png", str(picture))
    assert done.exit_code == 0
    assert "planned: lift the block" in done.output
    assert [step.failed for step in load_task(solved).steps][-1] == 0
    assert run("certify", str(solved)).exit_code == 0


def test_what_a_task_has_learned_is_kept_in_a_file_and_helps_the_next(tmp_path: Path) -> None:
    steps, memory = tmp_path / "steps.json", tmp_path / "bin.memory.json"
    Task((*pick_steps("blue_block"), MoveTo("home"))).save(steps)
    states = []
    for _ in range(2):
        done = run("solve", str(steps), "--scene", "bin", "--memory", str(memory), "--json")
        assert done.exit_code == 0
        states.append(json.loads(done.stdout)["counts"]["states"])
    assert states[1] < states[0]
    assert len(Memory.load(memory).grips) == 1
    steps.replace(memory)
    done = run("solve", str(memory), "--scene", "bin", "--memory", str(memory))
    assert (done.exit_code, "memory.json" in done.output) == (2, True)


def test_a_task_without_a_plan_says_which_step_has_none_and_why(tmp_path: Path) -> None:
    steps, solved = tmp_path / "steps.json", tmp_path / "solved.json"
    Task(pick_steps("tray", GraspKinds([GraspKind.TOP]))).save(steps)
    done = run("solve", str(steps), "--scene", "bin", "--out", str(solved))
    assert done.exit_code == 1
    assert re.search(r"3 Grasp tray +1 +1 +no top grasp: expected", done.output)
    assert str(load_task(solved).steps[2]).startswith("3 Grasp tray: 1 of 1 failed: no top grasp: expected an object")


def test_a_file_that_is_no_task_of_steps_is_refused(tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    assert run("plan", "--scene", "bin", "--start", "home", "--goal", "ready", "--out", str(plan)).exit_code == 0
    done = run("solve", str(plan), "--scene", "bin")
    assert (done.exit_code, "expected 'planner-service/steps'" in done.output) == (2, True)
