"""Suites, and the rows that are made of them."""

from __future__ import annotations

import random
from io import StringIO
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks.harness import runner
from benchmarks.harness.attempts import Ask, attempt, states_of
from benchmarks.harness.audit import Auditor, between, worst
from benchmarks.harness.report import Row
from benchmarks.harness.suite import Suite, load_suite, planner_of, seeds_of, suite_names
from benchmarks.studies import suites
from benchmarks.worlds import planar
from benchmarks.worlds.drawn import blocked_ends
from benchmarks.worlds.queries import load
from planner_service import PRM, CollisionChecker, RRTConnect, load_robot, load_scene
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.planners import PLANNERS

QUIET = Console(file=StringIO())

TINY = """\
about = "two queries"
planners = ["rrtconnect", "balancedrrtconnect"]
seeds = "0:2"

[[queries]]
scenes = ["bin"]
numbers = [0]
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Suite:
    return suite_of(tmp_path, TINY)


def suite_of(folder: Path, text: str) -> Suite:
    (folder / "tiny.toml").write_text(text, "utf-8")
    return load_suite(str(folder / "tiny.toml"))


# --- suites


def test_the_suites_that_come_along_hold_what_they_are_about() -> None:
    assert set(suite_names()) >= {"smoke", "tabletop", "seeds", "narrow", "panda"}
    kinds = {name: {p.kind for p in load_suite(name).problems} for name in suite_names()}
    assert kinds["tabletop"] == {"bin", "shelf", "post", "clutter"}
    assert kinds["narrow"] == {"narrow", "window"}
    assert len(kinds["panda"]) == 7
    assert len(load_suite("panda").problems) == 70
    assert load_suite("seeds").seeds == range(20)


def test_a_suite_makes_its_problems_from_its_tables(tiny: Suite) -> None:
    (motion,) = tiny.problems
    assert (motion.id, motion.kind, motion.robot) == ("bin/0", "bin", "wxai")
    assert motion.start.tolist() == load("bin")[0].start.tolist()
    assert (tiny.planners, tiny.seeds, tiny.max_checks) == (("rrtconnect", "balancedrrtconnect"), range(2), 50_000)


def test_all_problems_of_a_suite_are_told_at_once(tmp_path: Path) -> None:
    text = """\
about = 3
planners = ["rrtconect", "prm:milestone=3"]
seeds = "5:2"
speed = 1
[[queries]]
scenes = ["bim"]
numbers = [20]
[[drawn]]
robots = ["planar:99", "wxia"]
scene = "discs"
count = 0
[[problems]]
file = "../mbm_panda.json"
robot = "panda_mbm"
"""
    with pytest.raises(InvalidFile) as caught:
        suite_of(tmp_path, text)
    told = "\n".join(caught.value.problems)
    wrong = ("about", "rrtconect", "milestone", "seeds", "speed", "bim", "numbers", "planar:", "wxia", "count", "file")
    assert [word for word in wrong if word not in told] == []


def test_a_suite_without_problems_or_with_one_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidFile, match="no problems"):
        suite_of(tmp_path, 'about = "none"\nplanners = ["rrt"]\nseeds = "0"\n')
    with pytest.raises(InvalidFile, match="'bin/0' is there twice"):
        suite_of(tmp_path, TINY + '[[queries]]\nscenes = ["bin"]\n')
    with pytest.raises(UnknownName, match="did you mean 'smoke'"):
        load_suite("smok")


def test_a_set_of_problems_is_refused_for_a_robot_with_other_joints(tmp_path: Path) -> None:
    table = '[[problems]]\nfile = "mbm_panda.json"\nrobot = "wxai"\n'
    with pytest.raises(InvalidFile, match=r"problems\[0\].*robot: .*wxai has the joints joint_0"):
        suite_of(tmp_path, TINY + table)


def test_every_planner_of_the_service_is_named_as_the_service_names_it() -> None:
    assert [type(planner_of(name)) for name in PLANNERS] == list(PLANNERS.values())
    assert planner_of("rrtconnect:range=0.3") == RRTConnect(range=0.3)
    assert planner_of("prm:milestones=9,neighbours=2") == PRM(milestones=9, neighbours=2)


def test_a_setting_that_a_planner_does_not_have_is_refused() -> None:
    for text in ["prm:milestones", "prm:milestones=x", "rrtconnect:samples=3", "rrt:range=-1"]:
        with pytest.raises(InvalidRequest, match="setting=number"):
            planner_of(text)


def test_seeds_are_one_or_a_range() -> None:
    assert seeds_of("3:6") == range(3, 6)
    assert seeds_of("7") == range(7, 8)
    for text in ("", "6:3", "3:3", "-1", "0:1000000", "a:b"):
        with pytest.raises(InvalidRequest, match="seeds"):
            seeds_of(text)


# --- worlds that grow


@pytest.mark.parametrize("joints", [2, 5])
def test_a_planar_arm_reaches_as_far_however_many_joints_it_has(joints: int) -> None:
    robot = load_robot(planar.planar_robot(joints))
    assert robot.n == joints
    assert robot.tool_pose(np.zeros(joints))[:3, 3].tolist() == pytest.approx([1.5, 0.0, 0.0])
    q = np.array([0.3 - 0.2 * k for k in range(joints)])
    angles = np.cumsum(q)
    tip = np.array([np.cos(angles).sum(), np.sin(angles).sum()]) * 1.5 / joints
    assert robot.tool_pose(q)[:2, 3].tolist() == pytest.approx(tip.tolist())


def test_drawn_ends_are_free_not_joined_by_a_line_and_the_same_each_time() -> None:
    checker = CollisionChecker(load_robot(planar.planar_robot(3)), load_scene("discs"))
    drawn, again = (list(islice(blocked_ends(checker, random.Random(5)), count)) for count in (3, 2))
    assert all(checker.state_is_free(q) for ends in drawn for q in ends)
    assert not any(checker.edge_is_free(*ends) for ends in drawn)
    assert [[q.tolist() for q in ends] for ends in again] == [[q.tolist() for q in ends] for ends in drawn[:2]]


# --- rows


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[Row]:
    suite = suite_of(tmp_path_factory.mktemp("suite"), TINY)
    return list(runner.made(runner.jobs_of(suite)))


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


SAME = ("checks", "path_hash", "length")


def test_the_same_job_has_the_same_counts_and_bits_again(found: list[Row], tiny: Suite) -> None:
    for row, job in zip(found, runner.jobs_of(tiny), strict=True):
        again = job.row()
        assert [row[key] for key in SAME] == [again[key] for key in SAME]


def test_a_run_that_fails_is_a_row_charged_what_it_spent(tiny: Suite) -> None:
    row = attempt(tiny.problems[0], Ask("rrtconnect", 0, 300))
    assert (row["ok"], row["failure"], row["audit"]["verdict"]) == (False, "CHECK_BUDGET_EXHAUSTED", "not_asked")
    assert 0 < states_of(row) <= 300
    assert row["cpu_seconds"] > 0.0
    assert (row["length"], row["path_hash"]) == (None, None)


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
    monkeypatch.setattr(suites, "load_suite", lambda _: tiny)
    report = suites.run("smoke", seeds=1)
    assert [(row["planner"], row["seed"]) for row in report.rows] == [("rrtconnect", 0), ("balancedrrtconnect", 0)]
    solved, kinds = ([list(column.cells) for column in table.columns] for table in report.tables)
    assert (solved[0], solved[1]) == (["rrtconnect", "balancedrrtconnect"], ["1/1", "1/1"])
    assert [column.header for column in report.tables[1].columns][1:] == ["bin"]
    assert all(str(cell).startswith("1/1, ") for column in kinds[1:] for cell in column)
