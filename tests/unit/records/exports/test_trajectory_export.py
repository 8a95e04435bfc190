"""Trajectories for others: ROS-shaped, as a table, and by the command ``export``."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from functools import partial
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planner_service.errors import InvalidRequest, PlanningFailed
from planner_service.path.joint_path import JointPath
from planner_service.path.trajectory import Trajectory
from planner_service.planning.request import PlanRequest
from planner_service.planning.result import PlanResult
from planner_service.planning.task_result import Segment
from planner_service.records.evidence import save_plan
from planner_service.records.exports.trajectory_export import (
    csv_text,
    display_trajectory,
    joint_trajectory,
    robot_trajectory,
    task_csv_text,
    task_trajectories,
    write_csv,
    yaml_text,
)
from planner_service.records.plan_file import SavedPlan
from planner_service.service import PlannerService
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.command import run

SERVICE = PlannerService("planar2", "discs")
NAMES = SERVICE.robot.joint_names
REQUEST = PlanRequest(SERVICE.robot.pose("lesson_start"), SERVICE.robot.pose("lesson_goal"), time_limit=None)


@pytest.fixture(scope="module")
def planned() -> PlanResult:
    return SERVICE.plan(REQUEST)


@pytest.fixture(scope="module")
def trajectory(planned: PlanResult) -> Trajectory:
    return planned.unwrap()[1]


def fields(message: Any) -> Any:
    """The names of a message's fields, of lists those of the first entry."""
    if isinstance(message, dict):
        return {name: fields(value) for name, value in message.items()}
    return [fields(message[0])] if isinstance(message, list) and message else None


def nanoseconds(message: dict[str, Any]) -> list[int]:
    times = [point["time_from_start"] for point in message["points"]]
    assert all(0 <= time["nanosec"] < 10**9 for time in times)
    return [time["sec"] * 10**9 + time["nanosec"] for time in times]


def test_a_joint_trajectory_has_the_fields_of_the_message_and_ends_exactly(
    planned: PlanResult, trajectory: Trajectory
) -> None:
    message = joint_trajectory(planned, NAMES, 0.01, frame_id="base")
    assert message == json.loads(json.dumps(message, allow_nan=False))
    assert list(message) == ["header", "joint_names", "points"]
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"}
    assert message["joint_names"] == list(NAMES)
    t, q, qd, qdd = trajectory.sample(0.01)
    points = message["points"]
    assert [point["positions"] for point in points] == q.tolist()
    assert [point["velocities"] for point in points] == qd.tolist()
    assert [point["accelerations"] for point in points] == qdd.tolist()
    assert all(point["effort"] == [] for point in points)
    assert nanoseconds(message) == [round(at * 1e9) for at in t.tolist()]
    assert points[-1]["positions"] == trajectory.path.waypoints[-1].tolist()
    assert points[-1]["velocities"] == [0.0, 0.0]


HEADER = {"stamp": {"sec": None, "nanosec": None}, "frame_id": None}
POINT = {"positions": [None], "velocities": [None], "accelerations": [None], "effort": None}
JOINTS = {
    "header": HEADER,
    "joint_names": [None],
    "points": [{**POINT, "time_from_start": {"sec": None, "nanosec": None}}],
}
ROBOT = {
    "joint_trajectory": JOINTS,
    "multi_dof_joint_trajectory": {"header": HEADER, "joint_names": None, "points": None},
}


def test_moveits_messages_have_their_fields_and_the_same_trajectory(planned: PlanResult) -> None:
    joints = joint_trajectory(planned, NAMES, 0.01, frame_id="base")
    robot = robot_trajectory(planned, NAMES, 0.01, frame_id="base")
    assert robot["joint_trajectory"] == joints
    assert fields(robot) == ROBOT
    poses = SERVICE.robot.poses
    back = SERVICE.plan(PlanRequest(poses["lesson_goal"], poses["lesson_start"], time_limit=None))
    segments = [Segment("there", planned, 0.0), Segment("back", back, 0.0)]
    shown = display_trajectory(segments, NAMES, 0.01, model_id="planar2", frame_id="base")
    assert shown["trajectory"] == [robot, robot_trajectory(back, NAMES, 0.01, frame_id="base")]
    assert shown["trajectory_start"]["joint_state"]["position"] == SERVICE.robot.pose("lesson_start").tolist()
    assert fields(shown) == {
        "model_id": None,
        "trajectory": [ROBOT],
        "trajectory_start": {
            "joint_state": {"header": HEADER, "name": [None], "position": [None], "velocity": None, "effort": None},
            "multi_dof_joint_state": {
                "header": HEADER, "joint_names": None, "transforms": None, "twist": None, "wrench": None,
            },
            "attached_collision_objects": None,
            "is_diff": None,
        },
    }  # fmt: skip
    assert task_trajectories(segments, NAMES, 0.01, moveit=True)["motions"][1]["trajectory"] == robot_trajectory(
        back, NAMES, 0.01
    )


def test_yaml_reads_back_as_the_same_bits(planned: PlanResult) -> None:
    message = robot_trajectory(planned, NAMES, 0.01)
    message["joint_trajectory"]["points"][0]["positions"] = [1e-05, -1e300]  # YAML 1.1 takes 1e-05 for text
    message["joint_trajectory"]["joint_names"] = ["on", "1e5"]
    assert yaml.safe_load(yaml_text(message)) == message


@pytest.mark.parametrize("factor", [1.0, 1e-10])
def test_times_from_start_always_grow_however_short_the_steps(trajectory: Trajectory, factor: float) -> None:
    short = trajectory.dilated(factor * 10.0).dilated(0.1)
    for share in (3e-3, 0.25, 0.25 * (1 - 1e-7), 2.0):  # the last but one ends a fraction of a nanosecond early
        message = joint_trajectory(short, NAMES, short.duration * share)
        times = nanoseconds(message)
        assert times[0] == 0
        assert all(before < after for before, after in pairwise(times))
        assert abs(times[-1] - short.duration * 1e9) <= 1.0
        assert message["points"][-1]["positions"] == trajectory.path.waypoints[-1].tolist()


def test_a_table_reads_back_as_the_same_bits(planned: PlanResult, trajectory: Trajectory, tmp_path: Path) -> None:
    path = tmp_path / "motion.csv"
    write_csv(planned, path, ("upper, left", '"q"'), 0.01)
    with open(path, newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head == ["t", "q_upper, left", 'q_"q"', "qd_upper, left", 'qd_"q"', "qdd_upper, left", 'qdd_"q"']
    assert [[float(word) for word in row] for row in rows] == np.column_stack(trajectory.sample(0.01)).tolist()


# The command


@pytest.fixture
def plan_file(planned: PlanResult, tmp_path: Path) -> Path:
    save_plan(SavedPlan(SERVICE.world, REQUEST, planned), tmp_path / "plan.json")
    return tmp_path / "plan.json"


def test_export_prints_the_message_or_writes_it(plan_file: Path, trajectory: Trajectory, tmp_path: Path) -> None:
    printed = run("export", plan_file, "--format", "robot-trajectory", "--dt", "0.02")
    assert (printed.exit_code, json.loads(printed.stdout)) == (0, robot_trajectory(trajectory, NAMES, 0.02))
    for _ in range(2):  # the second time over the first
        done = run("export", plan_file, "--format", "display-trajectory", "--yaml", "--out", tmp_path / "motion.yaml")
        assert (done.exit_code, done.stdout) == (0, "")
    before = plan_file.read_bytes()
    for wrong in (("--out", plan_file), ("--format", "csv", "--yaml"), ("--format", "cvs")):
        assert run("export", plan_file, *wrong).exit_code == 2
    assert plan_file.read_bytes() == before
    message = yaml.safe_load((tmp_path / "motion.yaml").read_text())
    assert (message["model_id"], message["trajectory"]) == ("planar2", [robot_trajectory(trajectory, NAMES, 0.01)])


def test_what_no_message_can_hold_is_refused(planned: PlanResult, trajectory: Trajectory) -> None:
    twice = [Segment("there", planned, 0.0), Segment("again", planned, 0.0)]
    still = Trajectory(JointPath(np.array([[0.5, -0.5]])), np.zeros(0), np.zeros((0, 4)))
    assert csv_text(still, NAMES, 0.01).splitlines()[1:] == ["0.0,0.5,-0.5,0.0,0.0,0.0,0.0"]
    wrong: Any = 7
    refused: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
        *(
            (joint_trajectory, (planned, names, 0.01), "joint_names")
            for names in (("a",), ("a", "a"), ("a", ""), "ab", 5)
        ),
        (csv_text, (trajectory, NAMES, 0.0), r"dt: got 0\.0; expected a positive number of seconds"),
        (joint_trajectory, (trajectory.dilated(1e9).dilated(10.0), NAMES, 1e9), "a duration below 2,147,483,648 s"),
        (csv_text, (None, NAMES, 0.01), "motion: got None; expected a Trajectory or a PlanResult"),
        (task_trajectories, (twice, NAMES, 0.01), r"segments: got 'again, which begins at .*; .* where there ends"),
        (task_csv_text, (twice, NAMES, 0.01), "segments: got 'again, which begins at"),
        *((task_trajectories, (none, NAMES, 0.1), "segments") for none in (None, [], [1], "plan")),
        (partial(joint_trajectory, frame_id=wrong), (planned, NAMES, 0.1), "frame_id"),
        (partial(display_trajectory, model_id=wrong), (twice[:1], NAMES, 0.1), "model_id"),
    ]
    for export, arguments, match in refused:
        with pytest.raises(InvalidRequest, match=match):
            export(*arguments)
    with pytest.raises(PlanningFailed, match="GOAL_OUTSIDE_LIMITS"):
        csv_text(SERVICE.plan(PlanRequest(REQUEST.start, [0.0, 100.0], time_limit=None)), NAMES, 0.01)


@pytest.mark.slow
def test_export_of_a_task_has_all_motions_on_one_clock(tmp_path: Path) -> None:
    service = PlannerService("wxai", "bin")
    home = service.robot.home
    task = plan_pick_place(service, "blue_block", "tray", PlanRequest(home, home, time_limit=None))
    task.save(tmp_path / "task.json")
    printed = run("export", tmp_path / "task.json", "--format", "csv", "--dt", "0.05")
    assert printed.exit_code == 0
    head, *rows = csv.reader(printed.stdout.splitlines())
    assert head[:4] == ["t", "motion", "gripper_width", "q_joint_0"]
    assert [name for name, _ in groupby(row[1] for row in rows)] == [segment.name for segment in task.segments]
    times = [float(row[0]) for row in rows]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(sum(segment.result.unwrap()[1].duration for segment in task.segments))
    widths = {segment.name: segment.width for segment in task.segments}
    assert all(float(row[2]) == widths[row[1]] for row in rows)
    motions = json.loads(run("export", tmp_path / "task.json").stdout)["motions"]
    for motion, segment in zip(motions, task.segments, strict=True):
        assert (motion["name"], motion["gripper_width"]) == (segment.name, segment.width)
        assert motion["trajectory"] == joint_trajectory(segment.result, service.robot.joint_names, 0.01)
    shown = json.loads(run("export", tmp_path / "task.json", "--format", "display-trajectory").stdout)
    assert [each["joint_trajectory"] for each in shown["trajectory"]] == [motion["trajectory"] for motion in motions]
    assert motions[1]["begin"] == task.segments[0].result.unwrap()[1].duration
