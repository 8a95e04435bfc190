"""Constraints of tool lines and arcs, of picks and places, and of what the robot carries."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from planner_service import (
    Attached,
    Box,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Scene,
    TaskResult,
    inverse_kinematics,
)
from planner_service.constraints import Constraint, JointRange, KeepOrientation, KeepUpright, OnLine, OnPlane
from planner_service.planning.result import Reason
from planner_service.records.plan_file import SavedTask, load_task
from planner_service.records.recertify import recertify
from planner_service.tasks import move_linear
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present

DOWN = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
START = (0.25, 0.0, 0.12)
FORWARD = (0.05, 0.0, 0.0)


@cache
def service() -> PlannerService:
    return PlannerService("wxai", "bin")


@cache
def nothing_there() -> PlannerService:
    return PlannerService("wxai", Scene())


@cache
def start() -> tuple[float, ...]:
    """The tool at ``START``, pointing down."""
    return tuple(inverse_kinematics(service().robot, Pose(START, DOWN))[0].tolist())


def line(length: float, tolerance: float) -> Constraint:
    return OnLine(START, (START[0] + length, *START[1:]), tolerance)


def names(result: PlanResult) -> list[str]:
    return [kept.name for kept in present(result.certificate).kept]


# Along a given path of the tool.


def test_a_line_ends_where_it_leaves_a_constraint() -> None:
    short = [line(0.03, 0.001)]  # of 5 cm
    result = move_linear(nothing_there(), start(), FORWARD, constraints=short)
    assert present(result.failure).reason is Reason.CONSTRAINT_NOT_CERTIFIED
    assert "the straight tool line ends after 61.0 %: it does not keep line: z is" in present(result.failure).detail
    part = move_linear(nothing_there(), start(), FORWARD, constraints=short, partial=True)
    assert part.ok
    assert names(part) == ["line"]
    tool = nothing_there().robot.tool_pose(present(part.path).waypoints[-1])
    assert tool[0, 3] - START[0] == pytest.approx(0.05 * present(part.fraction), abs=1e-6)
    assert present(part.fraction) == pytest.approx(0.61, abs=0.001)


@pytest.mark.parametrize("zone", [0.0, 0.01])
def test_lines_with_corners_keep_them(zone: float) -> None:
    asked = [OnPlane(Pose(START), 0.0003), KeepOrientation(Pose(START, DOWN), 0.002)]
    result = move_linear(nothing_there(), start(), [FORWARD, (0.0, 0.04, 0.0)], zone=zone, constraints=asked)
    assert result.ok
    assert names(result) == ["plane", "orientation"]
    stops = [k for k in present(result.path).corners if present(result.path).blends[k] == 0.0]
    assert len(stops) == (1 if zone == 0.0 else 0)


def test_a_polyline_that_breaks_them_between_its_waypoints_is_refused() -> None:
    robot = nothing_there().robot
    ends = [start(), inverse_kinematics(robot, Pose((0.32, 0.0, 0.12), DOWN), still=np.array(start()))[0].tolist()]
    result = nothing_there().follow(ends, constraints=[OnPlane(Pose(START), 0.001)])
    assert present(result.failure).reason is Reason.CONSTRAINT_NOT_CERTIFIED
    assert nothing_there().follow(ends, constraints=[OnPlane(Pose(START), 0.1)]).ok


# Picked and placed.


@cache
def upright_task() -> TaskResult:
    home = service().robot.home
    return plan_pick_place(service(), "blue_block", "tray", PlanRequest(home, home), upright=0.05)


def lean(task: TaskResult, name: str) -> float:
    """How far the object leans at most from how it stood, sampled along one motion, in radians."""
    segment = next(each for each in task.segments if each.name == name)
    scene, robot = present(segment.scene), service().robot
    (held,) = scene.attached
    path = present(segment.result.path)
    poses = [robot.tool_pose(q) @ held.pose.matrix for q in path(np.linspace(0.0, path.length, 500))]
    return max(math.acos(min(1.0, float(pose[2, 2]))) for pose in poses)


def test_what_is_picked_upright_stays_so_until_it_stands_again() -> None:
    task = upright_task()
    assert task.failure is None
    carried = {"lift", "transfer", "lower"}
    assert {s.name for s in task.segments if s.result.constraints} == carried
    for name in carried:
        assert lean(task, name) <= 0.05
    home = service().robot.home
    free = plan_pick_place(service(), "blue_block", "tray", PlanRequest(home, home))
    assert lean(free, "transfer") > 0.05
    assert task.notes[0] == free.notes[0]  # the same grasp


def test_a_saved_task_is_proven_to_keep_what_it_carries_upright(tmp_path: Path) -> None:
    upright_task().save(tmp_path / "task.json")
    saved = load_task(tmp_path / "task.json")
    proven = recertify(saved, service()).required()
    kept = {each.name: [k.name for k in each.certificate.kept] for each in proven.motions}
    assert {name for name, all_kept in kept.items() if all_kept == ["upright"]} == {"lift", "transfer", "lower"}


def test_a_task_that_breaks_what_its_object_asks_for_is_refused() -> None:
    """As from a file: the motions say nothing of constraints, the object that is carried does."""
    home = service().robot.home
    free = plan_pick_place(service(), "blue_block", "tray", PlanRequest(home, home))
    asks = next(s.scene for s in upright_task().segments if s.name == "lift")
    (held,) = present(asks).attached

    def carrying(scene: Scene) -> Scene:
        return replace(scene, attached=tuple(replace(each, constraints=held.constraints) for each in scene.attached))

    segments = [
        replace(s, scene=carrying(present(s.scene)), result=replace(s.result, origin=None)) for s in free.segments
    ]
    found = recertify(replace(SavedTask.of(free), segments=tuple(segments)), service())
    assert any("transfer: upright is not proven kept" in problem for problem in found.problems)


# Carried.


def carrying(*constraints: Constraint) -> PlannerService:
    cup = Attached("cup", Box((0.02, 0.02, 0.02)), Pose((0.03, 0.0, 0.0)), ("finger_left", "finger_right"), constraints)
    return PlannerService("wxai", Scene(attached=(cup,)))


def test_every_motion_keeps_what_is_carried_as_it_asks() -> None:
    upright = KeepUpright((-1, 0, 0), 0.1)
    with_cup = carrying(upright)
    goal = Pose((0.25, 0.2, 0.12), DOWN)
    planned = with_cup.plan(PlanRequest(start(), goal))
    moved = move_linear(with_cup, start(), FORWARD)
    followed = with_cup.follow(present(planned.path).waypoints)
    for result in (planned, moved, followed):
        assert result.ok
        assert result.constraints == (upright,)
        assert names(result) == ["upright"]
    both = with_cup.plan(PlanRequest(start(), goal, constraints=[JointRange("joint_0", -1.0, 1.0), upright]))
    assert names(both) == ["joint_0", "upright"]
