"""The gate over the smoke suite: green on what is stored, red on a planner that asks more."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks.harness import gate, pins, runner
from benchmarks.harness.suite import Suite, stored, suite_named
from planner_service import RRTConnect
from planner_service.search.problem import SearchOracle

SMALL = Suite("small", "", {"rrtconnect": RRTConnect()}, range(2), (lambda: stored(["bin", "window"], [0]),))


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What the gate stores of the small suite."""
    folder = tmp_path_factory.mktemp("baseline")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pins, "FOLDER", folder)
        patch.setattr(gate, "suite_named", lambda _: SMALL)
        assert checked("--write")[0] == 0
    return (folder / "small.json").read_bytes()


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, baseline: bytes) -> Path:
    """A suite with a baseline of its own, in what counts as the pinned environment; the file of the baseline."""
    (tmp_path / "small.json").write_bytes(baseline)
    monkeypatch.setattr(pins, "FOLDER", tmp_path)
    monkeypatch.setattr(gate, "unpinned", list)
    monkeypatch.setattr(gate, "suite_named", lambda _: SMALL)
    return tmp_path / "small.json"


def checked(*options: str) -> tuple[int, str]:
    """The exit code of the gate, and what it printed."""
    out = StringIO()
    code = gate.main(["--suite", "small", *options], Console(file=out, width=200))
    return code, out.getvalue()


def asks_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plant a mutation: every edge that OMPL's planners ask about costs a state more."""
    honest = SearchOracle.edge_is_free_coarse

    def dear(self: SearchOracle, q1: Any, q2: Any, **known: Any) -> Any:
        self.state_is_free(q1)
        return honest(self, q1, q2, **known)

    monkeypatch.setattr(SearchOracle, "edge_is_free_coarse", dear)


def test_it_is_green_on_what_is_stored_and_red_on_one_more_check_per_edge(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, printed = checked()
    assert code == 0
    assert "4 runs as stored: all equal" in printed
    with monkeypatch.context() as patch:
        asks_more(patch)
        code, printed = checked()
    assert code == 1
    assert "4 runs as stored: 4 differ" in printed
    assert "bin/0 rrtconnect seed 0" in printed
    assert "search" in printed
    assert f"{pins.REGENERATE} --suite small" in printed
    assert checked()[0] == 0


def test_elsewhere_it_says_so_and_asks_for_no_equal_counts(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "unpinned", lambda: ["ompl 9 is not 2.0.1"])
    asks_more(monkeypatch)
    code, printed = checked()
    assert code == 0
    assert "equal counts are not asked for: ompl 9 is not 2.0.1" in printed
    assert "4 differ" in next(line for line in printed.splitlines() if "as stored" in line)


def test_a_ceiling_is_not_lifted_by_storing(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "suite_named", lambda _: replace(SMALL, ceilings={"rrtconnect": 100}))
    assert checked("--write")[0] == 0
    code, printed = checked()
    assert code == 1
    assert "at most 100" in next(line for line in printed.splitlines() if "BROKEN" in line)


def smoke() -> Suite:
    return suite_named("smoke")


def test_the_stored_baseline_is_of_every_run_of_the_smoke_suite() -> None:
    jobs = runner.jobs_of(smoke())
    assert list(pins.load_pins(pins.FOLDER / "smoke.json")) == [
        f"{j.problem.id} {j.ask.name} seed {j.ask.seed}" for j in jobs
    ]
    assert set(smoke().ceilings) == set(smoke().planners)
