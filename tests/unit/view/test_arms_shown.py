"""The page plays the plan of a cell: every arm on its own clock, with a row for each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service import InvalidRequest, NotProven, PlannerService
from planner_service.cell import CellPlan
from planner_service.cli.view import opened
from planner_service.planning.result import Failure, Reason, Stage
from planner_service.records.cells import save_cell_plan
from planner_service.view.controls.timeline import timeline_html
from planner_service.view.markdown import result_markdown
from planner_service.view.state import ViewState
from tests.unit.records.cells.cells import DELAY, crossing, two_discs


@pytest.fixture(scope="module")
def plan() -> CellPlan:
    return crossing(two_discs())


def test_every_arm_is_where_its_own_clock_has_it(plan: CellPlan) -> None:
    playback = ViewState.of(two_discs().service, plan).playback
    assert playback is not None
    assert playback.duration == plan.duration
    times = np.linspace(0.0, plan.duration, 500)
    (clip,) = playback.clips
    assert np.array_equal(clip.trajectory(times), plan(times))
    h = 1e-6
    for order in (1, 2):
        inside = times[5:-5]
        slope = (clip.trajectory(inside + h, order - 1) - clip.trajectory(inside - h, order - 1)) / (2.0 * h)
        off = np.abs(slope - clip.trajectory(inside, order))
        assert np.quantile(off, 0.97) < 1e-3, "but where a law has a corner"
    assert playback.samples.clearance.min() > 0.0
    assert [len(points) for points in playback.tools] == [200, 200]


def test_rows_say_when_arms_move_and_wait(plan: CellPlan) -> None:
    state = ViewState.of(two_discs().service, plan)
    assert state.playback is not None
    rows = dict(state.playback.rows)
    late = next(clock for clock in plan.clocks if clock.start > 0.0)
    (wait, move) = rows[late.arms[0]]
    assert wait == (0.0, late.start, True)
    assert move == (late.start, late.end, False)
    shown = timeline_html(state.playback)
    assert shown.count(" waits from ") == 1
    assert shown.count(" moves from ") == 2
    assert f"each arm may be {DELAY:.3f} s late" in result_markdown(state).replace("\\", "")


def test_names_are_escaped(plan: CellPlan) -> None:
    evil = tuple(replace(clock, arms=("<b>",)) for clock in plan.clocks)
    state = ViewState.of(two_discs().service, replace(plan, clocks=evil, layout=None))
    assert state.playback is not None
    assert "<b>" not in timeline_html(state.playback)


def test_a_plan_of_others_is_refused_and_a_failure_is_shown(plan: CellPlan) -> None:
    with pytest.raises(InvalidRequest, match="4 joints"):
        ViewState.of(PlannerService("wxai", "empty"), plan)
    failure = Failure(Stage.SEARCH, Reason.PLANNING_FAILED, "no way")
    state = ViewState.of(two_discs().service, replace(plan, clocks=(), failure=failure))
    assert state.playback is None
    assert "no way" in result_markdown(state)


def test_the_command_proves_what_it_shows(plan: CellPlan, tmp_path: Path) -> None:
    file = tmp_path / "cell.json"
    save_cell_plan(plan, file)
    service, shown, notes = opened(str(file), None, None)
    assert isinstance(shown, CellPlan)
    assert ViewState.of(service, shown).playback is not None
    assert "one clock" in notes[0]
    save_cell_plan(replace(plan, tolerates=5.0), file)
    with pytest.raises(NotProven):
        opened(str(file), None, None)
    save_cell_plan(plan, file)
    with pytest.raises(InvalidRequest, match="--allow"):
        opened(str(file), None, None, ["a:b"])
