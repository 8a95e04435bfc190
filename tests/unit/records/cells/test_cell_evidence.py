"""Evidence of cells is made of proofs that hold, and of no others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planner_service import NotProven
from planner_service.cell import CellPlan
from planner_service.records.cells import SavedCellPlan, load_cell_plan, prove_cell, with_cell_evidence
from tests.unit.records.cells.cells import DELAY, crossing, two_discs


@pytest.fixture(scope="module")
def plan() -> CellPlan:
    return crossing(two_discs())


def test_it_is_kept_in_the_file_and_proven_like_any_other(plan: CellPlan, tmp_path: Path) -> None:
    shown = with_cell_evidence(replace(SavedCellPlan.of(plan), sections={"mine": 1}))
    shown.save(tmp_path / "shown.json")
    saved = load_cell_plan(tmp_path / "shown.json")
    assert set(saved.sections) == {"mine", "evidence"}
    assert saved.plan.tolerates == plan.tolerates >= DELAY
    assert prove_cell(saved).certified
    (between,) = saved.sections["evidence"]["between"]
    assert between["arms"] == ["left", "right"]
    assert between["clearance"] > 0.001


def test_what_does_not_hold_gets_none(plan: CellPlan) -> None:
    with pytest.raises(NotProven, match="left x right"):
        with_cell_evidence(replace(plan, tolerates=1.0))
