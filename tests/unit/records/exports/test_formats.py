"""Saved motions in every format: read back as their own programs would, they are points of the proven curves."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planner_service.errors import InvalidRequest, UnknownName
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import PlanRequest
from planner_service.records.exports.deviation import Between, deviation
from planner_service.records.exports.formats import FORMATS, How, exported, kept, one_motion
from planner_service.records.exports.robot_programs import points_within
from planner_service.records.plan_file import SavedPlan, SavedTask
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place

Floats = NDArray[np.float64]

DT = 0.02


def picked(robot: str) -> SavedTask:
    service = PlannerService(robot, "bin")
    home = service.robot.home
    return SavedTask.of(plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home)))


@pytest.fixture(scope="module")
def task() -> SavedTask:
    return picked("wxai")


@pytest.fixture(scope="module")
def curves(task: SavedTask) -> list[Trajectory]:
    return [segment.result.unwrap()[1] for segment in task.segments]


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.\d+", text)]


def urscript(text: str) -> Floats:
    return np.array([numbers(q) for q in re.findall(r"(?:movej|servoj)\(\[([^]]*)\]", text)])


def rapid(text: str) -> Floats:
    return np.radians([numbers(q) for q in re.findall(r"MoveAbsJ \[\[([^]]*)\]", text)])


def krl(text: str) -> Floats:
    return np.radians([numbers(q) for q in re.findall(r"PTP \{([^}]*)\}", text)])


def fanuc(text: str) -> Floats:
    positions = {int(k): numbers(q) for k, q in re.findall(r"P\[(\d+)\]\{.*?\t(J1=.*?)\n\};", text, re.DOTALL)}
    q = np.radians([positions[int(k)] for k in re.findall(r":J P\[(\d+)\]", text)])
    q[:, 2] += q[:, 1]
    return q


READERS: dict[str, Callable[[str], Floats]] = {
    "urscript": urscript,
    "urscript-servoj": urscript,
    "rapid": rapid,
    "krl": krl,
    "fanuc-ls": fanuc,
}


def away(points: Floats, curves: list[Trajectory]) -> float:
    """How far points are from the curves of motions one after another, in order."""
    dense = np.concatenate([curve.path(np.linspace(0.0, curve.path.length, 20_001)) for curve in curves])
    return max(float(np.abs(dense - q).max(axis=1).min()) for q in points)


@pytest.mark.parametrize("form", READERS)
def test_the_points_of_a_program_are_on_the_proven_curves_and_end_where_they_end(
    task: SavedTask, curves: list[Trajectory], form: str
) -> None:
    text = exported(task, form, How(dt=DT))
    assert isinstance(text, str)
    q = READERS[form](text)
    assert away(q[::7], curves) <= 2e-4  # the curves are looked at every 1e-4 rad
    assert np.abs(q[-1] - curves[-1].path.waypoints[-1]).max() < 1e-8
    widths = [segment.width for segment in task.segments]
    changes = 1 + sum(a != b for a, b in pairwise(widths))
    assert len(re.findall(r"^(?:.*set_gripper[ (]0|.*[sS]et the gripper to 0)", text, re.MULTILINE)) == changes
    assert task.segments[1].name in text


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_joint_moves_stay_within_the_tolerance_of_the_curve(curves: list[Trajectory], tolerance: float) -> None:
    for curve in curves:
        points = points_within(curve, tolerance)
        s = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(points, axis=0)).max(axis=1))])
        dense = curve.path(np.linspace(0.0, curve.path.length, 100 * len(points)))
        moved = np.stack([np.interp(np.linspace(0.0, s[-1], 2_000 * len(points)), s, q) for q in points.T], axis=1)
        some = dense[:: max(37, len(dense) // 150)]
        coarse = moved[::200]
        nearest = [200 * int(np.abs(coarse - q).max(axis=1).argmin()) for q in some]
        near = [moved[max(0, k - 400) : k + 400] for k in nearest]  # what is left out is no nearer, or the test fails
        worst = max(float(np.abs(part - q).max(axis=1).min()) for part, q in zip(near, some, strict=True))
        assert worst <= tolerance + s[-1] / (2_000 * len(points))


def test_a_finer_tolerance_takes_more_points(curves: list[Trajectory]) -> None:
    bent = max(curves, key=lambda curve: len(curve.path.waypoints))
    assert len(points_within(bent, 1e-5)) > 2 * len(points_within(bent, 1e-3)) > 2


@pytest.mark.parametrize("between", ["linear", "cubic", "quintic"])
def test_the_deviation_bounds_what_is_drawn_between_samples(curves: list[Trajectory], between: Between) -> None:
    rng = np.random.default_rng(41)
    for curve in curves:
        samples = curve.sample(0.05)
        t = rng.uniform(0.0, curve.duration, 20_000)
        k = np.clip(samples.t.searchsorted(t, side="right") - 1, 0, len(samples.t) - 2)
        h, x = np.diff(samples.t)[k][:, None], (t - samples.t[k])[:, None] / np.diff(samples.t)[k][:, None]
        q0, q1 = samples.q[k], samples.q[k + 1]
        v0, v1, a0, a1 = samples.qd[k] * h, samples.qd[k + 1] * h, samples.qdd[k] * h * h, samples.qdd[k + 1] * h * h
        if between == "linear":
            drawn = q0 + (q1 - q0) * x
        elif between == "cubic":  # Hermite's own basis
            drawn = (1 + 2 * x) * (1 - x) ** 2 * q0 + x * (1 - x) ** 2 * v0
            drawn += x * x * (3 - 2 * x) * q1 - x * x * (1 - x) * v1
        else:
            drawn = (1 - 10 * x**3 + 15 * x**4 - 6 * x**5) * q0 + (10 * x**3 - 15 * x**4 + 6 * x**5) * q1
            drawn += (x - 6 * x**3 + 8 * x**4 - 3 * x**5) * v0 + (-4 * x**3 + 7 * x**4 - 3 * x**5) * v1
            drawn += (x**2 - 3 * x**3 + 3 * x**4 - x**5) / 2 * a0 + (x**3 - 2 * x**4 + x**5) / 2 * a1
        seen = float(np.abs(drawn - curve(t)).max())
        bound = deviation(curve, samples, between)
        assert seen <= bound <= 2.0 * seen + 5e-4


def test_json_has_all_motions_and_the_grippers_events(task: SavedTask, curves: list[Trajectory]) -> None:
    document = json.loads(exported(task, "json", How(dt=DT)))
    assert document["joint_names"] == list(task.robot.joint_names)
    assert set(document["units"]) == {"rad"}
    assert [motion["name"] for motion in document["motions"]] == [segment.name for segment in task.segments]
    for motion, curve in zip(document["motions"], curves, strict=True):
        np.testing.assert_array_equal(motion["positions"], curve(np.array(motion["t"])))
        assert motion["t"][-1] == curve.duration
    widths = [(event["before"], event["width"]) for event in document["events"]]
    assert [name for name, _ in widths] == [task.segments[k].name for k in (0, 2, 5)]
    assert widths[1][1] < widths[0][1]
    assert all(bound < 1e-3 for bound in document["deviation"].values())


def test_a_gripper_that_sucks_says_when_it_does() -> None:
    sucking = picked("xarm7_vacuum")
    assert sucking.failure is None
    found = json.loads(exported(sucking, "json", How(dt=DT)))["events"]
    assert [(event["before"], event["suction"]) for event in found] == [
        (sucking.segments[2].name, True),
        (sucking.segments[5].name, False),
    ]


def test_an_array_has_the_rows_of_the_table(task: SavedTask) -> None:
    content = exported(task, "npy", How(dt=DT))
    assert isinstance(content, bytes)
    rows = np.load(io.BytesIO(content), allow_pickle=False)
    table = str(exported(task, "csv", How(dt=DT))).splitlines()[1:]
    np.testing.assert_array_equal(
        rows, [[float(x) for k, x in enumerate(row.split(",")) if k not in (1, 2)] for row in table]
    )


def test_actions_of_lerobot_are_on_the_curves_at_equal_distances(task: SavedTask, curves: list[Trajectory]) -> None:
    document = json.loads(exported(task, "lerobot", How(dt=1 / 30)))
    assert document["fps"] == pytest.approx(30.0)
    firsts = [motion["first"] for motion in document["motions"]] + [len(document["actions"])]
    for curve, first, end in zip(curves, firsts, firsts[1:], strict=False):
        q = [[action[f"{name}.pos"] for name in task.robot.joint_names] for action in document["actions"][first:end]]
        t = np.linspace(0.0, curve.duration, end - first)
        np.testing.assert_allclose(q, curve(t), atol=1e-9)
        assert curve.duration / (end - first - 1) <= 1 / 30
    carriage = {2.0 * action["left_carriage_joint.pos"] for action in document["actions"]}
    assert carriage == {segment.width for segment in task.segments}


def test_a_goal_of_follow_joint_trajectory_holds_the_joint_trajectory(task: SavedTask) -> None:
    goals = json.loads(exported(task, "follow-joint-trajectory", How(dt=DT)))["motions"]
    plain = json.loads(exported(task, "joint-trajectory", How(dt=DT)))["motions"]
    assert [goal["trajectory"]["trajectory"] for goal in goals] == [each["trajectory"] for each in plain]
    assert goals[0]["trajectory"]["goal_time_tolerance"] == {"sec": 0, "nanosec": 0}


def test_a_recording_of_mcap_is_read_by_its_own_reader(task: SavedTask, curves: list[Trajectory]) -> None:
    make_reader = pytest.importorskip("mcap.reader").make_reader
    content = exported(task, "mcap", How(dt=0.1))
    assert isinstance(content, bytes)
    topics: dict[str, list[Any]] = {}
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages():
        assert schema is not None
        topics.setdefault(f"{channel.topic} {schema.name}", []).append((message.log_time, json.loads(message.data)))
    joints = topics["/joint_states foxglove.JointStates"]
    assert [joint["name"] for joint in joints[0][1]["joints"]] == list(task.robot.joint_names)
    assert joints[-1][0] == pytest.approx(1e9 * sum(curve.duration for curve in curves), abs=10.0)
    end = [joint["position"] for joint in joints[-1][1]["joints"]]
    np.testing.assert_array_equal(end, curves[-1].path.waypoints[-1])
    assert len(topics["/tf foxglove.FrameTransforms"]) == len(joints)
    scenes = [update for _, update in topics["/scene foxglove.SceneUpdate"]]
    assert len(scenes) == len(task.segments)
    assert {"blue_block", "tray"} <= {entity["id"].partition(" ")[2] for entity in scenes[0]["entities"]}


def test_one_motion_of_a_task_is_a_task_of_its_own(task: SavedTask) -> None:
    lift = one_motion(task, "lift")
    assert [segment.name for segment in lift.segments] == ["lift"]
    assert [each.name for each in one_motion(task, "2").segments] == ["lift"]
    assert lift.begin.robot.gripper_width == task.segments[1].width
    for wrong in ("lif", "7", "-1", "²"):
        with pytest.raises(UnknownName, match="segment"):
            one_motion(task, wrong)


@pytest.mark.parametrize("form", [form for form in FORMATS if form not in ("mujoco", "rrd", "mcap")])
def test_every_format_begins_as_it_says_and_tells_what_it_keeps(task: SavedTask, form: str) -> None:
    content = exported(task, form, How())
    start = content if isinstance(content, bytes) else content.encode()
    assert FORMATS[form].beginning.match(start)
    assert re.search(r"within [0-9.e-]+ rad", kept(task, form, How()))


def test_what_does_not_go_with_a_format_is_refused(task: SavedTask) -> None:
    with pytest.raises(UnknownName, match="format"):
        exported(task, "json5", How())
    with pytest.raises(InvalidRequest, match="yaml"):
        exported(task, "csv", How(yaml=True))
    with pytest.raises(InvalidRequest, match="model"):
        exported(task, "mujoco", How())
    with pytest.raises(InvalidRequest, match="tolerance"):
        exported(task, "rapid", How(tolerance=math.inf))
    with pytest.raises(InvalidRequest, match="dt"):
        exported(task, "urscript-servoj", How(dt=0.0))
    planar = PlannerService("planar2", "discs")
    poses = PlanRequest(planar.robot.pose("lesson_start"), planar.robot.pose("lesson_goal"))
    with pytest.raises(InvalidRequest, match="6 revolute joints"):
        exported(SavedPlan.of(planar.plan(poses)), "krl", How())
