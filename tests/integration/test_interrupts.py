"""Ctrl-C at any line: the next call is as if nothing had happened, from the same service and from another."""

from __future__ import annotations

import os
import sys
import threading
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import ompl.util as ou
import pytest

from planner_service import (
    BalancedRRTConnect,
    CancelToken,
    PlannerService,
    PlanRequest,
    PlanResult,
    RRTConnect,
    service,
)
from planner_service.collision import budget as ledger
from planner_service.collision import checker as judging
from planner_service.concurrency import fair_lock as turns
from planner_service.planners import AORRTC, Planner
from planner_service.planning import accounting, pipeline, search_stage
from planner_service.search import ompl, planners, problem

START, GOAL = (-2.5, 2.0), (2.2, -2.2)

HELD = (ledger, turns, accounting, ompl, planners, problem, service, pipeline, search_stage, judging)
FILES = {str(module.__file__) for module in HELD}
"""Where Ctrl-C strikes: whatever holds a limit, a lock or a turn."""

SAMPLE = None if "EVERY_LINE" in os.environ else 100
"""Lines at which Ctrl-C strikes in each test: some, or with ``EVERY_LINE=1`` in the environment all of them."""

Trace = Callable[[FrameType, str, Any], Any]


def traced(act: Callable[[], object], at_line: Callable[[FrameType], None]) -> None:
    def local(frame: FrameType, event: str, _: Any) -> Trace:
        if event == "line":
            at_line(frame)
        return local

    def entered(frame: FrameType, event: str, _: Any) -> Trace | None:
        return local if frame.f_code.co_filename in FILES else None

    sys.settrace(entered)
    try:
        act()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(None)


def lines_of(act: Callable[[], object]) -> list[int]:
    """The events at which lines are reached for the first and the last time, or a sample of these."""
    reached, count = defaultdict[tuple[str, int], list[int]](list), 0

    def note(frame: FrameType) -> None:
        nonlocal count
        reached[frame.f_code.co_filename, frame.f_lineno].append(count)
        count += 1

    traced(act, note)
    assert len(reached) > 30, "or this tests nothing"
    events = sorted({k for times in reached.values() for k in (times[0], times[-1])})
    if SAMPLE is not None:
        events = sorted(np.random.default_rng(1).choice(events, min(SAMPLE, len(events)), replace=False).tolist())
    return events


def interrupted(act: Callable[[], object], event: int) -> str:
    """Have Ctrl-C come at one event; where that was."""
    count, place = 0, ""

    def strike(frame: FrameType) -> None:
        nonlocal count, place
        count += 1
        if count == event + 1:
            place = f"{Path(frame.f_code.co_filename).name}:{frame.f_lineno}"
            raise KeyboardInterrupt

    traced(act, strike)
    return place


def in_another_thread(act: Callable[[], object]) -> object:
    """What ``act`` returns, or that it hangs."""
    found: list[object] = ["it hangs"]
    thread = threading.Thread(target=lambda: found.append(act()), daemon=True)
    thread.start()
    thread.join(20.0)
    return found[-1]


def told(result: PlanResult) -> tuple[object, ...]:
    waypoints = None if result.path is None else result.path.waypoints.tobytes()
    return result.ok, result.counts, result.attempts, waypoints, str(result.failure)


def request(planner: Planner | None = None) -> PlanRequest:
    return PlanRequest(START, GOAL, planner=planner or RRTConnect(), time_limit=60.0)


@pytest.mark.parametrize("planner", [BalancedRRTConnect(), AORRTC(checks=20)], ids=lambda p: p.name)
def test_after_ctrl_c_at_any_line_of_a_plan_the_next_is_the_same(planner: Planner) -> None:
    here = PlannerService("planar2", "discs")
    asked = request(planner)
    before, level = told(here.plan(asked)), ou.getLogLevel()

    def cancellable() -> None:
        here.plan(asked, cancel=CancelToken())

    for event in lines_of(cancellable):
        place = interrupted(cancellable, event)
        assert in_another_thread(lambda: told(here.plan(asked))) == before, place
        assert told(here.plan(asked)) == before, place
        assert ou.getLogLevel() == level, place
    assert told(PlannerService("planar2", "discs").plan(asked)) == before
