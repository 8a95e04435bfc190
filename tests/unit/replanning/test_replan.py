"""Replanning: no jump at the splice, what is returned is proven in the new scene, and faults planted there are told."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.studies import replan as measure
from benchmarks.worlds import queries
from planner_service import (
    CancelToken,
    CheckCounts,
    Cylinder,
    InvalidRequest,
    JointPath,
    JointStep,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Reason,
    SCurve,
    Stage,
    ToppRa,
    Trajectory,
    Trapezoidal,
    load_scene,
    save_scene,
)
from planner_service.certify import Certifier
from planner_service.cli.commands import app
from planner_service.planning import AllowedStretch, Pace
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan
from planner_service.records.result import ResultRecord, result_record
from planner_service.replanning import Outcome, Replanned
from planner_service.replanning.splice import HOLD, Underway
from planner_service.scene.scene import Scene
from planner_service.timing.limit_check import peaks
from tests.support.optional import present

EMPTY = Scene(())
BENT = np.array([[0.0, 0.0], [1.0, 0.2], [1.6, 1.0], [2.4, 1.0]])
WIDE = (0.0, 0.4, 0.3, 0.0)
LATENCY = 0.1

NO_JUMP = 1e-12
"""Of position, velocity and acceleration at a splice: rounding, some units of the last place of numbers like 3."""


@cache
def room() -> PlannerService:
    return PlannerService("planar2", EMPTY)


@cache
def swing() -> PlanResult:
    """A straight motion, the arm stretched out."""
    return room().plan(PlanRequest((0.0, 0.0), (2.4, 0.0), time_limit=None))


@cache
def curved() -> PlanResult:
    """A motion over two wide blends."""
    return room().follow(BENT, pace=Pace(ToppRa()), blends=WIDE)


def disc(angle: float, radius: float = 0.05, *, away: float = 1.4) -> Scene:
    """A disc in the way of the stretched arm."""
    place = (away * math.cos(angle), away * math.sin(angle), 0.0)
    return Scene((Obstacle("disc", Cylinder(radius, 0.2), Pose(place)),))


def trajectory_of(motion: PlanResult | Replanned) -> Trajectory:
    return present(motion.trajectory)


def jumps(old: PlanResult, new: Replanned) -> list[float]:
    """Of q, qd and qdd at the splice."""
    before, after = trajectory_of(old), trajectory_of(new)
    return [float(np.abs(before(new.splice, order) - after(0.0, order)).max()) for order in range(3)]


def touching(motion: Trajectory, scene: Scene) -> int:
    """How many of its samples every 2 ms collide."""
    return int((~PlannerService("planar2", scene).checker.states_are_free(motion.sample(0.002).q)).sum())


# -- the splice -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9])
@pytest.mark.parametrize("goal", [None, (2.2, 0.9), (2.5, 1.3)])
def test_position_velocity_and_acceleration_go_on_at_the_splice(share: float, goal: Any) -> None:
    at = share * trajectory_of(curved()).duration
    found = room().replan(curved(), at_time=at, latency=LATENCY, goal=goal)
    assert found.outcome in (Outcome.KEPT, Outcome.NEW)
    assert max(jumps(curved(), found)) <= NO_JUMP


def test_splices_in_a_blend_and_on_a_straight_stretch_were_among_them() -> None:
    motion = trajectory_of(curved())
    path = motion.path
    times = [share * motion.duration + LATENCY for share in (0.1, 0.25, 0.4, 0.5, 0.6, 0.75)]
    assert set(path.blended[path.pieces_at(motion.s(times))].tolist()) == {False, True}


@pytest.mark.parametrize("law", [Trapezoidal(), SCurve(), SCurve(jerk=4.0), ToppRa()])
def test_the_old_motion_may_be_under_any_law(law: Any) -> None:
    old = room().follow(BENT, pace=Pace(law), blends=WIDE)
    for share in (0.05, 0.2, 0.5, 0.7):
        found = room().replan(old, at_time=share * trajectory_of(old).duration, goal=(2.3, 1.2))
        assert found.outcome is Outcome.NEW
        assert max(jumps(old, found)) <= NO_JUMP


def test_a_new_motion_holds_the_limits_at_a_thousand_instants_too() -> None:
    found = room().replan(curved(), at_time=0.9, goal=(2.2, 0.6))
    told = present(found.result.motion).peaks
    assert max(told.velocity.ratio, told.acceleration.ratio) <= 1.0 + 1e-9
    motion, limits = trajectory_of(found), room().robot.limits
    t = np.linspace(0.0, motion.duration, 1000)
    assert (np.abs(motion(t, 1)) <= limits.velocity * (1.0 + 1e-9)).all()
    assert (np.abs(motion(t, 2)) <= limits.acceleration * (1.0 + 1e-9)).all()


def test_a_new_motion_is_not_stopped_before_its_goal() -> None:
    found = trajectory_of(room().replan(curved(), at_time=0.8, goal=(2.3, 1.3)))
    speeds = found.s(np.linspace(0.0, found.duration - 0.05, 500), 1)
    assert speeds.min() > 0.05


def test_a_new_motion_ends_at_rest_at_the_goal_to_the_last_bit() -> None:
    goal = (2.25, 0.875)
    found = trajectory_of(room().replan(curved(), at_time=0.8, goal=goal))
    assert found(found.duration).tolist() == list(goal)
    assert found(found.duration, 1).tolist() == [0.0, 0.0]


def test_before_the_splice_the_new_path_is_the_old_one() -> None:
    found = room().replan(curved(), at_time=0.7, goal=(2.25, 0.875))
    old, new = trajectory_of(curved()), trajectory_of(found)
    shift = float(old.s(found.splice)) - new.begin
    s = np.linspace(float(old.s(0.7)), float(old.s(found.splice)), 50)
    assert np.abs(old.path(s) - present(found.path)(s - shift)).max() <= NO_JUMP


def test_twenty_steps_in_a_row_after_a_goal_that_moves_are_one_smooth_motion() -> None:
    old: PlanResult | Replanned = room().plan(PlanRequest((0.0, 0.0), (1.5, 0.8), time_limit=None))
    for step in range(20):
        new = room().replan(old, at_time=0.0, latency=LATENCY, goal=(1.5 + 0.02 * step, 0.8 - 0.03 * step))
        assert new.outcome in (Outcome.NEW, Outcome.KEPT)
        before, after = trajectory_of(old), trajectory_of(new)
        assert max(float(np.abs(before(LATENCY, k) - after(0.0, k)).max()) for k in range(3)) <= NO_JUMP
        assert after.s(np.linspace(0.0, LATENCY, 50), 1).min() > 0.0 or step == 0
        old = new


@pytest.mark.slow
def test_a_tool_follows_a_goal_that_wanders_and_stops_at_most_once() -> None:
    service = PlannerService("wxai", "post")
    setting = present(measure.wandering_goal(service, queries.load("post")[2]))
    told = measure.drive(service, *setting, steps=40)
    assert told.stops <= 1
    assert told.uncertified == told.touching == 0
    assert max(told.jumps) <= 1e-11


@pytest.mark.slow
def test_a_goal_that_creeps_along_is_followed_without_a_stop() -> None:
    old: PlanResult | Replanned = room().plan(PlanRequest((0.0, 0.0), (0.3, 0.2), time_limit=None))
    for step in range(1, 25):
        old = room().replan(old, at_time=0.0, latency=LATENCY, goal=(0.3 + 0.03 * step, 0.2 + 0.02 * math.sin(step)))
        assert trajectory_of(old).s(np.linspace(0.0, LATENCY, 50), 1).min() > 0.0 or step == 1


# -- what is in the way ---------------------------------------------------------------------------


def test_a_free_motion_goes_on_as_it_was() -> None:
    found = room().replan(swing(), at_time=1.0, scene=disc(-1.0))
    assert found.outcome is Outcome.KEPT
    old, new = trajectory_of(swing()), trajectory_of(found)
    t = np.linspace(0.0, new.duration, 50)
    assert np.abs(new(t) - old(np.minimum(t + found.splice, old.duration))).max() <= NO_JUMP
    assert new.duration == pytest.approx(old.duration - found.splice, abs=1e-12)


def test_an_obstacle_put_onto_the_rest_of_the_path_is_driven_around() -> None:
    scene = disc(2.0)
    assert touching(trajectory_of(swing()), scene) > 0
    found = room().replan(swing(), at_time=0.5, scene=scene)
    assert found.outcome is Outcome.NEW
    assert found.failure is None
    motion = trajectory_of(found)
    assert touching(motion, scene) == 0
    assert motion(motion.duration).tolist() == [2.4, 0.0]
    assert max(jumps(swing(), found)) <= NO_JUMP


def test_what_is_proven_begins_where_the_robot_is_and_ends_with_the_motion() -> None:
    found = room().replan(swing(), at_time=0.5, scene=disc(2.0))
    assert found.certificate is not None
    assert found.certificate.certified
    assert found.path is not None
    part = present(found.certificate.part)
    assert found.path(part[0]) == pytest.approx(trajectory_of(swing())(0.5), abs=1e-12)
    assert part[1] == trajectory_of(found).end == found.path.length
    again = Certifier(room().robot, disc(2.0)).certify(found.path, part=part)
    assert again == found.certificate


def test_without_a_way_the_robot_stops_along_the_old_curve() -> None:
    scene = disc(2.4)
    found = room().replan(swing(), at_time=0.5, scene=scene)
    assert found.outcome is Outcome.STOP
    assert found.ok
    assert present(found.failure).reason is Reason.GOAL_IN_COLLISION
    assert present(found.certificate).certified
    assert max(jumps(swing(), found)) <= NO_JUMP
    motion = trajectory_of(found)
    assert touching(motion, scene) == 0
    assert np.abs(motion.sample(0.01).q[:, 1]).max() == 0.0  # on the old line


def test_a_stop_on_a_straight_line_is_the_quickest_there_is() -> None:
    found = room().replan(swing(), at_time=1.0, scene=disc(2.4))
    old, limits = trajectory_of(swing()), room().robot.limits
    speed = old(found.splice + HOLD, 1)[0]
    assert trajectory_of(found).duration == pytest.approx(HOLD + speed / limits.acceleration[0], rel=1e-9)


def test_a_stop_in_a_blend_ends_there_within_the_limits() -> None:
    old, path = trajectory_of(curved()), trajectory_of(curved()).path
    t = np.linspace(0.0, old.duration, 2000)
    blended = path.blended[path.pieces_at(old.s(t))]
    at = float(t[int(blended.argmax())]) - LATENCY + 0.02
    found = Underway(old, at, at + LATENCY).braked(room().robot.limits)
    ratios = peaks(found, room().robot.limits)
    assert max(ratios.velocity.ratio, ratios.acceleration.ratio) <= 1.0 + 1e-9
    assert bool(found.path.blended[found.path.pieces_at(np.array([found.begin]))[0]])
    assert found.s(found.duration, 1) == 0.0
    assert found.duration < 0.9 * (old.duration - at - LATENCY)


def test_a_robot_that_is_faster_than_asked_stops_within_its_own_limits() -> None:
    scene = disc(2.4)
    found = room().replan(swing(), at_time=1.0, scene=scene, request=small(swing(), velocity_scale=0.3))
    assert found.outcome is Outcome.STOP
    assert trajectory_of(found).duration == trajectory_of(room().replan(swing(), at_time=1.0, scene=scene)).duration
    assert found.result.notes[-1].startswith("beyond the limits asked: velocity 333%")


@pytest.mark.slow
def test_a_stop_is_as_gentle_as_asked_where_that_is_safe() -> None:
    request = PlanRequest((0.0, 0.0), (2.4, 0.0), acceleration_scale=0.5, max_checks=20_000, time_limit=None)
    slow = room().plan(request)
    gentle = room().replan(slow, at_time=1.0, scene=disc(2.4), request=request)
    assert gentle.outcome is Outcome.STOP
    assert present(gentle.result.motion).peaks.acceleration.ratio == pytest.approx(1.0)
    here = float(trajectory_of(gentle)(trajectory_of(gentle).duration)[0])
    hard = room().replan(slow, at_time=1.0, scene=disc(here, away=0.9), request=request)
    assert hard.outcome is Outcome.STOP
    assert trajectory_of(hard).duration < trajectory_of(gentle).duration


def test_an_old_motion_that_is_faster_than_asked_is_left_and_the_notes_say_so() -> None:
    found = room().replan(swing(), at_time=1.0, request=small(swing(), velocity_scale=0.3))
    assert found.outcome is Outcome.STOP
    assert "the old motion is left: " in found.result.notes[0]
    assert found.result.notes[-1] == "beyond the limits asked: velocity 333%, acceleration 100% of them"


def test_a_robot_that_stopped_goes_on_to_its_goal_when_the_way_is_free_again() -> None:
    stop = room().replan(swing(), at_time=0.5, scene=disc(2.4))
    assert stop.outcome is Outcome.STOP
    for at in (0.05, trajectory_of(stop).duration):
        found = room().replan(stop, at_time=at)
        assert found.outcome is Outcome.NEW
        motion = trajectory_of(found)
        assert motion(motion.duration).tolist() == [2.4, 0.0]


def test_a_goal_out_of_reach_is_not_answered_with_the_way_to_the_old_one() -> None:
    found = room().replan(swing(), at_time=0.5, goal=Pose((5.0, 0.0, 0.0)))
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is Reason.NO_IK_SOLUTION


def test_the_old_goal_as_a_pose_is_still_the_goal() -> None:
    there = Pose.from_matrix(room().robot.tool_pose((2.4, 0.0)))
    found = room().replan(swing(), at_time=0.5, goal=there, request=small(swing(), max_checks=1))
    assert found.outcome is Outcome.KEPT


def test_a_robot_that_stopped_remembers_that_its_goal_had_moved() -> None:
    stop = room().replan(swing(), at_time=0.5, goal=(2.0, 0.5), scene=disc(2.0, away=1.0))
    assert stop.outcome is Outcome.STOP
    found = trajectory_of(room().replan(stop, at_time=0.1))
    assert found(found.duration).tolist() == [2.0, 0.5]


def test_a_way_that_samples_pass_but_cannot_be_proven_is_not_taken() -> None:
    coarse = PlannerService("planar2", disc(1.9, 0.001, away=0.7), edge_step=JointStep(0.5))
    found = coarse.replan(swing(), at_time=0.5)
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is Reason.NOT_CERTIFIED


def test_a_stop_remembers_the_waypoints_beyond_it() -> None:
    tip = room().robot.tool_pose(BENT[-1])[:3, 3]
    scene = Scene((Obstacle("pin", Cylinder(0.02, 0.2), Pose(tuple(tip.tolist()))),))
    found = room().replan(curved(), at_time=0.3, scene=scene)
    assert found.outcome is Outcome.STOP
    assert found.ahead[-1].tolist() == BENT[-1].tolist()
    assert len(present(found.path).waypoints) + len(found.ahead) == len(BENT)


@pytest.mark.parametrize("ahead", [0.05, 0.15, 0.25])
def test_an_obstacle_that_makes_the_stop_impossible_is_said_with_the_earliest_stop(ahead: float) -> None:
    at = 1.0
    here = float(trajectory_of(swing())(at + LATENCY)[0])
    scene = disc(here + ahead, away=0.9)  # no elbow passes it
    found = room().replan(swing(), at_time=at, scene=scene)
    assert found.outcome is Outcome.UNSAFE
    assert not found.ok
    assert found.trajectory is None
    assert found.result.failure is not None
    assert found.result.failure.reason is Reason.NOT_CERTIFIED
    assert "nothing is safe: the earliest stop along the old curve ends" in found.result.failure.detail
    assert "upper_arm x disc" in found.result.failure.detail
    assert touching(present(found.stop), scene) > 0


def test_an_obstacle_where_the_robot_is_before_the_splice_makes_nothing_safe() -> None:
    middle = float(trajectory_of(swing())(1.0 + LATENCY / 2)[0])
    found = room().replan(swing(), at_time=1.0, scene=disc(middle, 0.01))
    assert found.outcome is Outcome.UNSAFE


def test_what_the_robot_has_passed_is_no_longer_in_its_way() -> None:
    behind = float(trajectory_of(swing())(1.0)[0]) - 0.2
    assert room().replan(swing(), at_time=1.0, scene=disc(behind)).outcome is Outcome.KEPT


def test_nor_in_the_way_of_the_proof_of_its_saved_plan(tmp_path: Path) -> None:
    plan, world = str(tmp_path / "plan.json"), str(tmp_path / "world.toml")
    service = room().with_scene(disc(float(trajectory_of(swing())(1.0)[0]) - 0.2))
    save_scene(service.scene, world)
    found = service.replan(swing(), at_time=1.0)
    save_plan(SavedPlan(service.world, found.request, found.result), plan)
    assert not service.certify(present(found.path)).certified
    done = CliRunner().invoke(app, ["certify", plan, "--robot", "planar2", "--scene", world])
    assert done.stdout.startswith("certified: ")
    assert "of its path remains" in done.stdout


def test_a_robot_at_rest_at_its_goal_is_given_an_ordinary_plan() -> None:
    end = trajectory_of(swing()).duration
    found = room().replan(swing(), at_time=end, goal=(1.5, 0.5))
    assert found.outcome is Outcome.NEW
    assert found.splice == end + LATENCY
    motion = trajectory_of(found)
    assert motion(0.0).tolist() == [2.4, 0.0]
    assert motion.part is None


def test_a_robot_at_rest_at_its_goal_stays_there() -> None:
    found = room().replan(swing(), at_time=trajectory_of(swing()).duration)
    assert found.outcome is Outcome.KEPT
    assert trajectory_of(found).duration == 0.0


def test_a_robot_at_rest_that_can_go_nowhere_stays_and_that_is_proven() -> None:
    for at in (trajectory_of(swing()).duration, trajectory_of(swing()).duration - 0.05):
        found = room().replan(swing(), at_time=at, goal=(1.0, 0.0), scene=disc(1.0))
        assert found.outcome is Outcome.STOP
        assert trajectory_of(found).duration == 0.0
        assert trajectory_of(found)(0.0).tolist() == [2.4, 0.0]
        assert present(found.certificate).certified


def test_on_a_fixed_way_out_of_a_pose_the_old_motion_goes_on() -> None:
    service = PlannerService("wxai", "table")
    old = service.plan(PlanRequest(service.robot.pose("sleep"), service.robot.home, time_limit=None))
    found = service.replan(old, at_time=0.05)
    assert found.outcome is Outcome.KEPT
    assert [interval.pairs for interval in found.result.exempt] == [interval.pairs for interval in old.exempt]
    assert present(found.certificate).certified


def test_a_fixed_way_into_a_pose_is_exempt_to_its_last_bit_wherever_the_robot_is() -> None:
    service = PlannerService("wxai", "post")
    rng, limits = np.random.default_rng(3), service.robot.limits
    starts = [q for q in rng.uniform(limits.lower, limits.upper, (14, 6)) if service.checker.state_is_free(q)]
    for q in starts:
        old = service.plan(PlanRequest(q, service.robot.pose("sleep"), time_limit=None))
        assert old.exempt
        for share in (0.3, 0.6, 0.8, 0.95):
            found = service.replan(old, at_time=share * trajectory_of(old).duration, latency=0.01)
            assert found.outcome is Outcome.KEPT, str(found.failure)


def test_what_was_meant_to_be_touched_and_is_gone_is_no_mistake() -> None:
    meant = AllowedStretch(0, 3, (("forearm", "disc"), ("upper_arm", "disc")), "pushed")
    old = PlannerService("planar2", disc(0.6)).follow(BENT, pace=Pace(ToppRa()), contacts=(meant,))
    assert old.ok
    found = room().replan(old, at_time=0.5)
    assert present(found.certificate).certified
    assert found.result.exempt == ()


@pytest.mark.parametrize(
    "slower",
    [{"velocity_scale": 0.3}, {"acceleration_scale": 0.3}, {"max_tool_speed": 0.4}],
    ids=lambda given: next(iter(given)),
)
def test_a_motion_that_is_faster_than_is_asked_now_is_stopped_as_quickly_as_the_robot_can(
    slower: dict[str, float],
) -> None:
    at_time = 0.2
    request = PlanRequest((0.0, 0.0), (2.4, 0.0), **slower)  # type: ignore[arg-type]
    found = room().replan(swing(), at_time=at_time, request=request)
    assert found.outcome is Outcome.STOP
    own = peaks(trajectory_of(found), Pace(ToppRa()).limits(room().robot))
    assert own.highest <= 1.0 + 1e-9
    quickest = Underway(trajectory_of(swing()), at_time, at_time + LATENCY).braked(room().robot.limits)
    assert trajectory_of(found).duration <= quickest.duration * (1.0 + 1e-9)
    assert max(jumps(swing(), found)) <= NO_JUMP


def test_what_came_of_replanning_is_saved_and_read_without_losing_a_bit() -> None:
    result = room().replan(swing(), at_time=0.5, scene=disc(2.0)).result
    again = ResultRecord.model_validate(json.loads(json.dumps(result_record(result)))).value
    assert present(again.trajectory).part == present(result.trajectory).part
    assert present(again.trajectory)(0.1).tolist() == present(result.trajectory)(0.1).tolist()
    assert again.certificate == result.certificate


@pytest.mark.parametrize("part", [[2.0, 2.4], [0.0, 1.0]])
def test_a_record_whose_proof_leaves_out_some_of_the_motion_is_refused(part: list[float]) -> None:
    record = json.loads(json.dumps(result_record(room().replan(swing(), at_time=0.5).result)))
    record["certificate"]["part"] = part
    with pytest.raises(InvalidRequest, match="a proof of all that the trajectory runs along"):
        _ = ResultRecord.model_validate(record).value


def test_a_saved_rest_of_a_motion_is_proven_again_from_where_the_robot_was(tmp_path: Path) -> None:
    scene = disc(0.1)  # where the robot has been
    service = room().with_scene(scene)
    found = service.replan(swing(), at_time=1.5)
    assert found.outcome is Outcome.KEPT
    save_plan(SavedPlan(service.world, None, found.result), tmp_path / "rest.json")
    save_scene(scene, tmp_path / "disc.toml")
    done = CliRunner().invoke(app, ["certify", str(tmp_path / "rest.json"), "--scene", str(tmp_path / "disc.toml")])
    assert done.exit_code == 0, done.output
    assert "from s =" in done.output


def test_where_nothing_is_in_the_way_any_more_the_detour_is_cut_short() -> None:
    scene = disc(1.2)
    service = room().with_scene(scene)
    around = service.plan(PlanRequest((0.0, 0.0), (2.4, 0.0), time_limit=None))
    found = room().replan(around, at_time=0.05)
    assert found.outcome is Outcome.NEW
    assert trajectory_of(found).duration < 0.97 * (trajectory_of(around).duration - found.splice)


# -- budgets, counts, bits ------------------------------------------------------------------------


def small(swing: PlanResult, **settings: Any) -> PlanRequest:
    return PlanRequest((0.0, 0.0), (2.4, 0.0), **{"time_limit": None, **settings})


def test_a_spent_budget_ends_in_a_proven_stop() -> None:
    found = room().replan(swing(), at_time=0.5, scene=disc(2.0), request=small(swing(), max_checks=20))
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is Reason.CHECK_BUDGET_EXHAUSTED
    assert found.counts.states == 20


def test_a_spent_budget_lets_a_free_motion_go_on() -> None:
    found = room().replan(swing(), at_time=0.5, scene=disc(-1.0), request=small(swing(), max_checks=3))
    assert found.outcome is Outcome.KEPT
    assert found.result.deterministic


def test_a_cancelled_call_ends_in_a_proven_stop() -> None:
    token = CancelToken()
    token.cancel()
    found = PlannerService("planar2", disc(-1.0)).replan(swing(), at_time=0.5, cancel=token)
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is Reason.PREEMPTED
    assert found.counts.distances > 0
    assert found.counts == sum((report.counts for report in found.result.stages), CheckCounts())


def test_the_same_question_has_the_same_answer_to_the_last_bit() -> None:
    def answer() -> tuple[object, ...]:
        found = room().replan(swing(), at_time=0.5, scene=disc(2.0))
        motion = trajectory_of(found)
        stages = [(report.stage, report.counts) for report in found.result.stages]
        return stages, motion.durations.tolist(), motion.coefficients.tolist(), motion.path.waypoints.tolist()

    first = answer()
    room().replan(swing(), at_time=0.7, scene=disc(1.8))
    assert answer() == first


def test_the_counts_are_those_of_the_stages_and_the_service_does_not_mix_them() -> None:
    service = PlannerService("planar2", disc(2.0))
    before = service._planning.counts
    found = service.replan(swing(), at_time=0.5)
    assert found.counts == service._planning.counts - before
    for stage in (Stage.ENDPOINTS, Stage.STRAIGHT_LINE, Stage.SEARCH):
        assert found.result.stage(stage).counts.states > 0
    assert found.result.stage(Stage.CERTIFY).counts.distances > 0
    assert found.result.stage(Stage.TIMING).counts.states == 0


def test_an_obstacle_far_away_costs_little() -> None:
    assert room().replan(swing(), at_time=0.5, scene=disc(-1.0)).counts.states < 500


def test_the_tool_stays_as_slow_as_it_must_be() -> None:
    request = PlanRequest((0.0, 0.0), (2.4, 0.5), max_tool_speed=0.4, time_limit=None)
    old = room().plan(request)
    found = room().replan(old, at_time=1.5, goal=(2.4, 0.8), request=request)
    assert found.outcome is Outcome.NEW
    assert present(found.result.motion).tool_speed <= 0.4 * (1.0 + 1e-6)
    assert max(jumps(old, found)) <= NO_JUMP


@pytest.mark.slow
def test_a_real_arm_around_a_post_that_moves() -> None:
    service, scene = PlannerService("wxai", "post"), load_scene("post")
    query = queries.load("post")[0]
    request = PlanRequest(query.start, query.goal, padding=0.02, time_limit=None)
    old: PlanResult | Replanned = service.plan(request)
    for step in range(12):
        x, y, z = (0.3, 0.01 * step, 0.25)
        there = scene.moved("post_ahead", Pose((x, y, z)))
        new = service.replan(old, at_time=0.0, scene=there, request=request)
        assert new.ok
        assert present(new.certificate).certified
        assert (
            max(float(np.abs(trajectory_of(old)(0.1, k) - trajectory_of(new)(0.0, k)).max()) for k in range(3)) < 1e-11
        )
        assert service.with_scene(there).checker.states_are_free(trajectory_of(new).sample(0.01).q).all()
        old = new


# -- mistakes -------------------------------------------------------------------------------------


def test_a_mistake_is_refused_by_name() -> None:
    values: Any
    for values, message in [
        ({"at_time": -0.1}, "at_time"),
        ({"at_time": 99.0}, "at_time: got 99.0; expected seconds on the old motion"),
        ({"at_time": math.nan}, "at_time"),
        ({"at_time": "now"}, "at_time"),
        ({"latency": -0.1}, "latency"),
        ({"latency": 100.0}, "latency"),
        ({"goal": (1.0, 2.0, 3.0)}, "goal"),
        ({"goal": (1.0, math.inf)}, "goal"),
        ({"request": "quickly"}, "request"),
        ({"request": PlanRequest((0.0, 0.0), (1.0, 0.0), timing=SCurve())}, "request.timing"),
    ]:
        with pytest.raises(InvalidRequest, match=message):
            room().replan(swing(), **{"at_time": 0.5, **values})


def test_a_failed_plan_is_nothing_under_way() -> None:
    service = room().with_scene(disc(2.4))
    failed = service.plan(small(swing()))
    with pytest.raises(InvalidRequest, match="previous: got 'GOAL_IN_COLLISION"):
        room().replan(failed, at_time=0.0)


def test_a_motion_of_another_robot_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="previous: got 'a motion of 2 joints'"):
        PlannerService("wxai", "table").replan(swing(), at_time=0.0)


def test_a_motion_outside_the_limits_is_another_robots() -> None:
    robot = room().robot
    narrow = replace(robot, limits=replace(robot.limits, upper=np.array([2.0, 3.0])))
    with pytest.raises(InvalidRequest, match="outside this robot's joint limits"):
        PlannerService(narrow, EMPTY).replan(swing(), at_time=0.0)


def test_what_is_no_plan_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="previous"):
        room().replan(JointPath(BENT), at_time=0.0)  # type: ignore[arg-type]


# -- what it is made of ---------------------------------------------------------------------------


def test_a_part_of_a_path_is_proven_and_no_more() -> None:
    robot = PlannerService("planar2", EMPTY).robot
    path = JointPath(np.array([[0.0, 0.0], [2.4, 0.0]]))
    certifier = Certifier(robot, disc(1.2))
    assert not certifier.certify(path).certified
    assert certifier.certify(path, part=(0.0, 1.0)).certified
    assert certifier.certify(path, part=(1.4, 2.4)).certified
    assert not certifier.certify(path, part=(1.0, 1.2)).certified
    assert certifier.certify(path, part=(0.5, 0.5)).certified
    assert not certifier.certify(path, part=(1.2, 1.2)).certified


def test_a_part_that_is_not_on_the_path_is_refused() -> None:
    for part in [(-0.1, 1.0), (1.0, 0.5), (0.0, 2.5), (math.nan, 1.0)]:
        robot = PlannerService("planar2", EMPTY).robot
        path = JointPath(np.array([[0.0, 0.0], [2.4, 0.0]]))
        with pytest.raises(InvalidRequest, match="part"):
            Certifier(robot, EMPTY).certify(path, part=part)


def straight_part(begin: float, rate: float, seconds: float, end: float) -> Trajectory:
    path = JointPath(np.array([[0.0, 0.0], [2.0, 0.0]]))
    law = np.array([[begin, rate, -rate / (2.0 * seconds), 0.0]])
    return Trajectory(path, np.array([seconds]), law, 1.0, (begin, end))


def test_a_part_of_a_path_may_be_entered_at_speed() -> None:
    motion = straight_part(0.5, 1.0, 1.0, 1.0)
    assert motion(0.0).tolist() == [0.5, 0.0]
    assert motion(0.0, 1).tolist() == [1.0, 0.0]
    assert motion(1.0).tolist() == [1.0, 0.0]
    assert motion(1.0, 1).tolist() == [0.0, 0.0]
    assert motion.dilated(2.0)(2.0).tolist() == [1.0, 0.0]


def test_a_start_at_speed_is_no_jump_of_acceleration_and_a_stop_is() -> None:
    found = peaks(straight_part(0.5, 1.0, 1.0, 1.0), room().robot.limits)
    assert found.jerk.ratio == math.inf
    assert found.jerk.time == 1.0


def test_a_law_that_is_not_along_its_part_is_refused() -> None:
    for begin, end in [(0.5, 0.9), (0.4, 1.0), (-0.5, 1.0), (0.5, 2.5)]:
        path = JointPath(np.array([[0.0, 0.0], [2.0, 0.0]]))
        with pytest.raises(InvalidRequest, match=r"part|coefficients"):
            Trajectory(path, np.array([1.0]), np.array([[0.5, 1.0, -0.5, 0.0]]), 1.0, (begin, end))


def test_corners_before_and_after_a_part_are_passed_by_others() -> None:
    path = JointPath(np.array([[0.0, 1.0], [0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]))
    law = np.array([[1.5, 1.0, -0.5, 0.0]])
    assert Trajectory(path, np.array([1.0]), law, 1.0, (1.5, 2.0))(0.0).tolist() == [0.5, 0.0]
    law = np.array([[0.5, 1.0, 0.0, 0.0], [1.5, 1.0, -0.5, 0.0]])
    with pytest.raises(InvalidRequest, match=r"a stop at the path's corner at s = 1$"):
        Trajectory(path, np.array([1.0, 1.0]), law, 1.0, (0.5, 2.0))


def test_a_part_must_end_at_rest() -> None:
    path = JointPath(np.array([[0.0, 0.0], [2.0, 0.0]]))
    with pytest.raises(InvalidRequest, match="0 at both ends"):
        Trajectory(path, np.array([1.0]), np.array([[0.5, 0.5, 0.0, 0.0]]), 1.0, (0.5, 1.0))


def test_without_a_request_what_was_asked_before_is_kept() -> None:
    asked = PlanRequest(
        (0.0, 0.0),
        (2.4, 0.0),
        padding=0.02,
        velocity_scale=0.3,
        acceleration_scale=0.4,
        max_tool_speed=0.2,
        seed=5,
        blend=0.2,
        timing=SCurve(),
        max_checks=3000,
    )
    found = room().replan(room().plan(asked), at_time=0.5, scene=disc(2.0))
    kept = ("padding", "velocity_scale", "acceleration_scale", "max_tool_speed", "seed", "blend", "max_checks")
    assert {name: getattr(found.request, name) for name in kept} == {name: getattr(asked, name) for name in kept}
    assert present(found.result.motion).tool_speed <= 0.2 * (1.0 + 1e-6)
    assert any("timed by toppra, which can begin at speed, not by s-curve" in note for note in found.result.notes)
    again = room().replan(found, at_time=0.1, scene=disc(2.1))
    assert {name: getattr(again.request, name) for name in kept} == {name: getattr(asked, name) for name in kept}


def test_without_a_request_a_given_line_goes_on_at_its_own_pace() -> None:
    pace = Pace(Trapezoidal(), velocity_scale=0.25, acceleration_scale=0.5, max_tool_speed=0.3)
    found = room().replan(
        room().follow([[0.0, 0.0], [2.4, 0.0]], pace=pace, padding=0.01), at_time=0.5, scene=disc(2.0)
    )
    told = found.request.velocity_scale, found.request.acceleration_scale, found.request.max_tool_speed
    assert (*told, found.request.padding) == (0.25, 0.5, 0.3, 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("law", [ToppRa(), SCurve(), Trapezoidal()], ids=lambda law: str(law.name))
def test_at_the_very_end_of_a_motion_there_is_an_outcome_too(law: Any) -> None:
    old = room().plan(PlanRequest((0.0, 0.0), (2.4, 0.0), timing=law))
    duration = trajectory_of(old).duration
    for left in 10.0 ** np.arange(-9.0, -1.0, 0.25):
        found = room().replan(old, at_time=duration - left, latency=0.0, goal=(0.0, 0.0))
        assert found.ok
        assert duration - left <= found.splice <= duration
        if found.splice < duration:
            assert max(jumps(old, found)) <= NO_JUMP
        else:
            assert found.request.start.tolist() == [2.4, 0.0]  # type: ignore[union-attr]
