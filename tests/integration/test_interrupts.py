"""Ctrl-C at any line: the next call is as if nothing had happened, from the same service and from another."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
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
    PRM,
    BalancedRRTConnect,
    CancelToken,
    CollisionChecker,
    PlannerService,
    PlanRequest,
    PlanResult,
    RRTConnect,
    load_robot,
    load_scene,
    service,
)
from planner_service.collision import budget as ledger
from planner_service.collision import checker as judging
from planner_service.concurrency import fair_lock as turns
from planner_service.planners import AORRTC, Planner
from planner_service.planning import accounting, pipeline, search_stage
from planner_service.search import balanced, edge_cache, ompl

START, GOAL = (-2.5, 2.0), (2.2, -2.2)

HELD = (ledger, turns, accounting, ompl, balanced, edge_cache, service, pipeline, search_stage, judging)
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


@pytest.mark.parametrize(
    "planner",
    [BalancedRRTConnect(), RRTConnect(range=1.5), AORRTC(checks=20), PRM(milestones=5)],
    ids=lambda p: p.name,
)
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


def test_after_ctrl_c_at_any_line_of_a_limit_the_checker_has_none() -> None:
    checker = CollisionChecker(load_robot("planar2"), load_scene("discs"))

    def limited() -> None:
        with checker.limited(states=3, deadline=1e9):
            checker.state_is_free(START)
            checker.edge_is_free(START, START)

    gc.freeze()  # what is here already need not be looked through each time
    try:
        for event in lines_of(limited):
            place = interrupted(limited, event)
            gc.collect()  # tracing leaves cycles that hold frames
            assert all(checker.edge_is_free(START, START) for _ in range(5)), place
    finally:
        gc.unfreeze()


def test_an_interrupted_import_is_whole_all_the_same() -> None:
    """Ctrl-C at each of some moments of a process that plans for the first time, and that then plans."""
    program = """
import signal, sys
import planner_service as ps
signal.signal(signal.SIGALRM, signal.default_int_handler)
def plan():
    service = ps.PlannerService("planar2", "discs")
    found = service.plan(ps.PlanRequest((-2.5, 2.0), (2.2, -2.2), polish=ps.Optimise()))
    assert found.polish is not None and found.polish.iterations > 0, found
    return found.counts
signal.setitimer(signal.ITIMER_REAL, float(sys.argv[1]))
try:
    plan()
except KeyboardInterrupt:
    pass
signal.setitimer(signal.ITIMER_REAL, 0)
print(plan() == plan())
"""
    for moment in (0.01, 0.05, 0.1, 0.2, 0.4):
        done = subprocess.run([sys.executable, "-c", program, str(moment)], capture_output=True, text=True, timeout=60)
        assert done.stdout == "True\n", (moment, done.stderr[-2000:])


def test_ctrl_c_between_any_two_instructions_that_make_a_planner_of_ompl_ends_no_process() -> None:
    """AORRTC's destructor crashes unless it was set up: also one that was made, but not yet assigned."""
    program = """
import sys
import planner_service as ps
from planner_service.planners import AORRTC
from planner_service.search import ompl

service = ps.PlannerService("planar2", "discs")
asked = ps.PlanRequest((-2.5, 2.0), (2.2, -2.2), planner=AORRTC(checks=20))

def struck(at):
    reached = 0

    def local(frame, event, _):
        nonlocal reached
        frame.f_trace_opcodes = True
        if event == "opcode":
            reached += 1
            if reached == at:
                raise KeyboardInterrupt
        return local

    def entered(frame, event, _):
        if frame.f_code.co_filename == ompl.__file__ and frame.f_code.co_name == "ready":
            frame.f_trace_opcodes = True
            return local

    sys.settrace(entered)
    try:
        result = service.plan(asked)
    except KeyboardInterrupt:
        return reached
    finally:
        sys.settrace(None)
    assert result.ok and (at == 0 or reached < at), "nothing else keeps Ctrl-C"
    return reached

count = struck(0)
assert count > 20, "or this tests nothing"
for at in range(1, count + 1):
    struck(at)
print(struck(0) == count)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr[-2000:]


def struck_in_the_import_of_ompl(strike: str, after: str) -> subprocess.CompletedProcess[str]:
    """A process that runs ``strike`` while OMPL makes its enumerations with Python's ``enum``, and then ``after``."""
    program = f"""
import enum, signal, sys, threading, time

struck = []

def profile(frame, event, _):
    if event != "call" or frame.f_code.co_filename != enum.__file__ or struck or "ompl._ompl" not in sys.modules:
        return
    struck.append(True)
    {strike}

sys.setprofile(profile)
threading.setprofile(profile)
{after}
"""
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)


def test_ctrl_c_while_ompl_is_imported_ends_no_process_with_a_crash() -> None:
    """OMPL ends the process where the making of its enumerations is interrupted."""
    done = struck_in_the_import_of_ompl(
        "signal.raise_signal(signal.SIGINT)",
        """
try:
    import planner_service
except KeyboardInterrupt:
    pass
sys.setprofile(None)
threading.setprofile(None)
import planner_service as ps
from planner_service.planners import AORRTC
asked = ps.PlanRequest((-2.5, 2.0), (2.2, -2.2), planner=AORRTC(checks=20))
print(bool(struck), ps.PlannerService("planar2", "discs").plan(asked).ok)
""",
    )
    assert (done.returncode, done.stdout) == (0, "True True\n"), done.stderr[-2000:]


def test_ctrl_c_that_ends_a_process_while_ompl_is_imported_lets_the_import_end_first() -> None:
    done = struck_in_the_import_of_ompl(
        "signal.pthread_kill(threading.main_thread().ident, signal.SIGINT); time.sleep(0.01)  # the main one goes on",
        "import planner_service",
    )
    assert done.returncode == -signal.SIGINT, done.stderr[-2000:]
    assert done.stderr.endswith("KeyboardInterrupt\n")
