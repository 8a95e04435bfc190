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

EXAMPLES = Path(__file__).parents[2] / "examples"


def printed_by(example: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / example), run_name="__main__")
    return capsys.readouterr().out


def number(text: str) -> int:
    return int(text.replace(",", ""))


def test_a_first_plan_shows_what_each_stage_costs_and_that_it_is_proven(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("01_first_plan.py", capsys)
    stages = re.findall(r"^([a-z ]+?) +([\d,]+) states +\d+ edges", printed, flags=re.MULTILINE)
    words = ["endpoints", "straight line", "search", "shortcut", "polish", "certify", "timing"]
    assert [name for name, _ in stages] == words
    (total,) = re.findall(r"^in total ([\d,]+) states", printed, flags=re.MULTILINE)
    assert sum(number(states) for _, states in stages) == number(total)
    assert re.search(r"^proven free along the whole curve", printed, flags=re.MULTILINE)
    assert "t = 0.00 s  q = [0.0, 0.95, 1.15, -1.25, 0.0, 0.0]  fastest joint 0.00" in printed


def test_a_block_is_taken_from_the_bin_to_the_tray_and_touched_only_where_it_is_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed = printed_by("02_pick_and_place.py", capsys)
    motions = re.findall(r"^  ([a-z ]+?) +(straight|searched) +([\d,]+) states +(.*) mm clear$", printed, re.MULTILINE)
    names = ["to pregrasp", "descend", "lift", "transfer", "lower", "retreat", "to home"]
    assert [name for name, *_ in motions] == names
    assert [name for name, how, *_ in motions if how == "searched"] == ["transfer", "to home"]
    assert min(float(clear) for *_, clear in motions) > 0.0
    (total,) = re.findall(r"^([\d,]+) states for", printed, flags=re.MULTILINE)
    assert sum(number(states) for _, _, states, _ in motions) == number(total)
    meant = re.findall(r"^    not judged from s = \S+ to \S+: (.*) \(", printed, flags=re.MULTILINE)
    fingers = "finger_left x blue_block, finger_right x blue_block"
    assert meant == [fingers, "blue_block x bin_floor", "blue_block x tray", fingers]
    assert printed.rstrip().endswith("the block now stands at (0.2, 0.28, 0.0335)")


def test_planners_are_compared_by_what_they_cost_and_how_short_their_paths_are(
    capsys: pytest.CaptureFixture[str],
) -> None:
    printed = printed_by("03_compare_planners.py", capsys)
    row = r"^(\w+) +(\d+)/10 +([\d,]+) +([\d,]+) +([\d,]+) +([\d.]+) -> ([\d.]+) rad$"
    rows = {name: figures for name, *figures in re.findall(row, printed, flags=re.MULTILINE)}
    assert list(rows) == ["RRTConnect", "RRT", "LBKPIECE1", "BITstar", "AORRTC", "Optimise"]
    solved, search, found = ({name: number(f[k].replace(".", "")) for name, f in rows.items()} for k in (0, 1, 4))
    assert solved == dict.fromkeys(rows, 10)
    assert search["Optimise"] < search["RRTConnect"] < min(search[name] for name in ("LBKPIECE1", "BITstar", "AORRTC"))
    assert max(found["AORRTC"], found["BITstar"]) < found["RRTConnect"]


def test_an_arm_comes_with_its_contacts_explained_and_plans(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("05_your_own_robot.py", capsys)
    table = re.findall(r"^  (allowed|checked) +(\w+ x \w+) +(\S.*)$", printed, flags=re.MULTILINE)
    assert len(table) == 10
    assert {reason.split(":")[0] for verdict, _, reason in table if verdict == "allowed"} == {"adjacent", "never"}
    assert all(reason.startswith("collides in") for verdict, _, reason in table if verdict == "checked")
    assert re.search(r"^blocked at .*: \w+ x post$", printed, flags=re.MULTILINE)
    assert re.search(r"^planned: ", printed, flags=re.MULTILINE)
    asked = re.findall(r"^\w+ +(\d+) pairs checked in each of ([\d,]+) states$", printed, flags=re.MULTILINE)
    (imported, states), (as_it_came, states_then) = asked
    assert (int(imported) < int(as_it_came), states) == (True, states_then)
    (pair, depth) = re.findall(r"^at \[.*\]: (\w+ x \w+) \(at most ([\d.]+) mm deep\)$", printed, flags=re.MULTILINE)[0]
    assert float(depth) > 0.0
    assert pair in {" x ".join(reversed(links.split(" x "))) for _, links, _ in table} | {
        links for _, links, _ in table
    }


def test_a_path_from_elsewhere_is_refused_repaired_and_proven(capsys: pytest.CaptureFixture[str]) -> None:
    printed = printed_by("06_certify_someone_elses_path.py", capsys)
    (looked, free) = re.findall(r"^at (\d+) samples, .*: (\d+) free$", printed, flags=re.MULTILINE)[0]
    assert looked == free
    refused = re.findall(r"^(\w+ x \w+) is not proven apart from s = (\S+) to (\S+): .*overlap", printed, re.MULTILINE)
    assert [pair for pair, *_ in refused] == ["link_6 x post_ahead"]
    assert re.search(r"^piece 2 planned again: ", printed, flags=re.MULTILINE)
    assert re.search(r"^proven: at least ([\d.]+) mm", printed, flags=re.MULTILINE)
    (stops, blends) = re.findall(r"^([\d.]+) s with stops, ([\d.]+) s with blends$", printed, flags=re.MULTILINE)[0]
    assert float(blends) < 0.7 * float(stops)


def test_a_cell_pays_for_its_checks_once(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLES / "04_roadmap_for_a_cell.py"), run_name="__main__")
    printed = capsys.readouterr().out
    cost = {
        name.strip(): int(total.replace(",", ""))
        for name, total in re.findall(r"^(\w+(?: \d)?) .* ([\d,]+) in total$", printed, flags=re.MULTILINE)
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
    page = (EXAMPLES.parent / "docs" / "guides" / "roadmaps.md").read_text(encoding="utf-8")
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
    page = (EXAMPLES.parent / "docs" / "guides" / name).read_text(encoding="utf-8")
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
