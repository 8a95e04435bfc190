"""What the benchmarks measure on, measure against and write down."""

from __future__ import annotations

import json
import math
import sys
from io import StringIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

import planner_service as ps
from benchmarks import __main__ as command
from benchmarks.baselines.lesson import STEP, Lesson, Toy, VertexShortcut, cut_vertices, length_of, samples
from benchmarks.baselines.peers.environments import Environment
from benchmarks.baselines.peers.versions import HERE, THEN, version_here, version_then
from benchmarks.harness.report import Promise, Report, Row, grouped, p50, p95, show, write_json
from benchmarks.studies import (
    agreement,
    differential,
    latency,
    panda,
    proven,
    toy,
)
from benchmarks.studies.states import run_lesson
from benchmarks.worlds import drawn, queries, sheets
from benchmarks.worlds.queries import SCENES, Region
from planner_service.certify import Certificate, Refusal
from planner_service.collision import Known
from planner_service.collision.native_kernel import instruction_sets
from planner_service.errors import InvalidRequest, UnknownName
from planner_service.geometry.arrays import FloatArray, joint_distance
from planner_service.search.edge_cache import SearchOracle
from planner_service.search.problem import SearchProblem
from tests.support.pairwise_fcl import PairwiseFcl

Judged = tuple[Row, ps.JointPath]
"""A measured query and its path."""


def checker_of(scene: str) -> ps.CollisionChecker:
    return ps.CollisionChecker(ps.load_robot(queries.ROBOT), ps.load_scene(scene))


# --- queries


def test_the_stored_queries_are_what_their_seed_gives() -> None:
    for scene in SCENES:
        assert queries.text_of(queries.draw(scene)) == queries.stored_text(scene)


@pytest.mark.parametrize("scene", SCENES)
def test_a_scene_has_twenty_queries_whose_ends_are_free_and_whose_straight_line_is_mostly_blocked(scene: str) -> None:
    checker, here = checker_of(scene), queries.load(scene)
    assert len(here) == queries.PER_SCENE == 20
    assert all(checker.state_is_free(q) for query in here for q in (query.start, query.goal))
    assert [checker.edge_is_free(query.start, query.goal) for query in here] == [query.straight for query in here]
    assert sum(not query.straight for query in here) >= 18


@pytest.mark.parametrize("scene", SCENES)
def test_a_query_leads_from_one_region_of_a_pair_to_the_other(scene: str) -> None:
    robot = ps.load_robot(queries.ROBOT)

    def inside(region: Region, q: FloatArray) -> bool:
        tip = robot.tool_pose(q)[:3, 3].tolist()
        ranges = (region.x, region.y, region.z)
        return all(low - 1e-5 <= v <= high + 1e-5 for v, (low, high) in zip(tip, ranges, strict=True))

    for query in queries.load(scene):
        ends = (query.start, query.goal)
        sides = [pair for regions in SCENES[scene] for pair in (regions, regions[::-1])]
        assert any(inside(a, ends[0]) and inside(b, ends[1]) for a, b in sides), query.name


def test_other_seeds_give_other_queries_and_more_queries_begin_with_the_same() -> None:
    five = queries.draw("post", 5)
    assert [q.start.tolist() for q in queries.draw("post", 3)] == [q.start.tolist() for q in five[:3]]
    assert queries.draw("post", 1, seed=1)[0].start.tolist() != five[0].start.tolist()


# --- the lesson


def test_the_toy_counts_what_the_lesson_counts() -> None:
    run = Toy.run(7)
    assert (run.checks, run.growth, run.shortcut) == (18_793, 1_136, 17_657)
    assert (len(run.raw), len(run.short)) == (49, 3)
    assert length_of(run.raw) == pytest.approx(7.1951, abs=5e-5)
    assert length_of(run.short) == pytest.approx(6.5525, abs=5e-5)


class Disc:
    """The toy's disc as a planner's oracle."""

    def __init__(self) -> None:
        self.toy = Toy()

    @property
    def states(self) -> int:
        return self.toy.checks

    def state_is_free(self, q: FloatArray) -> bool:
        return not self.toy.collides(q.tolist())

    def edge_is_free(self, q1: FloatArray, q2: FloatArray, *, known: Known = Known.NEITHER) -> bool:
        raise AssertionError("it asks about states only")


def test_the_lesson_grows_a_path_of_short_free_edges_from_start_to_goal() -> None:
    oracle, box = Disc(), np.full(2, math.pi)
    problem = SearchProblem(Toy.START, Toy.GOAL[None], -box, box, oracle, seed=7)
    path = Lesson().search(problem).waypoints
    assert path is not None
    assert (path[0].tolist(), path[-1].tolist()) == (Toy.START.tolist(), Toy.GOAL.tolist())
    assert max(joint_distance(a, b) for a, b in pairwise(path)) <= STEP + 1e-12
    assert all(Toy().edge_is_free(a, b) for a, b in pairwise(path))
    assert oracle.states == 1_136  # as the toy of the same seed
    assert len(path) == 49


def test_the_lesson_says_so_when_it_gives_up() -> None:
    class Walled(Disc):
        def state_is_free(self, q: FloatArray) -> bool:
            return super().state_is_free(q) and abs(float(q[0])) > 0.2

    box = np.full(2, math.pi)
    result = Lesson().search(SearchProblem(Toy.START, Toy.GOAL[None], -box, box, Walled()))
    assert result.waypoints is None
    assert "2000 rounds" in result.note


def test_shortcutting_from_memory_counts_as_walking_every_edge_again() -> None:
    query = queries.load("bin")[0]
    checker, walker = checker_of("bin"), checker_of("bin")
    limits = checker.robot.limits
    problem = SearchProblem(query.start, query.goal[None], limits.lower, limits.upper, SearchOracle(checker))
    grown = Lesson().search(problem).waypoints
    assert grown is not None
    before = checker.counts.states
    remembered = VertexShortcut(checker).shorten(grown, 0)
    rng = np.random.default_rng([0, 1])
    walked = cut_vertices(list(grown), rng, lambda a, b: all(walker.state_is_free(q) for q in samples(a, b)))
    assert checker.counts.states - before == walker.counts.states
    assert remembered.tolist() == np.array(walked).tolist()


def test_a_run_of_the_lesson_counts_everything_and_ends_where_it_should() -> None:
    query, checker = queries.load("shelf")[0], checker_of("shelf")
    run = run_lesson(checker, query)
    assert run.states == run.growth + run.shortcut == checker.counts.states
    assert run.path is not None
    assert (run.path[0].tolist(), run.path[-1].tolist()) == (query.start.tolist(), query.goal.tolist())


# --- speed


def test_the_checker_judges_every_pair_that_there_is() -> None:
    for scene in SCENES:
        baseline = PairwiseFcl(ps.load_robot(queries.ROBOT), ps.load_scene(scene))
        assert baseline.pair_count == len(baseline.self_pairs) + len(baseline.scene_pairs)
        assert checker_of(scene).pair_count == baseline.pair_count > 0
        assert len(baseline.self_pairs) == 171
        assert len(baseline.scene_pairs) == 26 * len(ps.load_scene(scene).obstacles)


def test_pair_by_pair_and_the_checker_give_the_same_verdicts() -> None:
    checker, baseline = checker_of("bin"), PairwiseFcl(ps.load_robot(queries.ROBOT), ps.load_scene("bin"))
    limits = checker.robot.limits
    Q = limits.lower + (limits.upper - limits.lower) * np.random.default_rng(5).random((200, 6))
    verdicts = [checker.state_is_free(q) for q in Q]
    assert verdicts == [baseline.state_is_free(q) for q in Q.tolist()]
    assert 20 < sum(verdicts) < 180


# --- reports and the command


def promising(*kept: bool) -> Report:
    return Report("some", ({"row": 1},), (), tuple(Promise(f"promise {k}", "1", k_) for k, k_ in enumerate(kept)))


def test_one_broken_promise_is_shown_and_breaks_the_whole() -> None:
    out = StringIO()
    assert show([promising(True), promising(True)], Console(file=out))
    assert not show([promising(True), promising(True, False)], Console(file=out))
    assert "BROKEN" in out.getvalue()


def test_rows_and_promises_are_written_for_machines(tmp_path: Path) -> None:
    write_json([promising(True)], tmp_path / "out.json")
    content = json.loads((tmp_path / "out.json").read_text("utf-8"))
    promise = {"text": "promise 0", "measured": "1", "kept": True}
    assert content == {"some": {"rows": [{"row": 1}], "promises": [promise]}}


def test_the_command_measures_the_exercise_of_the_lesson_prints_and_writes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(["toy", "--json", str(tmp_path / "toy.json")]) == 0
    assert "18,793" in capsys.readouterr().out
    rows = json.loads((tmp_path / "toy.json").read_text("utf-8"))["toy"]["rows"]
    assert len(rows) == 50
    table = {key: (p50(row[key] for row in rows), p95(row[key] for row in rows)) for key in rows[0]}
    assert {key: tuple(map(round, table[key])) for key in table if "checks" in key} == {
        "growth checks": (925, 1278),
        "shortcut checks": (16_830, 19_944),
        "total checks": (17_644, 20_821),  # 17,644.5, rounded to even
    }
    lengths = {"raw length": (7.591, 8.498), "shortcut length": (6.490, 6.832)}
    seconds = {"raw seconds": (15.71, 17.71), "shortcut seconds": (4.171, 4.890)}
    for key, published in {**lengths, **seconds}.items():
        assert table[key] == pytest.approx(published, abs=5e-3 if "raw s" in key else 5e-4)


def test_the_command_refuses_what_it_cannot_do_before_it_measures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(toy, "run", lambda: pytest.fail("it is measured"))
    assert command.main(["toy", "--json", str(tmp_path / "nowhere" / "toy.json")]) == 2
    assert "has to be there" in capsys.readouterr().out
    assert command.main(["differential", "--robot", "wxia"]) == 2
    assert "did you mean 'wxai'" in capsys.readouterr().out
    for arguments, told in (
        (["toy", "--seed", "3"], "argument --seed: toy has none; it takes none"),
        (["proven", "--seed", "3"], "argument --seed: proven has none; it takes --queries"),
        (["serve", "--part", "warm"], "argument --part: serve has load, memory"),
        (["agreement", "--states", "0"], "argument --states: got '0'; expected a whole number from 1"),
    ):
        with pytest.raises(SystemExit, match="2"):
            command.main(arguments)
        assert told in capsys.readouterr().err


def test_ctrl_c_ends_a_study_without_a_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(toy, "run", interrupted)
    assert command.main(["toy"]) == 130
    assert capsys.readouterr().out == "interrupted\n"


def test_without_an_argument_everything_there_is_is_listed_as_in_the_docs(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([]) == 0
    told = capsys.readouterr().out
    assert all(name in told and text in told for name, text in command.STUDIES.items())
    assert all(name in told for name in command.COMMANDS)
    text = (Path(__file__).parents[2] / "docs" / "figures" / "measured.md").read_text("utf-8")
    assert command.listed() in text
    assert set(command.LONG) < set(command.STUDIES)


def test_few_states_are_compared_in_the_kinds_there_are() -> None:
    assert [promise for promise in agreement.run("planar2", 1).promises if not promise.kept] == []


# --- the curves themselves


def test_drawn_scenes_and_queries_are_the_same_each_time_and_have_something_in_the_way() -> None:
    scene = drawn.draw_scene(3)
    assert scene.hash == drawn.draw_scene(3).hash != drawn.draw_scene(4).hash
    asked, checker = list(drawn.draw_queries(3, scene)), ps.CollisionChecker(ps.load_robot(queries.ROBOT), scene)
    assert [q.start.tolist() for q in asked] == [q.start.tolist() for q in drawn.draw_queries(3, scene)]
    assert len(asked) == drawn.PER_SCENE
    assert all(checker.state_is_free(q) for query in asked for q in (query.start, query.goal))
    assert not any(checker.edge_is_free(query.start, query.goal) for query in asked)


@pytest.fixture(scope="module")
def shelf() -> proven.World:
    return proven.World.of("shelf", ps.load_scene("shelf"), queries.load("shelf")[:1])


@pytest.fixture(scope="module")
def judged(shelf: proven.World) -> Judged:
    row, result = proven.measured(shelf, shelf.queries[0])
    assert result.path is not None
    return row, result.path


def test_the_independent_checker_walks_a_curve_in_steps_that_bound_the_motion(
    shelf: proven.World, judged: Judged
) -> None:
    path = judged[1]
    walked = shelf.second.along(path, path.length, 0.002)
    assert walked[[0, -1]].tolist() == path.waypoints[[0, -1]].tolist()
    assert (np.abs(np.diff(walked, axis=0)) * shelf.second.reach).sum(axis=1).max() <= 0.002
    whole = float((path.travel(path.length) * shelf.second.reach).sum())
    assert whole / 0.002 <= len(walked) <= 1.3 * whole / 0.002 + 2


def test_the_independent_checker_finds_a_touch_in_the_middle_of_a_curve(shelf: proven.World) -> None:
    query = shelf.queries[0]
    line = ps.JointPath(np.array([query.start, query.goal]))  # blocked, and free at both ends
    touch = shelf.second.curve_touch(line, line.length, 0.002)
    assert touch is not None
    assert shelf.second.touching(touch.q)


def test_rates_by_the_chain_rule_are_the_differences_of_a_motion(judged: Judged) -> None:
    trajectory = ps.ToppRa().time_path(judged[1], ps.load_robot(queries.ROBOT).limits)
    on_blends = np.flatnonzero(trajectory.path.blended[trajectory.geometry])
    t = trajectory.knots[on_blends] + 0.4 * trajectory.durations[on_blends]
    h = 0.01 * trajectory.durations[on_blends].min()
    for order, rate in enumerate(proven.rates(trajectory, t)):
        differences = (trajectory(t + h, order) - trajectory(t - h, order)) / (2.0 * h)
        assert np.abs(rate - differences).max() <= 1e-4 * np.abs(rate).max()


def site(world: proven.World, path: ps.JointPath, **changes: Any) -> sheets.Site:
    parts = {"name": "here", "robot": world.service.robot, "scene": world.scene, "path": path}
    return sheets.Site(**{**parts, "touches": lambda *_: True, **changes})


def test_sheets_that_samples_miss_are_planted_and_each_is_caught(
    shelf: proven.World, judged: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheets, "STEPS", (0.1,))
    (row,) = proven.planted(shelf, shelf.queries[0], judged[1])
    assert row["missed"] == sheets.MISSES
    assert row["tried"] > row["touched"] == row["caught"] >= row["missed"]


def test_a_refusal_that_names_another_pair_has_not_caught_the_sheet(
    shelf: proven.World, judged: Judged, monkeypatch: pytest.MonkeyPatch
) -> None:
    refused = Certificate(-math.inf, 1, 0.0, refusal=Refusal(0.0, 1.0, 0.5, "link_4", "board", "too close"))
    monkeypatch.setattr(sheets, "Certifier", lambda *_: SimpleNamespace(certify=lambda path: refused))
    found = sheets.plant(site(shelf, judged[1]), 0.1)
    assert found.touched > found.caught == 0


def test_a_measured_query_keeps_every_promise_and_each_worse_figure_breaks_one(judged: Judged) -> None:
    blends = {law: judged[0][law] | {"duration": 0.7, "stops": 1.0} for law in proven.LAWS}
    sheet = {"tried": 90, "touched": 40, "missed": 30, "caught": 40}

    def broken(row: Row = {}, sheet: Row = sheet) -> list[str]:  # noqa: B006
        rows = [{**judged[0], **blends, **row, "world": name} for name in proven.NAMES]
        rows.append({"world": proven.DRAWN, "query": "lost", "failure": "NOT_CERTIFIED"})
        found = proven.promises(rows, [{**sheet, "step": step} for step in sheets.STEPS])
        return [promise.text for promise in found if not promise.kept]

    assert broken() == []
    gap = judged[0]["sampled_gap"]
    for change, text, count in (
        ({"touch": "link_4 x board"}, "curves in collision", 1),
        ({"off_path": 1e-15}, "the timed curve", 1),
        ({"clearance": gap + 6e-6}, "no certificate states more", 1),
        ({"toppra": blends["toppra"] | {"worst": 1.0 + 2e-6}}, "toppra: no sample", 1),
        ({"s-curve": blends["s-curve"] | {"duration": 0.91}}, "s-curve blended", 2),
    ):
        found = broken(change)
        assert len(found) == count
        assert all(text in each for each in found)
    for wrong in ({"caught": 39}, {"missed": 19}):
        assert len(broken(sheet=sheet | wrong)) == len(sheets.STEPS)


# --- the kernel, for its answers, and versions next to each other


@pytest.fixture(scope="module")
def both_versions() -> tuple[Environment, Environment]:
    """This version, twice: 0.1.0 is not installed for a test."""
    return version_here(), version_then(Path(sys.executable))


@pytest.fixture(scope="module")
def in_turn(both_versions: tuple[Environment, Environment]) -> list[Row]:
    return list(panda.rows_in_turn(both_versions, seeds=1, problems=3))


def test_two_versions_plan_the_same_problems_and_the_auditor_rejects_none(in_turn: list[Row]) -> None:
    assert len(in_turn) == 6
    for here, then in zip(*(grouped(in_turn, "tool")[tool] for tool in (HERE, THEN)), strict=True):
        assert (here["problem"], here["path_hash"]) == (then["problem"], then["path_hash"])
        assert (here["ok"], here["audit"]["verdict"]) == (True, "free")
        assert 0.0 < here["stage_cpu_seconds"]["search"] < here["cpu_seconds"]


def test_panda_promises_are_kept_by_good_figures_and_broken_by_each_bad_one(in_turn: list[Row]) -> None:
    old: Row = {"tool": THEN, "cpu_seconds": 1.0, "stage_cpu_seconds": {"search": 1.0}}
    good: Row = {"cpu_seconds": 0.25, "stage_cpu_seconds": {"search": 0.12}, "length": 4.8}
    rows = [row | (old if row["tool"] == THEN else good) for row in in_turn]
    bad: list[Row] = [
        {"ok": False},
        {"audit": {"verdict": "colliding", "pair": ["link", "box"]}},
        {"cpu_seconds": 0.26},
        {"stage_cpu_seconds": {"search": 0.13}},
        {"length": 4.9},
    ]
    assert [promise.text for promise in panda.promises(rows) if not promise.kept] == []
    for k, change in enumerate(bad):
        worse = rows[:1] if k == 0 else [row for row in rows if row["tool"] == HERE]
        changed = [row | change if row in worse else row for row in rows]
        assert [promise.kept for promise in panda.promises(changed)] == [number != k for number in range(len(bad))]


def test_a_version_to_compare_with_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="--against"):
        panda.run(against=tmp_path / "bin" / "python")
    assert command.main(["panda", "--seeds", "0"]) == 2


def test_other_seeds_ask_other_states_and_the_same_seed_the_same() -> None:
    robot, scene = differential.case("planar2 pins")
    asked = [list(differential.questions(robot, scene, 30, 3, seed)) for seed in (1, 1, 2)]
    first, again, other = ([block[1].tolist() for block in blocks] for blocks in asked)
    assert first == again != other
    assert [kind for kind, *_ in asked[0]] == list(differential.KINDS)


def test_parts_are_asked_in_processes_and_make_up_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(differential, "PART", 40)
    report = differential.run("planar2", 100, 10, seed=1)
    counts = [sum(row["number"] for row in report.rows if row["what"] == what) for what in ("states", "edges")]
    assert counts == [100, 10]
    assert [promise.kept for promise in report.promises] == [bool(instruction_sets())]


def test_a_robot_that_is_not_compared_is_refused() -> None:
    with pytest.raises(UnknownName, match="xarm7"):
        differential.run("xarm7")


def test_plans_and_straight_lines_are_timed_and_slow_ones_break_their_promise(
    both_versions: tuple[Environment, Environment],
) -> None:
    plans = list(latency.plan_rows(both_versions, ("bin",), 2, ("JointStep(0.02)",)))
    straight = list(latency.straight_rows(("shelf",), 2, 1))
    assert [(len(row["ms"]), len(row["then"])) for row in plans] == [(2, 2)]
    assert [len(row["ms"]["whole"]) for row in straight] == [2, 2]
    for ms, decided, whole in ((3.5, 1.0, 2.0), (3.6, 1.0, 2.0), (3.5, 1.1, 2.0), (3.5, 1.0, 2.1)):
        told = [row | {"ms": [ms] * 2, "then": [10.0] * 2} for row in plans]
        lines = [row | {"ms": {"decided": [decided], "whole": [whole]}} for row in straight]
        kept = [promise.kept for promise in latency.promises(told, lines)]
        assert kept == [ms == 3.5, decided == 1.0, whole == 2.0]
