"""Published problem sets: each format gives the problems that it means, or says what it cannot."""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner_service import Box, Cylinder, InvalidFile, InvalidRequest, Mesh, PlannerService, Pose, Scene, load_robot
from planner_service.records import Problem, read_problems
from planner_service.records.problems import moveit_folder

SETS = Path(__file__).parents[3] / "benchmarks" / "problems"
SAMPLES = SETS / "samples"

SCENE = """\
robot_state:
  joint_state: {name: [a, b, c], position: [0, 0, 0], header: {frame_id: base_link}}
name: ""
allowed_collision_matrix: {entry_names: [l1], entry_values: [[true]]}
robot_model_name: arm
fixed_frame_transforms:
  - {header: {frame_id: base_link}, child_frame_id: base_link, transform: {translation: [0, 0, 0]}}
world:
  collision_objects:
    - header: {frame_id: base_link}
      id: can
      primitives: [{type: cylinder, dimensions: [0.14, 0.03]}]
      primitive_poses: [{position: [1, 2, 3], orientation: [0, 0, 1, 0]}]
    - header: {frame_id: /base_link}
      id: table
      pose: {position: [0, 0, 1], orientation: [0, 0, 0, 1]}
      primitives: [{type: box, dimensions: [1, 2, 0.1]}, {type: sphere, dimensions: [0.2]}]
      primitive_poses: [{position: [1, 0, 0]}, {position: [0, 1, 0]}]
      meshes: [{vertices: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], triangles: [[0, 1, 2]]}]
      mesh_poses: [{position: [0, 0, 1e-05]}]
"""
REQUEST = """\
start_state: {joint_state: {name: [a, b, c], position: [0.1, 0.2, 0.3], header: {frame_id: base_link}}}
workspace_parameters: {header: {frame_id: ""}, min_corner: [-1, -1, -1], max_corner: [1, 1, 1]}
allowed_planning_time: 60
goal_constraints: [{joint_constraints: [{joint_name: c, position: 1}, {position: -0.5, joint_name: a}]}]
planner_id: RRT
group_name: arm
"""


def folder_of(folder: Path, scene: str = SCENE, request: str = REQUEST) -> Path:
    place = folder / "set" / "box_arm"
    place.mkdir(parents=True)
    (place / "scene0003.yaml").write_text(scene, "utf-8")
    (place / "scene_sensed0003.yaml").write_text("octomap: {}", "utf-8")
    (place / "request0003.yaml").write_text(request, "utf-8")
    (place / "path0003.yaml").write_text("anything: [", "utf-8")
    return folder / "set"


def test_a_scene_and_a_request_of_moveit_are_a_problem(tmp_path: Path) -> None:
    found = read_problems(folder_of(tmp_path))
    (problem,) = found.problems
    assert (found.robot, problem.id, problem.joint_names) == ("arm", "box_arm/0003", ("c", "a"))
    assert (problem.frame, problem.start.tolist()) == ("base_link", [0.3, 0.1])
    assert [goal.tolist() for goal in problem.goals] == [[1.0, -0.5]]
    can, table, ball, hull = problem.scene.obstacles
    assert (can.shape, can.pose) == (Cylinder(0.03, 0.14), Pose((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0)))
    assert (table.name, table.shape, table.pose.position) == ("table", Box((1.0, 2.0, 0.1)), (1.0, 0.0, 1.0))
    assert (ball.name, ball.pose.position) == ("table#2", (0.0, 1.0, 1.0))
    assert (hull.name, hull.pose.position, type(hull.shape)) == ("table#3", (0.0, 0.0, 1.00001), Mesh)


def test_an_archive_is_read_as_the_folder_it_holds(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    with tarfile.open(tmp_path / "problems.tar.bz2", "w:bz2") as archive:
        archive.add(folder, "arm")
    (inside,), (outside,) = read_problems(tmp_path / "problems.tar.bz2").problems, read_problems(folder).problems
    assert (inside.id, inside.scene, inside.start.tolist()) == (outside.id, outside.scene, outside.start.tolist())


@pytest.mark.parametrize(
    ("scene", "request_", "problem"),
    [
        (SCENE.replace("type: sphere", "type: cone"), REQUEST, "cone"),
        (SCENE.replace("/base_link", "odom"), REQUEST, "'base_link, odom'; expected objects in one frame"),
        (
            SCENE.replace(", {position: [0, 1, 0]}", ""),
            REQUEST,
            "primitive_poses: got 1; expected one pose for each of 2",
        ),
        (SCENE.replace("dimensions: [0.2]", "dimensions: [0.2, 1]"), REQUEST, r"\[radius\]"),
        (SCENE + "  octomap: {octomap: {data: [1]}}\n", REQUEST, r"octomap: .*PointCloud"),
        (SCENE + "friction: 1\n", REQUEST, "unknown key 'friction'"),
        (SCENE, REQUEST.replace("joint_name: a", "joint_name: d"), "start_state: no position of d"),
        (SCENE, REQUEST + "path_constraints: {joint_constraints: [{joint_name: a}]}\n", "path_constraints: "),
        (SCENE, REQUEST.replace("0.1, 0.2, 0.3", "0.1, 0.2"), "expected one number for each of 3 names"),
        (
            SCENE,
            REQUEST.replace("{joint_constraints", "{position_constraints: [{}], joint_constraints"),
            "an empty list",
        ),
    ],
)
def test_what_would_change_a_moveit_problem_is_refused(tmp_path: Path, scene: str, request_: str, problem: str) -> None:
    with pytest.raises(InvalidFile, match=problem):
        read_problems(folder_of(tmp_path, scene, request_))


def test_a_request_without_its_scene_and_a_folder_without_requests_are_refused(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    (folder / "box_arm" / "request0004.yaml").write_text(REQUEST, "utf-8")
    with pytest.raises(InvalidFile, match=r"scene0004.yaml is missing beside it"):
        read_problems(folder)
    with pytest.raises(InvalidFile, match="no requests"):
        read_problems(SETS.parent / "worlds")


def bodies(scene: Scene) -> list[Any]:
    return sorted((type(o.shape).__name__, o.pose.position, *map(str, vars(o.shape).values())) for o in scene.obstacles)


def test_a_folder_of_something_else_is_not_searched_through(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(12):
        (tmp_path / f"{k}.txt").touch()
    monkeypatch.setattr(moveit_folder, "MAX_ENTRIES", 10)
    with pytest.raises(InvalidFile, match="more than 10 files and folders"):
        read_problems(tmp_path)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "request0001.yaml").write_text("")
    (tmp_path / "set" / "request0001.yaml").symlink_to(tmp_path / "request0001.yaml")
    with pytest.raises(InvalidFile, match="leads out of the folder"):
        read_problems(tmp_path / "set")


def test_the_samples_of_vamp_and_robometrics_are_the_problems_they_were_made_of() -> None:
    robot, own = load_robot("panda_mbm"), read_problems(SETS / "mbm_panda.json")
    vamp, robometrics = (read_problems(SAMPLES / f"{name}_panda.{kind}").problems for name, kind in FORMATS)
    assert [problem.id for problem in robometrics] == ["bookshelf_thin_panda/0000", "table_under_pick_panda/0000"]
    names = (*(problem.id for problem in vamp), "bookshelf_thin/0007", "table_under_pick/0007")
    for found, expected in zip((*vamp, *robometrics), map(own.problem, names), strict=True):
        assert bodies(found.scene) == bodies(expected.scene)
        first, second = (problem.request(robot) for problem in (found, expected))
        assert np.array_equal(first.start, second.start)
        assert np.array_equal(first.goals(robot)[0], second.goals(robot)[0])  # type: ignore[arg-type]


FORMATS = (("vamp", "json"), ("robometrics", "yaml"))


def test_the_sample_of_motion_bench_maker_is_planned() -> None:
    robot = load_robot("ur5")
    problem, _ = read_problems(SAMPLES / "motion_bench_maker").problems
    assert PlannerService(robot, problem.scene).plan(problem.request(robot, time_limit=None)).ok


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("vamp_panda.json", '"valid": true', '"velid": true'),
        ("robometrics_panda.yaml", "  start:", "  gripper: 1\n  start:"),
        ("robometrics_panda.yaml", "    cylinder:", "    mesh: {}\n    cylinder:"),
    ],
)
def test_unknown_words_of_vamp_and_robometrics_are_refused(tmp_path: Path, name: str, old: str, new: str) -> None:
    (tmp_path / name).write_text((SAMPLES / name).read_text("utf-8").replace(old, new, 1), "utf-8")
    with pytest.raises(InvalidFile, match="unknown key"):
        read_problems(tmp_path / name)


def test_a_pickle_is_never_read(tmp_path: Path) -> None:
    (tmp_path / "problems.pkl").write_bytes(b"\x80\x04.")
    with pytest.raises(InvalidFile, match=r"runs code when it is read; .* problems\.json"):
        read_problems(tmp_path / "problems.pkl")


def problem_of(**changes: Any) -> Problem:
    parts: dict[str, Any] = {"id": "p", "joint_names": (), "scene": Scene(), "start": np.zeros(2)}
    return Problem(**parts | {"goals": (np.ones(2),)} | changes)


def test_joints_are_put_in_the_order_of_the_robot() -> None:
    arm = load_robot("planar2")
    given = problem_of(joint_names=arm.joint_names[::-1], start=np.array([0.1, 0.2]), goals=(np.array([0.3, 0.4]),))
    request = given.request(arm)
    assert (np.asarray(request.start).tolist(), np.asarray(request.goal).tolist()) == ([0.2, 0.1], [0.4, 0.3])
    with pytest.raises(InvalidRequest, match="problem 'p' is for 3 joints"):
        problem_of(start=np.zeros(3)).request(arm)


def test_a_scene_is_in_the_frame_of_the_base_and_a_pose_that_of_the_tool() -> None:
    arm = load_robot("wxai")
    ends: dict[str, Any] = {"start": arm.home, "goals": (arm.home,)}
    for frame in ("", "world", "base_link"):
        problem_of(frame=frame, **ends).request(arm)
    for frame in ("odom", "link_3"):
        with pytest.raises(InvalidRequest, match=f"frame of problem 'p': got '{frame}'; expected the base of wxai: "):
            problem_of(frame=frame, **ends).request(arm)
    pose = Pose((0.3, 0.0, 0.2))
    assert problem_of(start=arm.home, goals=(), tool_pose=(arm.tool_frame, pose)).request(arm).goal == pose
    with pytest.raises(InvalidRequest, match=r"tool_frame: .*expected panda_hand"):
        problem_of(start=arm.home, goals=(), tool_pose=("panda_hand", pose)).request(arm)


def test_a_robometrics_problem_without_configurations_has_its_pose_as_the_goal(tmp_path: Path) -> None:
    text = """bin:
- start: [0, 0]
  goal_pose: {frame: hand, position_xyz: [1, 0, 0], quaternion_wxyz: [1, 0, 0, 0]}
  obstacles: {cuboid: {}, cylinder: null}
"""
    (tmp_path / "set.yaml").write_text(text, "utf-8")
    (problem,) = read_problems(tmp_path / "set.yaml").problems
    assert (problem.goals, problem.tool_pose) == ((), ("hand", Pose((1.0, 0.0, 0.0))))
    (tmp_path / "set.yaml").write_text(text.replace("  goal_pose", "  goal_ik: [[0]]\n  goal_pose"), "utf-8")
    with pytest.raises(InvalidFile, match="each goal as many numbers as the start, 2"):
        read_problems(tmp_path / "set.yaml")


def test_own_files_are_read_as_before(tmp_path: Path) -> None:
    assert len(read_problems(SETS / "mbm_panda.json").problems) == 70
    (tmp_path / "x.json").write_text(json.dumps({"joints": ["a"], "problems": [{"id": "x"}]}), "utf-8")
    with pytest.raises(InvalidFile, match=r"problems\[0\].start: missing"):
        read_problems(tmp_path / "x.json")
