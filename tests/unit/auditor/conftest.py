"""Files with evidence that the tests of the verifier change."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import pytest

from auditor.trails import digest
from planner_service import Box, Obstacle, PlannerService, PlanRequest, Pose, Scene, load_scene
from planner_service.records.evidence import with_evidence
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.tasks.pick_place import plan_pick_place

Document = dict[str, Any]


@pytest.fixture(scope="session")
def made_plan() -> Document:
    service = PlannerService("wxai", Scene((Obstacle("wall", Box((0.02, 0.3, 0.3)), Pose((0.35, 0.25, 0.2))),)))
    poses = dict(service.robot.named_poses)
    plan = SavedPlan.of(service.plan(PlanRequest(poses["home"], poses["ready"], time_limit=None)))
    document: Document = json.loads(with_evidence(plan).file_text())
    return document


@pytest.fixture(scope="session")
def made_task() -> Document:
    service = PlannerService("wxai", load_scene("bin"))
    home = service.robot.home
    task = plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home, time_limit=None), upright=0.3)
    document: Document = json.loads(with_evidence(SavedTask.of(task)).file_text())
    return document


@pytest.fixture
def plan(made_plan: Document) -> Document:
    return deepcopy(made_plan)


@pytest.fixture
def task(made_task: Document) -> Document:
    return deepcopy(made_task)


@pytest.fixture
def resealed() -> Callable[[Document], Document]:
    """The same document with digests that are right for what it now says."""

    def seal(document: Document) -> Document:
        for part in ("robot", "scene"):
            document["sections"]["evidence"][part] = digest(document[part])
        return document

    return seal
