"""The study of two arms finds clocks that stop too late and schedules without waits, and nothing in what is proven."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.harness.audit import Auditor
from benchmarks.studies import two_arms
from benchmarks.studies.two_arms import picks
from benchmarks.worlds.placed import table_of_arms
from planner_service import InvalidRequest, Pose, load_robot
from planner_service.cell import Arm, Cell


def test_joint_stops_are_kept_and_planted_faults_are_found() -> None:
    report = two_arms.run(part="stops", queries=20, seed=2)
    assert [promise.text for promise in report.promises if not promise.kept] == []
    assert len(report.promises) == 5
    own = [row for row in report.rows if row["clocks"] == "as they are"]
    assert len(own) == 20
    assert any(row["stopped"] for row in own)


def test_schedules_of_picks_are_proven_again_and_nothing_touches() -> None:
    report = picks.run(1, 3, blocks=3, executions=2)
    assert [row["ok"] for row in report.rows] == [True, True]
    broken = [promise.text for promise in report.promises if not promise.kept]
    assert all("of the time one after the other" in text for text in broken)


def test_robots_at_places_are_the_same_to_coal(tmp_path: Path) -> None:
    places = {"one": ("panda", Pose((-0.15, 0.3, 0.0))), "two": ("wxai", Pose.from_rpy((0.3, -0.2, 0.0), (0, 0, 1.0)))}
    cell = Cell({name: Arm(load_robot(robot), base) for name, (robot, base) in places.items()}, "bin")
    auditor = Auditor(table_of_arms(places, tmp_path), cell.scene)
    states = np.random.default_rng(1).uniform(*cell.robot.bounds, (100, cell.robot.n))
    mine = [cell.service.checker.state_is_free(q) for q in states]
    assert [auditor.judge(q[None])["verdict"] == "free" for q in states] == mine
    assert 0 < sum(mine) < 100


def test_peers_get_the_same_queries_and_one_judge() -> None:
    report = two_arms.run(part="peers", queries=1, seed=4)
    assert all(promise.kept for promise in report.promises)
    planners = {row["planner"] for row in report.rows}
    assert len(planners) == 2, "SRMP needs a Python of its own"
    for row in report.rows:
        assert row["audit"] in ("free", "none")
        assert row["off"] < 1e-6
        assert row["speed"] < 1.01


def test_a_python_without_srmp_is_named() -> None:
    with pytest.raises(InvalidRequest, match="srmp"):
        two_arms.run(part="peers", queries=1, against=Path(sys.executable))
