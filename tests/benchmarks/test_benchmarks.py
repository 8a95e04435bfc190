"""What the benchmarks measure on, measure against and write down."""

from __future__ import annotations

import inspect
import math
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

import planner_service as ps
from benchmarks import __main__ as command
from benchmarks.baselines.lesson import Toy, length_of
from benchmarks.harness.report import Promise, Report, Row, show
from benchmarks.studies import proven, toy
from benchmarks.worlds import queries, sheets
from benchmarks.worlds.queries import SCENES
from planner_service.certify import Certificate, Refusal

Judged = tuple[Row, ps.JointPath]
"""A measured query and its path."""


def checker_of(scene: str) -> ps.CollisionChecker:
    return ps.CollisionChecker(ps.load_robot(queries.ROBOT), ps.load_scene(scene))


# --- options


@pytest.mark.parametrize("name", command.STUDIES)
def test_a_study_takes_an_option_as_the_command_line_reads_it(name: str) -> None:
    kinds = {key: read.__name__ if isinstance(read, type) else "int" for key, (read, *_) in command.OPTIONS.items()}
    taken = inspect.signature(command.study(name).run).parameters
    for key in command.options_of(name):
        assert kinds[key] in str(taken[key].annotation), key


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


# --- the lesson


def test_the_toy_counts_what_the_lesson_counts() -> None:
    run = Toy.run(7)
    assert (run.checks, run.growth, run.shortcut) == (18_793, 1_136, 17_657)
    assert (len(run.raw), len(run.short)) == (49, 3)
    assert length_of(run.raw) == pytest.approx(7.1951, abs=5e-5)
    assert length_of(run.short) == pytest.approx(6.5525, abs=5e-5)


# --- speed


# --- reports and the command


def promising(*kept: bool) -> Report:
    return Report("some", ({"row": 1},), (), tuple(Promise(f"promise {k}", "1", k_) for k, k_ in enumerate(kept)))


def test_one_broken_promise_is_shown_and_breaks_the_whole() -> None:
    out = StringIO()
    assert show([promising(True), promising(True)], Console(file=out))
    assert not show([promising(True), promising(True, False)], Console(file=out))
    assert "BROKEN" in out.getvalue()


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
        (["differential", "--states", "0"], "argument --states: got '0'; expected a whole number from 1"),
    ):
        with pytest.raises(SystemExit, match="2"):
            command.main(arguments)
        assert told in capsys.readouterr().err


def test_without_an_argument_everything_there_is_is_listed_as_in_the_docs(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([]) == 0
    told = capsys.readouterr().out
    assert all(name in told and text in told for name, text in command.STUDIES.items())
    assert all(name in told for name in command.COMMANDS)
    text = (Path(__file__).parents[2] / "docs" / "figures" / "measured.md").read_text("utf-8")
    assert command.listed() in text
    assert set(command.LONG) < set(command.STUDIES)


# --- the curves themselves


@pytest.fixture(scope="module")
def shelf() -> proven.World:
    return proven.World.of("shelf", ps.load_scene("shelf"), queries.load("shelf")[:1])


@pytest.fixture(scope="module")
def judged(shelf: proven.World) -> Judged:
    row, result = proven.measured(shelf, shelf.queries[0])
    assert result.path is not None
    return row, result.path


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


# --- the kernel, for its answers, and versions next to each other
