"""Motions of the tool along lines and arcs: what is possible, what is not, and what the result says of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Box,
    CancelToken,
    Failure,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanResult,
    Pose,
    Reason,
    Scene,
    Stage,
    ToppRa,
    Trapezoidal,
    move_linear,
)
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import Pace
from planner_service.tasks import move_circular
from tests.support.optional import present

ASIDE = (0.0, 0.1, 0.0)
DOWN = (0.0, 0.0, -0.08)

linear: Callable[..., Any] = move_linear
circular: Callable[..., Any] = move_circular
"""Without the types, which bad input does not have."""


@pytest.fixture(scope="module")
def cell() -> PlannerService:
    """The arm above a clear table."""
    return PlannerService("wxai", "table")


@pytest.fixture(scope="module")
def walled(cell: PlannerService) -> PlannerService:
    """The same with a wall beside the tool, 10 cm from its origin at home."""
    wall = Obstacle("wall", Box((0.4, 0.02, 0.4)), Pose((0.25, 0.11, 0.2)))
    return cell.with_scene(cell.scene.with_obstacle(wall))


def tips(result: PlanResult, cell: PlannerService, count: int = 300) -> FloatArray:
    path, _ = result.unwrap()
    return np.array([cell.robot.tool_pose(q)[:3, 3] for q in path(np.linspace(0.0, path.length, count))])


def test_a_straight_tool_move_is_straight_and_checked(cell: PlannerService) -> None:
    result = move_linear(cell, cell.robot.home, (0.03, 0.0, 0.02))
    at = tips(result, cell)
    direction = np.array([0.03, 0.0, 0.02]) / math.hypot(0.03, 0.02)
    away = (at - at[0]) - np.outer((at - at[0]) @ direction, direction)
    assert np.abs(away).max() < 1e-3
    np.testing.assert_allclose(at[-1] - at[0], [0.03, 0.0, 0.02], atol=1e-6)
    assert result.fraction == 1.0


def test_the_tool_does_not_stop_on_a_straight_line() -> None:
    service = PlannerService("panda", Scene())
    path, trajectory = move_linear(service, service.robot.home, (0.15, 0.1, -0.1)).unwrap()
    assert len(path.waypoints) > 2
    assert path.corners == ()
    _, qd = trajectory.moving(np.linspace(0.05, 0.95, 400) * trajectory.duration)
    assert np.abs(qd).max(axis=1).min() > 0.02


def test_a_tool_move_out_of_reach_says_how_far_it_came_and_why(cell: PlannerService) -> None:
    result = move_linear(cell, cell.robot.home, (0.0, 0.0, 1.0))
    failure = present(result.failure)
    assert failure.reason is Reason.LINE_BLOCKED
    assert result.path is None
    assert failure.detail == (
        f"the straight tool line ends after {100 * present(result.fraction):.1f} %: joint_3 is at its limit"
    )
    assert result.counts.states > 0  # up to there it was checked


@pytest.mark.parametrize("goal", [(0.0, 0.2, 0.0), [(0.0, 0.02, 0.0), (0.0, 0.18, 0.0)]], ids=["one", "two"])
def test_a_tool_move_into_an_obstacle_says_how_far_it_came_and_what_collides(
    cell: PlannerService, walled: PlannerService, goal: object
) -> None:
    result = move_linear(walled, walled.robot.home, goal)  # type: ignore[arg-type]
    failure = present(result.failure)
    assert (failure.stage, failure.reason) == (Stage.STRAIGHT_LINE, Reason.LINE_BLOCKED)
    assert "x wall collide" in failure.detail
    assert f"ends after {100 * present(result.fraction):.1f} %" in failure.detail
    part = move_linear(walled, walled.robot.home, goal, partial=True)  # type: ignore[arg-type]
    assert (part.ok, part.fraction) == (True, result.fraction)
    assert present(part.certificate).certified
    assert any(note == f"only a part: {failure.detail}" for note in part.notes)
    at = tips(part, walled)
    assert at[-1, 1] - at[0, 1] == pytest.approx(0.2 * present(part.fraction), abs=1e-6)
    q = part.unwrap()[0].waypoints[-1]
    ahead = move_linear(cell, q, (0.0, 0.006, 0.0)).unwrap()[0].waypoints[-1]
    assert not walled.checker.state_is_free(ahead)  # a step farther there is the wall


def test_a_part_is_returned_up_to_where_the_arm_can_follow(cell: PlannerService) -> None:
    part = move_linear(cell, cell.robot.home, (0.0, 0.0, 1.0), partial=True)
    assert part.ok
    assert 0.0 < present(part.fraction) < 0.5
    at = tips(part, cell)
    assert at[-1, 2] - at[0, 2] == pytest.approx(present(part.fraction), abs=1e-6)


def test_the_first_obstacle_on_the_way_is_named_not_the_limit_behind_it(cell: PlannerService) -> None:
    lid = Obstacle("lid", Box((0.4, 0.4, 0.02)), Pose((0.25, 0.0, 0.53)))
    service = cell.with_scene(cell.scene.with_obstacle(lid))
    free = present(move_linear(cell, cell.robot.home, (0.0, 0.0, 1.0)).fraction)
    result = move_linear(service, service.robot.home, (0.0, 0.0, 1.0))
    assert "x lid collide" in present(result.failure).detail
    assert present(result.fraction) < free


def test_of_a_move_that_cannot_begin_there_is_no_part(cell: PlannerService) -> None:
    within = cell.with_scene(cell.scene.with_obstacle(Obstacle("fog", Box((1.0, 1.0, 1.0)))))
    result = move_linear(within, cell.robot.home, [ASIDE, DOWN], partial=True)
    assert present(result.failure).reason is Reason.START_IN_COLLISION
    assert result.fraction == 0.0


def test_corners_are_passed_within_their_zone_and_without_one_the_tool_stops(cell: PlannerService) -> None:
    home = cell.robot.home
    sharp, round_ = (move_linear(cell, home, [ASIDE, DOWN], zone=zone) for zone in (0.0, 0.02))
    corner = cell.robot.tool_pose(home)[:3, 3] + ASIDE
    nearest = [float(np.linalg.norm(tips(result, cell, 2000) - corner, axis=1).min()) for result in (sharp, round_)]
    assert nearest[0] < 1e-4
    assert 0.004 < nearest[1] < 0.02
    assert len(sharp.unwrap()[0].corners) == 1
    assert len(round_.unwrap()[0].corners) == 0
    assert round_.unwrap()[1].duration < sharp.unwrap()[1].duration


def test_displacements_count_from_the_pose_before(cell: PlannerService) -> None:
    home = cell.robot.home
    begin = Pose.from_matrix(cell.robot.tool_pose(home))
    x, y, z = begin.position
    aside, down = Pose((x, y + 0.1, z), begin.quaternion), Pose((x, y + 0.1, z - 0.08), begin.quaternion)
    poses, shifts = move_linear(cell, home, [aside, down]), move_linear(cell, home, [ASIDE, DOWN])
    mixed = linear(cell, home, [aside, DOWN])
    assert poses.unwrap()[0].waypoints.tolist() == shifts.unwrap()[0].waypoints.tolist()
    assert poses.unwrap()[0].waypoints.tolist() == mixed.unwrap()[0].waypoints.tolist()
    rows = move_linear(cell, home, np.array([ASIDE, DOWN]))  # type: ignore[arg-type]
    assert rows.unwrap()[0].waypoints.tolist() == shifts.unwrap()[0].waypoints.tolist()


def test_a_list_of_one_pose_is_that_pose(cell: PlannerService) -> None:
    one, alone = (move_linear(cell, cell.robot.home, goal) for goal in ([DOWN], DOWN))
    assert one.unwrap()[0].waypoints.tolist() == alone.unwrap()[0].waypoints.tolist()
    assert one.counts == alone.counts


def test_a_circular_move_passes_its_middle_point_whatever_that_points_orientation(cell: PlannerService) -> None:
    home = cell.robot.home
    x, y, z = cell.robot.tool_pose(home)[:3, 3]
    middle = Pose((x, y + 0.05, z - 0.05), (0.0, 1.0, 0.0, 0.0))
    results = [move_circular(cell, home, via, ASIDE) for via in ((0.0, 0.05, -0.05), middle)]
    at = tips(results[0], cell)
    centre = np.array([x, y + 0.05, z])
    assert np.abs(np.linalg.norm(at - centre, axis=1) - 0.05).max() < 1e-3
    assert np.abs(at[:, 0] - x).max() < 1e-3
    assert at[:, 2].min() == pytest.approx(z - 0.05, abs=1e-3)
    np.testing.assert_allclose(at[-1], [x, y + 0.1, z], atol=1e-6)
    assert results[0].unwrap()[0].waypoints.tolist() == results[1].unwrap()[0].waypoints.tolist()
    assert results[0].fraction == 1.0
    assert present(results[0].certificate).certified


def test_a_circular_move_into_an_obstacle_is_possible_in_part(walled: PlannerService) -> None:
    home = walled.robot.home
    failed = move_circular(walled, home, (0.0, 0.1, -0.1), (0.0, 0.2, 0.0))
    assert present(failed.failure).detail.startswith(
        f"the circular arc ends after {100 * present(failed.fraction):.1f} %: "
    )
    part = move_circular(walled, home, (0.0, 0.1, -0.1), (0.0, 0.2, 0.0), partial=True)
    assert part.ok
    assert part.fraction == failed.fraction


@pytest.mark.parametrize("law", [Trapezoidal(), ToppRa()])
def test_the_tool_keeps_its_speed_limit_and_toppra_its_speed(cell: PlannerService, law: object) -> None:
    pace = Pace(law, max_tool_speed=0.05)  # type: ignore[arg-type]
    for result in (
        move_circular(cell, cell.robot.home, (0.0, 0.05, -0.05), ASIDE, pace=pace),
        move_linear(cell, cell.robot.home, [ASIDE, DOWN], zone=0.02, pace=pace),
    ):
        _, trajectory = result.unwrap()
        t = np.linspace(0.0, trajectory.duration, 4000)
        at = np.array([cell.robot.tool_pose(q)[:3, 3] for q in trajectory(t)])
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(t)
        assert speed.max() <= 0.05 * (1.0 + 1e-6)
        if isinstance(law, ToppRa):
            cruising = speed[(t[1:] > 0.15 * t[-1]) & (t[1:] < 0.85 * t[-1])]
            assert cruising.min() > 0.05 * 0.99


def test_the_joint_rate_is_the_callers_choice(cell: PlannerService) -> None:
    for result in (
        move_linear(cell, cell.robot.home, DOWN, max_joint_rate=1.0),
        move_linear(cell, cell.robot.home, [ASIDE, DOWN], max_joint_rate=1.0),
        move_circular(cell, cell.robot.home, (0.0, 0.05, -0.05), ASIDE, max_joint_rate=1.0),
    ):
        assert "would move more than max_joint_rate per metre of the tool" in present(result.failure).detail


def test_a_cancelled_tool_move_ends_as_preempted(cell: PlannerService) -> None:
    token = CancelToken()
    token.cancel()
    result = move_linear(cell, cell.robot.home, [ASIDE, DOWN], cancel=token)
    assert present(result.failure).reason is Reason.PREEMPTED
    assert result.fraction is None


def test_the_checks_of_every_try_are_counted(walled: PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    tries, follow = [], PlannerService.follow

    def followed(*args: Any, **options: Any) -> PlanResult:
        tries.append(follow(*args, **options))
        return tries[-1]

    monkeypatch.setattr(PlannerService, "follow", followed)
    before = walled.checker.counts
    result = move_linear(walled, walled.robot.home, [(0.0, 0.02, 0.0), (0.0, 0.18, 0.0)], partial=True)
    assert len(tries) == 2
    looking = walled.checker.counts - before  # for the first collision
    assert looking.edges > 0
    assert result.counts == sum((a.counts for a in tries), looking)


def test_a_part_without_a_proof_is_cut_until_it_has_one(cell: PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    follow, tries = PlannerService.follow, []
    begin = cell.robot.tool_pose(cell.robot.home)[1, 3]

    def unproven_beyond_5_cm(service: PlannerService, waypoints: FloatArray, **options: Any) -> PlanResult:
        result = follow(service, waypoints, **options)
        tries.append(cell.robot.tool_pose(waypoints[-1])[1, 3] - begin)
        refused = Failure(Stage.CERTIFY, Reason.NOT_CERTIFIED, "not proven: link_5 x table")
        return result if tries[-1] < 0.05 else replace(result, path=None, trajectory=None, failure=refused)

    monkeypatch.setattr(PlannerService, "follow", unproven_beyond_5_cm)
    result = move_linear(cell, cell.robot.home, ASIDE, partial=True)
    assert result.ok
    assert present(result.fraction) * 0.1 == pytest.approx(tries[-1], abs=1e-6)
    assert 0.0 < tries[-1] < 0.05
    assert len(tries) < 8
    assert result.notes[-1].endswith("%: not proven: link_5 x table")
    failed = move_linear(cell, cell.robot.home, ASIDE)
    assert present(failed.failure).reason is Reason.NOT_CERTIFIED
    assert failed.fraction == result.fraction


def test_joints_that_do_not_move_the_tool_stay() -> None:
    service = PlannerService("wxai_dual", Scene())
    home = service.robot.home
    path, _ = move_circular(service, home, (0.0, 0.02, 0.02), (0.0, 0.04, 0.0)).unwrap()
    moving = np.abs(path.waypoints - home).max(axis=0) > 0.0
    assert moving.sum() == 6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: linear(c, c.robot.home, []), r"goal: got \[\]; expected at least one Pose"),
        (
            lambda c: linear(c, c.robot.home, [ASIDE, (1.0, 2.0)]),
            r"goal\[1\]: got .*; expected a Pose, or a shift",
        ),
        (lambda c: linear(c, c.robot.home, [ASIDE, "x"]), r"goal\[1\]: got 'x'; expected a Pose, or a shift"),
        (lambda c: linear(c, c.robot.home, DOWN, zone=-0.1), r"zone: got -0.1; expected metres in \[0, 1\]"),
        (lambda c: linear(c, c.robot.home, DOWN, zone=10), r"zone: got 10; expected metres in \[0, 1\]"),
        (lambda c: linear(c, c.robot.home, DOWN, partial=1), r"partial: got 1; expected True or False"),
        (lambda c: linear(c, c.robot.home, [ASIDE, DOWN], max_joint_rate=0), r"max_joint_rate: got 0; expected"),
        (
            lambda c: linear(c, c.robot.home, [ASIDE, (1e4, 0, 0)]),
            r"goal\[1\]: got .*; expected a position within 1000 m",
        ),
        (
            lambda c: circular(c, c.robot.home, Pose((0, 1e200, 0)), ASIDE),
            r"via: got .*; expected a position within 1000",
        ),
        (lambda c: circular(c, c.robot.home, "x", ASIDE), r"via: got 'x'; expected a Pose, or a shift"),
        (lambda c: circular(c, c.robot.home, ASIDE, (1, 2)), r"goal: got \(1, 2\); expected a Pose, or a shift"),
        (lambda c: circular(c, c.robot.home, (0, 0.05, 0), ASIDE), r"via: got .*; expected a point at least 0.1"),
        (lambda c: circular(c, [0.0], DOWN, ASIDE), r"start: got .*; expected 6 joint values"),
        (lambda c: circular("x", [0.0], DOWN, ASIDE), r"service: got 'x'; expected a PlannerService"),
    ],
)
def test_bad_input_names_what_is_wrong(
    cell: PlannerService, call: Callable[[PlannerService], Any], message: str
) -> None:
    with pytest.raises(InvalidRequest, match=message):
        call(cell)
