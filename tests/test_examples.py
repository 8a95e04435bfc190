"""The examples run and keep what they promise, those of the page on roadmaps included."""

from __future__ import annotations

import re
import runpy
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from planner_service.cli.commands import app

EXAMPLES = Path(__file__).parent.parent / "examples"


def test_a_cell_pays_for_its_checks_once(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "04_roadmap_for_a_cell.py"), run_name="__main__")
    printed = capsys.readouterr().out
    cost = {
        name.strip(): int(total.replace(",", ""))
        for name, total in re.findall(r"^(\w+(?: \d)?) .* ([\d,]+) in all$", printed, flags=re.MULTILINE)
    }
    assert list(cost) == ["RRTConnect", "round 1", "round 2", "round 3", "moved 1", "moved 2", "moved 3"]
    assert cost["round 1"] < cost["RRTConnect"] / 5
    assert cost["round 3"] <= cost["round 2"] <= cost["round 1"]
    assert cost["moved 3"] <= cost["moved 1"] < cost["RRTConnect"] / 5
    assert re.search(r"^demo_post changed: [\d,]+ edges kept without a check", printed, flags=re.MULTILINE)


def test_what_the_page_on_roadmaps_shows_is_what_happens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    page = (EXAMPLES.parent / "docs" / "roadmaps.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w+)\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    for (language, code), (below, expected) in pairwise(blocks):
        if language == "python":
            exec(compile(code, "roadmaps.md", "exec"), names)
            assert (below, capsys.readouterr().out) == ("text", expected)
    commands = re.findall(r"^\$ planner-service (.*)$", page, flags=re.MULTILINE)
    assert [CliRunner().invoke(app, command).exit_code for command in commands] == [0] * 5


@pytest.mark.parametrize("name", ["optimisation.md", "replanning.md"])
def test_what_the_pages_on_optimising_and_replanning_show_is_what_happens(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (EXAMPLES.parent / "docs" / name).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w+)\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    for (language, code), (below, expected) in pairwise([*blocks, ("", "")]):
        if language == "python":
            exec(compile(code, name, "exec"), names)
            assert capsys.readouterr().out == (expected if below == "text" else "")
    assert "text" in dict(blocks)
    if "drive" in names:
        clock = [0.0]
        around = {"now": lambda: clock[0], "wait_until": lambda t: clock.__setitem__(0, t)}
        names |= around | {"as_seen": lambda: names["scene"], "halt": lambda: pytest.fail("nothing is safe")}
        names["drive"](names["motion"], names["request"], names["GOAL"])


def test_a_motion_is_replanned_while_it_is_under_way(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "07_replanning.py"), run_name="__main__")
    printed = capsys.readouterr().out
    jumps = [float(jump) for jump in re.findall(r"largest jump (\S+)$", printed, flags=re.MULTILINE)]
    assert len(jumps) > 10
    assert max(jumps) < 1e-9
    assert printed.rstrip().endswith("arrived")
