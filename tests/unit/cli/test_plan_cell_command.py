"""The command that plans for several arms."""

from __future__ import annotations

import json
from pathlib import Path

from auditor.__main__ import judged
from tests.support.command import refused, run
from tests.unit.records.cells.test_cell_request import GOOD, written


def test_a_cell_is_planned_saved_and_proven(tmp_path: Path) -> None:
    file, out = written(tmp_path, GOOD), tmp_path / "cell.json"
    done = run("plan-cell", str(file), "--out", str(out), "--evidence", "--png", str(tmp_path / "cell.png"))
    assert done.exit_code == 0
    assert done.stdout.startswith("planned: left, right in empty")
    assert "tolerates 0.1" in done.stdout
    assert (tmp_path / "cell.png").read_bytes().startswith(b"\x89PNG")
    assert run("certify", str(out)).exit_code == 0
    assert list(judged(json.loads(out.read_text())))[-1].startswith("verified: ")
    shown = json.loads(run("plan-cell", str(file), "--delay", "0.2", "--json").stdout)
    assert shown["format"] == "planner-service/cell-plan"
    assert shown["tolerates"] >= 0.2


def test_a_cell_without_a_plan_says_why(tmp_path: Path) -> None:
    there = GOOD.replace("[0.6, 0.1]", "[0.0, 0.1]", 1)
    failed = run("plan-cell", str(written(tmp_path, there)), "--out", str(tmp_path / "cell.json"))
    assert failed.exit_code == 1
    assert "touch at the start" in failed.stderr
    assert json.loads((tmp_path / "cell.json").read_text())["failure"] is not None


def test_a_wrong_file_is_refused(tmp_path: Path) -> None:
    assert "unknown key" in refused("plan-cell", str(written(tmp_path, GOOD.replace("delay", "lateness"))))
    assert "delay: got -1.0" in refused("plan-cell", str(written(tmp_path, GOOD)), "--delay=-1")
