"""Replanning: no jump at the splice, what is returned is proven in the new scene, and faults planted there are told."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import planner_service as ps
from planner_service.certify import Certifier
from planner_service.cli.commands import app
from planner_service.planning import Pace
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan
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
def room() -> ps.PlannerService:
    return ps.PlannerService("planar2", EMPTY)


@cache
def swing() -> ps.PlanResult:
    """A straight motion, the arm stretched out."""
    return room().plan(ps.PlanRequest((0.0, 0.0), (2.4, 0.0), time_limit=None))


@cache
def curved() -> ps.PlanResult:
    """A motion over two wide blends."""
    return room().follow(BENT, pace=Pace(ps.ToppRa()), blends=WIDE)


def disc(angle: float, radius: float = 0.05, *, away: float = 1.4) -> Scene:
    """A disc in the way of the stretched arm."""
    place = (away * math.cos(angle), away * math.sin(angle), 0.0)
    return Scene((ps.Obstacle("disc", ps.Cylinder(radius, 0.2), ps.Pose(place)),))


def trajectory_of(motion: ps.PlanResult | Replanned) -> ps.Trajectory:
    return present(motion.trajectory)


def jumps(old: ps.PlanResult, new: Replanned) -> list[float]:
    """Of q, qd and qdd at the splice."""
    before, after = trajectory_of(old), trajectory_of(new)
    return [float(np.abs(before(new.splice, order) - after(0.0, order)).max()) for order in range(3)]


def touching(motion: ps.Trajectory, scene: Scene) -> int:
    """How many of its samples every 2 ms collide."""
    return int((~ps.PlannerService("planar2", scene).checker.states_are_free(motion.sample(0.002).q)).sum())


# -- the splice -----------------------------------------------------------------------------------


@pytest.mark.parametrize("goal", [None, (2.2, 0.9), (2.5, 1.3)])
def test_position_velocity_and_acceleration_go_on_at_the_splice(goal: Any) -> None:
    for share in [0.0, 0.1, 0.4, 0.5, 0.75, 0.9]:  # in blends and between them
        at = share * trajectory_of(curved()).duration
        found = room().replan(curved(), at_time=at, latency=LATENCY, goal=goal)
        assert found.outcome in (Outcome.KEPT, Outcome.NEW)
        assert max(jumps(curved(), found)) <= NO_JUMP


@pytest.mark.parametrize("law", [ps.Trapezoidal(), ps.SCurve(), ps.SCurve(jerk=4.0), ps.ToppRa()])
def test_the_old_motion_may_be_under_any_law(law: Any) -> None:
    old = room().follow(BENT, pace=Pace(law), blends=WIDE)
    for share in (0.05, 0.2, 0.5, 0.7):
        found = room().replan(old, at_time=share * trajectory_of(old).duration, goal=(2.3, 1.2))
        assert found.outcome is Outcome.NEW
        assert max(jumps(old, found)) <= NO_JUMP


def test_twenty_steps_in_a_row_after_a_goal_that_moves_are_one_smooth_motion() -> None:
    old: ps.PlanResult | Replanned = room().plan(ps.PlanRequest((0.0, 0.0), (1.5, 0.8), time_limit=None))
    for step in range(20):
        new = room().replan(old, at_time=0.0, latency=LATENCY, goal=(1.5 + 0.02 * step, 0.8 - 0.03 * step))
        assert new.outcome in (Outcome.NEW, Outcome.KEPT)
        before, after = trajectory_of(old), trajectory_of(new)
        assert max(float(np.abs(before(LATENCY, k) - after(0.0, k)).max()) for k in range(3)) <= NO_JUMP
        assert after.s(np.linspace(0.0, LATENCY, 50), 1).min() > 0.0 or step == 0
        old = new


# -- what is in the way ---------------------------------------------------------------------------


def test_a_free_motion_goes_on_as_it_was() -> None:
    found = room().replan(swing(), at_time=1.0, scene=disc(0.1))  # where the robot has been
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
    path, part = present(found.path), present(present(found.certificate).part)
    assert path(part[0]) == pytest.approx(trajectory_of(swing())(0.5), abs=1e-12)  # proven from where the robot is
    assert part[1] == motion.end == path.length
    assert Certifier(room().robot, scene).certify(path, part=part) == found.certificate


def test_without_a_way_the_robot_stops_along_the_old_curve() -> None:
    scene = disc(2.4)
    found = room().replan(swing(), at_time=0.5, scene=scene)
    assert found.outcome is Outcome.STOP
    assert found.ok
    assert present(found.failure).reason is ps.Reason.GOAL_IN_COLLISION
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


@pytest.mark.slow
def test_a_stop_is_as_gentle_as_asked_where_that_is_safe() -> None:
    request = ps.PlanRequest((0.0, 0.0), (2.4, 0.0), acceleration_scale=0.5, max_checks=20_000, time_limit=None)
    slow = room().plan(request)
    gentle = room().replan(slow, at_time=1.0, scene=disc(2.4), request=request)
    assert gentle.outcome is Outcome.STOP
    assert present(gentle.result.motion).peaks.acceleration.ratio == pytest.approx(1.0)
    here = float(trajectory_of(gentle)(trajectory_of(gentle).duration)[0])
    hard = room().replan(slow, at_time=1.0, scene=disc(here, away=0.9), request=request)
    assert hard.outcome is Outcome.STOP
    assert trajectory_of(hard).duration < trajectory_of(gentle).duration


def test_a_robot_that_stopped_goes_on_to_its_goal_when_the_way_is_free_again() -> None:
    stop = room().replan(swing(), at_time=0.5, scene=disc(2.4))
    assert stop.outcome is Outcome.STOP
    for at in (0.05, trajectory_of(stop).duration):
        found = room().replan(stop, at_time=at)
        assert found.outcome is Outcome.NEW
        motion = trajectory_of(found)
        assert motion(motion.duration).tolist() == [2.4, 0.0]


def test_a_goal_out_of_reach_is_not_answered_with_the_way_to_the_old_one() -> None:
    found = room().replan(swing(), at_time=0.5, goal=ps.Pose((5.0, 0.0, 0.0)))
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is ps.Reason.NO_IK_SOLUTION


def test_a_robot_that_stopped_remembers_that_its_goal_had_moved() -> None:
    stop = room().replan(swing(), at_time=0.5, goal=(2.0, 0.5), scene=disc(2.0, away=1.0))
    assert stop.outcome is Outcome.STOP
    found = trajectory_of(room().replan(stop, at_time=0.1))
    assert found(found.duration).tolist() == [2.0, 0.5]


def test_an_obstacle_that_makes_the_stop_impossible_is_said_with_the_earliest_stop() -> None:
    at = 1.0
    here = float(trajectory_of(swing())(at + LATENCY)[0])
    scene = disc(here + 0.15, away=0.9)  # no elbow passes it
    found = room().replan(swing(), at_time=at, scene=scene)
    assert found.outcome is Outcome.UNSAFE
    assert not found.ok
    assert found.trajectory is None
    assert found.result.failure is not None
    assert found.result.failure.reason is ps.Reason.NOT_CERTIFIED
    assert "nothing is safe: the earliest stop along the old curve ends" in found.result.failure.detail
    assert "upper_arm x disc" in found.result.failure.detail
    assert touching(present(found.stop), scene) > 0


def test_an_obstacle_where_the_robot_is_before_the_splice_makes_nothing_safe() -> None:
    middle = float(trajectory_of(swing())(1.0 + LATENCY / 2)[0])
    found = room().replan(swing(), at_time=1.0, scene=disc(middle, 0.01))
    assert found.outcome is Outcome.UNSAFE


def test_a_robot_at_rest_that_can_go_nowhere_stays_and_that_is_proven() -> None:
    for at in (trajectory_of(swing()).duration, trajectory_of(swing()).duration - 0.05):  # at rest when it may turn off
        found = room().replan(swing(), at_time=at, goal=(1.0, 0.0), scene=disc(1.0))
        assert found.outcome is Outcome.STOP
        assert trajectory_of(found).duration == 0.0
        assert trajectory_of(found)(0.0).tolist() == [2.4, 0.0]
        assert present(found.certificate).certified


def test_on_a_fixed_way_out_of_a_pose_the_old_motion_goes_on() -> None:
    service = ps.PlannerService("wxai", "table")
    old = service.plan(ps.PlanRequest(service.robot.pose("sleep"), service.robot.home, time_limit=None))
    found = service.replan(old, at_time=0.05)
    assert found.outcome is Outcome.KEPT
    assert [interval.pairs for interval in found.result.exempt] == [interval.pairs for interval in old.exempt]
    assert present(found.certificate).certified


def test_a_fixed_way_into_a_pose_is_exempt_to_its_last_bit_wherever_the_robot_is() -> None:
    service = ps.PlannerService("wxai", "post")
    rng, limits = np.random.default_rng(3), service.robot.limits
    starts = [q for q in rng.uniform(limits.lower, limits.upper, (5, 6)) if service.checker.state_is_free(q)]
    for q in starts:
        old = service.plan(ps.PlanRequest(q, service.robot.pose("sleep"), time_limit=None))
        assert old.exempt
        for share in (0.3, 0.6, 0.8, 0.95):
            found = service.replan(old, at_time=share * trajectory_of(old).duration, latency=0.01)
            assert found.outcome is Outcome.KEPT, str(found.failure)


@pytest.mark.parametrize("slower", [{"velocity_scale": 0.3}, {"acceleration_scale": 0.3}, {"max_tool_speed": 0.4}])
def test_a_motion_that_is_faster_than_is_asked_now_is_stopped_as_quickly_as_the_robot_can(slower: Any) -> None:
    at_time, request = 0.2, small(swing(), **slower)
    found = room().replan(swing(), at_time=at_time, request=request)
    assert found.outcome is Outcome.STOP
    own = peaks(trajectory_of(found), Pace(ps.ToppRa()).limits(room().robot))
    assert own.highest <= 1.0 + 1e-9
    quickest = Underway(trajectory_of(swing()), at_time, at_time + LATENCY).braked(room().robot.limits)
    assert trajectory_of(found).duration <= quickest.duration * (1.0 + 1e-9)
    assert found.result.notes[-1].startswith("beyond the limits asked: ") == ("max_tool_speed" not in slower)
    assert max(jumps(swing(), found)) <= NO_JUMP


def test_a_saved_rest_of_a_motion_is_proven_again_from_where_the_robot_was(tmp_path: Path) -> None:
    scene = disc(0.1)  # where the robot has been
    service = room().with_scene(scene)
    found = service.replan(swing(), at_time=1.5)
    assert found.outcome is Outcome.KEPT
    save_plan(SavedPlan(service.world, None, found.result), tmp_path / "rest.json")
    ps.save_scene(scene, tmp_path / "disc.toml")
    done = CliRunner().invoke(app, ["certify", str(tmp_path / "rest.json"), "--scene", str(tmp_path / "disc.toml")])
    assert done.exit_code == 0, done.output
    assert "from s =" in done.output


# -- budgets, counts, bits ------------------------------------------------------------------------


def small(swing: ps.PlanResult, **settings: Any) -> ps.PlanRequest:
    return ps.PlanRequest((0.0, 0.0), (2.4, 0.0), **{"time_limit": None, **settings})


def test_a_spent_budget_ends_in_a_proven_stop() -> None:
    found = room().replan(swing(), at_time=0.5, scene=disc(2.0), request=small(swing(), max_checks=20))
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is ps.Reason.CHECK_BUDGET_EXHAUSTED
    assert found.counts.states == 20


def test_a_cancelled_call_ends_in_a_proven_stop() -> None:
    token = ps.CancelToken()
    token.cancel()
    found = ps.PlannerService("planar2", disc(-1.0)).replan(swing(), at_time=0.5, cancel=token)
    assert found.outcome is Outcome.STOP
    assert present(found.failure).reason is ps.Reason.PREEMPTED
    assert found.counts.distances > 0
    assert found.counts == sum((report.counts for report in found.result.stages), ps.CheckCounts())


# -- mistakes -------------------------------------------------------------------------------------


def test_a_mistake_is_refused_by_name() -> None:
    values: Any
    for values, message in [
        ({"at_time": -0.1}, "at_time"),
        ({"at_time": 99.0}, "at_time: got 99.0; expected seconds on the old motion"),
        ({"latency": 100.0}, "latency"),
        ({"goal": (1.0, 2.0, 3.0)}, "goal"),
        ({"goal": (1.0, math.inf)}, "goal"),
        ({"request": "quickly"}, "request"),
        ({"request": ps.PlanRequest((0.0, 0.0), (1.0, 0.0), timing=ps.SCurve())}, "request.timing"),
    ]:
        with pytest.raises(ps.InvalidRequest, match=message):
            room().replan(swing(), **{"at_time": 0.5, **values})


def test_what_this_robot_does_not_do_is_refused() -> None:
    robot = room().robot
    narrow = replace(robot, limits=replace(robot.limits, upper=np.array([2.0, 3.0])))
    failed = room().with_scene(disc(2.4)).plan(small(swing()))
    for service, previous, message in [
        (ps.PlannerService(narrow, EMPTY), swing(), "outside this robot's joint limits"),
        (ps.PlannerService("wxai", "table"), swing(), "previous: got 'a motion of 2 joints'"),
        (room(), failed, "previous: got 'GOAL_IN_COLLISION"),
        (room(), ps.JointPath(BENT), "previous"),
    ]:
        with pytest.raises(ps.InvalidRequest, match=message):
            service.replan(previous, at_time=0.0)  # type: ignore[arg-type]


# -- what it is made of ---------------------------------------------------------------------------


def test_without_a_request_what_was_asked_before_is_kept() -> None:
    kept = {"padding": 0.02, "velocity_scale": 0.3, "acceleration_scale": 0.4, "max_tool_speed": 0.2}
    kept |= {"seed": 5, "blend": 0.2, "max_checks": 3000}
    asked = small(swing(), timing=ps.SCurve(), **kept)
    found = room().replan(room().plan(asked), at_time=0.5, scene=disc(2.0))
    assert {name: getattr(found.request, name) for name in kept} == kept
    assert present(found.result.motion).tool_speed <= 0.2 * (1.0 + 1e-6)
    assert any("timed by toppra, which can begin at speed, not by s-curve" in note for note in found.result.notes)
    again = room().replan(found, at_time=0.1, scene=disc(2.1))
    assert {name: getattr(again.request, name) for name in kept} == kept


@pytest.mark.slow
@pytest.mark.parametrize("law", [ps.ToppRa(), ps.SCurve(), ps.Trapezoidal()], ids=lambda law: str(law.name))
def test_at_the_very_end_of_a_motion_there_is_an_outcome_too(law: Any) -> None:
    old = room().plan(ps.PlanRequest((0.0, 0.0), (2.4, 0.0), timing=law))
    duration = trajectory_of(old).duration
    for left in 10.0 ** np.arange(-9.0, -1.0, 0.5):
        found = room().replan(old, at_time=duration - left, latency=0.0, goal=(0.0, 0.0))
        assert found.ok
        assert duration - left <= found.splice <= duration
        if found.splice < duration:
            assert max(jumps(old, found)) <= NO_JUMP
        else:
            assert found.request.start.tolist() == [2.4, 0.0]  # type: ignore[union-attr]
