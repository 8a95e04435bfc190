"""Plans of cells survive their files bit for bit, and what is wrong in a file is named."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Box, InvalidFile, InvalidRequest, Obstacle, PlanRequest, Pose, Scene, load_robot
from planner_service.cell import Arm, Cell, CellPlan
from planner_service.records.cells import SavedCellPlan, load_cell_plan, load_saved, save_cell_plan
from tests.unit.records.cells.cells import crossing, two_discs

Document = dict[str, Any]


@pytest.fixture(scope="module")
def plan() -> CellPlan:
    return crossing(two_discs())


@pytest.fixture
def document(plan: CellPlan) -> Document:
    found: Document = json.loads(SavedCellPlan.of(plan).file_text())
    return found


def test_a_plan_is_read_back_as_it_was(plan: CellPlan, tmp_path: Path) -> None:
    file = tmp_path / "cell.json"
    save_cell_plan(plan, file)
    saved = load_cell_plan(file)
    assert saved.counts == plan.counts
    assert (saved.plan.tolerates, saved.plan.notes) == (plan.tolerates, plan.notes)
    assert saved.plan.rectangles == plan.rectangles > 0
    assert [clock.arms for clock in saved.plan.clocks] == [clock.arms for clock in plan.clocks]
    assert [clock.columns for clock in saved.plan.clocks] == [clock.columns for clock in plan.clocks]
    times = np.linspace(0.0, plan.duration, 50)
    assert saved.plan.duration == plan.duration
    assert (saved.plan(times, {"left": 0.1}) == plan(times, {"left": 0.1})).all()
    assert saved.cell.robot.hash == two_discs().robot.hash
    saved.save(file)
    assert file.read_text() == SavedCellPlan.of(plan).file_text()
    assert isinstance(load_saved(file), SavedCellPlan)


def test_requests_are_kept(plan: CellPlan, document: Document) -> None:
    assert [clock["request"]["velocity_scale"] for clock in document["clocks"]] == [0.2, 1.0]
    assert len(document["robots"]) == 1, "a robot that is in two places is written once"


def test_one_robot_with_two_arms_is_kept(tmp_path: Path) -> None:
    dual = load_robot("wxai_dual")
    sides = {side: [name for name in dual.joint_names if name.startswith(side)] for side in ("left", "right")}
    cell = Cell.of(dual, sides, Scene(), tools={"right": "right_ee_gripper_link"})
    requests = {side: PlanRequest(q, q + 0.1) for side in sides for q in [cell.arm(side).robot.home]}
    plan = cell.plan(requests, delay=0.05)
    assert plan.ok
    save_cell_plan(plan, tmp_path / "cell.json")
    saved = load_cell_plan(tmp_path / "cell.json")
    assert saved.cell.arm("right").robot.tool_frame == "right_ee_gripper_link"
    assert saved.cell.robot.hash == dual.hash
    assert [clock.columns for clock in saved.plan.clocks] == [clock.columns for clock in plan.clocks]


def test_a_failure_is_kept(tmp_path: Path) -> None:
    cell = two_discs()
    wall = Scene((Obstacle("wall", Box((0.2, 0.2, 0.2)), Pose((0.8, 0.0, 0.0))),))
    cell = Cell(cell.layout.arms, wall)
    failed = crossing(cell)
    assert failed.failure is not None
    save_cell_plan(failed, tmp_path / "cell.json")
    failure = load_cell_plan(tmp_path / "cell.json").failure
    assert failure is not None
    assert (failure.reason, failure.detail) == (failed.failure.reason, failed.failure.detail)


def test_no_limit_of_the_delay_is_null(tmp_path: Path) -> None:
    alone = two_discs().plan({"left": PlanRequest([1.0, 0.1], [1.5, 0.1])})
    assert alone.tolerates == math.inf
    save_cell_plan(alone, tmp_path / "cell.json")
    assert json.loads((tmp_path / "cell.json").read_text())["tolerates"] is None
    assert load_cell_plan(tmp_path / "cell.json").plan.tolerates == math.inf


def test_a_plan_without_its_cell_is_not_saved(plan: CellPlan, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="an unknown cell"):
        save_cell_plan(replace(plan, layout=None), tmp_path / "cell.json")


def _set(*keys: str | int, value: Any) -> Callable[[Document], None]:
    def change(document: Document) -> None:
        inner: Any = document
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value

    return change


WRONG: dict[str, tuple[Callable[[Document], None], str]] = {
    "version": (_set("version", value=2), "version: got 2"),
    "unknown word": (_set("clocks", 0, "lateness", value=1.0), "unknown key 'lateness'"),
    "arm": (_set("clocks", 0, "arms", value=["middle"]), "unknown arm 'middle'"),
    "twice": (_set("clocks", 1, "arms", value=["left"]), "one motion of each arm"),
    "no motion": (_set("clocks", value=[]), "motions, or a failure and none"),
    "start": (_set("clocks", 0, "start", value=-0.1), r"clocks\[0\].start: got -0.1"),
    "tolerates": (_set("tolerates", value=-1.0), "tolerates: got -1.0"),
    "still": (_set("still", value=[0.0]), "still: got"),
    "robot": (_set("arms", 0, "robot", value=7), r"arms\[0\].robot: got 7"),
    "name": (_set("arms", 0, "name", value="right"), "each name once"),
    "base": (_set("arms", 0, "base", value=None), "an arm with a base"),
    "tool": (_set("arms", 0, "tool", value="upper_arm"), "an arm with a base and without a tool"),
    "mixed": (_set("arms", 0, "joints", value=["joint_1", "joint_2"]), "robots at places, or joints of one robot"),
    "hash": (_set("robots", 0, "hash", value="0" * 64), "that of the content"),
    "shared": (_set("clocks", 0, "arms", value=["left", "right"]), "joint"),
    "joints": (_set("robots", 0, "joint_names", value=["joint_1"]), r"robots\[0\]"),
    "not a list": (_set("arms", value={}), "arms"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named(what: str, document: Document, tmp_path: Path) -> None:
    change, said = WRONG[what]
    change(document)
    (tmp_path / "cell.json").write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match=said):
        load_cell_plan(tmp_path / "cell.json")


def test_other_files_are_refused_by_their_format(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text('{"format": "planner-service/plan"}')
    with pytest.raises(InvalidFile, match="format: got 'planner-service/plan'"):
        load_cell_plan(tmp_path / "plan.json")
    with pytest.raises(InvalidFile, match="version"):
        load_saved(tmp_path / "plan.json")


def test_robots_of_other_joints_are_read_each_with_its_own(tmp_path: Path) -> None:
    cell = Cell({"small": load_robot("planar2"), "large": Arm(load_robot("wxai"), Pose((3.0, 0.0, 0.0)))}, Scene())
    requests = {name: PlanRequest(q, q + 0.1) for name in cell.arms for q in [cell.arm(name).robot.home]}
    plan = cell.plan(requests)
    assert plan.ok, plan
    save_cell_plan(plan, tmp_path / "cell.json")
    assert load_cell_plan(tmp_path / "cell.json").plan.duration == plan.duration
