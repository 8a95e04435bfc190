"""What a long study has done is in its file, however it ended."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks.harness.kept import Kept
from benchmarks.harness.report import Row
from benchmarks.studies.gate import chunks, times
from planner_service.parallel import Sequential


def test_what_was_done_is_there_again_and_a_line_that_was_cut_off_is_not(tmp_path: Path) -> None:
    file = tmp_path / "done.jsonl"
    kept = Kept(file)
    kept.put("a", {"x": 1})
    with file.open("a") as cut:
        cut.write('["b", {"x"')
    again = Kept(file)
    assert again.get("a") == {"x": 1}
    assert again.get("b") is None
    again.put("b", {"x": 2})
    assert Kept(file).get("b") == {"x": 2}


def test_rows_are_made_once_and_those_that_were_not_asked_for_are_there_if_they_are_kept(tmp_path: Path) -> None:
    made = list[int]()

    def rows() -> Iterator[Row]:
        made.append(len(made))
        yield {"x": math.inf}

    for _ in range(2):
        assert Kept(tmp_path / "done.jsonl").rows("a", rows) == [{"x": math.inf}]
    assert made == [0]
    assert Kept(tmp_path / "done.jsonl").rows("a", None) == [{"x": math.inf}]
    assert Kept(tmp_path / "done.jsonl").rows("b", None) == []
    assert Kept().rows("a", rows) == [{"x": math.inf}]


@pytest.mark.slow
def test_a_study_that_goes_on_says_what_one_at_once_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "CHECKS", 2)
    monkeypatch.setattr(chunks, "EPISODES", 1)
    monkeypatch.setattr(chunks, "Processes", Sequential)  # three starts of workers would take most of the time
    at_once = chunks.run(4 * chunks.CHECKS, 0, "wxai")
    kept = Kept(tmp_path / "done.jsonl")
    chunks.run(2 * chunks.CHECKS, 0, "wxai", kept)
    assert chunks.run(4 * chunks.CHECKS, 0, "wxai", Kept(tmp_path / "done.jsonl")).rows == at_once.rows


def test_times_that_were_taken_are_not_taken_again(tmp_path: Path) -> None:
    first = times.run(5, 0, "wxai", Kept(tmp_path / "done.jsonl"))
    assert times.run(5, 0, "wxai", Kept(tmp_path / "done.jsonl")).rows == first.rows
