"""What a page shows, without a browser: motions on one clock, what is said of a configuration, what is carried when."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import (
    Box,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Scene,
    TaskResult,
)
from planner_service.cli.view import opened
from planner_service.collision import CheckCounts
from planner_service.constraints import JointRange, ToolRegion
from planner_service.records.plan_file import SavedTask, load_plan_or_task
from planner_service.tasks import Segment
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.view import open_viewer
from planner_service.view.collision_report import CollisionReporter
from planner_service.view.lines import tool_points
from planner_service.view.markdown import report_markdown, result_markdown, state_markdown
from planner_service.view.playback import Playback
from planner_service.view.state import Choice, ViewState
from tests.support.optional import present

KEPT = (ToolRegion(upper=(math.inf, 1.4, math.inf), name="low"), JointRange("elbow", -2.5, 2.5))


@pytest.fixture(scope="module")
def task(bin_: PlannerService) -> TaskResult:
    home = bin_.robot.home
    return plan_pick_place(bin_, "blue_block", "tray", PlanRequest(home, home, time_limit=None))


def asked(service: PlannerService, **settings: object) -> PlanRequest:
    poses = service.robot.poses
    given = {"start": poses["lesson_start"], "goal": poses["lesson_goal"], "time_limit": None, **settings}
    return PlanRequest(**given)  # type: ignore[arg-type]


def colliding(service: PlannerService) -> Any:
    """A configuration of the planar arm in which it touches the disc of the lesson."""
    path = present(service.plan(asked(service)).path)
    line = np.linspace(path.waypoints[0], path.waypoints[-1], 200)
    return next(q for q in line if not service.checker.state_is_free(q))


# Motions on one clock.


def test_a_plan_is_at_its_ends_when_its_reel_is(discs: PlannerService) -> None:
    result = discs.plan(asked(discs))
    state = ViewState.of(discs, result)
    assert result.trajectory is not None
    assert present(state.playback).duration == result.trajectory.duration
    assert state.q.tolist() == result.trajectory(0.0).tolist()
    assert state.at(1e9).q.tolist() == result.trajectory(result.trajectory.duration).tolist()
    assert state.at(0.7).q.tolist() == result.trajectory(0.7).tolist()


def test_gripper_and_scene_are_those_of_the_motion(bin_: PlannerService, task: TaskResult) -> None:
    state = ViewState.of(bin_, task)
    for clip, segment in zip(present(state.playback).clips, task.segments, strict=True):
        there = state.at(clip.begin + 0.01)
        assert there.service.robot.gripper_width == segment.width
        carries = [held.name for held in there.service.scene.attached]
        assert carries == (["blue_block"] if segment.name in ("lift", "transfer", "lower") else [])
        assert state_markdown(there).endswith("carrying blue\\_block") == bool(carries)
        stood = ("blue_block", "bin_floor")
        expected = [stood in present(state.playback).at(t).expected for t in (clip.begin, clip.end - 1e-3)]
        assert expected == [segment.name == "lift", False]


def test_plotted_velocities_are_parts_of_the_limits(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs)))
    samples, clip = present(state.playback).samples, present(state.playback).clips[0]
    k, limits = len(samples.t) // 3, discs.robot.limits
    at = float(samples.t[k])
    np.testing.assert_allclose(samples.velocity[k] * limits.velocity, clip.trajectory(at, 1), atol=1e-12)
    np.testing.assert_allclose(samples.acceleration[k] * limits.acceleration, clip.trajectory(at, 2), atol=1e-12)
    low, high = limits.lower, limits.upper
    np.testing.assert_allclose((samples.position[k] + 1.0) / 2.0 * (high - low) + low, clip.trajectory(at), atol=1e-12)


def test_how_much_of_its_tolerances_a_plan_uses_is_plotted_at_the_instants_of_the_other_plots(
    discs: PlannerService,
) -> None:
    result = discs.plan(asked(discs, constraints=KEPT))
    playback = present(ViewState.of(discs, result).playback)
    assert list(playback.used) == ["elbow", "low y"]
    trajectory = present(result.trajectory)
    elbow = trajectory(playback.samples.t)[:, 1]
    np.testing.assert_allclose(playback.used["elbow"], elbow / 2.5, atol=1e-12)
    assert all(np.abs(values).max() <= 1.0 for values in playback.used.values())
    assert present(Playback.of_result(discs, discs.plan(asked(discs)))).used == {}


def test_the_next_plan_keeps_the_constraints_of_the_motion_shown(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs, constraints=KEPT)))
    (again,) = state.with_goal().planned(Choice()).results
    assert again.result.constraints == KEPT
    with pytest.raises(InvalidRequest, match=r"planner: got RRT.*as there are constraints"):
        state.planned(Choice("rrt"))


# What is said of a configuration.


def test_a_colliding_configuration_names_its_pair_and_where_it_touches(discs: PlannerService) -> None:
    q, before = colliding(discs), discs.checker.counts
    report = ViewState.of(discs).posed(q).report
    assert discs.checker.counts == before
    assert [(c.a, c.b) for c in report.contacts] == [(c.a, c.b) for c in discs.checker.contacts(q)]
    assert not report.free
    assert "**in collision**" in report_markdown(report)
    assert "lesson\\_disc" in report_markdown(report)
    (names, point), *_ = report.points
    assert names == (report.contacts[0].a, report.contacts[0].b)
    disc = np.array(discs.scene.obstacle("lesson_disc").pose.position)
    assert math.dist(disc[:2], point[:2]) < 0.2
    report = ViewState.of(discs).posed((0.0, 0.0)).report
    assert (report.free, report.points) == (True, ())
    assert report.clearance > 0.0
    assert report_markdown(report).startswith("**free**: at least ")


def test_a_name_from_a_file_is_no_html_and_no_markdown(discs: PlannerService) -> None:
    name = "<img src=x> [a](http://b) `c` &lt; |"
    scene = replace(
        discs.scene, obstacles=tuple(replace(o, name=f"{k}{name}") for k, o in enumerate(discs.scene.obstacles))
    )
    service = PlannerService(discs.robot, scene)
    words = report_markdown(ViewState.of(service).posed(colliding(service)).report)
    assert "\\<img src\\=x\\> \\[a\\]\\(http\\:\\/\\/b\\) \\`c\\` \\&lt\\; \\|" in words
    result = discs.plan(asked(discs))
    segments = tuple(Segment(name, result, 0.0) for _ in range(2))
    state = ViewState.of(discs, SavedTask(discs.world, "", segments, CheckCounts(), 0.0))
    assert "<img" not in result_markdown(state).replace("\\<", "")
    assert "<img" not in state_markdown(state).replace("\\<", "")


def test_what_may_touch_is_told_apart() -> None:
    touching = PlannerService("wxai", Scene((Obstacle("table", Box((1.0, 1.0, 0.1)), Pose((0.0, 0.0, -0.05))),)))
    line = np.linspace(touching.robot.home, touching.robot.limits.upper, 50)
    q = next(q for q in line if not touching.checker.state_is_free(q))
    pairs = [(c.a, c.b) for c in touching.checker.contacts(q)]
    report = CollisionReporter(touching).report(q, pairs)
    assert (report.free, [(c.a, c.b) for c in report.expected]) == (True, pairs)
    assert "expected contacts" in report_markdown(report)


# What a user does.


def test_a_pose_by_hand_stays_within_the_limits_and_what_is_no_number_moves_nothing(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs))).at(0.7)
    low, high = discs.robot.limits.lower, discs.robot.limits.upper
    assert state.at(math.nan) == state
    assert state.posed((100.0, -100.0)).q.tolist() == [high[0], low[1]]
    posed = state.posed((math.nan, 0.1))
    assert posed.q.tolist() == [state.q[0], 0.1]
    assert posed.report.clearance is not None


def test_a_plan_made_on_the_page_is_the_services_with_a_trace(discs: PlannerService) -> None:
    choice = Choice("rrt", seed=7, timing="trapezoidal", velocity_scale=0.5, acceleration_scale=0.25)
    state = ViewState.of(discs, discs.plan(asked(discs))).planned(choice)
    (segment,) = state.results
    result, request = segment.result, present(present(segment.result.origin).request)
    assert result.trace is not None
    assert (request.planner.name, request.seed, request.timing.name) == ("rrt", 7, "trapezoidal")
    assert (request.velocity_scale, request.acceleration_scale) == (0.5, 0.25)
    assert discs.plan(request).counts == result.counts
    assert state.seconds == 0.0


def test_a_goal_that_is_dragged_follows_the_handles(bin_: PlannerService) -> None:
    state = ViewState.of(bin_)
    pose = Pose((0.0, 0.0, -0.02)) @ state.tool_of_goal
    dragged = state.aimed(pose)
    np.testing.assert_allclose(bin_.robot.tool_pose(dragged.goal), pose.matrix, atol=1e-7)
    assert (dragged.tool_of_goal, dragged.goal_objection) == (pose, "")
    assert dragged.start is state.start


def test_a_goal_out_of_reach_is_told_until_the_handles_are_let_go(bin_: PlannerService) -> None:
    state = ViewState.of(bin_)
    far = Pose((5.0, 0.0, 0.0)) @ state.tool_of_goal
    dragged = state.aimed(far)
    assert dragged.goal_objection == "not reached by the tool"
    released = dragged.released()
    assert "not reached" not in released.goal_objection
    assert released.tool_of_goal.position[0] < 1.0
    assert dragged.with_goal().aim is None


def test_what_the_page_saves_is_what_the_result_saves(
    discs: PlannerService, bin_: PlannerService, task: TaskResult, tmp_path: Path
) -> None:
    assert ViewState.of(discs).saved is None
    for service, shown in ((discs, discs.plan(asked(discs))), (bin_, task)):
        shown.save(tmp_path / "saved.json")
        saved = present(ViewState.of(service, shown).saved)
        assert saved.file_text() == (tmp_path / "saved.json").read_text("ascii")
        again = load_plan_or_task(tmp_path / "saved.json")
        shown_again = again if isinstance(again, SavedTask) else again.result
        assert (ViewState.of(service, shown_again).saved is None) == (not isinstance(again, SavedTask))


def test_a_plan_that_fails_is_told_with_its_reason(discs: PlannerService) -> None:
    state = ViewState.of(discs).posed(colliding(discs)).with_goal().planned(Choice("rrtconnect"))
    assert state.playback is None
    words = result_markdown(state)
    assert "GOAL\\_IN\\_COLLISION" in words
    assert "**proven**: no plan exists" in words
    assert "| endpoints |" in words


# Lines.


def test_tool_points_are_those_of_the_tool_pose(bin_: PlannerService) -> None:
    rng, limits = np.random.default_rng(1), bin_.robot.limits
    Q = limits.lower + (limits.upper - limits.lower) * rng.random((20, bin_.robot.n))
    expected = [bin_.robot.tool_pose(q)[:3, 3] for q in Q]
    np.testing.assert_allclose(tool_points(bin_.robot, Q), expected, atol=1e-12)


# What is refused.


def test_a_plan_file_is_shown_in_its_scene_or_one_that_is_given(discs: PlannerService, tmp_path: Path) -> None:
    result = discs.plan(asked(discs))
    result.save(tmp_path / "plan.json")
    service, shown, notes = opened(str(tmp_path / "plan.json"), None, None)
    assert notes == ["using the scene in this file: discs"]
    state = ViewState.of(service, shown)
    assert present(state.playback).duration == present(result.trajectory).duration
    other, shown, notes = opened(str(tmp_path / "plan.json"), None, "table")
    assert other.scene.name == "table"
    assert notes[0].startswith("using --scene table instead of the scene in this file")
    assert ViewState.of(other, shown).service.scene.name == "table"


@pytest.mark.parametrize(
    ("shown", "given", "match"),
    [
        (None, {"port": 70_000}, "port: got 70000; expected a whole number from 0 to 65,535"),
        (None, {"port": True}, "port: got True"),
        (None, {"host": "", "port": 0}, "host: got ''; expected an address of this machine"),
        (None, {"host": "203.0.113.7", "port": 0}, r"host: got '203\.0\.113\.7'"),
        (3, {"port": 0}, "shown: got 3; expected a PlanResult"),
        (PlannerService("planar2", "empty").plan(PlanRequest((0.0, 0.0), (0.1, 0.1))), {"port": 0}, "2 joints; .* 6"),
    ],
)
def test_what_cannot_be_shown_or_served_is_refused(
    bin_: PlannerService, shown: Any, given: dict[str, Any], match: str
) -> None:
    with pytest.raises(InvalidRequest, match=match):
        open_viewer(bin_, shown, **given)
