"""``planner-service order``: visits in a file are put in order, or what has no order is named."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planner_service.records.plan_file import load_task
from planner_service.records.visits import save_visits
from planner_service.tasks.ordering import Visit
from tests.support.command import run

HOME = (0.0, 0.95, 1.15, -1.25, 0.0, 0.0)


def turned(*angles: float) -> list[list[float]]:
    return [[angle, *HOME[1:]] for angle in angles]


@pytest.fixture
def visits(tmp_path: Path) -> Path:
    file = tmp_path / "visits.json"
    save_visits([Visit("left", turned(0.5, 0.4), after=["right"]), Visit("right", turned(-0.4))], file)
    return file


def test_visits_in_a_file_are_put_in_order_saved_and_proven(visits: Path, tmp_path: Path) -> None:
    solved, picture = tmp_path / "task.json", tmp_path / "task.png"
    done = run("order", str(visits), "--scene", "bin", "--out", str(solved), "--png", str(picture), "--end", "ready")
    assert done.exit_code == 0
    assert "planned: order 2 visits" in done.output
    assert "2 visits in " in done.output
    assert "longer than the best" in done.output
    section = load_task(solved).sections["order"]
    assert [stop["visit"] for stop in section["stops"]] == ["right", "left"]
    assert [stop["motion"] for stop in section["stops"]] == [0, 1]
    assert section["floor"] <= section["bound"] <= section["duration"]
    assert picture.stat().st_size > 1_000
    assert run("certify", str(solved)).exit_code == 0


def test_json_has_the_order_with_its_gap(visits: Path) -> None:
    done = run("order", str(visits), "--scene", "bin", "--json", "--gap", "0.2", "--plans", "10")
    assert done.exit_code == 0
    assert json.loads(done.stdout)["sections"]["order"]["gap"] <= 0.2


def test_a_visit_that_touches_something_is_named(tmp_path: Path) -> None:
    save_visits([Visit("below the table", [[0.0, 2.4, 0.3, 0.0, 0.0, 0.0]])], tmp_path / "visits.json")
    done = run("order", str(tmp_path / "visits.json"), "--scene", "bin")
    assert done.exit_code == 1
    assert "no branch of below the table can be used" in done.output.replace("\n", " ")


@pytest.mark.parametrize("option", [("--gap", "-1"), ("--gap", "nan"), ("--plans", "0"), ("--end", "nowhere")])
def test_options_out_of_range_are_refused(visits: Path, option: tuple[str, str]) -> None:
    assert run("order", str(visits), "--scene", "bin", *option).exit_code == 2


def test_a_file_that_is_none_of_visits_is_refused(tmp_path: Path) -> None:
    (tmp_path / "visits.json").write_text('{"format": "planner-service/steps", "version": 1, "steps": []}')
    done = run("order", str(tmp_path / "visits.json"), "--scene", "bin")
    assert (done.exit_code, "expected 'planner-service/visits'" in done.output) == (2, True)
