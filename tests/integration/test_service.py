"""PlannerService: what a plan is, what it costs, and why there is none; mostly on the two-link arm among discs."""

from __future__ import annotations

import math
import os
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import planner_service as ps
from auditor.checker import IndependentChecker, tables_of
from planner_service.planning import AllowedStretch
from tests.support.optional import present

ROOT = Path(__file__).parents[2]
START, GOAL = (0.0, 0.0), (math.pi / 2, -math.pi / 2)


def asked(start: object = START, goal: object = GOAL, **settings: object) -> ps.PlanRequest:
    """A request without a clock: what it decides is decided by counts."""
    return ps.PlanRequest(**{"start": start, "goal": goal, "timing": ps.Trapezoidal(), "time_limit": None, **settings})  # type: ignore[arg-type]


# -- plans ----------------------------------------------------------------------------------------


def test_a_free_straight_line_is_the_plan_and_nothing_is_searched(discs: ps.PlannerService) -> None:
    result = discs.plan(asked(goal=(0.3, -0.3)))
    assert result.unwrap()[0].waypoints.tolist() == [[0.0, 0.0], [0.3, -0.3]]
    assert result.stage(ps.Stage.SEARCH).counts == ps.CheckCounts()
    assert result.attempts == 0


def test_a_blocked_line_is_searched_and_every_piece_of_the_path_is_free(discs: ps.PlannerService) -> None:
    result = discs.plan(asked())
    path, trajectory = result.unwrap()
    assert result.stage(ps.Stage.SEARCH).counts.states > 0
    assert path.waypoints[0].tolist() == list(START)
    assert path.waypoints[-1].tolist() == list(GOAL)
    assert discs.checker.path_is_free(path)
    assert trajectory(trajectory.duration).tolist() == list(GOAL)


def test_any_of_several_goals_will_do_and_the_result_says_which(discs: ps.PlannerService) -> None:
    inside_a_disc = (math.atan2(0.6, 1.1), 0.0)
    result = discs.plan(asked(goal=[inside_a_disc, GOAL, (0.3, 0.0)]))
    assert result.goal_index == 2
    assert result.unwrap()[0].waypoints[-1].tolist() == [0.3, 0.0]


def test_a_pose_goal_is_reached_by_the_tool(bin_: ps.PlannerService) -> None:
    pose = ps.Pose((0.25, -0.20, 0.10), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    path, _ = bin_.plan(asked(bin_.robot.home, pose)).unwrap()
    np.testing.assert_allclose(bin_.robot.tool_pose(path.waypoints[-1]), pose.matrix, atol=1e-7)


# -- no plan --------------------------------------------------------------------------------------


def test_unwrap_raises_what_the_failure_says(discs: ps.PlannerService) -> None:
    result = discs.plan(asked(goal=(4.0, 0.0)))
    with pytest.raises(ps.PlanningFailed, match=r"GOAL_OUTSIDE_LIMITS.*shoulder = 4 is outside"):
        result.unwrap()


@pytest.mark.parametrize(
    ("start", "goal", "reason"),
    [
        (START, (math.atan2(0.6, 1.1), 0.0), ps.Reason.GOAL_IN_COLLISION),
        ((math.atan2(0.6, 1.1), 0.0), GOAL, ps.Reason.START_IN_COLLISION),
    ],
)
def test_an_end_in_collision_names_the_pair_its_depth_and_the_nearest_free_configuration(
    discs: ps.PlannerService, start: object, goal: object, reason: ps.Reason
) -> None:
    failure = present(discs.plan(asked(start, goal)).failure)
    assert failure.reason is reason
    assert (failure.contacts[0].a, failure.contacts[0].b) == ("forearm", "lesson_disc")
    assert 0.0 < failure.contacts[0].depth < 0.32
    assert "forearm x lesson_disc (at most" in failure.detail
    assert discs.checker.state_is_free(present(failure.nearest_free))


def test_a_start_outside_its_limits_is_refused_unless_it_is_within_the_tolerance(discs: ps.PlannerService) -> None:
    refused = present(discs.plan(asked(start=(math.pi + 0.02, 0.0), goal=(3.0, 0.0))).failure)
    clamped = discs.plan(asked(start=(math.pi + 0.005, 0.0), goal=(3.0, 0.0)))
    assert refused.reason is ps.Reason.START_OUTSIDE_LIMITS
    assert clamped.unwrap()[0].waypoints[0].tolist() == [math.pi, 0.0]
    assert "clamped" in clamped.notes[0]


def test_things_that_are_carried_together_are_not_judged_against_each_other_and_the_answer_names_them() -> None:
    tray = ps.Attached("tray", ps.Box((0.2, 0.2, 0.01)), ps.Pose((0.3, 0.0, 0.0)))
    cup = ps.Attached(
        "cup", ps.Box((0.05, 0.05, 0.1)), ps.Pose((0.3, 0.0, 0.055))
    )  # stands on the tray, to the last bit or not
    service = ps.PlannerService("planar2", ps.Scene((), attached=(tray, cup)))
    result = service.plan(asked(start=(0.0, 0.5), goal=(1.0, 0.4)))
    assert "not judged: tray x cup (carried together)" in str(result)
    second = IndependentChecker(ROOT / "robots" / "planar2", tables_of(service.scene))
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (100, 2)):
        assert not any({"tray", "cup"} == {contact.a, contact.b} for contact in service.checker.contacts(q))
    assert not any({"tray", "cup"} == set(pair) for pair in second.pairs)


def test_what_a_service_allows_to_touch_stands_in_every_answer(discs: ps.PlannerService) -> None:
    pair = ("forearm", "lesson_disc")
    service = ps.PlannerService("planar2", discs.scene, allowed=[pair])
    results = [service.plan(asked()), service.plan(asked(goal=(4.0, 0.0)))]
    assert [result.ok for result in results] == [True, False]
    for result in results:
        assert result.allowed == (pair,)
        assert "not judged: forearm x lesson_disc (allowed by the service)" in str(result)


def walled_in() -> ps.PlannerService:
    """The planar arm with its goal at (pi, 0) between two rods closer than any motion: it is boxed in."""
    rods = tuple(
        ps.Obstacle(f"rod_{side}", ps.Box((0.4, 0.02, 0.2)), ps.Pose((-1.3, y, 0.0)))
        for side, y in (("l", 0.03), ("r", -0.03))
    )
    stop = ps.Obstacle("stop", ps.Box((0.02, 0.2, 0.2)), ps.Pose((-1.53, 0.0, 0.0)))
    return ps.PlannerService("planar2", ps.Scene((*rods, stop)))


def test_a_spent_budget_is_exact_leaves_feasibility_open_and_tells_what_was_in_the_way() -> None:
    service = walled_in()
    result = service.plan(asked(goal=(math.pi, 0.0), max_checks=3000, retries=1, planner=ps.RRTConnect(range=0.5)))
    failure = present(result.failure)
    assert failure.reason is ps.Reason.CHECK_BUDGET_EXHAUSTED
    assert result.counts.states <= 3000
    assert "whether a path exists is unknown" in failure.detail
    assert {name for a, b, _ in failure.blocked_by for name in (a, b)} >= {"forearm", "rod_l"}
    assert sum(share for *_, share in failure.blocked_by) == pytest.approx(1.0)
    assert "at the goal was free: it is boxed in" in failure.detail


def test_a_spent_time_box_says_that_the_clock_decided() -> None:
    result = walled_in().plan(asked(goal=(math.pi, 0.0), time_limit=0.0))
    assert present(result.failure).reason is ps.Reason.TIMED_OUT
    assert not result.deterministic


def test_a_cancelled_call_ends_as_preempted() -> None:
    service, token = walled_in(), ps.CancelToken()
    threading.Timer(0.05, token.cancel).start()
    result = service.plan(asked(goal=(math.pi, 0.0), max_checks=10**8), cancel=token)
    assert present(result.failure).reason is ps.Reason.PREEMPTED
    assert not result.deterministic


# -- bad requests ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": (0.0, math.nan)}, r"start: got nan; expected a finite value for elbow"),
        ({"start": [True, False]}, r"start: got .*; expected joint values"),
        ({"goal": ()}, r"goal: got .*; expected"),
        ({"seed": -1}, r"seed: got -1; expected a whole number"),
        ({"velocity_scale": 0.0}, r"velocity_scale: got 0.0"),
        ({"planner": "rrt"}, r"planner: got 'rrt'; expected a planner such as BalancedRRTConnect\(\)"),
        ({"timing": "fast"}, r"timing: got 'fast'"),
    ],
)
def test_a_bad_request_names_the_field_the_value_and_what_would_be_right(
    discs: ps.PlannerService, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(ps.InvalidRequest, match=message):
        discs.plan(asked(**settings))


def test_services_of_one_world_share_what_is_compiled_and_count_apart() -> None:
    service = ps.PlannerService("wxai", "bin")
    again, narrow = ps.PlannerService.of(service.world), service.changed(gripper=0.02)
    assert again.checker.parts is service.checker.parts
    assert narrow.checker.parts is not service.checker.parts
    home, padded = service.robot.home, [each.checker.variant(padding=0.01) for each in (service, again)]
    assert padded[0].parts is padded[1].parts
    assert [each.state_is_free(home) for each in padded] == [
        service.checker.variant(padding=0.01).state_is_free(home)
    ] * 2
    assert (service.checker.counts.states, again.checker.counts.states) == (2, 1)
    assert service.checker.state_is_free(home)
    assert not again.checker.variant(padding=0.1).state_is_free(home)
    allowed = ps.PlannerService(service.robot, service.scene, allowed=[("link_5", "bin_floor")])
    assert allowed.checker.pair_count < again.checker.pair_count
    coarse = ps.PlannerService(service.robot, service.scene, edge_step=ps.JointStep(0.5))
    assert coarse.checker.segments(home, home + 0.1) < again.checker.segments(home, home + 0.1)


def test_a_service_carried_across_a_fork_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    service = ps.PlannerService("planar2", "discs")
    monkeypatch.setattr(os, "getpid", lambda: -1)
    with pytest.raises(ps.InvalidRequest, match="built before a fork"):
        service.plan(asked())


# -- padding, rest pose, remedies -----------------------------------------------------------------


def test_the_way_out_of_sleep_is_exempt_for_its_two_pairs_and_nothing_else(bin_: ps.PlannerService) -> None:
    sleep = bin_.robot.pose("sleep")
    result = bin_.plan(asked(sleep, bin_.robot.home))
    assert result.ok
    assert result.exempt[0].s_start == 0.0
    assert result.exempt[0].s_end == pytest.approx(math.sqrt(2) * 0.08)
    assert result.exempt[0].pairs == (("link_2", "link_5"), ("link_2", "link_4"))
    without = ps.PlannerService(replace(bin_.robot, retreats=()), bin_.scene).plan(asked(sleep, bin_.robot.home))
    assert present(without.failure).reason is ps.Reason.START_IN_COLLISION


def test_a_way_out_of_a_collision_touches_only_what_it_touched_at_its_start(discs: ps.PlannerService) -> None:
    start = np.array([math.atan2(0.6, 1.1) - 0.1, 0.0])
    out = present(discs.way_out(start))
    assert out.pairs == (("forearm", "lesson_disc"),)
    assert out.path.waypoints[0].tolist() == start.tolist()
    assert discs.checker.state_is_free(out.path.waypoints[-1])


# -- following a given line -----------------------------------------------------------------------


def test_a_given_polyline_is_judged_once_piece_by_piece(discs: ps.PlannerService) -> None:
    points = [(0.0, 0.0), (0.1, -0.1), (0.1, -0.2)]
    result = discs.follow(points)
    samples = sum(discs.checker.segments(a, b) for a, b in pairwise(points))
    assert result.counts - result.stage(ps.Stage.CERTIFY).counts == ps.CheckCounts(states=1 + samples, edges=2)
    assert result.unwrap()[0].waypoints.tolist() == [list(q) for q in points]


def test_contact_is_allowed_only_on_the_stretch_it_is_meant_for(discs: ps.PlannerService) -> None:
    touching = (math.atan2(0.6, 1.1), 0.0)
    points = [START, touching, (1.3, 0.0)]
    pair = (("forearm", "lesson_disc"),)
    whole = discs.follow(points, contacts=[AllowedStretch(0, 2, pair, "test")])
    half = discs.follow(points, contacts=[AllowedStretch(0, 1, pair, "test")])
    assert whole.ok
    assert whole.exempt[0].s_end == whole.unwrap()[0].length
    assert present(half.failure).reason is ps.Reason.LINE_BLOCKED
