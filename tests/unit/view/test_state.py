"""What a page shows, without a browser: motions on one clock, what is said of a configuration, what is carried when."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import (
    PRM,
    Box,
    InvalidRequest,
    MissingDependency,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Roadmap,
    Scene,
    TaskResult,
    UnknownName,
)
from planner_service.cli.view import opened
from planner_service.collision import CheckCounts
from planner_service.constraints import JointRange, KeepUpright, ToolRegion
from planner_service.planning.result import Reason
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedTask, load_plan_or_task, load_task
from planner_service.search.trace import SearchGraph
from planner_service.tasks import Segment
from planner_service.tasks.pick_place import plan_pick_place
from planner_service.view import open_viewer
from planner_service.view.collision_report import CollisionReporter
from planner_service.view.lines import MAX_EDGES, curve_lines, free_graph, graph_lines, polyline_lines, tool_points
from planner_service.view.markdown import report_markdown, result_markdown, state_markdown
from planner_service.view.playback import Playback
from planner_service.view.state import Choice, ViewState
from tests.support.command import refused
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


def test_motions_of_a_task_follow_each_other_without_a_jump(bin_: PlannerService, task: TaskResult) -> None:
    playback = present(Playback.of_task(bin_, task.segments))
    assert [clip.name for clip in playback.clips] == [segment.name for segment in task.segments]
    for before, after in zip(playback.clips, playback.clips[1:], strict=False):
        assert after.begin == before.end
        np.testing.assert_allclose(playback.at(before.end - 1e-9).q, playback.at(after.begin).q, atol=1e-6)


def test_gripper_and_scene_are_those_of_the_motion(bin_: PlannerService, task: TaskResult) -> None:
    state = ViewState.of(bin_, task)
    for clip, segment in zip(present(state.playback).clips, task.segments, strict=True):
        there = state.at(clip.begin + 0.01)
        assert there.service.robot.gripper_width == segment.width
        carries = [held.name for held in there.service.scene.attached]
        assert carries == (["blue_block"] if segment.name in ("lift", "transfer", "lower") else [])


def test_a_task_from_a_file_tells_what_each_motion_carries(
    bin_: PlannerService, task: TaskResult, tmp_path: Path
) -> None:
    save_plan(task, tmp_path / "task.json")
    read = load_task(tmp_path / "task.json")
    known, found = Playback.of_task(bin_, task.segments), Playback.of_task(read.service(), read.segments)
    assert known is not None
    assert found is not None
    for one, other in zip(known.clips, found.clips, strict=True):
        assert one.service.robot.hash == other.service.robot.hash
        assert one.service.scene == other.service.scene


def test_plotted_motions_keep_to_the_limits(bin_: PlannerService, task: TaskResult) -> None:
    playback = present(Playback.of_task(bin_, task.segments))
    samples = playback.samples
    assert samples.t[0] == 0.0
    assert samples.t[-1] == pytest.approx(playback.duration, abs=1e-12)
    assert (np.diff(samples.t) >= 0.0).all()
    for part in (samples.position, samples.velocity, samples.acceleration):
        assert part.shape == (len(samples.t), bin_.robot.n)
        assert np.abs(part).max() <= 1.0 + 1e-9
    proofs = [segment.result.certificate for segment in task.segments]
    assert samples.clearance.min() >= min(proof.clearance for proof in proofs if proof is not None) - 1e-9


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


def test_of_a_task_what_a_motion_does_not_keep_is_not_plotted_while_it_lasts(
    bin_: PlannerService, task: TaskResult
) -> None:
    segments = [
        replace(segment, result=replace(segment.result, constraints=(KeepUpright((-1, 0, 0), 3.0),)))
        if segment.name in ("lift", "lower")
        else segment
        for segment in task.segments
    ]
    playback = present(Playback.of_task(bin_, segments))
    (tilt,) = playback.used.values()
    assert tilt.shape == playback.samples.t.shape
    for clip in playback.clips:
        inside = (playback.samples.t > clip.begin) & (playback.samples.t < clip.end)
        assert (np.isnan(tilt[inside]) == (clip.name not in ("lift", "lower"))).all()
    state = ViewState.of(bin_, replace(task, segments=tuple(segments)))
    for clip in playback.clips:
        assert (state.at(clip.begin + 1e-3).kept is None) == (clip.name not in ("lift", "lower"))


def test_a_plan_that_fails_shows_the_constraints_that_it_was_to_keep(discs: PlannerService) -> None:
    high = replace(KEPT[0], lower=(-math.inf, 0.5, -math.inf), upper=(math.inf, 2.0, math.inf))
    result = discs.plan(asked(discs, constraints=(high,)))
    assert present(result.failure).reason is Reason.START_VIOLATES_CONSTRAINT
    state = ViewState.of(discs, result)
    kept = present(state.kept)
    assert kept.constraints.constraints == (high,)
    assert kept.Q.tolist() == [state.start.tolist(), state.goal.tolist()]
    assert state.posed((0.5, 0.5)).kept is kept


def test_the_next_plan_keeps_the_constraints_of_the_motion_shown(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs, constraints=KEPT)))
    (again,) = state.with_goal().planned(Choice()).results
    assert again.result.constraints == KEPT
    with pytest.raises(InvalidRequest, match=r"planner: got RRT.*as there are constraints"):
        state.planned(Choice("rrt"))


def test_a_plan_from_a_file_shows_its_constraints(discs: PlannerService, tmp_path: Path) -> None:
    result = discs.plan(asked(discs, constraints=KEPT))
    result.save(tmp_path / "plan.json")
    service, shown, _ = opened(str(tmp_path / "plan.json"), None, None)
    known, found = (present(ViewState.of(*given).playback).used for given in ((discs, result), (service, shown)))
    assert list(known) == list(found)
    for name in known:
        assert known[name].tolist() == found[name].tolist()


# What is said of a configuration.


def test_a_colliding_configuration_names_its_pair_and_where_it_touches(discs: PlannerService) -> None:
    q = colliding(discs)
    report = ViewState.of(discs).posed(q).report
    assert [(c.a, c.b) for c in report.contacts] == [(c.a, c.b) for c in discs.checker.contacts(q)]
    assert not report.free
    assert "**in collision**" in report_markdown(report)
    assert "lesson\\_disc" in report_markdown(report)
    (names, point), *_ = report.points
    assert names == (report.contacts[0].a, report.contacts[0].b)
    disc = np.array(discs.scene.obstacle("lesson_disc").pose.position)
    assert math.dist(disc[:2], point[:2]) < 0.2


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


def test_a_free_configuration_tells_a_clearance_that_is_proven(discs: PlannerService) -> None:
    report = ViewState.of(discs).posed((0.0, 0.0)).report
    assert report.free
    assert report.points == ()
    assert report.clearance > 0.0
    assert report_markdown(report).startswith("**free**: at least ")


def test_looking_changes_nobodys_counts(discs: PlannerService) -> None:
    before = discs.checker.counts
    ViewState.of(discs).posed(colliding(PlannerService(discs.robot, discs.scene))).report  # noqa: B018
    assert discs.checker.counts == before


def test_what_is_meant_to_touch_is_told_apart(bin_: PlannerService, task: TaskResult) -> None:
    state = ViewState.of(bin_, task)
    descend = next(clip for clip in present(state.playback).clips if clip.name == "descend")
    report = state.at(descend.end - 1e-3).report
    assert report.free
    fingers = {("finger_left", "blue_block"), ("finger_right", "blue_block")}
    lift = next(clip for clip in present(state.playback).clips if clip.name == "lift")
    assert fingers.isdisjoint((c.a, c.b) for c in state.at(lift.begin).report.contacts)
    table = Scene((Obstacle("table", Box((1.0, 1.0, 0.1)), Pose((0.0, 0.0, -0.05))),))
    touching = PlannerService("wxai", table)
    q = next(q for q in np.linspace(touching.robot.home, touching.robot.limits.upper, 50) if _touches(touching, q))
    pairs = [(c.a, c.b) for c in touching.checker.contacts(q)]
    report = CollisionReporter(touching).report(q, pairs)
    assert report.free
    assert [(c.a, c.b) for c in report.expected] == pairs
    assert "expected contacts" in report_markdown(report)


def _touches(service: PlannerService, q: Any) -> bool:
    return not service.checker.state_is_free(q)


# What a user does.


def test_a_pose_by_hand_stays_within_the_limits(discs: PlannerService) -> None:
    state = ViewState.of(discs).posed((100.0, -100.0))
    assert state.q.tolist() == [discs.robot.limits.upper[0], discs.robot.limits.lower[1]]
    assert state.seconds is None


def test_what_is_no_number_moves_nothing(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs))).at(0.7)
    assert state.at(math.nan) == state
    posed = state.posed((math.nan, 0.1))
    assert posed.q.tolist() == [state.q[0], 0.1]
    assert posed.report.clearance is not None


def test_start_and_goal_are_where_the_robot_stands(discs: PlannerService) -> None:
    state = ViewState.of(discs).posed((0.1, 0.2)).with_start().posed((0.3, 0.4)).with_goal()
    assert (state.start.tolist(), state.goal.tolist()) == ([0.1, 0.2], [0.3, 0.4])


def test_a_plan_made_on_the_page_is_the_services_with_a_trace(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs))).planned(Choice("rrt", seed=7))
    (segment,) = state.results
    result = segment.result
    assert result.trace is not None
    assert result.origin is not None
    assert result.origin.request is not None
    assert (result.origin.request.planner.name, result.origin.request.seed) == ("rrt", 7)
    again = discs.plan(result.origin.request)
    assert again.counts == result.counts
    assert state.seconds == 0.0


def test_a_plan_made_on_the_page_has_the_timing_that_was_chosen(discs: PlannerService) -> None:
    state = ViewState.of(discs, discs.plan(asked(discs)))
    choice = Choice(timing="trapezoidal", velocity_scale=0.5, acceleration_scale=0.25)
    request = present(present(state.planned(choice).results[0].result.origin).request)
    assert request.timing.name == "trapezoidal"
    assert (request.velocity_scale, request.acceleration_scale) == (0.5, 0.25)


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
    assert released.with_goal().aim is None


def test_a_goal_in_collision_names_its_pair(discs: PlannerService) -> None:
    state = ViewState.of(discs).posed(colliding(discs)).with_goal()
    (contact, *_) = discs.checker.contacts(state.goal)
    assert f"{contact.a} × {contact.b}" in state.goal_objection


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


def test_an_unknown_planner_is_refused(discs: PlannerService) -> None:
    with pytest.raises(UnknownName, match="rrtconnect"):
        ViewState.of(discs).planned(Choice("rrtconect"))


def test_a_result_is_shown_as_it_is(discs: PlannerService) -> None:
    result = discs.plan(asked(discs))
    (segment,) = ViewState.of(discs, result).results
    assert segment.result is result


def test_what_is_said_of_a_plan_adds_up(discs: PlannerService) -> None:
    result = discs.plan(asked(discs))
    words = result_markdown(ViewState.of(discs, result))
    assert f"| **total** | {result.counts.states:,} | {result.counts.edges:,} | {result.counts.distances:,} |" in words
    assert "**certified**: " in words


def test_the_clock_says_which_motion_it_is_and_what_is_carried(bin_: PlannerService, task: TaskResult) -> None:
    state = ViewState.of(bin_, task)
    lift = next(clip for clip in present(state.playback).clips if clip.name == "lift")
    assert state_markdown(state.at(lift.begin + 0.1)).startswith("lift, ")
    assert state_markdown(state.at(lift.begin + 0.1)).endswith("carrying blue\\_block")
    assert state_markdown(state.posed(bin_.robot.home)) == "moved by hand"


# Lines.


def test_tool_points_are_those_of_the_tool_pose(bin_: PlannerService) -> None:
    rng, limits = np.random.default_rng(1), bin_.robot.limits
    Q = limits.lower + (limits.upper - limits.lower) * rng.random((20, bin_.robot.n))
    expected = [bin_.robot.tool_pose(q)[:3, 3] for q in Q]
    np.testing.assert_allclose(tool_points(bin_.robot, Q), expected, atol=1e-12)


def test_lines_run_from_milestone_to_milestone(discs: PlannerService) -> None:
    trace = present(discs.plan(asked(discs), trace=True).trace)
    assert trace.graph is not None
    drawn = polyline_lines(discs.robot, present(trace.searched))
    np.testing.assert_allclose(drawn[:-1, 1], drawn[1:, 0], atol=1e-12)
    np.testing.assert_allclose(
        drawn[[0, -1], [0, 1]], tool_points(discs.robot, present(trace.searched)[[0, -1]]), atol=1e-12
    )
    milestones = tool_points(discs.robot, trace.graph.milestones)
    for edge in trace.graph.edges[:5]:
        one = graph_lines(discs.robot, SearchGraph(trace.graph.milestones, edge[None]))
        np.testing.assert_allclose([one[0, 0], one[-1, 1]], milestones[edge], atol=1e-12)


def test_a_curve_is_drawn_from_start_to_goal(discs: PlannerService) -> None:
    path = present(discs.plan(asked(discs)).path)
    drawn = curve_lines(discs.robot, path)
    np.testing.assert_allclose(drawn[[0, -1], [0, 1]], tool_points(discs.robot, path.waypoints[[0, -1]]), atol=1e-12)


def test_of_a_roadmap_what_is_known_to_be_free_is_drawn(discs: PlannerService) -> None:
    roadmap = discs.build_roadmap(PRM(milestones=40), progress=False)
    graph = free_graph(roadmap)
    assert 0 < len(graph.edges) <= len(roadmap.edges)
    judged = Roadmap.judged([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], [(0, 1)], {(1, 2): "post"})
    assert free_graph(judged).edges.tolist() == [[0, 1]]


def test_of_a_huge_tree_some_edges_are_drawn(discs: PlannerService) -> None:
    points = np.linspace((0.0, 0.0), (0.01, 0.01), 3 * MAX_EDGES, dtype=np.float64)
    edges = np.stack([np.arange(len(points) - 1), np.arange(1, len(points))], axis=1)
    assert len(graph_lines(discs.robot, SearchGraph(points, edges))) == MAX_EDGES


# What is refused.


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"port": 70_000}, "port: got 70000; expected a whole number from 0 to 65,535"),
        ({"port": True}, "port: got True"),
        ({"host": "", "port": 0}, "host: got ''; expected an address of this machine"),
        ({"host": "203.0.113.7", "port": 0}, r"host: got '203\.0\.113\.7'; expected an address of this machine"),
    ],
)
def test_an_address_that_is_none_is_refused(discs: PlannerService, given: dict[str, Any], match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        open_viewer(discs, None, **given)


def test_what_cannot_be_shown_is_refused(discs: PlannerService, bin_: PlannerService) -> None:
    other = discs.plan(asked(discs))
    with pytest.raises(InvalidRequest, match="a plan of 2 joints; expected one of wxai's 6"):
        ViewState.of(bin_, other)
    with pytest.raises(InvalidRequest, match="shown: got 3; expected a PlanResult"):
        ViewState.of(bin_, 3)  # type: ignore[arg-type]


def test_without_viser_the_extra_is_named(discs: PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.delitem(sys.modules, "planner_service.view.serving.server", raising=False)
    with pytest.raises(MissingDependency, match=r"planner-service\[view\]"):
        discs.view(port=0, block=False)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("view",), "give --scene, or the FILE of a plan or task"),
        (("view", "--scene", "bni"), "did you mean 'bin'"),
        (("view", "--scene", "discs", "--robot", "planar2", "--port", "-1"), "port: got -1"),
        (("view", "nowhere.json"), "no such file"),
    ],
)
def test_the_command_refuses_what_it_cannot_show(arguments: tuple[str, ...], match: str) -> None:
    assert match in refused(*arguments)


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


def test_a_task_from_a_file_is_shown_by_itself(
    task: TaskResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[str, object]] = []
    monkeypatch.setattr("planner_service.view.show", lambda world, what, **_: shown.append((world.scene.name, what)))
    save_plan(task, tmp_path / "task.json")
    read = load_task(tmp_path / "task.json")
    read.show()
    assert shown == [("bin", read)]
