"""Lines with rounded corners and arcs, measured by the auditor's kinematics and judged by its collision checks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from auditor.checker import IndependentChecker, tables_of
from planner_service import Box, Obstacle, PlannerService, PlanResult, Pose, Scene, ToppRa, move_linear
from planner_service.files.package_data import data_folder
from planner_service.geometry.arrays import FloatArray
from planner_service.planning import Pace
from planner_service.tasks import move_circular

TABLE = Obstacle("table", Box((2.4, 2.4, 0.1)), Pose((0.0, 0.0, -0.06)))
METRES, RADIANS = 1e-3, 5e-3
SAMPLES = 600

Track = tuple[FloatArray, FloatArray]
"""Positions (m, 3) and rotation matrices (m, 3, 3)."""


@pytest.fixture(scope="module", params=["wxai", "panda"])
def service(request: pytest.FixtureRequest) -> PlannerService:
    return PlannerService(request.param, Scene(obstacles=(TABLE,)))


@pytest.fixture(scope="module")
def auditor(service: PlannerService) -> IndependentChecker:
    return IndependentChecker(data_folder("robots") / service.robot.name, tables_of(service.scene))


def turned(pose: Pose, shift: tuple[float, float, float], rpy: tuple[float, float, float]) -> Pose:
    """The pose moved along the base's axes and turned about its own."""
    x, y, z = (a + b for a, b in zip(pose.position, shift, strict=True))
    return Pose((x, y, z), (pose @ Pose.from_rpy((0.0, 0.0, 0.0), rpy)).quaternion)


def measured(auditor: IndependentChecker, result: PlanResult) -> Track:
    _, trajectory = result.unwrap()
    poses = np.array([auditor.tool_pose(q) for q in trajectory(np.linspace(0.0, trajectory.duration, SAMPLES))])
    return poses[:, :3, 3], poses[:, :3, :3]


def rotations(a: Pose, b: Pose, u: FloatArray) -> FloatArray:
    """Turning from one orientation to the other by fractions u, (m, 3, 3)."""
    first, last = (Rotation.from_matrix(pose.rotation) for pose in (a, b))
    return np.asarray((Rotation.from_rotvec(np.outer(u, (last * first.inv()).as_rotvec())) * first).as_matrix())


def deviations(track: Track, ideal: Track) -> tuple[FloatArray, FloatArray]:
    """Of each sample, the distance (m) and angle (rad) from the pose of the ideal path that it is nearest to.

    Nearest is by the larger share of the tolerance.
    """
    metres, radians = [], []
    for position, rotation in zip(*track, strict=True):
        away = np.linalg.norm(ideal[0] - position, axis=1)
        angle = 2.0 * np.arcsin(np.minimum(1.0, np.sqrt(((ideal[1] - rotation) ** 2).sum(axis=(1, 2)) / 8.0)))
        best = int(np.maximum(away / METRES, angle / RADIANS).argmin())
        metres.append(away[best])
        radians.append(angle[best])
    return np.array(metres), np.array(radians)


def line(a: Pose, b: Pose) -> Track:
    u = np.linspace(0.0, 1.0, 2000, dtype=np.float64)
    return np.outer(1.0 - u, a.position) + np.outer(u, b.position), rotations(a, b, u)


def test_the_tool_follows_an_arc_and_turns_evenly(service: PlannerService, auditor: IndependentChecker) -> None:
    begin = Pose.from_matrix(service.robot.tool_pose(service.robot.home))
    radius, u = 0.05, np.linspace(0.0, 1.0, 3000, dtype=np.float64)
    goal = turned(begin, (0.0, 2.0 * radius, 0.0), (0.1, -0.2, 0.3))
    result = move_circular(service, service.robot.home, (0.0, radius, -radius), goal, pace=Pace(ToppRa()))
    angle = math.pi * u
    arc = np.stack([0.0 * u, radius - radius * np.cos(angle), -radius * np.sin(angle)], axis=1) + begin.position
    metres, radians = deviations(measured(auditor, result), (arc, rotations(begin, goal, u)))
    assert metres.max() <= METRES
    assert radians.max() <= RADIANS
    assert auditor.trajectory_is_free(result.unwrap()[1], result.unwrap()[1].duration, 0.01)


@pytest.mark.parametrize("zone", [0.0, 0.03])
def test_the_tool_follows_lines_and_leaves_them_only_within_the_zones(
    service: PlannerService, auditor: IndependentChecker, zone: float
) -> None:
    begin = Pose.from_matrix(service.robot.tool_pose(service.robot.home))
    second = turned(begin, (0.0, 0.08, 0.0), (0.1, 0.0, 0.2))
    third = turned(second, (-0.03, 0.0, -0.06), (0.0, -0.2, 0.0))
    goal = turned(third, (0.0, -0.08, 0.0), (0.0, 0.0, 0.0))
    poses = [second, third, goal]
    result = move_linear(service, service.robot.home, poses, zone=zone, pace=Pace(ToppRa()))
    track = measured(auditor, result)
    lines = [line(a, b) for a, b in zip([begin, *poses], poses, strict=False)]
    ideal = np.concatenate([at for at, _ in lines]), np.concatenate([turn for _, turn in lines])
    metres, radians = deviations(track, ideal)
    corner = np.min([np.linalg.norm(track[0] - pose.position, axis=1) for pose in (second, third)], axis=0)
    outside = corner > zone + METRES
    assert outside.sum() > SAMPLES / 4
    assert metres[outside].max() <= METRES
    assert radians[outside].max() <= RADIANS
    assert metres.max() <= METRES + zone * 5 / 12  # a corner of 90 degrees is missed by 0.3 of the zone
    assert np.linalg.norm(track[0][-1] - goal.position) < 1e-6
    assert auditor.trajectory_is_free(result.unwrap()[1], result.unwrap()[1].duration, 0.01)
