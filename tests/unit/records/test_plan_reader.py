"""Plans of one world are read as files are, and those of another world are refused."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from planner_service import InvalidFile, PlannerService, PlanRequest
from planner_service.records.plan_file import SavedPlan, load_plan
from planner_service.records.plan_reader import PlanReader
from planner_service.records.result import result_record


@cache
def plan_document() -> dict[str, Any]:
    discs = PlannerService("planar2", "discs")
    return read(SavedPlan.of(discs.plan(PlanRequest((0.0, 0.0), (1.2, -1.2), seed=7))).file_text())


def read(text: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(text)
    return document


def test_a_plan_is_what_load_plan_reads(discs: PlannerService, tmp_path: Any) -> None:
    (tmp_path / "plan.json").write_text(json.dumps(plan_document()))
    loaded, saved = load_plan(tmp_path / "plan.json"), PlanReader(discs.world).plan(plan_document(), "plan")
    assert result_record(saved.result) == result_record(loaded.result)
    assert saved.document() == loaded.document()
    assert saved.robot is discs.robot
    assert saved.scene is discs.scene


def test_a_scene_may_have_another_name(discs: PlannerService) -> None:
    document = copy.deepcopy(plan_document())
    document["scene"]["name"] = "cell"
    assert PlanReader(discs.world).plan(document, "plan").scene is discs.scene


def test_the_robots_hash_stands_for_the_robot(discs: PlannerService) -> None:
    document = {**plan_document(), "robot": {"hash": discs.robot.hash}}
    assert PlanReader(discs.world).plan(document, "plan").document() == plan_document()


def test_a_plan_has_the_request_that_was_asked_and_no_other(discs: PlannerService) -> None:
    asked, other = (PlanRequest((0.0, 0.0), (1.2, -1.2), seed=seed) for seed in (7, 8))
    reader = PlanReader(discs.world)
    assert reader.plan(plan_document(), "plan", asked).request is asked
    read = reader.plan(plan_document(), "plan", other).request
    assert read is not None
    assert read.seed == 7
    wrong = {**plan_document(), "request": {**plan_document()["request"], "seed": "7"}}
    with pytest.raises(InvalidFile, match=r"request\.seed"):
        reader.plan(wrong, "plan", asked)


Change = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda plan: plan["robot"]["limits"]["velocity"].__setitem__(0, 9.0), "robot: another one"),
        (lambda plan: plan.update(robot={"hash": "0" * 64}), "robot: another one"),
        (lambda plan: plan["scene"]["obstacles"].pop(), "scene: another one"),
        (lambda plan: plan.update(scene=None), "scene: another one"),
        (lambda plan: plan["allowed"].append(["a", "b"]), "allowed: another one"),
        (lambda plan: plan["edge_step"].update(size=1.0), "edge_step: another one"),
        (lambda plan: plan.update(format="planner-service/task"), "format"),
        (lambda plan: plan.update(more=1), "unknown key 'more'"),
    ],
)
def test_what_was_made_in_another_world_or_is_no_plan_is_refused(
    discs: PlannerService, change: Change, problem: str
) -> None:
    document = copy.deepcopy(plan_document())
    change(document)
    with pytest.raises(InvalidFile, match=problem):
        PlanReader(discs.world).plan(document, "plan")
