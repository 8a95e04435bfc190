"""What a worker of the server does with a request."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from planner_service.planning.request import PlanRequest, World
from planner_service.records.http.bodies import PlanBody, read_body
from planner_service.records.http.replies import VERBS
from planner_service.records.plan_file import SavedPlan
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.scene import Scene
from planner_service.serve.work import Assignment, Ending, Following, ServerWork, Source, unrun
from planner_service.service import PlannerService
from tests.support.optional import present

BODY = json.dumps({"scene": "bin", "request": {"start": "home", "goals": [{"joints": "home"}]}}).encode()


@pytest.mark.parametrize("followed", [False, True])
def test_stages_are_sent_as_they_end_if_a_client_follows_and_else_with_the_answer(followed: bool) -> None:
    sent: list[Any] = []
    work = ServerWork(World(load_robot("wxai"), Scene()))
    work.connect(sent.append)
    if followed:
        work.told(Following("one"))
    body = read_body(PlanBody, BODY, work.world.robot)
    answer = work(Assignment("one", "plans", body))
    other = work(Assignment("other", "plans", body))
    assert answer.stages
    assert sent == (list(answer.stages) if followed else [])
    assert answer.told == len(sent)
    assert other.told == 0


def test_what_was_made_with_another_robot_is_refused() -> None:
    other = PlannerService("planar2", "discs")
    file = SavedPlan.of(other.plan(PlanRequest(other.robot.home, other.robot.home))).file_text().encode()
    work = ServerWork(World(load_robot("wxai"), Scene()))
    work.connect([].append)
    for body, field in ((b'{"plan": "one", "at_time": 0.0}', "replan"), (b'{"plan": "one"}', "certify")):
        item = Assignment(
            "two", field, read_body(VERBS[field].body, body, work.world.robot), {"plan": Source("0", file)}
        )
        answer = work(item)
        assert answer.refused
        assert json.loads(answer.content)["detail"].startswith("plan: got 'planar2'; expected one made with")


def test_a_robot_with_another_range_of_the_gripper_is_another_robot() -> None:
    robot = load_robot("wxai")
    narrow = replace(robot, gripper=replace(present(robot.gripper), upper=0.02), gripper_width=0.01)
    service = PlannerService(robot.with_gripper(0.05), "empty")
    file = SavedPlan.of(service.plan(PlanRequest(robot.home, robot.home))).file_text().encode()
    body = read_body(VERBS["replan"].body, b'{"plan": "one", "at_time": 0.0}', narrow)
    work = ServerWork(World(narrow, Scene()))
    work.connect([].append)
    answer = work(Assignment("two", "replan", body, {"plan": Source("0", file)}))
    assert json.loads(answer.content)["detail"].startswith("plan: got 'wxai'; expected one made with")
    ended = unrun(Assignment("two", "replan", body, {"plan": Source("0", file)}), work.world, Ending.CANCELLED)
    assert (ended.reason, json.loads(ended.content)["status"]) == ("PREEMPTED", 410)
