"""What a fresh process tells of its first plan."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks.studies import cold
from planner_service.errors import BrokenInvariant, InvalidFile


def test_a_fresh_process_tells_the_moments_of_its_first_plan_and_its_memory(tmp_path: Path) -> None:
    out = StringIO()
    options = ["--scene", "window", "--repeats", "1", "--plans", "2", "--json", str(tmp_path / "cold.json")]
    assert cold.main(options, Console(file=out, width=200)) == 0
    told = json.loads((tmp_path / "cold.json").read_text("utf-8"))["births"][0]
    moments = [told["start"], *told["moments"]]
    assert moments == sorted(moments)
    assert len(moments) == 1 + len(cold.STEPS)
    assert len(told["seconds"]) == 2
    printed = out.getvalue()
    assert "start to first plan" in printed
    assert "p99" in printed
    assert ("does not tell" in printed) == (told["peak_mb"] is None)


def test_instructions_are_counted_by_what_can_or_said_not_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []

    def born(scene: str, plans: int, before: Sequence[str] = ()) -> tuple[float, dict[str, Any]]:
        asked.append((before[0], plans))
        if before[0] == "perf":
            raise BrokenInvariant("may not count")
        file = Path(next(option for option in before if "out-file" in option).partition("=")[2])
        file.write_text(f"events: Ir\nsummary: {1000 + 70 * plans}\n", "utf-8")
        return 0.0, {}

    out = StringIO()
    console = Console(file=out, width=200)
    monkeypatch.setattr(cold, "_born", born)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    assert cold._counted("bin", console) == (1000, 70)
    assert ("perf", 0) in asked
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert cold._counted("bin", console) is None
    assert "not counted" in out.getvalue()


def test_a_process_that_cannot_plan_is_our_bug_and_its_words_are_told() -> None:
    with pytest.raises(BrokenInvariant, match=r"nowhere\.json"):
        cold._born("nowhere", 0)


def test_what_cannot_be_done_is_refused_before_any_process_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cold, "_born", lambda *_: pytest.fail("a process is started"))
    for option, value in (("--repeats", "0"), ("--plans", "-5")):
        with pytest.raises(SystemExit, match="2"):
            cold.main([option, value], Console(file=StringIO()))
        assert f"argument {option}: got {value!r}; expected a whole number from" in capsys.readouterr().err
    with pytest.raises(InvalidFile, match="has to be there"):
        cold.main(["--json", str(tmp_path / "nowhere" / "cold.json")], Console(file=StringIO()))
