"""Visits in files come back as they were, what is none is refused, and an order is a section of its task's file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.records.plan_file import load_task
from planner_service.records.visits import load_visits, save_visits, saved_order
from planner_service.tasks.ordering import Branch, Visit, order

THERE = ps.Pose((0.3, 0.1, 0.2), (0.0, 1.0, 0.0, 0.0))
WAYS: list[Branch | ps.Pose] = [Branch(np.array([0.1, 0.2])), THERE]
VISITS = (
    Visit("one", WAYS),
    Visit("two", [[0.3, 0.4]], Visit("then", [THERE], Visit("last", [[0.5, -0.0]])), after=("one",)),
)


def flat(visit: Visit | None) -> Any:
    if visit is None:
        return None
    ways = [way.q.tobytes() if isinstance(way, Branch) else way for way in visit.ways]
    return visit.name, ways, flat(visit.then), tuple(visit.after)


def document(**changed: Any) -> dict[str, Any]:
    visit = {"name": "a", "branches": [{"joints": [0.1, 0.2]}], **changed}
    return {"format": "planner-service/visits", "version": 1, "visits": [visit]}


def test_visits_come_back_from_their_file_bit_for_bit(tmp_path: Path) -> None:
    save_visits(VISITS, tmp_path / "visits.json")
    assert list(map(flat, load_visits(tmp_path / "visits.json"))) == list(map(flat, VISITS))
    first = json.loads((tmp_path / "visits.json").read_text())["visits"][0]
    assert set(first) == {"name", "branches"}, "what is as usual is not written"


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"branches": []}, "branches"),
        ({"branches": [{"joints": [0.1], "pose": {}}]}, "an object with joints"),
        ({"branches": [{"joints": "home"}]}, "joints"),
        ({"branches": [{"joints": [True]}]}, "joints"),
        ({"branches": [{"joints": []}]}, "joints"),
        ({"branches": [{"pose": {"position": [0, 0, 0], "quaternion_wxyz": [0, 0, 0, 0]}}]}, "quaternion"),
        ({"after": ["b"]}, "unknown visit 'b'"),
        ({"after": ["a"]}, "do not wait for each other"),
        ({"then": [{"name": "a", "branches": [{"joints": [0.1, 0.2]}]}]}, "each name once"),
        ({"then": [{"name": "b", "branches": [{"joints": [0.1, 0.2]}], "then": []}]}, "then"),
        ({"motions": []}, "motions"),
        ({"name": ""}, "name"),
    ],
)
def test_what_is_no_visit_is_refused_with_its_place(changed: dict[str, Any], match: str, tmp_path: Path) -> None:
    file = tmp_path / "visits.json"
    file.write_text(json.dumps(document(**changed)))
    with pytest.raises(ps.InvalidFile, match=match):
        load_visits(file)


def test_files_of_another_kind_and_too_many_visits_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "visits.json"
    file.write_text(json.dumps(document() | {"format": "planner-service/steps"}))
    with pytest.raises(ps.InvalidFile, match="expected 'planner-service/visits'"):
        load_visits(file)
    following = [{"name": f"b{k}", "branches": [{"joints": [0.1]}]} for k in range(500)]
    file.write_text(json.dumps(document(then=following)))
    with pytest.raises(ps.InvalidFile, match="at most 500 visits, with those that follow others; there are 501"):
        load_visits(file)


def test_what_has_no_place_in_a_file_is_refused(tmp_path: Path) -> None:
    service, q = ps.PlannerService("planar2", "empty"), np.array([0.1, 0.2])
    for branch in (Branch(q, after=service), Branch(q, q + 0.1)):
        with pytest.raises(ps.InvalidRequest, match="have no place in a file"):
            save_visits([Visit("a", [branch])], tmp_path / "visits.json")
    with pytest.raises(ps.InvalidRequest, match="visits"):
        save_visits([], tmp_path / "visits.json")
    assert not (tmp_path / "visits.json").exists()


def test_an_order_is_a_section_of_its_tasks_file(tmp_path: Path) -> None:
    service = ps.PlannerService("planar2", "empty")
    request = ps.PlanRequest([0.0, 0.0], [0.0, 0.0], time_limit=None)
    visits = [Visit("out", [[0.5, 0.1]], Visit("further", [[0.9, 0.1]])), Visit("back", [[-0.4, 0.2], [-0.3, 0.2]])]
    found = order(service, visits, request)
    saved_order(found).save(tmp_path / "task.json")
    loaded = load_task(tmp_path / "task.json")
    section = loaded.sections["order"]
    assert [stop["visit"] for stop in section["stops"]] == list(found.order)
    for stop, made in zip(section["stops"], found.stops, strict=True):
        path = loaded.segments[stop["motion"]].result.unwrap()[0]
        assert np.array_equal(path.waypoints[-1], made.leg.unwrap()[0].waypoints[-1])
        assert stop["branch"] == made.branch
    assert (section["bound"], section["floor"], section["gap"]) == (found.bound, found.floor, found.gap)
    assert section["duration"] == found.duration


def test_without_an_order_its_times_are_null_and_its_reasons_are_there(tmp_path: Path) -> None:
    service = ps.PlannerService("planar2", "discs")
    request = ps.PlanRequest([0.0, 0.0], [0.0, 0.0], time_limit=None)
    found = order(service, [Visit("in a disc", [[np.arctan2(0.6, 1.1), 0.0]])], request)
    assert not found.ok
    section = saved_order(found).sections["order"]
    assert [section[name] for name in ("duration", "bound", "floor", "gap")] == [None] * 4
    assert section["refused"][0].startswith("in a disc [0]: ")
    saved_order(found).save(tmp_path / "task.json")
    assert load_task(tmp_path / "task.json").failure is not None
