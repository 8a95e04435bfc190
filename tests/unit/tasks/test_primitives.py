"""Pick and place with the WidowX AI: where contact is meant, and nowhere else."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.studies.starts import starts_of
from planner_service import (
    Box,
    CancelToken,
    CheckCounts,
    Handling,
    InvalidRequest,
    Obstacle,
    PlannerService,
    PlanRequest,
    Pose,
    Reason,
    SCurve,
    Stage,
    TaskResult,
    UnknownName,
    load_scene,
    move_linear,
    pick,
    place,
    top_grasps,
)
from planner_service.certify import Certifier
from planner_service.records.recertify import recertify
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present

HALF = 0.0225


@pytest.fixture(scope="module")
def cell() -> PlannerService:
    """A clear table with a block standing exactly on it, and a mat exactly as high as the table beside it."""
    scene = load_scene("table")
    block = Obstacle("block", Box((0.045, 0.045, 0.045)), Pose((0.28, 0.10, HALF - 0.001)))
    return PlannerService("wxai", scene.with_obstacle(block))


def yaws(x: float, y: float, z: float) -> list[Pose]:
    return [Pose((x, y, z), (math.cos(a / 2), 0.0, 0.0, math.sin(a / 2))) for a in (0.0, math.pi / 2, math.pi)]


def picked(service: PlannerService, **handling: object) -> TaskResult:
    grasps = top_grasps(service.robot, service.scene.obstacle("block"))
    return pick(service, service.robot.home, "block", grasps, Handling(**{"support": "table", **handling}))  # type: ignore[arg-type]


def test_a_clear_table_pick_and_place_never_searches_and_judges_each_piece_once(cell: PlannerService) -> None:
    taken = picked(cell)
    put = place(
        PlannerService.of(taken.world), taken.q, "block", yaws(0.28, -0.10, HALF - 0.001), Handling(support="table")
    )
    back = PlannerService.of(put.world).plan(PlanRequest(put.q, cell.robot.home))
    assert taken.ok
    assert put.ok
    assert back.ok
    for segment in (*taken.segments, *put.segments):
        path, _ = segment.result.unwrap()
        assert segment.result.stage(Stage.SEARCH).counts == CheckCounts()
        assert segment.result.counts.edges == len(path.waypoints) - 1
    assert (taken.choosing + put.choosing).edges == 0
    assert (taken.choosing + put.choosing).states <= 8  # where it starts, and whether the contact makes sense


def test_a_pick_approaches_straight_takes_the_object_along_and_closes_on_it(cell: PlannerService) -> None:
    task = picked(cell)
    assert [segment.name for segment in task.segments] == ["to pregrasp", "descend", "lift"]
    assert [segment.width for segment in task.segments] == pytest.approx([0.069, 0.069, 0.045])
    descend = task.segments[1].result.unwrap()[0]
    tips = np.array([cell.robot.tool_pose(q)[:3, 3] for q in descend(np.linspace(0.0, descend.length, 200))])
    assert np.abs(tips[:, :2] - [0.28, 0.10]).max() < 1e-3
    assert tips[0, 2] - tips[-1, 2] == pytest.approx(0.10, abs=1e-6)
    assert [a.name for a in task.world.scene.attached] == ["block"]
    assert "block" not in [o.name for o in task.world.scene.obstacles]


def test_segments_join_end_to_start(cell: PlannerService) -> None:
    task = picked(cell)
    paths = [segment.result.unwrap()[0].waypoints for segment in task.segments]
    assert paths[0][0].tolist() == cell.robot.home.tolist()
    assert all(a[-1].tolist() == b[0].tolist() for a, b in pairwise(paths))
    assert task.q.tolist() == paths[-1][-1].tolist()


@pytest.mark.slow
def test_without_the_exemption_of_its_support_a_standing_object_cannot_be_lifted(cell: PlannerService) -> None:
    sunk = cell.with_scene(cell.scene.moved("block", Pose((0.28, 0.10, HALF - 0.0012))))  # 0.2 mm into the table
    assert picked(sunk).ok
    refused = picked(sunk, support=None)
    assert "block x table" in present(refused.failure).detail


def test_the_support_may_be_touched_only_within_the_support_gap(cell: PlannerService) -> None:
    lift = picked(cell).segments[2].result
    assert lift.exempt[0].pairs == (("block", "table"),)
    path, _ = lift.unwrap()
    heights = [cell.robot.tool_pose(path(s))[2, 3] for s in (lift.exempt[0].s_start, lift.exempt[0].s_end)]
    assert 0.0 < heights[1] - heights[0] <= 0.005


@pytest.mark.slow
def test_an_object_under_a_shelf_is_not_lifted_into_it(cell: PlannerService) -> None:
    lid = Obstacle("lid", Box((0.3, 0.3, 0.01)), Pose((0.28, 0.10, 0.12)))
    task = picked(cell.with_scene(cell.scene.with_obstacle(lid)))
    assert task.segments == ()
    assert "x lid" in present(task.failure).detail


@pytest.mark.slow
def test_high_up_a_lean_or_a_shorter_line_is_chosen_and_said(cell: PlannerService) -> None:
    """Straight down, the tip cannot rise above 0.175 m: 10 cm of vertical lift are not there at z = 0.12."""
    stand = Obstacle("stand", Box((0.06, 0.06, 0.10)), Pose((0.30, 0.0, 0.0495)))
    scene = cell.scene.without("block").with_obstacle(stand)
    scene = scene.with_obstacle(Obstacle("block", Box((0.045, 0.045, 0.045)), Pose((0.30, 0.0, 0.0995 + HALF))))
    task = picked(cell.with_scene(scene), support="stand")
    assert task.ok
    assert any("way 1 with 10 cm: the straight tool line ends" in note for note in task.notes)
    assert "way 1 of" not in task.notes[0]


@pytest.mark.slow
def test_a_placed_object_stands_where_it_was_put(cell: PlannerService) -> None:
    taken = picked(cell)
    poses = yaws(0.28, -0.10, HALF - 0.001)
    put = place(PlannerService.of(taken.world), taken.q, "block", poses, Handling(support="table"))
    assert put.world.scene.obstacle("block").pose in poses
    assert put.world.scene.attached == ()
    assert put.segments[2].width == pytest.approx(0.069)


def test_the_timing_law_of_the_lines_is_the_callers_choice(cell: PlannerService) -> None:
    assert picked(cell, line_timing=SCurve()).segments[1].result.stage(Stage.TIMING).note.startswith("s-curve")


@pytest.mark.slow
def test_what_looking_for_a_grasp_cost_is_counted(cell: PlannerService) -> None:
    lid = Obstacle("lid", Box((0.3, 0.3, 0.01)), Pose((0.28, 0.10, 0.12)))
    service = cell.with_scene(cell.scene.with_obstacle(lid))
    task = picked(service)
    assert task.choosing.states > 0
    assert task.counts == task.choosing


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda c: pick(c, c.robot.home, "blok", [Pose()]),
            UnknownName,
            "unknown obstacle 'blok'; did you mean 'block'",
        ),
        (lambda c: pick(c, c.robot.home, "block", []), InvalidRequest, "grasps: got .*; expected a list of at least"),
        (lambda c: pick(c, [0.0], "block", [Pose()]), InvalidRequest, "q: got .*; expected 6 joint values"),
        (lambda c: picked(c, support="tabel"), UnknownName, "unknown obstacle 'tabel'; did you mean 'table'"),
        (lambda c: picked(c, support="block"), InvalidRequest, "support: got 'block'; expected what the object"),
        (lambda c: picked(c, support_gap="x"), InvalidRequest, "support_gap: got 'x'"),
        (lambda c: picked(c, open_width=0.01), InvalidRequest, "open_width: got 0.01; expected at least the object's"),
        (lambda c: pick(c, c.robot.home, "block", list("x")), InvalidRequest, "grasps: got .*; expected a list"),  # type: ignore[arg-type]
        (lambda c: picked(c, support_gap=-1.0), InvalidRequest, "support_gap: got -1.0"),
        (lambda c: place(c, c.robot.home, "block", [Pose()]), UnknownName, "unknown carried object 'block'"),
        (lambda c: picked(c, open_width=0.2), InvalidRequest, r"width: got 0.2; expected a gap .* in \[0, 0.08\]"),
    ],
)
def test_bad_input_names_what_is_wrong(
    cell: PlannerService, call: object, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call(cell)  # type: ignore[operator]


def test_an_object_wider_than_the_gripper_has_no_grasp(cell: PlannerService) -> None:
    wide = replace(cell.scene.obstacle("block"), shape=Box((0.1, 0.1, 0.045)))
    with pytest.raises(InvalidRequest, match=r"at most 0.080 m wide; this one is 0.100 m"):
        top_grasps(cell.robot, wide)


def grasp_at(x: float, y: float, z: float) -> Pose:
    return Pose((x, y, z), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))


@pytest.mark.parametrize(
    ("grasp", "message"),
    [
        (grasp_at(0.28, -0.10, 0.03), r"the fingertips are 178 mm away from block"),
        (grasp_at(0.28, 0.107, 0.021), r"closing would push block 7 mm aside"),
    ],
)
def test_a_grasp_that_does_not_hold_the_object_is_refused(cell: PlannerService, grasp: Pose, message: str) -> None:
    task = pick(cell, cell.robot.home, "block", [grasp], Handling(support="table"))
    assert re.search(message, present(task.failure).detail)


def test_a_grasp_whose_fingers_would_stand_inside_the_object_is_refused(cell: PlannerService) -> None:
    tight = Handling(support="table", open_width=0.0452)  # no room for a grasp 2 mm beside the middle
    task = pick(cell, cell.robot.home, "block", [grasp_at(0.28, 0.102, 0.021)], tight)
    assert re.search(r"finger_(left|right) would stand [12].\d mm inside block", present(task.failure).detail)


@pytest.mark.parametrize(
    ("height", "message"),
    [(-0.004, r"block would stand 4.0 mm inside table"), (0.02, r"block would not come within 5 mm of table")],
)
def test_an_object_is_set_down_on_its_support_not_into_it_or_above_it(
    cell: PlannerService, height: float, message: str
) -> None:
    taken = picked(cell)
    put = place(
        PlannerService.of(taken.world),
        taken.q,
        "block",
        yaws(0.28, -0.10, HALF - 0.001 + height),
        Handling(support="table"),
    )
    assert re.search(message, present(put.failure).detail)


def test_the_scales_of_the_request_slow_the_straight_lines_down_too(cell: PlannerService) -> None:
    slow = PlanRequest(cell.robot.home, cell.robot.home, velocity_scale=0.25, acceleration_scale=0.25)
    full, quarter = picked(cell), picked(cell, request=slow)
    for a, b in zip(full.segments, quarter.segments, strict=True):
        assert b.result.unwrap()[1].duration > 1.9 * a.result.unwrap()[1].duration


def test_a_pick_from_a_start_in_collision_says_so_at_once(cell: PlannerService) -> None:
    task = pick(cell, [0.0, 1.8, 0.5, 0.0, 0.0, 0.0], "block", [grasp_at(0.28, 0.10, 0.021)])
    assert present(task.failure).reason is Reason.START_IN_COLLISION
    assert task.counts.edges == 0


def test_a_cancelled_pick_ends_as_preempted(cell: PlannerService) -> None:
    token = CancelToken()
    token.cancel()
    task = picked(cell, cancel=token)
    assert present(task.failure).reason is Reason.PREEMPTED


@pytest.mark.slow
def test_a_grasp_at_which_something_else_touches_is_refused_before_any_edge_is_judged() -> None:
    service = PlannerService("panda", "bin")
    block = service.scene.obstacle("blue_block").pose.position
    task = pick(service, service.robot.home, "blue_block", [grasp_at(*block), Pose(block)])  # lying on its side
    assert " x table touch" in present(task.failure).detail
    assert task.counts.edges == 0


# --- what the request says holds on the straight lines too

SLOW_AND_SMOOTH = {"velocity_scale": 0.5, "acceleration_scale": 0.6, "max_tool_speed": 0.08, "padding": 0.003}


def asked(service: PlannerService, **settings: object) -> PlanRequest:
    return PlanRequest(service.robot.home, service.robot.home, **settings)  # type: ignore[arg-type]


def test_every_motion_of_a_pick_and_place_obeys_the_request() -> None:
    service = PlannerService("wxai", load_scene("bin").without("demo_post"))
    request = asked(service, timing=SCurve(), **SLOW_AND_SMOOTH)
    task = plan_pick_place(service, "blue_block", "tray", request)
    assert task.failure is None
    assert len(task.segments) == 7
    for segment in task.segments:
        motion = present(segment.result.motion)
        assert segment.result.stage(Stage.TIMING).note.startswith("s-curve")
        assert motion.peaks.jerk.ratio <= 1.0 + 1e-9
        assert motion.peaks.velocity.ratio <= 1.0 + 1e-9
        assert motion.tool_speed <= 0.08 * (1.0 + 1e-6)
        told = any("less than the padding of 3 mm" in note for note in segment.result.notes)
        assert segment.result.padding == 0.003 or told


def test_a_line_that_cannot_keep_the_padding_at_its_end_says_near_what_and_where(
    cell: PlannerService,
) -> None:
    task = picked(cell, request=asked(cell, padding=0.03))
    descend = task.segments[1].result
    (near,) = descend.near_ends
    path = descend.unwrap()[0]
    assert descend.padding == 0.03
    assert near.s_end == path.length
    assert near.s_start > path.length / 2
    assert re.search(r"closer than 30 mm, as at that end, from s = .*: \w+ x \w+", descend.notes[0])
    assert picked(cell).segments[1].result.padding == 0.001


def test_what_stood_on_something_is_near_it_at_the_end_of_the_line_alone(cell: PlannerService) -> None:
    lift = picked(cell, request=asked(cell, padding=0.01)).segments[2].result
    (near,) = lift.near_ends
    (stood,) = lift.exempt
    assert lift.padding == 0.01
    assert near.pairs == (("block", "table"),)
    assert stood.s_end < near.s_end < lift.unwrap()[0].length / 2


def test_a_given_line_keeps_the_padding_asked_or_says_what_it_keeps(cell: PlannerService) -> None:
    home = cell.robot.home
    line = [home, home + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])]
    roomy, tight = cell.follow(line, padding=0.01), cell.follow(line, padding=0.09)
    assert (roomy.padding, roomy.notes) == (0.01, ())
    assert tight.ok
    assert present(tight.certificate).clearance <= tight.padding < 0.09
    assert re.match(r"[0-9.]+ mm are proven, less than the padding of 90 mm: \w+ x \w+ at s = ", tight.notes[0])
    assert move_linear(cell, home, (0.02, 0.0, 0.0), padding=0.01).padding == 0.01
    with pytest.raises(InvalidRequest, match=r"padding: got 0.2; expected metres in \[0, 0.1\]"):
        cell.follow(line, padding=0.2)


def test_lines_keep_their_corners_where_no_blend_is_wanted(cell: PlannerService) -> None:
    sharp = picked(cell, request=asked(cell, blend=0.0)).segments[1].result.unwrap()[0]
    assert len(sharp.corners) == len(sharp.waypoints) - 2 > 0
    assert not sharp.blends.any()


def test_the_time_limit_is_for_the_whole_pick(cell: PlannerService) -> None:
    task = picked(cell, request=asked(cell, time_limit=0.0))
    assert present(task.failure).reason is Reason.TIMED_OUT
    late = picked(cell, request=asked(cell, time_limit=1e-3))
    assert present(late.failure).reason is Reason.TIMED_OUT


def test_a_cancelled_pick_and_place_ends(cell: PlannerService) -> None:
    token = CancelToken()
    token.cancel()
    service = PlannerService("wxai", "bin")
    task = plan_pick_place(service, "blue_block", "tray", asked(service), cancel=token)
    assert present(task.failure).reason is Reason.PREEMPTED


def test_a_task_whose_start_touches_something_begins_by_leaving_it_and_is_proven_as_a_whole() -> None:
    service = PlannerService("wxai", "bin")
    certifier = Certifier(service.robot, service.scene)
    start, _ = next(starts_of(service, certifier, np.random.default_rng(1), itself=False))
    request = PlanRequest(start, start)
    task = plan_pick_place(service, "blue_block", "tray", request)
    assert task.ok
    assert [segment.name for segment in task.segments][:2] == ["leave", "home -> pregrasp"]
    assert task.segments[0].result.exempt
    assert not any(each.depth is not None for segment in task.segments[1:] for each in segment.result.exempt)
    assert recertify(task).certified
    refused = plan_pick_place(service, "blue_block", "tray", replace(request, start_overlap=0.0))
    assert present(refused.failure).reason is Reason.START_IN_COLLISION


def test_a_place_that_cannot_be_reached_says_what_turn_of_the_tool_would_do(cell: PlannerService) -> None:
    taken = picked(cell)
    put = place(PlannerService.of(taken.world), taken.q, "block", yaws(0.30, 0.25, 0.33))
    failure = present(put.failure)
    assert "the position is within reach, but with the tool turned by 0.5" in failure.detail
    assert 0.5 < present(failure.unreachable).turn < 0.6


def test_a_pick_that_is_too_far_away_says_by_how_much(cell: PlannerService) -> None:
    far = Obstacle("far", Box((0.03, 0.03, 0.03)), Pose((0.9, 0.0, 0.1)))
    service = PlannerService("wxai", cell.scene.with_obstacle(far))
    failure = present(pick(service, cell.robot.home, "far", top_grasps(cell.robot, far)).failure)
    assert re.search(r"way \d+ comes nearest: out of reach by \d+\.\d mm, nearest at ", failure.detail)
    assert 0.1 < present(failure.unreachable).gap < 0.2
