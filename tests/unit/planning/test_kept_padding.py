"""What padding a motion keeps where an end is closer to something."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planner_service import Cylinder, Obstacle, PlannerService, PlanRequest, PlanResult, Pose, RRTConnect, Scene
from planner_service.optimize import Optimise

PADDING = 0.02
NEAR = Obstacle("near", Cylinder(0.1, 0.2), Pose((1.2, 0.1104, 0.0)))  # 0.4 mm beside the stretched arm
START, GOAL = (0.0, 0.0), (-1.6, 0.0)


def post(gap: float) -> Obstacle:
    """A post that the end of the stretched arm, 1.5 m away, passes in that distance when it is at -0.8 rad."""
    reach = 1.5 + gap + 0.02
    return Obstacle("post", Cylinder(0.02, 0.5), Pose((reach * math.cos(-0.8), reach * math.sin(-0.8), 0.0)))


def close_to(robot: PlannerService, result: PlanResult, padding: float) -> set[tuple[str, str]]:
    """Pairs that are closer than a padding at samples where the result does not say that they are."""
    path = result.unwrap()[0]
    s = np.linspace(0.0, path.length, 800)
    near = robot.checker.near(path(s), padding + 0.01)
    pairs = [robot.checker.pair_names(pair) for pair in near.pairs.tolist()]
    return {
        names
        for row, names, distance in zip(near.rows.tolist(), pairs, near.distances.tolist(), strict=True)
        if distance < padding
        and not any(end.s_start <= s[row] <= end.s_end and names in end.pairs for end in result.near_ends)
    }


def test_a_straight_line_from_an_end_that_is_close_loses_no_padding_on_the_way() -> None:
    service = PlannerService("planar2", Scene((NEAR, post(0.015))))
    result = service.plan(PlanRequest(START, GOAL, padding=PADDING))
    assert result.attempts > 0
    assert result.padding == PADDING
    assert [end.pairs for end in result.near_ends] == [(("forearm", "near"),)]
    assert str(result.near_ends[0]) in result.notes[0]
    assert not close_to(service, result, PADDING)


def test_a_straight_line_that_keeps_the_padding_but_near_its_end_is_taken() -> None:
    service = PlannerService("planar2", Scene((NEAR,)))
    result = service.plan(PlanRequest(START, GOAL, padding=PADDING))
    assert (result.attempts, result.padding) == (0, PADDING)
    assert 0.0 < result.near_ends[0].s_end < 0.3
    assert not close_to(service, result, PADDING)


@pytest.mark.parametrize("planner", [RRTConnect(), Optimise()])
def test_where_nothing_keeps_the_padding_the_first_note_says_what_is_kept(planner: RRTConnect | Optimise) -> None:
    service = PlannerService("planar2", Scene((NEAR,)))
    result = service.plan(PlanRequest(START, (-0.01, 0.0), padding=PADDING, planner=planner))  # it is close all along
    assert result.ok
    assert result.padding < PADDING
    assert "less than the padding of 20 mm" in result.notes[0]
    assert not close_to(service, result, result.padding)
