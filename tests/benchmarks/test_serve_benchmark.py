"""The study of the server: what it sends is drawn by a seed, and answers are compared by all but what a clock says."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from benchmarks.studies.serve import asked, hostile
from planner_service import PlannerService
from planner_service.records.plan_file import SavedPlan

PLAN = {"result": {"path": [0.1, 0.2], "stages": [{"stage": "search", "seconds": 0.1, "states": 7}]}, "seconds": 1.0}


def locustfile(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The file that locust runs, without locust."""
    (tmp_path / "requests.json").write_text("[]")
    monkeypatch.setenv("SERVE_REQUESTS", str(tmp_path / "requests.json"))
    stub = SimpleNamespace(FastHttpUser=object, task=lambda function: function)
    monkeypatch.setitem(sys.modules, "locust", stub)
    monkeypatch.delitem(sys.modules, "benchmarks.studies.serve.locustfile", raising=False)
    from benchmarks.studies.serve import locustfile

    return locustfile


def test_locust_compares_what_the_study_compares(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert locustfile(monkeypatch, tmp_path).digest(PLAN) == asked.digest(PLAN)


def test_a_digest_is_of_all_but_what_a_clock_says() -> None:
    change: Any
    for change, same in [
        (lambda plan: plan.update(seconds=2.0), True),
        (lambda plan: plan["result"]["stages"][0].update(seconds=2.0), True),
        (lambda plan: plan["result"]["stages"][0].update(states=8), False),
        (lambda plan: plan["result"]["path"].__setitem__(0, 0.1 + 1e-18), True),  # the same double
        (lambda plan: plan["result"]["path"].__setitem__(0, 0.10000000000000002), False),
    ]:
        changed = json.loads(json.dumps(PLAN))
        change(changed)
        assert (asked.digest(changed) == asked.digest(PLAN)) is same


def test_a_hostile_request_is_drawn_by_its_seed() -> None:
    first, again = ([hostile._hostile(random.Random(seed)) for seed in range(300)] for _ in range(2))
    assert first == again
    assert len(set(first)) > 250


def test_the_bodies_ask_for_what_the_library_plans(bin_: PlannerService) -> None:
    (request,), (body,) = asked.plan_requests(1), asked.plan_bodies(asked.plan_requests(1))
    recorded = SavedPlan.of(bin_.plan(request)).document()["request"]
    assert {name: recorded[name] for name in body["request"]} == body["request"]
