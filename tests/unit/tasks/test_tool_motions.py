"""Motions of the tool along lines and arcs: what is possible, what is not, and what the result says of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import planner_service as ps
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import Pace
from planner_service.tasks import move_circular
from tests.support.optional import present

ASIDE = (0.0, 0.1, 0.0)
DOWN = (0.0, 0.0, -0.08)

linear: Callable[..., Any] = ps.move_linear
circular: Callable[..., Any] = move_circular
"""Without the types, which bad input does not have."""


@pytest.fixture(scope="module")
def cell() -> ps.PlannerService:
    """The arm above a clear table."""
    return ps.PlannerService("wxai", "table")


@pytest.fixture(scope="module")
def walled(cell: ps.PlannerService) -> ps.PlannerService:
    """The same with a wall beside the tool, 10 cm from its origin at home."""
    wall = ps.Obstacle("wall", ps.Box((0.4, 0.02, 0.4)), ps.Pose((0.25, 0.11, 0.2)))
    return cell.with_scene(cell.scene.with_obstacle(wall))


def tips(result: ps.PlanResult, cell: ps.PlannerService, count: int = 300) -> FloatArray:
    path, _ = result.unwrap()
    return np.array([cell.robot.tool_pose(q)[:3, 3] for q in path(np.linspace(0.0, path.length, count))])


def test_a_straight_tool_move_is_straight_and_checked(cell: ps.PlannerService) -> None:
    result = ps.move_linear(cell, cell.robot.home, (0.03, 0.0, 0.02))
    at = tips(result, cell)
    direction = np.array([0.03, 0.0, 0.02]) / math.hypot(0.03, 0.02)
    away = (at - at[0]) - np.outer((at - at[0]) @ direction, direction)
    assert np.abs(away).max() < 1e-3
    np.testing.assert_allclose(at[-1] - at[0], [0.03, 0.0, 0.02], atol=1e-6)
    assert result.fraction == 1.0


def test_a_tool_move_out_of_reach_says_how_far_it_came_and_why(cell: ps.PlannerService) -> None:
    result = ps.move_linear(cell, cell.robot.home, (0.0, 0.0, 1.0))
    failure = present(result.failure)
    assert failure.reason is ps.Reason.LINE_BLOCKED
    assert result.path is None
    assert failure.detail == (
        f"the straight tool line ends after {100 * present(result.fraction):.1f} %: joint_3 is at its limit"
    )
    assert result.counts.states > 0  # up to there it was checked


def test_a_tool_move_into_an_obstacle_says_how_far_it_came_and_what_collides(
    cell: ps.PlannerService, walled: ps.PlannerService
) -> None:
    goal = [(0.0, 0.02, 0.0), (0.0, 0.18, 0.0)]
    result = ps.move_linear(walled, walled.robot.home, goal)
    failure = present(result.failure)
    assert (failure.stage, failure.reason) == (ps.Stage.STRAIGHT_LINE, ps.Reason.LINE_BLOCKED)
    assert "x wall collide" in failure.detail
    assert f"ends after {100 * present(result.fraction):.1f} %" in failure.detail
    part = ps.move_linear(walled, walled.robot.home, goal, partial=True)
    assert (part.ok, part.fraction) == (True, result.fraction)
    assert present(part.certificate).certified
    assert any(note == f"only a part: {failure.detail}" for note in part.notes)
    at = tips(part, walled)
    assert at[-1, 1] - at[0, 1] == pytest.approx(0.2 * present(part.fraction), abs=1e-6)
    q = part.unwrap()[0].waypoints[-1]
    ahead = ps.move_linear(cell, q, (0.0, 0.006, 0.0)).unwrap()[0].waypoints[-1]
    assert not walled.checker.state_is_free(ahead)  # a step farther there is the wall


def test_the_tool_keeps_its_speed_limit_and_toppra_its_speed(cell: ps.PlannerService) -> None:
    pace = Pace(ps.ToppRa(), max_tool_speed=0.05)
    for result in (
        move_circular(cell, cell.robot.home, (0.0, 0.05, -0.05), ASIDE, pace=pace),
        ps.move_linear(cell, cell.robot.home, [ASIDE, DOWN], zone=0.02, pace=pace),
    ):
        _, trajectory = result.unwrap()
        t = np.linspace(0.0, trajectory.duration, 4000)
        at = np.array([cell.robot.tool_pose(q)[:3, 3] for q in trajectory(t)])
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(t)
        assert speed.max() <= 0.05 * (1.0 + 1e-6)
        cruising = speed[(t[1:] > 0.15 * t[-1]) & (t[1:] < 0.85 * t[-1])]
        assert cruising.min() > 0.05 * 0.99


def test_a_part_without_a_proof_is_cut_until_it_has_one(
    cell: ps.PlannerService, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow, tries = ps.PlannerService.follow, []
    begin = cell.robot.tool_pose(cell.robot.home)[1, 3]

    def unproven_beyond_5_cm(service: ps.PlannerService, waypoints: FloatArray, **options: Any) -> ps.PlanResult:
        result = follow(service, waypoints, **options)
        tries.append(cell.robot.tool_pose(waypoints[-1])[1, 3] - begin)
        refused = ps.Failure(ps.Stage.CERTIFY, ps.Reason.NOT_CERTIFIED, "not proven: link_5 x table")
        return result if tries[-1] < 0.05 else replace(result, path=None, trajectory=None, failure=refused)

    monkeypatch.setattr(ps.PlannerService, "follow", unproven_beyond_5_cm)
    result = ps.move_linear(cell, cell.robot.home, ASIDE, partial=True)
    assert result.ok
    assert present(result.fraction) * 0.1 == pytest.approx(tries[-1], abs=1e-6)
    assert 0.0 < tries[-1] < 0.05
    assert len(tries) < 8
    assert result.notes[-1].endswith("%: not proven: link_5 x table")
    failed = ps.move_linear(cell, cell.robot.home, ASIDE)
    assert present(failed.failure).reason is ps.Reason.NOT_CERTIFIED
    assert failed.fraction == result.fraction


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: linear(c, c.robot.home, []), r"goal: got \[\]; expected at least one Pose"),
        (lambda c: linear(c, c.robot.home, DOWN, zone=-0.1), r"zone: got -0.1; expected metres in \[0, 1\]"),
        (lambda c: circular(c, c.robot.home, "x", ASIDE), r"via: got 'x'; expected a Pose, or a shift"),
        (lambda c: circular(c, c.robot.home, (0, 0.05, 0), ASIDE), r"via: got .*; expected a point at least 0.1"),
    ],
)
def test_bad_input_names_what_is_wrong(
    cell: ps.PlannerService, call: Callable[[ps.PlannerService], Any], message: str
) -> None:
    with pytest.raises(ps.InvalidRequest, match=message):
        call(cell)
