"""Pick and place with the WidowX AI: where contact is meant, and nowhere else."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import planner_service as ps
from benchmarks.studies.starts import starts_of
from planner_service.certify import Certifier
from planner_service.records.recertify import recertify
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present

HALF = 0.0225


@pytest.fixture(scope="module")
def cell() -> ps.PlannerService:
    """A clear table with a block standing exactly on it, and a mat exactly as high as the table beside it."""
    scene = ps.load_scene("table")
    block = ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.28, 0.10, HALF - 0.001)))
    return ps.PlannerService("wxai", scene.with_obstacle(block))


def yaws(x: float, y: float, z: float) -> list[ps.Pose]:
    return [ps.Pose((x, y, z), (math.cos(a / 2), 0.0, 0.0, math.sin(a / 2))) for a in (0.0, math.pi / 2, math.pi)]


def picked(service: ps.PlannerService, **handling: object) -> ps.TaskResult:
    grasps = ps.top_grasps(service.robot, service.scene.obstacle("block"))
    return ps.pick(service, service.robot.home, "block", grasps, ps.Handling(**{"support": "table", **handling}))  # type: ignore[arg-type]


def test_a_clear_table_pick_and_place_never_searches_and_judges_each_piece_once(cell: ps.PlannerService) -> None:
    taken = picked(cell)
    put = ps.place(
        ps.PlannerService.of(taken.world),
        taken.q,
        "block",
        yaws(0.28, -0.10, HALF - 0.001),
        ps.Handling(support="table"),
    )
    back = ps.PlannerService.of(put.world).plan(ps.PlanRequest(put.q, cell.robot.home))
    assert taken.ok
    assert put.ok
    assert back.ok
    for segment in (*taken.segments, *put.segments):
        path, _ = segment.result.unwrap()
        assert segment.result.stage(ps.Stage.SEARCH).counts == ps.CheckCounts()
        assert segment.result.counts.edges == len(path.waypoints) - 1
    assert (taken.choosing + put.choosing).edges == 0
    assert (taken.choosing + put.choosing).states <= 8  # where it starts, and whether the contact makes sense


def test_a_pick_approaches_straight_takes_the_object_along_and_closes_on_it(cell: ps.PlannerService) -> None:
    task = picked(cell)
    assert [segment.name for segment in task.segments] == ["to pregrasp", "descend", "lift"]
    assert [segment.width for segment in task.segments] == pytest.approx([0.069, 0.069, 0.045])
    descend = task.segments[1].result.unwrap()[0]
    tips = np.array([cell.robot.tool_pose(q)[:3, 3] for q in descend(np.linspace(0.0, descend.length, 200))])
    assert np.abs(tips[:, :2] - [0.28, 0.10]).max() < 1e-3
    assert tips[0, 2] - tips[-1, 2] == pytest.approx(0.10, abs=1e-6)
    assert all(
        a[-1].tolist() == b[0].tolist() for a, b in pairwise(s.result.unwrap()[0].waypoints for s in task.segments)
    )
    assert [a.name for a in task.world.scene.attached] == ["block"]
    assert "block" not in [o.name for o in task.world.scene.obstacles]


@pytest.mark.slow
def test_without_the_exemption_of_its_support_a_standing_object_cannot_be_lifted(cell: ps.PlannerService) -> None:
    sunk = cell.with_scene(cell.scene.moved("block", ps.Pose((0.28, 0.10, HALF - 0.0012))))  # 0.2 mm into the table
    assert picked(sunk).ok
    refused = picked(sunk, support=None)
    assert "block x table" in present(refused.failure).detail


def test_the_support_may_be_touched_only_within_the_support_gap(cell: ps.PlannerService) -> None:
    lift = picked(cell).segments[2].result
    assert lift.exempt[0].pairs == (("block", "table"),)
    path, _ = lift.unwrap()
    heights = [cell.robot.tool_pose(path(s))[2, 3] for s in (lift.exempt[0].s_start, lift.exempt[0].s_end)]
    assert 0.0 < heights[1] - heights[0] <= 0.005


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (
            lambda c: ps.pick(c, c.robot.home, "blok", [ps.Pose()]),
            ps.UnknownName,
            "unknown obstacle 'blok'; did you mean 'block'",
        ),
        (lambda c: picked(c, support="tabel"), ps.UnknownName, "unknown obstacle 'tabel'; did you mean 'table'"),
        (lambda c: picked(c, support="block"), ps.InvalidRequest, "support: got 'block'; expected what the object"),
        (lambda c: ps.place(c, c.robot.home, "block", [ps.Pose()]), ps.UnknownName, "unknown carried object 'block'"),
    ],
)
def test_bad_input_names_what_is_wrong(
    cell: ps.PlannerService, call: object, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        call(cell)  # type: ignore[operator]


def grasp_at(x: float, y: float, z: float) -> ps.Pose:
    return ps.Pose((x, y, z), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))


@pytest.mark.parametrize(
    ("grasp", "message"),
    [
        (grasp_at(0.28, -0.10, 0.03), r"the fingertips are 178 mm away from block"),
        (grasp_at(0.28, 0.107, 0.021), r"closing would push block 7 mm aside"),
    ],
)
def test_a_grasp_that_does_not_hold_the_object_is_refused(
    cell: ps.PlannerService, grasp: ps.Pose, message: str
) -> None:
    task = ps.pick(cell, cell.robot.home, "block", [grasp], ps.Handling(support="table"))
    assert re.search(message, present(task.failure).detail)


def test_a_grasp_whose_fingers_would_stand_inside_the_object_is_refused(cell: ps.PlannerService) -> None:
    tight = ps.Handling(support="table", open_width=0.0452)  # no room for a grasp 2 mm beside the middle
    task = ps.pick(cell, cell.robot.home, "block", [grasp_at(0.28, 0.102, 0.021)], tight)
    assert re.search(r"finger_(left|right) would stand [12].\d mm inside block", present(task.failure).detail)


@pytest.mark.parametrize(
    ("height", "message"),
    [(-0.004, r"block would stand 4.0 mm inside table"), (0.02, r"block would not come within 5 mm of table")],
)
def test_an_object_is_set_down_on_its_support_not_into_it_or_above_it(
    cell: ps.PlannerService, height: float, message: str
) -> None:
    taken = picked(cell)
    poses = yaws(0.28, -0.10, HALF - 0.001 + height)
    put = ps.place(ps.PlannerService.of(taken.world), taken.q, "block", poses, ps.Handling(support="table"))
    assert re.search(message, present(put.failure).detail)


def among_others(gap: float) -> ps.Scene:
    """A table with a block of 45 mm that others of its size stand around, ``gap`` metres away."""
    scene, block = ps.load_scene("table"), ps.Box((0.045, 0.045, 0.045))
    for k, (x, y) in enumerate(((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))):
        at = ps.Pose((0.33 + x * (0.045 + gap), y * (0.045 + gap), 0.0235))
        scene = scene.with_obstacle(ps.Obstacle(f"other_{k}" if k else "block", block, at))
    return scene


def picked_among(gap: float, open_width: float | None) -> ps.TaskResult:
    service = ps.PlannerService("wxai", among_others(gap))
    grasps = ps.top_grasps(service.robot, service.scene.obstacle("block"))
    return ps.pick(service, service.robot.home, "block", grasps, ps.Handling(support="table", open_width=open_width))


def test_a_pick_among_others_opens_the_gripper_as_far_as_there_is_room() -> None:
    task = picked_among(0.02, None)
    assert task.ok
    assert task.segments[1].width == pytest.approx(0.051)
    assert any("finger_left x other" in note for note in task.notes), "why not 69 mm"
    assert any("gripper 57.0 mm open: finger_left x other" in note for note in task.notes), "why not 57 mm"


def test_an_opening_that_was_asked_for_is_the_only_one_tried() -> None:
    task = picked_among(0.02, 0.069)
    assert "finger_" in present(task.failure).detail
    assert {width for note in task.notes for width in re.findall(r"gripper (\S+) mm open", note)} == {"69.0"}


def test_a_pick_that_has_no_room_for_any_opening_names_what_was_tried() -> None:
    notes = picked_among(0.002, None).notes
    assert any("gripper 69.0 mm open: finger_" in note for note in notes)
    assert any("gripper 57.0 mm open: finger_" in note for note in notes)
    assert any("gripper 51.0 mm open: finger_" in note for note in notes)


@pytest.mark.parametrize(("gap", "width"), [(0.03, 0.069), (0.02, 0.051)])
def test_a_place_beside_another_opens_as_far_as_there_is_room(gap: float, width: float) -> None:
    block, stands = ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.33, 0.0, 0.0235))
    beside = ps.Obstacle("other", block, ps.Pose((0.2, 0.28, 0.0235)))
    scene = ps.load_scene("table").with_obstacle(ps.Obstacle("block", block, stands)).with_obstacle(beside)
    service = ps.PlannerService("wxai", scene)
    grasps = ps.top_grasps(service.robot, scene.obstacle("block"))
    handling = ps.Handling(support="table")
    taken = ps.pick(service, service.robot.home, "block", grasps, handling)
    there = ps.Pose((0.2, 0.235 - gap, 0.0235))
    put = ps.place(ps.PlannerService.of(taken.world), taken.q, "block", [there], handling)
    assert put.ok
    assert put.segments[-1].width == pytest.approx(width)


# --- what the request says holds on the straight lines too

SLOW_AND_SMOOTH = {"velocity_scale": 0.5, "acceleration_scale": 0.6, "max_tool_speed": 0.08, "padding": 0.003}


def asked(service: ps.PlannerService, **settings: object) -> ps.PlanRequest:
    return ps.PlanRequest(service.robot.home, service.robot.home, **settings)  # type: ignore[arg-type]


def test_every_motion_of_a_pick_and_place_obeys_the_request() -> None:
    service = ps.PlannerService("wxai", ps.load_scene("bin").without("demo_post"))
    request = asked(service, timing=ps.SCurve(), **SLOW_AND_SMOOTH)
    task = plan_pick_place(service, "blue_block", "tray", request)
    assert task.failure is None
    assert len(task.segments) == 7
    for segment in task.segments:
        motion = present(segment.result.motion)
        assert segment.result.stage(ps.Stage.TIMING).note.startswith("s-curve")
        assert motion.peaks.jerk.ratio <= 1.0 + 1e-9
        assert motion.peaks.velocity.ratio <= 1.0 + 1e-9
        assert motion.tool_speed <= 0.08 * (1.0 + 1e-6)
        told = any("less than the padding of 3 mm" in note for note in segment.result.notes)
        assert segment.result.padding == 0.003 or told


def test_the_time_limit_is_for_the_whole_pick(cell: ps.PlannerService) -> None:
    task = picked(cell, request=asked(cell, time_limit=0.0))
    assert present(task.failure).reason is ps.Reason.TIMED_OUT
    late = picked(cell, request=asked(cell, time_limit=1e-3))
    assert present(late.failure).reason is ps.Reason.TIMED_OUT


def test_a_task_whose_start_touches_something_begins_by_leaving_it_and_is_proven_as_a_whole() -> None:
    service = ps.PlannerService("wxai", "bin")
    certifier = Certifier(service.robot, service.scene)
    start, _ = next(starts_of(service, certifier, np.random.default_rng(1), itself=False))
    request = ps.PlanRequest(start, start)
    task = plan_pick_place(service, "blue_block", "tray", request)
    assert task.ok
    assert [segment.name for segment in task.segments][:2] == ["leave", "home -> pregrasp"]
    assert task.segments[0].result.exempt
    assert not any(each.depth is not None for segment in task.segments[1:] for each in segment.result.exempt)
    assert recertify(task).certified
    refused = plan_pick_place(service, "blue_block", "tray", replace(request, start_overlap=0.0))
    assert present(refused.failure).reason is ps.Reason.START_IN_COLLISION


def test_a_place_that_cannot_be_reached_says_what_turn_of_the_tool_would_do(cell: ps.PlannerService) -> None:
    taken = picked(cell)
    put = ps.place(ps.PlannerService.of(taken.world), taken.q, "block", yaws(0.30, 0.25, 0.33))
    failure = present(put.failure)
    assert "the position is within reach, but with the tool turned by 0.5" in failure.detail
    assert 0.5 < present(failure.unreachable).turn < 0.6
