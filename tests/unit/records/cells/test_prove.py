"""What a file of a cell claims is worked out anew, over all clocks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service import Box, InvalidRequest, NotProven, Obstacle, PlanRequest, Pose, Scene
from planner_service.cell import Cell, CellPlan, OwnClock
from planner_service.records.cells import SavedCellPlan, load_cell_plan, prove_cell, save_cell_plan
from tests.unit.records.cells.cells import DELAY, crossing, two_discs


@pytest.fixture(scope="module")
def plan() -> CellPlan:
    return crossing(two_discs())


def changed(whole: CellPlan, k: int, **values: object) -> CellPlan:
    clocks = list(whole.clocks)
    clocks[k] = replace(clocks[k], **values)  # type: ignore[arg-type]
    return replace(whole, clocks=tuple(clocks))


def test_an_honest_plan_is_proven(plan: CellPlan, tmp_path: Path) -> None:
    save_cell_plan(plan, tmp_path / "cell.json")
    for each in (plan, SavedCellPlan.of(plan), load_cell_plan(tmp_path / "cell.json")):
        proven = prove_cell(each)
        assert proven.problems == ()
        assert proven.tolerates == plan.tolerates >= DELAY
        assert proven.rectangles > 0
        assert proven.required() is proven


def test_a_delay_that_is_too_large_is_refused(plan: CellPlan) -> None:
    assert not prove_cell(replace(plan, tolerates=plan.tolerates + 0.1)).certified
    with pytest.raises(NotProven, match="left x right: not proven apart"):
        prove_cell(replace(plan, tolerates=5.0)).required()


def test_a_moved_start_is_refused(plan: CellPlan) -> None:
    second = next(k for k, clock in enumerate(plan.clocks) if clock.start > 0.0)
    assert not prove_cell(changed(plan, second, start=0.0)).certified
    assert "seconds >= 0" in prove_cell(changed(plan, second, start=-1.0)).problems[0]


def test_certificates_are_new(plan: CellPlan) -> None:
    none = replace(plan.clocks[0].plan, certificate=None)
    proven = prove_cell(changed(plan, 0, plan=none))
    assert proven.certified
    assert proven.plan.clocks[0].plan.certificate == plan.clocks[0].plan.certificate


def test_a_motion_that_begins_elsewhere_is_refused(plan: CellPlan) -> None:
    assert prove_cell(replace(plan, still=plan.still + 0.01)).problems == (
        "left: its motion does not begin where it stands",
        "right: its motion does not begin where it stands",
    )


def test_swapped_motions_are_refused(plan: CellPlan) -> None:
    one, two = plan.clocks
    swapped = replace(one, plan=two.plan), replace(two, plan=one.plan)
    assert not prove_cell(replace(plan, clocks=swapped)).certified


def test_arms_are_checked(plan: CellPlan) -> None:
    first = plan.clocks[0]
    twice = replace(plan, clocks=(first, first))
    assert any("more than one motion" in problem for problem in prove_cell(twice).problems)
    unknown = OwnClock(("middle",), first.plan, 0.0, ())
    assert any("unknown arm" in problem for problem in prove_cell(replace(plan, clocks=(unknown,))).problems)


def test_an_arm_that_stands_is_not_in_the_way() -> None:
    cell = two_discs()
    left = PlanRequest([0.3, 0.1], [1.5, 0.1])
    alone = cell.plan({"left": left}, standing={"right": [-0.1, 0.1]})
    assert prove_cell(alone).certified
    there = replace(alone, still=cell.joined({"left": left.start, "right": [-0.6, 0.1]}))
    problems = prove_cell(there).problems
    assert any("right_" in problem for problem in problems)


def test_what_stands_is_apart_from_the_scene() -> None:
    cell = two_discs()
    alone = cell.plan({"left": PlanRequest([1.0, 0.1], [1.5, 0.1])}, standing={"right": [1.0, 0.1]})
    saved = SavedCellPlan.of(alone)
    assert prove_cell(saved).certified
    tip = cell.arm("right").robot.tool_pose(np.array([1.0, 0.1]))[:3, 3]
    post = Scene((Obstacle("post", Box((0.05, 0.05, 0.05)), Pose(tuple(tip))),))
    problems = prove_cell(saved.within(post)).problems
    assert problems
    assert problems[0].startswith("arms that stand: right_forearm x post")


def test_arms_that_share_a_clock_are_proven_over_it_and_late() -> None:
    cell = two_discs()
    start, goal = cell.joined({"left": [0.3, 0.1], "right": [0.3, 0.1]}), cell.joined({"left": [0.8, 0.1]})
    goal[2:] = (0.0, 0.1)
    together = cell.service.plan(PlanRequest(start, goal))
    columns = ((0, 1), (2, 3))
    shared = CellPlan((OwnClock(("left", "right"), together, 0.0, columns),), 0.05, None, start, layout=cell.layout)
    assert prove_cell(shared).certified
    assert prove_cell(replace(shared, tolerates=0.0)).certified


def test_a_failure_is_not_proven() -> None:
    arms = two_discs().layout.arms
    with pytest.raises(InvalidRequest, match="a plan, not a failure"):
        prove_cell(crossing(Cell(arms, Scene((Obstacle("on", Box((1.0, 1.0, 1.0))),)))))
