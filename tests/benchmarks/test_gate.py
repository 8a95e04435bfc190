"""The gate over the smoke suite: green on what is stored, red on a planner that asks more."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks.harness import environment, gate, pins, runner
from benchmarks.harness.report import Row
from benchmarks.harness.suite import Suite, load_suite
from planner_service.errors import InvalidFile
from planner_service.search.edge_cache import SearchOracle

ROOT = Path(__file__).parents[2]

SMALL = """\
about = "a few runs of the smoke suite's"
planners = ["rrtconnect"]
seeds = "0:2"
ceilings = { rrtconnect = 6000 }

[[queries]]
scenes = ["bin", "window"]
numbers = [0]
"""


@pytest.fixture(scope="module")
def baseline(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What the gate stores of the small suite."""
    folder = tmp_path_factory.mktemp("baseline")
    (folder / "small.toml").write_text(SMALL, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pins, "FOLDER", folder)
        assert checked(str(folder / "small.toml"), "--write")[0] == 0
    return (folder / "small.json").read_bytes()


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, baseline: bytes) -> str:
    """A suite with a baseline of its own, in what counts as the pinned environment."""
    (tmp_path / "small.toml").write_text(SMALL, "utf-8")
    (tmp_path / "small.json").write_bytes(baseline)
    monkeypatch.setattr(pins, "FOLDER", tmp_path)
    monkeypatch.setattr(gate, "unpinned", list)
    return str(tmp_path / "small.toml")


def checked(suite: str, *options: str) -> tuple[int, str]:
    """The exit code of the gate, and what it printed."""
    out = StringIO()
    code = gate.main(["--suite", suite, *options], Console(file=out, width=200))
    return code, out.getvalue()


def asks_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plant a mutation: every edge that OMPL's planners ask about costs a state more."""
    honest = SearchOracle.edge_is_free_coarse

    def dear(self: SearchOracle, q1: Any, q2: Any, **known: Any) -> Any:
        self.state_is_free(q1)
        return honest(self, q1, q2, **known)

    monkeypatch.setattr(SearchOracle, "edge_is_free_coarse", dear)


def test_it_is_green_on_what_is_stored_and_red_on_one_more_check_per_edge(
    small: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, printed = checked(small)
    assert code == 0
    assert "4 runs as stored: all equal" in printed
    with monkeypatch.context() as patch:
        asks_more(patch)
        code, printed = checked(small)
    assert code == 1
    assert "4 runs as stored: 4 differ" in printed
    assert "bin/0 rrtconnect seed 0" in printed
    assert "search" in printed
    assert f"{pins.REGENERATE} --suite {small}" in printed
    assert checked(small)[0] == 0


def test_elsewhere_it_says_so_and_asks_for_no_equal_counts(small: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "unpinned", lambda: ["ompl 9 is not 2.0.1"])
    asks_more(monkeypatch)
    code, printed = checked(small)
    assert code == 0
    assert "equal counts are not asked for: ompl 9 is not 2.0.1" in printed
    assert "4 differ" in next(line for line in printed.splitlines() if "as stored" in line)


def test_a_ceiling_is_not_lifted_by_storing(small: str) -> None:
    Path(small).write_text(SMALL.replace("6000", "100"), "utf-8")
    assert checked(small, "--write")[0] == 0
    code, printed = checked(small)
    assert code == 1
    assert "at most 100" in next(line for line in printed.splitlines() if "BROKEN" in line)


def test_a_plan_that_is_lost_and_a_path_that_is_rejected_are_told(small: str, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = runner.Job.row

    def worse(job: runner.Job) -> Row:
        row = honest(job)
        if (job.problem.id, job.ask.seed) == ("bin/0", 0):
            return row | {"ok": False, "failure": "TIMED_OUT"}
        return row | {"audit": {"step": 0.01, "verdict": "colliding", "depth": 0.1, "pair": ["a", "b"]}}

    monkeypatch.setattr(runner.Job, "row", worse)
    monkeypatch.setattr(gate, "unpinned", lambda: ["elsewhere"])
    code, printed = checked(small)
    assert code == 1
    assert "plans lost: bin/0 rrtconnect seed 0" in printed
    assert "rejected by the independent checker: bin/0 rrtconnect ['a', 'b']" in printed


def test_without_a_baseline_it_says_how_to_store_one(small: str, tmp_path: Path) -> None:
    (tmp_path / "small.json").unlink()
    with pytest.raises(InvalidFile, match=pins.REGENERATE):
        checked(small)


def test_a_baseline_that_cannot_be_stored_is_refused_before_anything_is_planned(
    small: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pins, "FOLDER", tmp_path / "nowhere")
    monkeypatch.setattr(runner.Job, "row", lambda _: pytest.fail("it is planned"))
    with pytest.raises(InvalidFile, match="nowhere has to be there"):
        checked(small, "--write")


@pytest.mark.parametrize("text", ["[]", '{"bin/0 rrtconnect seed 0": 1}'])
def test_pins_that_are_none_are_refused(small: str, tmp_path: Path, text: str) -> None:
    (tmp_path / "small.json").write_text(text, "utf-8")
    with pytest.raises(InvalidFile, match="expected an object that holds one for each run"):
        checked(small)


def test_a_run_that_is_gone_is_reported(small: str, tmp_path: Path) -> None:
    content = json.loads((tmp_path / "small.json").read_text("utf-8"))
    pins.store_pins(tmp_path / "small.json", {**content, "more": {"outcome": "planned"}})
    code, printed = checked(small)
    assert code == 1
    assert "4 runs as stored: 1 differ" in printed


def smoke() -> Suite:
    return load_suite("smoke")


def test_the_stored_baseline_is_of_every_run_of_the_smoke_suite() -> None:
    jobs = runner.jobs_of(smoke())
    assert list(pins.load_pins(pins.FOLDER / "smoke.json")) == [
        f"{j.problem.id} {j.ask.planner} seed {j.ask.seed}" for j in jobs
    ]
    assert set(smoke().ceilings) == set(smoke().planners)


ELSEWHERE = """\
import json
from benchmarks.harness import gate
from benchmarks.harness import runner
from benchmarks.harness.suite import load_suite
jobs = runner.jobs_of(load_suite("smoke"), ["rrtconnect", "lbkpiece1"], [1])[::6]
print(json.dumps(gate.pins_of(runner.made(jobs[::-1]))))
"""


def test_two_runs_and_another_process_cost_the_same_as_is_stored() -> None:
    jobs = runner.jobs_of(smoke(), ["rrtconnect", "lbkpiece1"], [1])[::6]
    here = gate.pins_of(runner.made(jobs))
    assert gate.pins_of(runner.made(jobs)) == here
    told = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "4321"}
    done = subprocess.run([sys.executable, "-c", ELSEWHERE], cwd=ROOT, env=told, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == here
    changed = pins.differences(pins.load_pins(pins.FOLDER / "smoke.json"), here)
    assert not changed or environment.unpinned(), changed


def test_the_pinned_environment_is_that_of_the_constraints(monkeypatch: pytest.MonkeyPatch) -> None:
    assert environment.pinned()["ompl"] == "2.0.1"
    pinned = dict(environment.pinned())
    monkeypatch.setattr(environment, "versions", lambda: {**pinned, "numpy": "1.0"})
    assert environment.unpinned()[0] == f"numpy 1.0 is not {pinned['numpy']}"
