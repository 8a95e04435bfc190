"""The log that OMPL's own script makes a database of."""

from __future__ import annotations

import re
import sqlite3
import subprocess
import sys
from datetime import datetime, timezone
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks.harness import ompl_log, rows
from benchmarks.harness.rows import Results, Row
from tests.benchmarks.results import HEADER, UNASKED, counted, results_file, row

WHEN = datetime(2026, 11, 21, 12, 0, tzinfo=timezone.utc)


def found() -> tuple[Row, ...]:
    failed = {"ok": False, "failure": "CHECK_BUDGET_EXHAUSTED", "length": None, "duration": None, "clearance": None}
    hit = {"step": 0.01, "verdict": "colliding", "depth": 0.1, "pair": ["a", "b"]}
    return (
        row("bin/0", checks={"straight line": {"states": 3, "edges": 1, "distances": 0}, **counted(40)}),
        row("bin/1", 1, **failed, audit=UNASKED, checks=counted(900)),
        row("bin/0", planner="prm:milestones=200", seconds={"straight line": 0.25}, audit=hit),
        row("bin/1", tool="mplib", planner="rrt|connect", checks={}),
    )


@pytest.fixture
def database(tmp_path: Path) -> sqlite3.Connection:
    log = tmp_path / "runs.log"
    log.write_text(ompl_log.text_of(Results(HEADER, found()), WHEN), "utf-8")
    script = [sys.executable, "-m", "ompl.ompl_benchmark_statistics", str(log), "-d", str(tmp_path / "runs.db")]
    done = subprocess.run(script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return sqlite3.connect(tmp_path / "runs.db")


def test_ompls_script_makes_one_row_of_each_run_and_one_column_of_each_count(database: sqlite3.Connection) -> None:
    query = """
        SELECT plannerConfigs.name, solved, correct_solution, collision_checks, states_search, edges_straight_line,
               simplified_solution_length, seed FROM runs JOIN plannerConfigs ON plannerid = plannerConfigs.id
    """
    assert database.execute(query).fetchall() == [
        ("planner_service_a", 1, 1, 43, 40, 1, 2.0, 0),
        ("planner_service_a", 0, None, 900, 900, None, None, 1),
        ("planner_service_prm_milestones_200", 1, 0, 100, 100, None, 2.0, 0),
        ("mplib_rrt_connect", 1, 1, None, None, None, 2.0, 0),
    ]
    assert database.execute("SELECT seconds_straight_line FROM runs WHERE id = 3").fetchone() == (0.25,)


def test_ompls_script_finds_the_experiment_and_what_enumerations_mean(database: sqlite3.Connection) -> None:
    told = database.execute("SELECT name, hostname, date, runcount, setup FROM experiments").fetchall()
    assert [each[:4] for each in told] == [("some", "Linux", "2026-11-21 12:00:00", 2)]
    assert '"suite": "some"' in told[0][4]
    query = "SELECT description FROM runs JOIN enums ON enums.name = ? AND enums.value = {} ORDER BY id"
    meaning = {
        name: [text for (text,) in database.execute(query.format(name), (name,))]
        for name in ("problem", "failure", "status")
    }
    assert meaning["problem"] == ["bin/0", "bin/1", "bin/0", "bin/1"]
    assert meaning["failure"] == ["planned", "CHECK_BUDGET_EXHAUSTED", "planned", "planned"]
    assert meaning["status"] == ["Exact solution", "Timeout", "Exact solution", "Exact solution"]


def test_every_name_that_becomes_sql_is_letters_digits_and_blanks() -> None:
    evil = row("bin/0", planner="a`; DROP TABLE runs", checks={"x); --": {"states": 1, "edges": 1, "distances": 1}})
    text = ompl_log.text_of(Results(HEADER, (evil,)), WHEN)
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.endswith("properties for each run"))
    count = int(lines[start].split()[0])
    assert all(re.fullmatch(r"[A-Za-z0-9 ]+ (REAL|INTEGER|BOOLEAN|ENUM)", line) for line in lines[start + 1 :][:count])
    assert lines[start - 4] == "planner_service_a_DROP_TABLE_runs"


def test_the_command_writes_the_log_of_a_file(tmp_path: Path) -> None:
    results, log = results_file(tmp_path / "a.jsonl", *found()), tmp_path / "a.log"
    assert command.main(["export", str(results), "--ompl-log", str(log)]) == 0
    assert log.read_text("utf-8").splitlines()[1] == "Experiment some"
    assert rows.read(results).rows == found()
