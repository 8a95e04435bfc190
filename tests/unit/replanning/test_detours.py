"""Where a robot under way may turn off, which goal it turns to, and what looking for something better may cost."""

from __future__ import annotations

import numpy as np
import pytest

from planner_service import BalancedRRTConnect, PlannerService, PlanRequest, PlanResult, Pose, Stage, ToppRa
from planner_service.certify import Certifier
from planner_service.concurrency.polling import Prepared
from planner_service.planning import Pace
from planner_service.planning.accounting import PlanAccounting, PlanContext
from planner_service.replanning import Outcome
from planner_service.replanning.detour import Detours, Place
from planner_service.replanning.splice import SwitchPoint, Underway
from planner_service.scene.scene import Scene
from planner_service.search.problem import SearchResult
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
    request = PlanRequest((0.0, 0.0), goal, padding=PADDING)
    context = PlanContext(request, (np.array(goal),), service.checker, certifier, accounting)
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
    assert roomy <= free
    assert min(place.s for place in everywhere) < stop < max(place.s for place in everywhere)  # slight turns and any
    assert all(place.s > switch.s and place.q.tolist() == [place.s, 0.0] for place in everywhere)


def test_last_it_may_go_straight_beyond_its_old_end_within_its_limits() -> None:
    for goal, count in [((2.4, 0.0), 0), ((2.401, 0.0), 0), ((2.4, 0.5), 2), ((2.4, 3.0), 0)]:
        before = len(turning_off(EMPTY, (2.4, 0.0))[2])
        beyond = turning_off(EMPTY, goal)[2][before:]
        assert len(beyond) == count
        for place in beyond:
            assert 2.4 < place.s < 2.4 + goal[1]
            assert place.q == pytest.approx([place.s, 0.0], abs=1e-12)
            assert (place.waypoint, place.roomy) == (1, False)


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


def test_nor_for_one_on_which_the_robot_arrives_hardly_sooner() -> None:
    for sideways, outcome in [(0.3, Outcome.KEPT), (0.4, Outcome.KEPT), (0.5, Outcome.KEPT), (0.7, Outcome.NEW)]:
        bent = room().follow([[0.0, 0.0], [1.2, sideways], [2.4, 0.0]], pace=Pace(ToppRa()), blends=(0.0, 0.2, 0.0))
        found = room().replan(bent, at_time=0.1, latency=0.02)
        assert found.outcome is outcome
        left = trajectory_of(bent).duration - found.splice
        assert (trajectory_of(found).duration <= 0.97 * left) == (outcome is Outcome.NEW)


def test_looking_for_something_better_than_a_free_motion_takes_a_fifth_of_the_budget() -> None:
    service, most = room().with_scene(disc(1.2)), 100
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
