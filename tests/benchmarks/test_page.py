"""Reports: tables, sentences about who is faster, and the parts of a text that they renew."""

from __future__ import annotations

from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks.harness.report import Promise, Report, table_of
from benchmarks.harness.rows import Results, Row
from benchmarks.pages import page
from benchmarks.pages.page_builds import builds
from benchmarks.pages.page_numbers import Sheet, paces, sheets_of
from benchmarks.pages.page_tables import (
    Cell,
    Sheaf,
    environments,
    failures_in_short,
    overall,
    statements,
)
from planner_service.errors import InvalidFile, InvalidRequest
from tests.benchmarks import results
from tests.benchmarks.results import HEADER, UNASKED, counted, results_file


def row(problem: int = 0, tool: str = "planner_service", planner: str = "rrtconnect", **changes: Any) -> Row:
    """A row with a path; numbers differ by problem."""
    made = results.row(f"box/{problem}", kind="box", tool=tool, planner=planner)
    counts = {"states": 100 * (problem + 1), "edges": 3, "distances": 0}
    made |= {"checks": {"search": counts, "shortcut": counts | {"states": 50}}}
    made |= {"seconds": {"search": 0.01 * (problem + 1), "timing": 0.005}, "cpu_seconds": 0.01 * (problem + 1) + 0.005}
    return made | {"raw_length": 9.0, "length": 5.0 + problem, "duration": 2.5, "clearance": 0.004} | changes


def failed(problem: int = 0, reason: str = "TIMED_OUT", detail: str = "out of time", **changes: Any) -> Row:
    """A row without a path."""
    nothing = dict.fromkeys(("raw_length", "length", "duration", "clearance", "path_hash"))
    told: Row = {"ok": False, "failure": reason, "detail": detail, "audit": UNASKED}
    return {**row(problem), **told, **nothing, **changes}


def colliding(problem: int = 0, depth: float = 0.0125, **changes: Any) -> Row:
    """A row that the independent checker refuses."""
    audit = {"step": 0.005, "verdict": "colliding", "depth": depth, "pair": ["hand", "shelf"]}
    return {**row(problem), "audit": audit, "clearance": -depth, **changes}


def sheet(*found: Row) -> Sheet:
    (made,) = sheets_of([Results(HEADER, found)])
    return made


def many() -> tuple[Row, ...]:
    """Two planners of ours, a peer that is faster, one that is refused, and one that is not there."""
    found = [row(k, planner=planner) for k in range(8) for planner in ("rrtconnect", "prm")]
    quick = {"seconds": {"search": 0.001}, "cpu_seconds": 0.001, "checks": {}, "duration": None, "length": 4.0}
    found += [row(k, "fast", "rrt", **quick) for k in range(8)]
    found += [colliding(k, tool="loose", planner="rrt", checks={}, cpu_seconds=1.0) for k in range(7)]
    found += [failed(7, tool="loose", planner="rrt", checks={})]
    found += [
        failed(k, "not_installed", "no compiler", tool="gone", planner="x", checks={}, seconds={}) for k in range(8)
    ]
    return tuple(found)


# --- the page


def test_refusals_are_marked_as_bad_news_and_clean_results_are_not() -> None:
    refused, clean = overall(sheet(colliding(), row(1))), overall(sheet(row(), row(1)))
    assert [cell.text for cell in refused.rows[0] if cell.bad] == ["1/2"]
    assert [cell for cell in clean.rows[0] if cell.bad] == []


def test_a_peer_that_was_not_run_has_no_numbers() -> None:
    table = overall(sheet(row(), failed(0, "not_installed", "why", tool="gone")))
    assert [cell.text for cell in table.rows[1]] == ["gone rrtconnect", "not run", *["–"] * 7]
    assert [group.name for group in sheet(*many()).present if group.tool == "gone"] == []


def test_failures_are_charged_in_counts_and_times() -> None:
    cells = {head.text: cell.text for head, cell in zip(*_of_one(row(0), failed(9)), strict=True)}
    assert cells["solved"] == "1/2"
    assert cells["states"] == "600 / 1,005"  # 150 and 1,050
    assert cells["ms"] == "60 / 101"


def _of_one(*found: Row) -> tuple[tuple[Cell, ...], tuple[Cell, ...]]:
    table = overall(sheet(*found))
    return table.heads, table.rows[0]


def test_in_short_failures_are_counted_by_reason() -> None:
    table = failures_in_short(sheet(failed(0), failed(1, detail="other"), failed(2, "NOT_CERTIFIED", "touches")))
    assert table is not None
    assert [[cell.text for cell in cells] for cells in table.rows] == [
        ["rrtconnect", "2", "TIMED_OUT", "box/0 seed 0: out of time"],
        ["rrtconnect", "1", "NOT_CERTIFIED", "box/2 seed 0: touches"],
    ]
    assert failures_in_short(sheet(row())) is None


# --- who is faster


def test_a_faster_peer_is_said_to_be_faster_with_what_its_results_are_worth() -> None:
    told = [sentence for sentence in statements(sheet(*many())) if sentence.startswith("fast rrt")]
    assert len(told) == 1
    assert "fast rrt is faster than planner_service rrtconnect" in told[0]
    assert "refuses 0 of its 8 results" in told[0]
    slower = next(sentence for sentence in statements(sheet(*many())) if sentence.startswith("loose rrt"))
    assert "is slower" in slower
    assert "refuses 7 of its 7 results" in slower


def test_peers_are_compared_on_problems_that_both_solved() -> None:
    ours = [row(k, cpu_seconds=1.0) for k in range(8)] + [failed(8, cpu_seconds=0.001)]
    theirs = [row(k, "peer", cpu_seconds=4.0) for k in range(1, 9)]
    (pace,) = paces(sheet(*ours, *theirs))
    assert (pace.units, pace.unit, pace.ratio.value, pace.faster, pace.verdict) == (7, "problems", 4.0, 0, "slower")


def test_of_few_problems_runs_are_compared_and_of_few_runs_nothing_is_said() -> None:
    ours = [row(0, seed=seed, cpu_seconds=1.0 + seed) for seed in range(6)]
    theirs = [row(0, "peer", seed=seed, cpu_seconds=3.0 * (1.0 + seed)) for seed in range(6)]
    (pace,) = paces(sheet(*ours, *theirs))
    assert (pace.units, pace.unit, pace.verdict) == (6, "runs", "slower")
    assert pace.ratio.value == pytest.approx(3.0)
    (pace,) = paces(sheet(*ours[:5], *theirs[:5]))
    assert (pace.units, pace.verdict) == (5, "not shown")


def test_where_times_overlap_no_difference_is_shown() -> None:
    ours = [row(k, cpu_seconds=1.0) for k in range(8)]
    theirs = [row(k, "peer", cpu_seconds=0.5 if k % 2 else 2.0) for k in range(8)]
    (pace,) = paces(sheet(*ours, *theirs))
    assert pace.verdict == "not shown"
    assert pace.faster == 4


def test_the_time_of_the_path_alone_leaves_out_set_up_proof_and_timing() -> None:
    ours = {"search": 0.01, "polish": 0.01, "certify": 5.0, "timing": 5.0}
    theirs = {"setup": 9.0, "search": 0.04}
    found = [row(k, seconds=ours, cpu_seconds=10.02) for k in range(3)]
    found += [row(k, "peer", seconds=theirs, cpu_seconds=0.04) for k in range(3)]
    (pace,) = paces(sheet(*found))
    assert pace.planning is not None
    assert pace.planning.value == pytest.approx(2.0)
    assert pace.ratio.value == pytest.approx(0.04 / 10.02)


def test_a_side_that_does_not_tell_its_stages_is_compared_as_a_whole() -> None:
    rows = [row(k, tool="lesson", planner="lesson", seconds={}, cpu_seconds=0.001) for k in range(6)]
    made = sheet(*map(row, range(6)), *rows)
    (pace,) = paces(made)
    assert (pace.peer, pace.planning, pace.verdict) == ("lesson", None, "faster")
    (told,) = statements(made)
    assert "For the path alone" not in told
    assert [cell.text for cell in overall(made).rows[1]][5] == "–"


def test_shorter_paths_of_a_peer_are_admitted() -> None:
    told = statements(sheet(*many()))
    assert any(
        text.startswith("Shorter paths than ours") and "fast rrt (4.00 rad to our 8.50 rad" in text for text in told
    )
    assert statements(sheet(row(), row(1, planner="prm"))) == []


def test_a_row_in_two_files_counts_once_and_suites_are_apart() -> None:
    other = row(0, suite="other")
    sheets = sheets_of([Results(HEADER, (row(0), row(1), other)), Results(HEADER, (row(0), row(2)))])
    assert [(each.suite, len(each.groups[0].rows)) for each in sheets] == [("some", 3), ("other", 1)]
    assert sheets[0].groups[0].name == "rrtconnect"


# --- pictures


# --- the command


def reported(*arguments: object, said: StringIO | None = None) -> int:
    return page.main(list(map(str, arguments)), Console(file=said or StringIO(), width=200))


def test_the_command_renews_the_generated_part_of_a_text_and_nothing_else(tmp_path: Path) -> None:
    text = tmp_path / "benchmarks.md"
    text.write_text("# Ours\n\n<!-- generated: some -->\nyesterday\n<!-- end of some -->\n\nThe end.\n", "utf-8")
    found = results_file(tmp_path / "some.jsonl", *many())
    for _ in range(2):
        assert reported(found, "--markdown", text) == 0
        told = text.read_text("utf-8")
        assert told.startswith("# Ours\n\n<!-- generated: some -->\n")
        assert told.endswith("<!-- end of some -->\n\nThe end.\n")
        assert told.count("| planner_service rrtconnect |") == 1
        assert "yesterday" not in told
        assert "fast rrt is faster" in told
        assert "`python -m benchmarks run --suite some`" in told


def test_a_text_without_the_part_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "benchmarks.md"
    text.write_text("<!-- generated: some -->\n", "utf-8")
    found = results_file(tmp_path / "some.jsonl", row())
    with pytest.raises(InvalidFile, match="<!-- end of some --> is missing"):
        reported(found, "--markdown", text)
    assert text.read_text("utf-8") == "<!-- generated: some -->\n"


def test_a_measure_is_written_into_its_part_of_a_text(tmp_path: Path) -> None:
    text = tmp_path / "measured.md"
    text.write_text("Before.\n<!-- generated: speed -->\nold\n<!-- end of speed -->\nAfter.\n", "utf-8")
    shown = table_of("Fast", [{"scene": "bin", "ms": "1.0 / 2.0"}, {"scene": "a|b", "ms": "3"}], caption="CPU time.")
    promises = (Promise("at most 2 ms", "1.0", True), Promise("at most 0.5 ms", "1.0", False))
    page.write_measure(Report("speed", (), (shown,), promises), text)
    assert text.read_text("utf-8") == (
        "Before.\n<!-- generated: speed -->\n\n| scene | ms |\n| --- | ---: |\n| bin | 1.0 / 2.0 |\n| a\\|b | 3 |\n\n"
        "CPU time.\n\n- kept: at most 2 ms: 1.0\n- MISSED: at most 0.5 ms: 1.0\n\n<!-- end of speed -->\nAfter.\n"
    )
    with pytest.raises(InvalidFile, match="<!-- generated: slow --> is missing"):
        page.write_measure(Report("slow", (), (shown,)), text)


def test_a_new_text_has_a_part_for_each_suite_and_nothing_to_write_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, out = results_file(tmp_path / "some.jsonl", *many()), tmp_path / "report.md"
    assert reported(found, "-o", out) == 0
    assert out.read_text("utf-8").startswith("## some\n\n<!-- generated: some -->")
    assert "| fast rrt |" in out.read_text("utf-8")
    with pytest.raises(InvalidRequest, match="at least one row"):
        reported(results_file(tmp_path / "none.jsonl"), "-o", out)
    with pytest.raises(SystemExit, match="2"):
        reported(found)
    assert "-o" in capsys.readouterr().err
    with pytest.raises(InvalidFile, match="nowhere has to be there"):
        reported(found, "-o", tmp_path / "nowhere" / "report.md")


def test_cells_of_a_markdown_table_cannot_break_it() -> None:
    table = Sheaf("t", (Cell("a"), Cell("b")), ((Cell("x | y\nz", "<b>"), Cell("1", "[2, 3] [4]", bad=True)),))
    assert table.markdown() == "| a | b |\n| --- | ---: |\n| x \\| y z &lt;b&gt; | **1 \\[2, 3] \\[4]** |\n"


def test_commands_are_shown_so_that_they_can_be_repeated() -> None:
    command = ["run", "--suite", "my suite.toml", "--planner", "prm:milestones=200"]
    (made,) = sheets_of([Results({**HEADER, "command": command}, (row(),))])
    shown = dict(environments(made))["command"]
    assert shown == "python -m benchmarks run --suite 'my suite.toml' --planner prm:milestones=200"


# --- what is built before


def test_building_and_asking_are_told_apart() -> None:
    size = {"states": 1_000, "edges": 9, "distances": 0, "milestones": 5, "joined": 6, "cpu_seconds": 0.5}
    growing = {"roadmap": {"states": 1_000, "edges": 9, "distances": 0}}
    once = [row(k, planner="roadmap", checks=counted(20), built=size) for k in range(4)]
    each = [row(k, planner="prm", checks=growing | counted(20)) for k in range(4)]
    trees = [row(k, planner="balancedrrtconnect", checks=counted(120)) for k in range(4)]
    ompls = [row(k, checks=counted(150)) for k in range(4)]
    (sheet,) = sheets_of([Results(HEADER, (*trees, *ompls, *once, *each))])
    found = builds(sheet)
    assert found is not None
    told = {line[0].text: [cell.text for cell in line[1:]] for line in found.rows}
    assert told["roadmap"][:4] == ["1 for 4 plans", "1,000", "500", "20.0 / 20.0"]
    assert told["roadmap"][-1] == "10"
    assert told["prm"][:2] == ["each plan", "1,000"]
    assert told["prm"][3] == "20.0 / 20.0"
    assert (told["prm"][-1], told["balancedrrtconnect"][0], told["rrtconnect"][0]) == ("–", "–", "–")
    assert "| built |" in page.filled("<!-- generated: some -->\n<!-- end of some -->\n", [sheet], Path("a.md"))


def test_a_roadmap_that_saves_nothing_never_pays_and_without_any_there_is_no_table() -> None:
    size = {"states": 1_000, "edges": 9, "distances": 0, "milestones": 5, "joined": 6, "cpu_seconds": 0.5}
    tree = row(0, planner="balancedrrtconnect")
    (sheet,) = sheets_of([Results(HEADER, (tree, row(0, planner="roadmap", built=size)))])
    found = builds(sheet)
    assert found is not None
    assert found.rows[0][-1].text == "never"
    (plain,) = sheets_of([Results(HEADER, (row(0),))])
    assert builds(plain) is None
