"""What leaves the service is blended, proven and timed, or it does not leave."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.checker import IndependentChecker
from benchmarks.worlds import queries
from planner_service import (
    Box,
    CheckCounts,
    CollisionChecker,
    Cylinder,
    InvalidRequest,
    JointPath,
    JointStep,
    MotionStep,
    Obstacle,
    Optimise,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    RRTConnect,
    Scene,
    SCurve,
    Stage,
    ToppRa,
    Trapezoidal,
    load_robot,
)
from planner_service.collision.budget import TimeBoxSpent
from planner_service.geometry.arrays import FloatArray
from planner_service.kinematics.tool_speed import peak_tool_speed, tool_speeds
from planner_service.planning import AllowedStretch, Pace, pipeline
from planner_service.planning.accounting import certified_path, timed
from planner_service.search.problem import SearchProblem, SearchResult
from tests.support.optional import present
from tests.support.refusals import refused_pair

START, GOAL = (0.0, 0.0), (math.pi / 2, -math.pi / 2)
ROOT = Path(__file__).parents[3]
COARSE = JointStep(0.6)
"""Samples so far apart that the arm passes a thin post between two of them."""


def thin_post(angle: float) -> Obstacle:
    x, y = 1.2 * math.cos(angle), 1.2 * math.sin(angle)
    return Obstacle("post", Cylinder(0.002, 0.2), Pose((x, y, 0.0)))


def asked(start: object = START, goal: object = GOAL, **settings: object) -> PlanRequest:
    return PlanRequest(**{"start": start, "goal": goal, "time_limit": None, **settings})  # type: ignore[arg-type]


def is_free(service: PlannerService, path: JointPath) -> bool:
    """Of the planar arm's path, at samples that leave less than a tenth of a millimetre of motion between them."""
    checker = CollisionChecker(service.robot, service.scene, edge_step=JointStep(5e-5))
    return all(map(checker.state_is_free, path(np.linspace(0.0, path.length, 1 + math.ceil(path.length / 5e-5)))))


class GivenPaths:
    """A planner that answers with one given path after the other, the last for ever."""

    name = "given"
    patience = None

    def __init__(self, *paths: list[tuple[float, float]]) -> None:
        self._paths = list(paths)
        self.judges: list[CollisionChecker] = []

    @property
    def asked(self) -> int:
        """How often."""
        return len(self.judges)

    def search(self, problem: SearchProblem) -> SearchResult:
        path = self._paths[min(self.asked, len(self._paths) - 1)]
        self.judges.append(problem.oracle._checker)  # type: ignore[attr-defined]
        return SearchResult(np.array(path))


# -- proven ---------------------------------------------------------------------------------------


def test_a_plan_comes_with_its_proof_and_what_that_cost(discs: PlannerService) -> None:
    result = discs.plan(asked())
    assert result.certificate is not None
    assert result.certificate.certified
    assert result.certificate.clearance > 0.0
    assert result.stage(Stage.CERTIFY).counts.distances == result.certificate.distances > 0
    assert result.counts.distances == result.certificate.distances
    assert is_free(discs, result.unwrap()[0])


@pytest.mark.slow
@pytest.mark.parametrize("angle", np.linspace(0.3, 1.2, 7).tolist())
def test_what_samples_miss_the_proof_does_not(angle: float) -> None:
    service = PlannerService("planar2", Scene((thin_post(angle),)), edge_step=COARSE)
    goal = (1.5, 0.0)
    assert service.checker.edge_is_free(START, goal), "or this tests nothing"
    result = service.plan(asked(goal=goal))
    if result.failure is None:
        assert is_free(service, result.unwrap()[0])
        assert any(note.startswith("searched again") for note in result.notes)
    else:
        assert result.failure.reason is Reason.NOT_CERTIFIED
        assert "post" in result.failure.detail


def test_a_path_that_cannot_be_proven_is_searched_again_and_the_proven_one_leaves() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    around = [START, (0.0, 2.8), (1.5, 2.8), (1.5, 0.0)]
    planner = GivenPaths([START, (1.5, 0.0)], around)
    result = service.plan(asked(goal=(1.5, 0.0), planner=planner))
    assert planner.asked == 2
    assert is_free(service, result.unwrap()[0])
    assert any("searched again" in note and "post" in note for note in result.notes)


def test_what_is_searched_again_is_sampled_as_closely_as_it_is_padded() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    planner = GivenPaths([START, (1.5, 0.0)])
    result = service.plan(asked(goal=(1.5, 0.0), planner=planner, padding=0.001))
    assert [judge.padding for judge in planner.judges] == [0.003, 0.001]
    for judge in planner.judges:
        assert 0.3 * service.robot.reach()[0] / judge.segments((0.0, 0.0), (0.3, 0.0)) <= judge.padding
    assert result.padding == 0.001
    assert result.attempts == 2
    assert present(result.certificate).refusal is not None


def test_a_finer_step_than_the_padding_is_kept_when_searching_again() -> None:
    checker = PlannerService("planar2", "empty", edge_step=MotionStep(0.0005)).checker
    assert checker.variant(padding=0.01, motion_step=0.01).segments(START, (0.3, 0.0)) == checker.segments(
        START, (0.3, 0.0)
    )


def test_a_path_that_can_never_be_proven_does_not_leave() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    planner = GivenPaths([START, (1.5, 0.0)])
    failure = present(service.plan(asked(goal=(1.5, 0.0), planner=planner)).failure)
    assert (failure.stage, failure.reason) == (Stage.CERTIFY, Reason.NOT_CERTIFIED)
    assert "x post is not proven apart" in failure.detail
    assert planner.asked == 2


def test_a_given_polyline_that_samples_pass_is_refused_by_the_proof() -> None:
    service = PlannerService("planar2", Scene((thin_post(0.75),)), edge_step=COARSE)
    failure = present(service.follow([START, (1.5, 0.0)]).failure)
    assert (failure.stage, failure.reason) == (Stage.CERTIFY, Reason.NOT_CERTIFIED)


def test_standing_still_is_proven_too(discs: PlannerService) -> None:
    result = discs.plan(asked(goal=START))
    assert present(result.certificate).certified
    assert "nothing to do" in result.notes[0]
    assert result.motion is not None
    assert (result.motion.duration, result.motion.tool_speed, result.motion.settle_time) == (0.0, 0.0, 0.0)


def test_a_path_from_anywhere_is_proven_or_refused_with_pair_and_place(discs: PlannerService) -> None:
    assert discs.certify([[0.0, 0.0], [0.3, -0.3]]).certified
    refused = discs.certify([START, GOAL])
    refusal = refused_pair(refused)
    assert "forearm" in (refusal.a, refusal.b)
    assert 0.0 <= refusal.s_start < refusal.s_end <= JointPath(np.array([START, GOAL])).length


# -- blended --------------------------------------------------------------------------------------


def test_corners_are_blended_and_blends_cost_states_of_their_own(discs: PlannerService) -> None:
    sharp, smooth = discs.plan(asked(blend=0.0)), discs.plan(asked())
    assert len(sharp.unwrap()[0].corners) > 0
    assert smooth.unwrap()[0].corners == ()
    assert sharp.stage(Stage.POLISH).counts.states < smooth.stage(Stage.POLISH).counts.states
    assert sharp.stage(Stage.SHORTCUT).counts == smooth.stage(Stage.SHORTCUT).counts


@pytest.mark.parametrize("timing", [ToppRa(), SCurve(), Trapezoidal()], ids=lambda law: law.name)
def test_blends_make_every_law_faster(timing: Any) -> None:
    service = PlannerService("wxai", "shelf")
    for query in queries.load("shelf")[:4]:
        motion = present(service.plan(asked(query.start, query.goal, timing=timing)).motion)
        assert motion.duration < motion.stop_duration


def test_blends_that_samples_wrongly_call_free_are_narrowed_until_they_are_proven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    service, query = PlannerService("wxai", "post"), queries.load("post")[3]
    second = IndependentChecker(ROOT / "robots" / "wxai", ROOT / "scenes" / "post.toml")

    def hopeful(path: JointPath, oracle: Any, sizes: FloatArray) -> JointPath:
        pieces = np.diff(path.knots)
        inner = np.minimum(sizes[1:-1], 0.499 * np.minimum(pieces[:-1], pieces[1:]))
        return path.with_blends([0.0, *(inner * [k in path.corners for k in range(1, len(sizes) - 1)]), 0.0])

    monkeypatch.setattr(pipeline, "blended", hopeful)
    result = service.plan(asked(query.start, query.goal, seed=query.number))
    path = result.unwrap()[0]
    assert result.stage(Stage.CERTIFY).counts.distances > present(result.certificate).distances, (
        "or nothing was refused"
    )
    lengths = np.diff(path.knots)
    widest = np.minimum(0.5, 0.499 * np.minimum(lengths[:-1], lengths[1:]))
    assert np.any(path.blends[1:-1] < 0.9 * widest)
    assert all(map(second.free, path(np.linspace(0.0, path.length, 3000))))


def test_a_proven_plan_is_kept_when_a_limit_ends_the_look_at_its_stops(
    discs: PlannerService, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = timed

    def slower(*arguments: Any) -> Any:
        trajectory, motion = measured(*arguments)
        return trajectory, replace(motion, stop_duration=0.0)

    monkeypatch.setattr("planner_service.planning.pipeline.timed", slower)
    stopped = discs.plan(asked())
    assert stopped.unwrap()[0].blended.any(), "stops that are not really faster are not taken"
    calls: list[int] = []

    def spent(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) > 1:
            raise TimeBoxSpent("the time limit passed")
        return certified_path(*arguments)

    monkeypatch.setattr("planner_service.planning.pipeline.certified_path", spent)
    assert discs.plan(asked()).ok
    assert len(calls) == 2


def test_stages_are_logged_for_debugging_and_retries_as_information(
    discs: PlannerService, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, logger="planner_service")
    result = discs.plan(asked(planner=RRTConnect(range=0.01), max_checks=3000, time_limit=None))
    logged = [(record.levelno, record.message.split(":")[0]) for record in caplog.records]
    stages = [name for level, name in logged if level == logging.DEBUG]
    assert list(dict.fromkeys(stages)) == [report.stage.value for report in result.stages]
    retries = [name for level, name in logged if level == logging.INFO]
    assert retries == [f"attempt {k}" for k in range(2, result.attempts + 1)] != []


def test_a_search_that_gives_up_says_what_was_most_in_the_way(discs: PlannerService) -> None:
    failure = present(discs.plan(asked(max_checks=100)).failure)
    assert "; whether a path exists is unknown (no proof that there is none in " in failure.detail
    assert failure.detail.endswith("; most in the way: forearm x lesson_disc (100%)")


def test_the_corner_where_a_way_out_ends_is_no_blend() -> None:
    service = PlannerService("wxai", "table")
    sleep, to = service.robot.pose("sleep"), service.robot.retreats[0].to
    path, _ = service.plan(asked(sleep, service.robot.pose("ready"))).unwrap()
    assert path.waypoints[1].tolist() == to.tolist()
    assert path.blends[1] == 0.0


def test_only_the_fixed_ways_out_of_a_pose_and_into_it_are_exempt() -> None:
    wxai = load_robot("wxai")
    (way,) = wxai.retreats
    turned = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not wxai.pose("sleep").any()
    away = replace(way, to=way.to + turned)
    robot = replace(wxai, named_poses=(("home", wxai.home), ("sleep", turned)), retreats=(away,))
    service, length = PlannerService(robot, Scene(())), 0.08 * math.sqrt(2.0)
    out, back = service.plan(asked(turned + 1e-7, robot.home)), service.plan(asked(robot.home, turned))
    assert np.array([(e.s_start, e.s_end) for e in out.exempt]) == pytest.approx(np.array([[0.0, length]]), abs=1e-6)
    assert out.notes == ("taken for the pose 'sleep', 1.0e-07 rad away",)
    end = back.unwrap()[0].length
    assert np.array([(e.s_start, e.s_end) for e in back.exempt]) == pytest.approx(np.array([[end - length, end]]))


# -- timed ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("timing", [ToppRa(), SCurve(), Trapezoidal()], ids=lambda law: law.name)
def test_the_tool_is_no_faster_than_it_may_be(discs: PlannerService, timing: Any) -> None:
    free = discs.plan(asked(timing=timing))
    slow = discs.plan(asked(timing=timing, max_tool_speed=0.25))
    assert present(free.motion).tool_speed > 0.3
    trajectory = slow.unwrap()[1]
    t = np.linspace(0.0, trajectory.duration, 40_001)
    tips = np.array([discs.robot.tool_pose(q)[:3, 3] for q in trajectory(t)])
    speeds = np.sqrt((np.diff(tips, axis=0) ** 2).sum(axis=1)) / np.diff(t)
    assert speeds.max() <= 0.25 * (1 + 1e-9)
    assert speeds.max() == pytest.approx(present(slow.motion).tool_speed, rel=1e-4)
    assert present(slow.motion).tool_speed > 0.24, "as fast as it may be somewhere"
    assert trajectory.duration > present(free.motion).duration


@pytest.mark.parametrize(("name", "joint"), [("wxai", 5), ("wxai_dual", 11)])
def test_a_joint_that_leaves_the_tool_where_it_is_is_planned_at_no_tool_speed(name: str, joint: int) -> None:
    robot = load_robot(name)
    goal = robot.home.copy()
    goal[joint] += 0.3
    result = PlannerService(robot, Scene()).plan(asked(robot.home, goal, max_tool_speed=0.1))
    assert present(result.motion).tool_speed == 0.0
    assert present(result.motion).duration > 0.1


@pytest.mark.slow
def test_peak_tool_speed_is_that_of_the_densest_samples() -> None:
    robot = load_robot("wxai")
    points = np.random.default_rng(3).uniform(robot.limits.lower, robot.limits.upper, (4, 6))
    trajectory = SCurve().time_path(JointPath(points), robot.limits)
    t = np.linspace(0.0, trajectory.duration, 20_001)
    q, qd = trajectory(t), trajectory(t, 1)
    speeds = [np.linalg.norm(robot.tool_jacobian(a)[:3] @ b) for a, b in zip(q, qd, strict=True)]
    found = peak_tool_speed(robot, trajectory)
    assert max(speeds) * (1 - 1e-12) <= found <= max(speeds) * (1 + 1e-5)


@pytest.mark.parametrize("jerk", [5.0, 50.0, 5000.0])
def test_peaks_are_measured_against_the_jerk_that_the_law_holds(discs: PlannerService, jerk: float) -> None:
    for scale in (1.0, 0.5):
        motion = present(discs.plan(asked(timing=SCurve(jerk=jerk), acceleration_scale=scale)).motion)
        assert 0.5 < motion.peaks.jerk.ratio <= 1 + 1e-9


def test_a_slow_tool_is_as_slow_as_it_must_be_everywhere() -> None:
    service, query = PlannerService("wxai", "shelf"), queries.load("shelf")[1]
    result = service.plan(asked(query.start, query.goal, max_tool_speed=0.05))
    trajectory = result.unwrap()[1]
    t = np.linspace(0.0, trajectory.duration, 30_001)
    assert tool_speeds(service.robot, trajectory(t), trajectory(t, 1)).max() <= 0.05 * (1 + 1e-6)


def test_a_result_says_how_its_motion_compares(discs: PlannerService) -> None:
    result = discs.plan(asked(timing=SCurve(), velocity_scale=0.5))
    motion, trajectory = result.motion, result.unwrap()[1]
    assert motion is not None
    assert motion.duration == trajectory.duration
    assert motion.settle_time == discs.robot.settle_time
    assert max(motion.peaks.velocity.ratio, motion.peaks.acceleration.ratio, motion.peaks.jerk.ratio) <= 1 + 1e-9
    t = np.linspace(0.0, trajectory.duration, 5001)
    assert np.abs(trajectory(t, 1)).max() <= 0.5 * discs.robot.limits.velocity.max() * (1 + 1e-9)


def test_an_impossible_blend_or_tool_speed_is_refused() -> None:
    for field, value in [
        ("blend", -0.1),
        ("blend", math.nan),
        ("blend", "wide"),
        ("max_tool_speed", 0.0),
        ("max_tool_speed", math.inf),
        ("max_tool_speed", "fast"),
    ]:
        with pytest.raises(InvalidRequest, match=field):
            asked(**{field: value})


def test_the_pace_of_a_given_polyline_is_held(discs: PlannerService) -> None:
    result = discs.follow([[0.0, 0.0], [0.3, -0.3]], pace=Pace(SCurve(), max_tool_speed=0.1))
    assert 0.09 < present(result.motion).tool_speed <= 0.1
    with pytest.raises(InvalidRequest, match="velocity_scale"):
        Pace(SCurve(), velocity_scale=0.0)
    with pytest.raises(InvalidRequest, match="timing: got 'toppra'"):
        Pace("toppra")  # type: ignore[arg-type]


def test_corners_pulled_in_too_far_to_be_proven_go_back_before_anything_is_searched_again() -> None:
    service, query = PlannerService("wxai", "bin", edge_step=JointStep(0.05)), queries.load("bin")[9]
    result = service.plan(asked(query.start, query.goal, seed=query.number))
    assert [note for note in result.notes if note.startswith("corners put back where they were: link_6 x demo_post")]
    assert result.ok
    assert result.attempts == 1


# -- given polylines -------------------------------------------------------------------------------


BEND = [(0.0, 0.0), (-0.5, 0.0), (-0.5, -0.5)]


def test_a_given_polyline_is_blended_where_that_is_asked_and_free(discs: PlannerService) -> None:
    plain, smooth = discs.follow(BEND), discs.follow(BEND, blends=[0.0, 0.2, 0.0])
    assert plain.unwrap()[0].corners == (1,)
    assert smooth.unwrap()[0].blends.tolist() == [0.0, 0.2, 0.0]
    assert smooth.stage(Stage.POLISH).counts.states > 0
    assert smooth.unwrap()[1].duration < plain.unwrap()[1].duration


def test_contact_that_is_meant_on_one_side_of_a_corner_is_not_meant_on_its_blend(discs: PlannerService) -> None:
    tip = discs.robot.tool_pose(np.array([-0.6, -0.2]))[:3, 3].tolist()
    pin = Obstacle("pin", Cylinder(0.02, 0.2), Pose((tip[0], tip[1], tip[2])))
    service = PlannerService("planar2", Scene((pin,)))
    line = [(-0.2, -0.2), (-0.55, -0.2), (-0.7, -0.05)]
    contact = AllowedStretch(1, 2, (("forearm", "pin"),), "it is pushed")
    result = service.follow(line, contacts=[contact], blends=[0.0, 0.1, 0.0])
    first, second = (service.follow(part).failure for part in (line[:2], line[1:]))
    assert first is None
    assert second is not None
    blend = JointPath(np.array(line), np.array([0.0, 0.1, 0.0]))
    assert not service.checker.blend_is_free(blend, 1), "or this tests nothing"
    assert result.unwrap()[0].blends[1] < 0.1
    assert result.exempt[0].s_start == pytest.approx(0.35)


def test_where_a_given_polyline_collides_is_said(discs: PlannerService) -> None:
    inside = (math.atan2(0.6, 1.1), 0.0)
    out, into = (present(discs.follow(points).failure) for points in ([inside, START], [START, inside]))
    assert (out.reason, into.reason) == (Reason.START_IN_COLLISION, Reason.LINE_BLOCKED)
    assert out.detail.startswith("start in collision: forearm x lesson_disc")


def test_waypoints_that_coincide_leave_corners_as_stops(discs: PlannerService) -> None:
    again = [BEND[0], BEND[0], *BEND[1:]]
    path, _ = discs.follow(again, blends=[0.0, 0.0, 0.2, 0.0]).unwrap()
    assert path.corners == (1,)
    straight = [BEND[0], BEND[1]]
    with pytest.raises(InvalidRequest, match="blends"):
        discs.follow(straight, blends=[0.0, math.nan])


@pytest.mark.parametrize(
    ("field", "value"),
    [("contacts", None), ("contacts", [None]), ("contacts", 5), ("pace", 5), ("pace", ToppRa())],
)
def test_a_given_polyline_with_something_else_for_contacts_or_pace_is_refused(
    discs: PlannerService, field: str, value: Any
) -> None:
    with pytest.raises(InvalidRequest, match=field):
        discs.follow(BEND, **{field: value})


def test_an_impossible_stretch_of_contact_is_refused() -> None:
    values: Any
    for values in [(0.5, 1, ()), ("0", 1, ()), (0, 1, None), (0, 1, (("a",),))]:
        with pytest.raises(InvalidRequest, match=r"^(first|pairs): got"):
            AllowedStretch(values[0], values[1], values[2], "because")


def test_a_corner_that_would_need_a_narrower_blend_than_the_least_is_a_stop(discs: PlannerService) -> None:
    assert discs.follow(BEND, blends=[0.0, 0.005, 0.0]).unwrap()[0].blends[1] == 0.0
    assert discs.follow(BEND, blends=[0.0, 0.005, 0.0], min_blend=0.001).unwrap()[0].blends[1] == 0.005
    with pytest.raises(InvalidRequest, match=r"min_blend: got 0.0; expected radians in \[1e-6, 1\]"):
        discs.follow(BEND, min_blend=0.0)


@pytest.mark.parametrize("blends", [[0.0, 0.1], [0.0, -0.1, 0.0], [0.0, math.nan, 0.0], "wide"])
def test_impossible_blends_of_a_given_polyline_are_refused(discs: PlannerService, blends: Any) -> None:
    with pytest.raises(InvalidRequest, match="blends"):
        discs.follow(BEND, blends=blends)


# -- bad paths ------------------------------------------------------------------------------------


@pytest.mark.parametrize("timing", [ToppRa(), SCurve(), Trapezoidal()], ids=lambda law: law.name)
def test_repeated_waypoints_on_a_line_cost_no_time(discs: PlannerService, timing: Any) -> None:
    for gap in [1e-12, 1e-9, 1e-6, 1e-4, 1e-3]:
        plain = discs.follow([[0.0, 0.0], [-1.0, 0.5]], pace=Pace(timing)).unwrap()[1].duration
        middle = np.array([-0.5, 0.25])
        again = middle + gap * np.array([-1.0, 0.5]) / math.hypot(1.0, 0.5)
        result: PlanResult = discs.follow(np.array([[0.0, 0.0], middle, again, [-1.0, 0.5]]), pace=Pace(timing))
        assert result.unwrap()[1].duration == pytest.approx(plain, rel=5e-3)


def test_a_path_that_turns_back_stops_there(discs: PlannerService) -> None:
    there = discs.follow([[0.0, 0.0], [-0.5, 0.0]]).unwrap()[1].duration
    result = discs.follow([[0.0, 0.0], [-0.5, 0.0], [0.0, 0.0]])
    assert result.unwrap()[1].duration == pytest.approx(2 * there)
    assert present(result.certificate).certified


def test_an_optimisation_instead_of_a_search_is_not_asked_about_a_free_line_and_does_not_search_about_another() -> None:
    request = asked((0.0, 0.0), (2.4, 0.0), planner=Optimise())
    free = PlannerService("planar2", Scene(())).plan(request)
    assert free.ok
    assert free.stage(Stage.SEARCH).counts == CheckCounts()
    blocked = PlannerService("planar2", Scene((thin_post(1.2),))).plan(request)
    assert blocked.ok or present(blocked.failure).reason is Reason.OPTIMUM_IN_COLLISION
    assert blocked.stage(Stage.SEARCH).counts.states > 0


@pytest.mark.parametrize(("gap", "reason"), [(1.5e-6, Reason.NOT_CERTIFIED), (2.5e-6, None)])
def test_an_end_nearer_than_can_be_proven_is_refused_before_any_search(gap: float, reason: Reason | None) -> None:
    width = 0.01
    wall = Obstacle("wall", Box((0.2, 0.02, 0.2)), Pose((1.2, width + 0.01 + gap, 0.0)))
    service = PlannerService("planar2", Scene((wall,)))
    result = service.plan(asked(goal=(0.0, 0.0), start=(-1.0, 0.0)))
    assert CollisionChecker(service.robot, service.scene).state_is_free((0.0, 0.0))
    assert (result.failure and result.failure.reason) == reason
    if result.failure is not None:
        assert result.failure.stage is Stage.ENDPOINTS
        assert "no gap of more than 0.002 mm is proven" in result.failure.detail
