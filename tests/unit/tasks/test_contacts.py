"""Kinds of grasps: the next one is looked for where none of the one before has a plan."""

from __future__ import annotations

import re
from typing import Any

import pytest

import planner_service as ps
from planner_service.errors import InvalidRequest
from planner_service.grasping import GraspKind, GraspKinds
from planner_service.grasping import grasps as measures
from planner_service.planning.result import Reason
from planner_service.records.recertify import recertify
from planner_service.tasks import Task, contacts, pick_steps
from tests.support.optional import present

HOME = ps.load_robot("wxai").home
ON_TABLE = ps.Handling(support="table")
NO_CLOCK = ps.PlanRequest(HOME, HOME, time_limit=None)
"""Finding grasps takes a second, more if others are at work."""
ALL_OF_THEM = "planner_service.grasping.kinds.antipodal_grasps"


@pytest.fixture(scope="module")
def table() -> ps.PlannerService:
    block = ps.Obstacle("block", ps.Box((0.045, 0.045, 0.045)), ps.Pose((0.28, 0.10, 0.0215)))
    return ps.PlannerService("wxai", ps.load_scene("table").with_obstacle(block))


@pytest.fixture(scope="module")
def shelf(table: ps.PlannerService) -> ps.PlannerService:
    """A can under a board: there is no room above it for the gripper."""
    can = ps.Obstacle("can", ps.Cylinder(0.025, 0.11), ps.Pose((0.40, 0.0, 0.0551)))
    board = ps.Obstacle("board", ps.Box((0.24, 0.40, 0.01)), ps.Pose((0.43, 0.0, 0.245)))
    return table.with_scene(ps.load_scene("table").with_obstacle(can).with_obstacle(board))


def refused(*args: Any, **settings: Any) -> Any:
    raise AssertionError("antipodal grasps are looked for only if no other grasp has a plan")


def bits(task: ps.TaskResult) -> list[bytes]:
    return [segment.result.unwrap()[0].waypoints.tobytes() for segment in task.segments]


def test_where_a_grasp_from_above_has_a_plan_no_other_is_looked_for(
    table: ps.PlannerService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ALL_OF_THEM, refused)
    monkeypatch.setattr("planner_service.grasping.kinds.side_grasps", refused)
    top = ps.top_grasps(table.robot, table.scene.obstacle("block"))
    given, chosen = (ps.pick(table, table.robot.home, "block", grasps, ON_TABLE) for grasps in (top, None))
    assert bits(given) == bits(chosen)
    assert (given.counts, given.notes, given.choosing) == (chosen.counts, chosen.notes, chosen.choosing)


def test_a_can_under_a_board_is_taken_from_the_side(shelf: ps.PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    top = GraspKinds([GraspKind.TOP])
    assert not ps.pick(shelf, shelf.robot.home, "can", top, ON_TABLE).ok
    monkeypatch.setattr(ALL_OF_THEM, refused)
    one, two = (ps.pick(shelf, shelf.robot.home, "can", grasps, ON_TABLE) for grasps in (None, GraspKinds()))
    assert one.notes[0].startswith("way 49 of 64, side grasp, ")
    assert recertify(one).certified
    assert (bits(one), one.counts, one.notes) == (bits(two), two.counts, two.notes)


def test_grasps_are_worked_out_as_their_turn_comes(table: ps.PlannerService, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[ps.Pose] = []
    width_across = measures.width_across

    def told(target: ps.Obstacle, grasp: ps.Pose, robot: ps.Robot) -> float:
        asked.append(grasp)
        return width_across(target, grasp, robot)

    monkeypatch.setattr(contacts, "width_across", told)
    task = table.solve(Task(pick_steps("block", None, ON_TABLE)), table.robot.home)
    assert task.notes[0].startswith("way 1 of 20, ")
    assert len(asked) == 1


def test_a_failure_says_of_each_kind_how_many_there_were_and_why_none_would_do(table: ps.PlannerService) -> None:
    can = ps.Obstacle("can", ps.Cylinder(0.03, 0.12), ps.Pose((0.95, 0.0, 0.061)))
    far = table.with_scene(table.scene.with_obstacle(can))
    task = far.solve(Task(pick_steps("can", GraspKinds(most=20), ON_TABLE)), far.robot.home, request=NO_CLOCK)
    found = re.fullmatch(
        r"Grasp can: none of (\d+) ways has a plan: 40 top grasps: way 1: out of reach; way 2: out of reach; "
        r"24 side grasps: way 41: out of reach; way 42: out of reach; "
        r"(\d+) antipodal grasps: way 65: out of reach; way 66: out of reach; way \d+ comes nearest: .*",
        present(task.failure).detail,
    )
    ways, last = map(int, present(found).groups())
    assert ways == 64 + last
    (grasp,) = (step for step in task.steps if step.step == "3 Grasp can")
    assert dict(grasp.reasons) == {"out of reach": 40, "side: out of reach": 24, "antipodal: out of reach": last}
    assert grasp.tried == grasp.failed == ways


def test_kinds_that_have_no_grasp_at_all_say_what_they_expected(table: ps.PlannerService) -> None:
    crate = ps.Obstacle("crate", ps.Box((0.1, 0.1, 0.1)), ps.Pose((0.3, 0.1, 0.051)))
    wide = table.with_scene(ps.load_scene("table").with_obstacle(crate))
    task = wide.solve(Task(pick_steps("crate", None, ON_TABLE)), HOME, request=NO_CLOCK)
    assert present(task.failure).reason is Reason.PLANNING_FAILED
    wanted = "expected an object at most 0.080 m wide; this one is 0.100 m"
    begin = f"Grasp crate: no top grasp: {wanted}; no side grasp: {wanted}; no antipodal grasp: expected an object with"
    assert present(task.failure).detail.startswith(begin)
    with pytest.raises(InvalidRequest, match=r"target: got 'crate'; expected an object at most 0\.080 m wide"):
        ps.pick(wide, HOME, "crate")


def test_a_cancelled_task_does_not_look_for_another_kind(shelf: ps.PlannerService) -> None:
    cancel = ps.CancelToken()

    class Sides(GraspKinds):
        """Cancels once the first kind was found."""

        def _of(self, kind: GraspKind, robot: ps.Robot, target: ps.Obstacle) -> tuple[ps.Pose, ...]:
            assert not cancel.cancelled
            cancel.cancel()
            return ()

    task = ps.pick(shelf, shelf.robot.home, "can", Sides(), ps.Handling(support="table", cancel=cancel))
    assert present(task.failure).reason is Reason.PREEMPTED


def test_a_grasp_that_is_too_narrow_for_the_wanted_opening_is_named_by_its_number(table: ps.PlannerService) -> None:
    long = ps.Obstacle("long", ps.Box((0.03, 0.07, 0.04)), ps.Pose((0.28, 0.10, 0.019)))
    service = table.with_scene(ps.load_scene("table").with_obstacle(long))
    handling = ps.Handling(support="table", open_width=0.05)
    task = ps.pick(service, service.robot.home, "long", None, handling)
    assert task.ok, "across the short side"
    narrow = [note for note in task.notes if "open_width" in note]
    assert narrow == ["way 1: open_width: got 0.05; expected at least the object's width, 0.0700 m"]
