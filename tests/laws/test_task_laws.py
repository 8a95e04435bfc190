"""Whatever a task is made of: what is solved is proven again, and what is not says which step and why."""

from __future__ import annotations

import math

import numpy as np
import pytest

import planner_service as ps
from planner_service.records.recertify import recertify
from planner_service.tasks import (
    Alternatives,
    Approach,
    Connect,
    Grasp,
    MoveLinear,
    MoveTo,
    Release,
    Repeat,
    Retreat,
    Step,
    Task,
    Wait,
)
from tests.support.optional import present

SPOTS, APART = 5, 0.11
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


def cell(rng: np.random.Generator) -> tuple[ps.PlannerService, list[tuple[float, float]]]:
    """A table with two blocks and a stand, and places on it."""
    spots: list[tuple[float, float]] = []
    while len(spots) < SPOTS:
        r, a = rng.uniform(0.2, 0.38), rng.uniform(-1.2, 1.2)
        spot = (r * math.cos(a), r * math.sin(a))
        if all(math.dist(spot, other) > APART for other in spots):
            spots.append(spot)
    block = ps.Box((0.04, 0.04, 0.05))
    obstacles = [
        ps.Obstacle("table", ps.Box((1.6, 1.6, 0.02)), ps.Pose((0.5, 0.0, -0.031))),
        ps.Obstacle("one", block, ps.Pose((*spots[0], 0.0052))),
        ps.Obstacle("other", block, ps.Pose((*spots[1], 0.0052))),
        ps.Obstacle("stand", ps.Box((0.09, 0.09, 0.04)), ps.Pose((*spots[2], 0.0))),
    ]
    return ps.PlannerService("wxai", ps.Scene(tuple(obstacles))), spots


def task(rng: np.random.Generator, spots: list[tuple[float, float]]) -> Task:
    """Something is taken, something happens, and it is set down again."""
    into: tuple[Step, ...] = (Approach("in"),)
    out: tuple[Step, ...] = (Retreat("out"),)
    if rng.random() < 0.5:
        into = (Approach("beside", (0.04,), direction=(0.3, 0.2, -0.5)), Approach("down", (0.02,), direction=DOWN))
        out = (Retreat("up", (0.02,), UP), Retreat("away", (0.05, 0.03)))
    places = [ps.Pose((*spots[3], 0.0052)), ps.Pose((*spots[2], 0.0454)), ps.Pose((*spots[4], 0.0052))]
    rng.shuffle(places)  # type: ignore[arg-type]
    between = [
        MoveTo("home"),
        Wait(0.5),
        MoveLinear(tuple(rng.uniform(-0.04, 0.04, 3).tolist())),
        Repeat((MoveLinear((0.0, 0.0, 0.02)), MoveLinear((0.0, 0.0, -0.02))), 2),
        Alternatives((MoveLinear((0.0, 0.0, 0.9)), ())),
    ]
    support = rng.choice(["table", "stand", ""]) or None
    upright = float(rng.uniform(0.3, 1.0)) if rng.random() < 0.3 else None
    return Task(
        (
            *(Connect("there"), *into, Grasp("one", support="table", upright=upright), *out),
            *(between[k] for k in rng.choice(len(between), size=2, replace=False)),
            *(Connect("across"), *into, Release("one", places, support=support), *out, MoveTo()),
        )
    )


def solved(seed: int, *, farther: float = 1.0) -> tuple[Task, ps.TaskResult]:
    """A random task, with the places so many times as far away, and what came of it."""
    rng = np.random.default_rng(seed)
    service, spots = cell(rng)
    asked, home = task(rng, [(farther * x, farther * y) for x, y in spots]), service.robot.home
    request = ps.PlanRequest(home, home, time_limit=None, max_checks=4_000)
    return asked, service.solve(asked, home, request=request, searches=8)


@pytest.mark.parametrize("seed", range(8))
def test_what_is_solved_is_proven_again(seed: int) -> None:
    _, result = solved(seed)
    assert result.ok
    assert recertify(result).certified
    assert np.array_equal(result.q, ps.load_robot("wxai").home)
    assert "one" in [obstacle.name for obstacle in result.world.scene.obstacles]


@pytest.mark.parametrize("seed", range(8))
def test_what_is_not_solved_names_a_step_that_failed_whenever_it_was_tried(seed: int) -> None:
    asked, result = solved(seed, farther=5.0)
    detail = present(result.failure).detail
    named = [step for step in asked.steps if detail.startswith(f"{step}: ")]
    assert [step.kind for step in named] == ["Release"]
    report = next(report for report in result.steps if report.step.endswith(str(named[0])))
    assert report.tried == report.failed > 0
    assert sum(times for _, times in report.reasons) == report.failed
    assert not result.segments
