"""The attack on the tools for agents finds what it is there to find, and the study of tasks runs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.attack.agents import ORDERS
from benchmarks.attack.harness import Wrong
from benchmarks.attack.running import maker
from benchmarks.studies import mcp
from planner_service.mcp import server

QUIET = {"lines": [], "names": list(ORDERS)[:1]}


def test_an_order_that_is_passed_on_as_a_name_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    part = maker("agents")()
    assert part.run(QUIET) == 0
    monkeypatch.setattr("planner_service.mcp.session.plainly_named", lambda scene: (scene, {}))
    with pytest.raises(Wrong, match="stands in a label alone"):
        part.run(QUIET)


def test_a_tool_that_fails_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = dataclasses.replace(server.TOOLS["describe_scene"], verb=lambda *_: 1 / 0)  # type: ignore[arg-type]
    monkeypatch.setitem(server.TOOLS, "describe_scene", broken)
    with pytest.raises(Wrong, match="no call makes a tool fail"):
        maker("agents")().run(QUIET)


def test_what_is_drawn_is_answered() -> None:
    part = maker("agents")()
    case = part.draw(np.random.default_rng(3))
    assert part.run(case) == len(case["lines"])
    assert part.counted["answered"] + part.counted["refused"] > 0


@pytest.mark.sim
@pytest.mark.slow
def test_a_task_is_done_by_tool_calls_in_simulation() -> None:
    report = mcp.run(queries=1)
    assert [promise.kept for promise in report.promises] == [True, True, True]
    assert [row["executed"] for row in report.rows] == [6]
