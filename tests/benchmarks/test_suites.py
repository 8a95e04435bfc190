"""Suites, rows, and how a run makes the ones of the others."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks import __main__ as command
from benchmarks.harness import rows, runner
from benchmarks.harness.attempts import Ask, attempt
from benchmarks.harness.audit import Auditor, between, worst
from benchmarks.harness.environment import environment
from benchmarks.harness.sources import Motion, Task, ToyQuery
from benchmarks.harness.suite import (
    LESSON,
    Suite,
    grower_of,
    load_suite,
    planner_of,
    require_planner,
    seeds_of,
    suite_names,
)
from benchmarks.worlds import planar
from benchmarks.worlds.drawn import blocked_ends
from benchmarks.worlds.queries import load
from planner_service import PRM, CollisionChecker, PlannerService, Roadmap, RRTConnect, load_robot, load_scene
from planner_service.errors import InvalidFile, InvalidRequest, UnknownName
from planner_service.parallel import Engine, Processes
from planner_service.planners import PLANNERS
from tests.benchmarks.results import HEADER, results_file

QUIET = Console(file=StringIO())

TINY = """\
about = "two queries"
planners = ["rrtconnect", "lesson"]
seeds = "0:2"

[[queries]]
scenes = ["bin"]
numbers = [0]

[[toy]]
"""


@pytest.fixture
def tiny(tmp_path: Path) -> Suite:
    return suite_of(tmp_path, TINY)


def suite_of(folder: Path, text: str) -> Suite:
    (folder / "tiny.toml").write_text(text, "utf-8")
    return load_suite(str(folder / "tiny.toml"))


# --- suites


def test_the_suites_that_come_along_hold_what_they_are_about() -> None:
    assert set(suite_names()) >= {"smoke", "tabletop", "seeds", "pick_place", "narrow", "lesson", "panda"}
    kinds = {name: {p.kind for p in load_suite(name).problems} for name in suite_names()}
    assert kinds["tabletop"] == {"bin", "shelf", "post", "clutter"}
    assert kinds["narrow"] == {"narrow", "window"}
    assert kinds["pick_place"] == {"task"}
    assert kinds["lesson"] == {"toy"}
    assert len(kinds["panda"]) == 7
    assert len(load_suite("panda").problems) == 70
    assert load_suite("lesson").seeds == range(50)


def test_a_suite_makes_its_problems_from_its_tables(tiny: Suite) -> None:
    motion, toy = tiny.problems
    assert isinstance(motion, Motion)
    assert isinstance(toy, ToyQuery)
    assert (motion.id, motion.kind, motion.robot) == ("bin/0", "bin", "wxai")
    assert motion.start.tolist() == load("bin")[0].start.tolist()
    assert (tiny.planners, tiny.seeds, tiny.max_checks) == (("rrtconnect", "lesson"), range(2), 50_000)


def test_a_task_puts_its_block_and_tray_on_the_table_and_leaves_out_what_it_says(tmp_path: Path) -> None:
    table = '[[tasks]]\nscene = "bin"\npick = "block_2"\nonto = "tray"\nwithout = ["demo_post"]\n'
    with pytest.raises(InvalidFile, match="block_2"):
        suite_of(tmp_path, TINY + table)
    placed = table.replace('"bin"', '"post"').replace("block_2", "blue_block").replace('["demo_post"]', '["post_left"]')
    suite = suite_of(tmp_path, TINY + placed + "block = [0.3, -0.1]\ntray = [0.2, 0.28]\n")
    (task,) = [problem for problem in suite.problems if isinstance(problem, Task)]
    assert task.scene.obstacle("blue_block").pose.position == (0.3, -0.1, 0.0225)
    assert "post_left" not in [obstacle.name for obstacle in task.scene.obstacles]


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


def test_rows_made_by_several_processes_are_those_of_one(tiny: Suite) -> None:
    def told(engine: Engine | None) -> list[rows.Row]:
        timeless = dict.fromkeys(("seconds", "total_seconds", "cpu_seconds"))
        return [row | timeless for row in runner.made(runner.jobs_of(tiny), engine=engine)]

    assert told(Processes(2)) == told(None)


def test_every_planner_of_the_service_is_named_as_the_service_names_it() -> None:
    assert [type(planner_of(name)) for name in PLANNERS] == list(PLANNERS.values())
    assert planner_of("rrtconnect:range=0.3") == RRTConnect(range=0.3)
    assert planner_of("prm:milestones=9,neighbours=2") == PRM(milestones=9, neighbours=2)
    require_planner(LESSON)


@pytest.mark.parametrize("text", ["prm:milestones", "prm:milestones=x", "rrtconnect:samples=3", "rrt:range=-1"])
def test_a_setting_that_a_planner_does_not_have_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest, match="setting=number"):
        planner_of(text)


def test_seeds_are_one_or_a_range() -> None:
    assert seeds_of("3:6") == range(3, 6)
    assert seeds_of("7") == range(7, 8)
    for text in ("", "6:3", "3:3", "-1", "0:1000000", "a:b"):
        with pytest.raises(InvalidRequest, match="seeds"):
            seeds_of(text)


def test_a_roadmap_takes_the_settings_of_prm_under_its_own_name() -> None:
    assert grower_of("roadmap") == PRM()
    assert grower_of("roadmap:milestones=9,neighbours=2") == PRM(milestones=9, neighbours=2)
    require_planner("roadmap:milestones=9")
    with pytest.raises(InvalidRequest, match=r"roadmap:samples=3.*expected roadmap:setting=number"):
        require_planner("roadmap:samples=3")
    with pytest.raises(UnknownName, match="did you mean 'roadmap'"):
        require_planner("roadmaps")


def test_a_roadmap_is_built_once_for_a_scene_and_seed_and_its_cost_is_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: list[int] = []
    build = PlannerService.build_roadmap

    def noted(self: PlannerService, *args: Any, **settings: Any) -> Roadmap:
        seeds.append(settings["seed"])
        return build(self, *args, **settings)

    monkeypatch.setattr(PlannerService, "build_roadmap", noted)
    head = 'about = "x"\nplanners = ["roadmap:milestones=40"]\nseeds = "0:2"\n'
    text = f'{head}[[queries]]\nscenes = ["bin"]\nnumbers = [0, 1]\n'
    found = list(runner.made(runner.jobs_of(suite_of(tmp_path, text))))
    assert seeds == [0, 1]
    assert [row["seed"] for row in found] == [0, 1, 0, 1]
    first, second, *rest = [row["built"] for row in found]
    assert rest == [first, second]
    assert first["states"] != second["states"]
    assert all("roadmap" not in row["checks"] and rows.states_of(row) < row["built"]["states"] for row in found)
    told = rows.read(results_file(tmp_path / "a.jsonl", *found)).rows
    assert list(told) == found
    with pytest.raises(InvalidFile, match=r"line 2\.built\.states"):
        rows.read(results_file(tmp_path / "b.jsonl", {**found[0], "built": {**first, "states": -1}}))


def test_a_disc_has_no_scene_to_build_a_roadmap_for(tiny: Suite) -> None:
    with pytest.raises(InvalidRequest, match="one that is not built before, for toy of tiny"):
        runner.jobs_of(tiny, ["roadmap"])


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
def found(tmp_path_factory: pytest.TempPathFactory) -> list[rows.Row]:
    suite = suite_of(tmp_path_factory.mktemp("suite"), TINY)
    return list(runner.made(runner.jobs_of(suite)))


def test_a_row_tells_what_a_plan_cost_and_what_became_of_it(found: list[rows.Row]) -> None:
    row = found[0]
    assert {name for name, field in rows.RowRecord.model_fields.items() if field.is_required()} <= set(row)
    told = [row[key] for key in ("suite", "problem", "planner", "seed", "ok")]
    assert told == ["tiny", "bin/0", "rrtconnect", 0, True]
    assert set(row["checks"]) == set(row["seconds"]) >= {"search", "shortcut", "certify"}
    assert rows.states_of(row) == sum(counts["states"] for counts in row["checks"].values()) > 0
    assert 0.0 < row["length"] <= row["raw_length"]
    assert row["clearance"] > 0.0
    assert max(row["peaks"]["velocity"], row["peaks"]["acceleration"]) <= 1.0 + 1e-9
    assert row["audit"] == {"step": 0.01, "verdict": "free", "depth": None, "pair": None}


SAME = ("checks", "path_hash", "length")


def test_the_same_job_has_the_same_counts_and_bits_again(found: list[rows.Row], tiny: Suite) -> None:
    for row, job in zip(found, runner.jobs_of(tiny), strict=True):
        again = job.row()
        assert rows.key_of(row) == rows.key_of(again) == job.key
        assert [row[key] for key in SAME] == [again[key] for key in SAME]


def test_the_lesson_is_a_planner_of_its_own_tool(found: list[rows.Row]) -> None:
    toy = next(row for row in found if (row["problem"], row["planner"]) == ("toy", LESSON))
    assert toy["tool"] == LESSON
    assert {row["tool"] for row in found if row["planner"] != LESSON} == {"planner_service"}
    service = next(row for row in found if (row["problem"], row["planner"]) == ("toy", "rrtconnect"))
    assert rows.states_of(service) < 0.2 * rows.states_of(toy)


def test_a_run_that_fails_is_a_row_charged_what_it_spent(tiny: Suite) -> None:
    row = attempt(tiny.problems[0], Ask("rrtconnect", 0, 300))
    assert (row["ok"], row["failure"], row["audit"]["verdict"]) == (False, "CHECK_BUDGET_EXHAUSTED", "not_asked")
    assert 0 < rows.states_of(row) <= 300
    assert row["cpu_seconds"] > 0.0
    assert (row["length"], row["path_hash"]) == (None, None)


def test_a_whole_pick_and_place_is_one_row_each_motion_of_which_is_audited(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []
    judge = Auditor.judge

    def noted(self: Auditor, Q: Any, step: float = 0.01) -> dict[str, Any]:
        asked.append(np.asarray(Q).shape)
        return judge(self, Q, step)

    monkeypatch.setattr(Auditor, "judge", noted)
    task = next(p for p in load_suite("pick_place").problems if p.id == "task/bin/without_demo_post")
    row = attempt(task, Ask("rrtconnect", 0, 50_000))
    assert (row["ok"], row["audit"]["verdict"]) == (True, "free")
    assert row["checks"]["choosing"]["states"] > 0
    assert row["checks"]["gripper"]["distances"] > 0
    assert len(asked) >= 7
    assert row["duration"] > 4.0


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


# --- files


def test_what_is_written_reads_back_and_a_torn_last_line_is_left_out(tmp_path: Path, found: list[rows.Row]) -> None:
    results = rows.read(results_file(tmp_path / "a.jsonl", *found, tail='{"suite": "ti'))
    assert list(results.rows) == found
    assert results.header == HEADER
    with rows.appending(tmp_path / "a.jsonl", results) as put:
        put(found[0])
    assert list(rows.read(tmp_path / "a.jsonl").rows) == [*found, found[0]]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": -1}, "line 2.seed"),
        ({"ok": "yes"}, "line 2.ok"),
        ({"checks": {"search": {"states": 1}}}, "line 2.checks.search.edges: missing"),
        ({"audit": {"step": None, "verdict": "fine", "depth": None, "pair": None}}, "one of free, colliding"),
        ({"length": "long"}, "line 2.length"),
    ],
)
def test_a_row_that_is_none_is_told_by_its_line(
    tmp_path: Path, found: list[rows.Row], change: dict[str, Any], told: str
) -> None:
    file = results_file(tmp_path / "a.jsonl", {**found[0], **change})
    with pytest.raises(InvalidFile, match=told):
        rows.read(file)


def test_two_processes_do_not_write_to_one_file(tmp_path: Path, found: list[rows.Row]) -> None:
    out, none = tmp_path / "a.jsonl", rows.Results(HEADER, ())
    with rows.appending(out, none) as put:
        put(found[0])
        with pytest.raises(InvalidRequest, match="another process is writing"), rows.appending(out, none):
            pytest.fail("it is written to twice")
        put(found[1])
    assert list(rows.read(out).rows) == found[:2]
    with rows.appending(out, rows.read(out)) as put:
        put(found[2])
    assert list(rows.read(out).rows) == found[:3]


@pytest.mark.parametrize("text", ["", "{}\n", "[1]\n", "no json\n", '{"header": {"version": 2}}\n', '{"header": 3}\n'])
def test_a_file_that_holds_no_results_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.jsonl").write_text(text, "utf-8")
    with pytest.raises(InvalidFile, match=r"a\.jsonl"):
        rows.read(tmp_path / "a.jsonl")


# --- run


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch, found: list[rows.Row]) -> list[rows.Key]:
    """The rows of the tiny suite come from memory; which ones were made is noted."""
    made: list[rows.Key] = []
    by_key = {rows.key_of(row): row for row in found}

    def row(job: runner.Job) -> rows.Row:
        made.append(job.key)
        return by_key[job.key]

    monkeypatch.setattr(runner.Job, "row", row)
    monkeypatch.setattr(runner, "warm", lambda *_: None)
    return made


def test_a_run_goes_on_where_it_was_interrupted_and_loses_no_row(
    tiny: Suite, tmp_path: Path, counted: list[rows.Key], monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, out = runner.jobs_of(tiny), tmp_path / "out.jsonl"
    row = runner.Job.row

    def interrupted(job: runner.Job) -> rows.Row:
        if len(counted) == 3:
            raise KeyboardInterrupt
        return row(job)

    with monkeypatch.context() as patch:
        patch.setattr(runner.Job, "row", interrupted)
        with pytest.raises(KeyboardInterrupt):
            runner.run(jobs, out, ["run"], QUIET)
    assert [rows.key_of(r) for r in rows.read(out).rows] == [job.key for job in jobs[:3]]
    results = runner.run(jobs, out, ["run"], QUIET)
    assert counted == [job.key for job in jobs]
    assert [rows.key_of(r) for r in results.rows] == [job.key for job in jobs]
    assert [rows.key_of(r) for r in rows.read(out).rows] == [job.key for job in jobs]
    runner.run(jobs, out, ["run"], QUIET)
    assert len(counted) == len(jobs)


def test_rows_are_not_put_beside_others_of_another_suite_or_code(
    tiny: Suite, tmp_path: Path, counted: list[rows.Key], monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs, out = runner.jobs_of(tiny), tmp_path / "out.jsonl"
    runner.run(jobs[:1], out, ["run"], QUIET)
    with pytest.raises(InvalidRequest, match="suite tiny is now other"):
        runner.run([replace(job, suite="other") for job in jobs], out, ["run"], QUIET)
    made = environment()
    monkeypatch.setattr(runner, "environment", lambda: {**made, "commit": "another"})
    with pytest.raises(InvalidRequest, match=r"commit .* is now another"):
        runner.run(jobs, out, ["run"], QUIET)


def test_the_command_runs_a_suite_and_says_what_is_wrong_with_its_options(
    tiny: Suite, tmp_path: Path, counted: list[rows.Key], capsys: pytest.CaptureFixture[str]
) -> None:
    suite, out = str(tmp_path / "tiny.toml"), str(tmp_path / "out.jsonl")
    assert command.main(["run", "--suite", suite, "--planner", "lesson", "--seeds", "0:2", "--out", out]) == 0
    printed = capsys.readouterr().out
    assert "4 rows in" in printed
    assert len(rows.read(Path(out)).rows) == 4
    assert command.main(["run", "--suite", suite, "--planner", "rrtconect", "--out", out]) == 2
    assert "did you mean 'rrtconnect'" in capsys.readouterr().out


def test_ctrl_c_ends_the_command_with_what_to_do_next(
    tiny: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "warm", interrupted)
    out = str(tmp_path / "out.jsonl")
    assert command.main(["run", "--suite", str(tmp_path / "tiny.toml"), "--out", out]) == 130
    assert "the same command goes on" in " ".join(capsys.readouterr().out.split())
    assert json.loads(Path(out).read_text("utf-8").splitlines()[0])["header"]["suite"] == "tiny"


def test_the_lesson_is_not_asked_to_pick() -> None:
    suite = load_suite("pick_place")
    with pytest.raises(InvalidRequest, match=r"'lesson'; expected one that picks and places, for task/"):
        runner.jobs_of(suite, [LESSON])
    with pytest.raises(UnknownName, match="did you mean 'lesson'"):
        runner.jobs_of(suite, ["leson"])


def test_a_problem_that_cannot_be_asked_is_named(tmp_path: Path) -> None:
    table = '[[tasks]]\nscene = "bin"\npick = "table"\nonto = "tray"\n'
    suite = suite_of(tmp_path, TINY.replace(', "lesson"', "") + table)
    (job,) = [job for job in runner.jobs_of(suite, ["rrtconnect"], [0]) if isinstance(job.problem, Task)]
    with pytest.raises(InvalidRequest, match=r"problem task/bin of tiny, rrtconnect: target: got 'table'"):
        job.row()
