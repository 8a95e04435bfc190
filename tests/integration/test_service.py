"""PlannerService: what a plan is, what it costs, and why there is none; mostly on the two-link arm among discs."""

from __future__ import annotations

import hashlib
import math
import os
import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from auditor.checker import IndependentChecker, tables_of
from planner_service import (
    PRM,
    Attached,
    Box,
    CancelToken,
    CheckCounts,
    Cylinder,
    InvalidRequest,
    JointPath,
    Obstacle,
    PlannerService,
    PlanningFailed,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    RRTConnect,
    Scene,
    Stage,
    Trapezoidal,
    load_robot,
    load_scene,
    move_linear,
)
from planner_service.planners import RRTstar
from planner_service.planning import AllowedStretch
from tests.support.optional import present

ROOT = Path(__file__).parents[2]
START, GOAL = (0.0, 0.0), (math.pi / 2, -math.pi / 2)


def asked(start: object = START, goal: object = GOAL, **settings: object) -> PlanRequest:
    """A request without a clock: what it decides is decided by counts."""
    return PlanRequest(**{"start": start, "goal": goal, "timing": Trapezoidal(), "time_limit": None, **settings})  # type: ignore[arg-type]


def fingerprint(result: PlanResult) -> str:
    path, _ = result.unwrap()
    text = "".join(value.hex() for value in [*path.waypoints.ravel().tolist(), *path.blends.tolist()])
    counts = [(report.stage.value, report.counts) for report in result.stages]
    return hashlib.sha256(f"{text} {counts}".encode()).hexdigest()


# -- plans ----------------------------------------------------------------------------------------


def test_a_free_straight_line_is_the_plan_and_nothing_is_searched(discs: PlannerService) -> None:
    result = discs.plan(asked(goal=(0.3, -0.3)))
    assert result.unwrap()[0].waypoints.tolist() == [[0.0, 0.0], [0.3, -0.3]]
    assert result.stage(Stage.SEARCH).counts == CheckCounts()
    assert result.attempts == 0


def test_a_blocked_line_is_searched_and_every_piece_of_the_path_is_free(discs: PlannerService) -> None:
    result = discs.plan(asked())
    path, trajectory = result.unwrap()
    assert result.stage(Stage.SEARCH).counts.states > 0
    assert path.waypoints[0].tolist() == list(START)
    assert path.waypoints[-1].tolist() == list(GOAL)
    assert discs.checker.path_is_free(path)
    assert trajectory(trajectory.duration).tolist() == list(GOAL)


def test_the_counts_of_a_result_are_the_sum_of_its_stages_and_what_was_judged(discs: PlannerService) -> None:
    before = discs._planning.counts
    result = discs.plan(asked())
    assert sum((report.counts for report in result.stages), CheckCounts()) == result.counts
    assert discs._planning.counts - before == result.counts


def test_questions_of_ones_own_change_nothing_about_a_plan(discs: PlannerService) -> None:
    alone, stop = fingerprint(discs.plan(asked())), threading.Event()

    def ask() -> None:
        while not stop.is_set():
            discs.checker.state_is_free(START)

    asking = threading.Thread(target=ask)
    asking.start()
    beside = fingerprint(discs.plan(asked()))
    stop.set()
    asking.join()
    assert beside == alone


def test_shortcutting_makes_the_path_shorter(discs: PlannerService) -> None:
    result = discs.plan(asked(seed=3))
    search, short = result.stage(Stage.SEARCH).length, result.stage(Stage.SHORTCUT).length
    assert search is not None
    assert short is not None
    assert short < search


def test_any_of_several_goals_will_do_and_the_result_says_which(discs: PlannerService) -> None:
    inside_a_disc = (math.atan2(0.6, 1.1), 0.0)
    result = discs.plan(asked(goal=[inside_a_disc, GOAL, (0.3, 0.0)]))
    assert result.goal_index == 2
    assert result.unwrap()[0].waypoints[-1].tolist() == [0.3, 0.0]


def test_a_pose_goal_is_reached_by_the_tool(bin_: PlannerService) -> None:
    pose = Pose((0.25, -0.20, 0.10), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    path, _ = bin_.plan(asked(bin_.robot.home, pose)).unwrap()
    np.testing.assert_allclose(bin_.robot.tool_pose(path.waypoints[-1]), pose.matrix, atol=1e-7)


def test_asleep_and_asked_to_sleep_nothing_moves(bin_: PlannerService) -> None:
    sleep = bin_.robot.pose("sleep")
    result = bin_.plan(asked(sleep, sleep))
    assert result.unwrap()[0].waypoints.tolist() == [[0.0] * 6]
    assert bin_.plan(asked(sleep, bin_.robot.retreats[0].to)).unwrap()[0].length == pytest.approx(math.sqrt(2) * 0.08)


def test_a_configuration_beside_sleep_is_not_taken_for_it(bin_: PlannerService) -> None:
    beside = bin_.plan(asked([0.0, 0.0, 0.0, 0.0, 0.005, 0.0], bin_.robot.home))
    assert present(beside.failure).reason is Reason.START_IN_COLLISION
    assert "the pose 'sleep' itself has a way out" in present(beside.failure).detail


def test_many_colliding_goals_cost_little_when_one_is_free(discs: PlannerService) -> None:
    inside = (math.atan2(0.6, 1.1), 0.0)
    result = discs.plan(asked(goal=[inside] * 50 + [(0.3, 0.0)]))
    assert result.goal_index == 50
    assert result.stage(Stage.ENDPOINTS).counts.states <= 1 + 51 * 3


def test_half_the_velocity_and_acceleration_take_longer_and_move_the_same_way(discs: PlannerService) -> None:
    full, half = discs.plan(asked()), discs.plan(asked(velocity_scale=0.5, acceleration_scale=0.5))
    assert half.unwrap()[0].waypoints.tolist() == full.unwrap()[0].waypoints.tolist()
    assert half.unwrap()[1].duration > 1.4 * full.unwrap()[1].duration


def test_a_roadmap_is_grown_on_its_own_budget_and_its_cost_is_reported(discs: PlannerService) -> None:
    result = discs.plan(asked(planner=PRM(milestones=60, neighbours=6), max_checks=2000))
    assert result.ok
    assert result.stage(Stage.ROADMAP).counts.states > 2000


def test_an_anytime_planner_ends_at_its_soft_cap_with_a_path(discs: PlannerService) -> None:
    result = discs.plan(asked(planner=RRTstar(checks=3000)))
    assert result.ok
    assert 3000 <= result.stage(Stage.SEARCH).counts.states < 3500
    assert result.attempts == 1


# -- no plan --------------------------------------------------------------------------------------


def test_unwrap_raises_what_the_failure_says(discs: PlannerService) -> None:
    result = discs.plan(asked(goal=(4.0, 0.0)))
    with pytest.raises(PlanningFailed, match=r"GOAL_OUTSIDE_LIMITS.*shoulder = 4 is outside"):
        result.unwrap()


@pytest.mark.parametrize(
    ("start", "goal", "reason"),
    [
        (START, (math.atan2(0.6, 1.1), 0.0), Reason.GOAL_IN_COLLISION),
        ((math.atan2(0.6, 1.1), 0.0), GOAL, Reason.START_IN_COLLISION),
    ],
)
def test_an_end_in_collision_names_the_pair_its_depth_and_the_nearest_free_configuration(
    discs: PlannerService, start: object, goal: object, reason: Reason
) -> None:
    failure = present(discs.plan(asked(start, goal)).failure)
    assert failure.reason is reason
    assert (failure.contacts[0].a, failure.contacts[0].b) == ("forearm", "lesson_disc")
    assert 0.0 < failure.contacts[0].depth < 0.32
    assert "forearm x lesson_disc (at most" in failure.detail
    assert discs.checker.state_is_free(present(failure.nearest_free))


def test_a_start_outside_its_limits_is_refused_unless_it_is_within_the_tolerance(discs: PlannerService) -> None:
    refused = present(discs.plan(asked(start=(math.pi + 0.02, 0.0), goal=(3.0, 0.0))).failure)
    clamped = discs.plan(asked(start=(math.pi + 0.005, 0.0), goal=(3.0, 0.0)))
    assert refused.reason is Reason.START_OUTSIDE_LIMITS
    assert clamped.unwrap()[0].waypoints[0].tolist() == [math.pi, 0.0]
    assert "clamped" in clamped.notes[0]


def test_a_goal_outside_its_limits_is_refused_unless_it_is_within_the_tolerance(discs: PlannerService) -> None:
    refused = present(discs.plan(asked(start=(3.0, 0.0), goal=(math.pi + 0.02, 0.0))).failure)
    clamped = discs.plan(asked(start=(3.0, 0.0), goal=[(math.pi + 0.02, 0.0), (math.nextafter(math.pi, 4.0), 0.0)]))
    assert refused.reason is Reason.GOAL_OUTSIDE_LIMITS
    assert clamped.unwrap()[0].waypoints[-1].tolist() == [math.pi, 0.0]
    assert clamped.goal_index == 1
    pi = "3.141592653589793"
    assert clamped.notes[0] == f"goal[1]: shoulder = {pi[:-1]}4 is outside [-{pi}, {pi}]; it was clamped to the limit"


def test_given_lines_are_clamped_as_ends_are_and_say_so() -> None:
    service = PlannerService("planar2", Scene(()))
    limit = float(service.robot.limits.upper[0])
    beyond, far = [(0.0, 0.5), (limit + 3e-6, 0.5)], [(0.0, 0.5), (limit + 0.02, 0.5)]
    result = service.follow(beyond)
    assert result.unwrap()[0].waypoints[-1].tolist() == [limit, 0.5]
    assert result.notes[0].startswith("waypoints[1]: shoulder = 3.1416 is outside [-3.14159, 3.14159]; it was clamped")
    with pytest.raises(InvalidRequest, match=r"shoulder in \[-3.1416, 3.1416\]"):
        service.follow(far)


def test_a_tool_line_begins_where_a_start_is_clamped_to() -> None:
    service = PlannerService("panda", Scene(()))
    start = service.robot.home.copy()
    start[0] = service.robot.limits.upper[0] + 0.004
    result = move_linear(service, start, (0.0, 0.0, -0.02))
    assert result.unwrap()[0].waypoints[0][0] == service.robot.limits.upper[0]
    assert result.notes[0].startswith("start: panda_joint1 = 2.9013 is outside [-2.8973, 2.8973]; it was clamped")


def test_things_that_are_carried_together_are_not_judged_against_each_other_and_the_answer_names_them() -> None:
    tray = Attached("tray", Box((0.2, 0.2, 0.01)), Pose((0.3, 0.0, 0.0)))
    cup = Attached("cup", Box((0.05, 0.05, 0.1)), Pose((0.3, 0.0, 0.055)))  # stands on the tray, to the last bit or not
    service = PlannerService("planar2", Scene((), attached=(tray, cup)))
    result = service.plan(asked(start=(0.0, 0.5), goal=(1.0, 0.4)))
    assert "not judged: tray x cup (carried together)" in str(result)
    second = IndependentChecker(ROOT / "robots" / "planar2", tables_of(service.scene))
    for q in np.random.default_rng(0).uniform(-1.0, 1.0, (100, 2)):
        assert not any({"tray", "cup"} == {contact.a, contact.b} for contact in service.checker.contacts(q))
    assert not any({"tray", "cup"} == set(pair) for pair in second.pairs)


def test_a_carried_thing_is_judged_against_the_link_that_holds_it() -> None:
    held = Attached("held", Box((0.2, 0.2, 0.2)), Pose())
    failure = present(PlannerService("planar2", Scene((), attached=(held,))).plan(asked()).failure)
    assert "held" in failure.detail


def test_what_a_service_allows_to_touch_stands_in_every_answer(discs: PlannerService) -> None:
    pair = ("forearm", "lesson_disc")
    service = PlannerService("planar2", discs.scene, allowed=[pair])
    results = [service.plan(asked()), service.plan(asked(goal=(4.0, 0.0)))]
    assert [result.ok for result in results] == [True, False]
    for result in results:
        assert result.allowed == (pair,)
        assert "not judged: forearm x lesson_disc (allowed by the service)" in str(result)


def test_an_unreachable_pose_says_so(bin_: PlannerService) -> None:
    failure = present(bin_.plan(asked(bin_.robot.home, Pose((2.0, 0.0, 0.2)))).failure)
    assert failure.reason is Reason.NO_IK_SOLUTION
    assert "(2.0000, 0.0000, 0.2000)" in failure.detail


def walled_in() -> PlannerService:
    """The planar arm with its goal at (pi, 0) between two rods closer than any motion: it is boxed in."""
    rods = tuple(
        Obstacle(f"rod_{side}", Box((0.4, 0.02, 0.2)), Pose((-1.3, y, 0.0))) for side, y in (("l", 0.03), ("r", -0.03))
    )
    stop = Obstacle("stop", Box((0.02, 0.2, 0.2)), Pose((-1.53, 0.0, 0.0)))
    return PlannerService("planar2", Scene((*rods, stop)))


def test_a_spent_budget_is_exact_leaves_feasibility_open_and_tells_what_was_in_the_way() -> None:
    service = walled_in()
    result = service.plan(asked(goal=(math.pi, 0.0), max_checks=3000, retries=1, planner=RRTConnect(range=0.5)))
    failure = present(result.failure)
    assert failure.reason is Reason.CHECK_BUDGET_EXHAUSTED
    assert result.counts.states <= 3000
    assert "whether a path exists is unknown" in failure.detail
    assert {name for a, b, _ in failure.blocked_by for name in (a, b)} >= {"forearm", "rod_l"}
    assert sum(share for *_, share in failure.blocked_by) == pytest.approx(1.0)
    assert "at the goal was free: it is boxed in" in failure.detail


def test_a_spent_time_box_says_that_the_clock_decided() -> None:
    result = walled_in().plan(asked(goal=(math.pi, 0.0), time_limit=0.0))
    assert present(result.failure).reason is Reason.TIMED_OUT
    assert not result.deterministic


def test_a_cancelled_call_ends_as_preempted() -> None:
    service, token = walled_in(), CancelToken()
    threading.Timer(0.05, token.cancel).start()
    result = service.plan(asked(goal=(math.pi, 0.0), max_checks=10**8), cancel=token)
    assert present(result.failure).reason is Reason.PREEMPTED
    assert not result.deterministic


def test_a_call_cancelled_while_waiting_for_its_turn_ends_too() -> None:
    service, first, second = walled_in(), CancelToken(), CancelToken()
    long = threading.Thread(
        target=service.plan, args=(asked(goal=(math.pi, 0.0), max_checks=10**8),), kwargs={"cancel": first}
    )
    long.start()
    second.cancel()
    result = service.plan(asked(goal=(0.1, 0.1)), cancel=second)
    first.cancel()
    long.join()
    assert present(result.failure).reason is Reason.PREEMPTED


# -- bad requests ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": (0.0, math.nan)}, r"start: got nan; expected a finite value for elbow"),
        ({"start": (0.0, 0.0, 0.0)}, r"start: got 'shape \(3,\)'; expected 2 joint values"),
        ({"start": "home"}, r"start: got 'home'; expected joint values"),
        ({"start": ["0", "0"]}, r"start: got .*; expected joint values"),
        ({"start": [True, False]}, r"start: got .*; expected joint values"),
        ({"start": [10**400, 0]}, r"start: got .*; expected joint values"),
        ({"padding": 10**400}, r"padding: got 1000.*; expected a number"),
        ({"goal": ()}, r"goal: got .*; expected"),
        ({"goal": [[0.0, 0.0], [0.0, math.inf]]}, r"goal\[1\]: got inf"),
        ({"seed": -1}, r"seed: got -1; expected a whole number"),
        ({"seed": 0.5}, r"seed: got 0.5; expected a whole number"),
        ({"max_checks": 0}, r"max_checks: got 0"),
        ({"time_limit": math.nan}, r"time_limit: got nan"),
        ({"padding": 0.5}, r"padding: got 0.5; expected a number in \[0, 0.1\]"),
        ({"velocity_scale": 0.0}, r"velocity_scale: got 0.0"),
        ({"acceleration_scale": 1.5}, r"acceleration_scale: got 1.5"),
        ({"planner": "rrt"}, r"planner: got 'rrt'; expected a planner such as BalancedRRTConnect\(\)"),
        (
            {"planner": RRTConnect},
            r"planner: got <class .*RRTConnect'>; expected a planner such as BalancedRRTConnect\(\)",
        ),
        ({"timing": "fast"}, r"timing: got 'fast'"),
        ({"timing": Trapezoidal}, r"timing: got <class"),
    ],
)
def test_a_bad_request_names_the_field_the_value_and_what_would_be_right(
    discs: PlannerService, settings: dict[str, object], message: str
) -> None:
    with pytest.raises(InvalidRequest, match=message):
        discs.plan(asked(**settings))


def test_a_service_carried_across_a_fork_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    service = PlannerService("planar2", "discs")
    monkeypatch.setattr(os, "getpid", lambda: -1)
    with pytest.raises(InvalidRequest, match="built before a fork"):
        service.plan(asked())


# -- padding, rest pose, remedies -----------------------------------------------------------------


def test_the_search_keeps_its_padding_and_less_where_an_end_is_closer() -> None:
    near = Obstacle("near", Cylinder(0.1, 0.2), Pose((1.2, 0.1104, 0.0)))  # 0.4 mm beside the stretched arm
    service = PlannerService("planar2", Scene((near,)))
    straight = service.plan(asked(goal=(-1.0, 0.0)))
    assert (straight.attempts, straight.padding) == (0, 0.001)
    assert "closer than 1 mm, as at that end, from s = 0.000 to " in straight.notes[0]
    assert service.plan(asked(start=(-0.5, 0.0), goal=(-1.0, 0.0))).padding == 0.001
    beyond = service.plan(asked(goal=(0.6, 0.0)))
    path, _ = beyond.unwrap()
    assert beyond.padding == 0.001
    assert beyond.near_ends[0].pairs == (("forearm", "near"),)
    roomy = service.checker.variant(padding=0.001)
    assert roomy.path_is_free(JointPath(path.waypoints[1:]))
    assert not roomy.state_is_free(path.waypoints[0])
    assert service.checker.path_is_free(path)


def test_the_way_out_of_sleep_is_exempt_for_its_two_pairs_and_nothing_else(bin_: PlannerService) -> None:
    sleep = bin_.robot.pose("sleep")
    result = bin_.plan(asked(sleep, bin_.robot.home))
    assert result.ok
    assert result.exempt[0].s_start == 0.0
    assert result.exempt[0].s_end == pytest.approx(math.sqrt(2) * 0.08)
    assert result.exempt[0].pairs == (("link_2", "link_5"), ("link_2", "link_4"))
    without = PlannerService(replace(bin_.robot, retreats=()), bin_.scene).plan(asked(sleep, bin_.robot.home))
    assert present(without.failure).reason is Reason.START_IN_COLLISION


def test_the_way_into_sleep_ends_with_the_same_retreat_backwards(bin_: PlannerService) -> None:
    result = bin_.plan(asked(bin_.robot.home, bin_.robot.pose("sleep")))
    path, _ = result.unwrap()
    assert path.waypoints[-1].tolist() == [0.0] * 6
    assert path.waypoints[-2].tolist() == bin_.robot.retreats[0].to.tolist()
    assert result.exempt[0].s_end == path.length


def test_a_way_out_of_a_collision_touches_only_what_it_touched_at_its_start(discs: PlannerService) -> None:
    start = np.array([math.atan2(0.6, 1.1) - 0.1, 0.0])
    out = present(discs.way_out(start))
    assert out.pairs == (("forearm", "lesson_disc"),)
    assert out.path.waypoints[0].tolist() == start.tolist()
    assert discs.checker.state_is_free(out.path.waypoints[-1])


# -- following a given line -----------------------------------------------------------------------


def test_a_given_polyline_is_judged_once_piece_by_piece(discs: PlannerService) -> None:
    points = [(0.0, 0.0), (0.1, -0.1), (0.1, -0.2)]
    result = discs.follow(points)
    samples = sum(discs.checker.segments(a, b) for a, b in pairwise(points))
    assert result.counts - result.stage(Stage.CERTIFY).counts == CheckCounts(states=1 + samples, edges=2)
    assert result.unwrap()[0].waypoints.tolist() == [list(q) for q in points]


def test_a_given_polyline_that_collides_says_where_and_with_what(discs: PlannerService) -> None:
    failure = present(discs.follow([START, GOAL]).failure)
    assert failure.reason is Reason.LINE_BLOCKED
    assert "forearm x lesson_disc" in failure.detail


@pytest.mark.parametrize(("first", "last"), [(0, -1), (2, 0), (0, 5), (-1, 1)])
def test_a_stretch_of_contact_must_lie_on_the_line(discs: PlannerService, first: int, last: int) -> None:
    with pytest.raises(InvalidRequest, match=r"contacts: got 'waypoints .*; expected first and last waypoint in order"):
        discs.follow([START, (0.1, 0.0)], contacts=[AllowedStretch(first, last, (), "test")])


def test_contact_is_allowed_only_on_the_stretch_it_is_meant_for(discs: PlannerService) -> None:
    touching = (math.atan2(0.6, 1.1), 0.0)
    points = [START, touching, (1.3, 0.0)]
    pair = (("forearm", "lesson_disc"),)
    whole = discs.follow(points, contacts=[AllowedStretch(0, 2, pair, "test")])
    half = discs.follow(points, contacts=[AllowedStretch(0, 1, pair, "test")])
    assert whole.ok
    assert whole.exempt[0].s_end == whole.unwrap()[0].length
    assert present(half.failure).reason is Reason.LINE_BLOCKED


# -- determinism ----------------------------------------------------------------------------------

REQUESTS = [asked(seed=seed, goal=goal) for seed in (0, 1, 7) for goal in (GOAL, (-2.0, 1.0), (2.6, -0.4))]


def test_threads_get_what_they_would_have_got_alone(discs: PlannerService) -> None:
    alone = [fingerprint(discs.plan(request)) for request in REQUESTS]
    together: dict[int, str] = {}
    threads = [
        threading.Thread(target=lambda k=k: together.update({k: fingerprint(discs.plan(REQUESTS[k]))}))
        for k in range(len(REQUESTS))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [together[k] for k in range(len(REQUESTS))] == alone


def test_a_service_for_another_scene_keeps_robot_and_settings(discs: PlannerService) -> None:
    other = discs.with_scene(load_scene("empty"))
    assert other.robot is discs.robot
    assert other.checker.edge_step == discs.checker.edge_step
    assert other.plan(asked()).stage(Stage.SEARCH).counts == CheckCounts()


def test_a_robot_may_be_given_as_a_value_or_by_name() -> None:
    assert (
        PlannerService(load_robot("planar2"), load_scene("discs")).robot.hash
        == PlannerService("planar2", "discs").robot.hash
    )
