"""Goals that depend on other arms: a tool at another arm's tool, and arms that only get out of the way."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import (
    InvalidFile,
    InvalidRequest,
    PlanRequest,
    Pose,
    PoseGoal,
    Reason,
    UnknownName,
    inverse_kinematics,
    load_robot,
)
from planner_service.cell import Anywhere, Arm, AtTool, Cell, CellPlan
from planner_service.records.cells import load_cell_plan, prove_cell, read_cell_request, save_cell_plan

WXAI = load_robot("wxai")
START = [1.2, 1.0, 1.0, -0.5, 0.0, 0.0]
FACING = Pose((0.15, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
"""A tool that looks back at another one, 15 cm before it."""

MIDDLE, FAR = Pose((0.3, 0.0, 0.25)), Pose((0.3, 0.0, 2.0))
LEAVES, COMES = [1.1, 1.4, 1.2, -0.8, 0.0, 0.0], ([0.9, 1.4, 1.2, -0.8, 0.0, 0.0], [-0.5, 1.4, 1.2, -0.8, 0.0, 0.0])


@pytest.fixture(scope="module")
def facing() -> Cell:
    """Two arms that look at each other."""
    there = Pose((0.75, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return Cell({"left": Arm(WXAI), "right": Arm(WXAI, there)}, "table")


@pytest.fixture(scope="module")
def beside() -> Cell:
    return Cell({"left": Arm(WXAI, Pose((0.0, 0.25, 0.0))), "right": Arm(WXAI, Pose((0.0, -0.25, 0.0)))}, "table")


def apart(cell: Cell, plan: CellPlan) -> np.ndarray[Any, Any]:
    """The right tool in the left one's frame at the end."""
    end = plan(plan.duration)
    left, right = (cell.arm(name).robot.tool_pose(cell.of_arm(name, end)) for name in ("left", "right"))
    return np.asarray(np.linalg.inv(left) @ right)


@pytest.mark.parametrize(
    "goal",
    [MIDDLE, inverse_kinematics(WXAI, MIDDLE)[0] + 0.02, PoseGoal(MIDDLE, position_tolerance=0.01), [FAR, MIDDLE]],
)
def test_a_tool_ends_where_it_is_to_be_at_another(facing: Cell, goal: Any) -> None:
    """Also where the leader's first goal cannot be reached."""
    requests = {"left": PlanRequest(START, goal), "right": PlanRequest(START, START)}
    plan = facing.plan(requests, goals={"right": AtTool("left", FACING)}, delay=0.05)
    assert plan.ok, plan
    assert apart(facing, plan) == pytest.approx(FACING.matrix, abs=1e-6)
    assert prove_cell(plan).required().tolerates >= 0.05
    for q in plan(np.linspace(0.0, plan.duration, 100)):
        assert facing.service.checker.state_is_free(q)


def test_a_tool_goes_to_that_of_an_arm_that_stands(facing: Cell) -> None:
    stands = inverse_kinematics(facing.arm("left").robot, MIDDLE)[0]
    plan = facing.plan(
        {"right": PlanRequest(START, START)}, goals={"right": AtTool("left", FACING)}, standing={"left": stands}
    )
    assert plan.ok
    assert apart(facing, plan) == pytest.approx(FACING.matrix, abs=1e-6)


def test_tools_follow_each_other_in_a_row(facing: Cell) -> None:
    three = Cell({**facing.layout.arms, "third": Arm(WXAI, Pose((0.9, -0.3, 0.0), (0.0, 0.0, 0.0, 1.0)))}, "table")
    to_third = Pose((0.0, 0.3, 0.0))
    goals = {"third": AtTool("right", to_third), "right": AtTool("left", FACING)}
    requests = {"left": PlanRequest(START, MIDDLE), "right": PlanRequest(START, START)}
    plan = three.plan({**requests, "third": PlanRequest(START, START)}, goals=goals)
    assert plan.ok, plan
    end = plan(plan.duration)
    tools = {name: three.arm(name).robot.tool_pose(three.of_arm(name, end)) for name in three.arms}
    assert tools["third"] == pytest.approx(tools["right"] @ to_third.matrix, abs=1e-6)
    assert prove_cell(plan).certified


def test_where_a_tool_cannot_be_there_is_no_plan(facing: Cell) -> None:
    requests = {"left": PlanRequest(START, MIDDLE), "right": PlanRequest(START, START)}
    plan = facing.plan(requests, goals={"right": AtTool("left", Pose((3.0, 0.0, 0.0)))})
    assert plan.failure is not None
    assert plan.failure.reason is Reason.NO_IK_SOLUTION
    assert plan.failure.detail.startswith("right")
    assert not plan.goals


def test_an_arm_stays_that_is_in_nobodys_way(beside: Cell) -> None:
    requests = {"left": PlanRequest(*COMES), "right": PlanRequest([-1.0, *LEAVES[1:]], LEAVES)}
    plan = beside.plan(requests, goals={"right": Anywhere()}, delay=0.05)
    assert [clock.arms for clock in plan.clocks] == [("left",)]


def test_an_arm_leaves_that_is_in_the_way(beside: Cell) -> None:
    stands = beside.plan({"left": PlanRequest(*COMES)}, standing={"right": LEAVES})
    assert stands.failure is not None, "or it is in nobody's way"
    requests = {"left": PlanRequest(*COMES), "right": PlanRequest(LEAVES, LEAVES)}
    plan = beside.plan(requests, goals={"right": Anywhere()}, delay=0.05)
    assert plan.ok
    assert "right: gets out of the way" in plan.notes
    assert np.abs(beside.of_arm("right", plan(plan.duration)) - LEAVES).max() > 0.1
    assert prove_cell(plan).required().tolerates >= 0.05
    again = beside.plan(requests, goals={"right": Anywhere()}, delay=0.05)
    assert np.array_equal(again(again.duration), plan(plan.duration))


def test_an_arm_that_cannot_move_out_of_what_it_touches_is_named(beside: Cell) -> None:
    below = [0.0, 2.6, 0.0, 0.0, 0.0, 0.0]
    requests = {"left": PlanRequest(*COMES), "right": PlanRequest(below, LEAVES)}
    plan = beside.plan(requests, goals={"right": Anywhere()})
    assert plan.failure is not None
    assert plan.failure.reason is Reason.START_IN_COLLISION


@pytest.mark.parametrize(
    ("goals", "error"),
    [
        ([], InvalidRequest),
        ({"third": Anywhere()}, UnknownName),
        ({"right": AtTool("third", FACING)}, UnknownName),
        ({"right": MIDDLE}, InvalidRequest),
        ({"right": AtTool("right", FACING)}, InvalidRequest),
        ({"right": AtTool("left", FACING), "left": AtTool("right", FACING)}, InvalidRequest),
        ({"right": AtTool("left", FACING), "left": Anywhere()}, InvalidRequest),
        ({"right": Anywhere(), "left": Anywhere()}, InvalidRequest),
    ],
)
def test_goals_that_are_none_are_named(facing: Cell, goals: Any, error: type[Exception]) -> None:
    requests = {name: PlanRequest(START, START) for name in facing.arms}
    with pytest.raises(error):
        facing.plan(requests, goals=goals)
    with pytest.raises(InvalidRequest, match=r"goals\['left'\]"):
        facing.plan({"right": requests["right"]}, goals={"left": Anywhere()})


@pytest.mark.parametrize("given", [("", FACING), ("left", None), (3, FACING)])
def test_values_of_goals_are_checked(given: Any) -> None:
    with pytest.raises(InvalidRequest):
        AtTool(*given)


def test_files_keep_where_tools_were_to_be_and_proofs_look(facing: Cell, tmp_path: Path) -> None:
    requests = {"left": PlanRequest(START, MIDDLE), "right": PlanRequest(START, START)}
    plan = facing.plan(requests, goals={"right": AtTool("left", FACING)}, delay=0.05)
    file = tmp_path / "cell.json"
    save_cell_plan(plan, file)
    saved = load_cell_plan(file)
    assert saved.plan.goals == {"right": AtTool("left", FACING)}
    assert prove_cell(saved).certified
    off = replace(plan, goals={"right": AtTool("left", replace(FACING, position=(0.1502, 0.0, 0.0)))})
    assert "0.2 mm" in prove_cell(off).problems[0]
    assert "third: at the tool" in prove_cell(replace(plan, goals={"third": AtTool("left", FACING)})).problems[0]
    document = json.loads(file.read_text())
    for other in ("third", "right"):
        document["arms"][1]["at_tool"]["arm"] = other
        file.write_text(json.dumps(document))
        with pytest.raises(InvalidFile, match="another arm"):
            load_cell_plan(file)


ASKED = """
scene = "table"
delay = 0.05

[[arm]]
name = "left"
robot = "wxai"
start = [1.2, 1.0, 1.0, -0.5, 0.0, 0.0]
goal = { position = [0.3, 0.0, 0.25], quaternion_wxyz = [1.0, 0.0, 0.0, 0.0] }

[[arm]]
name = "right"
robot = "wxai"
position = [0.75, 0.0, 0.0]
quaternion_wxyz = [0.0, 0.0, 0.0, 1.0]
start = [1.2, 1.0, 1.0, -0.5, 0.0, 0.0]
goal = GOAL
"""


def test_a_file_may_ask_for_them(tmp_path: Path) -> None:
    file = tmp_path / "cell.toml"
    file.write_text(
        ASKED.replace(
            "GOAL", '{ at_tool_of = "left", position = [0.15, 0.0, 0.0], quaternion_wxyz = [0.0, 0.0, 0.0, 1.0] }'
        )
    )
    asked = read_cell_request(file)
    assert asked.goals == {"right": AtTool("left", FACING)}
    assert asked.plan().ok
    file.write_text(ASKED.replace("GOAL", '"any"'))
    assert read_cell_request(file).goals == {"right": Anywhere()}
    file.write_text(ASKED.replace("GOAL", "{ at_tool_of = 3, position = [0.15, 0.0, 0.0] }"))
    with pytest.raises(InvalidFile, match="at_tool_of"):
        read_cell_request(file)
