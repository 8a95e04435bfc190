"""Suites, and the rows that are made of them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.harness import runner
from benchmarks.harness.attempts import states_of
from benchmarks.harness.audit import Auditor, between, worst
from benchmarks.harness.report import Row
from benchmarks.harness.suite import SUITES, Suite, stored, suite_named
from benchmarks.studies import suites
from planner_service import BalancedRRTConnect, RRTConnect, UnknownName, load_scene
from planner_service.planners import Planner

PLANNERS: dict[str, Planner] = {"rrtconnect": RRTConnect(), "balancedrrtconnect": BalancedRRTConnect()}


@pytest.fixture(scope="module")
def tiny() -> Suite:
    return Suite("tiny", "a query", PLANNERS, range(2), (lambda: stored(["bin"], [0]),))


# --- suites


def test_the_suites_that_come_along_hold_what_they_are_about() -> None:
    kinds = {name: {p.kind for p in suite.problems} for name, suite in SUITES.items()}
    assert set(kinds) == {"smoke", "tabletop", "seeds", "narrow", "panda"}
    assert kinds["tabletop"] == kinds["seeds"] == {"bin", "shelf", "post", "clutter"}
    assert kinds["narrow"] == {"narrow", "window"}
    assert len(kinds["panda"]) == 7
    assert len(suite_named("panda").problems) == 70
    assert all(len({p.id for p in suite.problems}) == len(suite.problems) for suite in SUITES.values())
    with pytest.raises(UnknownName, match="did you mean 'smoke'"):
        suite_named("smok")


# --- rows


@pytest.fixture(scope="module")
def found(tiny: Suite) -> list[Row]:
    return list(runner.made(runner.jobs_of(tiny)))


def test_a_row_tells_what_a_plan_cost_and_what_became_of_it(found: list[Row]) -> None:
    row = found[0]
    told = [row[key] for key in ("suite", "problem", "planner", "seed", "ok")]
    assert told == ["tiny", "bin/0", "rrtconnect", 0, True]
    assert set(row["checks"]) == set(row["seconds"]) >= {"search", "shortcut", "certify"}
    assert states_of(row) == sum(counts["states"] for counts in row["checks"].values()) > 0
    assert 0.0 < row["length"] <= row["raw_length"]
    assert row["clearance"] > 0.0
    assert max(row["peaks"]["velocity"], row["peaks"]["acceleration"]) <= 1.0 + 1e-9
    assert row["audit"] == {"step": 0.01, "verdict": "free", "depth": None, "pair": None}


# --- the audit


def test_the_audit_finds_the_deepest_touch_and_a_limit() -> None:
    auditor = Auditor("planar2", load_scene("discs"))
    line = between([[0.0, 0.0], [np.pi / 2, -np.pi / 2]])
    told = auditor.judge(line)
    assert told["verdict"] == "colliding"
    assert set(told["pair"]) == {"forearm", "lesson_disc"}
    assert 0.01 < told["depth"] < 0.2
    assert auditor.judge(np.array([[0.0, 4.0]]))["verdict"] == "outside_limits"
    assert auditor.judge(line[:2])["verdict"] == "free"
    assert auditor.clearance(line[:2]) > 0.0 > auditor.clearance(line)
    assert worst([auditor.judge(line[:2]), told]) == told


# --- the study


def test_a_suite_is_a_study_whose_tables_count_what_was_solved(tiny: Suite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SUITES, "smoke", tiny)
    report = suites.run("smoke", seeds=1)
    assert [(row["planner"], row["seed"]) for row in report.rows] == [("rrtconnect", 0), ("balancedrrtconnect", 0)]
    solved, kinds = ([list(column.cells) for column in table.columns] for table in report.tables)
    assert (solved[0], solved[1]) == (["rrtconnect", "balancedrrtconnect"], ["1/1", "1/1"])
    assert [column.header for column in report.tables[1].columns][1:] == ["bin"]
    assert all(str(cell).startswith("1/1, ") for column in kinds[1:] for cell in column)
