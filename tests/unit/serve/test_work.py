"""What a worker of the server does with a request."""

from __future__ import annotations

import json
from typing import Any

import pytest

from planner_service.planning.world import World
from planner_service.robot.model import load_robot
from planner_service.scene.scene import Scene
from planner_service.serve.bodies import PlanBody, read_body
from planner_service.serve.work import Assignment, Following, ServerWork

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
