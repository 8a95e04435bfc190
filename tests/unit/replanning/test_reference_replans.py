"""What replanning costs and comes to while the planar arm moves: the numbers of release 0.1.0.

A line names the outcome, when the new motion begins and how many old waypoints are left beyond a stop, then the
motion as in the pinned plans.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import pytest

from benchmarks.worlds import queries
from planner_service import Cylinder, Obstacle, PlannerService, PlanRequest, PlanResult, Pose, SCurve, Trapezoidal
from planner_service.planning import Pace
from planner_service.replanning import Replanned
from planner_service.scene.scene import Scene
from tests.support.optional import present
from tests.support.pinned import pinned
from tests.unit.planning.test_reference_plans import line as plan_line
from tests.unit.replanning.test_replan import BENT, EMPTY, WIDE, disc

PINNED = pinned("replans")


@lru_cache
def room() -> PlannerService:
    return PlannerService("planar2", EMPTY)


@lru_cache
def swing() -> PlanResult:
    return room().plan(PlanRequest((0.0, 0.0), (2.4, 0.0), time_limit=None))


@lru_cache
def curved(pace: Pace | None = None) -> PlanResult:
    return room().follow(BENT, pace=pace, blends=WIDE)


@lru_cache
def among_discs() -> tuple[PlannerService, PlanResult]:
    service = PlannerService("planar2", "discs")
    return service, service.plan(PlanRequest((-2.5, 2.0), (2.2, -2.2), seed=7, time_limit=None))


@lru_cache
def out_of_the_bin() -> tuple[PlannerService, PlanResult]:
    service, stored = PlannerService("wxai", "bin"), queries.load("bin")[0]
    return service, service.plan(PlanRequest(stored.start, stored.goal, time_limit=None))


def again(motion: PlanResult | Replanned, at: float, **changes: Any) -> Replanned:
    """Replan in the empty room, ``at`` a share of the motion's time."""
    return room().replan(motion, at_time=at * present(motion.trajectory).duration, **changes)


def in_the_discs(at: float, **changes: Any) -> Replanned:
    service, motion = among_discs()
    return service.replan(motion, at_time=at * present(motion.trajectory).duration, **changes)


def over_the_bin(at: float, **changes: Any) -> Replanned:
    service, motion = out_of_the_bin()
    return service.replan(motion, at_time=at * present(motion.trajectory).duration, **changes)


def with_post(x: float, y: float) -> Scene:
    """The bin and a thin post."""
    there = out_of_the_bin()[0].scene
    return Scene((*there.obstacles, Obstacle("post", Cylinder(0.02, 0.6), Pose((x, y, 0.3)))))


def stopped() -> Replanned:
    """A stop before a wall that closes the way."""
    return again(swing(), 0.3, scene=disc(1.9, 0.6))


CASES: dict[str, Callable[[], Replanned]] = {
    "kept": lambda: again(swing(), 0.3),
    "kept on a blend": lambda: again(curved(), 0.4, latency=0.05),
    "kept among discs": lambda: in_the_discs(0.4),
    "kept over the bin": lambda: over_the_bin(0.4),
    "new goal": lambda: again(curved(), 0.25, goal=(2.2, 0.9)),
    "new goal in a blend": lambda: again(curved(), 0.4, goal=(2.5, 1.3), latency=0.02),
    "new goal at the end": lambda: again(curved(), 0.97, goal=(2.5, 1.3)),
    "new goal by trapezoids": lambda: again(curved(Pace(Trapezoidal())), 0.5, goal=(2.2, 0.9)),
    "new goal by an s-curve": lambda: again(curved(Pace(SCurve(), velocity_scale=0.5)), 0.5, goal=(2.2, 0.9)),
    "new goal behind": lambda: again(swing(), 0.5, goal=(-0.5, 0.3)),
    "new goal among discs": lambda: in_the_discs(0.3, goal=(2.0, -2.4)),
    "another goal among discs": lambda: in_the_discs(0.6, goal=(-2.0, -2.0)),
    "new goal over the bin": lambda: over_the_bin(0.3, goal=queries.load("bin")[1].goal),
    "slower": lambda: again(
        swing(), 0.2, request=PlanRequest((0.0, 0.0), (2.4, 0.5), time_limit=None, velocity_scale=0.3)
    ),
    "around a disc": lambda: again(swing(), 0.2, scene=disc(1.9)),
    "around a disc, early": lambda: again(swing(), 0.05, scene=disc(1.2, 0.1)),
    "around a disc that is near": lambda: again(swing(), 0.3, scene=disc(1.45)),
    "around a disc beside a blend": lambda: again(curved(), 0.3, scene=disc(1.5, 0.05, away=1.2)),
    "around a post over the bin": lambda: over_the_bin(0.2, scene=with_post(0.25, 0.0)),
    "around another post": lambda: over_the_bin(0.1, scene=with_post(0.2, 0.2)),
    "away from a disc that left": lambda: in_the_discs(0.3, scene=Scene(among_discs()[0].scene.obstacles[1:])),
    "stop": stopped,
    "stop in a blend": lambda: again(curved(), 0.35, scene=disc(1.9, 0.6)),
    "stop over the bin": lambda: over_the_bin(0.5, goal=Pose((2.0, 0.0, 0.0))),
    "stop as quickly as the robot can": lambda: again(swing(), 0.4, scene=disc(1.35, 0.1)),
    "after a stop": lambda: again(stopped(), 0.5),
    "at rest": lambda: again(swing(), 1.0, goal=(1.0, 0.4)),
    "at rest at the goal": lambda: again(swing(), 1.0),
    "passed": lambda: again(swing(), 0.8, scene=disc(0.5)),
}


def line(found: Replanned) -> str:
    """What is pinned of it."""
    begins = f"{found.outcome.name} at {found.splice:.6g}, {len(found.ahead)} ahead"
    stop = "" if found.stop is None else f", a stop of {found.stop.duration:.5g}"
    why = "" if found.failure is None else f", {found.failure.reason.value}"
    return f"{begins}{stop}{why}; {plan_line(found.result)}"


def lines() -> dict[str, str]:
    """What is to be pinned."""
    return {name: line(replan()) for name, replan in CASES.items()}


def test_the_pinned_answers_are_these() -> None:
    assert list(PINNED) == list(CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_replanning_costs_and_comes_to_what_is_pinned(name: str) -> None:
    assert line(CASES[name]()) == PINNED[name]
