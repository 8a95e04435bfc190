"""Pictures of cells show each arm where its own clock has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service import InvalidRequest, Trajectory
from planner_service.cell import CellPlan
from planner_service.view.still.cells import draw_cell, draw_cell_motion
from planner_service.view.still.clocks import WAITS, clock_rows, strip_height, waits_of
from tests.unit.records.cells.cells import crossing, two_discs


@pytest.fixture(scope="module")
def plan() -> CellPlan:
    return crossing(two_discs())


def drawn(plan: CellPlan, file: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    pictures = pytest.importorskip("PIL.Image")
    draw_cell(plan, file)
    with pictures.open(file) as image:
        return np.asarray(image.convert("RGB"))


def test_an_arm_that_starts_later_is_drawn_elsewhere_on_its_way(plan: CellPlan, tmp_path: Path) -> None:
    image = drawn(plan, tmp_path / "cell.png")
    assert image.shape == (800, 1280, 3)
    clocks = tuple(replace(clock, start=0.0) for clock in plan.clocks)
    at_once = drawn(replace(plan, clocks=clocks), tmp_path / "at_once.png")
    assert (image[:700] != at_once[:700]).any()


def test_rows_of_the_clocks_show_when_arms_move_and_wait(plan: CellPlan) -> None:
    pytest.importorskip("PIL.Image")
    late = next(clock for clock in plan.clocks if clock.start > 0.0)
    first = next(clock for clock in plan.clocks if clock.start == 0.0)
    assert waits_of(late) == ()
    rows = clock_rows(plan, ("left", "right"), 800)
    count = (rows == np.array(WAITS)).all(axis=2).sum(axis=1)
    assert 0 < count.max() < 800 * late.start / plan.duration
    at_once = replace(plan, clocks=(first, replace(late, start=0.0)))
    assert not (clock_rows(at_once, ("left", "right"), 800) == np.array(WAITS)).all(axis=2).any()
    alone = clock_rows(replace(plan, clocks=(first,)), ("left", "right"), 800, now=0.5)
    assert alone.shape == rows.shape == (strip_height(2), 800, 3)
    assert (alone != clock_rows(replace(plan, clocks=(first,)), ("left", "right"), 800)).any()


def test_a_wait_on_the_way_is_found(plan: CellPlan) -> None:
    trajectory = plan.clocks[0].plan.unwrap()[1]
    rest = trajectory.s(trajectory.duration)
    stays = Trajectory(
        trajectory.path,
        np.append(trajectory.durations, 1.0),
        np.vstack([trajectory.coefficients, [rest, 0.0, 0.0, 0.0]]),
    )
    clock = replace(plan.clocks[0], start=2.0, plan=replace(plan.clocks[0].plan, trajectory=stays))
    ((begin, end),) = waits_of(clock)
    assert (begin, end) == pytest.approx((2.0 + trajectory.duration, 3.0 + trajectory.duration), abs=0.01)


def test_a_picture_moves(plan: CellPlan, tmp_path: Path) -> None:
    pictures = pytest.importorskip("PIL.Image")
    draw_cell_motion(plan, tmp_path / "cell.webp", speed=10.0)
    with pictures.open(tmp_path / "cell.webp") as moving:
        assert moving.n_frames > 3
        assert moving.size == (800, 560)


def test_what_cannot_be_drawn_is_named(plan: CellPlan, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="a plan of an unknown cell"):
        draw_cell(replace(plan, layout=None), tmp_path / "cell.png")
    with pytest.raises(InvalidRequest, match="speed"):
        draw_cell_motion(plan, tmp_path / "cell.webp", speed=0.0)
    with pytest.raises(InvalidRequest, match="a CellPlan"):
        draw_cell("plan", tmp_path / "cell.png")  # type: ignore[arg-type]
