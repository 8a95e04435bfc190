"""What a worker of the server does with a request."""

from __future__ import annotations

import json
from typing import Any

import pytest

from planner_service.planning.world import World
from planner_service.robot.model import load_robot
from planner_service.scene.scene import Scene
from planner_service.serve.work import Assignment, Following, ServerWork

BODY = json.dumps({"scene": "bin", "request": {"start": "home", "goals": [{"joints": "home"}]}}).encode()


@pytest.mark.parametrize("followed", [False, True])
def test_stages_are_sent_as_they_end_if_a_client_follows_and_else_with_the_answer(followed: bool) -> None:
    sent: list[Any] = []
    work = ServerWork(World(load_robot("wxai"), Scene()))
    work.connect(sent.append)
    if followed:
        work.told(Following("one"))
    answer = work(Assignment("one", "plans", BODY))
    other = work(Assignment("other", "plans", BODY))
    told, untold = (sent, answer.untold) if followed else (answer.untold, sent)
    assert [note["stage"] for note in told] == [stage for stage, _ in answer.stages] != []
    assert not untold
    assert len(other.untold) == len(other.stages)
