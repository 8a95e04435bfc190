"""Where a robot under way may turn off, which goal it turns to, and what looking for something better may cost."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from planner_service import (
    BalancedRRTConnect,
    JointPath,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    Stage,
    ToppRa,
)
from planner_service.certify import Certifier
from planner_service.concurrency.polling import Prepared
from planner_service.planning import Pace
from planner_service.planning.accounting import PlanAccounting, PlanContext
from planner_service.planning.endpoints import find_ends
from planner_service.replanning import Outcome
from planner_service.replanning.detour import Detours, Place
from planner_service.replanning.splice import SwitchPoint, Underway
from planner_service.scene.scene import Scene
from planner_service.search.problem import SearchResult
from planner_service.timing.laws import TimingFailed
from tests.support.optional import present
from tests.unit.replanning.test_replan import EMPTY, disc, room, small, swing, trajectory_of

PADDING = 0.02


def turning_off(scene: Scene, goal: tuple[float, float], at: float = 1.0) -> tuple[SwitchPoint, float, list[Place]]:
    """Where the swinging arm may turn off for a goal; before that its switch point, and where it can stop."""
    service = room().with_scene(scene)
    motion = Underway(trajectory_of(swing()), at, at + 0.1)
    switch = next(motion.switch_points())
    stop = motion.stop_from(switch, service.robot.limits)
    accounting = PlanAccounting(service.checker, states=10_000, search_states=10_000)
    certifier = Prepared(lambda: Certifier(service.robot, service.scene))
    context = PlanContext(PlanRequest((0.0, 0.0), goal, padding=PADDING), service.checker, certifier, accounting)
    detours = Detours(context, motion.path, np.zeros((0, 2)))
    return switch, stop, list(detours.places(switch, stop, np.array(goal)))


def keeps(scene: Scene, padding: float, switch: SwitchPoint, s: float) -> bool:
    """Whether the old line is free at 500 places up to s, for an arm that keeps a padding."""
    checker = PlannerService("planar2", scene).checker.variant(padding=padding)
    return bool(checker.states_are_free(np.array([[x, 0.0] for x in np.linspace(switch.s, s, 500)])).all())


@pytest.mark.parametrize("scene", [EMPTY, disc(1.03, away=1.56), disc(1.1, away=1.56), disc(1.06), disc(1.18)])
def test_a_robot_turns_off_first_where_all_of_the_padding_is_kept_and_nowhere_else_than_where_it_is_free(
    scene: Scene,
) -> None:
    switch, stop, everywhere = turning_off(EMPTY, (2.4, 0.0))
    _, _, places = turning_off(scene, (2.4, 0.0))
    free = {place.s for place in everywhere if keeps(scene, 0.0, switch, place.s)}
    roomy = {place.s for place in everywhere if keeps(scene, PADDING, switch, place.s)}
    assert {place.s for place in places} == free
    assert {place.s for place in places if place.roomy} == roomy
    assert [place.roomy for place in places] == [True] * len(roomy) + [False] * (len(free) - len(roomy))
    assert min(place.s for place in everywhere) < stop < max(place.s for place in everywhere)  # slight turns and any
    assert all(place.s > switch.s and place.q.tolist() == [place.s, 0.0] for place in everywhere)


def test_of_these_scenes_some_let_it_turn_off_with_less_padding_or_at_fewer_places() -> None:
    near = [place.roomy for place in turning_off(disc(1.1, away=1.56), (2.4, 0.0))[2]]
    assert set(near) == {True, False}
    blocked = [place.roomy for place in turning_off(disc(1.06), (2.4, 0.0))[2]]
    assert 0 < len(blocked) < len(near)


def test_last_it_may_go_straight_beyond_its_old_end_within_its_limits() -> None:
    for goal, count in [((2.4, 0.0), 0), ((2.401, 0.0), 0), ((2.4, 0.5), 2), ((2.4, 3.0), 0)]:
        before = len(turning_off(EMPTY, (2.4, 0.0))[2])
        beyond = turning_off(EMPTY, goal)[2][before:]
        assert len(beyond) == count
        for place in beyond:
            assert 2.4 < place.s < 2.4 + goal[1]
            assert place.q == pytest.approx([place.s, 0.0], abs=1e-12)
            assert (place.waypoint, place.roomy) == (1, False)


def test_a_robot_that_stands_turns_off_where_it_is() -> None:
    switch, _, places = turning_off(EMPTY, (2.0, 1.0), trajectory_of(swing()).duration - 0.1)
    assert switch.rate == 0.0
    assert [place.s for place in places] == [switch.s] == [2.4]


def test_of_several_goals_the_one_nearest_to_the_old_end_is_turned_to() -> None:
    found = room().replan(swing(), at_time=0.5, goal=[(0.5, 1.0), (2.3, 0.5)])
    assert (found.outcome, found.result.goal_index) == (Outcome.NEW, 1)
    kept = room().replan(swing(), at_time=0.5, goal=[(2.3, 0.5), (2.4, 0.0)])
    assert (kept.outcome, kept.result.goal_index) == (Outcome.KEPT, 1)


@pytest.mark.parametrize(("off", "outcome"), [(5e-7, Outcome.KEPT), (2e-6, Outcome.STOP)])
def test_a_tool_within_a_micrometre_of_a_pose_is_there(off: float, outcome: Outcome) -> None:
    T = room().robot.tool_pose((2.4, 0.0)).copy()
    T[0, 3] += off
    request = small(swing(), max_checks=1)  # not enough to find the pose's configuration
    assert room().replan(swing(), at_time=0.5, goal=Pose.from_matrix(T), request=request).outcome is outcome


def test_a_free_motion_to_another_goal_does_not_go_on_when_the_budget_is_spent() -> None:
    found = room().replan(swing(), at_time=0.5, goal=(2.4, 0.1), request=small(swing(), max_checks=1))
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is Reason.CHECK_BUDGET_EXHAUSTED


def test_a_free_motion_is_not_left_for_a_path_that_is_hardly_shorter() -> None:
    for sideways in [0.02, 0.1, 0.2]:
        bent = room().follow([[0.0, 0.0], [1.2, sideways], [2.4, 0.0]], pace=Pace(ToppRa()), blends=(0.0, 0.2, 0.0))
        found = room().replan(bent, at_time=0.1)
        assert found.outcome is Outcome.KEPT
        assert found.result.notes == ()  # nothing was timed


def test_nor_for_one_on_which_the_robot_arrives_hardly_sooner() -> None:
    for sideways, outcome in [(0.3, Outcome.KEPT), (0.4, Outcome.KEPT), (0.5, Outcome.KEPT), (0.7, Outcome.NEW)]:
        bent = room().follow([[0.0, 0.0], [1.2, sideways], [2.4, 0.0]], pace=Pace(ToppRa()), blends=(0.0, 0.2, 0.0))
        found = room().replan(bent, at_time=0.1, latency=0.02)
        assert found.outcome is outcome
        left = trajectory_of(bent).duration - found.splice
        assert (trajectory_of(found).duration <= 0.97 * left) == (outcome is Outcome.NEW)


@pytest.mark.parametrize("most", [100, 1000])
def test_looking_for_something_better_than_a_free_motion_takes_a_fifth_of_the_budget(most: int) -> None:
    service = room().with_scene(disc(1.2))
    around = service.plan(small(swing()))
    found = service.replan(around, at_time=0.05, request=small(swing(), max_checks=most))
    assert found.outcome is Outcome.KEPT
    assert found.result.notes == ("the old motion goes on: the check budget is spent",)
    of_goals = found.result.stage(Stage.ENDPOINTS).counts.states
    assert most / 5 <= found.counts.states <= most / 5 + of_goals


def test_what_is_left_is_proven_even_if_it_ends_before_the_splice() -> None:
    at = trajectory_of(swing()).duration - 0.05
    found = room().replan(swing(), at_time=at, latency=0.1, scene=disc(2.4, 0.01))
    assert found.outcome is Outcome.UNSAFE
    assert "forearm x disc" in str(found.result.failure)


def test_a_planner_that_does_not_search_gives_way_to_one_that_does() -> None:
    request = small(swing(), planner=Optimise())
    found = room().replan(swing(), at_time=0.5, scene=disc(2.0), request=request)
    assert found.outcome is Outcome.NEW
    assert found.result.stage(Stage.SEARCH).note == BalancedRRTConnect.name


def test_where_the_default_finds_no_way_round_another_algorithm_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BalancedRRTConnect, "search", lambda *_: SearchResult(None))
    found = room().replan(swing(), at_time=0.5, scene=disc(2.0), request=small(swing()))
    assert found.outcome is Outcome.NEW
    assert found.result.stage(Stage.SEARCH).note == "rrtconnect, try 2"
    alone = room().replan(swing(), at_time=0.5, scene=disc(2.0), request=small(swing(), retries=0))
    assert alone.outcome is Outcome.STOP


def follow_line(padding: float = 0.0) -> PlanResult:
    return room().follow([[0.0, 0.0], [2.4, 0.0]], pace=Pace(ToppRa()), padding=padding)


def test_without_a_request_few_states_are_judged_and_the_usual_padding_is_kept() -> None:
    generous = room().plan(small(swing(), max_checks=50_000))
    usual = PlanRequest((), ()).padding
    for old, padding in ((generous, usual), (follow_line(), usual), (follow_line(padding=0.01), 0.01)):
        request = room().replan(old, at_time=0.5).request
        assert (request.max_checks, request.padding) == (20_000, padding)


def test_ten_seconds_of_latency_are_the_most() -> None:
    found = room().replan(swing(), at_time=0.5, latency=10.0)
    assert (found.outcome, found.splice) == (Outcome.KEPT, 10.5)
    assert present(found.path).waypoints.tolist() == JointPath(np.array([[2.4, 0.0]])).waypoints.tolist()


@pytest.mark.parametrize("goal", [(2.4, 0.0), (2.2, 0.9)])
def test_of_a_few_new_motions_the_quickest_is_taken_but_a_good_one_at_once(goal: tuple[float, float]) -> None:
    service, at = room().with_scene(disc(1.8)), 0.3
    request = PlanRequest((0.0, 0.0), goal, seed=1, max_checks=20_000, time_limit=None)
    motion = Underway(trajectory_of(swing()), at, at + 0.1)
    switch, limits = next(motion.switch_points()), service.robot.limits
    accounting = PlanAccounting(service.checker, states=20_000, search_states=20_000)
    certifier = Prepared(lambda: Certifier(service.robot, service.scene))
    context = PlanContext(request, service.checker, certifier, accounting)
    detours, (end, *_) = Detours(context, motion.path, np.zeros((0, 2))), find_ends(context).goals
    times: list[float] = []
    for place in detours.places(switch, motion.stop_from(switch, limits), end.q):
        candidate = present(detours.candidate(switch, place, end))
        with suppress(TimingFailed):
            times.append(motion.onward(candidate.path, switch, ToppRa(), limits)[0].duration)
    found = service.replan(swing(), at_time=at, goal=goal, request=request)
    assert min(times) < times[0]
    good = times[0] <= 1.3 * (motion.trajectory.duration - motion.splice)
    assert good == (goal == (2.2, 0.9))
    assert trajectory_of(found).duration == pytest.approx(times[0] if good else min(times), rel=1e-9)
