"""Nothing that a plan says of itself is believed: motions, time laws and exemptions are proven or derived anew."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from planner_service import (
    Attached,
    Box,
    Certificate,
    Handling,
    InvalidRequest,
    JointPath,
    NotProven,
    Obstacle,
    PlannerService,
    PlanRequest,
    PlanResult,
    Pose,
    Robot,
    Scene,
    SCurve,
    ToppRa,
    Trajectory,
    Trapezoidal,
    pick,
    top_grasps,
)
from planner_service.certify import ExemptInterval
from planner_service.cli import run
from planner_service.cli.commands import app
from planner_service.execute import execute
from planner_service.execute import stream as execution
from planner_service.kinematics.inverse import inverse_kinematics
from planner_service.kinematics.pose_goal import PoseGoal
from planner_service.kinematics.tool_line import straight_tool_line
from planner_service.planning.follow import AllowedStretch
from planner_service.planning.request import Pace, World
from planner_service.planning.task_result import TaskResult
from planner_service.records.evidence import save_plan
from planner_service.records.plan_file import SavedPlan, SavedTask, load_plan, load_task
from planner_service.records.recertify import recertify
from planner_service.tasks import Segment
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.arms import QUICK, FakeArm, FakeTime
from tests.support.optional import present

ABOVE_TRAY = Pose((0.20, 0.28, 0.15), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
ABOVE_TRAY_TURNED = ABOVE_TRAY @ Pose((0.0, 0.0, 0.0), (math.cos(0.2), math.sin(0.2), 0.0, 0.0))


@cache
def bin_() -> PlannerService:
    return PlannerService("wxai", "bin")


@cache
def home() -> Any:
    return bin_().robot.home


@cache
def good() -> PlanResult:
    """Around the post, to above the tray."""
    return bin_().plan(PlanRequest(home(), ABOVE_TRAY, seed=7))


@cache
def task() -> TaskResult:
    return plan_pick_place(bin_(), "blue_block", "tray", PlanRequest(home(), home(), seed=0))


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> SavedTask:
    """The same from a file."""
    path = tmp_path_factory.mktemp("tasks") / "task.json"
    save_plan(task(), path)
    return load_task(path)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    clock = FakeTime()
    monkeypatch.setattr(execution, "time", clock)
    return clock


def saved(service: PlannerService, result: PlanResult, folder: Path, request: PlanRequest | None = None) -> SavedPlan:
    """A plan as it comes back from a file."""
    save_plan(SavedPlan(service.world, request, result), folder / "plan.json")
    return load_plan(folder / "plan.json")


def along(result: PlanResult, path: JointPath, service: PlannerService, *exempt: ExemptInterval) -> PlanResult:
    """A plan whose path was replaced, with a certificate that says all is well."""
    motion = Trapezoidal().time_path(path, service.robot.limits)
    return replace(result, path=path, trajectory=motion, certificate=Certificate(0.05, 1000, 0.0, exempt))


def through_the_post(good: PlanResult, service: PlannerService, *exempt: ExemptInterval) -> PlanResult:
    path = JointPath(present(good.path).waypoints[[0, -1]])
    assert not service.certify(path).certified
    return along(good, path, service, *exempt)


def everything(service: PlannerService, length: float) -> ExemptInterval:
    links = dict.fromkeys(shape.link for shape in service.robot.shapes)
    pairs = tuple((link, obstacle.name) for link in links for obstacle in service.scene.obstacles)
    return ExemptInterval(0.0, length, pairs, "grasp")


def objections(plan: Any, **options: Any) -> str:
    return "\n".join(recertify(plan, **options).problems)


def refused(plan: Any, match: str, service: PlannerService, **options: Any) -> None:
    """Neither proven nor driven."""
    with pytest.raises(InvalidRequest, match=match):
        recertify(plan, **options).required()
    first: Any = plan.segments[0].result if isinstance(plan, SavedTask | TaskResult) else getattr(plan, "result", plan)
    arm = FakeArm(np.array(first.trajectory(0.0)))
    with pytest.raises(InvalidRequest, match=match):
        execute(plan, arm, service.robot, QUICK, **options)
    assert (arm.told, arm.widths) == ([], [])


def test_a_plan_as_planned_is_proven_from_memory_and_from_a_file(tmp_path: Path) -> None:
    for plan in (good(), saved(bin_(), good(), tmp_path)):
        found = recertify(plan)
        assert (found.certified, found.problems, found.not_checked) == (True, (), ())
        assert found.motions[0].certificate.clearance == present(good().certificate).clearance
        arm = FakeArm(np.array(bin_().robot.home))
        assert execute(plan, arm, bin_().robot, QUICK).ok


@pytest.mark.slow
def test_a_task_as_planned_is_proven_and_each_exemption_is_derived(read: SavedTask) -> None:
    fingers = "finger_left x blue_block, finger_right x blue_block"
    for plan in (task(), read):
        found = recertify(plan).required()
        assert [motion.name for motion in found.motions] == [segment.name for segment in task().segments]
        told = [(line.split(": ")[0], line.split(": ")[2]) for line in found.not_checked if "gripper" not in line]
        assert told == [
            ("descend", f"{fingers} (fingers may touch blue_block, which they take)"),
            ("lift", "blue_block x bin_floor (blue_block stood there)"),
            ("lower", "blue_block x tray (blue_block is to stand there)"),
            ("retreat", f"{fingers} (fingers may touch blue_block, which they leave)"),
        ]


def test_the_grippers_own_motion_is_proven_too_from_the_width_it_has(read: SavedTask) -> None:
    found = recertify(read).required()
    moved = {motion.name: motion.gripper.name for motion in found.motions if motion.gripper is not None}
    assert moved == {
        "home -> pregrasp": "gripper closes",
        "lift": "gripper closes",
        "retreat": "gripper opens",
    }
    assert sum("gripper" in line for line in found.not_checked) == 2
    tool = Pose.from_matrix(bin_().robot.tool_pose(bin_().robot.home))
    plate = Obstacle("plate", Box((0.02, 0.004, 0.02)), tool @ Pose((0.0, 0.0, 0.0)))
    beside = PlannerService(bin_().robot, Scene((plate,)))
    assert beside.checker.state_is_free(bin_().robot.home)
    assert not beside.changed(gripper=0.0).checker.state_is_free(bin_().robot.home)
    stay = beside.changed(gripper=0.03).plan(PlanRequest(bin_().robot.home, bin_().robot.home))
    stand = FakeArm(np.array(bin_().robot.home), width=0.06)
    assert execute(stay, stand, None, QUICK).ok
    stay = beside.plan(PlanRequest(bin_().robot.home, bin_().robot.home))
    stand = FakeArm(np.array(bin_().robot.home), width=0.0)
    with pytest.raises(NotProven, match=r"gripper cannot open from 0\.0 to 80\.0 mm: .* plate"):
        execute(stay, stand, None, QUICK)
    assert (stand.told, stand.widths) == ([], [])


@pytest.mark.slow
def test_a_gripper_that_is_told_to_press_is_free_to_close_that_far() -> None:
    plate = Obstacle("plate", Box((0.008, 0.045, 0.045)), Pose((0.28, 0.0, 0.03)))
    beside = Obstacle("beside", Box((0.004, 0.039, 0.045)), Pose((0.2875, 0.0, 0.03)))
    service = PlannerService("wxai", Scene((plate, beside)))
    robot = service.robot
    grasps = [Pose.from_rpy((0.28, 0.0, 0.03), (0.0, math.pi / 2, 0.0))]
    task = pick(service, robot.home, "plate", grasps)
    assert task.failure is None, task.failure
    assert recertify(task).certified
    arm = FakeArm(robot.home, stone=0.045)
    with pytest.raises(NotProven, match=r"lift: the gripper cannot close from 69\.0 to 35\.0 mm: finger_.* x beside"):
        execute(task, arm, None, QUICK)
    assert (arm.told, arm.widths) == ([], [])
    assert execute(task, arm, None, replace(QUICK, squeeze=0.001)).ok
    told = present(recertify(task, squeeze=0.001).motions[2].gripper)
    assert told.end == pytest.approx(0.044)
    assert arm.widths[-1] == pytest.approx(0.044)
    assert told.certificate.distances > 0


def test_a_result_of_this_process_is_proven_again_too() -> None:
    forged = through_the_post(good(), bin_())
    assert forged.origin is not None
    refused(forged, "is not proven apart", bin_())
    refused(replace(good(), trajectory=forged.trajectory), "a trajectory along another path than the plan's", bin_())


def test_an_exemption_over_everything_is_refused_in_two_lines_the_collision_first(tmp_path: Path) -> None:
    length = through_the_post(good(), bin_()).path.length  # type: ignore[union-attr]
    forged = through_the_post(good(), bin_(), everything(bin_(), length))
    plan = saved(bin_(), forged, tmp_path)
    refused(plan, "no rule of picking or placing allows that contact there", bin_())
    collision, exempt = recertify(plan).problems
    assert "is not proven apart" in collision
    assert re.search(r"^motion: base_link x table, .* and \d+ more pairs are not judged from s = 0 to ", exempt)
    one = ExemptInterval(0.0, length, (("link_4", "demo_post"),), "grasp")
    told = objections(saved(bin_(), through_the_post(good(), bin_(), one), tmp_path))
    assert "link_4 x demo_post is not judged from" in told
    assert "--allow link_4:demo_post (Python: allowed=[('link_4', 'demo_post')])" in told


def test_a_stretch_that_no_rule_gives_is_honoured_once_its_pairs_are_named_again(tmp_path: Path) -> None:
    path = present(good().path)
    stretch = AllowedStretch(0, 1, (("link_6", "demo_post"),), "camera mount")
    made = bin_().follow(path.waypoints, contacts=[stretch])
    for plan in (made, saved(bin_(), made, tmp_path)):
        assert "link_6 x demo_post is not judged from s = 0 to" in objections(plan)
        found = recertify(plan, allowed=[("demo_post", "link_6")]).required()
        assert [pair for line in found.not_checked for pair in [line.split(": ")[1]]] == [
            "link_6 x demo_post (named as a pair that may touch)"
        ]
        arm = FakeArm(np.array(bin_().robot.home))
        assert execute(plan, arm, bin_().robot, QUICK, allowed=[("link_6", "demo_post")]).ok
    with pytest.raises(InvalidRequest, match=r"a pair that this plan lets touch \(none"):
        recertify(good(), allowed=[("link_6", "demo_post")])


def test_pairs_that_a_plan_was_made_with_are_named_again_by_whoever_executes(tmp_path: Path) -> None:
    lenient = PlannerService("wxai", "bin", allowed=[("link_6", "demo_post")])
    made = lenient.plan(PlanRequest(home(), ABOVE_TRAY, seed=7))
    for plan in (made, saved(lenient, made, tmp_path)):
        refused(plan, "planned with demo_post x link_6 allowed to touch; .* --allow demo_post:link_6", lenient)
        found = recertify(plan, allowed=[("link_6", "demo_post")])
        assert (found.certified, found.allowed) == (True, (("demo_post", "link_6"),))
        assert recertify(plan, service=lenient).certified  # who gives a service that allows it has named it
        assert "allowed to touch all the time: demo_post x link_6" in found.not_checked


def test_the_robots_own_way_out_of_a_pose_is_exempt_there_and_nowhere_else(tmp_path: Path) -> None:
    asleep = bin_().robot.pose("sleep")
    for start, goal in ((asleep, home()), (home(), asleep)):
        made = bin_().plan(PlanRequest(start, goal))
        assert made.exempt
        assert made.certificate is not None
        assert recertify(saved(bin_(), made, tmp_path)).certified
        (own,) = made.exempt
        for wider in (
            replace(own, s_start=0.0, s_end=present(made.path).length),
            replace(own, pairs=(*own.pairs, ("link_1", "link_3"))),
        ):
            forged = replace(made, certificate=replace(made.certificate, exempt=(wider,)))
            refused(saved(bin_(), forged, tmp_path), "not judged from s", bin_())


@cache
def left_table() -> tuple[PlannerService, PlanResult]:
    """A plan from 1.5 mm inside the table to home."""
    service = PlannerService("wxai", "table")
    in_table = inverse_kinematics(service.robot, Pose((0.3, 0.0, -0.0025), ABOVE_TRAY.quaternion))[0]
    return service, service.plan(PlanRequest(in_table, service.robot.home))


def test_a_way_out_of_a_collision_is_worked_out_anew(tmp_path: Path) -> None:
    service, made = left_table()
    plan = saved(service, made, tmp_path)
    assert recertify(plan).certified
    assert execute(plan, FakeArm(np.array(present(made.path).waypoints[0])), service.robot, QUICK).ok
    certificate, (one, other) = present(made.certificate), made.exempt
    length = present(made.path).length
    for forged, why in (
        (replace(one, depth=None), "no rule of picking or placing allows"),
        (replace(one, depth=present(one.depth) + 1e-6), "where it begins, not by"),
        (replace(one, depth=present(one.depth) - 1e-6), "less than .* mm is allowed"),
        (replace(one, s_end=length), None),  # it has come apart long before, and is proven so all along
        (replace(one, s_end=0.5 * one.s_end), "is not proven apart|have not come apart"),
        (replace(one, s_start=1e-6), "only where the first motion begins|is not proven apart"),
        (replace(one, pairs=(("link_6", "table"),)), "they do not touch where the motion begins"),
    ):
        other_plan = replace(made, certificate=replace(certificate, exempt=(forged, other)))
        if why is not None:
            refused(saved(service, other_plan, tmp_path), why, service)


def test_a_way_out_of_more_than_was_asked_for_is_refused(tmp_path: Path) -> None:
    service, made = left_table()
    asked = PlanRequest(present(made.path).waypoints[0], service.robot.home, start_overlap=0.001)
    refused(saved(service, made, tmp_path, asked), "they overlap by 1.* mm, and start_overlap allows 1 mm", service)


def test_a_plan_that_begins_or_ends_elsewhere_than_its_request_asks_is_refused(tmp_path: Path) -> None:
    made, moved = good(), np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])
    asked = present(present(made.origin).request)
    for request, match in (
        (replace(asked, start=home() + moved), "it begins at 0, .*; its request at 0.1"),
        (replace(asked, goal=home()), "which is not goal 0"),
        (replace(asked, goal=Pose((0.20, 0.28, 0.151), ABOVE_TRAY.quaternion)), "which is not goal 0"),
        (replace(asked, goal=PoseGoal(ABOVE_TRAY_TURNED, free_axis=(0.0, 0.0, 1.0))), "which is not goal 0"),
    ):
        refused(saved(bin_(), made, tmp_path, request), match, bin_())
    for index in (None, 1):
        changed = replace(made, goal_index=index)
        refused(saved(bin_(), changed, tmp_path, asked), f"goal {index}; its request has 1", bin_())


def test_a_plan_that_rests_on_its_way_and_claims_its_goal_is_refused(tmp_path: Path) -> None:
    made, points = good(), present(good().path).waypoints
    path, asked = present(made.path), present(present(made.origin).request)
    line = JointPath(np.array([points[0], (points[0] + points[1]) / 2.0]))
    law = Trapezoidal().time_path(line, bin_().robot.limits)
    early = Trajectory(path, law.durations, law.coefficients, 1.0, (0.0, line.length))
    refused(saved(bin_(), replace(made, trajectory=early), tmp_path, asked), "which is not goal 0", bin_())
    assert not objections(saved(bin_(), replace(made, trajectory=early, goal_index=None), tmp_path, asked))


def test_a_plan_may_end_anywhere_within_the_room_of_its_goal(tmp_path: Path) -> None:
    asked = present(present(good().origin).request)
    near = Pose((0.20, 0.28, 0.151), ABOVE_TRAY.quaternion)
    for goal in (PoseGoal(near, position_tolerance=0.0011), PoseGoal(ABOVE_TRAY_TURNED, free_axis=(1.0, 0.0, 0.0))):
        assert not objections(saved(bin_(), good(), tmp_path, replace(asked, goal=goal)))


# Time laws.


def test_a_time_law_beyond_the_limits_is_refused(tmp_path: Path) -> None:
    fast = replace(good(), trajectory=present(good().trajectory).dilated(0.5))
    for plan in (fast, saved(bin_(), fast, tmp_path)):
        refused(plan, r"joint_\d reaches .* times the acceleration allowed", bin_())


@pytest.mark.parametrize(
    ("option", "value", "match"),
    [
        ("max_tool_speed", 0.05, r"the tool moves at .* m/s; the request allows 0\.05"),
        ("velocity_scale", 0.2, "times the velocity"),
        ("acceleration_scale", 0.1, "times the acceleration"),
        ("timing", SCurve(), "times the jerk"),
    ],
)
def test_a_motion_faster_than_was_asked_for_is_refused(option: str, value: Any, match: str, tmp_path: Path) -> None:
    slow = PlanRequest(home(), ABOVE_TRAY, seed=7, **{option: value})
    assert recertify(saved(bin_(), bin_().plan(slow), tmp_path, slow)).certified
    refused(saved(bin_(), good(), tmp_path, slow), match, bin_())


def test_a_saved_pick_keeps_what_it_was_asked_and_the_law_of_its_lines(tmp_path: Path) -> None:
    block = bin_().scene.obstacle("blue_block")
    asked = PlanRequest((), (), seed=3, acceleration_scale=0.5)
    handling = Handling(support="bin_floor", request=asked, line_timing=SCurve())
    pick(bin_(), home(), "blue_block", top_grasps(bin_().robot, block), handling).save(tmp_path / "pick.json")
    read = load_task(tmp_path / "pick.json")
    assert read.request is not None
    assert (read.request.seed, read.request.acceleration_scale, read.request.timing) == (3, 0.5, asked.timing)
    assert [segment.timing for segment in read.segments] == [None, SCurve(), SCurve()]
    assert recertify(read).certified
    descent = read.segments[1].result
    line = bin_().follow(descent.unwrap()[0].waypoints, pace=Pace(asked.timing, acceleration_scale=0.5))
    jerky = replace(descent, path=line.path, trajectory=line.trajectory)
    refused(changed(read, "descend", result=jerky), "descend: .* the jerk", bin_())
    weak = replace(read.request, timing=ToppRa(torque=True), torque_scale=0.1)  # which its lines have to keep, too
    refused(replace(read, request=weak), "descend: .* torque", bin_())


# What a task says the gripper does.


def with_segments(task: SavedTask, *segments: Segment) -> SavedTask:
    return replace(task, segments=segments)


def changed(task: SavedTask, name: str, **values: Any) -> SavedTask:
    parts = [replace(part, **values) if part.name == name else part for part in task.segments]
    assert any(part.name == name for part in task.segments)
    return with_segments(task, *parts)


def exempting(task: SavedTask, name: str, *exempt: ExemptInterval) -> SavedTask:
    (part,) = [part for part in task.segments if part.name == name]
    certificate = replace(present(part.result.certificate), exempt=(*part.result.exempt, *exempt))
    return changed(task, name, result=replace(part.result, certificate=certificate))


def length_of(task: SavedTask, name: str) -> float:
    (path,) = [part.result.path for part in task.segments if part.name == name]
    assert path is not None
    return path.length


def test_a_gripper_is_not_told_a_width_beyond_its_range(read: SavedTask) -> None:
    for width in (5.0, -1.0, math.nan):
        forged = with_segments(read, *(replace(part, width=width) for part in read.segments))
        refused(forged, r"expected a gap between the finger pads in \[0", bin_())
        with pytest.raises(InvalidRequest, match="a gap between the finger pads"):
            execute(forged, FakeArm(np.array(bin_().robot.home)), bin_().robot, QUICK, allow_unproven=True)


@pytest.mark.slow
def test_an_object_is_taken_by_a_gripper_that_closes_on_it(read: SavedTask) -> None:
    shut = with_segments(read, *(replace(part, width=0.0) if k > 1 else part for k, part in enumerate(read.segments)))
    refused(shut, "lift: got a gripper 0.0000 m open around blue_block", bin_())
    closed = next(part.width for part in read.segments if part.name == "lift")
    early = changed(changed(read, "home -> pregrasp", width=closed), "descend", width=closed)
    refused(early, "lift: got blue_block taken by a gripper that stays as it is", bin_())
    never = changed(changed(read, "retreat", width=closed), "retreat -> home", width=closed)
    refused(never, "retreat: got blue_block left by a gripper that stays as it is", bin_())
    refused(changed(read, "lift", width=0.08), "lift: got blue_block taken by a gripper that opens", bin_())
    refused(changed(read, "retreat", width=0.0), "retreat: got blue_block left by a gripper that closes", bin_())
    refused(changed(read, "transfer", width=0.05), "around blue_block; expected a gripper that stays as it is", bin_())


@pytest.mark.parametrize(
    ("kept", "match"),
    [
        ((0, 3, 4, 5, 6), "transfer: got blue_block carried at another place than where it is taken"),
        ((0, 1, 3, 4, 5, 6), "expected .*, where descend ends"),
        ((2, 3, 4, 5, 6), "lift: got blue_block carried; expected nothing"),
        ((0, 1, 2, 2, 3, 4, 5, 6), "where lift ends"),
        ((0, 2, 1, 3, 4, 5, 6), "where home -> pregrasp ends|blue_block"),
    ],
)
def test_pieces_of_a_task_left_out_repeated_or_swapped_are_refused(
    kept: tuple[int, ...], match: str, read: SavedTask
) -> None:
    refused(with_segments(read, *(read.segments[k] for k in kept)), match, bin_())


def scene_of(task: SavedTask, name: str) -> Scene:
    (scene,) = [part.scene for part in task.segments if part.name == name]
    assert scene is not None
    return scene


def carrying(task: SavedTask, forge: Callable[[Attached], Attached]) -> SavedTask:
    """The task with another thing in the gripper, all along the way."""
    parts = []
    for part in task.segments:
        attached = tuple(forge(held) for held in present(part.scene).attached)
        parts.append(replace(part, scene=replace(present(part.scene), attached=attached)))
    return with_segments(task, *parts)


def test_what_is_carried_is_what_was_taken_where_it_was_taken(read: SavedTask) -> None:
    tiny = carrying(read, lambda held: replace(held, shape=Box((0.001, 0.001, 0.001))))
    refused(tiny, "an obstacle of that name and shape in the scene before", bin_())
    aside = carrying(read, lambda held: replace(held, pose=Pose((0.3, 0.0, 0.0)) @ held.pose))
    refused(aside, "carried at another place than where it is taken", bin_())
    post = bin_().scene.obstacle("demo_post")
    parts = []
    for part in read.segments:
        scene = part.scene
        if scene is not None and scene.attached:
            other = replace(scene.attached[0], name=post.name, shape=post.shape)
            scene = bin_().scene.without(post.name).with_attached(other)
        parts.append(replace(part, scene=scene))
    refused(with_segments(read, *parts), "demo_post carried at another place than where it is taken", bin_())
    links = tuple(dict.fromkeys(shape.link for shape in bin_().robot.shapes))
    anything = carrying(read, lambda held: replace(held, touch_links=links))
    refused(anything, "expected what is taken to touch the fingers alone", bin_())


@pytest.mark.slow
def test_nothing_vanishes_appears_or_moves_between_motions(read: SavedTask) -> None:
    without = changed(read, "transfer", scene=scene_of(read, "transfer").without("demo_post"))
    refused(without, "transfer: got another scene than after lift", bin_())
    moved = changed(read, "transfer", scene=scene_of(read, "transfer").moved("demo_post", Pose((0.0, -0.5, 0.1))))
    refused(moved, "transfer: got another scene than after lift", bin_())
    elsewhere = scene_of(read, "retreat").moved("blue_block", Pose((0.2, -0.3, 0.1)))
    refused(changed(read, "retreat", scene=elsewhere), "retreat: got another scene than after lower", bin_())
    ghost = replace(read, begin=replace(read.begin, scene=read.scene.without("demo_post")))
    refused(ghost, "home -> pregrasp: got another scene than at the start of the plan", bin_())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "length", "pair", "match"),
    [
        ("lift", None, ("blue_block", "bin_floor"), "at most 50 mm are meant"),
        ("lower", None, ("blue_block", "tray"), "at most 50 mm are meant"),
        ("transfer", None, ("blue_block", "tray"), "no rule"),
        ("descend", None, ("finger_left", "demo_post"), "no rule"),
        ("retreat -> home", None, ("finger_left", "blue_block"), "finger_left x blue_block is not judged"),
        ("lift", 9.0, ("blue_block", "bin_floor"), "beyond the end"),
        ("lift", 0.01, ("ghost", "demo_post"), "have no such pair"),
    ],
)
def test_a_stretch_wider_than_its_rule_is_refused(
    name: str, length: float | None, pair: tuple[str, str], match: str, read: SavedTask
) -> None:
    stretch = ExemptInterval(0.0, length or length_of(read, name), (pair,), "grasp")
    refused(exempting(read, name, stretch), match, bin_())


# Real arms, and the command line.


@pytest.mark.slow
def test_a_real_arm_is_moved_by_a_file_only_in_the_world_that_the_operator_knows(tmp_path: Path) -> None:
    simulated: Any = np.bool_(False)
    plan, arm = saved(bin_(), good(), tmp_path), FakeArm(np.array(bin_().robot.home), simulated=simulated)
    made = rf"wxai \({bin_().robot.hash[:12]}\) in bin \({bin_().scene.hash[:12]}\)"
    with pytest.raises(
        InvalidRequest, match=rf"--robot and --scene, or .*service=PlannerService\(robot, scene\)\)\. .*{made}"
    ):
        execute(plan, arm, bin_().robot, QUICK)
    moved = bin_().with_scene(bin_().scene.moved("demo_post", Pose((0.0, -0.6, 0.2))))
    with pytest.raises(InvalidRequest, match=rf"made in bin, {bin_().scene.hash[:12]}; .* {moved.scene.hash[:12]}"):
        execute(plan, arm, None, QUICK, service=moved)
    other = replace(bin_().robot, settle_time=9.0)
    with pytest.raises(InvalidRequest, match=rf"made for wxai, {bin_().robot.hash[:12]}; .* {other.hash[:12]}"):
        execute(plan, arm, None, QUICK, service=PlannerService(other, bin_().scene))
    assert arm.told == []
    assert execute(plan, arm, None, QUICK, service=bin_().changed(gripper=0.03)).ok
    arm.q = np.array(bin_().robot.home)
    assert execute(good(), arm, None, QUICK).ok  # this process planned it, for a scene that its caller gave


def test_a_forged_scene_does_not_reach_a_real_arm(tmp_path: Path) -> None:
    empty = PlannerService(bin_().robot, bin_().scene.without("demo_post"))
    plan = saved(empty, through_the_post(good(), bin_()), tmp_path)
    assert recertify(plan).certified  # in the scene of the file
    arm = FakeArm(np.array(bin_().robot.home), simulated=False)
    with pytest.raises(InvalidRequest, match="plan: made in bin"):
        execute(plan, arm, None, QUICK, service=bin_())
    assert arm.told == []


ARM = ["run", "--arm", "192.168.1.2", "--yes", "--robot", "wxai", "--scene", "bin"]
FILES = [["certify"], ["run", "--sim"], ARM, ["view", "--no-browser"], ["export"]]


@pytest.mark.parametrize("words", FILES, ids=lambda words: words[0])
def test_a_forged_file_is_refused_by_each_command(words: list[str], tmp_path: Path) -> None:
    saved(bin_(), through_the_post(good(), bin_()), tmp_path)
    done = CliRunner().invoke(app, [words[0], str(tmp_path / "plan.json"), *words[1:]])
    assert done.exit_code == 1
    assert "is not proven apart" in done.output


@pytest.mark.slow
def test_a_dry_run_lists_what_is_not_judged_and_moves_nothing(
    read: SavedTask, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "TrossenDriver", lambda address: pytest.fail("connected"))
    save_plan(read, tmp_path / "task.json")
    done = CliRunner().invoke(app, ["run", str(tmp_path / "task.json"), "--arm", "192.168.1.2"])
    assert done.exit_code == 2
    told = " ".join(done.stderr.split())
    assert "Not checked: descend: not judged from s = 0.000 to" in told
    assert "finger_left x blue_block, finger_right x blue_block (fingers may touch blue_block, which they take)" in told
    assert "also give --robot and --scene" in told
    done = CliRunner().invoke(app, ["run", str(tmp_path / "task.json"), "--arm", "192.168.1.2", "--yes"])
    assert done.exit_code == 2
    assert "--robot and --scene, or execute(..., service=PlannerService(robot, scene))" in " ".join(done.stderr.split())


def starting_at(task: SavedTask, name: str, robot: Robot, *segments: Segment) -> SavedTask:
    """A task that begins with one of a task's motions, what is carried then included."""
    (part,) = [part for part in task.segments if part.name == name]
    begin = World(robot.with_gripper(part.width), present(part.scene), (), task.begin.edge_step)
    return replace(task, begin=begin, segments=segments or (part,))


def test_a_gripper_that_holds_something_does_not_open_for_the_first_motion(read: SavedTask) -> None:
    task = starting_at(read, "transfer", bin_().robot)
    (part,) = task.segments
    start = np.array(part.result.trajectory(0.0))  # type: ignore[misc]
    assert execute(task, FakeArm(start, width=part.width), None, QUICK).ok
    refused(with_segments(task, replace(part, width=0.08)), "would drop it, opening to 0.0800 m", bin_())
    arm = FakeArm(start, width=0.02)
    with pytest.raises(NotProven, match=r"holds blue_block at 0\.0200 m and would drop it"):
        execute(task, arm, None, QUICK)
    assert (arm.told, arm.widths) == ([], [])


def test_what_is_carried_is_not_pushed_into_what_it_is_set_down_on(read: SavedTask) -> None:
    robot = bin_().robot
    lower = next(part for part in read.segments if part.name == "lower")
    assert lower.result.certificate is not None
    end = present(lower.result.trajectory)(present(lower.result.trajectory).duration)
    deeper = JointPath(straight_tool_line(robot, end, (0.0, 0.0, -0.008)).waypoints)
    meant = ExemptInterval(0.0, deeper.length, (("blue_block", "tray"),), "grasp")
    down = replace(along(lower.result, deeper, bin_(), meant), origin=None)
    up = replace(along(lower.result, deeper.reversed(), bin_()), origin=None)
    (held,) = present(lower.scene).attached
    there = Pose.from_matrix(robot.tool_pose(deeper.waypoints[-1])) @ held.pose
    left = present(lower.scene).without_attached(held.name).with_obstacle(Obstacle(held.name, held.shape, there))
    motions = (replace(lower, result=down), Segment("retreat", up, 0.069, scene=left))
    forged = starting_at(read, "lower", robot, *motions)
    assert "blue_block x tray is not judged from s = 0 to" in objections(forged)
    refused(forged, r"blue_block comes 8\.\d mm into tray", bin_())


# Values that are not what they seem.


class Fickle(Trajectory):
    """Goes elsewhere once it is driven."""

    def dilated(self, factor: float) -> Trajectory:
        straight = JointPath(self.path.waypoints[[0, -1]])
        return Trapezoidal().time_path(straight, PlannerService("wxai", "bin").robot.limits)


def test_what_is_driven_is_made_of_the_numbers_that_were_proven() -> None:
    path, law = good().unwrap()
    fickle = Fickle(path, law.durations, law.coefficients, law.dilation)
    arm = FakeArm(np.array(bin_().robot.home))
    assert execute(replace(good(), trajectory=fickle), arm, bin_().robot, QUICK).ok
    assert all(bin_().checker.state_is_free(q) for q, _, _ in arm.told)


# Numbers chosen so that sums, products and roundings hide what the arm would do.


@pytest.mark.slow
def test_an_arm_does_not_turn_back_at_speed_by_many_tiny_turns() -> None:
    step, count = 2e-12, 3_000
    start = home() + np.array([0.0, 0.3, 0.3, 0.0, 0.0, 0.0])
    angles = np.pi * (np.arange(count) + 0.5) / count
    moves = np.zeros((count, 6))
    moves[:, 0], moves[:, 1] = step * np.cos(angles), step * np.sin(angles)
    along_0 = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    arc = start + along_0 + np.cumsum(moves, axis=0)
    path = JointPath(np.vstack([start, start + along_0, arc, arc[-1] - along_0]))
    motion = Trapezoidal().time_path(path, bin_().robot.limits)
    speeds = motion(np.arange(0.0, motion.duration, 1e-3), 1)
    assert np.all(np.abs(np.diff(speeds, axis=0)) <= 1e-3 * bin_().robot.limits.acceleration + 1e-6)
