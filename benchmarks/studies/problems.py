"""The public Panda problems of MotionBenchMaker, and their plans by a default request."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import planner_service as ps
from planner_service.records import Problem, ProblemSet, read_problems

__all__ = ["MOTION_STEP", "ROBOT", "SEED", "asked", "kind_of", "planned", "public_problems"]

ROBOT = "panda_mbm"
SEED = 0
FILE = Path(__file__).parents[1] / "problems" / "mbm_panda.json"

MOTION_STEP = 0.0002
"""Metres that any point of the robot moves at most between two samples of a curve that is audited."""


@cache
def public_problems() -> ProblemSet:
    """The 70 problems: ten of each of seven scenes."""
    return read_problems(FILE)


def kind_of(problem: Problem) -> str:
    """The scene of which a problem is one, such as ``cage``."""
    return problem.id.partition("/")[0]


def planned(robot: ps.Robot, problem: Problem) -> ps.PlanResult:
    """The plan of a default request, but that no clock has a say."""
    return ps.PlannerService(robot, problem.scene).plan(asked(robot, problem))


def asked(robot: ps.Robot, problem: Problem) -> ps.PlanRequest:
    """A default request, but that no clock has a say."""
    return problem.request(robot, seed=SEED, time_limit=None)
