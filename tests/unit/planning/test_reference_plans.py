"""What plans of every kind cost and come to: the numbers of release 0.1.0.

A line names the outcome; the states, edges and distances of each stage; and of a plan its corners and blends, how long
it takes, with stops and with the time to settle, how fast the tool moves, what clearance is proven and with what
padding the path was found. The notes are counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from benchmarks.worlds import queries
from planner_service import (
    PRM,
    LazyPRM,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    PoseGoal,
    RRTConnect,
    SCurve,
    Trapezoidal,
)
from planner_service.optimize import Chomp, TrajOpt
from planner_service.planning import Pace
from planner_service.planning.follow import AllowedStretch
from tests.support.optional import present
from tests.support.pinned import pinned

PINNED = pinned("plans")

START, GOAL = (-2.5, 2.0), (2.2, -2.2)
BLOCKED = (0.7854, -0.7854)
"""Link 2 is in the disc of the lesson."""

MEANT = tuple((link, f"{disc}_disc") for link in ("forearm", "upper_arm") for disc in ("lesson", "back", "far", "low"))


@lru_cache
def service(robot: str, scene: str) -> PlannerService:
    return PlannerService(robot, scene)


def among_discs(**changes: Any) -> PlanResult:
    asked = {"start": START, "goal": GOAL, "seed": 7, "time_limit": None, **changes}
    return service("planar2", "discs").plan(PlanRequest(**asked))


def query(scene: str, number: int, **changes: Any) -> PlanResult:
    stored = queries.load(scene)[number]
    asked = {"start": stored.start, "goal": stored.goal, "seed": number, "time_limit": None, **changes}
    return service("wxai", scene).plan(PlanRequest(**asked))


def named(scene: str, start: str, goal: Any, **changes: Any) -> PlanResult:
    robot = service("wxai", scene).robot
    goal = robot.pose(goal) if isinstance(goal, str) else goal
    return service("wxai", scene).plan(PlanRequest(robot.pose(start), goal, time_limit=None, **changes))


def above_the_bin() -> Pose:
    robot = service("wxai", "bin").robot
    return Pose.from_matrix(robot.tool_pose(np.array(queries.load("bin")[0].goal)))


def followed(**options: Any) -> PlanResult:
    points = [[-2.5, 2.0], [-2.2, 1.6], [-2.4, 2.2], [-2.9, 2.4]]
    return service("planar2", "discs").follow(points, **options)


def over_a_roadmap(max_checks: int, *, fallback: bool) -> PlanResult:
    """A plan over a lazy roadmap around the posts, and with an RRT-Connect behind it if there is a fallback."""
    roadmap = service("wxai", "post").build_roadmap(LazyPRM(milestones=150, neighbours=8), progress=False)
    return query("post", 2, planner=replace(roadmap, fallback=fallback), max_checks=max_checks)


def twice(scene: str, number: int) -> PlanResult:
    """The second plan of two along a roadmap that remembers."""
    memory = service("wxai", scene).path_memory()
    first = query(scene, number, planner=memory)
    return query(scene, number, planner=present(first.roadmap))


CASES: dict[str, Callable[[], PlanResult]] = {
    "default": among_discs,
    "trapezoids": lambda: among_discs(timing=Trapezoidal()),
    "s-curve without blends": lambda: among_discs(timing=SCurve(), blend=0.0),
    "s-curve with narrow blends": lambda: among_discs(timing=SCurve(20.0), blend=0.05),
    "half the speed": lambda: among_discs(velocity_scale=0.5, acceleration_scale=0.25),
    "slow tool": lambda: among_discs(max_tool_speed=0.2),
    "few states": lambda: among_discs(max_checks=150),
    "enough to search": lambda: among_discs(max_checks=900),
    "wide padding": lambda: among_discs(padding=0.05),
    "no padding": lambda: among_discs(padding=0.0),
    "start in collision": lambda: among_discs(start=BLOCKED),
    "goal in collision": lambda: among_discs(goal=BLOCKED),
    "one goal of two": lambda: among_discs(goal=[BLOCKED, GOAL]),
    "two goals": lambda: among_discs(goal=[GOAL, (-2.0, -2.0)]),
    "two goals in an array": lambda: among_discs(goal=np.array([GOAL, (-2.0, -2.0)])),
    "start over a limit": lambda: among_discs(start=(-3.145, 2.0), goal=(-2.5, 2.2)),
    "start far over a limit": lambda: among_discs(start=(-3.3, 2.0)),
    "nowhere to go": lambda: among_discs(goal=START),
    "straight": lambda: among_discs(goal=(-2.2, 1.6)),
    "short steps": lambda: among_discs(planner=RRTConnect(range=0.05)),
    "another seed": lambda: among_discs(seed=3, retries=2),
    "polished": lambda: among_discs(polish=Optimise(method=TrajOpt())),
    "polished for trapezoids": lambda: among_discs(polish=Optimise(method=Chomp()), timing=Trapezoidal()),
    "optimised from lines": lambda: among_discs(planner=Optimise(method=TrajOpt(), starts=3)),
    "optimised, not free": lambda: among_discs(planner=Optimise(method=Chomp(), starts=1)),
    "bin": lambda: query("bin", 0),
    "window": lambda: query("window", 3, timing=SCurve()),
    "shelf": lambda: query("shelf", 1, padding=0.01),
    "bin optimised from lines": lambda: query("bin", 4, planner=Optimise(method=TrajOpt(), starts=4)),
    "bin polished": lambda: query("bin", 1, polish=Optimise(method=TrajOpt())),
    "pose": lambda: query("bin", 0, goal=above_the_bin()),
    "pose with room": lambda: query("bin", 0, goal=PoseGoal(above_the_bin(), position_tolerance=0.01)),
    "pose out of reach": lambda: query("bin", 0, goal=Pose((2.0, 0.0, 0.0))),
    "out of sleep": lambda: named("table", "sleep", "ready"),
    "to sleep": lambda: named("table", "home", "sleep", timing=SCurve()),
    "asleep": lambda: named("table", "sleep", "sleep"),
    "roadmap": lambda: query("bin", 2, planner=PRM(milestones=150, neighbours=8)),
    "lazy roadmap": lambda: query("post", 2, planner=LazyPRM(milestones=150, neighbours=8)),
    "roadmap with few states, then a search": lambda: over_a_roadmap(1000, fallback=True),
    "roadmap alone with few states": lambda: over_a_roadmap(700, fallback=False),
    "roadmap alone": lambda: over_a_roadmap(1000, fallback=False),
    "remembered": lambda: twice("bin", 3),
    "followed": followed,
    "followed with blends": lambda: followed(blends=[0.0, 0.2, 0.02, 0.0], pace=Pace(SCurve(), velocity_scale=0.5)),
    "followed with padding": lambda: followed(padding=0.05),
    "followed with more padding than there is": lambda: followed(padding=0.07),
    "followed through a disc": lambda: service("planar2", "discs").follow([START, GOAL]),
    "followed where contact is meant": lambda: service("planar2", "discs").follow(
        [START, (-2.2, 1.6), GOAL], contacts=[AllowedStretch(1, 2, MEANT, "meant")], blends=[0.0, 0.1, 0.0]
    ),
}


def line(result: PlanResult) -> str:
    """What is pinned of a result."""
    stages = " ".join(
        f"{report.stage.value}:{report.counts.states}/{report.counts.edges}/{report.counts.distances}"
        for report in result.stages
    )
    if result.failure is not None:
        failure = result.failure
        found = f"{len(failure.contacts)} contacts, blocked by {len(failure.blocked_by)}"
        return f"{failure.reason.value}; {stages}; {found}{', a free place near' * (failure.nearest_free is not None)}"
    path, trajectory = result.unwrap()
    motion = present(result.motion)
    numbers = (
        *(path.length, trajectory.duration, motion.stop_duration, motion.settle_time, motion.tool_speed),
        *(present(result.certificate).clearance * 1e3, result.padding * 1e3),
    )
    shape = f"{len(path.waypoints)} points, {int((path.blends > 0.0).sum())} blends"
    more = f"attempt {result.attempts}, goal {result.goal_index}, {len(result.notes)} notes"
    return f"planned; {stages}; {shape}; {' '.join(f'{number:.5g}' for number in numbers)}; {more}"


def lines() -> dict[str, str]:
    """What is to be pinned."""
    return {name: line(plan()) for name, plan in CASES.items()}


def test_the_pinned_plans_are_these() -> None:
    assert list(PINNED) == list(CASES)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_plan_costs_and_comes_to_what_is_pinned(name: str) -> None:
    assert line(CASES[name]()) == PINNED[name]
