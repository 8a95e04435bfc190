"""Tasks as values: what comes before a step is chosen so that what follows has a plan."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import planner_service as ps
from auditor.verify import verify
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.planning.result import Reason
from planner_service.records.evidence import with_evidence
from planner_service.records.exports.robot_programs import program_text
from planner_service.records.plan_file import SavedTask, load_task
from planner_service.records.recertify import recertify
from planner_service.tasks import (
    Alternatives,
    Approach,
    Connect,
    Follow,
    Grasp,
    MoveCircular,
    MoveLinear,
    MoveTo,
    ProvenWay,
    Release,
    Repeat,
    Retreat,
    Task,
    Wait,
    explain_task,
    pick_steps,
    place_steps,
    proven_ways,
)
from tests.support.optional import present

HALF = 0.0225
ON_TABLE = ps.Handling(support="table")


@pytest.fixture(scope="module")
def cell() -> ps.PlannerService:
    scene = ps.load_scene("table")
    block = ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.28, 0.10, HALF - 0.001)))
    return ps.PlannerService("wxai", scene.with_obstacle(block))


def turned(x: float, y: float, z: float, yaw: float = 0.0) -> ps.Pose:
    return ps.Pose((x, y, z), (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)))


THERE = turned(0.28, -0.10, HALF - 0.001)


def moved(cell: ps.PlannerService, *poses: ps.Pose, grasps: tuple[ps.Pose, ...] | None = None) -> Task:
    """From where it stands to one of some poses, and home."""
    found = grasps or ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    return Task((pick_steps("block", found, ON_TABLE), place_steps("block", poses, ON_TABLE), MoveTo("home")))


def bits(segments: tuple[object, ...]) -> list[bytes]:
    return [present(segment.result.path).waypoints.tobytes() for segment in segments]  # type: ignore[attr-defined]


def test_a_task_is_the_pick_the_place_and_the_motion_that_a_person_would_write(cell: ps.PlannerService) -> None:
    task = cell.solve(moved(cell, THERE), cell.robot.home)
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    taken = ps.pick(cell, cell.robot.home, "block", grasps, ON_TABLE)
    put = ps.place(ps.PlannerService.of(taken.world), taken.q, "block", [THERE], ON_TABLE)
    home = ps.PlannerService.of(put.world).plan(ps.PlanRequest(put.q, cell.robot.home))
    assert task.ok
    assert bits(task.segments[:-1]) == bits((*taken.segments, *put.segments))
    assert present(task.segments[-1].result.path).waypoints.tobytes() == present(home.path).waypoints.tobytes()
    apart = taken.counts + put.counts + home.counts
    assert task.counts == replace(apart, states=apart.states - 1), "that the place begins where the pick ends is known"
    assert task.world.scene == put.world.scene
    assert recertify(task).certified


def test_the_same_task_has_the_same_bits_and_counts_each_time(cell: ps.PlannerService) -> None:
    again = ps.PlannerService(cell.robot, cell.scene)
    one, two = (each.solve(moved(each, THERE), each.robot.home) for each in (cell, again))
    assert bits(one.segments) == bits(two.segments)
    assert (one.counts, one.notes) == (two.counts, two.notes)
    assert [(step.tried, step.failed, step.reasons) for step in one.steps] == [
        (step.tried, step.failed, step.reasons) for step in two.steps
    ]


def beside_a_wall(cell: ps.PlannerService) -> ps.PlannerService:
    """Beside the place a wall stands so near that the fingers have to be along it."""
    wall = ps.Obstacle("wall", ps.Box((0.2, 0.01, 0.06)), ps.Pose((0.28, -0.10 - HALF - 0.008, 0.03)))
    return cell.with_scene(cell.scene.with_obstacle(wall))


def test_a_grasp_whose_object_could_not_be_set_down_is_skipped_without_a_search(cell: ps.PlannerService) -> None:
    walled = beside_a_wall(cell)
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    taken = ps.pick(walled, cell.robot.home, "block", grasps, ON_TABLE)
    put = ps.place(ps.PlannerService.of(taken.world), taken.q, "block", [THERE], ON_TABLE)
    assert taken.ok
    assert not put.ok, "the grasp that is best by itself is a dead end"
    task = walled.solve(moved(walled, THERE), cell.robot.home)
    assert task.ok
    assert recertify(task).certified
    connects = [step for step in task.steps if "Connect" in step.step]
    assert [(step.tried, step.failed) for step in connects] == [(1, 0), (1, 0)]
    assert any("then Release block has no way" in note for note in task.notes)


def test_a_failure_names_the_step_its_cause_and_how_often(cell: ps.PlannerService) -> None:
    far = turned(0.9, 0.0, HALF)
    task = cell.solve(moved(cell, far), cell.robot.home)
    failure = present(task.failure)
    assert failure.detail.startswith("Release block: the only way has no plan: way 1: out of reach")
    assert present(failure.unreachable).gap > 0.1
    release = next(step for step in task.steps if step.step == "7 Release block")
    assert release.tried == release.failed > 0
    assert release.reasons == (("out of reach", release.failed),)
    assert [step.tried for step in task.steps[-2:]] == [0, 0], "nothing was tried after it"


def test_a_motion_in_vain_is_told_with_what_explain_takes(cell: ps.PlannerService) -> None:
    goal = np.array([0.8, 1.3, 1.0, -0.8, 0.0, 0.0])
    ball = ps.Obstacle("ball", ps.Sphere(0.05), ps.Pose.from_matrix(cell.robot.tool_pose(goal)))
    cage = cell.with_scene(cell.scene.with_obstacle(ball))
    task = cage.solve(Task((MoveTo(goal, name="into the ball"),)), cell.robot.home)
    assert present(task.failure).reason is Reason.GOAL_IN_COLLISION
    refused = present(task.steps[0].refused)
    assert present(refused.origin).world is cage.world
    assert np.array_equal(np.asarray(present(present(refused.origin).request).goal), goal)


def test_the_next_pose_of_the_goal_is_tried_where_what_follows_has_no_plan(cell: ps.PlannerService) -> None:
    down = (0.7071067811865476, 0.0, 0.7071067811865476, 0.0)
    near, blocked = ps.Pose((0.25, -0.12, 0.13), down), ps.Pose((0.25, 0.0, 0.09), down)
    steps = (MoveTo([blocked, near]), MoveLinear((0.0, 0.0, -0.10)))
    task = cell.solve(Task(steps), cell.robot.home)
    assert task.ok
    assert [(step.tried, step.failed) for step in task.steps] == [(2, 0), (2, 1)]
    alone = cell.solve(Task((MoveTo([blocked]), steps[1])), cell.robot.home)
    assert present(alone.failure).detail.startswith("MoveLinear line: ")


def test_alternatives_are_tried_in_their_order(cell: ps.PlannerService) -> None:
    far, near = place_steps("block", [turned(0.9, 0.0, HALF)], ON_TABLE), place_steps("block", [THERE], ON_TABLE)
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    task = cell.solve(Task((pick_steps("block", grasps, ON_TABLE), Alternatives((far, near)))), cell.robot.home)
    assert task.ok
    assert task.world.scene.obstacle("block").pose == THERE


def test_what_is_repeated_is_done_so_often(cell: ps.PlannerService) -> None:
    up, down = MoveLinear((0.0, 0.0, 0.02), name="up"), MoveLinear((0.0, 0.0, -0.02), name="down")
    task = cell.solve(Task((Repeat((up, down), 3),)), cell.robot.home)
    assert [segment.name for segment in task.segments] == ["up", "down"] * 3
    assert [step.tried for step in task.steps] == [3, 3]


def between_plates() -> ps.PlannerService:
    """A block in a slot where fingers fit along y alone, and a rack where they fit along x alone."""
    scene = ps.load_scene("table")
    scene = scene.with_obstacle(ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), turned(0.28, 0.14, HALF - 0.001)))
    for name, y, dx, dy in (("slot", 0.14, 0.0, 0.036), ("rack", -0.14, 0.036, 0.0)):
        for sign in (-1, 1):
            plate = ps.Box((0.01, 0.07, 0.06) if dx else (0.07, 0.01, 0.06))
            there = ps.Pose((0.28 + sign * dx, y + sign * dy, 0.03))
            scene = scene.with_obstacle(ps.Obstacle(f"{name} {sign}", plate, there))
    return ps.PlannerService("wxai", scene)


def test_an_object_is_set_down_in_between_and_grasped_anew_where_no_grasp_suits_both_places() -> None:
    service, there = between_plates(), turned(0.28, -0.14, HALF - 0.001)
    take, put = pick_steps("block", handling=ON_TABLE), place_steps("block", [there], ON_TABLE)
    aside = place_steps("block", [turned(0.30, 0.0, HALF - 0.001)], ON_TABLE)
    direct = service.solve(Task((take, put)), service.robot.home)
    assert re.match("Release block: .* finger_.* x rack", present(direct.failure).detail)
    assert not direct.segments
    assert [step.tried for step in direct.steps if "Connect" in step.step] == [0, 0], "nothing was searched for"
    task = service.solve(Task((take, Alternatives(((), (aside, take))), put)), service.robot.home)
    assert task.ok
    assert len(task.segments) == 12
    assert task.world.scene.obstacle("block").pose == there
    assert recertify(task).certified


def test_a_place_relative_to_an_obstacle_moves_with_it(cell: ps.PlannerService) -> None:
    mat = ps.Obstacle("mat", ps.Box((0.1, 0.1, 0.001)), ps.Pose((0.28, -0.10, -0.0005)))
    on_mat = ps.Pose((0.0, 0.0, HALF))
    service = cell.with_scene(cell.scene.with_obstacle(mat))
    release = Release("block", [on_mat], frame="mat", support="mat")
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    task = service.solve(
        Task((pick_steps("block", grasps, ON_TABLE), Connect(), Approach(), release, Retreat())), cell.robot.home
    )
    assert task.ok
    assert task.world.scene.obstacle("block").pose.position == pytest.approx((0.28, -0.10, HALF - 0.0005))


def test_lines_arcs_and_given_waypoints_follow_each_other(cell: ps.PlannerService) -> None:
    home = cell.robot.home
    there = home + np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    steps = (
        MoveLinear((0.0, 0.05, 0.0)),
        MoveCircular((0.0, 0.02, -0.02), (0.0, 0.04, 0.0)),
        Connect("back"),
        Follow([home, there]),
        MoveTo(),
    )
    task = cell.solve(Task(steps), home)
    assert [segment.name for segment in task.segments] == ["line", "arc", "back", "follow", "move"]
    assert np.array_equal(task.q, home)
    assert recertify(task).certified


def test_a_retreat_ends_where_the_fingers_have_left_the_object(cell: ps.PlannerService) -> None:
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"))
    near = Approach("lower"), Release("block", [THERE], open_width=0.0451, support="table"), Retreat("away", (0.002,))
    task = cell.solve(Task((pick_steps("block", grasps, ON_TABLE), Connect(), *near)), cell.robot.home)
    assert re.match("Retreat away: .*finger_.* x block still touch", present(task.failure).detail)


def test_ways_that_are_looked_at_are_limited_too(cell: ps.PlannerService) -> None:
    walled = beside_a_wall(cell)
    task = walled.solve(moved(walled, THERE), cell.robot.home, searches=1)
    assert "the lines of 3 ways were looked at" in present(task.failure).detail


def test_searches_are_limited_by_their_number(cell: ps.PlannerService) -> None:
    task = cell.solve(moved(cell, THERE), cell.robot.home, searches=2)
    assert "all 2 searches were tried" in present(task.failure).detail
    assert len(task.segments) == 6, "as far as there are plans"


@pytest.mark.parametrize(
    ("steps", "error", "message"),
    [
        ((Grasp("blok"),), ps.UnknownName, "unknown obstacle 'blok'; did you mean 'block'"),
        ((MoveTo("hom"),), ps.UnknownName, "unknown pose 'hom'; did you mean 'home'"),
        (place_steps("block", [THERE]), ps.UnknownName, "unknown carried object 'block'"),
        ((MoveLinear(THERE, frame="tabel"),), ps.UnknownName, "unknown obstacle 'tabel'; did you mean 'table'"),
        (
            (Alternatives((pick_steps("block"), MoveTo())), MoveTo()),
            ps.InvalidRequest,
            "ones that all end with the same objects carried",
        ),
    ],
)
def test_what_is_not_there_is_named_before_anything_is_planned(
    cell: ps.PlannerService, steps: tuple[object, ...], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        cell.solve(Task(steps), cell.robot.home)


def test_a_chain_of_approaches_and_retreats_ends_at_the_contact_and_is_proven_from_its_file(
    cell: ps.PlannerService, tmp_path: Path
) -> None:
    grasps = ps.top_grasps(cell.robot, cell.scene.obstacle("block"), tilts=(0.26,))  # up is not along the gripper
    down, back = Approach("down", (0.01,), direction=(0.0, 0.0, -1.0)), Retreat("up", (0.01,), (0.0, 0.0, 1.0))
    steps = (
        *(
            Connect(),
            Approach("in"),
            Grasp("block", grasps, support="table"),
            replace(back, name="off"),
            Retreat("out"),
        ),
        *(Connect(), Approach("sideways", (0.05,), direction=(0.0, -1.0, 0.0)), down),
        *(Release("block", [THERE], support="table"), back, Retreat("away", (0.05,))),
    )
    task = cell.solve(Task(steps), cell.robot.home)
    assert task.ok
    names = ["transfer", "in", "off", "out", "transfer", "sideways", "down", "up", "away"]
    assert [segment.name for segment in task.segments] == names
    ends = [cell.robot.tool_pose(present(s.result.path).waypoints[-1])[:3, 3] for s in task.segments[4:8]]
    steps_between = [after - before for before, after in pairwise(ends)]
    assert steps_between[0] == pytest.approx([0.0, -0.05, 0.0], abs=1e-6)
    assert steps_between[1] == pytest.approx([0.0, 0.0, -0.01], abs=1e-6)
    assert steps_between[2] == pytest.approx([0.0, 0.0, 0.01], abs=1e-6)
    task.save(tmp_path / "task.json")
    assert recertify(load_task(tmp_path / "task.json")).certified
    document = json.loads(with_evidence(SavedTask.of(task)).file_text())
    said = [*verify(document)]
    assert sum("a thing and what it stands on" in each for each in said) == 2


def test_a_failed_task_prints_how_its_steps_fared(cell: ps.PlannerService) -> None:
    task = cell.solve(moved(cell, turned(0.9, 0.0, HALF)), cell.robot.home)
    lines = str(task).splitlines()
    table = lines[lines.index("") + 1 :]
    assert table[0].split() == ["step", "tried", "failed", "most", "frequent", "reasons"]
    assert any(line.split()[:3] == ["7", "Release", "block"] and line.endswith("out of reach (18)") for line in table)
    assert "most frequent reasons" not in str(cell.solve(moved(cell, THERE), cell.robot.home))


def test_proven_ways_are_those_of_a_pick_without_the_motion_that_leads_there(cell: ps.PlannerService) -> None:
    steps = pick_steps("block", None, ON_TABLE)
    ways = [*proven_ways(cell, steps, cell.robot.home)]
    task = cell.solve(Task(steps), cell.robot.home)
    assert bits(ways[0].segments) == bits(task.segments[1:])
    assert np.array_equal(ways[0].q_in, present(task.segments[0].result.path).waypoints[-1])
    assert np.array_equal(ways[0].q_out, task.q)
    assert len({way.number for way in ways}) > 4
    assert all(recertify_ends(way) for way in ways)


def recertify_ends(way: ProvenWay) -> bool:
    """Whether it begins where its first motion does, and ends where the last does."""
    first, last = (present(segment.result.path).waypoints for segment in (way.segments[0], way.segments[-1]))
    return np.array_equal(first[0], way.q_in) and np.array_equal(last[-1], way.q_out)


def test_what_would_help_is_told_of_the_motion_that_was_searched_in_vain(cell: ps.PlannerService) -> None:
    goal = np.array([0.8, 1.3, 1.0, -0.8, 0.0, 0.0])
    ball = ps.Obstacle("ball", ps.Sphere(0.05), ps.Pose.from_matrix(cell.robot.tool_pose(goal)))
    task = cell.with_scene(cell.scene.with_obstacle(ball)).solve(Task((MoveTo(goal),)), cell.robot.home)
    assert present(explain_task(task, plans=20, remedies=1)).remedies
    assert explain_task(cell.solve(Task((MoveTo(),)), cell.robot.home)) is None


def test_an_arm_waits_before_the_next_motion_in_the_file_and_in_the_program_too(
    cell: ps.PlannerService, tmp_path: Path
) -> None:
    steps = (Wait(0.5), MoveLinear((0.0, 0.0, 0.02)), Wait(1.0), Wait(0.25), MoveTo(), Wait(2.0))
    task = cell.solve(Task(steps), cell.robot.home)
    assert [(segment.name, segment.wait) for segment in task.segments] == [
        ("line", 0.5),
        ("move", 1.25),
        ("stand", 2.0),
    ]
    moving = sum(present(segment.result.trajectory).duration for segment in task.segments)
    assert task.duration == pytest.approx(moving + 3.75)
    task.save(tmp_path / "task.json")
    saved = load_task(tmp_path / "task.json")
    assert [segment.wait for segment in saved.segments] == [0.5, 1.25, 2.0]
    assert [*verify(json.loads(with_evidence(saved).file_text()))]
    assert recertify(saved).certified
    program = program_text("urscript", saved.segments, cell.robot)
    assert re.findall(r"sleep\((.*)\)", program) == ["0.500", "1.250", "2.000"]


def test_a_task_of_one_stage_names_its_step_too_with_the_reasons_of_that_step(cell: ps.PlannerService) -> None:
    roof = ps.Obstacle("roof", ps.Box((0.3, 0.3, 0.01)), ps.Pose((0.28, 0.10, 0.30)))
    low = cell.with_scene(cell.scene.with_obstacle(roof))
    for step, scene in ((MoveTo(ps.Pose((0.9, 0.0, 0.1))), cell), (MoveLinear((0.0, 0.0, 0.5)), cell)):
        task = scene.solve(Task((step,)), cell.robot.home)
        assert present(task.failure).detail.startswith(f"{step}: ")
    task = low.solve(Task(pick_steps("block", None, ON_TABLE)), cell.robot.home)
    named, _, detail = present(task.failure).detail.partition(": ")
    failed = next(report for report in task.steps if report.step.endswith(named))
    assert failed.tried == failed.failed
    assert any(reason in detail for reason, _ in failed.reasons)


def digest_of(service: ps.PlannerService) -> str:
    """A task with everything that is chosen in it, as text."""
    service = beside_a_wall(service)
    task = service.solve(moved(service, THERE), service.robot.home)
    paths = hashlib.sha256(b"".join(bits(task.segments))).hexdigest()
    return f"{paths} {task.counts} {task.notes} {[str(step) for step in task.steps]}"


@pytest.mark.slow
def test_another_process_with_other_hashes_chooses_the_same(cell: ps.PlannerService) -> None:
    code = """
import planner_service as ps
from tests.unit.tasks.test_solver import digest_of, HALF
block = ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.28, 0.10, HALF - 0.001)))
print(digest_of(ps.PlannerService("wxai", ps.load_scene("table").with_obstacle(block))))
"""
    told = {
        subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            check=True,
            cwd=Path(__file__).parents[3],
            env=os.environ | {"PYTHONHASHSEED": seed},
            text=True,
        ).stdout.strip()
        for seed in ("1", "2")
    }
    assert told == {digest_of(cell)}


def test_a_stage_is_given_up_when_its_searches_use_up_their_checks(cell: ps.PlannerService) -> None:
    request = ps.PlanRequest(cell.robot.home, cell.robot.home, time_limit=None, max_checks=3)
    task = cell.solve(Task(pick_steps("block", None, ON_TABLE)), cell.robot.home, request=request, beam=2)
    connect = task.steps[0]
    assert connect.tried == connect.failed == 3, "two searches, and that it was given up"
    assert ("given up: 2 searches used up their checks, or proved that there is no path", 1) in connect.reasons


def test_a_grasp_with_which_the_line_that_follows_is_impossible_costs_no_search(cell: ps.PlannerService) -> None:
    raised = cell.with_scene(cell.scene.moved("block", turned(0.28, 0.10, HALF + 0.001)))
    grasps = ps.top_grasps(cell.robot, raised.scene.obstacle("block"))
    able = [
        raised.solve(Task((Connect(), Approach("in", (0.02,)), Grasp("block", [grasp]), rise)), cell.robot.home).ok
        for rise in (MoveLinear((0.0, 0.0, 0.09), name="rise"),)
        for grasp in grasps
    ]
    order = sorted(range(len(grasps)), key=lambda k: able[k])  # those with which it is impossible come first
    assert not able[order[0]]
    assert able[order[-1]]
    mixed = Grasp("block", [grasps[order[0]], grasps[order[1]], grasps[order[-1]]])
    steps = (Connect(), Approach("in", (0.02,)), mixed, MoveLinear((0.0, 0.0, 0.09), name="rise"))
    task = raised.solve(Task(steps), cell.robot.home)
    assert task.ok
    assert task.steps[0].tried == 1, "one search"
    assert any(reason.startswith("then MoveLinear rise has no plan") for reason, _ in task.steps[2].reasons)


def test_fingers_that_cannot_close_are_refused_by_a_state_once_a_proof_has_failed() -> None:
    scene = ps.load_scene("table")
    scene = scene.with_obstacle(ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), turned(0.28, 0.14, HALF - 0.001)))
    for sign in (-1, 1):
        there = ps.Pose((0.28, 0.14 + sign * 0.031, 0.03))
        scene = scene.with_obstacle(ps.Obstacle(f"plate {sign}", ps.Box((0.07, 0.01, 0.06)), there))
    service = ps.PlannerService("wxai", scene)
    task = service.solve(Task(pick_steps("block", GraspKinds([GraspKind.TOP]), ON_TABLE)), service.robot.home)
    assert not task.ok
    reasons = dict(next(step for step in task.steps if "Grasp" in step.step).reasons)
    proofs = sum(times for reason, times in reasons.items() if "the gripper cannot close" in reason)
    states = sum(times for reason, times in reasons.items() if "touch where the gripper is closed" in reason)
    assert proofs == 1
    assert states > 10
