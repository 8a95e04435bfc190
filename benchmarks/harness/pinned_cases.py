"""What one plan or replan of each kind costs: other requests, planners and ends than the stored queries have."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from types import MappingProxyType
from typing import Any

import numpy as np

import planner_service as ps
from benchmarks.harness.pins import fingerprint
from benchmarks.harness.report import Row
from benchmarks.worlds import queries
from planner_service.optimize import Chomp, TrajOpt
from planner_service.planning import AllowedStretch, Pace
from planner_service.replanning import Replanned

__all__ = ["CASES", "PLANS", "REPLANS", "made"]

START, GOAL = (-2.5, 2.0), (2.2, -2.2)
BLOCKED = (0.7854, -0.7854)
"""Link 2 is in a disc."""
MEANT = tuple((link, f"{disc}_disc") for link in ("forearm", "upper_arm") for disc in ("lesson", "back", "far", "low"))
LINE = ((-2.5, 2.0), (-2.2, 1.6), (-2.4, 2.2), (-2.9, 2.4))
BENT = ((0.0, 0.0), (1.0, 0.2), (1.6, 1.0), (2.4, 1.0))

service = cache(ps.PlannerService)


def _planned(robot: str, scene: str, request: ps.PlanRequest, **changes: Any) -> ps.PlanResult:
    return service(robot, scene).plan(replace(request, time_limit=None, **changes))


_discs = partial(_planned, "planar2", "discs", ps.PlanRequest(START, GOAL, seed=7))


def _stored(scene: str, number: int, **changes: Any) -> ps.PlanResult:
    query = queries.load(scene)[number]
    return _planned(queries.ROBOT, scene, ps.PlanRequest(query.start, query.goal, seed=number), **changes)


def _followed(points: Any = LINE, **options: Any) -> ps.PlanResult:
    return service("planar2", "discs").follow(points, **options)


def _named(start: str, goal: str, **changes: Any) -> ps.PlanResult:
    pose = service(queries.ROBOT, "table").robot.pose
    return _planned(queries.ROBOT, "table", ps.PlanRequest(pose(start), pose(goal)), **changes)


def _above_the_bin() -> ps.Pose:
    return ps.Pose.from_matrix(service(queries.ROBOT, "bin").robot.tool_pose(queries.load("bin")[0].goal))


def _remembered() -> ps.PlanResult:
    """The second plan of two along a roadmap that remembers."""
    first = _stored("bin", 3, planner=service(queries.ROBOT, "bin").path_memory())
    return _stored("bin", 3, planner=first.roadmap)


PLANS: Mapping[str, Callable[[], ps.PlanResult]] = MappingProxyType(
    {
        "default": _discs,
        "trapezoids": partial(_discs, timing=ps.Trapezoidal()),
        "s-curve without blends": partial(_discs, timing=ps.SCurve(), blend=0.0),
        "s-curve with narrow blends": partial(_discs, timing=ps.SCurve(20.0), blend=0.05),
        "half the speed": partial(_discs, velocity_scale=0.5, acceleration_scale=0.25),
        "slow tool": partial(_discs, max_tool_speed=0.2),
        "few states": partial(_discs, max_checks=150),
        "wide padding": partial(_discs, padding=0.05),
        "start in collision": partial(_discs, start=BLOCKED),
        "goal in collision": partial(_discs, goal=BLOCKED),
        "one goal of two": partial(_discs, goal=[BLOCKED, GOAL]),
        "two goals": partial(_discs, goal=np.array([GOAL, (-2.0, -2.0)])),
        "start over a limit": partial(_discs, start=(-3.145, 2.0), goal=(-2.5, 2.2)),
        "nowhere to go": partial(_discs, goal=START),
        "straight": partial(_discs, goal=(-2.2, 1.6)),
        "short steps": partial(_discs, planner=ps.RRTConnect(range=0.05)),
        "polished": partial(_discs, polish=ps.Optimise(method=TrajOpt())),
        "polished for trapezoids": partial(_discs, polish=ps.Optimise(method=Chomp()), timing=ps.Trapezoidal()),
        "optimised from lines": partial(_discs, planner=ps.Optimise(method=TrajOpt(), starts=3)),
        "optimised, not free": partial(_discs, planner=ps.Optimise(method=Chomp(), starts=1)),
        "shelf with padding": partial(_stored, "shelf", 1, padding=0.01),
        "bin optimised from lines": partial(_stored, "bin", 4, planner=ps.Optimise(method=TrajOpt(), starts=4)),
        "pose": lambda: _stored("bin", 0, goal=_above_the_bin()),
        "pose with room": lambda: _stored("bin", 0, goal=ps.PoseGoal(_above_the_bin(), position_tolerance=0.01)),
        "pose out of reach": partial(_stored, "bin", 0, goal=ps.Pose((2.0, 0.0, 0.0))),
        "out of sleep": partial(_named, "sleep", "ready"),
        "to sleep": partial(_named, "home", "sleep", timing=ps.SCurve()),
        "asleep": partial(_named, "sleep", "sleep"),
        "roadmap": partial(_stored, "bin", 2, planner=ps.PRM(milestones=150, neighbours=8)),
        "lazy roadmap": partial(_stored, "post", 2, planner=ps.LazyPRM(milestones=150, neighbours=8)),
        "lazy roadmap, few states": partial(_stored, "post", 2, planner=ps.LazyPRM(milestones=150), max_checks=700),
        "remembered": _remembered,
        "followed": _followed,
        "followed with blends": partial(_followed, blends=[0.0, 0.2, 0.02, 0.0], pace=Pace(ps.SCurve(), 0.5)),
        "followed with padding": partial(_followed, padding=0.05),
        "followed with more padding than there is": partial(_followed, padding=0.07),
        "followed through a disc": partial(_followed, (START, GOAL)),
        "followed where contact is meant": partial(
            _followed, (START, LINE[1], GOAL), contacts=[AllowedStretch(1, 2, MEANT, "")], blends=[0.0, 0.1, 0.0]
        ),
    }
)


_swing = partial(_planned, "planar2", "empty", ps.PlanRequest((0.0, 0.0), (2.4, 0.0)))


def _curved(pace: Pace | None = None) -> ps.PlanResult:
    return service("planar2", "empty").follow(BENT, pace=pace, blends=(0.0, 0.4, 0.3, 0.0))


def _disc(angle: float, radius: float = 0.05, away: float = 1.4) -> ps.Scene:
    place = (away * math.cos(angle), away * math.sin(angle), 0.0)
    return ps.Scene((ps.Obstacle("disc", ps.Cylinder(radius, 0.2), ps.Pose(place)),))


def _again(make: Callable[[], ps.PlanResult | Replanned], share: float, **changes: Any) -> Replanned:
    """Replan what is made, a share of its time after it began, in its own world."""
    motion = make()
    assert motion.trajectory is not None
    origin = motion.result.origin if isinstance(motion, Replanned) else motion.origin
    assert origin is not None
    return ps.PlannerService.of(origin.world).replan(motion, at_time=share * motion.trajectory.duration, **changes)


_over_the_bin = partial(_stored, "bin", 0)
_stopped = partial(_again, _swing, 0.3, scene=_disc(1.9, 0.6))

REPLANS: Mapping[str, Callable[[], Replanned]] = MappingProxyType(
    {
        "kept": partial(_again, _swing, 0.3),
        "kept on a blend": partial(_again, _curved, 0.4, latency=0.05),
        "kept among discs": partial(_again, _discs, 0.4),
        "kept over the bin": partial(_again, _over_the_bin, 0.4),
        "new goal": partial(_again, _curved, 0.25, goal=(2.2, 0.9)),
        "new goal in a blend": partial(_again, _curved, 0.4, goal=(2.5, 1.3), latency=0.02),
        "new goal at the end": partial(_again, _curved, 0.97, goal=(2.5, 1.3)),
        "new goal by an s-curve": partial(_again, partial(_curved, Pace(ps.SCurve(), 0.5)), 0.5, goal=(2.2, 0.9)),
        "new goal behind": partial(_again, _swing, 0.5, goal=(-0.5, 0.3)),
        "new goal among discs": partial(_again, _discs, 0.3, goal=(2.0, -2.4)),
        "another goal among discs": partial(_again, _discs, 0.6, goal=(-2.0, -2.0)),
        "new goal over the bin": lambda: _again(_over_the_bin, 0.3, goal=queries.load("bin")[1].goal),
        "around a disc": partial(_again, _swing, 0.2, scene=_disc(1.9)),
        "around a disc that is near": partial(_again, _swing, 0.3, scene=_disc(1.45)),
        "around a disc beside a blend": partial(_again, _curved, 0.3, scene=_disc(1.5, away=1.2)),
        "stop": _stopped,
        "stop in a blend": partial(_again, _curved, 0.35, scene=_disc(1.9, 0.6)),
        "stop over the bin": partial(_again, _over_the_bin, 0.5, goal=ps.Pose((2.0, 0.0, 0.0))),
        "stop as quickly as the robot can": partial(_again, _swing, 0.4, scene=_disc(1.35, 0.1)),
        "after a stop": partial(_again, _stopped, 0.5, scene=ps.Scene()),
        "at rest at the goal": partial(_again, _swing, 1.0),
        "passed": partial(_again, _swing, 0.8, scene=_disc(0.5)),
    }
)

CASES: Mapping[str, Callable[[], ps.PlanResult | Replanned]] = MappingProxyType({**PLANS, **REPLANS})


def _row(result: ps.PlanResult | Replanned) -> Row:
    if isinstance(result, Replanned):
        stop = None if result.stop is None else f"{result.stop.duration:.5g}"
        found = {
            "replanned": result.outcome.name,
            "splice": f"{result.splice:.6g}",
            "ahead": len(result.ahead),
            "stop": stop,
        }
        return found | _row(result.result)
    row, motion, proof = fingerprint(result), result.motion, result.certificate
    if motion is not None and proof is not None:
        numbers = (motion.duration, motion.stop_duration, motion.settle_time, motion.tool_speed, proof.clearance * 1e3)
        row["motion"] = " ".join(f"{number:.5g}" for number in numbers)
    return row | {
        "padding": result.padding,
        "attempts": result.attempts,
        "goal": result.goal_index,
        "notes": len(result.notes),
    }


def made(names: Iterable[str] = CASES) -> dict[str, Row]:
    """What some of the cases cost, by name."""
    return {name: _row(CASES[name]()) for name in names}
