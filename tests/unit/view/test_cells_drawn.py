"""Pictures of cells show each arm where its own clock has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planner_service import InvalidRequest
from planner_service.cell import CellPlan
from planner_service.view.still.cells import draw_cell, draw_cell_motion
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


def test_a_picture_moves(plan: CellPlan, tmp_path: Path) -> None:
    pictures = pytest.importorskip("PIL.Image")
    draw_cell_motion(plan, tmp_path / "cell.webp", speed=10.0)
    with pictures.open(tmp_path / "cell.webp") as moving:
        assert moving.n_frames > 5


def test_what_cannot_be_drawn_is_named(plan: CellPlan, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="a plan of an unknown cell"):
        draw_cell(replace(plan, layout=None), tmp_path / "cell.png")
    with pytest.raises(InvalidRequest, match="speed"):
        draw_cell_motion(plan, tmp_path / "cell.webp", speed=0.0)
    with pytest.raises(InvalidRequest, match="a CellPlan"):
        draw_cell("plan", tmp_path / "cell.png")  # type: ignore[arg-type]
