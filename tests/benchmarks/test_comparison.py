"""What is said of two contenders, and what is not."""

from __future__ import annotations

import math
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks import __main__ as command
from benchmarks.harness import comparison
from benchmarks.harness import statistics as stats
from benchmarks.harness.rows import Results
from benchmarks.pages.page import tables_of
from tests.benchmarks.results import HEADER, counted, results_file, row

# --- statistics


def test_quantiles_come_with_intervals_that_hold_them_and_are_the_same_each_time() -> None:
    rng = np.random.default_rng(1)
    values = {str(k): rng.lognormal(6.0, 0.5, 5).tolist() for k in range(40)}
    for share in (0.25, 0.5, 0.95):
        found = stats.quantile(values, share)
        assert found.value == pytest.approx(np.quantile(np.concatenate(list(values.values())), share))
        assert found.low < found.value < found.high
        assert found == stats.quantile(values, share)


def test_intervals_are_over_problems_so_that_more_seeds_of_one_do_not_narrow_them() -> None:
    rng = np.random.default_rng(2)
    of_problem = rng.lognormal(6.0, 0.5, 12)
    few = {str(k): [v] * 2 for k, v in enumerate(of_problem)}
    many = {str(k): [v] * 50 for k, v in enumerate(of_problem)}
    narrow, wide = (stats.quantile(v, 0.5) for v in (many, few))
    assert (narrow.high - narrow.low) == pytest.approx(wide.high - wide.low, rel=0.2)
    uneven = {**few, "0": [of_problem[0]]}
    assert stats.quantile(uneven, 0.5).low == pytest.approx(wide.low, rel=0.2)


def test_the_interval_of_a_median_covers_it_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    hits = 0
    for _ in range(100):
        found = stats.quantile({str(k): [v] for k, v in enumerate(rng.normal(0.0, 1.0, 30))}, 0.5)
        hits += found.low <= 0.0 <= found.high
    assert 88 <= hits <= 100


def test_wilsons_interval_is_the_published_one_and_stays_within_0_and_1() -> None:
    found = stats.wilson(8, 10)
    assert (found.low, found.high) == pytest.approx((0.4902, 0.9433), abs=5e-5)  # as printed in textbooks for 8 of 10
    assert stats.wilson(0, 10).low == 0.0
    assert stats.wilson(10, 10).high == 1.0
    assert stats.wilson(10, 10).low == pytest.approx(0.7225, abs=5e-5)
    assert math.isnan(stats.wilson(0, 0).value)


def test_a_steady_ratio_is_significant_and_a_difference_of_chance_is_not() -> None:
    rng = np.random.default_rng(4)
    base = rng.lognormal(6.0, 1.0, 20)
    steady = {str(k): [(v, v * 1.1 * math.exp(rng.normal(0.0, 0.02)))] for k, v in enumerate(base)}
    chance = {str(k): [(v, v * math.exp(rng.normal(0.0, 0.3)))] for k, v in enumerate(base)}
    tests = [stats.compared(name, pairs) for name, pairs in (("steady", steady), ("chance", chance))]
    first, second = stats.holm([test for test in tests if test is not None])
    assert first.ratio.value == pytest.approx(1.1, rel=0.02)
    assert (first.significant, first.verdict) == (True, "second more")
    assert (second.significant, second.verdict) == (False, "not significant")


def test_equal_values_and_too_few_pairs_are_not_significant() -> None:
    same = stats.compared("same", {str(k): [(3.0, 3.0)] for k in range(9)})
    assert same is not None
    assert (same.p, same.ratio.value) == (1.0, 1.0)
    few = stats.compared("few", {"a": [(1.0, 9.0)] * 5})
    assert few is not None
    assert "too few" in stats.holm([few])[0].verdict
    assert stats.compared("none", {}) is None


def test_seeds_of_a_problem_are_one_unit_where_there_are_six_problems() -> None:
    pairs = {str(k): [(1.0, 2.0), (2.0, 1.0)] for k in range(6)}
    found = stats.compared("states", pairs)
    assert found is not None
    assert found.units == 6
    assert found.ratio.value == pytest.approx(1.0)
    fewer = stats.compared("states", {k: pairs[k] for k in "01234"})
    assert fewer is not None
    assert fewer.units == 10


def test_holm_multiplies_by_the_hypotheses_left_and_never_falls() -> None:
    one = stats.Comparison("m", stats.Estimate(1.0, 1.0, 1.0), 9, 0.0)
    found = stats.holm([replace(one, p=p) for p in (0.04, 0.01, 0.03)])
    assert [each.adjusted for each in found] == pytest.approx([0.06, 0.03, 0.06])
    assert [each.significant for each in found] == [False, True, False]


def test_the_ratio_of_totals_is_that_of_the_sums() -> None:
    found = stats.ratio_of_totals({"a": [(1.0, 2.0), (3.0, 2.0)], "b": [(4.0, 8.0)]})
    assert found.value == pytest.approx(12.0 / 8.0)
    assert found.low <= found.value <= found.high


# --- tables


def shown(*tables: Any) -> str:
    out = StringIO()
    Console(file=out, width=200).print(*tables, sep="\n")
    return out.getvalue()


def line(text: str, begin: str) -> list[str]:
    found = next(each for each in text.splitlines() if each.startswith(f"│ {begin} "))
    return [cell.strip() for cell in found.strip("│").split("│")]


def test_a_failure_counts_in_states_and_not_in_lengths() -> None:
    failed = row("x", 1, ok=False, failure="TIMED_OUT", length=None, duration=None, checks=counted(900))
    told = line(shown(*tables_of(Results(HEADER, (row("x", 0), failed)))), "a")
    assert told[1:3] == ["1/2 [9, 91] %", "0/1"]
    assert told[3].startswith("500 / 860")
    assert told[6] == "3.00 → 2.00"


def test_a_rejected_path_is_counted() -> None:
    hit = row("x", 1, audit={"step": 0.01, "verdict": "colliding", "depth": 0.01, "pair": ["a", "b"]})
    assert line(shown(*tables_of(Results(HEADER, (row("x"), hit)))), "a")[2].startswith("1/2")


def test_two_contenders_are_compared_on_the_runs_both_have_and_lengths_where_both_solved() -> None:
    names = [f"p{k}" for k in range(10)]
    first = [row(name) for name in names]
    second = [row(name, planner="b", checks=counted(200 + k)) for k, name in enumerate(names[:9])]
    second[0] |= {"ok": False, "failure": "TIMED_OUT", "length": None, "duration": None}
    text = shown(comparison.compare("a, then b", first, second))
    states, length = line(text, "states"), line(text, "length rad")
    assert states[3].startswith("2.04")
    assert (states[4], states[-1]) == ("9", "second more")
    assert (length[3], length[4], length[-1]) == ("1.000 [1.000, 1.000]", "8", "not significant")
    assert line(text, "solved")[3:5] == ["only one: 1 : 0", "9"]


def test_a_tool_that_tells_no_counts_is_compared_by_what_it_tells() -> None:
    peer = [row(f"p{k}", tool="mplib", checks={}, length=4.0) for k in range(8)]
    text = shown(comparison.compare("", [row(f"p{k}") for k in range(8)], peer))
    assert "states in search" not in text
    assert line(text, "length rad")[3].startswith("2.000")


# --- the command


def called(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    return command.main(["compare", *map(str, arguments)]), capsys.readouterr().out


def test_the_command_compares_two_files_or_planners(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ours = [row(f"p{k}", planner=planner) for k in range(12) for planner in ("a", "b")]
    one = results_file(tmp_path / "one.jsonl", *ours)
    two = results_file(tmp_path / "two.jsonl", *(row(f"p{k}", checks=counted(50)) for k in range(12)))
    alien = results_file(tmp_path / "peer.jsonl", *(row(f"p{k}", tool="vamp", planner="rrtc") for k in range(7)))
    code, printed = called(capsys, one)
    assert code == 0
    assert "a, then b" in printed
    assert "a, then b" in called(capsys, one, "--planner", "a", "--planner", "b")[1]
    assert "second less" in called(capsys, one, two)[1]
    code, printed = called(capsys, one, alien)
    assert code == 2
    assert "vamp rrtc" in printed
    code, printed = called(capsys, one, alien, "--planner", "a", "--planner", "vamp rrtc")
    assert code == 0
    assert "a, then vamp rrtc" in printed
    assert "unknown planner 'c'" in called(capsys, one, "--planner", "c")[1]


def test_the_command_says_what_cannot_be_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    none = results_file(tmp_path / "none.jsonl")
    one = results_file(tmp_path / "one.jsonl", row("p0"))
    both = results_file(tmp_path / "both.jsonl", *(row("p0", planner=planner) for planner in ("a", "b")))
    other = results_file(tmp_path / "other.jsonl", row("q0"))
    for asked, told in (
        ((none,), "no row in it; expected at least one"),
        ((one, none), "no row in it; expected at least one"),
        ((one,), "all rows are of a: there is nothing to compare it with; give a second file"),
        ((one, both, "--planner", "b", "--planner", "a"), "unknown planner of the first file 'b'"),
        ((one, both, "--planner", "b"), "b is not in both files: a and a, b"),
        ((one, both, *("--planner", "a") * 3), "expected at most two, one of each file"),
        ((one, other), "a: they have no run of the same problem and seed in common"),
    ):
        code, printed = called(capsys, *asked)
        assert (code, told in printed) == (2, True), (asked, printed)


def test_files_made_in_different_places_are_said_to_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two = (results_file(tmp_path / f"{name}.jsonl", row("p0")) for name in ("one", "two"))
    assert "different places" not in called(capsys, one, two)[1]
    two.write_text(two.read_text("utf-8").replace("a <fast> one", "slow"), "utf-8")
    code, printed = called(capsys, one, two)
    assert code == 0
    assert "made in different places, times are not comparable: cpu a <fast> one and slow" in printed
