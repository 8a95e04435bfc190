"""Plans of several arms by a server: the library's, to the bit, and what is none is refused on either side."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from auditor.__main__ import judged
from planner_service.cell import Anywhere, Arm, AtTool, Cell, CellPlan
from planner_service.client import Remote, plan_cell
from planner_service.records.cells import SavedCellPlan, load_cell_plan, prove_cell, with_cell_evidence
from planner_service.records.http.examples import EXAMPLES
from tests.integration.test_remote import Deaf, asked_through
from tests.support.served import asked, served

ASIDE = [1.2, 1.0, 1.0, -0.5, 0.0, 0.0]
FACING = ps.Pose((0.15, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
MEETING = ps.Pose((0.3, 0.0, 0.35))
BODY: dict[str, Any] = dict(EXAMPLES["plan_cell"]["two arms that meet"])


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with served(tmp_path_factory.mktemp("served"), "--robot", "wxai", "--scene", "bin", "--workers", "1") as address:
        yield address


@pytest.fixture(scope="module", params=[False, True], ids=["http", "channel"])
def remote(url: str, request: pytest.FixtureRequest) -> Iterator[Remote]:
    with Remote(url, "bin", channel=request.param) as made:
        yield made


@pytest.fixture(scope="module")
def cell() -> Cell:
    robot = ps.load_robot("wxai")
    held = ps.Attached("ball", ps.Sphere(0.01), ps.Pose(), touch_links=("finger_left", "finger_right"))
    there = ps.Pose((0.75, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return Cell({"left": Arm(robot), "right": Arm(robot, there)}, "bin").carrying({"left": [held]})


REQUESTS = {"left": ps.PlanRequest(ASIDE, MEETING, velocity_scale=0.5), "right": ps.PlanRequest(ASIDE, ASIDE)}
ASKED: dict[str, dict[str, Any]] = {
    "one at the other": {"requests": REQUESTS, "goals": {"right": AtTool("left", FACING)}, "delay": 0.05},
    "one stands": {"requests": {"left": REQUESTS["left"]}, "standing": {"right": ASIDE}},
    "one may be anywhere": {"requests": REQUESTS, "goals": {"right": Anywhere()}},
    "none can": {"requests": {"left": ps.PlanRequest(ASIDE, ps.Pose((3.0, 0.0, 0.3)))}},
}


def bits(plan: CellPlan) -> Any:
    document = SavedCellPlan.of(plan).document()
    del document["made_with"], document["counts"]
    for clock in document["clocks"]:
        for stage in clock["result"]["stages"]:
            del stage["seconds"]
    return document


@pytest.mark.parametrize("name", ASKED)
def test_a_server_plans_what_the_library_plans(remote: Remote, cell: Cell, name: str) -> None:
    there, here = plan_cell(remote, cell, **ASKED[name]), cell.plan(**ASKED[name])
    assert bits(there) == bits(here)
    assert there.layout is cell.layout
    assert not here.ok or prove_cell(there).certified


def test_an_answer_is_a_file_that_is_certified_and_audited(url: str, tmp_path: Path) -> None:
    status, headers, answer = asked(url, "POST", "/plan_cell", BODY)
    assert status == 200
    file = tmp_path / "cell.json"
    file.write_text(json.dumps(answer))
    saved = load_cell_plan(file)
    assert prove_cell(saved).required().tolerates >= BODY["delay"]
    shown = json.loads(with_cell_evidence(saved).file_text())
    assert list(judged(shown))[-1].startswith("verified: ")
    where = headers["content-location"]
    assert asked(url, "GET", where)[2] == answer
    assert asked(url, "GET", f"{where}/trajectory")[0] == 409
    assert asked(url, "GET", f"{where}/view")[0] == 409
    assert asked(url, "POST", "/certify", {"plan": where.split("/")[-1]})[0] == 422
    assert asked(url, "POST", "/plan_cell", {**BODY, "scene": {"after": where.split("/")[-1]}})[0] == 422


def _arm(k: int, **changes: Any) -> dict[str, Any]:
    arms = json.loads(json.dumps(BODY["arms"]))
    arms[k].update(changes)
    return {**BODY, "arms": arms}


BAD = {
    "no arms": {**BODY, "arms": []},
    "five arms": {**BODY, "arms": [{"name": f"arm {k}"} for k in range(5)]},
    "no motion": {**BODY, "arms": [{"name": "left"}]},
    "one name twice": _arm(1, name="left"),
    "a robot of one's own": _arm(0, robot="/etc/passwd"),
    "joints of some": _arm(0, joints=["joint_0"], base=None),
    "joints that are not there": {**BODY, "arms": [{**BODY["arms"][0], "base": None, "joints": ["a"] * 6}]},
    "a tool of a robot at a place": _arm(0, tool="tip"),
    "both goals": _arm(1, anywhere=True),
    "nothing but anywhere": {**BODY, "arms": [{**BODY["arms"][1], "at_tool": None, "anywhere": True}]},
    "at its own tool": _arm(1, at_tool={**BODY["arms"][1]["at_tool"], "arm": "right"}),
    "at the tool of none": _arm(1, at_tool={**BODY["arms"][1]["at_tool"], "arm": "third"}),
    "a motion that stands": _arm(0, stands="home"),
    "a start of others": _arm(0, request={**BODY["arms"][0]["request"], "start": [0.0]}),
    "late for ever": {**BODY, "delay": 1e9},
    "late by nothing": {**BODY, "delay": float("nan")},
    "a roadmap": _arm(0, request={**BODY["arms"][0]["request"], "planner": {"name": "roadmap", "hash": "0" * 64}}),
    "a name with a line": _arm(0, name="left\n"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_planned_is_refused_and_named(url: str, name: str) -> None:
    status, _, problem = asked(url, "POST", "/plan_cell", BAD[name])
    assert status in (400, 422), problem
    assert problem["type"].startswith("urn:problem-type:planner-service:")
    assert len(problem["detail"]) > 10


def test_a_deadline_ends_it(url: str) -> None:
    status, _, answer = asked(url, "POST", "/plan_cell", {**BODY, "deadline": 0.001})
    assert (status, answer.get("reason") or answer["failure"]["reason"]) in ((408, "TIMED_OUT"), (200, "TIMED_OUT"))


def test_a_cell_that_is_not_the_servers_is_refused(remote: Remote, cell: Cell) -> None:
    other = ps.load_robot("planar2")
    with pytest.raises(ps.InvalidRequest, match="robot"):
        plan_cell(remote, Cell({"left": other}, remote.scene), {"left": ps.PlanRequest([0.0, 0.1], [0.1, 0.1])})
    with pytest.raises(ps.InvalidRequest, match="scene"):
        plan_cell(remote, Cell(cell.layout.arms, "table"), REQUESTS)
    with pytest.raises(ps.UnknownName):
        plan_cell(remote, cell, {"third": REQUESTS["left"]})
    withdrawn = ps.CancelToken()
    withdrawn.cancel()
    plan = plan_cell(remote, cell, REQUESTS, cancel=withdrawn)
    assert plan.failure is not None
    assert plan.failure.reason is ps.Reason.PREEMPTED


def _moved_base(answer: dict[str, Any]) -> None:
    answer["arms"][1]["base"]["position"][0] += 0.5


def _other_start(answer: dict[str, Any]) -> None:
    answer["still"][0] += 0.1


def _less_delay(answer: dict[str, Any]) -> None:
    answer["tolerates"] = 0.01


def _one_motion(answer: dict[str, Any]) -> None:
    del answer["clocks"][1]


def _other_tool(answer: dict[str, Any]) -> None:
    answer["arms"][1]["at_tool"]["pose"]["position"][0] += 0.1


def _no_load(answer: dict[str, Any]) -> None:
    del answer["arms"][0]["carried"]


def _exchanged(answer: dict[str, Any]) -> None:
    """Each arm has the other's motion: one is too fast, as both are alike."""
    one, two = answer["clocks"]
    one["arms"], two["arms"] = two["arms"], one["arms"]


@pytest.mark.parametrize(
    "change", [_moved_base, _other_start, _less_delay, _one_motion, _other_tool, _no_load, _exchanged]
)
def test_the_answer_to_another_question_is_refused(
    url: str, cell: Cell, change: Callable[[dict[str, Any]], None]
) -> None:
    class Lying(Deaf):
        def _heard(self, asked: Any) -> Any:
            return asked

        def _said(self, content: bytes) -> bytes:
            if b"cell-plan" not in content:
                return content
            answer = json.loads(content)
            change(answer)
            return json.dumps(answer).encode()

    with asked_through(Lying, url) as lying, pytest.raises(ps.InvalidFile):
        plan_cell(lying, cell, **ASKED["one at the other"])


def test_one_robot_with_two_arms_is_divided(tmp_path: Path) -> None:
    robot = ps.load_robot("wxai_dual")
    sides = {side: [name for name in robot.joint_names if name.startswith(side)] for side in ("left", "right")}
    dual = Cell.of(robot, sides, "table", tools={"right": "right_ee_gripper_link"})
    start = {name: dual.arm(name).robot.home for name in dual.arms}
    requests = {name: ps.PlanRequest(q, np.asarray(q) + 0.2) for name, q in start.items()}
    with (
        served(tmp_path, "--robot", "wxai_dual", "--scene", "table", "--workers", "1") as url,
        Remote(url, "table") as remote,
    ):
        there = plan_cell(remote, dual, requests, delay=0.05)
        assert bits(there) == bits(dual.plan(requests, delay=0.05))
        named = [{"name": "left", "joints": sides["left"], "request": {"start": "home", "goals": [{"joints": "home"}]}}]
        status, _, problem = asked(url, "POST", "/plan_cell", {"scene": "table", "arms": named})
        assert status == 422, problem
        assert replace(there, tried=()).ok
