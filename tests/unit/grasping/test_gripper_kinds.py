"""Turning fingers and suction cups: where they stand, what they take, and that a task with them is proven again."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from auditor.schema import Invalid
from auditor.verify import verify
from planner_service import Box, Cylinder, Obstacle, PlannerService, PlanRequest, Pose, Scene, Sphere
from planner_service.certify import certify_gripper
from planner_service.collision import CollisionChecker
from planner_service.errors import InvalidFile, InvalidRequest
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.grasping import top_grasps
from planner_service.records.evidence import save_plan, with_evidence
from planner_service.records.plan_file import load_task
from planner_service.records.recertify import recertify
from planner_service.robot.model import Robot
from planner_service.robot_setup.loading import load_robot
from planner_service.scene.loading import load_scene
from planner_service.tasks.pick_place import plan_pick_place
from tests.support.optional import present


@pytest.fixture(scope="module")
def kinova() -> Robot:
    return load_robot("kinova_gripper")


def tip_gap(robot: Robot) -> float:
    """Metres between the two finger tips along the axis on which they close, by the corners of their hulls."""
    gripper, T = present(robot.gripper), np.linalg.inv(robot.tool_placement)
    ends = []
    for tip in gripper.tips:
        (item,) = (item for item in robot.shapes if item.link == tip)
        M = T @ item.pose.matrix
        along = (item.shape.vertices @ M[:3, :3].T + M[:3, 3]) @ np.array(gripper.closing)  # type: ignore[attr-defined]
        ends.append((along.min(), along.max()))
    (a, b), (c, d) = sorted(ends)
    return float(c - b) if d > b else float(a - d)


def test_turning_fingers_stand_as_far_apart_as_they_are_told(kinova: Robot) -> None:
    gripper = present(kinova.gripper)
    for width in np.linspace(gripper.lower, gripper.upper, 9).tolist():
        assert tip_gap(kinova.with_gripper(width)) == pytest.approx(width, abs=1e-9)
        assert gripper.width_at(gripper.position(width)) == pytest.approx(width, abs=1e-9)


def test_turning_fingers_are_where_pinocchio_says(kinova: Robot) -> None:
    pin = pytest.importorskip("pinocchio")
    gripper = present(kinova.gripper)
    model = pin.buildModelFromUrdf(str(data_folder("robots") / "kinova_gripper" / "kinova_gripper.urdf"))
    data, q = model.createData(), pin.neutral(model)
    for width in (0.0, 0.045, gripper.upper):
        for name in gripper.joints:
            q[model.joints[model.getJointId(name)].idx_q] = gripper.position(width)
        pin.framesForwardKinematics(model, data, q)
        palm = data.oMf[model.getFrameId("fingertips")].inverse()
        tool = Pose.from_matrix(kinova.tool_placement).inverse()
        for item in kinova.with_gripper(width).shapes:
            if item.link in gripper.links:
                there = (palm * data.oMf[model.getFrameId(item.link)]).homogeneous
                np.testing.assert_allclose((tool @ item.pose).matrix, there, atol=1e-9)


def test_a_thin_plate_between_the_fingers_stops_them(kinova: Robot) -> None:
    plate = Obstacle(
        "plate", Box((0.02, 0.001, 0.02)), Pose.from_matrix(kinova.tool_pose(kinova.home)) @ Pose((0.0, 0.04, 0.0))
    )
    scene, gripper = Scene(obstacles=(plate,)), present(kinova.gripper)
    ends = [CollisionChecker(kinova.with_gripper(w), scene).state_is_free(kinova.home) for w in (0.0, gripper.upper)]
    found = certify_gripper(kinova, scene, kinova.home, (gripper.upper, 0.0))
    assert ends == [True, True]
    assert "the gripper cannot close from 122.0 to 0.0 mm" in found.refused
    width = float(found.refused.split("width of ")[1].split()[0]) / 1e3
    assert 0.0 < width < gripper.upper


def test_a_locked_wrist_keeps_the_fingers_where_they_were(kinova: Robot) -> None:
    def shapes(robot: Robot) -> list[FloatArray]:
        bodies = [np.array(body) for body in robot.body_poses(kinova.home[: robot.n])]
        placed = [(bodies[item.body], item.pose.matrix) for item in robot.with_gripper(0.05).shapes]
        return [body[:9].reshape(3, 3) @ M[:3] + np.outer(body[9:], M[3]) for body, M in placed]

    locked = kinova.locked({"j2s6s200_joint_6": float(kinova.home[5])})
    np.testing.assert_allclose(shapes(locked), shapes(kinova), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kinova_gripper", "xarm7_vacuum"])
def test_a_block_is_taken_out_of_the_bin_and_the_file_shows_others_the_proof(name: str, tmp_path: Path) -> None:
    service = PlannerService(name, load_scene("bin"))
    task = plan_pick_place(service, "blue_block", "tray", PlanRequest(service.robot.home, service.robot.home))
    assert task.failure is None, task.failure
    assert all(present(segment.result.certificate).certified for segment in task.segments)
    save_plan(task, tmp_path / "task.json")
    again = load_task(tmp_path / "task.json")
    document = json.loads(with_evidence(again).file_text())
    assert list(verify(document))
    document["sections"]["evidence"]["proofs"][-1]["moved"] = [0.1, 0.1]
    with pytest.raises(Invalid, match="fingers elsewhere"):
        list(verify(document))
    moving = [segment for segment in task.segments if segment.gripper is not None]
    assert (len(moving) > 0) == (present(service.robot.gripper).kind != "vacuum")


@pytest.mark.parametrize(
    ("shape", "turn"), [(Box((0.05, 0.06, 0.07)), (0.3, 0.2, 0.5)), (Cylinder(0.03, 0.08), (0.2, 0.1, 0.0))]
)
def test_a_cup_lies_on_the_face_that_looks_up(shape: Box | Cylinder, turn: tuple[float, float, float]) -> None:
    robot, target = load_robot("ur5_vacuum"), Obstacle("thing", shape, Pose.from_rpy((0.4, 0.1, 0.2), turn))
    gripper = present(robot.gripper)
    for grasp in top_grasps(robot, target):
        angles = np.linspace(0.0, 2.0 * math.pi, 12)
        rim = [Pose((gripper.radius * math.cos(a), gripper.radius * math.sin(a), 0.0)) for a in angles]
        local = np.array([(target.pose.inverse() @ grasp @ at).position for at in rim])
        assert np.abs(shape.distance(local)).max() < 1e-12
        above = np.array([(target.pose.inverse() @ grasp @ Pose((0.0, 0.0, -1e-4))).position])
        assert shape.distance(above)[0] == pytest.approx(1e-4)
        assert (grasp.rotation @ np.array(gripper.approach))[2] < -0.5


NO_FACE = [Sphere(0.03), Box((0.02, 0.1, 0.1)), Cylinder(0.01, 0.1)]


def test_what_has_no_face_for_the_cup_is_refused() -> None:
    shape: Any
    for shape in NO_FACE:
        target = Obstacle("thing", shape, Pose((0.4, 0.0, 0.1)))
        with pytest.raises(
            InvalidRequest, match=r"target: got 'thing'; expected .* flat face that looks up, at least 0.030 m"
        ):
            top_grasps(load_robot("ur5_vacuum"), target)


def test_a_cup_beside_its_object_is_no_grasp_in_a_file(tmp_path: Path) -> None:
    service = PlannerService("ur5_vacuum", load_scene("bin"))
    task = plan_pick_place(service, "blue_block", "tray", PlanRequest(service.robot.home, service.robot.home))
    save_plan(task, tmp_path / "task.json")
    saved = load_task(tmp_path / "task.json")
    block = saved.scene.obstacle("blue_block")
    aside = replace(block, pose=Pose((0.015, 0.0, 0.0)) @ block.pose)
    scene = saved.scene.without("blue_block").with_obstacle(aside)
    moved = saved.within(replace(saved.begin, scene=scene))
    assert not recertify(moved).certified


# ---- files


def robot_file(folder: Path, text: str) -> Path:
    path = folder / "robot.toml"
    path.write_text(text, "utf-8")
    return path


TOOL = (data_folder("robots") / "ur5_vacuum" / "robot.toml").read_text("utf-8")

REFUSED = [
    ('base = "ur5"', 'base = "ur6"', "unknown robot of base 'ur6'"),
    ('link = "suction_tool"', 'link = "tool0"', "tool.link: got 'tool0'; expected a name that no link"),
    ("radius = 0.015\napproach", "approach", "gripper.radius is missing; a vacuum gripper needs it"),
    ('kind = "vacuum"', 'kind = "vacuum"\nclosing = [1.0, 0.0, 0.0]', "gripper.closing: a vacuum gripper has none"),
]


@pytest.mark.parametrize(("old", "new", "said"), REFUSED)
def test_a_mistake_about_a_tool_is_named(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in TOOL
    with pytest.raises(InvalidFile, match=said):
        load_robot(robot_file(tmp_path, TOOL.replace(old, new, 1)))


def test_a_robot_based_on_another_is_that_but_for_what_it_says(tmp_path: Path) -> None:
    text = 'name = "mine"\nbase = "ur5"\n\n[poses]\nhome = [0.0, -1.0, 1.0, 0.0, 0.0, 0.0]\n'
    robot, base = load_robot(robot_file(tmp_path, text)), load_robot("ur5")
    assert (robot.name, list(robot.poses), robot.home.tolist()) == ("mine", ["home"], [0.0, -1.0, 1.0, 0.0, 0.0, 0.0])
    assert robot.limits.velocity.tolist() == base.limits.velocity.tolist()
    assert replace(robot, name="ur5", named_poses=base.named_poses).hash == base.hash
